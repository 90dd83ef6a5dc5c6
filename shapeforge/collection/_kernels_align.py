"""Compiled loops of ``align``: steps of iterated closest points by brute force, and what they consist of.

A brute-force search over some 600 x 600 points in float32 takes a fraction of a millisecond and, unlike a kd-tree,
need not be rebuilt when the points move.  Nothing here is hooked by the shape-checking import hook (it breaks njit).
What needs a decomposition stays outside, as that costs tens of seconds of compilation here: a map that is about to
leave its bounds is handed back.
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


@njit(cache=True, nogil=True)
def moved_by(matrix, offset, source, out):
    """Points (n, 3) under an affine map, coordinates first (3, n)."""
    for i in range(source.shape[0]):
        x, y, z = source[i, 0], source[i, 1], source[i, 2]
        for axis in range(3):
            out[axis, i] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z + offset[axis]


@njit(cache=True, nogil=True)
def median_of(values, scratch):
    """The median of ``values`` (n,), as NumPy has it; ``scratch`` (n,) is written to."""
    n = len(values)
    scratch[:n] = values
    half = n // 2
    low, high = 0, n - 1
    while low < high:
        pivot = scratch[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while scratch[i] < pivot:
                i += 1
            while scratch[j] > pivot:
                j -= 1
            if i <= j:
                scratch[i], scratch[j] = scratch[j], scratch[i]
                i += 1
                j -= 1
        if half <= j:
            high = j
        elif half >= i:
            low = i
        else:
            break
    if n % 2:
        return scratch[half]
    below = scratch[0]
    for i in range(1, half):
        below = max(below, scratch[i])
    return (below + scratch[half]) / np.float32(2)


@njit(cache=True, nogil=True)
def determinant(m):
    """Of a matrix (3, 3)."""
    return (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )


@njit(cache=True, nogil=True)
def positive(m):
    """Whether a symmetric matrix (3, 3) is positive definite: its leading minors are."""
    return m[0, 0] > 0.0 and m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0] > 0.0 and determinant(m) > 0.0


@njit(cache=True, nogil=True)
def within_bounds(matrix, back, smallest, largest, shear):
    """Whether a map (3, 3) does not mirror, stretches between ``smallest`` and ``largest``, and shears what ``back``
    starts from by at most ``shear``; False on what is no number.
    """
    if not determinant(matrix) > 0.0:
        return False
    low, high = np.empty((3, 3)), np.empty((3, 3))
    for r in range(3):
        for c in range(3):
            square = 0.0
            change = 0.0
            for k in range(3):
                square += matrix[k, r] * matrix[k, c]
                change += matrix[r, k] * back[k, c]
            if r != c and not abs(change) <= shear:
                return False
            low[r, c] = square - (smallest * smallest if r == c else 0.0)
            high[r, c] = (largest * largest if r == c else 0.0) - square
    return positive(low) and positive(high)


@njit(cache=True, nogil=True)
def solved(second, cross, start, pull, out):
    """``out (second + pull I) = cross + pull start``, all (3, 3), the first symmetric; by its adjugate."""
    a = second.copy()
    for r in range(3):
        a[r, r] += pull
    scale = 1.0 / determinant(a)
    inverse = np.empty((3, 3))
    for r in range(3):
        for c in range(3):
            i, j = (r + 1) % 3, (r + 2) % 3
            k, m = (c + 1) % 3, (c + 2) % 3
            inverse[c, r] = (a[i, k] * a[j, m] - a[i, m] * a[j, k]) * scale
    for r in range(3):
        for c in range(3):
            total = 0.0
            for k in range(3):
                total += (cross[r, k] + pull * start[r, k]) * inverse[k, c]
            out[r, c] = total


RAN, SETTLED, OUT_OF_BOUNDS = 0, 1, 2


@njit(cache=True, nogil=True)
def closest_point_steps(
    source, target, fixed, start, back, ridge, bounds, settled, steps, wide, matrix, offset,
    nearest_of_source, squared_source, nearest_of_target, squared_target,
):  # fmt: skip
    """At most ``steps`` steps of ``align._closest_points`` from the map ``matrix`` (3, 3), ``offset`` (3,), in place.

    ``bounds`` are the smallest and largest stretch and the largest shear; ``wide`` is the least scale of the weights in
    the first step.  Returns how many steps were taken, the next step's ``wide``, how it ended, and the mean of the
    source: a map out of its bounds is written as it is, and its ``offset`` is the mean of the target, for the caller
    to put both right.
    """
    moved = np.empty((3, source.shape[0]), np.float32)
    scratch = np.empty(max(source.shape[0], target.shape[0]), np.float32)
    moments, second, cross, fitted = np.empty(25), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    mean = np.zeros(3)
    for step in range(steps):
        moved_by(matrix, offset, source, moved)
        nearest_both_ways(moved, fixed, nearest_of_source, squared_source, nearest_of_target, squared_target)
        typical = 0.5 * (np.sqrt(median_of(squared_source, scratch)) + np.sqrt(median_of(squared_target, scratch)))
        scale = max(4.0 * typical, wide) ** 2 + 1e-12
        wide *= 0.8
        moments[:] = 0.0
        add_moments(
            source, target, nearest_of_source, squared_source, nearest_of_target, squared_target, scale, moments
        )
        moments /= moments[0]
        trace = 0.0
        for r in range(3):
            mean[r] = moments[1 + r]
            for c in range(3):
                second[r, c] = moments[7 + 3 * r + c] - moments[1 + r] * moments[1 + c]
                cross[r, c] = moments[16 + 3 * r + c] - moments[4 + r] * moments[1 + c]
            trace += second[r, r]
        solved(second, cross, start, ridge * trace / 3.0 + 1e-12, fitted)
        if not within_bounds(fitted, back, bounds[0], bounds[1], bounds[2]):
            matrix[:], offset[:] = fitted, moments[4:7]
            return step + 1, wide, OUT_OF_BOUNDS, mean
        change = 0.0
        for r in range(3):
            through = moments[4 + r]
            for c in range(3):
                through -= fitted[r, c] * mean[c]
                change = max(change, abs(fitted[r, c] - matrix[r, c]))
                matrix[r, c] = fitted[r, c]
            change = max(change, abs(through - offset[r]))
            offset[r] = through
        if change < settled:
            return step + 1, wide, SETTLED, mean
    return steps, wide, RAN, mean
