"""Preparing a shape: normal coordinates and the way back, the same bytes for the same seed, and its cost."""

from __future__ import annotations

import time
from dataclasses import fields

import numpy as np
import pytest

from shapeforge import collection
from shapeforge.collection.iterate import last
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.prepare import normal_frame, prepare_shape
from shapeforge.collection.shape import Mesh, Shape
from tests.collection.solids import random_turn, soup, stool


def prepared(mesh: Mesh, seed: int = 0, n_points: int = 600, up: str = "y") -> Shape:
    return prepare_shape("stool", mesh, n_points=n_points, up=up, rng=np.random.default_rng(seed))


def test_a_shape_is_centred_with_diagonal_1_and_the_frame_leads_back():
    mesh = stool()
    there = mesh.moved(mesh.vertices * 1234.5 + [1e4, -3e3, 7])
    shape = prepared(there)
    low, high = shape.mesh.vertices.min(axis=0), shape.mesh.vertices.max(axis=0)
    np.testing.assert_allclose(low + high, 0, atol=1e-12)
    assert np.linalg.norm(high - low) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(shape.frame.to_input(shape.mesh.vertices), there.vertices, rtol=1e-12)
    corners = there.vertices[there.triangles[shape.triangle_of_point]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    on_plane = ((shape.frame.to_input(shape.points) - corners[:, 0]) * normal).sum(axis=1)
    np.testing.assert_allclose(on_plane / np.linalg.norm(normal, axis=1), 0, atol=1e-8)


def test_every_array_has_its_promised_shape():
    shape = prepared(stool())
    assert shape.n_points == 600 == len(shape.patch) == len(shape.normals)
    assert shape.descriptors.shape == (600, 10) and shape.neighbours.shape == (600, 20)
    np.testing.assert_array_equal(shape.face_of_point, shape.mesh.face_of_triangle[shape.triangle_of_point])
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1)
    inside = shape.neighbours >= 0
    same = shape.patch[shape.neighbours] == shape.patch[:, None]
    assert same[inside].all()
    assert all(np.isfinite(getattr(shape, f.name)).all() for f in fields(shape) if f.name in ("points", "descriptors"))


def test_the_same_seed_gives_the_same_bytes():
    first, second, third = prepared(stool(), 3), prepared(stool(), 3), prepared(stool(), 4)
    for name in ("points", "normals", "triangle_of_point", "descriptors", "patch", "neighbours"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.points.tobytes() != third.points.tobytes()


def test_z_up_is_turned_when_told():
    mesh = stool()
    lying = mesh.moved(mesh.vertices @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))  # y goes to z
    upright, turned = prepared(mesh), prepared(lying, up="z")
    extent = np.ptp(upright.mesh.vertices, axis=0)
    np.testing.assert_allclose(np.ptp(turned.mesh.vertices, axis=0), extent, atol=1e-12)
    assert "z" in turned.notes[0]
    # the seat, where most of the surface is, is above the middle again
    assert turned.points[:, 1].mean() == pytest.approx(upright.points[:, 1].mean(), abs=0.02)


def test_the_frame_of_any_rotation_centres_and_leads_back():
    mesh = stool()
    turn = random_turn(np.random.default_rng(0))
    frame = normal_frame(mesh, turn)
    here = frame.to_normal(mesh.vertices)
    np.testing.assert_allclose(here.min(axis=0) + here.max(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(frame.to_input(here), mesh.vertices, atol=1e-12)


def test_vertices_of_no_face_do_not_count():
    mesh = stool()
    stray = Mesh(np.vstack([mesh.vertices, [[99.0, 0, 0]]]), mesh.triangles, mesh.face_of_triangle, mesh.n_faces)
    np.testing.assert_allclose(prepared(stray).frame.scale, prepared(mesh).frame.scale)


def test_what_is_odd_is_noted():
    mesh = soup(stool(), np.random.default_rng(0))
    mesh.triangles[0] = mesh.triangles[1]
    mesh.triangles[2] = mesh.triangles[2][0]
    notes = prepared(mesh).notes
    assert any("drawn twice" in note for note in notes) and any("without area" in note for note in notes)


def test_an_unknown_up_is_refused():
    with pytest.raises(ValueError, match="up"):
        prepared(stool(), up="sideways")


def test_last_is_the_last_state():
    assert last(iter([1, 2, 3])) == 3
    with pytest.raises(ValueError, match="wanted at least one"):
        last(iter(()))


def test_real_shapes_are_prepared_in_time(real_shapes):
    folders = ("ikea/chairs", "sweethome3d/lamps", "aircraft/flightgear_ai", "aircraft/crrcsim")
    files = [file for folder in folders for file in sorted((real_shapes / folder).glob("*.obj"))[3::50]]
    seconds = []
    for file in files:
        mesh = read_mesh(file)
        start = time.process_time()
        shape = prepare_shape(file.stem, mesh, rng=np.random.default_rng(0))
        seconds.append(time.process_time() - start)
        assert shape.n_points == 5000 and np.isfinite(shape.descriptors).all()
    # about .4 s; the first of a fresh installation compiles, and a busy machine may take twice as long
    assert np.median(seconds) < 1.2


def test_every_public_name_of_the_room_is_there_and_no_other():
    for name in collection.__all__:
        assert getattr(collection, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        collection.nothing  # noqa: B018
