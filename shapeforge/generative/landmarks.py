"""One shape that follows its landmarks: some of its points are put somewhere, and the rest goes along as in the family.

Draws through given points (``evidence``) without the drawing: the shape moves as an ensemble around it does when that
is told where the points are.  Sliders' values can be kept meanwhile.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from shapeforge.generative.draw import LARGEST_LOGIT, Mixture, codes_near
from shapeforge.generative.evidence import ENSEMBLE, smoothed
from shapeforge.generative.inference import Latents, expected_at, logit, sigmoid
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import to_values

KEPT = 0.02
"""Standard deviations (of what is kept) by which it may move after all."""


def follow(
    machine: BetaShapeMachine,
    mixture: Mixture,
    start: Latents,
    points: Float[np.ndarray, "K 3"],
    *,
    rng: np.random.Generator,
    kept: Float[np.ndarray, "H A"] | None = None,
    tolerance: float = 0.005,
) -> Latents:
    """The latents of one shape, the most likely change of ``start`` when these ``points`` are where they are given.

    ``points`` are in normal coordinates, NaN where nothing is known; they are met up to about ``tolerance`` diagonals,
    as far as the family can.  ``kept`` are rows over the logits of all layers side by side: these sums, each in units
    of its own standard deviation, stay as they are.  The same numbers from ``rng`` make the result a smooth function of
    the points.  Raises ValueError where no point is known, or the part of one is absent.
    """
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    absent = sorted({machine.part_names[part] for part in machine.part[known] if not start.exists[0, part]})
    if not len(known) or absent:
        got = f"points of {', '.join(absent)}, which the shape does not have" if absent else "none"
        raise ValueError(f"points: wanted at least one point of a part that the shape has, got {got}")
    sd, rows = tolerance / machine.diagonals_per_unit, np.zeros((0, len(mixture.codes[0]))) if kept is None else kept
    code = np.concatenate([logit(layer[:1]) for layer in start.layers], axis=1)[0].astype(float)
    target = np.concatenate([to_values(points[known], machine.low, machine.high).reshape(-1) / sd, rows @ code / KEPT])

    def see(codes: np.ndarray) -> np.ndarray:
        first = sigmoid(codes[:, : machine.sizes[0]]).astype(machine.dtype)
        seen = expected_at(machine, first, known).reshape(len(codes), -1) / sd
        return np.concatenate([seen, codes @ rows.T / KEPT], axis=1)

    around = codes_near(mixture, start, ENSEMBLE, rng=rng).astype(float)
    around[0] = code
    found = smoothed(around, see, target, rng=rng, exact=1)[:1]
    layers = mixture.layers(np.clip(found, -LARGEST_LOGIT, LARGEST_LOGIT))
    return Latents(tuple(layer.astype(machine.dtype) for layer in layers), start.exists[:1])
