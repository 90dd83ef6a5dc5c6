"""Layer-wise pre-training by centred contrastive divergence: points-H1 per part, then H1-H2, then H2-H3 (§5, S§3).

Centring (subtracting running means of the units and of ln D) is what makes the print's schedule converge at all; see
docs/paper.md.  The negative statistics use ln E[D'], as printed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from shapeforge.generative._kernels import beta_means
from shapeforge.generative.inference import sigmoid
from shapeforge.generative.machine import FLOOR, BetaShapeMachine, project
from shapeforge.generative.observations import Observations

BATCH = 100
MOMENTUM = 0.9
CENTRE_RATE = 0.05
"""How far the running means ν move towards a batch's mean."""

FIRST_RATE, UPPER_RATE = 50.0, 0.02
"""Step sizes; the first layer's is divided by its number of coordinates, since a unit's input sums over all of them."""


def pretrain_points(
    machine: BetaShapeMachine, observations: Observations, *, rng: np.random.Generator, epochs: int,
    run: Callable = map,
) -> Iterator[tuple[BetaShapeMachine, float]]:  # fmt: skip
    """Train points-H1 of every part on the shapes that have it; after each epoch (machine, mean error in the interval).

    Parts are independent here (no upper layer yet): ``run=executor.map`` trains them side by side with the same result.
    """
    seeds = rng.spawn(machine.n_parts)
    states = [_PointLayer.start(machine, observations, index) for index in range(machine.n_parts)]
    for _ in range(epochs):
        states = list(run(lambda pair: pair[0].epoch(pair[1]), list(zip(states, seeds, strict=True))))
        machine = replace(
            machine,
            weights=tuple(state.weights.reshape(2, -1, state.weights.shape[1]) for state in states),
            rest=tuple(state.rest.reshape(2, -1) for state in states),
            biases=(np.concatenate([state.bias for state in states]), *machine.biases[1:]),
            centres=(np.concatenate([state.centre for state in states]), *machine.centres[1:]),
        )
        points = np.array([len(members) for members in machine.points_of_part], dtype=float)
        yield project(machine.copy()), float(np.average([state.error for state in states], weights=points))


