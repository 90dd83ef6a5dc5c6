"""How near new shapes are to those of the family, point by corresponding point: fast enough for a slider that moves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

SPARSE = 400
"""So many of the points, evenly chosen, tell how much shapes resemble each other."""
NEIGHBOURS, RIDGE = 6, 1e-3
ABSENT = 0.15
"""A point that only one of two shapes has counts as so far away (diagonals)."""


def nearest_shape(positions: Float[np.ndarray, "T K 3"], points: Float[np.ndarray, "K 3"]) -> tuple[int, float]:
    """Index of the shape nearest to the points, and the mean distance (diagonals) over the points that both have.

    NaN where a point is absent.  A shape that has less than half of the points is no candidate unless all have less.
    """
    square = np.zeros(positions.shape[:2])
    for axis in range(3):
        square += (positions[..., axis] - points[:, axis]) ** 2
    away = np.sqrt(square, out=square)
    both = np.isfinite(away)
    count = both.sum(axis=1)
    share = count / max(int(np.isfinite(points).all(axis=1).sum()), 1)
    mean = np.where(both, away, 0).sum(axis=1) / np.maximum(count, 1)
    mean = np.where(share > 0.5, mean, np.inf)
    best = int(mean.argmin())
    return best, float(mean[best])


def resemblance(positions: Float[np.ndarray, "T K 3"], points: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, " T"]:
    """How much each shape resembles the points (NaN where absent): weights that fall off with the mean distance, sum 1.

    Of many points some hundred are looked at.
    """
    step = max(len(points) // SPARSE, 1)
    away = np.linalg.norm(positions[:, ::step] - points[::step], axis=2)
    away = np.where(np.isfinite(away), away, ABSENT).mean(axis=1)
    weight = np.exp(-((away - away.min()) / max(0.25 * float(away.min()), 0.004)))
    return weight / weight.sum()


def blend(positions: Float[np.ndarray, "T K 3"], points: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, " T"]:
    """Of which shapes the points (NaN where absent) are a mean: weights with sum 1, which change as the points move.

    The weights of locally linear embedding (Roweis and Saul, 2000) over the nearest shapes: one between two of them
    lies between them on a map, too.
    """
    step = max(len(points) // SPARSE, 1)
    own, others = points[::step], positions[:, ::step]
    here, there = np.isfinite(own[:, 0]), np.isfinite(others[..., 0])
    away = np.where((here & there)[..., None], others - own, 0.0)
    away[..., 0] += np.where(here != there, ABSENT, 0.0)
    away = away.reshape(len(positions), -1)
    near = np.argsort((away**2).sum(axis=1), kind="stable")[:NEIGHBOURS]
    inner = away[near] @ away[near].T
    inner += (RIDGE * np.trace(inner) + 1e-12) * np.eye(len(near))
    weight = np.linalg.solve(inner, np.ones(len(near)))
    found = np.zeros(len(positions))
    found[near] = weight / weight.sum()
    return found


def least_like(
    positions: Float[np.ndarray, "T K 3"], exists: Bool[np.ndarray, "T L"], group: Int[np.ndarray, " T"], index: int
) -> int:
    """The shape that one is least like, of those in its group with the same parts, else of all; itself if alone."""
    others = np.arange(len(positions)) != index
    alike = others & (exists == exists[index]).all(axis=1) & (group == group[index])
    among = np.flatnonzero(alike if alike.any() else others)
    if not len(among):
        return index
    away = np.nanmean(np.linalg.norm(positions[among] - positions[index], axis=2), axis=1)
    return int(among[np.nanargmax(away)])
