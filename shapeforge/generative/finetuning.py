"""One step of fine-tuning: a loss through the unrolled mean field, and its gradient by a reverse pass written out.

Up: three rounds of H1, H2, H3 from the points.  H3 is sampled (straight-through: its derivative is that of its
probability).  Down: H2, H1, the points.  The loss asks the shape back twice, from H1 and from the sampled H3, and keeps
q(H3) near a prior p(H3 | E) so that the top stays a code worth drawing from:

    100 error(from H3) + 30 error(from H1) + β KL(q(H3) || p(H3 | E))

Errors are means over all coordinates, each part's divided by the share of shapes that have the part: a part seldom seen
is learned as well as a common one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.generative._kernels import reconstruction_loss
from shapeforge.generative.inference import DOWN_ROUNDS, UP_ROUNDS, gated_features, sigmoid
from shapeforge.generative.machine import FLOOR, BetaShapeMachine

TOP_WEIGHT, FIRST_WEIGHT, DIVERGENCE_WEIGHT = 100.0, 30.0, 1e-3
ROUNDING = 2e-3
"""Residuals count as |r|, rounded off below this (in the unit interval), so that the loss has a derivative."""


@dataclass(frozen=True, eq=False)
class TopPrior:
    """p(H3 | E): logit = bias + E weights.  Needed while learning only; the mixture of ``draw`` takes its place."""

    bias: Float[np.ndarray, " O"]
    weights: Float[np.ndarray, "L O"]


@dataclass(frozen=True, eq=False)
class Batch:
    """Shapes of one step: ``values`` (B, K, 3), ``exists`` (B, L), ``part_weight`` (L,) = 1 / share of the shapes with
    the part; ``noise`` (B, O) = sampled H3 minus its probability is drawn from ``uniform`` (B, O), or given."""

    values: Float[np.ndarray, "B K 3"]
    exists: Bool[np.ndarray, "B L"]
    part_weight: Float[np.ndarray, " L"]
    uniform: Float[np.ndarray, "B O"] | None = None
    noise: Float[np.ndarray, "B O"] | None = None


@dataclass(frozen=True)
class LossTerms:
    """``top`` and ``first`` are mean errors in the unit interval, ``divergence`` nats per shape, ``loss`` their sum."""

    loss: float
    top: float
    first: float
    divergence: float


def loss_and_gradient(
    machine: BetaShapeMachine, prior: TopPrior, batch: Batch, run: Callable = map
) -> tuple[LossTerms, dict[str, np.ndarray | tuple[np.ndarray, ...]]]:
    """The loss of a batch and its gradient by field name of the machine (and ``prior_bias``, ``prior_weights``).

    ``run`` maps a function over the parts: pass ``executor.map`` to use more threads.  The parts are independent and
    their results combined in order, so that the answer does not depend on it.
    """
    n, parts = len(batch.values), range(machine.n_parts)
    dtype = machine.bias1.dtype

    # --- up -------------------------------------------------------------------------------------------------------
    features = list(run(lambda l: gated_features(machine, batch.values, batch.exists, l), parts))  # noqa: E741
    flat = [weight.reshape(-1, weight.shape[2]) for weight in machine.weights]
    pull = machine.bias1 + np.concatenate(list(run(lambda l: features[l] @ flat[l], parts)), axis=1)  # noqa: E741
    known = (batch.exists - machine.existence_centre).astype(dtype)
    told = machine.bias3 + known @ machine.existence_top
    moved2 = [np.zeros((n, len(machine.bias2)), dtype)]
    moved3 = [np.zeros((n, len(machine.bias3)), dtype)]
    moved1 = []
    for _ in range(UP_ROUNDS):
        moved1.append(sigmoid(pull + moved2[-1] @ machine.weights12.T) - machine.centre1)
        second = sigmoid(machine.bias2 + moved1[-1] @ machine.weights12 + moved3[-1] @ machine.weights23.T)
        moved2.append(second - machine.centre2)
        moved3.append(sigmoid(told + moved2[-1] @ machine.weights23) - machine.centre3)
    top = moved3[-1] + machine.centre3
    noise = batch.noise
    if noise is None:
        noise = (batch.uniform < top).astype(dtype) - top if batch.uniform is not None else np.zeros_like(top)

    # --- down -----------------------------------------------------------------------------------------------------
    sampled = moved3[-1] + noise
    from_top = machine.bias2 + sampled @ machine.weights23.T
    down1, down2 = [np.zeros((n, len(machine.bias1)), dtype)], []
    for _ in range(DOWN_ROUNDS):
        down2.append(sigmoid(from_top + down1[-1] @ machine.weights12) - machine.centre2)
        down1.append(sigmoid(machine.bias1 + down2[-1] @ machine.weights12.T) - machine.centre1)

    # --- the points, and back to H1 --------------------------------------------------------------------------------
    per_coordinate = 1.0 / (n * 3 * machine.n_points)
    codes = np.concatenate([down1[-1], moved1[-1]])
    importance = np.repeat(np.array([TOP_WEIGHT, FIRST_WEIGHT]), n)

    def reconstruct(part: int):
        slot, weight = machine.units_of_part[part], flat[part]
        code = np.ascontiguousarray(codes[:, slot])
        both = code @ weight.T
        share = np.tile(batch.exists[:, part] * (batch.part_weight[part] * per_coordinate), 2)
        sums = reconstruction_loss(
            both, machine.rest[part].reshape(-1), machine.coordinates(batch.values, part),
            (share * importance).astype(dtype), dtype.type(ROUNDING), dtype.type(FLOOR),
        )  # fmt: skip
        return sums * share, code, both, both @ weight

    back = list(run(reconstruct, parts))
    errors = np.sum([item[0] for item in back], axis=0)
    d_codes = np.concatenate([item[3] for item in back], axis=1)

    # --- divergence -------------------------------------------------------------------------------------------------
    prior_logit = prior.bias + batch.exists.astype(dtype) @ prior.weights
    expected = sigmoid(prior_logit)
    sure, chance = (np.clip(q, 1e-7, 1 - 1e-7) for q in (top, expected))
    surplus = np.log(sure) - np.log1p(-sure) - np.log(chance) + np.log1p(-chance)
    divergence = sure * surplus + np.log1p(-sure) - np.log1p(-chance)
    d_prior = (DIVERGENCE_WEIGHT / n) * (expected - top)

    # --- reverse: down ----------------------------------------------------------------------------------------------
    w12, w23 = machine.weights12, machine.weights23
    g12, g23 = np.zeros_like(w12), np.zeros_like(w23)
    d_bias1, d_bias2 = np.zeros_like(machine.bias1), np.zeros_like(machine.bias2)
    d_from_top = np.zeros_like(from_top)
    d_one = d_codes[:n]
    for index in reversed(range(DOWN_ROUNDS)):
        d_one = d_one * _slope(down1[index + 1] + machine.centre1)
        d_bias1 += d_one.sum(axis=0)
        g12 += d_one.T @ down2[index]
        d_two = (d_one @ w12) * _slope(down2[index] + machine.centre2)
        d_from_top += d_two
        g12 += down1[index].T @ d_two
        d_one = d_two @ w12.T
    d_bias2 += d_from_top.sum(axis=0)
    g23 += d_from_top.T @ sampled

    # --- reverse: up ------------------------------------------------------------------------------------------------
    d_three = d_from_top @ w23 + (DIVERGENCE_WEIGHT / n) * surplus.astype(dtype)
    d_two = np.zeros_like(moved2[0])
    d_one = d_codes[n:]
    d_pull, d_told = np.zeros_like(pull), np.zeros_like(told)
    for index in reversed(range(UP_ROUNDS)):
        d_three = d_three * _slope(moved3[index + 1] + machine.centre3)
        d_told += d_three
        g23 += moved2[index + 1].T @ d_three
        d_two = (d_two + d_three @ w23.T) * _slope(moved2[index + 1] + machine.centre2)
        d_bias2 += d_two.sum(axis=0)
        g12 += moved1[index].T @ d_two
        g23 += d_two.T @ moved3[index]
        d_three = d_two @ w23
        d_one = (d_one + d_two @ w12.T) * _slope(moved1[index] + machine.centre1)
        d_pull += d_one
        g12 += d_one.T @ moved2[index]
        d_two, d_one = d_one @ w12, np.zeros_like(d_one)
    d_bias1 += d_pull.sum(axis=0)

    def gather(part: int):
        _, code, both, _ = back[part]
        slot, weight = machine.units_of_part[part], machine.weights[part]
        rows, columns = np.concatenate([both, features[part]]), np.concatenate([code, d_pull[:, slot]])
        return (rows.T @ columns).reshape(weight.shape), both.sum(axis=0).reshape(2, -1)

    gathered = list(run(gather, parts))
    terms = LossTerms(
        loss=float(importance @ errors + DIVERGENCE_WEIGHT * divergence.sum() / n),
        top=float(errors[:n].sum()),
        first=float(errors[n:].sum()),
        divergence=float(divergence.sum() / n),
    )
    return terms, {
        "weights": tuple(item[0] for item in gathered),
        "rest": tuple(item[1] for item in gathered),
        "bias1": d_bias1, "weights12": g12, "bias2": d_bias2, "weights23": g23,
        "bias3": d_told.sum(axis=0), "existence_top": known.T @ d_told,
        "prior_bias": d_prior.sum(axis=0), "prior_weights": batch.exists.astype(dtype).T @ d_prior,
    }  # fmt: skip


def _slope(probability: np.ndarray) -> np.ndarray:
    """Derivative of the sigmoid, from its value."""
    return probability * (1 - probability)
