"""Compiled loops that find nearest points through a grid of cells: some ten times as quick as a kd-tree."""

from __future__ import annotations

import numpy as np
from numba import njit

from shapeforge.collection._kernels import cell_grid

MOST_CELLS = 64
"""Cells along an axis at most: stray points must not ask for more memory than there is."""

GROUP = 0.9
"""Edge of the cells whose queries share a search, in cells of the points."""


@njit(cache=True, nogil=True)
def cell_size(points, k):
    """An edge of cells that suits a search: nearly the radius that holds k points of the surface."""
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
def gather(placed, low, shape, first, size, centre, radius, near, which):
    """Copy the points within ``radius`` of ``centre`` into ``near`` (3, n) and their rows into ``which``; how many."""
    bound = radius * radius
    x0 = int(min(max((centre[0] - radius - low[0]) / size, 0.0), shape[0]))
    x1 = int(min(max((centre[0] + radius - low[0]) / size, -1.0), shape[0] - 1.0))
    count = 0
    for x in range(x0, x1 + 1):
        gap = max(low[0] + x * size - centre[0], centre[0] - low[0] - (x + 1) * size, 0.0)
        left_x = bound - gap * gap
        if left_x < 0.0:
            continue
        wide = np.sqrt(left_x)
        y0 = int(min(max((centre[1] - wide - low[1]) / size, 0.0), shape[1]))
        y1 = int(min(max((centre[1] + wide - low[1]) / size, -1.0), shape[1] - 1.0))
        for y in range(y0, y1 + 1):
            gap = max(low[1] + y * size - centre[1], centre[1] - low[1] - (y + 1) * size, 0.0)
            left = left_x - gap * gap
            if left < 0.0:
                continue
            deep = np.sqrt(left)
            z0 = int(min(max((centre[2] - deep - low[2]) / size, 0.0), shape[2]))
            z1 = int(min(max((centre[2] + deep - low[2]) / size, -1.0), shape[2] - 1.0))
            if z1 < z0:
                continue
            row = (x * shape[1] + y) * shape[2]
            for at in range(first[row + z0], first[row + z1 + 1]):
                dx = placed[at, 0] - centre[0]
                dy = placed[at, 1] - centre[1]
                dz = placed[at, 2] - centre[2]
                near[0, count] = dx
                near[1, count] = dy
                near[2, count] = dz
                which[count] = at
                count += dx * dx + dy * dy + dz * dz <= bound
    return count


@njit(cache=True, nogil=True)
def threshold(distance, count, k):
    """A value that exactly ``k`` of the first ``count`` distances do not exceed, or -1 where equal ones prevent it."""
    low, high = np.float32(0.0), np.float32(0.0)
    for j in range(count):
        high = max(high, distance[j])
    below, above = 0, count
    if count == k:
        return high
    for step in range(32):
        # on a surface the number grows with the square of the distance; every third step halves, to be sure
        share = np.float32(0.5) if step % 3 == 2 else np.float32(k - below + 0.5) / np.float32(above - below + 1)
        middle = low + (high - low) * min(share, np.float32(0.97))
        if not low < middle < high:
            return np.float32(-1.0)
        within = np.int32(0)
        for j in range(count):
            within += np.int32(distance[j] <= middle)
        if within == k:
            return middle
        if within < k:
            low, below = middle, within
        else:
            high, above = middle, within
    return np.float32(-1.0)