@dataclass(eq=False)
class _PointLayer:
    """One part's Beta-Bernoulli machine under way: arrays change in place."""

    values: np.ndarray
    data_centre: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    bias: np.ndarray
    centre: np.ndarray
    speeds: tuple[np.ndarray, np.ndarray, np.ndarray]
    rate: float
    error: float

    @classmethod
    def start(cls, machine: BetaShapeMachine, observations: Observations, part: int) -> _PointLayer:
        weight = machine.weights[part]
        flat, rest = weight.reshape(-1, weight.shape[2]).copy(), machine.rest[part].reshape(-1).copy()
        slot = machine.units_of_part[part]
        bias = machine.biases[0][slot].copy()
        values = machine.coordinates(observations.values[observations.exists[:, part]], part)
        return cls(
            values, machine.data_centre[part].reshape(-1), flat, rest, bias, machine.centres[0][slot].copy(),
            (np.zeros_like(flat), np.zeros_like(rest), np.zeros_like(bias)), FIRST_RATE / max(len(rest), 1), np.inf,
        )  # fmt: skip

    def epoch(self, rng: np.random.Generator) -> _PointLayer:
        """One pass over the shapes; CD-1 with expectations, momentum, and ν following the units' means."""
        n_shapes, total = len(self.values), 0.0
        if n_shapes == 0 or self.values.shape[1] == 0:
            self.error = 0.0
            return self
        order = rng.permutation(n_shapes)
        for start in range(0, n_shapes, BATCH):
            values = self.values[order[start : start + BATCH]]
            features = self._features(values)
            hidden = sigmoid(self.bias + features @ self.weights)
            again = beta_means((hidden - self.centre) @ self.weights.T, self.rest, np.float32(FLOOR))
            total += float(np.abs(values - again).mean(axis=1).sum())
            imagined = self._features(again)
            hidden_again = sigmoid(self.bias + imagined @ self.weights)
            moved, moved_again = hidden - self.centre, hidden_again - self.centre
            n = np.float32(len(values))
            gradients = (
                (features.T @ moved - imagined.T @ moved_again) / n,
                (features - imagined).sum(axis=0) / n,
                (hidden - hidden_again).sum(axis=0) / n,
            )
            # Ā is of the order of the concentration, a weight of a hundredth of it: its steps must be larger.
            rates = (self.rate, 10 * self.rate, 0.01)
            for array, gradient, speed, rate in zip(
                (self.weights, self.rest, self.bias), gradients, self.speeds, rates, strict=True
            ):
                speed *= np.float32(MOMENTUM)
                speed += np.float32(rate) * gradient
                array += speed
            shift = np.float32(CENTRE_RATE) * (hidden.mean(axis=0) - self.centre)
            self.rest += self.weights @ shift
            self.centre += shift
        error = total / n_shapes
        # The print's rule (x1.1 after a fall, x0.9 after a rise), capped: unbounded it grows until units die.
        ceiling = 4 * FIRST_RATE / len(self.rest)
        self.rate = min(self.rate * 1.1, ceiling) if error < self.error else self.rate * 0.9
        self.error = error
        return self

    def _features(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate([np.log(values), np.log1p(-values)], axis=1) - self.data_centre


def pretrain_pair(
    lower: Float[np.ndarray, "n A"], upper: int, *, rng: np.random.Generator, epochs: int
) -> Iterator[tuple[dict[str, np.ndarray], float]]:
    """Train a centred binary machine on probabilities ``lower`` (n, A) with ``upper`` units by CD-1 on expectations.

    After each epoch: its arrays (``weights`` (A, B), ``lower_bias``, ``upper_bias``, ``lower_centre``,
    ``upper_centre``) and the mean error of the probabilities.
    """
    data = lower.astype(np.float32)
    n = len(data)
    lower_centre = np.clip(data.mean(axis=0), 0.02, 0.98)
    upper_centre = np.full(upper, 0.5, np.float32)
    # Small, so that no unit starts saturated (the print's N(0, .1) does on hundreds of inputs).
    spread = max(float((data - lower_centre).std()), 1e-3)
    weights = (rng.standard_normal((data.shape[1], upper)) * 0.5 / (spread * np.sqrt(data.shape[1]))).astype(np.float32)
    weights = np.clip(weights, -1, 1)
    lower_bias = np.log(lower_centre) - np.log1p(-lower_centre)
    upper_bias = np.zeros(upper, np.float32)
    speeds = (np.zeros_like(weights), np.zeros_like(lower_bias), np.zeros_like(upper_bias))
    for _ in range(epochs):
        total, order = 0.0, rng.permutation(n)
        for start in range(0, n, BATCH):
            visible = data[order[start : start + BATCH]]
            hidden = sigmoid(upper_bias + (visible - lower_centre) @ weights)
            again = sigmoid(lower_bias + (hidden - upper_centre) @ weights.T)
            hidden_again = sigmoid(upper_bias + (again - lower_centre) @ weights)
            total += float(np.abs(visible - again).mean(axis=1).sum())
            count = np.float32(len(visible))
            gradients = (
                ((visible - lower_centre).T @ (hidden - upper_centre)
                 - (again - lower_centre).T @ (hidden_again - upper_centre)) / count,
                (visible - again).sum(axis=0) / count,
                (hidden - hidden_again).sum(axis=0) / count,
            )  # fmt: skip
            for array, gradient, speed in zip((weights, lower_bias, upper_bias), gradients, speeds, strict=True):
                speed *= np.float32(MOMENTUM)
                speed += np.float32(UPPER_RATE) * gradient
                array += speed
            shift = np.float32(CENTRE_RATE) * (hidden.mean(axis=0) - upper_centre)
            lower_bias += weights @ shift
            upper_centre += shift
        arrays = {
            "weights": weights, "lower_bias": lower_bias, "upper_bias": upper_bias,
            "lower_centre": lower_centre, "upper_centre": upper_centre,
        }  # fmt: skip
        yield {name: array.copy() for name, array in arrays.items()}, total / n
