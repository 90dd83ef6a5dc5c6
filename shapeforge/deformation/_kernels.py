"""Numba kernels of the mean-field updates (supplement 1).  Serial and ``nogil``: parallelism is over shapes."""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"cache": True, "nogil": True}


@njit(**_FAST)
def segment(part_share, offsets, neighbour, attraction, log_epsilon, active, evidence, sweeps, quiet, segmentation):
    """Segmentation update (supplement, s[p,l]), Gauss-Seidel over points; ``attraction`` (M,) is logit Φ per pair.

    After the first sweep only points are taken up again a neighbour of which has changed by more than ``quiet`` since.
    """
    n_points, n_parts = part_share.shape
    logits = np.empty(n_parts)
    restless = np.ones(n_points, np.bool_)
    for _ in range(sweeps):
        for p in range(n_points):
            if not restless[p]:
                continue
            restless[p] = False
            if evidence[p] >= 0:
                for part in range(n_parts):
                    segmentation[p, part] = 1.0 if part == evidence[p] else 0.0
                continue
            for part in range(n_parts):
                logits[part] = log_epsilon * (1.0 - part_share[p, part])
            for c in range(offsets[p], offsets[p + 1]):
                other, pull = np.uint32(neighbour[c]), attraction[c]
                for part in range(n_parts):
                    logits[part] += pull * segmentation[other, part]
            best = -np.inf
            for part in range(n_parts):
                if active[part] and logits[part] > best:
                    best = logits[part]
            total = 0.0
            for part in range(n_parts):
                logits[part] = np.exp(logits[part] - best) if active[part] else 0.0
                total += logits[part]
            change = 0.0
            for part in range(n_parts):
                value = logits[part] / total
                change = max(change, abs(value - segmentation[p, part]))
                segmentation[p, part] = value
            if not change <= quiet:
                for c in range(offsets[p], offsets[p + 1]):
                    restless[np.uint32(neighbour[c])] = True


@njit(**_FAST)
def deform(weight, pull, mapped, offsets, neighbour, smooth_precision, sweeps, deformed):
    """Deformation update (supplement, ⟨D⟩), Gauss-Seidel sweeps over ``deformed`` (K,3).

    ``weight`` (K,3) and ``pull`` (K,3) are the precision and the precision times the mean of what draws each point
    (φ1, and a prior); ``mapped`` (K,3) is A[part]·Y.
    """
    n = deformed.shape[0]
    right, inverse = np.empty((n, 3)), np.empty((n, 3))
    sx, sy, sz = smooth_precision[0], smooth_precision[1], smooth_precision[2]
    for k in range(n):
        x = y = z = 0.0
        for c in range(offsets[k], offsets[k + 1]):
            other = neighbour[c]
            x += mapped[other, 0]
            y += mapped[other, 1]
            z += mapped[other, 2]
        degree = offsets[k + 1] - offsets[k]
        right[k, 0] = pull[k, 0] + sx * (degree * mapped[k, 0] - x)
        right[k, 1] = pull[k, 1] + sy * (degree * mapped[k, 1] - y)
        right[k, 2] = pull[k, 2] + sz * (degree * mapped[k, 2] - z)
        for axis in range(3):
            precision = weight[k, axis] + smooth_precision[axis] * degree
            inverse[k, axis] = 1.0 / precision if precision > 0.0 else 0.0
            if degree == 0 and precision > 0.0:
                deformed[k, axis] = right[k, axis] / precision
    for sweep in range(sweeps):
        for step in range(n):
            # alternate the direction of the sweep: information travels both ways along the numbering
            k = step if sweep % 2 == 0 else n - 1 - step
            begin, end = offsets[k], offsets[k + 1]
            if begin == end:
                continue
            x = y = z = 0.0
            for c in range(begin, end):
                other = neighbour[c]
                x += deformed[other, 0]
                y += deformed[other, 1]
                z += deformed[other, 2]
            deformed[k, 0] = (right[k, 0] + sx * x) * inverse[k, 0]
            deformed[k, 1] = (right[k, 1] + sy * y) * inverse[k, 1]
            deformed[k, 2] = (right[k, 2] + sz * z) * inverse[k, 2]


@njit(**_FAST)
def carried(maps, label, vectors):
    """Vectors (K,3) under the matrix (L,3,3) of the part of each."""
    out = np.empty_like(vectors)
    for k in range(vectors.shape[0]):
        part = label[k]
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        for row in range(3):
            out[k, row] = maps[part, row, 0] * x + maps[part, row, 1] * y + maps[part, row, 2] * z
    return out


@njit(**_FAST)
def carried_normals(maps, label, normals):
    """Unit normals (K,3) of surfaces that the matrices (L,3,3) of their parts map: under the cofactors, which are the
    inverse transposed up to a positive factor, and also say where a matrix that flattens leaves the normal.
    """
    cofactors = np.empty_like(maps)
    for part in range(maps.shape[0]):
        for row in range(3):
            for column in range(3):
                r, s = (row + 1) % 3, (row + 2) % 3
                c, d = (column + 1) % 3, (column + 2) % 3
                cofactors[part, row, column] = maps[part, r, c] * maps[part, s, d] - maps[part, r, d] * maps[part, s, c]
        determinant = 0.0
        for column in range(3):
            determinant += maps[part, 0, column] * cofactors[part, 0, column]
        if determinant < 0.0:
            cofactors[part] *= -1.0
    out = carried(cofactors, label, normals)
    for k in range(out.shape[0]):
        length = max(np.sqrt(out[k, 0] ** 2 + out[k, 1] ** 2 + out[k, 2] ** 2), 1e-12)
        for row in range(3):
            out[k, row] /= length
    return out


