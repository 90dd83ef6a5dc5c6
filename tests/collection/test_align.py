"""Affine alignment: recovers known maps, keeps its bounds, prefers the better start; dissimilarity orders shapes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from shapeforge.collection import align
from shapeforge.collection._kernels_align import (
    determinant,
    median_of,
    nearest_both_ways,
    solved,
    within_bounds,
)
from shapeforge.collection.align import Alignment, affine_align, dissimilarity, thinned


def box_points(rng: np.random.Generator, size, centre, count: int) -> np.ndarray:
    """Points on the surface of an axis-aligned box."""
    points = rng.uniform(-0.5, 0.5, (count, 3))
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = np.where(rng.random(count) < 0.5, -0.5, 0.5)
    return points * np.asarray(size) + np.asarray(centre)


def chair(rng: np.random.Generator, *, legs: float = 0.4, back: float = 0.45, width: float = 0.45) -> np.ndarray:
    """A four-legged chair of boxes, roughly of diagonal 1."""
    parts = [box_points(rng, (width, 0.05, 0.45), (0, 0, 0), 700)]
    parts.append(box_points(rng, (width, back, 0.04), (0, back / 2, -0.2), 600))
    for x in (-1, 1):
        for z in (-1, 1):
            parts.append(box_points(rng, (0.05, legs, 0.05), (x * width * 0.45, -legs / 2, z * 0.2), 150))
    return np.concatenate(parts)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_nearest_both_ways_equals_a_tree(rng):
    a, b = rng.random((83, 3)).astype(np.float32), rng.random((57, 3)).astype(np.float32)
    ia, da = np.empty(83, np.int32), np.empty(83, np.float32)
    ib, db = np.empty(57, np.int32), np.empty(57, np.float32)
    nearest_both_ways(np.ascontiguousarray(a.T), np.ascontiguousarray(b.T), ia, da, ib, db)
    distance, index = cKDTree(b).query(a)
    assert np.array_equal(ia, index) and np.allclose(np.sqrt(da), distance, atol=1e-6)
    distance, index = cKDTree(a).query(b)
    assert np.array_equal(ib, index) and np.allclose(np.sqrt(db), distance, atol=1e-6)


def test_recovers_an_anisotropic_stretch_of_the_same_shape(rng):
    source = chair(rng)
    matrix, offset = np.diag([1.5, 0.8, 1.1]), np.array([0.05, -0.1, 0.02])
    found = affine_align(source, chair(rng) @ matrix.T + offset)
    assert np.abs(found.matrix - matrix).max() < 0.06
    assert np.linalg.norm(found(source) - (source @ matrix.T + offset), axis=1).mean() < 0.02
    # Two samplings of one surface with 600 points lie this far apart and no nearer.
    assert found.residual < 0.03


def test_never_mirrors_and_keeps_its_bounds(rng):
    source = chair(rng)
    flat = rng.random((300, 3)) * [1, 1e-4, 1]
    for target in (source * [-1, 1, 1], source @ np.diag([5.0, 1, 1]), flat, source[:, ::-1]):
        found = affine_align(source, np.ascontiguousarray(target))
        assert np.linalg.det(found.matrix) > 0
        stretch = np.linalg.svd(found.matrix)[1]
        assert stretch.min() > 0.2 and stretch.max() < 4.5
        assert np.isfinite(found.residual)


def test_best_start_wins_and_is_named(rng):
    source, target = chair(rng), chair(rng, legs=0.8, back=0.2, width=0.9)
    alone = {name: affine_align(source, target, starts=(name,)).residual for name in ("box", "identity", "spread")}
    best = affine_align(source, target)
    assert best.residual == min(alone.values()) and alone[best.start] == best.residual


def test_same_bytes_again(rng):
    source, target = chair(rng), chair(rng, legs=0.6)
    one, two = affine_align(source, target), affine_align(source, target)
    assert isinstance(one, Alignment) and one.matrix.tobytes() == two.matrix.tobytes()


def test_dissimilarity_is_symmetric_and_orders_shapes(rng):
    a, similar = chair(rng), chair(rng, legs=0.44, back=0.42)
    table = box_points(rng, (0.8, 0.4, 0.5), (0, 0, 0), 1500)
    assert dissimilarity(a, similar) == pytest.approx(dissimilarity(similar, a), rel=1e-12)
    assert dissimilarity(a, a) == pytest.approx(0, abs=1e-6)
    assert dissimilarity(a, similar) < 0.6 * dissimilarity(a, table)


def test_stretching_counts_but_less_than_shape(rng):
    a = chair(rng)
    stretched, other = a * [1.4, 1, 1], box_points(rng, (0.5, 0.8, 0.5), (0, 0, 0), 1500)
    assert 0.003 < dissimilarity(a, stretched) < dissimilarity(a, other)


def test_thinned_keeps_order_and_ends(rng):
    points = rng.random((1001, 3))
    few = thinned(points, 11)
    assert np.array_equal(few, points[::100])
    assert thinned(points, 2000) is points


@pytest.mark.parametrize("count", [1, 2, 7, 600, 601])
def test_the_quick_median_is_numpys_to_the_bit(rng, count: int):
    values = rng.random(count).astype(np.float32)
    ours, theirs = np.float32(median_of(values, np.empty(700, np.float32))), np.median(values)
    assert ours == theirs and ours.dtype == theirs.dtype


def test_three_by_three_equals_numpy(rng):
    out = np.empty((3, 3))
    for _ in range(20):
        root, cross, start = rng.normal(size=(3, 3, 3))
        second, pull = root @ root.T, rng.random() + 0.1
        solved(second, cross, start, pull, out)
        np.testing.assert_allclose(out @ (second + pull * np.eye(3)), cross + pull * start, atol=1e-9)
        assert determinant(root) == pytest.approx(np.linalg.det(root), abs=1e-12)


def test_bounds_are_those_of_the_stretches_and_the_shear(rng):
    answers = []
    for _ in range(300):
        matrix, start = np.eye(3) + rng.normal(size=(2, 3, 3)) * [[[0.25]], [[0.05]]]
        back = np.linalg.inv(start)
        stretch = np.linalg.svd(matrix)[1]
        shear = np.abs((matrix @ back)[~np.eye(3, dtype=bool)]).max()
        wanted = np.linalg.det(matrix) > 0 and stretch[2] > 0.5 and stretch[0] < 1.8 and shear < 0.5
        assert within_bounds(matrix, back, 0.5, 1.8, 0.5) == wanted
        answers.append(wanted)
    assert 0.1 < np.mean(answers) < 0.9
    assert not within_bounds(np.full((3, 3), np.nan), np.eye(3), 0.5, 1.8, 0.5)


def test_a_map_that_would_leave_its_bounds_is_kept_within(rng):
    source = box_points(rng, (1, 1, 1), (0, 0, 0), 500)
    for wanted in (np.diag([6.0, 1.0, 1.0]), np.diag([0.1, 1.0, 1.0])):
        found = affine_align(source, source @ wanted.T, starts=("identity",))
        stretch = np.linalg.svd(found.matrix)[1]
        assert align.SMALLEST_STRETCH - 1e-9 <= stretch[2] and stretch[0] <= align.LARGEST_STRETCH + 1e-9


def test_errors_name_the_argument(rng):
    good = chair(rng)
    with pytest.raises(ValueError, match="source: wanted at least 4"):
        affine_align(good[:3], good)
    with pytest.raises(ValueError, match="target: wanted finite"):
        affine_align(good, np.full((10, 3), np.nan))
    with pytest.raises(ValueError, match="starts: .*bx"):
        affine_align(good, good, starts=("bx",))
