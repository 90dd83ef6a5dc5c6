"""Compiled loops of ``align``: brute-force nearest neighbours both ways, and one run of symmetric affine ICP.

A brute-force search over some 600 x 600 points in float32 takes a fraction of a millisecond and, unlike a kd-tree,
need not be rebuilt when the points move.  Nothing here is hooked by the shape-checking import hook (it breaks njit).
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def nearest_both_ways(a, b, nearest_of_a, squared_of_a, nearest_of_b, squared_of_b):
    """Fill, for every row of ``a`` (3, n) the nearest column of ``b`` (3, m) and its squared distance, and vice versa.

    Coordinates first, so that the inner loops run over contiguous memory and vectorise.
    """
    n, m = a.shape[1], b.shape[1]
    row = np.empty(m, np.float32)
    for j in range(m):
        squared_of_b[j] = np.inf
        nearest_of_b[j] = 0
    for i in range(n):
        x, y, z = a[0, i], a[1, i], a[2, i]
        for j in range(m):
            dx, dy, dz = b[0, j] - x, b[1, j] - y, b[2, j] - z
            row[j] = dx * dx + dy * dy + dz * dz
        least = row[0]
        for j in range(m):
            least = min(least, row[j])
        squared_of_a[i] = least
        for j in range(m):
            if row[j] == least:
                nearest_of_a[i] = j
                break
        for j in range(m):
            closer = row[j] < squared_of_b[j]
            squared_of_b[j] = row[j] if closer else squared_of_b[j]
            nearest_of_b[j] = np.int32(i) if closer else nearest_of_b[j]


@njit(cache=True, nogil=True)
def _transformed(points, matrix, offset, out):
    for i in range(points.shape[0]):
        for c in range(3):
            out[c, i] = (
                matrix[c, 0] * points[i, 0] + matrix[c, 1] * points[i, 1] + matrix[c, 2] * points[i, 2] + offset[c]
            )


@njit(cache=True, nogil=True)
def _trimmed_mean_root(squared, kept_share):
    kept = max(1, int(kept_share * len(squared)))
    ordered = np.sort(squared)
    total = 0.0
    for i in range(kept):
        total += np.sqrt(ordered[i])
    return total / kept


@njit(cache=True, nogil=True)
def _bounded(matrix, start, low, high, shear):
    """``matrix`` with singular values in [low, high] and bounded shear relative to ``start``; ``start`` if mirrored."""
    if np.linalg.det(matrix) <= 0.0:
        return start.copy()
    u, s, vt = np.linalg.svd(matrix)
    inside = True
    for c in range(3):
        if s[c] < low or s[c] > high:
            inside = False
            s[c] = min(max(s[c], low), high)
    if not inside:
        matrix = (u * s) @ vt
    change = matrix @ np.linalg.inv(start)
    bent = False
    for r in range(3):
        for c in range(3):
            if r != c and abs(change[r, c]) > shear:
                change[r, c] = shear if change[r, c] > 0 else -shear
                bent = True
    if bent:
        matrix = change @ start
        if np.linalg.det(matrix) <= 0.0:
            return start.copy()
    return matrix


@njit(cache=True, nogil=True)
def symmetric_icp(source, target, matrix, offset, ridge, max_iterations, tolerance, kept_share, low, high, shear):
    """One start of symmetric, robust, ridge-regularised affine ICP; returns (matrix, offset, residual).

    ``source`` (n, 3) and ``target`` (m, 3) float64.  Each iteration pairs every moved source point with its nearest
    target point and the other way round, weighs pairs by a Geman-McClure weight whose scale anneals towards the median
    distance, and solves the weighted least squares for the affine map, pulled towards the start by ``ridge`` times the
    mean variance of the source.
    """
    n, m = source.shape[0], target.shape[0]
    start = matrix.copy()
    moved = np.empty((3, n), np.float32)
    fixed = np.empty((3, m), np.float32)
    for j in range(m):
        for c in range(3):
            fixed[c, j] = target[j, c]
    of_source = np.empty(n, np.int32)
    of_target = np.empty(m, np.int32)
    squared_source = np.empty(n, np.float32)
    squared_target = np.empty(m, np.float32)
    # The first scale lets a fifth of the target's size pass, so that legs of another length still pull.
    spread = 0.0
    for c in range(3):
        spread += (target[:, c].max() - target[:, c].min()) ** 2
    wide = 0.2 * np.sqrt(spread)
    for _ in range(max_iterations):
        _transformed(source, matrix, offset, moved)
        nearest_both_ways(moved, fixed, of_source, squared_source, of_target, squared_target)
        typical = 0.5 * (np.sqrt(np.median(squared_source)) + np.sqrt(np.median(squared_target)))
        scale = max(4.0 * typical, wide) ** 2 + 1e-12
        wide *= 0.8
        total = 0.0
        mean_s = np.zeros(3)
        mean_t = np.zeros(3)
        second = np.zeros((3, 3))
        cross = np.zeros((3, 3))
        for way in range(2):
            count = n if way == 0 else m
            for p in range(count):
                if way == 0:
                    i, j, d2 = p, of_source[p], squared_source[p]
                else:
                    i, j, d2 = of_target[p], p, squared_target[p]
                w = 1.0 / (1.0 + d2 / scale) ** 2 / count
                total += w
                for r in range(3):
                    mean_s[r] += w * source[i, r]
                    mean_t[r] += w * target[j, r]
                    for c in range(3):
                        second[r, c] += w * source[i, r] * source[i, c]
                        cross[r, c] += w * target[j, r] * source[i, c]
        mean_s /= total
        mean_t /= total
        second = second / total - np.outer(mean_s, mean_s)
        cross = cross / total - np.outer(mean_t, mean_s)
        pull = ridge * (second[0, 0] + second[1, 1] + second[2, 2]) / 3.0 + 1e-12
        fitted = np.linalg.solve(second + pull * np.eye(3), (cross + pull * start).T).T
        fitted = _bounded(fitted, start, low, high, shear)
        shift = mean_t - fitted @ mean_s
        change = max(np.abs(fitted - matrix).max(), np.abs(shift - offset).max())
        matrix, offset = fitted, shift
        if change < tolerance:
            break
    _transformed(source, matrix, offset, moved)
    nearest_both_ways(moved, fixed, of_source, squared_source, of_target, squared_target)
    residual = 0.5 * (
        _trimmed_mean_root(squared_source, kept_share) + _trimmed_mean_root(squared_target, kept_share)
    )
    return matrix, offset, residual
