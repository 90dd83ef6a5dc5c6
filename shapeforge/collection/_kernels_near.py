"""Compiled loops that find nearest points through a grid of cells: some ten times as quick as a kd-tree."""

from __future__ import annotations

import numpy as np
from numba import njit

from shapeforge.collection._kernels import cell_grid

MOST_CELLS = 64
"""Cells along an axis at most: stray points must not ask for more memory than there is."""


@njit(cache=True, nogil=True)
def cell_size(points, k):
    """An edge of cells that suits ``nearest_k``: a little less than the radius that holds k points of the surface."""
    largest = 0.0
    for axis in range(3):
        largest = max(largest, points[:, axis].max() - points[:, axis].min())
    if largest <= 0.0:
        return 1.0
    trial = largest / 20
    first = cell_grid(points, trial)[2]
    occupied = 0
    for c in range(len(first) - 1):
        occupied += first[c + 1] > first[c]
    reach = trial * np.sqrt(k * occupied / (np.pi * len(points)))
    return max(0.9 * reach, largest / MOST_CELLS)


@njit(cache=True, nogil=True)
def part_smallest(distance, index, count, k):
    """Reorder the first ``count`` entries of both arrays so that the ``k`` smallest distances come first."""
    low, high = 0, count - 1
    while low < high:
        pivot = distance[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while distance[i] < pivot:
                i += 1
            while distance[j] > pivot:
                j -= 1
            if i <= j:
                distance[i], distance[j] = distance[j], distance[i]
                index[i], index[j] = index[j], index[i]
                i += 1
                j -= 1
        if k - 1 <= j:
            high = j
        elif k - 1 >= i:
            low = i
        else:
            return


@njit(cache=True, nogil=True)
def along_a_curve(points):
    """An order (n,) in which points that follow each other are near: Morton's, over 64 cells along each axis."""
    code = np.zeros(len(points), np.int64)
    low = np.empty(3)
    span = 1e-300
    for axis in range(3):
        low[axis] = points[:, axis].min()
        span = max(span, points[:, axis].max() - low[axis])
    for i in range(len(points)):
        for axis in range(3):
            at = min(int((points[i, axis] - low[axis]) / span * 64), 63)
            for bit in range(6):
                code[i] |= ((at >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code)


@njit(cache=True, nogil=True)
def nearest_k(points, queries, k, size, out, squared):
    """The ``k`` nearest of ``points`` (n >= k) to every query: indices into ``out`` (Q, k), squared distances.

    Unordered within a row.  Exact whatever the cells' ``size``: queries are taken along a curve, and the ball that
    holds the k nearest of one query, grown by the step to the next, holds at least k points for that one, too.
    """
    low, shape, first, order = cell_grid(points, size)
    placed = points[order]
    n = len(points)
    distance = np.empty(n)
    found = np.empty(n, np.int64)
    reach = np.inf
    px = py = pz = 0.0
    for i in along_a_curve(queries):
        qx, qy, qz = queries[i, 0], queries[i, 1], queries[i, 2]
        step = np.sqrt((qx - px) ** 2 + (qy - py) ** 2 + (qz - pz) ** 2)
        reach = (reach + step) * (1 + 1e-9) + 1e-12  # rounding must not lose the last one
        px, py, pz = qx, qy, qz
        bound = reach * reach
        x0 = int(min(max((qx - reach - low[0]) / size, 0.0), shape[0]))
        x1 = int(min(max((qx + reach - low[0]) / size, -1.0), shape[0] - 1.0))
        count = 0
        for x in range(x0, x1 + 1):
            gap = max(low[0] + x * size - qx, qx - low[0] - (x + 1) * size, 0.0)
            left_x = bound - gap * gap
            if left_x < 0.0:
                continue
            wide = np.sqrt(left_x)
            y0 = int(min(max((qy - wide - low[1]) / size, 0.0), shape[1]))
            y1 = int(min(max((qy + wide - low[1]) / size, -1.0), shape[1] - 1.0))
            for y in range(y0, y1 + 1):
                gap = max(low[1] + y * size - qy, qy - low[1] - (y + 1) * size, 0.0)
                left = left_x - gap * gap
                if left < 0.0:
                    continue
                deep = np.sqrt(left)
                z0 = int(min(max((qz - deep - low[2]) / size, 0.0), shape[2]))
                z1 = int(min(max((qz + deep - low[2]) / size, -1.0), shape[2] - 1.0))
                if z1 < z0:
                    continue
                row = (x * shape[1] + y) * shape[2]
                for at in range(first[row + z0], first[row + z1 + 1]):
                    dx = placed[at, 0] - qx
                    dy = placed[at, 1] - qy
                    dz = placed[at, 2] - qz
                    d = dx * dx + dy * dy + dz * dz
                    distance[count] = d
                    found[count] = at
                    count += d <= bound
        part_smallest(distance, found, count, k)
        farthest = 0.0
        for j in range(k):
            farthest = max(farthest, distance[j])
            out[i, j] = order[found[j]]
            squared[i, j] = distance[j]
        reach = np.sqrt(farthest)
