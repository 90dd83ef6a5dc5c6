"""Numba kernel: the first triangle that a ray meets."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def first_hits(corners, order, node_low, node_high, first, count, right, origins, directions):
    """Distance (R,) along each ray to the first of the triangles, either side; inf where there is none.

    The tree is that of ``_kernels_surface.build_tree``.
    """
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
            if count[node] > 0:
                for k in range(first[node], first[node] + count[node]):
                    t = order[k]
                    # Moeller and Trumbore 1997
                    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
                    ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
                    vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
                    px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
                    determinant = ux * px + uy * py + uz * pz
                    sides = (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)
                    if determinant * determinant <= 1e-24 * sides:  # no area, or seen edge-on
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
            near_left = entry(node_low, node_high, node + 1, ox, oy, oz, inverse, best)
            near_right = entry(node_low, node_high, right[node], ox, oy, oz, inverse, best)
            # the nearer child goes on top
            if near_left <= near_right:
                if near_right < best:
                    stack[size] = right[node]
                    size += 1
                if near_left < best:
                    stack[size] = node + 1
                    size += 1
            else:
                if near_left < best:
                    stack[size] = node + 1
                    size += 1
                if near_right < best:
                    stack[size] = right[node]
                    size += 1
        out[r] = best
    return out


@njit(cache=True, nogil=True)
def entry(node_low, node_high, node, ox, oy, oz, inverse, best):
    """Where the ray enters the node's box; inf where it does not, or not before ``best``."""
    a, b = (node_low[node, 0] - ox) * inverse[0], (node_high[node, 0] - ox) * inverse[0]
    low, high = min(a, b), max(a, b)
    a, b = (node_low[node, 1] - oy) * inverse[1], (node_high[node, 1] - oy) * inverse[1]
    low, high = max(low, min(a, b)), min(high, max(a, b))
    a, b = (node_low[node, 2] - oz) * inverse[2], (node_high[node, 2] - oz) * inverse[2]
    low, high = max(low, min(a, b)), min(high, max(a, b))
    # a hair wider than the box: rounding must not lose a triangle that lies in one of its sides
    if high * (1.0 + 1e-6) + 1e-9 < max(low, 0.0) or low > best:
        return np.inf
    return max(low, 0.0)
