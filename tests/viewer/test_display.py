"""Colours, borders and grids of what is shown: pure arrays."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.viewer.display import (
    Display,
    Mark,
    MeshLayer,
    PointLayer,
    View,
    coordinate_colours,
    face_colours,
    grid_of,
    probability_colours,
    record_borders,
)
from shapeforge.viewer.framing import contents, framing
from shapeforge.viewer.palette import SWITCHED_OFF, UNPAINTED, part_colours, rgb


def test_faces_are_coloured_by_part_unpainted_and_hidden():
    parts = part_colours(3)
    colours = face_colours(np.array([0, 2, -1, 1]), parts, hidden=(1,))
    assert colours.tolist() == [parts[0].tolist(), parts[2].tolist(), list(rgb(UNPAINTED)), list(rgb(SWITCHED_OFF))]


def test_a_coin_toss_is_pale_and_certainty_is_not():
    colours = probability_colours(np.array([[1.0, 0.0], [0.5, 0.5], [0.3, 0.7]]), part_colours(2))
    full, grey = part_colours(2), np.array(rgb(UNPAINTED))
    assert colours[0].tolist() == full[0].tolist()
    assert colours[1].tolist() == grey.tolist()
    away = np.abs(colours[2].astype(int) - grey).sum()
    assert 0 < away < np.abs(full[1].astype(int) - grey).sum()
    assert probability_colours(np.ones((2, 1)), part_colours(1)).tolist() == [part_colours(1)[0].tolist()] * 2


def test_borders_of_records_leave_the_diagonals_out():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    segments = record_borders(vertices, triangles, np.array([0, 0, 1, 1]))
    found = {frozenset(map(tuple, s.tolist())) for s in segments}
    assert len(segments) == len(found) == 7
    assert frozenset({(0.0, 0.0, 0.0), (1.0, 1.0, 0.0)}) not in found, "the diagonal of the first quad"
    assert frozenset({(1.0, 0.0, 0.0), (1.0, 1.0, 0.0)}) in found, "the edge between the quads"


@pytest.mark.parametrize(
    ("count", "aspect", "cells"), [(1, 1.4, (1, 1)), (12, 1.4, (3, 4)), (4, 1.0, (2, 2)), (2, 2.0, (1, 2))]
)
def test_grids_hold_all_and_suit_the_space(count, aspect, cells):
    assert grid_of(count, aspect) == cells
    for n in range(1, 30):
        rows, columns = grid_of(n, aspect)
        assert rows * columns >= n


def test_other_marks_keep_the_arrays():
    layer = MeshLayer("m", np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((1, 3), np.uint8))
    display = Display((View((layer,)),))
    marked = display.with_marks([(Mark("dot", (0.0, 0.0, 0.0)),)])
    assert marked.views[0].layers[0] is layer and len(marked.views[0].marks) == 1 and not display.views[0].marks


def test_colours_of_places_tell_places_apart():
    corners = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    assert len(np.unique(coordinate_colours(corners), axis=0)) == 8
    with_gap = coordinate_colours(np.vstack([corners, [[np.nan] * 3]]))
    assert with_gap.shape == (9, 3)


def box_and_points(positions: np.ndarray) -> Display:
    corners = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    mesh = MeshLayer("mesh", corners, np.array([[0, 1, 2]]), np.zeros((1, 3), np.uint8))
    dots = PointLayer("points", positions, np.zeros((len(positions), 3), np.uint8), 3.0)
    return Display((View((mesh, dots)),), 1, 1)


def test_points_astray_make_no_shape_small():
    """The camera of a fit stands by the shape; points near it are seen all the same, and points alone as they are."""
    near, far = np.array([[1.4, 1.4, -0.4]]), np.array([[0.5, 7.0, 0.5]])
    alone = framing(box_and_points(np.zeros((0, 3))), (400, 400))
    assert framing(box_and_points(far), (400, 400)) == alone
    assert framing(box_and_points(near), (400, 400)) != alone
    assert contents(box_and_points(near))[0].max() == 1.4
    cloud = View((PointLayer("points", far, np.zeros((1, 3), np.uint8), 3.0),))
    assert contents(Display((cloud,), 1, 1))[0].tolist() == far.tolist()
