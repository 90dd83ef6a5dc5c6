"""Shapes vote on proposed parts: what a point sees tells a shelf from a top, and small mistakes are mended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from shapeforge.collection.align import Alignment
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.deformation import voting
from shapeforge.deformation.pieces import find_pieces, piece_looks, point_components
from shapeforge.deformation.voting import exposure, vote

LEG, TOP, SHELF = 0, 1, 2
SAME = Alignment(np.eye(3), np.zeros(3), 0.0)
PLANE = np.array([1.0, 0.0, 0.0]), 0.0


def table(height: float, seed: int, rails: bool = False) -> tuple[Shape, np.ndarray]:
    """A table of height 1 with a shelf at this height, or with two rails between its legs, which are legs, too; and the
    true part of every point."""
    boxes = [((0.06, 1.0, 0.06), (x, 0.5, z), LEG) for x in (-0.6, 0.6) for z in (-0.4, 0.4)]
    boxes += [((1.4, 0.04, 1.0), (0, 1.0, 0), TOP)]
    if rails:
        boxes += [((1.14, 0.06, 0.06), (0, height, z), LEG) for z in (-0.4, 0.4)]
    else:
        boxes += [((1.1, 0.04, 0.7), (0, height, 0), SHELF)]
    made = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for size, at, _ in boxes]
    corners = np.cumsum([0] + [len(box.vertices) for box in made])
    faces = np.concatenate([box.faces + start for box, start in zip(made, corners[:-1], strict=True)])
    truth = np.repeat([part for *_, part in boxes], [len(box.faces) for box in made])
    mesh = Mesh(np.concatenate([box.vertices for box in made]), faces, np.arange(len(faces)), len(faces))
    shape = prepare_shape(f"table {seed}", mesh, n_points=600, up="y", rng=np.random.default_rng(seed))
    return shape, truth[shape.face_of_point]


@pytest.fixture(scope="module")
def tables() -> list[tuple[Shape, np.ndarray]]:
    """Five with a low shelf, and one whose shelf is nearly half way to the others' tops."""
    return [table(shelf, seed) for seed, shelf in enumerate((0.2, 0.25, 0.3, 0.28, 0.22, 0.59))]


def traits_of(shape: Shape, piece: np.ndarray) -> np.ndarray:
    seen = exposure(shape)
    return np.concatenate([seen, piece_looks(shape, piece, seen)[piece, 1:2].astype(np.float32)], axis=1)


def voted(tables, parts, cut: bool = False) -> list[np.ndarray]:
    """The parts after the vote; with ``cut`` the pieces are patches."""
    shapes = [shape for shape, _ in tables]
    if cut:
        pieces = [shape.patch.astype(np.int64) for shape in shapes]
        whole = [np.zeros(piece.max() + 1, bool) for piece in pieces]
    else:
        pieces, whole = zip(*[find_pieces(shape) for shape in shapes], strict=True)
    frames = [SAME] * len(shapes)
    traits = [traits_of(shape, piece) for shape, piece in zip(shapes, pieces, strict=True)]
    components = [point_components(shape) for shape in shapes]
    return vote(shapes, (frames,), traits, *PLANE, parts, 3, pieces, whole, components)


def test_a_top_sees_the_sky_and_a_shelf_does_not(tables):
    shape, truth = tables[0]
    seen = exposure(shape)
    upper = shape.normals[:, 1] > 0.9
    middle = (np.abs(shape.points[:, [0, 2]]) < 0.05).all(axis=1)
    assert seen.min() >= 0 and seen.max() <= 1
    inside = (np.abs(shape.points[:, [0, 2]]) < 0.2).all(axis=1)
    assert np.allclose(seen[(truth == TOP) & upper & inside], [1, 0, 1])
    assert seen[(truth == SHELF) & upper & middle, :2].max() == 0
    under = (truth == SHELF) & (shape.normals[:, 1] < -0.9) & middle
    assert np.allclose(seen[under, :2], [0, 1])


def test_a_high_shelf_is_a_shelf_by_what_it_sees(tables, monkeypatch):
    truths = [truth for _, truth in tables]
    wrong = [*truths[:5], np.where(truths[5] == SHELF, TOP, truths[5])]
    shelf = truths[5] == SHELF
    assert (voted(tables, wrong)[5][shelf] == SHELF).all()
    monkeypatch.setattr(voting, "SEEN", (0.0, 0.0, 0.0))
    assert (voted(tables, wrong)[5][shelf] == TOP).mean() > 0.5  # by its place alone it stays a top


def test_a_rail_among_shelves_is_no_shelf_as_it_is_long(monkeypatch):
    some = [table(height, seed) for seed, height in enumerate((0.25, 0.3, 0.28))]
    some += [table(height, seed, rails=True) for seed, height in ((3, 0.27), (4, 0.3), (5, 0.26))]
    shape, truth = some[5]
    rail = (truth == LEG) & (np.abs(shape.points[:, 0]) < 0.25)
    parts = [*(truth for _, truth in some[:5]), np.where(rail, SHELF, truth)]
    assert (voted(some, parts)[5][rail] == LEG).mean() > 0.9
    monkeypatch.setattr(voting, "LONG", 0.0)
    assert (voted(some, parts)[5][rail] == LEG).mean() < 0.5  # by its place alone it stays a shelf


def test_a_leg_that_one_shape_calls_a_top_is_a_leg_by_the_others(tables):
    truths = [truth for _, truth in tables]
    shape, truth = tables[2]
    leg = (truth == LEG) & (shape.points[:, 0] > 0) & (shape.points[:, 2] > 0)
    wrong = [*truths[:2], np.where(leg, TOP, truth), *truths[3:]]
    assert (voted(tables, wrong)[2][leg] == LEG).mean() > 0.95


def test_which_way_sideways_a_leg_faces_makes_no_difference(tables):
    """Legs that are turned about themselves are legs as before; were they tipped over, it would be noticed."""
    truths, rng = [truth for _, truth in tables], np.random.default_rng(0)
    wrong = [np.where(rng.random(len(truth)) < 0.5, truth, rng.integers(0, 3, len(truth))) for truth in truths]

    def turned(axis: list[float]) -> np.ndarray:
        turn = trimesh.transformations.rotation_matrix(0.7, axis)[:3, :3]
        half = [(replace(shape, normals=shape.normals @ turn.T), truth) for shape, truth in tables[:3]]
        return np.concatenate(voted([*half, *tables[3:]], wrong, cut=True))

    before = np.concatenate(voted(tables, wrong, cut=True))
    assert np.array_equal(turned([0, 1, 0]), before)
    assert not np.array_equal(turned([1, 0, 0]), before)


def test_what_is_right_stays_right(tables):
    truths = [truth for _, truth in tables]
    for new, truth in zip(voted(tables, truths), truths, strict=True):
        assert (new == truth).mean() > 0.97


def test_upper_ends_of_legs_that_most_call_tops_stay_with_their_legs(tables, monkeypatch):
    """A post that is cut into patches hears what the rest of it is."""
    truths = [truth for _, truth in tables]
    wrong = [np.where((truth == LEG) & (shape.points[:, 1] > 0.1), TOP, truth) for shape, truth in tables[:3]]
    post = truths[5] == LEG
    together = (voted(tables, [*wrong, *truths[3:]], cut=True)[5][post] == LEG).mean()
    monkeypatch.setattr(voting, "TOGETHER", 0.0)
    cut = (voted(tables, [*wrong, *truths[3:]], cut=True)[5][post] == LEG).mean()
    assert together > 0.98 and cut < together - 0.05
