"""The mirror plane of a shape: the best near-vertical plane that its surface points are symmetric about."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from shapeforge.collection.align import thinned

FAN = 36  # directions in plan, 5 degrees apart
REFINED = 4  # best candidates that are refined
STEEPEST = 0.25  # largest vertical component of the normal: about 14 degrees from vertical
KEPT_SHARE = 0.8  # of the pairs, while refining: a fifth of the surface may have no counterpart
ADVANTAGE = 0.8  # another plane must have an error this much smaller than the one across x: most families face z
_N_REFLECTED, _N_AGAINST = 300, 2500


def symmetry_plane(points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " 3"], float, float]:
    """The mirror plane ``normal · x = offset`` of surface points (n, 3), near-vertical (y is up), and its error.

    ``normal`` (3,) has unit length, its largest component positive.  ``error`` is the mean distance, in the units of
    the points, from a mirrored point to the nearest point: for a perfect mirror the spacing of the points remains.
    Among planes that are about as good, the one across x wins (a square table has four).

    Candidates: x = 0, z = 0, the principal axes in plan and a fan of angles; the best are refined by iterated closest
    points.  Raises ValueError for fewer than 4 points or non-finite ones.
    """
    if len(points) < 4 or not np.isfinite(points).all():
        raise ValueError(f"points: wanted at least 4 finite points (n, 3), got {points.shape}; was the shape sampled?")
    against = thinned(points, _N_AGAINST).astype(np.float64)
    reflected = thinned(against, _N_REFLECTED)
    tree = cKDTree(against)
    middle = (against.min(axis=0) + against.max(axis=0)) / 2
    candidates = []
    for normal in _directions(against):
        # A lamp arm moves the mean, a screw the box: try both.
        for offset in (float(normal @ middle), float(normal @ against.mean(axis=0))):
            candidates.append((_error(tree, reflected, normal, offset), normal, offset))
    order = np.argsort([error for error, _, _ in candidates], kind="stable")
    # The plane across x (the first two candidates) always gets its chance.
    found = [_refined(tree, reflected, *candidates[i]) for i in dict.fromkeys([0, 1, *order[:REFINED]])]
    across = min(found[:2], key=lambda plane: plane[0])
    best = min(found, key=lambda plane: plane[0])
    error, normal, offset = best if best[0] < ADVANTAGE * across[0] else across
    if normal[np.abs(normal).argmax()] < 0:
        normal, offset = -normal, -offset
    return normal, float(offset), float(error)


def mirrored(
    points: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, " 3"], offset: float
) -> Float[np.ndarray, "n 3"]:
    """Points (n, 3) on the other side of the plane ``normal · x = offset`` (unit normal)."""
    return points - 2 * ((points @ normal) - offset)[:, None] * normal


def _directions(points: np.ndarray) -> list[np.ndarray]:
    """Horizontal unit normals to try; the first is x."""
    plan = points[:, [0, 2]] - points[:, [0, 2]].mean(axis=0)
    _, axes = np.linalg.eigh(plan.T @ plan)
    angles = np.arange(FAN) * np.pi / FAN
    fan = [np.array([np.cos(angle), 0.0, np.sin(angle)]) for angle in angles]
    return fan + [np.array([axis[0], 0.0, axis[1]]) for axis in axes.T]


def _error(tree: cKDTree, points: np.ndarray, normal: np.ndarray, offset: float) -> float:
    return float(tree.query(mirrored(points, normal, offset))[0].mean())


def _refined(
    tree: cKDTree, points: np.ndarray, error: float, normal: np.ndarray, offset: float
) -> tuple[float, np.ndarray, float]:
    """The plane after some rounds of closest points; each round is kept only if the error falls.

    For pairs (x, y) the reflection that takes x nearest to y has as normal the eigenvector of least eigenvalue of the
    symmetric part of their cross-covariance, and passes half-way between the means.
    """
    for _ in range(12):
        distance, near = tree.query(mirrored(points, normal, offset))
        kept = distance <= np.quantile(distance, KEPT_SHARE)
        x, y = points[kept], tree.data[near[kept]]
        cross = (x - x.mean(axis=0)).T @ (y - y.mean(axis=0))
        _, vectors = np.linalg.eigh((cross + cross.T) / 2)
        better = vectors[:, 0] * np.sign(vectors[:, 0] @ normal or 1.0)
        if abs(better[1]) > STEEPEST:
            break
        through = float(better @ (x.mean(axis=0) + y.mean(axis=0)) / 2)
        lower = _error(tree, points, better, through)
        if lower >= error - 1e-7:
            break
        error, normal, offset = lower, better, through
    return error, normal, offset
