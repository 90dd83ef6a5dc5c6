"""Numba kernels of the mean-field updates (supplement 1).  Serial and ``nogil``: parallelism is over shapes."""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"cache": True, "nogil": True}


@njit(**_FAST)
def correspond(
    offsets, template_index, costs, points, deformed, half_trace, precision, label, segmentation, log_epsilon,
    q, part_share, mass, first_moment,
):  # fmt: skip
    """Correspondence update (supplement, q[p,k]); fills q (M,), part_share (P,L), mass (K,), first_moment (K,3)."""
    mass[:] = 0.0
    first_moment[:] = 0.0
    part_share[:] = 0.0
    wx, wy, wz = 0.5 * precision[0], 0.5 * precision[1], 0.5 * precision[2]
    for p in range(offsets.shape[0] - 1):
        begin, end = offsets[p], offsets[p + 1]
        if begin == end:
            continue
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        best = -np.inf
        for c in range(begin, end):
            k = template_index[c]
            dx, dy, dz = deformed[k, 0] - x, deformed[k, 1] - y, deformed[k, 2] - z
            logit = log_epsilon * (1.0 - segmentation[p, label[k]]) - (wx * dx * dx + wy * dy * dy + wz * dz * dz)
            logit -= half_trace[k] + costs[c]
            q[c] = logit
            best = max(best, logit)
        total = 0.0
        for c in range(begin, end):
            # below e^-32 of the largest a pair carries nothing; written so that what is no number stays none
            value = 0.0 if q[c] - best < -32.0 else np.exp(q[c] - best)
            q[c] = value
            total += value
        scale = 1.0 / total
        for c in range(begin, end):
            if q[c] == 0.0:
                continue
            value = q[c] * scale
            q[c] = value
            k = template_index[c]
            part_share[p, label[k]] += value
            mass[k] += value
            first_moment[k, 0] += value * x
            first_moment[k, 1] += value * y
            first_moment[k, 2] += value * z


@njit(**_FAST)
def segment(part_share, offsets, neighbour, attraction, log_epsilon, active, evidence, sweeps, segmentation):
    """Segmentation update (supplement, s[p,l]), Gauss-Seidel over points; ``attraction`` (M,) is logit Φ per pair."""
    n_parts = part_share.shape[1]
    logits = np.empty(n_parts)
    for _ in range(sweeps):
        for p in range(part_share.shape[0]):
            if evidence[p] >= 0:
                for part in range(n_parts):
                    segmentation[p, part] = 1.0 if part == evidence[p] else 0.0
                continue
            for part in range(n_parts):
                logits[part] = log_epsilon * (1.0 - part_share[p, part])
            for c in range(offsets[p], offsets[p + 1]):
                other = neighbour[c]
                for part in range(n_parts):
                    logits[part] += attraction[c] * segmentation[other, part]
            best = -np.inf
            for part in range(n_parts):
                if active[part] and logits[part] > best:
                    best = logits[part]
            total = 0.0
            for part in range(n_parts):
                value = np.exp(logits[part] - best) if active[part] else 0.0
                segmentation[p, part] = value
                total += value
            for part in range(n_parts):
                segmentation[p, part] /= total


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
def explained_without(offsets, template_index, costs, points, deformed, precision, label, n_parts, cap):
    """Per point the loss (nats, at most ``cap``) of the best explanation when its own favourite part is taken away.

    From φ1 and φ3 alone: ``ln Σ_k exp(-cost)`` over all candidates minus the same over candidates of other parts.
    Returns favourite part (P,), loss (P,) and the log density of each part (P, L).
    """
    n_points = offsets.shape[0] - 1
    favourite = np.full(n_points, -1, np.int32)
    loss = np.zeros(n_points)
    density = np.full((n_points, n_parts), -np.inf)
    longest = 0
    for p in range(n_points):
        longest = max(longest, offsets[p + 1] - offsets[p])
    logits, top, sums = np.empty(longest), np.empty(n_parts), np.empty(n_parts)
    for p in range(n_points):
        begin, end = offsets[p], offsets[p + 1]
        best = -np.inf
        top[:] = -np.inf
        sums[:] = 0.0
        for c in range(begin, end):
            k = template_index[c]
            squared = 0.0
            for axis in range(3):
                difference = deformed[k, axis] - points[p, axis]
                squared += precision[axis] * difference * difference
            logits[c - begin] = -0.5 * squared - costs[c]
            top[label[k]] = max(top[label[k]], logits[c - begin])
        for c in range(begin, end):
            part = label[template_index[c]]
            below = logits[c - begin] - top[part]
            if not below < -32.0:
                sums[part] += np.exp(below)
        for part in range(n_parts):
            if top[part] > -np.inf:
                density[p, part] = top[part] + np.log(sums[part])
        for part in range(n_parts):
            if density[p, part] > best:
                best = density[p, part]
                favourite[p] = part
        if favourite[p] < 0:
            continue
        everything, others = 0.0, 0.0
        for part in range(n_parts):
            value = np.exp(density[p, part] - best)
            everything += value
            if part != favourite[p]:
                others += value
        loss[p] = min(cap, np.log(everything / others)) if others > 0.0 else cap
    return favourite, loss, density


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