@njit(**_FAST)
def residual_sums(
    offsets, template_index, q, points, deformed, point_descriptors, template_descriptors, label, n_parts
):
    """q-weighted sums of squared residuals: total q, (3,) positions, (D,) descriptors, and per part (L,2) q and r²."""
    n_descriptor = point_descriptors.shape[1]
    position = np.zeros(3)
    descriptor = np.zeros(n_descriptor)
    by_part = np.zeros((n_parts, 2))
    total = 0.0
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            weight = q[c]
            if weight < 1e-6:
                continue
            k = template_index[c]
            total += weight
            squared = 0.0
            for axis in range(3):
                difference = deformed[k, axis] - points[p, axis]
                position[axis] += weight * difference * difference
                squared += difference * difference
            by_part[label[k], 0] += weight
            by_part[label[k], 1] += weight * squared
            for d in range(n_descriptor):
                difference = template_descriptors[k, d] - point_descriptors[p, d]
                descriptor[d] += weight * difference * difference
    return total, position, descriptor, by_part


@njit(**_FAST)
def smoothness_sums(offsets, neighbour, deformed, mapped, keep):
    """Sum over pairs of kept template points of (δ)² (3,) and the number of pairs (φ2)."""
    total = np.zeros(3)
    count = 0
    for k in range(deformed.shape[0]):
        if not keep[k]:
            continue
        for c in range(offsets[k], offsets[k + 1]):
            other = neighbour[c]
            if other > k:
                count += 1
                for axis in range(3):
                    delta = deformed[k, axis] - deformed[other, axis] - mapped[k, axis] + mapped[other, axis]
                    total[axis] += delta * delta
    return total, count


@njit(**_FAST)
def pair_attraction(offsets, neighbour, descriptors, precision, low, high):
    """logit Φ (M,) of every neighbour pair, Φ = exp(-½ mean over the descriptor's entries), clamped to [low, high]."""
    out = np.empty(neighbour.shape[0])
    n_descriptor = descriptors.shape[1]
    least, most = -np.log(high), -np.log(low)
    most_attraction, least_attraction = np.log(high / (1.0 - high)), np.log(low / (1.0 - low))
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            total = 0.0
            for d in range(n_descriptor):
                difference = descriptors[p, d] - descriptors[neighbour[c], d]
                total += precision[d] * difference * difference
            cost = 0.5 * total / n_descriptor
            if cost <= least:
                out[c] = most_attraction
            elif cost >= most:
                out[c] = least_attraction
            else:
                phi = np.exp(-cost)
                out[c] = np.log(phi / (1.0 - phi))
    return out


@njit(**_FAST)
def pair_squares(offsets, neighbour, descriptors):
    """Sum over neighbour pairs (both directions) of squared descriptor differences (D,), for Σ5."""
    out = np.zeros(descriptors.shape[1])
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            for d in range(descriptors.shape[1]):
                difference = descriptors[p, d] - descriptors[neighbour[c], d]
                out[d] += difference * difference
    return out


@njit(**_FAST)
def energy_of_correspondence(
    offsets, template_index, q, costs, points, deformed, variance, precision, label, segmentation, log_epsilon
):
    """Expected φ1, φ3 and φ4 costs minus the entropy of q, in nats."""
    total = 0.0
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            if q[c] < 1e-13:
                continue
            k = template_index[c]
            cost = costs[c] - log_epsilon * (1.0 - segmentation[p, label[k]]) + np.log(q[c])
            for axis in range(3):
                difference = deformed[k, axis] - points[p, axis]
                cost += 0.5 * precision[axis] * (difference * difference + variance[k, axis])
            total += q[c] * cost
    return total


@njit(**_FAST)
def energy_of_smoothness(offsets, neighbour, deformed, variance, mapped, precision):
    """Expected φ2 cost, every pair once, in nats."""
    total = 0.0
    for k in range(deformed.shape[0]):
        for c in range(offsets[k], offsets[k + 1]):
            other = neighbour[c]
            if other <= k:
                continue
            for axis in range(3):
                delta = deformed[k, axis] - deformed[other, axis] - mapped[k, axis] + mapped[other, axis]
                total += 0.5 * precision[axis] * (delta * delta + variance[k, axis] + variance[other, axis])
    return total


@njit(**_FAST)
def energy_of_segmentation(offsets, neighbour, attraction, segmentation):
    """Expected φ5 cost (every pair once) minus the entropy of s, in nats, up to Σ ln(1-Φ)."""
    total = 0.0
    for p in range(offsets.shape[0] - 1):
        for part in range(segmentation.shape[1]):
            share = segmentation[p, part]
            if share <= 0.0:
                continue
            total += share * np.log(share)
            for c in range(offsets[p], offsets[p + 1]):
                total -= 0.5 * attraction[c] * share * segmentation[neighbour[c], part]
    return total
