"""Compiled loops of the collection: cell grids, sample elimination, geodesics, local covariances, patches."""

from __future__ import annotations

import numpy as np
from numba import njit

UNREACHED = np.float32(np.inf)


@njit(cache=True, nogil=True)
def cell_grid(points, size):
    """Points sorted into cubes of edge ``size``: low corner, cells per axis, first of each cell (n+1,), order (P,)."""
    n = len(points)
    low = np.empty(3)
    shape = np.empty(3, np.int64)
    for axis in range(3):
        low[axis] = points[:, axis].min()
        shape[axis] = int((points[:, axis].max() - low[axis]) / size) + 1
    cell = np.empty(n, np.int64)
    first = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for i in range(n):
        x = int((points[i, 0] - low[0]) / size)
        y = int((points[i, 1] - low[1]) / size)
        z = int((points[i, 2] - low[2]) / size)
        cell[i] = (x * shape[1] + y) * shape[2] + z
        first[cell[i] + 1] += 1
    for c in range(len(first) - 1):
        first[c + 1] += first[c]
    order = np.empty(n, np.int64)
    fill = first[:-1].copy()
    for i in range(n):
        order[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return low, shape, first, order


@njit(cache=True, nogil=True)
def crowding_pairs(points, normals, radius):
    """For each point the points within ``radius`` that face the same way: rows (P+1,), columns, weights.

    The weight is Yuksel's (1 - d / radius)^8.
    """
    low, shape, first, order = cell_grid(points, radius)
    n = len(points)
    rows = np.zeros(n + 1, np.int64)
    capacity = 32 * n
    columns = np.empty(capacity, np.int32)
    weights = np.empty(capacity, np.float32)
    made = 0
    for i in range(n):
        x = int((points[i, 0] - low[0]) / radius)
        y = int((points[i, 1] - low[1]) / radius)
        z = int((points[i, 2] - low[2]) / radius)
        for cx in range(max(x - 1, 0), min(x + 2, shape[0])):
            for cy in range(max(y - 1, 0), min(y + 2, shape[1])):
                row = (cx * shape[1] + cy) * shape[2]
                for at in range(first[row + max(z - 1, 0)], first[row + min(z + 2, shape[2])]):
                    j = order[at]
                    if j == i:
                        continue
                    dx = points[i, 0] - points[j, 0]
                    dy = points[i, 1] - points[j, 1]
                    dz = points[i, 2] - points[j, 2]
                    squared = dx * dx + dy * dy + dz * dz
                    if squared >= radius * radius:
                        continue
                    agree = (
                        normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1] + normals[i, 2] * normals[j, 2]
                    )
                    if agree <= 0:  # the other side of a thin plate is another surface
                        continue
                    if made == capacity:
                        capacity *= 2
                        grown = np.empty(capacity, np.int32)
                        grown[:made] = columns
                        columns = grown
                        heavier = np.empty(capacity, np.float32)
                        heavier[:made] = weights
                        weights = heavier
                    w = 1.0 - np.sqrt(squared) / radius
                    w = w * w
                    w = w * w
                    columns[made] = j
                    weights[made] = w * w
                    made += 1
        rows[i + 1] = made
    return rows, columns[:made], weights[:made]


@njit(cache=True, nogil=True)
def sift(heap, place, load, at, size):
    """Move heap entry ``at`` down to where its load belongs (largest load on top)."""
    moving = heap[at]
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        if child + 1 < size and load[heap[child + 1]] > load[heap[child]]:
            child += 1
        if load[heap[child]] <= load[moving]:
            break
        heap[at] = heap[child]
        place[heap[at]] = at
        at = child
    heap[at] = moving
    place[moving] = at


