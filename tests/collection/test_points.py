"""Sampling: exact in number, true to area, better than independent points, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from shapeforge.collection.points import nearest_neighbours, nearest_points, neighbour_pairs, sample_points
from shapeforge.collection.shape import Mesh
from tests.collection.solids import as_mesh, box, joined, stool


@given(st.integers(1, 400), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_exactly_as_many_as_asked_for_each_on_its_triangle(n, seed):
    mesh = stool()
    points, normals, triangle = sample_points(mesh, n, rng=np.random.default_rng(seed))
    assert points.shape == normals.shape == (n, 3) and triangle.shape == (n,)
    corners = mesh.vertices[mesh.triangles[triangle]]
    barycentric = trimesh.triangles.points_to_barycentric(corners, points)
    assert barycentric.min() > -1e-9
    np.testing.assert_allclose(trimesh.triangles.barycentric_to_points(corners, barycentric), points, atol=1e-12)
    np.testing.assert_allclose(normals, mesh.triangle_normals[triangle])


def test_every_part_of_the_surface_gets_its_share_of_points():
    # a coarse and a fine sphere of the same size, one drawn twice: shares follow area, not triangles or distinct places
    coarse, fine = trimesh.creation.icosphere(1, 1.0), trimesh.creation.icosphere(4, 1.0)
    coarse.apply_translation([5, 0, 0])
    mesh = joined(coarse, fine, fine)
    _, _, triangle = sample_points(mesh, 3000, rng=np.random.default_rng(0))
    owner = np.searchsorted([len(coarse.faces), len(coarse.faces) + len(fine.faces)], triangle, side="right")
    share = np.bincount(owner, minlength=3)
    expected = 3000 * np.array([coarse.area, fine.area, fine.area]) / mesh.triangle_areas.sum()
    np.testing.assert_allclose(share, expected, atol=2 + 16)  # a quota's width; 3 sd of independent points: 80


def test_points_are_spread_far_more_evenly_than_independent_ones():
    mesh = as_mesh(trimesh.creation.icosphere(3))
    points, _, _ = sample_points(mesh, 2000, rng=np.random.default_rng(1))
    directions = np.random.default_rng(2).normal(size=(2000, 3))
    independent = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    gap = lambda p: np.quantile(cKDTree(p).query(p, 2)[0][:, 1], 0.05)  # noqa: E731
    assert gap(points) > 3 * gap(independent)
    # counts in the eight octants vary less than a quarter of the binomial variance
    counts = np.array(
        [
            np.bincount((sample_points(mesh, 800, rng=np.random.default_rng(s))[0] > 0) @ [1, 2, 4], minlength=8)
            for s in range(12)
        ]
    )
    assert counts.var(axis=0).mean() < 0.25 * 800 * (1 / 8) * (7 / 8)
    np.testing.assert_allclose(counts.mean(axis=0), 100, atol=4)


def test_both_sides_of_a_thin_plate_get_their_share():
    mesh = as_mesh(box((1, 1e-3, 1)))
    _, normals, _ = sample_points(mesh, 1000, rng=np.random.default_rng(0))
    assert abs((normals[:, 1] > 0.5).sum() - (normals[:, 1] < -0.5).sum()) <= 10


def test_the_same_seed_gives_the_same_bytes_and_a_prefix_is_a_sample_of_the_whole():
    mesh = stool()
    first, second = (sample_points(mesh, 1000, rng=np.random.default_rng(7)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert not np.array_equal(first[0], sample_points(mesh, 1000, rng=np.random.default_rng(8))[0])
    share = (mesh.triangle_areas[:12].sum()) / mesh.triangle_areas.sum()
    assert np.mean(first[2][:200] < 12) == pytest.approx(share, abs=0.1)


def test_faces_without_area_get_no_points():
    solid = stool()
    flat = np.array([[0, 1, 1], [0, 0, 0]], np.int32)
    triangles = np.vstack([solid.triangles, flat]).astype(np.int32)
    mesh = Mesh(solid.vertices, triangles, np.arange(len(triangles), dtype=np.int32), len(triangles))
    _, normals, triangle = sample_points(mesh, 500, rng=np.random.default_rng(0))
    assert triangle.max() < len(solid.triangles)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


def test_a_needle_needs_no_room_to_speak_of():
    mesh = as_mesh(box((1e-5, 1.0, 1e-5)))
    points, _, _ = sample_points(mesh, 500, rng=np.random.default_rng(0))
    assert np.diff(np.sort(points[:, 1])).max() < 0.02


def test_what_cannot_be_sampled_says_so():
    with pytest.raises(ValueError, match="n_points: wanted at least 1, got 0"):
        sample_points(stool(), 0, rng=np.random.default_rng(0))
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.array([0]), 1)
    with pytest.raises(ValueError, match="mesh: wanted a surface with an area"):
        sample_points(flat, 5, rng=np.random.default_rng(0))


@given(st.integers(1, 60), st.integers(1, 25), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_neighbours_are_the_nearest_and_never_the_point_itself(n, k, seed):
    points = np.random.default_rng(seed).integers(0, 4, (n, 3)).astype(float)  # many coincide
    found = nearest_neighbours(points, k)
    assert found.shape == (n, min(k, n - 1))
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    for i in range(n):
        assert i not in found[i] and len(set(found[i])) == len(found[i])
        others = np.sort(np.delete(distance[i], i))
        np.testing.assert_allclose(distance[i, found[i]], others[: found.shape[1]])


def test_pairs_name_each_edge_once():
    pairs = set(zip(*(x.tolist() for x in neighbour_pairs(np.array([[1, 2], [0, 2], [0, 3], [2, 1]]))), strict=True))
    assert pairs == {(0, 1), (0, 2), (1, 2), (2, 3), (1, 3)}


@given(
    st.integers(1, 80), st.integers(1, 50), st.just(1) | st.integers(1, 45), st.floats(0, 30), st.integers(0, 2**32 - 1)
)
@settings(deadline=None)
def test_the_nearest_points_of_near_and_far_queries(n, n_queries, k, far, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, 3)) * rng.choice([0.0, 1e-3, 1.0], size=3)
    points[rng.random(n) < 0.3] = points[0]
    queries = points[rng.integers(0, n, n_queries)] + far * rng.normal(size=(n_queries, 3))
    index, distance = nearest_points(points, queries, k)
    assert index.shape == distance.shape == (n_queries, min(k, n))
    assert all(len(set(row)) == len(row) for row in index)
    np.testing.assert_allclose(distance, np.linalg.norm(points[index] - queries[:, None], axis=2))
    wanted = cKDTree(points).query(queries, k=range(1, min(k, n) + 1))[0]
    # which of two points is nearer is told in single precision
    np.testing.assert_allclose(np.sort(distance, axis=1), wanted, rtol=1e-6, atol=3e-6 * (1 + far))


def test_nearest_points_refuse_what_is_not_finite():
    with pytest.raises(FloatingPointError, match="finite"):
        nearest_points(np.zeros((3, 3)), np.array([[0.0, np.nan, 0.0]]))
