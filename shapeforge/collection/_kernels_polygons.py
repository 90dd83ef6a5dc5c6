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
    o = corners[0]
    nx = ny = nz = 0.0
    for i in range(n):
        a = corners[i]
        b = corners[i + 1] if i + 1 < n else o
        ax, ay, az = vertices[a, 0] - vertices[o, 0], vertices[a, 1] - vertices[o, 1], vertices[a, 2] - vertices[o, 2]
        bx, by, bz = vertices[b, 0] - vertices[o, 0], vertices[b, 1] - vertices[o, 1], vertices[b, 2] - vertices[o, 2]
        nx += ay * bz - az * by
        ny += az * bx - ax * bz
        nz += ax * by - ay * bx
    # dropping the axis along which the normal is longest keeps the polygon's order, and needs no root
    first, second, along = 0, 1, nz
    if abs(nx) >= abs(ny) and abs(nx) >= abs(nz):
        first, second, along = 1, 2, nx
    elif abs(ny) >= abs(nz):
        first, second, along = 2, 0, ny
    if along < 0:
        first, second = second, first
    plane = np.empty((n, 2))
    for i in range(n):
        plane[i, 0] = vertices[corners[i], first] - vertices[o, first]
        plane[i, 1] = vertices[corners[i], second] - vertices[o, second]
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
    for k in range(len(counts)):
        total += max(counts[k] - 2, 0)
    triangles = np.empty((total, 3), np.int64)
    record = np.empty(total, np.int64)
    made = 0
    start = 0
    for k in range(len(counts)):
        n = counts[k]
        first = made
        if n == 3:
            for i in range(3):
                triangles[made, i] = corners[start + i]
            made += 1
        elif n > 3:
            clip_ears(flatten(vertices, corners[start : start + n]), triangles[made : made + n - 2])
            for piece in range(made, made + n - 2):
                for i in range(3):
                    triangles[piece, i] = corners[start + triangles[piece, i]]
            made += n - 2
        # what names a vertex twice is left out
        end = made
        made = first
        for piece in range(first, end):
            a, b, c = triangles[piece, 0], triangles[piece, 1], triangles[piece, 2]
            if a != b and b != c and a != c:
                triangles[made, 0], triangles[made, 1], triangles[made, 2] = a, b, c
                record[made] = k
                made += 1
        start += n
    return triangles[:made], record[:made]
