"""Compiled loops of the brush: walks over the graph of face records that stop where the brush ends."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def walk_within(start, neighbour, middle, centre, face, position, radius):  # pragma: no cover - compiled
    """Faces whose centre is within ``radius`` of ``position`` on ``face``, along centre - edge middle - centre paths.

    A Dijkstra with a binary heap; but for one byte a face, the work is that of the faces reached.
    """
    n = len(start) - 1
    settled = np.zeros(n, np.uint8)
    capacity = 256
    keys = np.empty(capacity, np.float64)
    nodes = np.empty(capacity, np.int64)
    found = np.empty(256, np.int64)
    count = 0
    keys[0] = 0.0
    nodes[0] = face
    size = 1
    while size > 0:
        distance = keys[0]
        here = nodes[0]
        size -= 1
        last_key = keys[size]
        last_node = nodes[size]
        i = 0
        while True:  # sift down
            child = 2 * i + 1
            if child >= size:
                break
            if child + 1 < size and keys[child + 1] < keys[child]:
                child += 1
            if keys[child] >= last_key:
                break
            keys[i] = keys[child]
            nodes[i] = nodes[child]
            i = child
        keys[i] = last_key
        nodes[i] = last_node
        if settled[here]:
            continue
        settled[here] = 1
        if count == len(found):
            grown = np.empty(2 * count, np.int64)
            grown[:count] = found
            found = grown
        found[count] = here
        count += 1
        from_x, from_y, from_z = centre[here, 0], centre[here, 1], centre[here, 2]
        if here == face:
            from_x, from_y, from_z = position[0], position[1], position[2]
        for e in range(start[here], start[here + 1]):
            there = neighbour[e]
            if settled[there]:
                continue
            x, y, z = middle[e, 0], middle[e, 1], middle[e, 2]
            step = np.sqrt((x - from_x) ** 2 + (y - from_y) ** 2 + (z - from_z) ** 2) + np.sqrt(
                (centre[there, 0] - x) ** 2 + (centre[there, 1] - y) ** 2 + (centre[there, 2] - z) ** 2
            )
            far = distance + step
            if far > radius:
                continue
            if size == capacity:
                more_keys = np.empty(2 * capacity, np.float64)
                more_nodes = np.empty(2 * capacity, np.int64)
                more_keys[:capacity] = keys
                more_nodes[:capacity] = nodes
                keys = more_keys
                nodes = more_nodes
                capacity *= 2
            i = size
            size += 1
            while i > 0:  # sift up
                parent = (i - 1) // 2
                if keys[parent] <= far:
                    break
                keys[i] = keys[parent]
                nodes[i] = nodes[parent]
                i = parent
            keys[i] = far
            nodes[i] = there
    return found[:count]


@njit(cache=True, nogil=True)
def flood(start, neighbour, bend, face, limit):  # pragma: no cover - compiled
    """Faces reached from ``face`` over edges that bend by at most ``limit``."""
    n = len(start) - 1
    seen = np.zeros(n, np.uint8)
    queue = np.empty(n, np.int64)
    queue[0] = face
    seen[face] = 1
    head = 0
    tail = 1
    while head < tail:
        here = queue[head]
        head += 1
        for e in range(start[here], start[here + 1]):
            there = neighbour[e]
            if seen[there] == 0 and bend[e] <= limit:
                seen[there] = 1
                queue[tail] = there
                tail += 1
    return queue[:tail].copy()
