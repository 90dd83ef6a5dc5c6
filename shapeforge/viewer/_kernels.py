"""Compiled loops of the brush: walks over the graph of face records that stop where the brush ends."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _push(keys, nodes, size, key, node):  # pragma: no cover - compiled
    """Put an entry into a binary heap of ``size`` entries; the arrays, longer ones where they were full."""
    if size == len(keys):
        more_keys = np.empty(2 * size, np.float64)
        more_nodes = np.empty(2 * size, np.int64)
        more_keys[:size] = keys
        more_nodes[:size] = nodes
        keys = more_keys
        nodes = more_nodes
    i = size
    while i > 0:
        parent = (i - 1) // 2
        if keys[parent] <= key:
            break
        keys[i] = keys[parent]
        nodes[i] = nodes[parent]
        i = parent
    keys[i] = key
    nodes[i] = node
    return keys, nodes


@njit(cache=True, nogil=True)
def _drop_first(keys, nodes, size):  # pragma: no cover - compiled
    """Take the first of ``size`` entries out of a binary heap."""
    last_key = keys[size - 1]
    last_node = nodes[size - 1]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size - 1:
            break
        if child + 1 < size - 1 and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= last_key:
            break
        keys[i] = keys[child]
        nodes[i] = nodes[child]
        i = child
    keys[i] = last_key
    nodes[i] = last_node


@njit(cache=True, nogil=True)
def walk_within(start, neighbour, middle, centre, face, position, radius):  # pragma: no cover - compiled
    """Faces whose centre is within ``radius`` of ``position`` on ``face``, along centre - edge middle - centre paths.

    A Dijkstra with a binary heap; but for one byte a face, the work is that of the faces reached.
    """
    n = len(start) - 1
    settled = np.zeros(n, np.uint8)
    keys = np.empty(256, np.float64)
    nodes = np.empty(256, np.int64)
    found = np.empty(256, np.int64)
    count = 0
    keys[0] = 0.0
    nodes[0] = face
    size = 1
    while size > 0:
        distance = keys[0]
        here = nodes[0]
        _drop_first(keys, nodes, size)
        size -= 1
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
            if far <= radius:
                keys, nodes = _push(keys, nodes, size, far, there)
                size += 1
    return found[:count]


@njit(cache=True, nogil=True)
def spread(start, neighbour, length, sources, ahead, limit):  # pragma: no cover - compiled
    """Shortest way (F,) to every face from ``sources``, which begin with ``ahead``; at most ``limit``."""
    far = np.full(len(start) - 1, limit)
    keys = np.empty(256, np.float64)
    nodes = np.empty(256, np.int64)
    size = 0
    for i in range(len(sources)):
        if ahead[i] < far[sources[i]]:
            far[sources[i]] = ahead[i]
            keys, nodes = _push(keys, nodes, size, ahead[i], sources[i])
            size += 1
    while size > 0:
        distance = keys[0]
        here = nodes[0]
        _drop_first(keys, nodes, size)
        size -= 1
        if distance > far[here]:
            continue
        for e in range(start[here], start[here + 1]):
            there = neighbour[e]
            way = distance + length[e]
            if way < far[there]:
                far[there] = way
                keys, nodes = _push(keys, nodes, size, way, there)
                size += 1
    return far


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
