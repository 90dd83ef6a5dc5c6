"""Compiled loops over sparse pairs: which pairs (p, k) carry probability, and neighbours made symmetric."""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"cache": True, "nogil": True}


@njit(**_FAST)
def merge_pairs(mine, theirs, n_rows):
    """CSR over rows of the union of (row -> column) and (column -> row) lists; entries < 0 are skipped.

    ``mine`` (rows, a) lists columns, ``theirs`` (columns, b) lists rows.  Returns offsets (rows+1,) and columns (M,),
    ascending within each row and none twice.
    """
    starts = np.zeros(n_rows + 1, np.int64)
    for k in range(theirs.shape[0]):
        for j in range(theirs.shape[1]):
            if theirs[k, j] >= 0:
                starts[theirs[k, j] + 1] += 1
    for p in range(n_rows):
        starts[p + 1] += starts[p]
    fill = starts[:-1].copy()
    turned = np.empty(starts[-1], np.int32)  # ascending within each row, because k ascends
    for k in range(theirs.shape[0]):
        for j in range(theirs.shape[1]):
            p = theirs[k, j]
            if p >= 0:
                turned[fill[p]] = k
                fill[p] += 1
    own = np.empty(mine.shape[1], np.int32)
    offsets = np.zeros(n_rows + 1, np.int64)
    columns = np.empty(len(turned) + mine.size, np.int32)
    used = 0
    for p in range(n_rows):
        n_own = 0
        for j in range(mine.shape[1]):
            k = mine[p, j]
            if k >= 0:
                at = n_own
                while at > 0 and own[at - 1] > k:
                    own[at] = own[at - 1]
                    at -= 1
                own[at] = k
                n_own += 1
        at, c, previous = 0, starts[p], -1
        while at < n_own or c < starts[p + 1]:
            if c == starts[p + 1] or (at < n_own and own[at] < turned[c]):
                k = own[at]
                at += 1
            else:
                k = turned[c]
                c += 1
            if k != previous:
                columns[used] = k
                used += 1
                previous = k
        offsets[p + 1] = used
    return offsets, columns[:used].copy()


@njit(**_FAST)
def refilled_pairs(offsets, template_index, costs, alive, rows, nearest):
    """The pairs without template points that are not ``alive`` (K,); point ``rows[i]`` gets ``nearest[i]`` as well.

    Returns CSR like ``merge_pairs``, and the ``costs`` (M,) of the pairs, NaN of those that are new; ``rows`` ascend.
    """
    n_points = offsets.shape[0] - 1
    out_offsets = np.zeros(n_points + 1, np.int64)
    columns, kept = np.empty(len(template_index) + nearest.size, np.int32), np.empty(len(template_index) + nearest.size)
    used = 0
    i = 0
    for p in range(n_points):
        begin = used
        for c in range(offsets[p], offsets[p + 1]):
            if alive[template_index[c]]:
                columns[used], kept[used] = template_index[c], costs[c]
                used += 1
        if i < len(rows) and rows[i] == p:
            for k in nearest[i]:
                at = used
                while at > begin and columns[at - 1] > k:
                    at -= 1
                if at > begin and columns[at - 1] == k:
                    continue
                for move in range(used, at, -1):
                    columns[move], kept[move] = columns[move - 1], kept[move - 1]
                columns[at], kept[at] = k, np.nan
                used += 1
            i += 1
        out_offsets[p + 1] = used
    return out_offsets, columns[:used].copy(), kept[:used].copy()


@njit(**_FAST, fastmath={"reassoc", "contract", "nsz"})
def pair_costs(
    offsets,
    template_index,
    point_descriptors,
    template_descriptors,
    point_normals,
    template_normals,
    normal_weight,
    out,
):
    """φ3 of every pair whose ``out[c]`` is NaN: ``|f_k - f_p|² + normal_weight (1 - |n_k·n_p|)``, descriptors scaled
    beforehand."""
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            if not np.isnan(out[c]):
                continue
            k = np.uint32(template_index[c])
            total = 0.0
            for d in range(point_descriptors.shape[1]):
                difference = template_descriptors[k, d] - point_descriptors[p, d]
                total += difference * difference
            cosine = 0.0
            for axis in range(3):
                cosine += point_normals[p, axis] * template_normals[k, axis]
            out[c] = total + normal_weight * (1.0 - abs(cosine))
