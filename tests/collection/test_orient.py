"""Which way is up: named axes, proper rotations, and the guess on furniture built here and (when present) real."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from shapeforge.collection.directions import turning_angle
from shapeforge.collection.orient import CHOICES, TURNS, orient, poses, upright
from shapeforge.collection.shape import Mesh
from shapeforge.collection.upright import make_surface, surface_of_mesh

DATA = Path(os.environ.get("SHAPEFORGE_DATA", Path(__file__).parents[3] / "shared" / "data"))


def boxes(*sizes_and_centres) -> Mesh:
    """A mesh of axis-aligned boxes, given as (size, centre) pairs."""
    place = trimesh.transformations.translation_matrix
    whole = trimesh.util.concatenate([trimesh.creation.box(size, place(at)) for size, at in sizes_and_centres])
    triangles = np.asarray(whole.faces, np.int64)
    return Mesh(np.asarray(whole.vertices, np.float64), triangles, np.arange(len(triangles)), len(triangles))


def chair() -> Mesh:
    legs = [((0.05, 0.45, 0.05), (x, 0.225, z)) for x in (-0.2, 0.2) for z in (-0.2, 0.2)]
    return boxes(((0.5, 0.04, 0.5), (0, 0.47, 0)), ((0.45, 0.3, 0.04), (0, 0.65, -0.2)), *legs)


def table() -> Mesh:
    legs = [((0.05, 0.7, 0.05), (x, 0.35, z)) for x in (-0.5, 0.5) for z in (-0.3, 0.3)]
    return boxes(((1.2, 0.04, 0.8), (0, 0.72, 0)), *legs)


@pytest.mark.parametrize("axis", sorted(TURNS))
def test_turns_are_proper_and_take_the_axis_up(axis):
    turn = TURNS[axis]
    assert np.allclose(turn @ turn.T, np.eye(3)) and np.linalg.det(turn) == pytest.approx(1)
    up = np.zeros(3)
    up["xyz".index(axis[1])] = 1 if axis[0] == "+" else -1
    assert np.array_equal(turn @ up, [0, 1, 0])


@pytest.mark.parametrize("up", [choice for choice in CHOICES if choice != "auto"])
def test_named_axis_is_obeyed_whatever_the_shape(up):
    rotation, note = orient(chair(), up)
    expected = np.eye(3) if up == "keep" else TURNS["+" + up]
    assert np.array_equal(rotation, expected) and note


@pytest.mark.parametrize("build", [chair, table])
@pytest.mark.parametrize("axis", ["+y", "+z"])
def test_auto_finds_y_and_z_up(build, axis):
    mesh = build()
    turned = mesh.moved(mesh.vertices @ TURNS[axis])
    rotation, note = orient(turned, "auto")
    assert np.array_equal(rotation, TURNS[axis])
    assert np.allclose(turned.vertices @ rotation.T, mesh.vertices)
    assert ("turned" in note) == (axis != "+y")


def test_auto_does_not_turn_what_has_no_area():
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros(1, np.int64), 1)
    rotation, _ = orient(mesh, "auto")
    assert np.array_equal(rotation, np.eye(3))


TILT = Rotation.from_rotvec(np.radians([8.0, 0, 6.0])).as_matrix()


@pytest.mark.parametrize("build", [chair, table])
def test_auto_takes_a_tilt_away_and_squares_the_shape(build):
    mesh = build()
    rotation, note = orient(mesh.moved(mesh.vertices @ TILT.T), "auto")
    assert turning_angle(rotation @ TILT) < 1 and "tilted by 10 degrees" in note


def test_poses_are_probabilities_of_different_directions_best_first():
    found = poses(surface_of_mesh(chair()))
    assert found[0].name == "+y" and np.exp([pose.score for pose in found]).sum() == pytest.approx(1)
    assert (np.diff([pose.score for pose in found]) <= 0).all()
    for pose in found:
        assert np.linalg.det(pose.rotation) == pytest.approx(1)
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-9)


def test_a_direction_opposite_to_up_can_be_turned_up():
    blob = np.random.default_rng(0).normal(size=(300, 3))
    rotation = upright(np.array([0.0, -1.0, 0.0]), make_surface(blob, blob / 2, blob))
    np.testing.assert_allclose(rotation @ [0, -1, 0], [0, 1, 0], atol=1e-9)


def test_unknown_up_is_an_error():
    with pytest.raises(ValueError, match="up: wanted one of auto, x, y, z, keep, got 'Z'"):
        orient(chair(), "Z")


@pytest.mark.skipif(not (DATA / "ikea").is_dir(), reason=f"development shapes not found at {DATA}")
@pytest.mark.parametrize("family", ["chairs", "tables"])
def test_auto_leaves_upright_furniture_alone_and_finds_most_when_z_is_up(family):
    found, files = 0, sorted((DATA / "ikea" / family).glob("*.obj"))
    for file in files:
        whole = trimesh.load(file, process=False, force="mesh", skip_materials=True)
        triangles = np.asarray(whole.faces, np.int64)
        mesh = Mesh(np.asarray(whole.vertices, np.float64), triangles, np.arange(len(triangles)), len(triangles))
        assert np.array_equal(orient(mesh, "auto")[0], np.eye(3)), file.stem
        found += np.array_equal(orient(mesh.moved(mesh.vertices @ TURNS["+z"]), "auto")[0], TURNS["+z"])
    assert found >= 0.75 * len(files)
