"""One step of fine-tuning: a loss through the unrolled mean field, and its gradient by a reverse pass written out.

Up: three rounds through all layers from the points.  The top (H3 in the print) is sampled (straight-through: its
derivative is that of its probability).  Down: the layers below, the points.  The loss asks the shape back twice, from
H1 and from the sampled top, and keeps q(top) near a prior p(top | E) so that the top stays a code worth drawing from:

    100 error(from the top) + 100 error(from H1) + β KL(q(top) || p(top | E))

Errors are means over all coordinates, each part's divided by the share of shapes that have the part: a part seldom seen
is learned as well as a common one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.generative._kernels import reconstruction_loss
from shapeforge.generative.inference import DOWN_ROUNDS, UP_ROUNDS, gated_features, settle, sigmoid
from shapeforge.generative.machine import FLOOR, BetaShapeMachine

TOP_WEIGHT, FIRST_WEIGHT, DIVERGENCE_WEIGHT = 100.0, 100.0, 1e-3
ROUNDING = 2e-3
"""Residuals count as |r|, rounded off below this (in the unit interval), so that the loss has a derivative."""


@dataclass(frozen=True, eq=False)
class TopPrior:
    """p(top | E): logit = bias + E weights.  Needed while learning only; the mixture of ``draw`` takes its place."""

    bias: Float[np.ndarray, " O"]
    weights: Float[np.ndarray, "L O"]


@dataclass(frozen=True, eq=False)
class Batch:
    """Shapes of one step: ``values`` (B, K, 3), ``exists`` (B, L), ``part_weight`` (L,) = 1 / share of the shapes with
    the part; ``noise`` (B, O) = the sampled top minus its probability is drawn from ``uniform`` (B, O), or given."""

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
    dtype = machine.dtype

    # --- up -------------------------------------------------------------------------------------------------------
    features = list(run(lambda part: gated_features(machine, batch.values, batch.exists, part), parts))
    flat = [weight.reshape(-1, weight.shape[2]) for weight in machine.weights]
    said = np.concatenate(list(run(lambda part: features[part] @ flat[part], parts)), axis=1)
    known = (batch.exists - machine.existence_centre).astype(dtype)
    totals = list(machine.biases)
    totals[0] = totals[0] + said
    totals[-1] = totals[-1] + known @ machine.existence_top
    last = machine.n_layers - 1
    moved: list[np.ndarray | None] = [None] * machine.n_layers
    up: list[_Step] = []
    for _ in range(UP_ROUNDS if last else 1):
        for index in range(machine.n_layers):
            moved[index] = settle(machine, index, totals[index], moved)
            up.append(_Step(index, list(moved)))
    first, top = moved[0], moved[-1] + machine.centres[-1]
    noise = batch.noise
    if noise is None:
        noise = (batch.uniform < top).astype(dtype) - top if batch.uniform is not None else np.zeros_like(top)

    # --- down -----------------------------------------------------------------------------------------------------
    moved = [None] * last + [moved[-1] + noise]
    down: list[_Step] = []
    for _ in range(DOWN_ROUNDS if last > 1 else 1):
        for index in reversed(range(last)):
            moved[index] = settle(machine, index, machine.biases[index], moved)
            down.append(_Step(index, list(moved)))

    # --- the points, and back to H1 --------------------------------------------------------------------------------
    per_coordinate = 1.0 / (n * 3 * machine.n_points)
    codes = np.concatenate([moved[0], first])
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

    # --- reverse ----------------------------------------------------------------------------------------------------
    back_to = _Slopes.zero(machine)
    d_down: list[np.ndarray | None] = [d_codes[:n], *[None] * last]
    back_to.through(down, d_down, of_sampled=True)
    d_up: list[np.ndarray | None] = [d_codes[n:], *[None] * last]
    d_up[-1] = _plus(d_up[-1], d_down[-1] + (DIVERGENCE_WEIGHT / n) * surplus.astype(dtype))
    back_to.through(up, d_up)
    d_said, d_told = back_to.inputs[0], back_to.inputs[-1]

    def gather(part: int):
        _, code, both, _ = back[part]
        slot, weight = machine.units_of_part[part], machine.weights[part]
        rows, columns = np.concatenate([both, features[part]]), np.concatenate([code, d_said[:, slot]])
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
        "biases": tuple(back_to.biases), "couplings": tuple(back_to.couplings), "existence_top": known.T @ d_told,
        "prior_bias": d_prior.sum(axis=0), "prior_weights": batch.exists.astype(dtype).T @ d_prior,
    }  # fmt: skip


class _Step(NamedTuple):
    """One layer was settled; ``moved`` is every layer (less its centre, None: at its centre) just after that."""

    index: int
    moved: list[np.ndarray | None]


@dataclass(eq=False)
class _Slopes:
    """Derivatives of the loss while the steps are gone through backwards: of ``biases`` and ``couplings`` (summed over
    all steps), and of the ``inputs`` (B, size) that came in going up from the points and from E."""

    machine: BetaShapeMachine
    biases: list[np.ndarray]
    couplings: list[np.ndarray]
    inputs: list[np.ndarray | None]

    @classmethod
    def zero(cls, machine: BetaShapeMachine) -> _Slopes:
        biases, couplings = map(np.zeros_like, machine.biases), map(np.zeros_like, machine.couplings)
        return cls(machine, list(biases), list(couplings), [None] * machine.n_layers)

    def through(self, steps: list[_Step], slopes: list[np.ndarray | None], of_sampled: bool = False) -> None:
        """Back through ``steps``; ``slopes`` are those of the layers after the last step (None: 0), and become those
        before the first.  With ``of_sampled`` the top was given (sampled): nothing came in from points and E.
        """
        machine = self.machine
        for step in reversed(steps):
            index, slope = step.index, slopes[step.index]
            slopes[index] = None
            if slope is None:
                continue
            probability = step.moved[index] + machine.centres[index]
            slope = slope * (probability * (1 - probability))
            self.biases[index] += slope.sum(axis=0)
            if not of_sampled:
                self.inputs[index] = slope if self.inputs[index] is None else self.inputs[index] + slope
            if index > 0 and step.moved[index - 1] is not None:
                coupling = machine.couplings[index - 1]
                self.couplings[index - 1] += step.moved[index - 1].T @ slope
                slopes[index - 1] = _plus(slopes[index - 1], slope @ coupling.T)
            if index + 1 < machine.n_layers and step.moved[index + 1] is not None:
                coupling = machine.couplings[index]
                self.couplings[index] += slope.T @ step.moved[index + 1]
                slopes[index + 1] = _plus(slopes[index + 1], slope @ coupling)


def _plus(total: np.ndarray | None, more: np.ndarray) -> np.ndarray:
    return more if total is None else total + more
