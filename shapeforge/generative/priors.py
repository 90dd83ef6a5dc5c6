"""The print's priors on the parameters (§5): points near each other are pulled alike (λ1), weights are few (λ2).

Both are steps of their own beside Adam's (decoupled, as its weight decay is): what Adam divides a slope by is of the
size of the slope, so that inside it a prior would count most where the data say least.  The print adds up over all
neighbours within a radius, of which there are the more the denser the points; here their mean counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from shapeforge.generative._kernels import neighbour_signs, prior_step
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import Observations

RADIUS = 0.1
"""Neighbours are nearer than this share of the largest distance between two points of a shape, on average."""

SHAPES_TO_MEASURE = 40
ENOUGH = 500  # points, to measure how large a shape is
EVERY = 10
"""Steps of learning between two of the priors' (each then counts for as many)."""

BLOCK = 256


@dataclass(frozen=True)
class Strengths:
    """``decay``: weight decay of all pairwise weights, a share per unit of step size.  ``smooth`` is the print's λ1 on
    what the points and H1 say to each other, ``sparse`` its λ2, on all pairwise weights; 0 leaves a prior out."""

    decay: float = 0.1
    smooth: float = 0.0
    sparse: float = 0.0


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Points of one part near each other: those of point i are ``index[start[i] : start[i + 1]]``."""

    start: Int[np.ndarray, " n1"]
    index: Int[np.ndarray, " e"]


def near_points(observations: Observations, radius: float = RADIUS) -> tuple[Neighbours, ...]:
    """For every part, which of its points lie near each other, by their mean distance over (at most 40 of) the shapes
    that have the part."""
    chosen = np.unique(np.linspace(0, observations.n_shapes - 1, SHAPES_TO_MEASURE).astype(int))
    values, exists = observations.values[chosen].astype(np.float64), observations.exists[chosen]
    present = exists[:, observations.part]
    thinned = (own[there][:: 1 + there.sum() // ENOUGH] for own, there in zip(values, present, strict=True))
    reach = radius * max(float(cdist(points, points).max()) for points in thinned if len(points))
    found = []
    for part in range(exists.shape[1]):
        own = values[:, observations.part == part]
        having = np.flatnonzero(exists[:, part])
        n = own.shape[1]
        mean = sum((cdist(own[t], own[t]) for t in having), np.zeros((n, n))) / max(len(having), 1)
        near = (mean < reach) & ~np.eye(n, dtype=bool) & bool(len(having))
        start = np.concatenate([[0], np.cumsum(near.sum(axis=1))]).astype(np.int32)
        found.append(Neighbours(start, np.nonzero(near)[1].astype(np.int32)))
    return tuple(found)


def smoothness(weights: Float[np.ndarray, "2 F M"], near: Neighbours) -> float:
    """Σ over points of the mean over their neighbours of |θ - θ'|, all weights of a part: what λ1 multiplies."""
    rows = np.ascontiguousarray(weights.reshape(2, len(near.start) - 1, -1).transpose(1, 0, 2))
    total = 0.0
    for i, (first, stop) in enumerate(zip(near.start[:-1], near.start[1:], strict=True)):
        if stop > first:
            total += float(np.abs(rows[i] - rows[near.index[first:stop]]).sum() / (stop - first))
    return total


def apply_priors(
    machine: BetaShapeMachine, near: tuple[Neighbours, ...] | None, strengths: Strengths, rate: float
) -> None:
    """One step of size ``rate`` along the priors' slopes, in place; without ``near`` λ1 is left out."""
    for part, weight in enumerate(machine.weights):
        rows = weight.reshape(2, weight.shape[1] // 3, -1)
        n = rows.shape[1]
        if n == 0:
            continue
        for half in rows:
            signs = np.zeros(half.shape, np.int32)
            per_sign = np.zeros(n, weight.dtype)
            if near is not None and strengths.smooth:
                start, index = near[part].start, near[part].index
                # Both ends of a pair are moved, each by the mean over its own neighbours: twice the slope of one sum.
                per_sign = (2 * rate * strengths.smooth / np.maximum(np.diff(start), 1)).astype(weight.dtype)
                neighbour_signs(half, start, index, np.empty((n, BLOCK), weight.dtype), signs)
            prior_step(half, signs, per_sign, weight.dtype.type(rate * strengths.sparse))
    if strengths.sparse:
        for coupling in machine.couplings:
            size = np.abs(coupling) - coupling.dtype.type(rate * strengths.sparse)
            coupling[...] = np.sign(coupling) * np.maximum(size, 0)
