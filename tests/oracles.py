"""Each equation as literal nested loops: slow, obvious, and independent of the code under test."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np


def finite_differences(record: Any, field: str, value: Callable[[Any], float], step: float) -> list[np.ndarray]:
    """Slopes of ``value(record)`` by all entries of a field of a frozen record: an array, or each of a tuple."""
    found = getattr(record, field)
    tuples = isinstance(found, tuple)
    slopes = [np.empty(np.shape(item)) for item in (found if tuples else (found,))]
    for index, slope in enumerate(slopes):
        for place in np.ndindex(slope.shape):
            ends = []
            for moved in (step, -step):
                arrays = [np.array(item) for item in (found if tuples else (found,))]
                arrays[index][place] += moved
                ends.append(value(replace(record, **{field: tuple(arrays) if tuples else arrays[0]})))
            slope[place] = (ends[0] - ends[1]) / (2 * step)
    return slopes


def correspondences(
    points, point_f, point_n, deformed, variance, template_f, template_n, label, pairs, s, sigma1, precision3,
    log_epsilon, normal_weight,
):  # fmt: skip
    """q[p][k] over the given pairs, a list of k per p (supplement, correspondence update)."""
    out = []
    for p, ks in enumerate(pairs):
        logits = []
        for k in ks:
            value = 0.0
            for axis in range(3):
                value -= 0.5 * (deformed[k][axis] - points[p][axis]) ** 2 / sigma1[axis]
                value -= 0.5 * variance[k][axis] / sigma1[axis]
            for d in range(len(precision3)):
                value -= 0.5 * precision3[d] * (template_f[k][d] - point_f[p][d]) ** 2
            value -= normal_weight * (1.0 - abs(sum(point_n[p][axis] * template_n[k][axis] for axis in range(3))))
            value += log_epsilon * (1.0 - s[p][label[k]])
            logits.append(value)
        top = max(logits)
        total = sum(math.exp(v - top) for v in logits)
        out.append([math.exp(v - top) / total for v in logits])
    return out


def deformations_fixed_point(mass, moment, mapped, edges, unary, smooth):
    """⟨D⟩ as the solution of the whole linear system (φ1 and φ2), edges are unordered pairs (k, k')."""
    n = len(mass)
    out = np.zeros((n, 3))
    for axis in range(3):
        matrix, right = np.zeros((n, n)), np.zeros(n)
        for k in range(n):
            matrix[k, k] += mass[k] / unary[axis]
            right[k] += moment[k][axis] / unary[axis]
        for a, b in edges:
            wanted = mapped[a][axis] - mapped[b][axis]
            matrix[a, a] += 1 / smooth[axis]
            matrix[b, b] += 1 / smooth[axis]
            matrix[a, b] -= 1 / smooth[axis]
            matrix[b, a] -= 1 / smooth[axis]
            right[a] += wanted / smooth[axis]
            right[b] -= wanted / smooth[axis]
        out[:, axis] = np.linalg.solve(matrix, right)
    return out


def segmentation_of_point(p, share, s, neighbours, attraction, log_epsilon, active):
    """s[p] given everything else (supplement, segmentation update); inactive parts have probability zero."""
    n_parts = len(share[p])
    logits = [-math.inf] * n_parts
    for part in range(n_parts):
        if not active[part]:
            continue
        logits[part] = log_epsilon * (1.0 - share[p][part])
        for other, pull in zip(neighbours[p], attraction[p], strict=True):
            phi = 1.0 / (1.0 + math.exp(-pull))
            logits[part] += s[other][part] * math.log(phi) + (1.0 - s[other][part]) * math.log(1.0 - phi)
    top = max(logits)
    total = sum(math.exp(v - top) for v in logits if v > -math.inf)
    return [math.exp(v - top) / total if v > -math.inf else 0.0 for v in logits]


def distance_to_triangle(p, a, b, c, steps=60):
    """Distance to a triangle over a barycentric grid: too large by at most an edge over ``steps``."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    inside = i + j <= steps
    u, v = i[inside] / steps, j[inside] / steps
    grid = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    return float(np.linalg.norm(grid - p, axis=1).min())
