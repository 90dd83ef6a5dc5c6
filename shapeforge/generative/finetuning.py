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
    n, parts, last = len(batch.values), range(machine.n_parts), machine.n_layers - 1
    known = (batch.exists - machine.existence_centre).astype(machine.dtype)
    features = list(run(lambda part: gated_features(machine, batch.values, batch.exists, part), parts))
    up = _upwards(machine, features, known, run)
    first, top = up[-1].moved[0], up[-1].moved[-1] + machine.centres[-1]
    sampled = up[-1].moved[-1] + _sampling_noise(batch, top)
    down = _downwards(machine, sampled)

    # the points, and back to H1: rows are the shapes from the sampled top, then the shapes from H1
    codes = np.concatenate([down[-1].moved[0] if down else sampled, first])
    back = list(run(lambda part: _reconstruct(machine, batch, codes, part), parts))
    errors = np.sum([one.errors for one in back], axis=0)
    slopes = np.concatenate([one.slopes for one in back], axis=1)
    divergence, d_top, d_prior = _divergence(prior, batch, top)

    totals = _Slopes.zero(machine)
    d_down: list[np.ndarray | None] = [slopes[:n], *[None] * last]
    totals.through(down, d_down, of_sampled=True)
    d_up: list[np.ndarray | None] = [slopes[n:], *[None] * last]
    d_up[-1] = _plus(d_up[-1], d_down[-1] + d_top)
    totals.through(up, d_up)
    d_said, d_told = totals.inputs[0], totals.inputs[-1]

    def gather(part: int) -> tuple[np.ndarray, np.ndarray]:
        own, slot = back[part], machine.units_of_part[part]
        rows = np.concatenate([own.parameters, features[part]])
        columns = np.concatenate([own.codes, d_said[:, slot]])
        return (rows.T @ columns).reshape(machine.weights[part].shape), own.parameters.sum(axis=0).reshape(2, -1)

    gathered = list(run(gather, parts))
    terms = LossTerms(
        loss=float(_importance(n) @ errors + DIVERGENCE_WEIGHT * divergence.sum() / n),
        top=float(errors[:n].sum()),
        first=float(errors[n:].sum()),
        divergence=float(divergence.sum() / n),
    )
    return terms, {
        "weights": tuple(weight for weight, _ in gathered),
        "rest": tuple(rest for _, rest in gathered),
        "biases": tuple(totals.biases), "couplings": tuple(totals.couplings), "existence_top": known.T @ d_told,
        "prior_bias": d_prior.sum(axis=0), "prior_weights": batch.exists.astype(machine.dtype).T @ d_prior,
    }  # fmt: skip


def _importance(n: int) -> np.ndarray:
    """Weight (2n,) of the errors of n shapes from the sampled top, then of the same from H1."""
    return np.repeat(np.array([TOP_WEIGHT, FIRST_WEIGHT]), n)


def _sampling_noise(batch: Batch, top: np.ndarray) -> np.ndarray:
    """What sampling adds to the top's probabilities (B, O): straight-through, so that it has no derivative."""
    if batch.noise is not None:
        return batch.noise
    return np.zeros_like(top) if batch.uniform is None else (batch.uniform < top).astype(top.dtype) - top


def _upwards(machine: BetaShapeMachine, features: list[np.ndarray], known: np.ndarray, run: Callable) -> list[_Step]:
    """The mean field of ``infer``, step by step: ``features`` are E (X - μ) of every part, ``known`` E - ε."""
    said = run(lambda part: features[part] @ _flat(machine, part), range(machine.n_parts))
    totals = list(machine.biases)
    totals[0] = totals[0] + np.concatenate(list(said), axis=1)
    totals[-1] = totals[-1] + known @ machine.existence_top
    moved: list[np.ndarray | None] = [None] * machine.n_layers
    steps: list[_Step] = []
    for _ in range(UP_ROUNDS if machine.n_layers > 1 else 1):
        for index in range(machine.n_layers):
            moved[index] = settle(machine, index, totals[index], moved)
            steps.append(_Step(index, list(moved)))
    return steps


def _downwards(machine: BetaShapeMachine, top: np.ndarray) -> list[_Step]:
    """The mean field of ``descend``, step by step, from the sampled ``top`` less its centre; none with one layer."""
    last = machine.n_layers - 1
    moved: list[np.ndarray | None] = [*[None] * last, top]
    steps: list[_Step] = []
    for _ in range(DOWN_ROUNDS if last > 1 else 1):
        for index in reversed(range(last)):
            moved[index] = settle(machine, index, machine.biases[index], moved)
            steps.append(_Step(index, list(moved)))
    return steps


def _flat(machine: BetaShapeMachine, part: int) -> np.ndarray:
    """[W^α, W^β] of one part as one matrix (2 F_l, M_l)."""
    weight = machine.weights[part]
    return weight.reshape(-1, weight.shape[2])


class _Back(NamedTuple):
    """One part given back from ``codes`` (2B, M_l), H1 less its centre: ``errors`` (2B,), and the derivatives of the
    loss by [α, β], ``parameters`` (2B, 2 F_l), and by the codes, ``slopes`` (2B, M_l)."""

    errors: np.ndarray
    codes: np.ndarray
    parameters: np.ndarray
    slopes: np.ndarray


def _reconstruct(machine: BetaShapeMachine, batch: Batch, codes: np.ndarray, part: int) -> _Back:
    """The points of one part from rows of H1 (2B, M), beside what they were."""
    n, dtype, weight = len(batch.values), machine.dtype, _flat(machine, part)
    code = np.ascontiguousarray(codes[:, machine.units_of_part[part]])
    both = code @ weight.T
    per_coordinate = 1.0 / (n * 3 * machine.n_points)
    share = np.tile(batch.exists[:, part] * (batch.part_weight[part] * per_coordinate), 2)
    sums = reconstruction_loss(
        both, machine.rest[part].reshape(-1), machine.coordinates(batch.values, part),
        (share * _importance(n)).astype(dtype), dtype.type(ROUNDING), dtype.type(FLOOR),
    )  # fmt: skip
    return _Back(sums * share, code, both, both @ weight)


def _divergence(prior: TopPrior, batch: Batch, top: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """KL(q(top) || p(top | E)) (B, O), and the slopes of its share of the loss by q(top) and by the prior's logits."""
    per_shape = DIVERGENCE_WEIGHT / len(top)
    expected = sigmoid(prior.bias + batch.exists.astype(top.dtype) @ prior.weights)
    sure, chance = (np.clip(q, 1e-7, 1 - 1e-7) for q in (top, expected))
    surplus = np.log(sure) - np.log1p(-sure) - np.log(chance) + np.log1p(-chance)
    divergence = sure * surplus + np.log1p(-sure) - np.log1p(-chance)
    return divergence, per_shape * surplus.astype(top.dtype), per_shape * (expected - top)


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