@njit(cache=True, nogil=True)
def nearest_k(points, queries, k, size, out, squared):
    """The ``k`` nearest of ``points`` (n >= k) to every query: indices into ``out`` (Q, k), squared distances.

    Unordered within a row; exact, up to ties in single precision, whatever the cells' ``size``.  Queries of one cell
    share a search: the ball around their middle that holds k points, grown by twice their spread, holds the k nearest
    of each.
    """
    low, shape, first, order = cell_grid(points, size)
    placed = points[order]
    n = len(points)
    _, _, group_first, group_order = cell_grid(queries, size_of_groups(queries, size))
    near, which = np.empty((3, n + 1), np.float32), np.empty(n + 1, np.int32)
    distance, index = np.empty(n + 1, np.float32), np.empty(n + 1, np.int32)
    centre, before = np.empty(3), np.zeros(3)
    reach = np.inf
    for group in range(len(group_first) - 1):
        begin, end = group_first[group], group_first[group + 1]
        if begin == end:
            continue
        for axis in range(3):
            centre[axis] = 0.0
            for g in range(begin, end):
                centre[axis] += queries[group_order[g], axis] / (end - begin)
        spread, step = 0.0, 0.0
        for g in range(begin, end):
            apart = 0.0
            for axis in range(3):
                apart += (queries[group_order[g], axis] - centre[axis]) ** 2
            spread = max(spread, np.sqrt(apart))
        for axis in range(3):
            step += (centre[axis] - before[axis]) ** 2
            before[axis] = centre[axis]
        # the ball that held k points of the last middle, grown by the step, holds k of this one
        count = gather(placed, low, shape, first, size, centre, (reach + np.sqrt(step)) * 1.00001 + 1e-9, near, which)
        for j in range(count):
            distance[j] = near[0, j] * near[0, j] + near[1, j] * near[1, j] + near[2, j] * near[2, j]
            index[j] = j
        limit = threshold(distance, count, k)
        if limit < 0.0:
            part_smallest(distance, index, count, k)
            limit = distance[:k].max()
        reach = np.sqrt(float(limit))
        count = gather(placed, low, shape, first, size, centre, (reach + 2 * spread) * 1.00001 + 1e-9, near, which)
        for g in range(begin, end):
            i = group_order[g]
            x = np.float32(queries[i, 0] - centre[0])
            y = np.float32(queries[i, 1] - centre[1])
            z = np.float32(queries[i, 2] - centre[2])
            for j in range(count):
                dx, dy, dz = near[0, j] - x, near[1, j] - y, near[2, j] - z
                distance[j] = dx * dx + dy * dy + dz * dz
            limit = threshold(distance, count, k)
            if limit < 0.0:
                for j in range(count):
                    index[j] = which[j]
                part_smallest(distance, index, count, k)
            else:
                found = 0
                for j in range(count):
                    index[found] = which[j]
                    found += distance[j] <= limit
            for j in range(k):
                at = index[j]
                dx = placed[at, 0] - queries[i, 0]
                dy = placed[at, 1] - queries[i, 1]
                dz = placed[at, 2] - queries[i, 2]
                out[i, j] = order[at]
                squared[i, j] = dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def nearest_1(points, queries, size, out, squared):
    """The nearest of ``points`` (n >= 1) to every query: indices into ``out`` (Q, 1), squared distances; exact.

    Queries are taken cell by cell, so that what the last one found bounds the ball to be searched for the next.
    """
    low, shape, first, order = cell_grid(points, size)
    placed = points[order]
    _, _, _, query_order = cell_grid(queries, size_of_groups(queries, size))
    best = 0
    for i in query_order:
        x, y, z = queries[i, 0], queries[i, 1], queries[i, 2]
        bound = (placed[best, 0] - x) ** 2 + (placed[best, 1] - y) ** 2 + (placed[best, 2] - z) ** 2
        cx = min(max(int((x - low[0]) / size), 0), shape[0] - 1)
        cy = min(max(int((y - low[1]) / size), 0), shape[1] - 1)
        cz = min(max(int((z - low[2]) / size), 0), shape[2] - 1)
        cell = (cx * shape[1] + cy) * shape[2] + cz
        for at in range(first[cell], first[cell + 1]):
            apart = (placed[at, 0] - x) ** 2 + (placed[at, 1] - y) ** 2 + (placed[at, 2] - z) ** 2
            if apart < bound:
                bound, best = apart, at
        reach = np.sqrt(bound) * 1.00001 + 1e-12
        y0 = min(max(int((y - reach - low[1]) / size), 0), shape[1] - 1)
        y1 = min(max(int((y + reach - low[1]) / size), 0), shape[1] - 1)
        z0 = min(max(int((z - reach - low[2]) / size), 0), shape[2] - 1)
        z1 = min(max(int((z + reach - low[2]) / size), 0), shape[2] - 1)
        x0 = min(max(int((x - reach - low[0]) / size), 0), shape[0] - 1)
        x1 = min(max(int((x + reach - low[0]) / size), 0), shape[0] - 1)
        for gx in range(x0, x1 + 1):
            gap = max(low[0] + gx * size - x, x - low[0] - (gx + 1) * size, 0.0)
            if gap * gap > bound:
                continue
            for gy in range(y0, y1 + 1):
                gap_y = max(low[1] + gy * size - y, y - low[1] - (gy + 1) * size, 0.0)
                if gap * gap + gap_y * gap_y > bound:
                    continue
                row = (gx * shape[1] + gy) * shape[2]
                for at in range(first[row + z0], first[row + z1 + 1]):
                    apart = (placed[at, 0] - x) ** 2 + (placed[at, 1] - y) ** 2 + (placed[at, 2] - z) ** 2
                    if apart < bound:
                        bound, best = apart, at
        out[i, 0], squared[i, 0] = order[best], bound


@njit(cache=True, nogil=True)
def size_of_groups(queries, size):
    """Edge of the cells whose queries share a search."""
    largest = 0.0
    for axis in range(3):
        largest = max(largest, queries[:, axis].max() - queries[:, axis].min())
    return max(GROUP * size, largest / MOST_CELLS, 1e-12)
