"""Numba kernels that sum exponentials over the sparse pairs (p, k): correspondences, and what speaks for parts.

They are where a fit spends its time, so they are written for the vector units: a row of pairs is first gathered into
small buffers in single precision (a logit is a difference from the best of its row, where single precision is plenty),
exponentials are taken by a polynomial without branches, sums are taken in double precision.  Indices are unsigned:
signed ones may count from the end, and the test for that keeps loops from being vectorised.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# no assumption about NaN and infinity: what is no number must stay none, the fit looks for it
_FAST = {"cache": True, "nogil": True, "fastmath": {"reassoc", "contract", "nsz", "arcp"}}

_LOG2_E = np.float32(1.4426950408889634)
_LOWEST = np.float32(-60.0)  # 2^-60: nothing beside the largest, which is 1
_BIAS, _MANTISSA = np.int32(127), np.int32(23)

# 2^f on [0, 1), by Chebyshev interpolation: relative error below 3e-9
_C0, _C1, _C2, _C3, _C4, _C5, _C6 = (
    np.float32(c)
    for c in (1.00000000253, 0.69314693276, 0.24023045441, 0.0554806302, 0.00968418631, 0.00123913318, 0.00021865785)
)


@njit(**_FAST, inline="always")
def exponentials(logit, top, n, bits, out):
    """``out[j] = exp(logit[j] - top[j])`` for the first ``n`` entries, single precision; ``bits`` (int32) is scratch.

    To 3e-7 of the result, which is at least 1e-18: no branch, so that the loop vectorises.  No logit is above its top.
    """
    powers = bits.view(np.float32)
    for j in range(n):
        exponent = (logit[j] - top[j]) * _LOG2_E
        exponent = _LOWEST if exponent < _LOWEST else exponent  # and not the maximum: NaN stays NaN
        whole = np.floor(exponent)
        f = exponent - whole
        bits[j] = (np.int32(whole) + _BIAS) << _MANTISSA
        out[j] = _C0 + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * (_C5 + f * _C6)))))
    for j in range(n):
        out[j] *= powers[j]


@njit(**_FAST)
def longest_row(offsets):
    """The most pairs that a point has."""
    longest = 0
    for p in range(offsets.shape[0] - 1):
        longest = max(longest, offsets[p + 1] - offsets[p])
    return longest


@njit(**_FAST)
def whitened(deformed, precision, extra):
    """(K, 4) in single precision: points times the root of half their precision, and ``extra`` (K,) as it is."""
    out = np.empty((deformed.shape[0], 4), np.float32)
    scale = np.sqrt(0.5 * precision)
    for k in range(deformed.shape[0]):
        for axis in range(3):
            out[k, axis] = deformed[k, axis] * scale[axis]
        out[k, 3] = extra[k]
    return out


@njit(**_FAST, inline="always")
def place_of(points, p, scale):
    """Point ``p`` of ``points``, each axis times its ``scale``, in single precision."""
    return np.float32(points[p, 0] * scale[0]), np.float32(points[p, 1] * scale[1]), np.float32(points[p, 2] * scale[2])


@njit(**_FAST)
def correspond(
    offsets, template_index, costs, points, deformed, half_trace, precision, label, segmentation, log_epsilon,
    q, part_share, mass, first_moment,
):  # fmt: skip
    """Correspondence update (supplement, q[p,k]); fills q (M,), part_share (P,L), mass (K,), first_moment (K,3)."""
    n_parts, longest = segmentation.shape[1], longest_row(offsets)
    scale = np.sqrt(0.5 * precision)
    place = whitened(deformed, precision, half_trace)
    sums = np.zeros((deformed.shape[0], 4))  # mass and first moment side by side: one line of memory a pair
    logit, value, top = np.empty(longest, np.float32), np.empty(longest, np.float32), np.empty(longest, np.float32)
    bits, part, against = np.empty(longest, np.int32), np.empty(longest, np.int32), np.empty(n_parts, np.float32)
    for p in range(offsets.shape[0] - 1):
        begin, end = offsets[p], offsets[p + 1]
        index, cost, mine = template_index[begin:end], costs[begin:end], q[begin:end]
        n = len(index)
        for one in range(n_parts):
            against[one] = log_epsilon * (1.0 - segmentation[p, one])
        x, y, z = place_of(points, p, scale)
        for j in range(n):
            k = np.uint32(index[j])
            dx, dy, dz = place[k, 0] - x, place[k, 1] - y, place[k, 2] - z
            part[j] = label[k]
            logit[j] = against[np.uint32(part[j])] - (dx * dx + dy * dy + dz * dz + place[k, 3] + np.float32(cost[j]))
        best = np.float32(-np.inf)
        for j in range(n):
            best = max(best, logit[j])
        top[:n] = best
        exponentials(logit, top, n, bits, value)
        total = np.float32(0.0)
        for j in range(n):
            total += value[j]
        share = 1.0 / np.float64(total) if n else 0.0
        for one in range(n_parts):
            own = np.float32(0.0)
            for j in range(n):
                own += value[j] * np.float32(part[j] == one)
            part_share[p, one] = own * share
        for j in range(n):
            mine[j] = value[j] * share
        for j in range(n):
            k = np.uint32(index[j])
            sums[k, 0] += mine[j]
            sums[k, 1] += mine[j] * points[p, 0]
            sums[k, 2] += mine[j] * points[p, 1]
            sums[k, 3] += mine[j] * points[p, 2]
    mass[:] = sums[:, 0]
    first_moment[:] = sums[:, 1:]


@njit(**_FAST)
def explained_without(offsets, template_index, costs, points, deformed, precision, label, n_parts, cap):
    """Per point the loss (nats, at most ``cap``) of the best explanation when its own favourite part is taken away.

    From φ1 and φ3 alone: ``ln Σ_k exp(-cost)`` over all candidates minus the same over candidates of other parts.
    Returns favourite part (P,), loss (P,) and the log density of each part (P, L).
    """
    n_points, longest = offsets.shape[0] - 1, longest_row(offsets)
    favourite, loss = np.full(n_points, -1, np.int32), np.zeros(n_points)
    density = np.full((n_points, n_parts), -np.inf)
    scale = np.sqrt(0.5 * precision)
    place = whitened(deformed, precision, np.zeros(deformed.shape[0]))
    logit, value, top = np.empty(longest, np.float32), np.empty(longest, np.float32), np.empty(longest, np.float32)
    bits, part, best_of = np.empty(longest, np.int32), np.empty(longest, np.int32), np.empty(n_parts, np.float32)
    for p in range(n_points):
        begin, end = offsets[p], offsets[p + 1]
        index, cost = template_index[begin:end], costs[begin:end]
        n = len(index)
        x, y, z = place_of(points, p, scale)
        for j in range(n):
            k = np.uint32(index[j])
            dx, dy, dz = place[k, 0] - x, place[k, 1] - y, place[k, 2] - z
            part[j] = label[k]
            logit[j] = -(dx * dx + dy * dy + dz * dz + np.float32(cost[j]))
        best_of[:] = -np.inf
        for j in range(n):
            one = np.uint32(part[j])
            best_of[one] = max(best_of[one], logit[j])
        for j in range(n):
            top[j] = best_of[np.uint32(part[j])]
        exponentials(logit, top, n, bits, value)
        best = -np.inf
        for one in range(n_parts):
            if best_of[one] == -np.inf:
                continue
            own = np.float32(0.0)
            for j in range(n):
                own += value[j] * np.float32(part[j] == one)
            density[p, one] = best_of[one] + np.log(np.float64(own))
            if density[p, one] > best:
                best, favourite[p] = density[p, one], one
        if favourite[p] < 0:
            continue
        everything, others = 0.0, 0.0
        for one in range(n_parts):
            amount = np.exp(density[p, one] - best)
            everything += amount
            if one != favourite[p]:
                others += amount
        loss[p] = min(cap, np.log(everything / others)) if others > 0.0 else cap
    return favourite, loss, density