@njit(cache=True, nogil=True)
def eliminate(rows, columns, weights, group, surplus):
    """Take the most crowded point away until each group g has lost ``surplus[g]`` (Yuksel 2015); True for the rest."""
    n = len(rows) - 1
    load = np.zeros(n, np.float32)
    for i in range(n):
        for at in range(rows[i], rows[i + 1]):
            load[i] += weights[at]
    heap = np.arange(n)
    place = np.arange(n)
    for at in range(n // 2 - 1, -1, -1):
        sift(heap, place, load, at, n)
    size = n
    stays = np.ones(n, np.bool_)
    while size > 0:
        top = heap[0]
        size -= 1
        heap[0] = heap[size]
        place[heap[0]] = 0
        if size > 0:
            sift(heap, place, load, 0, size)
        place[top] = -1
        if surplus[group[top]] == 0:
            continue
        surplus[group[top]] -= 1
        stays[top] = False
        for at in range(rows[top], rows[top + 1]):
            j = columns[at]
            if place[j] >= 0:
                load[j] -= weights[at]
                sift(heap, place, load, place[j], size)
    return stays


@njit(cache=True, nogil=True)
def local_covariances(points, others, reach):
    """Weighted covariances (P, 6) of ``others`` around each of ``points``: xx, xy, xz, yy, yz, zz.

    Weight 1 - d^2 / reach^2, so that nothing jumps when a point crosses the reach.
    """
    n = len(points)
    low, shape, first, order = cell_grid(others, reach)
    sorted_points = others[order]
    out = np.zeros((n, 6))
    scale = 1.0 / (reach * reach)
    for i in range(n):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = int(np.floor((px - low[0]) / reach))
        y = int(np.floor((py - low[1]) / reach))
        z = int(np.floor((pz - low[2]) / reach))
        z_low, z_high = max(z - 1, 0), min(z + 2, shape[2])
        total = 1e-9  # the point itself may not be among the others
        mx = my = mz = xx = xy = xz = yy = yz = zz = 0.0
        for cx in range(max(x - 1, 0), min(x + 2, shape[0])):
            for cy in range(max(y - 1, 0), min(y + 2, shape[1])):
                row = (cx * shape[1] + cy) * shape[2]
                if z_low >= z_high:
                    continue
                for at in range(first[row + z_low], first[row + z_high]):
                    dx = sorted_points[at, 0] - px
                    dy = sorted_points[at, 1] - py
                    dz = sorted_points[at, 2] - pz
                    w = 1.0 - (dx * dx + dy * dy + dz * dz) * scale
                    if w <= 0.0:
                        continue
                    total += w
                    wx, wy, wz = w * dx, w * dy, w * dz
                    mx += wx
                    my += wy
                    mz += wz
                    xx += wx * dx
                    xy += wx * dy
                    xz += wx * dz
                    yy += wy * dy
                    yz += wy * dz
                    zz += wz * dz
        mx, my, mz = mx / total, my / total, mz / total
        out[i, 0] = xx / total - mx * mx
        out[i, 1] = xy / total - mx * my
        out[i, 2] = xz / total - mx * mz
        out[i, 3] = yy / total - my * my
        out[i, 4] = yz / total - my * mz
        out[i, 5] = zz / total - mz * mz
    return out


@njit(cache=True, nogil=True)
def root(parent, i):
    """Representative of the set that holds ``i``, with path halving."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def bridges(points, tails, heads):
    """Shortest edges (B, 2) that join the pieces of the graph into one (Boruvka's rounds, all pairs of points)."""
    n = len(points)
    parent = np.arange(n)
    for e in range(len(tails)):
        a, b = root(parent, tails[e]), root(parent, heads[e])
        if a != b:
            parent[max(a, b)] = min(a, b)
    made = np.empty((n, 2), np.int64)
    n_made = 0
    best = np.empty(n)
    near = np.empty((n, 2), np.int64)
    piece = np.empty(n, np.int64)
    while True:
        pieces = 0
        for i in range(n):
            piece[i] = root(parent, i)
            pieces += piece[i] == i
        if pieces == 1:
            return made[:n_made]
        best[:] = np.inf
        # a pair farther apart in x than both pieces' best gaps cannot help
        for i in range(n):
            a = piece[i]
            for j in range(i + 1, n):
                b = piece[j]
                if a == b:
                    continue
                dx = points[j, 0] - points[i, 0]
                if dx * dx > best[a] and dx * dx > best[b]:
                    continue
                dy = points[j, 1] - points[i, 1]
                dz = points[j, 2] - points[i, 2]
                d = dx * dx + dy * dy + dz * dz
                if d < best[a]:
                    best[a] = d
                    near[a, 0], near[a, 1] = i, j
                if d < best[b]:
                    best[b] = d
                    near[b, 0], near[b, 1] = i, j
        for a in range(n):
            if piece[a] == a:
                p, q = root(parent, near[a, 0]), root(parent, near[a, 1])
                if p != q:
                    parent[max(p, q)] = min(p, q)
                    made[n_made, 0], made[n_made, 1] = near[a, 0], near[a, 1]
                    n_made += 1


@njit(cache=True, nogil=True)
def compressed(n, tails, heads, lengths):
    """Undirected edges as compressed rows: rows (n+1,), columns (2E,), lengths (2E,)."""
    rows = np.zeros(n + 1, np.int64)
    for e in range(len(tails)):
        rows[tails[e] + 1] += 1
        rows[heads[e] + 1] += 1
    for i in range(n):
        rows[i + 1] += rows[i]
    fill = rows[:-1].copy()
    columns = np.empty(rows[n], np.int32)
    out = np.empty(rows[n], np.float32)
    for e in range(len(tails)):
        a, b = tails[e], heads[e]
        columns[fill[a]] = b
        out[fill[a]] = lengths[e]
        fill[a] += 1
        columns[fill[b]] = a
        out[fill[b]] = lengths[e]
        fill[b] += 1
    return rows, columns, out


@njit(cache=True, nogil=True)
def distances_from(source, rows, columns, lengths, distance, heap_key, heap_node):
    """Dijkstra with a lazy binary heap; ``distance`` (n,) is overwritten, the heap arrays are working space."""
    distance[:] = UNREACHED
    distance[source] = 0.0
    heap_key[0] = 0.0
    heap_node[0] = source
    size = 1
    while size > 0:
        key, node = heap_key[0], heap_node[0]
        size -= 1
        last_key, last_node = heap_key[size], heap_node[size]
        at = 0
        while True:
            child = 2 * at + 1
            if child >= size:
                break
            if child + 1 < size and heap_key[child + 1] < heap_key[child]:
                child += 1
            if heap_key[child] >= last_key:
                break
            heap_key[at], heap_node[at] = heap_key[child], heap_node[child]
            at = child
        heap_key[at], heap_node[at] = last_key, last_node
        if key > distance[node]:
            continue
        for e in range(rows[node], rows[node + 1]):
            other = columns[e]
            through = key + lengths[e]
            if through < distance[other]:
                distance[other] = through
                at = size
                size += 1
                while at > 0:
                    above = (at - 1) // 2
                    if heap_key[above] <= through:
                        break
                    heap_key[at], heap_node[at] = heap_key[above], heap_node[above]
                    at = above
                heap_key[at], heap_node[at] = through, other


@njit(cache=True, nogil=True)
def mean_distances(rows, columns, lengths, n_sources, start):
    """Mean graph distance (n,) of every node to all, estimated from ``n_sources`` farthest-point sources.

    Each source stands for the nodes nearest to it, so the mean is over the surface and not over the sources.
    """
    n = len(rows) - 1
    all_distances = np.empty((n_sources, n), np.float32)
    heap_key = np.empty(len(columns) + 1, np.float32)
    heap_node = np.empty(len(columns) + 1, np.int64)
    nearest = np.full(n, UNREACHED)
    owner = np.zeros(n, np.int64)
    source = start
    for s in range(n_sources):
        distances_from(source, rows, columns, lengths, all_distances[s], heap_key, heap_node)
        for i in range(n):
            if all_distances[s, i] < nearest[i]:
                nearest[i] = all_distances[s, i]
                owner[i] = s
        source = np.argmax(nearest)
    share = np.zeros(n_sources)
    for i in range(n):
        share[owner[i]] += 1.0 / n
    mean = np.zeros(n)
    for s in range(n_sources):
        for i in range(n):
            mean[i] += share[s] * all_distances[s, i]
    return mean


@njit(cache=True, nogil=True)
def merge_regions(n, tails, heads, weights, order, scale, smallest):
    """Felzenszwalb and Huttenlocher's graph segmentation: region number (n,), counted from 0.

    Edges in ``order`` of rising weight join two regions when the weight is at most either's inner weight plus
    ``scale`` / size; then regions below ``smallest`` nodes join their nearest neighbour.
    """
    parent = np.arange(n)
    size = np.ones(n, np.int64)
    inner = np.zeros(n)
    for e in order:
        a, b = root(parent, tails[e]), root(parent, heads[e])
        if a == b:
            continue
        w = weights[e]
        if w <= min(inner[a] + scale / size[a], inner[b] + scale / size[b]):
            a, b = min(a, b), max(a, b)
            parent[b] = a
            size[a] += size[b]
            inner[a] = w
    for e in order:
        a, b = root(parent, tails[e]), root(parent, heads[e])
        if a != b and (size[a] < smallest or size[b] < smallest):
            a, b = min(a, b), max(a, b)
            parent[b] = a
            size[a] += size[b]
    number = np.full(n, -1, np.int64)
    out = np.empty(n, np.int32)
    count = 0
    for i in range(n):
        r = root(parent, i)
        if number[r] < 0:
            number[r] = count
            count += 1
        out[i] = number[r]
    return out
