"""Numba kernels: a bounding-volume tree over triangles, and closest points by branch and bound."""

from __future__ import annotations

import numpy as np
from numba import njit

LEAF = 6


@njit(cache=True, nogil=True)
def build_tree(low, high, centre):
    """Median-split tree over boxes (N,3).  Returns order (N,), node low/high (M,3), and first, count, right (M,).

    A leaf has count > 0 and its triangles are order[first:first+count]; an inner node's left child is the next node.
    """
    n = low.shape[0]
    order = np.arange(n)
    most = max(1, 4 * (n // LEAF + 1))
    node_low, node_high = np.empty((most, 3)), np.empty((most, 3))
    first, count = np.zeros(most, np.int64), np.zeros(most, np.int64)
    right = np.full(most, -1, np.int64)
    stack = np.empty((128, 3), np.int64)  # begin, end, parent whose right child this is (-1: none)
    stack[0] = (0, n, -1)
    depth, used = 1, 0
    while depth > 0:
        depth -= 1
        begin, end, parent = stack[depth]
        node = used
        used += 1
        if parent >= 0:
            right[parent] = node
        box_low, box_high = np.full(3, np.inf), np.full(3, -np.inf)
        centre_low, centre_high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in range(begin, end):
            t = order[i]
            for axis in range(3):
                box_low[axis] = min(box_low[axis], low[t, axis])
                box_high[axis] = max(box_high[axis], high[t, axis])
                centre_low[axis] = min(centre_low[axis], centre[t, axis])
                centre_high[axis] = max(centre_high[axis], centre[t, axis])
        node_low[node], node_high[node] = box_low, box_high
        first[node] = begin
        if end - begin <= LEAF:
            count[node] = end - begin
            continue
        axis = np.argmax(centre_high - centre_low)
        part = order[begin:end]
        order[begin:end] = part[np.argsort(centre[part, axis])]
        middle = (begin + end) // 2
        # the left child must be the next node: push the right one first
        stack[depth] = (middle, end, node)
        stack[depth + 1] = (begin, middle, -1)
        depth += 2
    return order, node_low[:used].copy(), node_high[:used].copy(), first[:used].copy(), count[:used].copy(), right[:used].copy()  # fmt: skip


@njit(cache=True, nogil=True)
def closest_on_triangle(p, a, b, c, out):
    """Closest point of triangle abc to p (Ericson, Real-Time Collision Detection 5.1.5); returns squared distance."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab @ ap, ac @ ap
    if d1 <= 0.0 and d2 <= 0.0:
        out[:] = a
    else:
        bp = p - b
        d3, d4 = ab @ bp, ac @ bp
        if d3 >= 0.0 and d4 <= d3:
            out[:] = b
        else:
            vc = d1 * d4 - d3 * d2
            if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 - d3 > 0.0:
                out[:] = a + (d1 / (d1 - d3)) * ab
            else:
                cp = p - c
                d5, d6 = ab @ cp, ac @ cp
                if d6 >= 0.0 and d5 <= d6:
                    out[:] = c
                else:
                    vb = d5 * d2 - d1 * d6
                    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 - d6 > 0.0:
                        out[:] = a + (d2 / (d2 - d6)) * ac
                    else:
                        va = d3 * d6 - d5 * d4
                        if va <= 0.0 and (d4 - d3) >= 0.0 and (d5 - d6) >= 0.0 and (d4 - d3) + (d5 - d6) > 0.0:
                            out[:] = b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b)
                        else:
                            total = va + vb + vc
                            if total > 0.0:
                                out[:] = a + ab * (vb / total) + ac * (vc / total)
                            else:  # no area and no edge region: any corner will do
                                out[:] = a
    difference = p - out
    return difference @ difference


@njit(cache=True, nogil=True)
def closest_points(vertices, triangles, order, node_low, node_high, first, count, right, queries, positions, triangle):
    """Closest surface point, its triangle and its distance for every query (n,3)."""
    distance = np.empty(queries.shape[0])
    stack = np.empty(128, np.int64)
    candidate = np.empty(3)
    for i in range(queries.shape[0]):
        p = queries[i]
        best = np.inf
        stack[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            gap = 0.0
            for axis in range(3):
                outside = max(node_low[node, axis] - p[axis], 0.0, p[axis] - node_high[node, axis])
                gap += outside * outside
            if gap >= best:
                continue
            if count[node] > 0:
                for j in range(first[node], first[node] + count[node]):
                    t = order[j]
                    squared = closest_on_triangle(
                        p, vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]], candidate
                    )
                    if squared < best:
                        best = squared
                        positions[i] = candidate
                        triangle[i] = t
                continue
            left, other = node + 1, right[node]
            # the nearer child last, so that it is looked at first
            left_gap, right_gap = 0.0, 0.0
            for axis in range(3):
                outside = max(node_low[left, axis] - p[axis], 0.0, p[axis] - node_high[left, axis])
                left_gap += outside * outside
                outside = max(node_low[other, axis] - p[axis], 0.0, p[axis] - node_high[other, axis])
                right_gap += outside * outside
            if left_gap <= right_gap:
                stack[depth], stack[depth + 1] = other, left
            else:
                stack[depth], stack[depth + 1] = left, other
            depth += 2
        distance[i] = np.sqrt(best)
    return distance
