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

REACH = 2.0
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

    ``points`` are in normal coordinates, NaN where nothing is known; they are met up to about ``tolerance``
    diagonals, as far as the family can: one that stays out of reach pulls no harder than one that is REACH tolerances
    away, or it would pull the shape out of shape. ``kept`` are rows over the logits of all layers side by side: these
    sums, each in units of its own standard deviation, stay as they are. The same numbers from ``rng`` make the result
    a smooth function of the points. Raises ValueError where no point is known, or the part of one is absent.
    """
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    absent = sorted({machine.part_names[part] for part in machine.part[known] if not start.exists[0, part]})
    if not len(known) or absent:
        got = f"points of {', '.join(absent)}, which the shape does not have" if absent else "none"
        raise ValueError(f"points: wanted at least one point of a part that the shape has, got {got}")
    around = codes_near(mixture, start, ENSEMBLE, rng=rng).astype(float)
    logits = np.concatenate([logit(layer[0]) for layer in start.layers])
    around[0] = np.clip(logits, -LARGEST_LOGIT, LARGEST_LOGIT)
    rows = np.zeros((0, around.shape[1])) if kept is None else kept / KEPT
    target, seed = to_values(points[known], machine.low, machine.high).reshape(-1), int(rng.integers(2**32))

    def seen(codes: np.ndarray) -> np.ndarray:
        first = sigmoid(codes[:, : machine.sizes[0]]).astype(machine.dtype)
        return expected_at(machine, first, known).reshape(len(codes), -1).astype(float)

    def solved(sd: np.ndarray) -> np.ndarray:
        wanted = np.concatenate([target / sd, rows @ around[0]])
        return smoothed(
            around, lambda codes: np.concatenate([seen(codes) / sd, codes @ rows.T], axis=1), wanted,
            rng=np.random.default_rng(seed), exact=1,
        )[:1]  # fmt: skip

    sd = np.full(len(target), tolerance / machine.diagonals_per_unit)
    missed = np.linalg.norm((seen(solved(sd)) - target).reshape(-1, 3), axis=1) * machine.diagonals_per_unit
    harder = np.sqrt(np.maximum(missed / (REACH * tolerance), 1.0))  # Huber's weights
    layers = mixture.layers(np.clip(solved(sd * np.repeat(harder, 3)), -LARGEST_LOGIT, LARGEST_LOGIT))
    return Latents(tuple(layer.astype(machine.dtype) for layer in layers), start.exists[:1])
