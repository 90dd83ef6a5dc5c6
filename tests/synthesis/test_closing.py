"""Surfaces as files have them become closed solids that keep their faces."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.synthesis.closing import SHEET, closed_solids
from shapeforge.synthesis.measures import open_edges
from shapeforge.synthesis.surfaces import sides_of
from tests.synthesis.conftest import CORNERS, QUADS

BOX = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
SMALL = 0.3 * CORNERS


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def assert_closed(solid) -> None:
    assert open_edges(solid.triangles) == 0
    assert (np.bincount(sides_of(solid.triangles)[1]) == 2).all()


def test_a_closed_box_wound_at_random_stays_and_faces_outwards() -> None:
    shuffled = np.where(np.random.default_rng(0).random(len(BOX))[:, None] < 0.5, BOX, BOX[:, ::-1])
    assert open_edges(shuffled) > 0
    (solid,) = closed_solids(SMALL, shuffled)
    assert_closed(solid)
    assert not solid.mended and len(solid.triangles) == 12
    assert volume(solid.vertices, solid.triangles) == pytest.approx(0.027)


def test_a_box_without_a_side_gets_a_lid() -> None:
    (solid,) = closed_solids(SMALL, np.delete(BOX, [0, 6], axis=0))  # both halves of one quad
    assert_closed(solid)
    assert solid.mended and solid.area == pytest.approx(5 * 0.09)
    assert volume(solid.vertices, solid.triangles) == pytest.approx(0.027)


def test_halves_that_share_a_wall_become_one_box() -> None:
    right = SMALL + [0.3, 0.0, 0.0]
    halves = np.concatenate([BOX, BOX + 8])
    own = halves[~np.isin(np.arange(24), [12, 18])]  # the wall in the middle once, as after welding
    (solid,) = closed_solids(np.concatenate([SMALL, right]), own)
    assert_closed(solid)
    assert not solid.mended and len(solid.triangles) == 20
    assert volume(solid.vertices, solid.triangles) == pytest.approx(0.054)


def test_boxes_that_meet_at_an_edge_are_told_apart() -> None:
    apart = SMALL + [0.3, 0.3, 0.0]
    solids = closed_solids(np.concatenate([SMALL, apart]), np.concatenate([BOX, BOX + 8]))
    assert len(solids) == 2
    for solid in solids:
        assert_closed(solid)
        assert not solid.mended and volume(solid.vertices, solid.triangles) == pytest.approx(0.027)


@pytest.mark.parametrize("twice", [False, True])
def test_a_sheet_becomes_a_plate(twice: bool) -> None:
    sheet = np.array([[0, 1, 3], [0, 3, 2]])
    (solid,) = closed_solids(SMALL, np.concatenate([sheet, sheet[:, ::-1]]) if twice else sheet)
    assert_closed(solid)
    assert solid.mended and volume(solid.vertices, solid.triangles) == pytest.approx(0.09 * SHEET, rel=0.05)


def test_a_strip_with_one_side_is_closed() -> None:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(turn), np.zeros(24), np.sin(turn)], axis=1)
    half = 0.3 * (np.cos(turn / 2)[:, None] * ring + np.sin(turn / 2)[:, None] * [0, 1, 0])
    vertices = 0.3 * np.concatenate([ring + half, ring - half])
    i = np.arange(24)
    after = np.where(i == 23, 24, i + 1), np.where(i == 23, 0, i + 25)  # its edges have changed places
    strip = np.concatenate([np.stack([i, after[0], i + 24], axis=1), np.stack([after[0], after[1], i + 24], axis=1)])
    (solid,) = closed_solids(vertices, strip)
    assert_closed(solid)
    assert solid.mended


@pytest.mark.parametrize("seed", range(8))
def test_any_tangle_of_triangles_becomes_closed_solids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(0, 0.5, (9, 3))
    triangles = np.array([rng.choice(9, 3, replace=False) for _ in range(30)])  # edges with up to six triangles
    solids = closed_solids(vertices, triangles)
    assert len(solids) > 0
    for solid in solids:
        assert_closed(solid)
        assert volume(solid.vertices, solid.triangles) >= 0
