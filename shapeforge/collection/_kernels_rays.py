"""Compiled tree of boxes over triangles, and the first triangle that a ray meets."""

from __future__ import annotations

import numpy as np
from numba import njit

LEAF = 4


@njit(cache=True, nogil=True)
def box_tree(corners):
    """Tree over triangles ``corners`` (N, 3, 3), halved at the median of the longest axis of the centres.

    Returns boxes (nodes, 6) low then high, child (nodes,) the left child (right is +1) or -1 for a leaf, the slice
    (nodes, 2) of ``order`` a leaf holds, and ``order`` (N,).
    """
    n = len(corners)
    centres = np.empty((n, 3), np.float32)
    for i in range(n):
        for axis in range(3):
            centres[i, axis] = (corners[i, 0, axis] + corners[i, 1, axis] + corners[i, 2, axis]) / 3
    order = np.arange(n)
    capacity = max(2 * n, 1)
    boxes = np.empty((capacity, 6), np.float32)
    child = np.full(capacity, -1, np.int64)
    piece = np.zeros((capacity, 2), np.int64)
    piece[0, 1] = n
    made = 1
    at = 0
    while at < made:
        begin, end = piece[at, 0], piece[at, 1]
        boxes[at, :3] = np.inf
        boxes[at, 3:] = -np.inf
        low = np.full(3, np.inf, np.float32)
        high = np.full(3, -np.inf, np.float32)
        for k in range(begin, end):
            t = order[k]
            for axis in range(3):
                for c in range(3):
                    boxes[at, axis] = min(boxes[at, axis], corners[t, c, axis])
                    boxes[at, 3 + axis] = max(boxes[at, 3 + axis], corners[t, c, axis])
                low[axis] = min(low[axis], centres[t, axis])
                high[axis] = max(high[axis], centres[t, axis])
        if end - begin > LEAF:
            axis = np.argmax(high - low)
            if high[axis] > low[axis]:
                members = order[begin:end].copy()
                by_centre = np.argsort(centres[members, axis], kind="mergesort")
                for k in range(end - begin):
                    order[begin + k] = members[by_centre[k]]
            middle = (begin + end) // 2
            child[at] = made
            piece[made, 0], piece[made, 1] = begin, middle
            piece[made + 1, 0], piece[made + 1, 1] = middle, end
            made += 2
        at += 1
    return boxes[:made], child[:made], piece[:made], order


@njit(cache=True, nogil=True)
def first_hits(corners, boxes, child, piece, order, origins, directions):
    """Distance (R,) along each ray to the first of the triangles, either side; inf where there is none."""
    out = np.full(len(origins), np.inf)
    stack = np.empty(128, np.int64)
    inverse = np.empty(3)
    for r in range(len(origins)):
        ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
        dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
        for axis in range(3):
            d = directions[r, axis]
            inverse[axis] = 1.0 / d if abs(d) > 1e-30 else 1e30
        best = np.inf
        size = 1
        stack[0] = 0
        while size > 0:
            size -= 1
            node = stack[size]
            if child[node] < 0:
                for k in range(piece[node, 0], piece[node, 1]):
                    t = order[k]
                    # Moeller and Trumbore 1997
                    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
                    ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
                    vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
                    px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
                    determinant = ux * px + uy * py + uz * pz
                    if determinant == 0:
                        continue
                    f = 1.0 / determinant
                    sx, sy, sz = ox - ax, oy - ay, oz - az
                    u = f * (sx * px + sy * py + sz * pz)
                    if u < 0 or u > 1:
                        continue
                    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
                    v = f * (dx * qx + dy * qy + dz * qz)
                    if v < 0 or u + v > 1:
                        continue
                    distance = f * (vx * qx + vy * qy + vz * qz)
                    if 0 < distance < best:
                        best = distance
                continue
            left = child[node]
            near_left = entry(boxes[left], ox, oy, oz, inverse, best)
            near_right = entry(boxes[left + 1], ox, oy, oz, inverse, best)
            # the nearer child goes on top
            if near_left <= near_right:
                if near_right < best:
                    stack[size] = left + 1
                    size += 1
                if near_left < best:
                    stack[size] = left
                    size += 1
            else:
                if near_left < best:
                    stack[size] = left
                    size += 1
                if near_right < best:
                    stack[size] = left + 1
                    size += 1
        out[r] = best
    return out


@njit(cache=True, nogil=True)
def entry(box, ox, oy, oz, inverse, best):
    """Where the ray enters the box; inf where it does not, or not before ``best``."""
    a, b = (box[0] - ox) * inverse[0], (box[3] - ox) * inverse[0]
    low, high = min(a, b), max(a, b)
    a, b = (box[1] - oy) * inverse[1], (box[4] - oy) * inverse[1]
    low, high = max(low, min(a, b)), min(high, max(a, b))
    a, b = (box[2] - oz) * inverse[2], (box[5] - oz) * inverse[2]
    low, high = max(low, min(a, b)), min(high, max(a, b))
    # a hair wider than the box: rounding must not lose a triangle that lies in one of its sides
    if high * (1.0 + 1e-6) + 1e-9 < max(low, 0.0) or low > best:
        return np.inf
    return max(low, 0.0)
