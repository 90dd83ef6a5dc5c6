"""Convex pieces: patches that see each other from within merge, and so do the two sides of a wall."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.deformation import convex_pieces
from shapeforge.deformation.convex_pieces import across, see_each_other
from shapeforge.deformation.pieces import face_components, find_pieces

# outlines from the axis at the bottom to the axis at the top: distance from the axis, height
GOBLET = [(0, 0), (0.5, 0), (0.5, 0.06), (0.07, 0.1), (0.07, 0.6), (0.3, 0.66), (0.5, 0.9), (0.5, 1.3), (0.45, 1.3)]
GOBLET += [(0.45, 0.92), (0.27, 0.71), (0, 0.7)]
BARBELL = [(0, 0), (0.4, 0), (0.4, 0.3), (0.1, 0.3), (0.1, 1.1), (0.4, 1.1), (0.4, 1.4), (0, 1.4)]


def shape_of(mesh: trimesh.Trimesh, n_points: int = 1500, seed: int = 0) -> Shape:
    faces = np.asarray(mesh.faces).astype(np.int64)
    found = Mesh(np.asarray(mesh.vertices, np.float64), faces, np.arange(len(faces)), len(faces))
    return prepare_shape("thing", found, n_points=n_points, up="y", rng=np.random.default_rng(seed))


def turned(outline: list[tuple[float, float]]) -> Shape:
    """A body of revolution about the vertical: one component."""
    made = trimesh.creation.revolve(np.array(outline), sections=48)
    made.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    shape = shape_of(made)
    assert len(np.unique(face_components(shape.mesh))) == 1
    return shape


def places(shape: Shape, outline: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the axis and height of the points, in the outline's units."""
    low, high = shape.points.min(axis=0), shape.points.max(axis=0)
    scale = (high[1] - low[1]) / (max(height for _, height in outline) - min(height for _, height in outline))
    middle = (low + high) / 2
    return np.linalg.norm(shape.points[:, [0, 2]] - middle[[0, 2]], axis=1) / scale, (
        shape.points[:, 1] - low[1]
    ) / scale


def purest(piece: np.ndarray) -> float:
    """Share of the points whose piece is the commonest."""
    return float(np.bincount(piece).max() / len(piece))


def test_a_barbell_is_two_weights_and_a_bar():
    shape = turned(BARBELL)
    piece, _ = find_pieces(shape)
    away, height = places(shape, BARBELL)
    lower, upper, bar = height < 0.28, height > 1.12, (height > 0.35) & (height < 1.05)
    assert min(purest(piece[part]) for part in (lower, upper, bar)) > 0.95
    names = [np.bincount(piece[part]).argmax() for part in (lower, upper, bar)]
    assert len(set(names)) == 3
    assert len(np.unique(piece)) < len(np.unique(shape.patch))


def test_the_inside_of_a_cup_belongs_to_its_outside(monkeypatch):
    shape = turned(GOBLET)
    away, height = places(shape, GOBLET)
    wall = (height > 0.95) & (height < 1.2)  # the rim may be a patch of its own
    inside, outside = wall & (away < 0.475), wall & (away > 0.475)
    piece, _ = find_pieces(shape)
    cup, stem = np.bincount(piece[outside]).argmax(), (height > 0.2) & (height < 0.5)
    assert min((piece[side] == cup).mean() for side in (outside, inside)) > 0.6
    assert (piece[stem] == cup).mean() < 0.05
    monkeypatch.setattr(convex_pieces, "ONE_WALL", 2.0)
    piece, _ = find_pieces(shape)
    assert (piece[inside] == np.bincount(piece[outside]).argmax()).mean() < 0.4


def test_pieces_of_a_post_are_no_taller_than_allowed():
    post = trimesh.creation.box((0.2, 1.4, 0.2))
    shape = shape_of(post)
    patch = np.minimum((4 * (shape.points[:, 1] - shape.points[:, 1].min()) / np.ptp(shape.points[:, 1])), 3).astype(
        int
    )
    rows, height = np.arange(shape.n_points), float(np.ptp(shape.points[:, 1]))
    opposite = across(shape)
    assert convex_pieces.merged_patches(shape, rows, patch, opposite, 2 * height).max() == 0
    halves = convex_pieces.merged_patches(shape, rows, patch, opposite, 0.6 * height)
    spans = [np.ptp(shape.points[halves == one, 1]) for one in np.unique(halves)]
    assert len(spans) == 2 and max(spans) < 0.6 * height


def test_what_does_not_touch_stays_apart_however_well_it_sees_each_other():
    """Two wings without the body between them."""
    left, right = (trimesh.creation.box((1, 0.02, 0.5), np.eye(4) + np.eye(4, k=3) * x) for x in (-0.8, 0.8))
    shape = shape_of(trimesh.util.concatenate([left, right]))
    patch = (shape.points[:, 0] > np.median(shape.points[:, 0])).astype(int)
    assert see_each_other(shape.points, shape.normals).mean() > 0.9
    piece = convex_pieces.merged_patches(shape, np.arange(shape.n_points), patch, across(shape), 1.0)
    assert np.array_equal(piece, patch)


@pytest.mark.parametrize("thick", [0.05, 0.5])
def test_across_a_board_lies_its_other_side_and_across_a_block_nothing(thick):
    shape = shape_of(trimesh.creation.box((1.4, thick, 1.0)))
    other = across(shape)
    flat = np.abs(shape.normals[:, 1]) > 0.9
    if thick > 0.1:
        assert (other[flat] == -1).all()
        return
    away = np.abs(shape.points[flat][:, [0, 2]]).max(axis=1)
    assert (other[flat] >= 0).mean() > 0.98
    told = flat & (other >= 0)
    assert (shape.normals[other[told], 1] * shape.normals[told, 1] < 0).all()
    apart = np.linalg.norm(shape.points[other[told]][:, [0, 2]] - shape.points[told][:, [0, 2]], axis=1)
    assert np.median(apart) < 0.05 < away.max()


def test_points_of_a_ball_see_each_other_and_those_of_two_do_not():
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(200, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert see_each_other(ball, ball).all()
    two = np.concatenate([ball, ball + [3, 0, 0]])
    seen = see_each_other(two, np.concatenate([ball, ball]))
    assert seen[:200, :200].all() and seen[:200, 200:].mean() < 0.5
    assert np.array_equal(seen, seen.T)
