"""Numba kernels of the mean-field updates (supplement 1).  Serial and ``nogil``: parallelism is over shapes."""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"cache": True, "nogil": True}


@njit(**_FAST)
def merge_candidates(by_point, by_template, n_points):
    """CSR over points of the union of (p -> k) rows and (k -> p) rows; entries < 0 are skipped.

    ``by_point`` (P, a) template points near each point, ``by_template`` (K, b) points near each template point.
    Returns offsets (P+1,), template indices (M,), sorted within each row.
    """
    counts = np.zeros(n_points + 1, np.int64)
    for p in range(by_point.shape[0]):
        for j in range(by_point.shape[1]):
            if by_point[p, j] >= 0:
                counts[p + 1] += 1
    for k in range(by_template.shape[0]):
        for j in range(by_template.shape[1]):
            if by_template[k, j] >= 0:
                counts[by_template[k, j] + 1] += 1
    offsets = np.cumsum(counts)
    fill = offsets[:-1].copy()
    raw = np.empty(offsets[-1], np.int32)
    for p in range(by_point.shape[0]):
        for j in range(by_point.shape[1]):
            if by_point[p, j] >= 0:
                raw[fill[p]] = by_point[p, j]
                fill[p] += 1
    for k in range(by_template.shape[0]):
        for j in range(by_template.shape[1]):
            p = by_template[k, j]
            if p >= 0:
                raw[fill[p]] = k
                fill[p] += 1
    out_offsets = np.zeros(n_points + 1, np.int64)
    used = 0
    for p in range(n_points):
        row = np.sort(raw[offsets[p] : offsets[p + 1]])
        previous = -1
        for k in row:
            if k != previous:
                raw[used] = k  # used never overtakes the row being read
                used += 1
                previous = k
        out_offsets[p + 1] = used
    return out_offsets, raw[:used].copy()


@njit(**_FAST)
def descriptor_costs(
    offsets, template_index, point_descriptors, template_descriptors, precision, point_normals, template_normals,
    normal_weight, out,
):  # fmt: skip
    """φ3 of every pair: ``out[c] = ½ (f_k - f_p)ᵀ precision (f_k - f_p) + normal_weight (1 - |n_k·n_p|)``."""
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            k = template_index[c]
            total = 0.0
            for d in range(precision.shape[0]):
                difference = template_descriptors[k, d] - point_descriptors[p, d]
                total += precision[d] * difference * difference
            cosine = 0.0
            for axis in range(3):
                cosine += point_normals[p, axis] * template_normals[k, axis]
            out[c] = 0.5 * total + normal_weight * (1.0 - abs(cosine))


@njit(**_FAST)
def correspond(
    offsets, template_index, costs, points, deformed, half_trace, precision, label, segmentation, log_epsilon, weight,
    q, part_share, mass, first_moment,
):  # fmt: skip
    """Correspondence update (supplement, q[p,k]); fills q (M,), part_share (P,L), mass (K,), first_moment (K,3).

    ``weight`` (P,) scales what a point contributes to the sums (a sample's share of the surface).
    """
    mass[:] = 0.0
    first_moment[:] = 0.0
    part_share[:] = 0.0
    for p in range(offsets.shape[0] - 1):
        begin, end = offsets[p], offsets[p + 1]
        if begin == end:
            continue
        best = -np.inf
        for c in range(begin, end):
            k = template_index[c]
            dx = deformed[k, 0] - points[p, 0]
            dy = deformed[k, 1] - points[p, 1]
            dz = deformed[k, 2] - points[p, 2]
            logit = -0.5 * (precision[0] * dx * dx + precision[1] * dy * dy + precision[2] * dz * dz)
            logit += -half_trace[k] - costs[c] + log_epsilon * (1.0 - segmentation[p, label[k]])
            q[c] = logit
            if logit > best:
                best = logit
        total = 0.0
        for c in range(begin, end):
            value = np.exp(q[c] - best)
            q[c] = value
            total += value
        for c in range(begin, end):
            value = q[c] / total
            q[c] = value
            k = template_index[c]
            part_share[p, label[k]] += value
            value *= weight[p]
            mass[k] += value
            first_moment[k, 0] += value * points[p, 0]
            first_moment[k, 1] += value * points[p, 1]
            first_moment[k, 2] += value * points[p, 2]


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
def deform(mass, first_moment, mapped, offsets, neighbour, unary_precision, smooth_precision, sweeps, deformed):
    """Deformation update (supplement, ⟨D⟩), Gauss-Seidel sweeps; ``mapped`` (K,3) is A[part]·Y.  Returns movement."""
    n_template = deformed.shape[0]
    pull = np.empty((n_template, 3))
    for k in range(n_template):
        for axis in range(3):
            total = unary_precision[axis] * first_moment[k, axis]
            for c in range(offsets[k], offsets[k + 1]):
                total += smooth_precision[axis] * (mapped[k, axis] - mapped[neighbour[c], axis])
            pull[k, axis] = total
    moved = 0.0
    for sweep in range(sweeps):
        moved = 0.0
        for step in range(n_template):
            # alternate the direction of the sweep: information travels both ways along the numbering
            k = step if sweep % 2 == 0 else n_template - 1 - step
            degree = offsets[k + 1] - offsets[k]
            squared = 0.0
            for axis in range(3):
                total = pull[k, axis]
                for c in range(offsets[k], offsets[k + 1]):
                    total += smooth_precision[axis] * deformed[neighbour[c], axis]
                precision = unary_precision[axis] * mass[k] + smooth_precision[axis] * degree
                if precision > 0.0:
                    value = total / precision
                    squared += (value - deformed[k, axis]) ** 2
                    deformed[k, axis] = value
            moved += np.sqrt(squared)
    return moved / max(n_template, 1)


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
    for p in range(n_points):
        begin, end = offsets[p], offsets[p + 1]
        best = -np.inf
        for c in range(begin, end):
            k = template_index[c]
            squared = 0.0
            for axis in range(3):
                difference = deformed[k, axis] - points[p, axis]
                squared += precision[axis] * difference * difference
            logit = -0.5 * squared - costs[c]
            part = label[k]
            # streaming log-sum-exp
            if density[p, part] == -np.inf:
                density[p, part] = logit
            elif logit > density[p, part]:
                density[p, part] = logit + np.log1p(np.exp(density[p, part] - logit))
            else:
                density[p, part] += np.log1p(np.exp(logit - density[p, part]))
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
    for p in range(offsets.shape[0] - 1):
        for c in range(offsets[p], offsets[p + 1]):
            total = 0.0
            for d in range(n_descriptor):
                difference = descriptors[p, d] - descriptors[neighbour[c], d]
                total += precision[d] * difference * difference
            phi = min(max(np.exp(-0.5 * total / n_descriptor), low), high)
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
            if q[c] <= 0.0:
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
