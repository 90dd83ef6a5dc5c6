"""Patches: parts of a simple solid end up apart, and neighbourhoods stay inside a patch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shapeforge.collection import _kernels
from shapeforge.collection.descriptors import descriptors_from_diameter, shape_diameter
from shapeforge.collection.labels import read_seg
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.patches import find_patches, patch_neighbours
from shapeforge.collection.points import nearest_neighbours, sample_points
from shapeforge.collection.prepare import prepare_shape
from tests.collection.solids import random_turn, stool


def purity(patch: np.ndarray, label: np.ndarray) -> float:
    """Share of labelled points whose label is the most frequent one of their patch."""
    table = np.zeros((patch.max() + 1, label.max() + 1))
    np.add.at(table, (patch[label >= 0], label[label >= 0]), 1)
    return float(table.max(axis=1).sum() / (label >= 0).sum())


def test_seat_and_legs_of_a_stool_are_apart():
    mesh = stool()
    points, normals, triangle = sample_points(mesh, 2000, rng=np.random.default_rng(0))
    near = nearest_neighbours(points, 20)
    diameter, outward = shape_diameter(mesh, points, normals, triangle, near)
    descriptors = descriptors_from_diameter(points, diameter, near)
    patch = find_patches(points, outward, descriptors, near)
    assert patch.dtype == np.int32 and set(patch) == set(range(patch.max() + 1))
    assert 4 <= patch.max() + 1 <= 30
    assert purity(patch, triangle // 12) > 0.95
    np.testing.assert_array_equal(patch, find_patches(points, outward, descriptors))
    turn = random_turn(np.random.default_rng(1))
    turned = find_patches(points @ turn.T, outward @ turn.T, descriptors, near)
    assert purity(turned, patch) > 0.99


def test_regions_follow_the_definition():
    # two tight triangles 0-1-2 and 3-4-5 and a far pair 6-7; a heavy bridge 2-3, a light stray 5-6
    tails = np.array([0, 1, 0, 3, 4, 3, 2, 5, 6])
    heads = np.array([1, 2, 2, 4, 5, 5, 3, 6, 7])
    weights = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 5.0, 2.0, 0.1])
    order = np.argsort(weights, kind="stable")
    apart = _kernels.merge_regions(8, tails, heads, weights, order, 1.0, 1)
    assert apart.tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    # the pair is too small: it joins over its lightest edge
    assert _kernels.merge_regions(8, tails, heads, weights, order, 1.0, 3).tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    assert set(_kernels.merge_regions(8, tails, heads, weights, order, 100.0, 1)) == {0}


@given(st.integers(1, 60), st.integers(1, 6), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_neighbours_are_the_nearest_of_the_own_patch(n, patches, seed):
    rng = np.random.default_rng(seed)
    points, patch = rng.normal(size=(n, 3)), rng.integers(0, patches, n).astype(np.int32)
    found = patch_neighbours(points, patch, 5)
    assert found.shape == (n, 5) and found.dtype == np.int32
    for i in range(n):
        mates = np.flatnonzero((patch == patch[i]) & (np.arange(n) != i))
        nearest = mates[np.argsort(np.linalg.norm(points[mates] - points[i], axis=1))][:5]
        assert found[i].tolist() == nearest.tolist() + [-1] * (5 - len(nearest))


@pytest.mark.parametrize("n", [1, 2, 5])
def test_few_points_are_no_trouble(n):
    points = np.random.default_rng(0).normal(size=(n, 3))
    patch = find_patches(points, np.ones((n, 3)) / np.sqrt(3), np.zeros((n, 10), np.float32))
    assert patch.shape == (n,)
    assert patch_neighbours(points, patch).shape == (n, 20)


def test_patches_of_real_chairs_respect_their_parts(real_shapes):
    purities, counts = [], []
    for file in sorted((real_shapes / "ikea" / "chairs").glob("*.obj"))[::10]:
        mesh = read_mesh(file)
        shape = prepare_shape(file.stem, mesh, up="y", rng=np.random.default_rng(0))
        label = read_seg(file.with_suffix(".seg"), mesh.n_faces)[shape.face_of_point]
        purities.append(purity(shape.patch, label))
        counts.append(int(shape.patch.max()) + 1)
    assert np.mean(purities) > 0.85 and min(purities) > 0.7
    assert 8 <= np.median(counts) <= 32
