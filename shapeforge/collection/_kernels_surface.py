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
    parts = node_low[:used].copy(), node_high[:used].copy(), first[:used].copy(), count[:used].copy()
    return order, parts[0], parts[1], parts[2], parts[3], right[:used].copy()


@njit(cache=True, nogil=True)
def refit_tree(corners, order, first, count, right):
    """Node boxes low/high (M,3) of a tree made for the same triangles elsewhere; ``corners`` (N,3,3) are where now.

    Children come after their parents, so one pass from the last node to the first will do.
    """
    nodes = first.shape[0]
    node_low, node_high = np.empty((nodes, 3)), np.empty((nodes, 3))
    for node in range(nodes - 1, -1, -1):
        for axis in range(3):
            low, high = np.inf, -np.inf
            if count[node] > 0:
                for j in range(first[node], first[node] + count[node]):
                    for corner in range(3):
                        place = corners[order[j], corner, axis]
                        low, high = min(low, place), max(high, place)
            else:
                low = min(node_low[node + 1, axis], node_low[right[node], axis])
                high = max(node_high[node + 1, axis], node_high[right[node], axis])
            node_low[node, axis], node_high[node, axis] = low, high
    return node_low, node_high


@njit(cache=True, nogil=True)
def closest_on_triangle(px, py, pz, corner):
    """Closest point (x, y, z) of a triangle, corner (3,3), to p (Ericson, Real-Time Collision Detection 5.1.5).

    In scalars throughout: small temporary arrays cost more than the arithmetic.
    """
    ax, ay, az = corner[0, 0], corner[0, 1], corner[0, 2]
    ux, uy, uz = corner[1, 0] - ax, corner[1, 1] - ay, corner[1, 2] - az
    vx, vy, vz = corner[2, 0] - ax, corner[2, 1] - ay, corner[2, 2] - az
    wx, wy, wz = px - ax, py - ay, pz - az
    d1, d2 = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d3, d4 = d1 - uu, d2 - uv
    if d3 >= 0.0 and d4 <= d3:
        return corner[1, 0], corner[1, 1], corner[1, 2]
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and uu > 0.0:
        s = d1 / uu
        return ax + s * ux, ay + s * uy, az + s * uz
    d5, d6 = d1 - uv, d2 - vv
    if d6 >= 0.0 and d5 <= d6:
        return corner[2, 0], corner[2, 1], corner[2, 2]
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and vv > 0.0:
        t = d2 / vv
        return ax + t * vx, ay + t * vy, az + t * vz
    va = d3 * d6 - d5 * d4
    along = (d4 - d3) + (d5 - d6)
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0 and along > 0.0:
        t = (d4 - d3) / along
        s = 1.0 - t
    else:
        total = va + vb + vc
        if total <= 0.0:  # no area and no edge region: any corner will do
            return ax, ay, az
        s, t = vb / total, vc / total
    return ax + s * ux + t * vx, ay + s * uy + t * vy, az + s * uz + t * vz


@njit(cache=True, nogil=True)
def box_gap(low, high, node, px, py, pz):
    """Squared distance of a point to a node's box."""
    x = max(low[node, 0] - px, 0.0, px - high[node, 0])
    y = max(low[node, 1] - py, 0.0, py - high[node, 1])
    z = max(low[node, 2] - pz, 0.0, pz - high[node, 2])
    return x * x + y * y + z * z


@njit(cache=True, nogil=True)
def closest_points(corners, order, node_low, node_high, first, count, right, queries, positions, triangle):
    """Closest surface point, its triangle and its distance for every query (n,3); ``corners`` (N,3,3)."""
    distance = np.empty(queries.shape[0])
    stack = np.empty(128, np.int64)
    for i in range(queries.shape[0]):
        px, py, pz = queries[i, 0], queries[i, 1], queries[i, 2]
        best = np.inf
        stack[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if box_gap(node_low, node_high, node, px, py, pz) >= best:
                continue
            if count[node] > 0:
                for j in range(first[node], first[node] + count[node]):
                    t = order[j]
                    x, y, z = closest_on_triangle(px, py, pz, corners[t])
                    squared = (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2
                    if squared < best:
                        best = squared
                        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
                        triangle[i] = t
                continue
            left, other = node + 1, right[node]
            # the nearer child last, so that it is looked at first
            left_gap = box_gap(node_low, node_high, left, px, py, pz)
            right_gap = box_gap(node_low, node_high, other, px, py, pz)
            if left_gap <= right_gap:
                stack[depth], stack[depth + 1] = other, left
            else:
                stack[depth], stack[depth + 1] = left, other
            depth += 2
        distance[i] = np.sqrt(best)
    return distance
