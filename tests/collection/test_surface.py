"""Closest points on a mesh against the brute-force oracle."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import SearchedMesh, closest_points
from tests.oracles import distance_to_triangle


def soup(seed: int, count: int) -> Mesh:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + 0.3 * rng.normal(size=(count, 3, 3))
    triangles = np.arange(3 * count).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), triangles, np.arange(count), count)


@pytest.mark.parametrize("count", [1, 7, 60])
def test_closest_points_equal_brute_force(count):
    mesh = soup(count, count)
    queries = np.random.default_rng(1).normal(size=(12, 3))
    positions, triangle, distance = closest_points(mesh, queries)
    for i, query in enumerate(queries):
        brute = min(distance_to_triangle(query, *mesh.vertices[row]) for row in mesh.triangles)
        assert distance[i] <= brute + 1e-12 and distance[i] > brute - 0.03
        np.testing.assert_allclose(np.linalg.norm(positions[i] - query), distance[i], atol=1e-12)
        a, b, c = mesh.vertices[mesh.triangles[triangle[i]]]
        weights = np.linalg.lstsq(np.stack([a, b, c]).T, positions[i], rcond=None)[0]
        assert weights.min() > -1e-6


def test_points_of_the_surface_are_their_own_closest_points():
    mesh = soup(3, 500)
    inside = mesh.vertices[mesh.triangles].mean(axis=1)
    positions, _, distance = closest_points(mesh, inside)
    np.testing.assert_allclose(positions, inside, atol=1e-9)
    assert distance.max() < 1e-9


def test_degenerate_triangles_do_no_harm():
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 0, 0], [0, 1, 1], [0, 1, 2]]),
                np.arange(3), 3)  # fmt: skip
    positions, _, distance = closest_points(mesh, np.array([[0.2, 0.2, 0.7]]))
    np.testing.assert_allclose(positions, [[0.2, 0.2, 0.0]], atol=1e-12)
    np.testing.assert_allclose(distance, 0.7)


def test_absent_queries_are_refused():
    with pytest.raises(ValueError, match="finite"):
        closest_points(soup(0, 3), np.array([[np.nan, 0, 0]]))


def test_a_searched_mesh_that_was_moved_answers_as_a_new_one():
    """It takes over the order of the boxes, not their places: a mesh crumpled beyond recognition shows it."""
    rng = np.random.default_rng(3)
    vertices, triangles = rng.normal(size=(60, 3)), rng.integers(0, 60, (200, 3))
    rest = SearchedMesh(vertices, triangles, np.arange(200), 200)
    queries = rng.normal(size=(80, 3))
    along = np.roll(queries, 1, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert len(closest_points(rest, queries)[2]) == 80
    for _ in range(2):
        rest = rest.moved(rng.permutation(vertices) * [3.0, 0.2, -1.0])
        anew = Mesh(rest.vertices, triangles, np.arange(200), 200)
        for found, expected in zip(closest_points(rest, queries)[::2], closest_points(anew, queries)[::2], strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)
        hits = first_hits(rest, queries, along)
        assert 0.1 < np.isfinite(hits).mean() < 0.9
        np.testing.assert_array_equal(hits, first_hits(anew, queries, along, embree=False))


def test_rays_meet_nothing_where_nothing_has_an_area():
    flat = np.array([[0.0, 0, 0], [0.3, 0.3, 0.3], [0.7, 0.7, 0.7]])
    down = np.array([[0.0, 0.0, -1.0]])
    for mesh in (
        Mesh(flat, np.array([[0, 1, 2]]), np.arange(1), 1),
        Mesh(flat, np.zeros((0, 3), int), np.arange(0), 0),
    ):
        assert np.isinf(first_hits(mesh, np.array([[0.4, 0.4, 1.0]]), down, embree=False)).all()
