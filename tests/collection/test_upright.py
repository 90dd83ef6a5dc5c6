"""Directions that may be up: found whatever the axes, described by numbers that do not depend on them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shapeforge.collection.directions import (
    AXIS_ROTATIONS,
    angle_between,
    convex_hull,
    facing_frames,
    frame_angle,
    half_sphere,
    spread_rotations,
    supports,
    turning_angle,
)
from shapeforge.collection.symmetry import Reflections, mirror_planes
from shapeforge.collection.upright import (
    FEATURES,
    log_likelihoods,
    make_surface,
    surface_of_mesh,
    up_candidates,
    up_features,
)
from tests.collection.test_orient import chair, table

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


def test_the_24_rotations_are_all_there_are():
    assert len({tuple(turn.ravel()) for turn in AXIS_ROTATIONS}) == 24
    assert np.array_equal(AXIS_ROTATIONS[0], np.eye(3))
    for turn in AXIS_ROTATIONS:
        assert np.linalg.det(turn) == pytest.approx(1) and (turn @ turn.T == np.eye(3)).all()


def test_spread_rotations_are_rotations_and_leave_no_large_hole():
    turns = spread_rotations(200)
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    assert np.linalg.det(turns).min() > 0
    for wanted in Rotation.random(30, random_state=0).as_matrix():
        assert min(turning_angle(turn @ wanted.T) for turn in turns) < 50


def test_half_sphere_is_on_one_side_and_leaves_no_large_hole():
    directions = half_sphere(150)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert (directions[:, 1] > 0).all()
    wanted = np.random.default_rng(0).normal(size=(50, 3))
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.abs(wanted @ directions.T).max(axis=1))).max() < 10


def test_angles():
    turn = Rotation.from_rotvec(np.radians([0, 20, 0])).as_matrix()
    assert turning_angle(turn) == pytest.approx(20)
    assert angle_between(turn[0], np.array([1.0, 0, 0])) == pytest.approx(20)
    assert frame_angle(AXIS_ROTATIONS[7] @ turn, np.eye(3)) == pytest.approx(20)


def test_the_faces_of_a_turned_table_are_found_to_a_degree():
    surface = surface_of_mesh(table().moved(table().vertices @ TURN.T))
    frame, share = facing_frames(surface.normals)[0]
    assert frame_angle(frame, TURN.T) < 1 and share == pytest.approx(1)
    ups = [up for up, _ in supports(surface.hull)]
    assert min(angle_between(up, TURN[:, 1]) for up in ups) < 1


def test_what_has_no_volume_has_no_supports():
    flat = np.random.default_rng(0).random((50, 3)) * [1, 0, 1]
    assert convex_hull(flat) is None and convex_hull(flat[:3]) is None and supports(None) == []
    assert facing_frames(np.zeros((0, 3))) == []


def test_the_mirror_of_a_turned_chair_is_found_without_a_hint():
    surface = surface_of_mesh(chair().moved(chair().vertices @ TURN.T))
    best = mirror_planes(Reflections(surface.points), np.zeros((0, 3)))[0]
    assert abs(best.normal @ TURN[:, 0]) > np.cos(np.radians(2))
    across_depth = Reflections(surface.points).refined(TURN[:, 2], float(surface.points.mean(axis=0) @ TURN[:, 2]))
    assert best.error < across_depth.error - 0.01


def assert_alike(one: np.ndarray, other: np.ndarray) -> None:
    """Equal features, but for the search for mirror planes, which is a search: .015 radii, times 10."""
    allowed = np.where(np.array(FEATURES) == "uprightness", 0.15, 0.01)
    assert (np.abs(one - other) <= allowed).all(), dict(zip(FEATURES, (one - other)[0].round(3), strict=True))


@pytest.mark.parametrize("build", [chair, table])
def test_turning_and_scaling_change_no_feature(build):
    """Float32 and qhull's joggling aside, a direction is described by the same numbers in any axes and units."""
    mesh = build()
    there = surface_of_mesh(mesh.moved(40 * mesh.vertices @ TURN.T + [3, -2, 9]))
    here = surface_of_mesh(mesh)
    given = np.array([[0.0, 1, 0], [0, -1, 0]])
    for up, same in zip(given, given @ TURN.T, strict=True):
        one = up_features(here, up_candidates(here, up[None])[:1])
        other = up_features(there, up_candidates(there, same[None])[:1])
        assert one.shape == (1, len(FEATURES))
        assert_alike(one, other)


@pytest.mark.parametrize("build", [chair, table])
def test_the_right_direction_is_the_most_likely(build):
    mesh = build()
    surface = surface_of_mesh(mesh.moved(mesh.vertices @ TURN.T))
    ups = up_candidates(surface, np.zeros((0, 3)))
    chances = log_likelihoods(up_features(surface, ups))
    assert np.exp(chances).sum() == pytest.approx(1)
    assert angle_between(ups[int(chances.argmax())].direction, TURN[:, 1]) < 2
    for i, up in enumerate(ups):
        assert all(angle_between(up.direction, other.direction) >= 1.9 for other in ups[:i])


def test_a_mirrored_model_scores_as_the_model_does():
    mesh = chair()
    one, other = surface_of_mesh(mesh), surface_of_mesh(mesh.moved(mesh.vertices * [-1, 1, 1]))
    assert_alike(*(up_features(surface, up_candidates(surface, np.eye(3)[1:2])[:1]) for surface in (one, other)))


def test_points_all_in_one_place_are_no_surface():
    assert make_surface(np.ones((20, 3)), np.tile([0.0, 1, 0], (20, 1)), np.ones((8, 3))) is None
