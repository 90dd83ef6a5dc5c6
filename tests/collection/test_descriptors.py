"""Descriptors: known answers on simple solids, and what must not change them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from shapeforge.collection import _kernels, descriptors, rays
from shapeforge.collection.descriptors import (
    DESCRIPTOR_NAMES,
    average_geodesic_distance,
    describe,
    local_shape,
    normalised_diameters,
    shape_diameter,
)
from shapeforge.collection.points import nearest_neighbours, sample_points
from shapeforge.collection.rays import first_hits
from tests.collection.solids import as_mesh, box, joined, random_turn, soup, stool


def sampled(mesh, n=800, seed=0):
    points, normals, triangle = sample_points(mesh, n, rng=np.random.default_rng(seed))
    return points, normals, triangle, nearest_neighbours(points, 20)


STOOL = stool()
STOOL_SAMPLES = sampled(STOOL)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_turning_and_moving_fixed_samples_changes_no_descriptor(seed):
    rng = np.random.default_rng(seed)
    turn, shift = random_turn(rng), rng.normal(size=3) * 0.3
    points, normals, triangle, _ = STOOL_SAMPLES
    before = describe(STOOL, points, normals, triangle)
    moved = STOOL.moved(STOOL.vertices @ turn.T + shift)
    after = describe(moved, points @ turn.T + shift, normals @ turn.T, triangle)
    # single-precision rays may pass an edge on the other side; all else is rounding
    difference = np.abs(before - after).max(axis=1)
    assert np.quantile(difference, 0.98) < 2e-3
    assert difference.max() < 0.05


def test_descriptors_lie_between_0_and_1_and_have_names():
    points, normals, triangle, near = STOOL_SAMPLES
    d = describe(STOOL, points, normals, triangle)
    assert d.shape == (800, 10) == (800, len(DESCRIPTOR_NAMES)) and d.dtype == np.float32
    assert d.min() >= 0 and d.max() <= 1
    np.testing.assert_array_equal(d, describe(STOOL, points, normals, triangle, near))


def test_samples_in_other_units_are_refused():
    points, normals, triangle, _ = STOOL_SAMPLES
    with pytest.raises(ValueError, match="points: wanted normal coordinates"):
        describe(STOOL.moved(STOOL.vertices * 1000), points * 1000, normals, triangle)


# ---- shape diameter


def test_diameter_is_the_thickness_of_a_plate_a_rod_and_a_ball():
    plate = as_mesh(box((0.7, 0.05, 0.7)))
    points, normals, triangle, near = sampled(plate, 600)
    diameter, outward = shape_diameter(plate, points, normals, triangle, near)
    middle = (np.abs(points[:, [0, 2]]) < 0.2).all(axis=1)
    # the mean length of the cone's rays through a plate of thickness 1
    cone, weights = descriptors._cone()
    expected = 0.05 * np.average(1 / cone[:, 2], weights=weights)
    assert np.median(diameter[middle]) == pytest.approx(expected, rel=0.1)
    np.testing.assert_array_equal(outward, normals)
    ball = as_mesh(trimesh.creation.icosphere(3, 0.1))
    points, normals, triangle, near = sampled(ball, 600)
    diameter, _ = shape_diameter(ball, points, normals, triangle, near)
    # chords of a circle: 2 r cos(angle)
    assert np.median(diameter) == pytest.approx(0.2 * np.average(cone[:, 2], weights=weights), rel=0.1)


def test_winding_changes_neither_diameter_nor_outward_normals():
    loose = soup(STOOL, np.random.default_rng(3))
    points, _, triangle, near = STOOL_SAMPLES
    expected = shape_diameter(STOOL, points, STOOL_SAMPLES[1], triangle, near)
    got = shape_diameter(loose, points, loose.triangle_normals[triangle], triangle, near)
    facing = (expected[1] * got[1]).sum(axis=1)
    assert np.mean(facing > 0.99) > 0.99
    # where a leg's top lies in the seat's underside there is no telling, and neighbours feel it by the smoothing
    assert np.isclose(got[0], expected[0], rtol=1e-4).mean() > 0.95
    away = points - [0, 0.06, 0]
    assert ((away * got[1]).sum(axis=1)[points[:, 1] > 0.13] > 0).all()


def test_a_mesh_wound_inside_out_gets_outward_normals():
    points, normals, triangle, near = STOOL_SAMPLES
    turned = STOOL.triangles[:, ::-1].copy()
    inside_out = type(STOOL)(STOOL.vertices, turned, STOOL.face_of_triangle, STOOL.n_faces)
    _, outward = shape_diameter(inside_out, points, -normals, triangle, near)
    np.testing.assert_array_equal(outward, normals)


def test_a_sheet_without_thickness_has_diameter_0_and_a_tube_of_sheet_its_width():
    sheet = as_mesh(trimesh.Trimesh([[0, 0, 0], [0.7, 0, 0], [0.7, 0, 0.7], [0, 0, 0.7]], [[0, 1, 2], [0, 2, 3]]))
    points, normals, triangle, near = sampled(sheet, 200)
    assert shape_diameter(sheet, points, normals, triangle, near)[0].max() == 0
    tube = trimesh.creation.cylinder(0.1, 0.9, sections=64)
    open_tube = as_mesh(tube.submesh([np.flatnonzero(np.abs(tube.face_normals[:, 2]) < 0.5)], append=True))
    points, normals, triangle, near = sampled(open_tube, 600)
    diameter, outward = shape_diameter(open_tube, points, -normals, triangle, near)
    middle = np.abs(points[:, 2]) < 0.2
    assert (diameter[middle] > 0.15).all() and (diameter[middle] < 0.25).all()
    assert ((outward * points)[:, :2].sum(axis=1)[middle] > 0).all()


def test_both_engines_find_the_same_hits():
    if rays.EmbreeScene is None:
        pytest.skip("embreex is not installed: there is only one engine")
    rng = np.random.default_rng(0)
    mesh = joined(trimesh.creation.icosphere(3, 0.3), box((0.1, 0.9, 0.1)), trimesh.creation.torus(0.4, 0.05))
    origins = rng.uniform(-0.4, 0.4, (4000, 3))
    directions = rng.normal(size=(4000, 3))
    directions[:300] = np.eye(3)[rng.integers(0, 3, 300)]  # along the axes, where slabs divide by 0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    embree = first_hits(mesh, origins, directions, embree=True)
    own = first_hits(mesh, origins, directions, embree=False)
    assert 0.2 < np.isfinite(own).mean() < 0.95
    # a ray through an edge may be counted by one engine and not by the other
    agree = np.isclose(embree, own, atol=1e-5) | (np.isinf(embree) & np.isinf(own))
    assert agree.mean() > 0.998
    points, normals, triangle, near = STOOL_SAMPLES
    one, other = (shape_diameter(STOOL, points, normals, triangle, near, embree=e)[0] for e in (True, False))
    np.testing.assert_allclose(one, other, atol=1e-3)
    assert np.quantile(np.abs(one - other), 0.99) < 1e-6


def test_own_engine_against_every_triangle_in_turn():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(60, 3, 3))
    mesh = soup(as_mesh(trimesh.Trimesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3), process=False)), rng)
    origins, directions = rng.normal(size=(300, 3)), rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    corners = mesh.vertices[mesh.triangles].astype(np.float32).astype(np.float64)
    expected = np.full(300, np.inf)
    for i in range(300):
        for a, b, c in corners:
            u, v, t = np.linalg.solve(np.stack([b - a, c - a, -directions[i]], axis=1), origins[i] - a)
            if u >= 0 and v >= 0 and u + v <= 1 and t > 0:
                expected[i] = min(expected[i], t)
    np.testing.assert_allclose(first_hits(mesh, origins, directions, embree=False), expected, rtol=1e-4)


def test_normalisation_is_logarithmic_and_ignores_single_outliers():
    diameter = np.linspace(0.1, 0.3, 1001)
    diameter[0] = 50.0
    normal = normalised_diameters(diameter)
    s = np.clip((0.2 - np.quantile(diameter, 0.01)) / (np.quantile(diameter, 0.99) - np.quantile(diameter, 0.01)), 0, 1)
    for column, alpha in enumerate((1, 2, 4)):
        assert normal[500, column] == pytest.approx(np.log(alpha * s + 1) / np.log(alpha + 1))
    assert normal.min() == 0 and normal.max() == 1
    assert np.isfinite(normalised_diameters(np.full(10, 0.2))).all()
    assert (normalised_diameters(np.zeros(10)) == 0).all()


# ---- geodesics


def test_average_geodesic_distance_against_scipy():
    points, _, _, near = STOOL_SAMPLES
    got = average_geodesic_distance(points, near, n_sources=len(points))
    k = descriptors.GEODESIC_NEIGHBOURS
    tails, heads = np.repeat(np.arange(len(points)), k), near[:, :k].reshape(-1)
    graph = coo_matrix((np.linalg.norm(points[tails] - points[heads], axis=1), (tails, heads)), (800, 800)).tocsr()
    mean = dijkstra(graph.maximum(graph.T), directed=False).mean(axis=1)
    np.testing.assert_allclose(got, (mean - mean.min()) / mean.max(), atol=2e-6)
    few = average_geodesic_distance(points, near)
    assert np.abs(few - got).max() < 0.02


def test_ends_are_far_and_the_middle_is_near():
    rod = as_mesh(box((0.02, 0.99, 0.02)).subdivide_to_size(0.05))
    points, _, _, near = sampled(rod, 600)
    value = average_geodesic_distance(points, near)
    # of a segment: mean distance 1/4 at the middle, 1/2 at an end, so 0 and 1/2
    height = np.abs(points[:, 1]) / 0.495
    np.testing.assert_allclose(value, height**2 / 2, atol=0.03)


@given(st.integers(2, 40), st.integers(1, 3), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=50)
def test_pieces_are_joined_by_the_shortest_gaps(n, k, seed):
    points = np.random.default_rng(seed).normal(size=(n, 3))
    near = nearest_neighbours(points, k)
    tails, heads = np.repeat(np.arange(n), near.shape[1]), near.reshape(-1).astype(np.int64)
    gaps = _kernels.bridges(points, tails, heads)
    # the minimum spanning tree of everything, with the graph's own edges for nothing
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    distance[tails, heads] = 1e-6
    distance = np.minimum(distance, distance.T)
    tree = minimum_spanning_tree(distance).tocoo()
    expected = np.sort(tree.data[tree.data > 1e-5])
    np.testing.assert_allclose(np.sort(np.linalg.norm(points[gaps[:, 0]] - points[gaps[:, 1]], axis=1)), expected)


def test_pieces_that_do_not_touch_have_finite_distances():
    posts = [box((0.1, 0.5, 0.1), (x, 0, 0)) for x in (-0.3, 0.3)]
    apart = joined(*posts, box((0.1, 0.1, 0.1), (0, 0.4, 0)))
    points, _, _, near = sampled(apart, 600)
    value = average_geodesic_distance(points, near)
    assert np.isfinite(value).all() and 0.2 < value.max() < 1


# ---- local PCA


def test_rod_plate_and_ball_are_told_apart():
    rod, plate = as_mesh(box((0.01, 0.99, 0.01))), as_mesh(box((0.7, 0.01, 0.7)))
    ball = as_mesh(trimesh.creation.icosphere(3, 0.06))
    width_rod, thick_rod = local_shape(sampled(rod, 600)[0])[:, :2].T
    points = sampled(plate, 2500)[0]
    inner = (np.abs(points[:, [0, 2]]) < 0.25).all(axis=1)
    width_plate, thick_plate = local_shape(points)[inner, :2].T
    width_ball, thick_ball = local_shape(sampled(ball, 600)[0])[:, 4:6].T
    assert np.median(width_rod) < 0.3 and np.median(thick_rod) < 0.3
    assert np.median(width_plate) > 0.85 and np.median(thick_plate) < 0.3
    assert np.median(width_ball) > 0.9 and np.median(thick_ball) > 0.7


def test_covariances_against_plain_sums():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(60, 3)) * 0.1
    others = points[::2]
    got = _kernels.local_covariances(points, others, 0.1)
    for i in range(60):
        offset = others - points[i]
        w = np.maximum(1 - (offset**2).sum(axis=1) / 0.01, 0)
        if w.sum() < 1e-3:
            continue
        mean = w @ offset / w.sum()
        expected = (w[:, None] * offset).T @ offset / w.sum() - np.outer(mean, mean)
        np.testing.assert_allclose(got[i], expected[np.triu_indices(3)], atol=1e-9)
