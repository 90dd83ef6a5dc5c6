"""Compiled loops of ``align``: brute-force nearest neighbours both ways, and the moments of the pairs they make.

A brute-force search over some 600 x 600 points in float32 takes a fraction of a millisecond and, unlike a kd-tree,
need not be rebuilt when the points move.  Nothing here is hooked by the shape-checking import hook (it breaks njit).
Linear algebra on 3 x 3 matrices stays outside: it costs nothing there, and tens of seconds of compilation here.
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
    # Floats that are not negative are ordered as their bits are, and the least of integers vectorises.
    bits = row.view(np.int32)
    for j in range(m):
        squared_of_b[j] = np.inf
        nearest_of_b[j] = 0
    for i in range(n):
        x, y, z = a[0, i], a[1, i], a[2, i]
        for j in range(m):
            dx, dy, dz = b[0, j] - x, b[1, j] - y, b[2, j] - z
            row[j] = dx * dx + dy * dy + dz * dz
        least = bits[0]
        for j in range(m):
            least = min(least, bits[j])
        for j in range(m):
            if bits[j] == least:
                nearest_of_a[i] = j
                squared_of_a[i] = row[j]
                break
        for j in range(m):
            closer = row[j] < squared_of_b[j]
            squared_of_b[j] = row[j] if closer else squared_of_b[j]
            nearest_of_b[j] = np.int32(i) if closer else nearest_of_b[j]


@njit(cache=True, nogil=True)
def add_moments(source, target, nearest_of_source, squared_source, nearest_of_target, squared_target, scale, moments):
    """Add up the weighted pairs of both ways into ``moments`` (1 + 3 + 3 + 9 + 9): weight, s, t, s s^T, t s^T.

    A pair at squared distance d weighs 1 / (1 + d / scale)^2 (Geman-McClure), over the number of pairs of its way.
    """
    n, m = source.shape[0], target.shape[0]
    for p in range(n + m):
        if p < n:
            i, j = p, nearest_of_source[p]
            w = 1.0 / (1.0 + squared_source[p] / scale) ** 2 / n
        else:
            i, j = nearest_of_target[p - n], p - n
            w = 1.0 / (1.0 + squared_target[j] / scale) ** 2 / m
        moments[0] += w
        for r in range(3):
            moments[1 + r] += w * source[i, r]
            moments[4 + r] += w * target[j, r]
            for c in range(3):
                moments[7 + 3 * r + c] += w * source[i, r] * source[i, c]
                moments[16 + 3 * r + c] += w * target[j, r] * source[i, c]
