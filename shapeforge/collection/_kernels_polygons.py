"""Compiled cutting of polygons into triangles."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def turn(p, a, b, c):
    """Twice the signed area of the triangle a, b, c of the plane points p."""
    return (p[b, 0] - p[a, 0]) * (p[c, 1] - p[a, 1]) - (p[b, 1] - p[a, 1]) * (p[c, 0] - p[a, 0])


@njit(cache=True, nogil=True)
def flatten(vertices, corners):
    """Corners in the plane of the polygon's Newell normal, seen so that the polygon turns anticlockwise."""
    n = len(corners)
    origin = vertices[corners[0]]
    nx = ny = nz = 0.0
    for i in range(n):
        a = vertices[corners[i]] - origin
        b = vertices[corners[(i + 1) % n]] - origin
        nx += a[1] * b[2] - a[2] * b[1]
        ny += a[2] * b[0] - a[0] * b[2]
        nz += a[0] * b[1] - a[1] * b[0]
    plane = np.empty((n, 2))
    ax, ay, az = abs(nx), abs(ny), abs(nz)
    # dropping the largest axis keeps the shape's topology and needs no root
    for i in range(n):
        x, y, z = vertices[corners[i]] - origin
        if ax >= ay and ax >= az:
            plane[i, 0], plane[i, 1] = (y, z) if nx >= 0 else (z, y)
        elif ay >= az:
            plane[i, 0], plane[i, 1] = (z, x) if ny >= 0 else (x, z)
        else:
            plane[i, 0], plane[i, 1] = (x, y) if nz >= 0 else (y, x)
    return plane


@njit(cache=True, nogil=True)
def clip_ears(plane, out):
    """Cut the polygon ``plane`` (n, 2), anticlockwise, into n-2 triangles ``out`` of corner numbers."""
    n = len(plane)
    convex = True
    for i in range(n):
        if turn(plane, i, (i + 1) % n, (i + 2) % n) < 0:
            convex = False
            break
    if convex:
        for i in range(n - 2):
            out[i, 0], out[i, 1], out[i, 2] = 0, i + 1, i + 2
        return
    following = np.empty(n, np.int64)
    previous = np.empty(n, np.int64)
    for i in range(n):
        following[i] = (i + 1) % n
        previous[i] = (i - 1) % n
    left = n
    made = 0
    current = 0
    stuck = 0
    while left > 3:
        a, b, c = previous[current], current, following[current]
        area = turn(plane, a, b, c)
        ear = area > 0
        if ear:
            other = following[c]
            while other != a:
                # a corner on the border counts as inside, unless it coincides with a corner of the ear (a bridge)
                if (
                    turn(plane, a, b, other) >= 0
                    and turn(plane, b, c, other) >= 0
                    and turn(plane, c, a, other) >= 0
                    and not (plane[other, 0] == plane[a, 0] and plane[other, 1] == plane[a, 1])
                    and not (plane[other, 0] == plane[b, 0] and plane[other, 1] == plane[b, 1])
                    and not (plane[other, 0] == plane[c, 0] and plane[other, 1] == plane[c, 1])
                ):
                    ear = False
                    break
                other = following[other]
        # after one idle turn accept flat corners, after two whatever comes (a polygon that crosses itself)
        if ear or (stuck > left and area == 0) or stuck > 2 * left:
            out[made, 0], out[made, 1], out[made, 2] = a, b, c
            made += 1
            following[a] = c
            previous[c] = a
            left -= 1
            stuck = 0
            current = c
        else:
            stuck += 1
            current = c
    out[made, 0], out[made, 1], out[made, 2] = previous[current], current, following[current]


@njit(cache=True, nogil=True)
def cut_polygons(vertices, corners, counts):
    """Triangles (N, 3) and their records (N,); a record of n >= 3 corners gives n-2, less those that repeat one."""
    total = 0
    for count in counts:
        total += max(count - 2, 0)
    triangles = np.empty((total, 3), np.int64)
    record = np.empty(total, np.int64)
    made = 0
    start = 0
    for k in range(len(counts)):
        n = counts[k]
        if n == 3:
            a, b, c = corners[start], corners[start + 1], corners[start + 2]
            if a != b and b != c and a != c:
                triangles[made, 0], triangles[made, 1], triangles[made, 2] = a, b, c
                record[made] = k
                made += 1
        elif n > 3:
            polygon = corners[start : start + n]
            pieces = np.empty((n - 2, 3), np.int64)
            clip_ears(flatten(vertices, polygon), pieces)
            for piece in pieces:
                a, b, c = polygon[piece[0]], polygon[piece[1]], polygon[piece[2]]
                if a != b and b != c and a != c:
                    triangles[made, 0], triangles[made, 1], triangles[made, 2] = a, b, c
                    record[made] = k
                    made += 1
        start += n
    return triangles[:made], record[:made]
