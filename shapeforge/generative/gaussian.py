"""A baseline: the Gaussian-Bernoulli deep Boltzmann machine, points given real-valued and the units above them binary.

Two layers of hidden units on all coordinates, each standardised, with a variance of its own that is learnt.  Parts are
treated as the Beta machine treats them, so that only the model of the points differs: absent ones count for nothing,
and what parts there are speaks to the top layer.  Centred like the Beta machine, without which it learns no more than
the mean shape.  Pre-training is layer by layer by contrastive divergence, then all layers learn together: mean field on
the data against chains that go on from step to step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.collection.iterate import last
from shapeforge.generative.inference import sigmoid
from shapeforge.generative.observations import LIMIT, Observations
from shapeforge.generative.pretraining import BATCH, MOMENTUM, pretrain_pair

CHAINS = 100
ROUNDS = 5
"""Rounds of mean field."""

SWEEPS = 100
"""Gibbs sweeps from a shape of the family to a draw."""

CENTRE_RATE = 0.05
UPPER_RATE = 0.01
LEAST_VARIANCE = 0.02
"""Of a standardised coordinate: smaller ones make every unit all or nothing."""


@dataclass(eq=False)
class GaussianMachine:
    """The parameters, changed in place while it is learnt.

    ``mean`` and ``scale`` (F,) standardise the coordinates; ``variance`` (F,) is what H1 leaves of the standardised
    ones.  Given H1 their mean is ``weights`` (F, M) (h1 - ν1); ``couplings`` (M, N) join H1 and H2, ``existence_top``
    (L, N) parts and H2; ``shapes`` are those learned from, from which chains start.
    """

    mean: np.ndarray
    scale: np.ndarray
    variance: np.ndarray
    weights: np.ndarray
    couplings: np.ndarray
    existence_top: np.ndarray
    existence_centre: np.ndarray
    biases: tuple[np.ndarray, np.ndarray]
    centres: tuple[np.ndarray, np.ndarray]
    shapes: Observations

    def standardised(self, observations: Observations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(coordinates (T, F), 0 where absent; which are there (T, F); parts relative to their mean (T, L))."""
        there = np.repeat(observations.exists[:, observations.part], 3, axis=1).astype(np.float32)
        flat = observations.values.reshape(observations.n_shapes, -1)
        known = (observations.exists - self.existence_centre).astype(np.float32)
        return ((flat - self.mean) / self.scale * there).astype(np.float32), there, known

    def from_points(self, points: np.ndarray) -> np.ndarray:
        """What standardised coordinates (n, F), 0 where absent, say to H1 (n, M)."""
        return self.biases[0] + (points / self.variance) @ self.weights

    def settled(self, points: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean field: probabilities of H1 (n, M) and H2 (n, N)."""
        below, told = self.from_points(points), self.biases[1] + known @ self.existence_top
        second = np.broadcast_to(self.centres[1], told.shape)
        for _ in range(ROUNDS):
            first = sigmoid(below + (second - self.centres[1]) @ self.couplings.T)
            second = sigmoid(told + (first - self.centres[0]) @ self.couplings)
        return first, second

    def expected(self, first: np.ndarray) -> np.ndarray:
        """Standardised coordinates (n, F) expected given H1."""
        return (first - self.centres[0]) @ self.weights.T

    def sweep(
        self, second: np.ndarray, points: np.ndarray, there: np.ndarray, known: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One Gibbs sweep from H2 and the points: H1, then both neighbours of it, sampled."""
        chance = sigmoid(self.from_points(points) + (second - self.centres[1]) @ self.couplings.T)
        first = _sampled(chance, rng)
        noise = rng.standard_normal(points.shape, dtype=np.float32) * np.sqrt(self.variance)
        points = (self.expected(first) + noise) * there
        told = self.biases[1] + known @ self.existence_top
        return first, _sampled(sigmoid(told + (first - self.centres[0]) @ self.couplings), rng), points


def fit_gaussian_machine(
    observations: Observations, *, rng: np.random.Generator, units: tuple[int, int] = (100, 50), rate: float = 1.0,
    steps: int = 2000,
) -> GaussianMachine:  # fmt: skip
    """Learn from the shapes: a quarter of the ``steps`` for each layer alone, then all together at falling rates.

    ``rate`` is the step size of the points' weights times their number of coordinates, over all of which a unit sums.
    """
    machine = _start(observations, units, rng)
    points, there, known = machine.standardised(observations)
    size = min(BATCH, observations.n_shapes)
    epochs = max(1, steps // 4 // -(-observations.n_shapes // size))
    _pretrain_points(machine, points, there, rng, rate / points.shape[1], steps // 4)
    first = sigmoid(machine.from_points(points))
    pair, _ = last(pretrain_pair(first, units[1], rng=rng, epochs=epochs))
    machine.couplings[...] = pair["weights"]
    machine.biases[1][...], machine.centres[1][...] = pair["upper_bias"], pair["upper_centre"]

    chains = rng.integers(observations.n_shapes, size=CHAINS)
    imagined, of_chain, parts = points[chains], there[chains], known[chains]
    second = _sampled(machine.settled(imagined, parts)[1], rng)
    share = np.maximum(there.mean(axis=0), 0.1)[:, None]
    speeds = [np.zeros_like(a) for a in _learnt(machine)]
    together = steps - 2 * (steps // 4)
    for step in range(together):
        chosen = rng.choice(observations.n_shapes, size, replace=False)
        data, data_parts = points[chosen], known[chosen]
        found = machine.settled(data, data_parts)
        first, second, imagined = machine.sweep(second, imagined, of_chain, parts, rng)
        positive = _statistics(machine, data, *found, data_parts, share)
        negative = _statistics(machine, imagined, first, second, parts, share)
        falling = 1 - step / together
        rates = (rate / points.shape[1], *[UPPER_RATE] * 4)
        for array, speed, plus, minus, own in zip(_learnt(machine), speeds, positive, negative, rates, strict=True):
            speed *= np.float32(MOMENTUM)
            speed += np.float32(falling * own) * (plus - minus)
            array += speed
        _follow(machine, data, there[chosen], found)
    return machine


def reconstruct_by_gaussian_machine(machine: GaussianMachine, observations: Observations) -> Float[np.ndarray, "T K 3"]:
    """Every shape as its H1 gives it back."""
    points, _, known = machine.standardised(observations)
    return _values(machine, machine.expected(machine.settled(points, known)[0]))


def draw_from_gaussian_machine(
    machine: GaussianMachine, n: int, *, rng: np.random.Generator, sweeps: int = SWEEPS
) -> tuple[Float[np.ndarray, "n K 3"], Bool[np.ndarray, "n L"]]:
    """n new shapes (values in (0, 1), parts): Gibbs chains from shapes of the family, whose parts they keep; then the
    points expected given H1."""
    chosen = rng.integers(machine.shapes.n_shapes, size=n)
    points, there, known = machine.standardised(machine.shapes.subset(chosen))
    second = _sampled(machine.settled(points, known)[1], rng)
    for _ in range(sweeps):
        _, second, points = machine.sweep(second, points, there, known, rng)
    return _values(machine, machine.expected(machine.settled(points, known)[0])), machine.shapes.exists[chosen]


def _start(observations: Observations, units: tuple[int, int], rng: np.random.Generator) -> GaussianMachine:
    flat = observations.values.reshape(observations.n_shapes, -1).astype(np.float64)
    there = np.repeat(observations.exists[:, observations.part], 3, axis=1)
    count = np.maximum(there.sum(axis=0), 1)
    mean = (flat * there).sum(axis=0) / count
    scale = np.sqrt((((flat - mean) * there) ** 2).sum(axis=0) / count)
    scale = np.maximum(scale, 1e-2 * max(float(scale.max()), 1e-6))
    n_features, n_parts = flat.shape[1], observations.exists.shape[1]
    arrays = (
        mean, scale, np.ones(n_features), 0.1 / np.sqrt(units[0]) * rng.standard_normal((n_features, units[0])),
        np.zeros(units), np.zeros((n_parts, units[1])), observations.exists.mean(axis=0),
    )  # fmt: skip
    halves = tuple(np.full(size, 0.5, np.float32) for size in units)
    biases = tuple(np.zeros(size, np.float32) for size in units)
    return GaussianMachine(*(a.astype(np.float32) for a in arrays), biases, halves, observations)


def _pretrain_points(machine, points, there, rng, rate, steps) -> None:
    """Points and H1 alone, by contrastive divergence on expectations."""
    size, share = min(BATCH, len(points)), np.maximum(there.mean(axis=0), 0.1)[:, None]
    speeds = [np.zeros_like(machine.weights), np.zeros_like(machine.biases[0])]
    for _ in range(steps):
        chosen = rng.choice(len(points), size, replace=False)
        data = points[chosen]
        hidden = sigmoid(machine.from_points(data))
        again = machine.expected(hidden) * there[chosen]
        hidden_again = sigmoid(machine.from_points(again))
        gradients = (
            ((data.T @ (hidden - machine.centres[0]) - again.T @ (hidden_again - machine.centres[0])) / size / share),
            (hidden - hidden_again).mean(axis=0),
        )
        learnt = zip((machine.weights, machine.biases[0]), speeds, gradients, (rate, UPPER_RATE), strict=True)
        for array, speed, gradient, own in learnt:
            speed *= np.float32(MOMENTUM)
            speed += np.float32(own) * gradient
            array += speed
        _follow(machine, data, there[chosen], (hidden,))


def _follow(machine: GaussianMachine, data: np.ndarray, there: np.ndarray, found: tuple[np.ndarray, ...]) -> None:
    """The centres follow the units, without changing the distribution; the variances follow what H1 leaves."""
    left = ((data - machine.expected(found[0]) * there) ** 2).sum(axis=0)
    count = there.sum(axis=0)
    variance = np.where(count > 0, left / np.maximum(count, 1), machine.variance)
    machine.variance += np.float32(CENTRE_RATE) * (np.maximum(variance, LEAST_VARIANCE) - machine.variance)
    shifts = [np.float32(CENTRE_RATE) * (q.mean(axis=0) - nu) for q, nu in zip(found, machine.centres, strict=False)]
    if len(shifts) > 1:
        machine.biases[0][...] += machine.couplings @ shifts[1]
        machine.biases[1][...] += shifts[0] @ machine.couplings
    for centre, shift in zip(machine.centres, shifts, strict=False):
        centre += shift


def _learnt(machine: GaussianMachine) -> tuple[np.ndarray, ...]:
    return machine.weights, machine.couplings, machine.existence_top, *machine.biases


def _statistics(machine, points, first, second, known, share) -> tuple[np.ndarray, ...]:
    """What the gradient compares, in the order of ``_learnt``: means over the rows."""
    n, moved = np.float32(len(points)), (first - machine.centres[0], second - machine.centres[1])
    return (
        points.T @ moved[0] / n / share, moved[0].T @ moved[1] / n, known.T @ second / n,
        first.mean(axis=0), second.mean(axis=0),
    )  # fmt: skip


def _values(machine: GaussianMachine, points: np.ndarray) -> np.ndarray:
    return np.clip(machine.mean + machine.scale * points, LIMIT, 1 - LIMIT).reshape(len(points), -1, 3)


def _sampled(chance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return (rng.random(chance.shape, dtype=np.float32) < chance).astype(np.float32)
