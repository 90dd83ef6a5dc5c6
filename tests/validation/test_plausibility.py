"""Chamfer equals loops; clumps, shifts and copies are told from fair samples."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.shape import Mesh
from shapeforge.validation.plausibility import (
    chamfer,
    chamfer_table,
    contact_distance,
    novelty,
    open_share,
    plausibility,
    thin_cloud,
)


def boxes(rng: np.random.Generator, n: int, sizes: np.ndarray | None = None) -> list[np.ndarray]:
    """Clouds filling boxes of random extents."""
    sizes = rng.uniform(0.3, 1, (n, 3)) if sizes is None else sizes
    lattice = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 5)] * 3), axis=-1).reshape(-1, 3)
    return [lattice * size + rng.normal(0, 0.005, lattice.shape) for size in sizes]


def test_chamfer_equals_loops() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(20, 3)), rng.normal(size=(30, 3))
    there = np.mean([min(np.linalg.norm(p - q) for q in b) for p in a])
    back = np.mean([min(np.linalg.norm(p - q) for q in a) for p in b])
    assert chamfer(a, b) == pytest.approx(0.5 * (there + back), abs=1e-12)
    table = chamfer_table([a, b, a + 1])
    np.testing.assert_allclose(table, table.T)
    assert table[0, 1] == pytest.approx(chamfer(a, b))
    np.testing.assert_allclose(chamfer_table([a, a + 1], [b]), [[table[0, 1]], [chamfer(a + 1, b)]])


def test_fair_samples_score_well_and_clumps_and_shifts_badly() -> None:
    rng = np.random.default_rng(1)
    real, fair = boxes(rng, 40), boxes(rng, 40)
    good = plausibility(real, fair)
    clump = plausibility(real, boxes(rng, 40, np.full((40, 3), 0.65)))
    shift = plausibility(real, [cloud * 1.6 for cloud in fair])
    assert 0.35 <= good.one_nn <= 0.65 and good.coverage > 0.45
    assert clump.coverage < 0.2 and clump.one_nn > 0.75
    assert shift.one_nn > 0.8 and shift.mmd > 1.5 * good.mmd
    copies = plausibility(real, real)
    assert copies.mmd == 0 and copies.coverage == 1 and copies.one_nn < 0.2
    with pytest.raises(ValueError, match="at least 2"):
        plausibility(real[:1], fair)


def test_thinned_clouds_are_finite_and_sized() -> None:
    rng = np.random.default_rng(2)
    cloud = rng.normal(size=(50, 3))
    cloud[:10] = np.nan
    assert thin_cloud(cloud, 25, rng=rng).shape == (25, 3)
    assert np.isfinite(thin_cloud(cloud, 100, rng=rng)).all() and len(thin_cloud(cloud, 100, rng=rng)) == 40


def test_copies_are_not_new_and_strangers_are() -> None:
    rng = np.random.default_rng(2)
    real = boxes(rng, 12)
    copies, strangers = novelty(real, real[:5]), novelty(real, [cloud * 2 for cloud in real[:5]])
    assert copies.new == 0 and copies.ratio == 0 and copies.real > 0.005
    assert strangers.real == copies.real and strangers.ratio > 2
    assert novelty(real, boxes(rng, 12)).ratio == pytest.approx(1, abs=0.5)
    with pytest.raises(ValueError, match="at least 2 and 1"):
        novelty(real[:1], real)


def test_the_distance_of_parts_that_should_touch() -> None:
    plate = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0]])
    vertices = np.concatenate([plate, plate + [0, 0.02, 0], plate + [0, 0.5, 0]])
    mesh = Mesh(vertices, np.arange(9).reshape(3, 3).astype(np.int32), np.arange(3), 3)
    touching = np.array([[0, 1, 0.2], [1, 0, 0.5], [0.2, 0.5, 0]])
    assert contact_distance(mesh, np.array([0, 1, 2]), touching) == pytest.approx((0.02 + 0.48) / 2)
    assert contact_distance(mesh, np.array([0, 1, 0]), touching) == pytest.approx(0.02)
    assert contact_distance(mesh, np.array([0, -1, 0]), touching) is None


def test_open_share_counts_edges_of_one_triangle() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    soup = Mesh(corners[faces].reshape(-1, 3), np.arange(12, dtype=np.int32).reshape(4, 3), np.arange(4), 4)
    assert open_share(soup) == 0.0  # corners that coincide are one
    assert open_share(Mesh(corners, faces[1:], np.arange(3), 3)) == 3 / 6
