"""Drawing new shapes: a mixture over the top layer and the existence of parts, then top-down mean field (§5).

Independent units, or Gibbs sampling between H2 and H3, draw clumps.  A mixture of Bernoullis fitted to (q(top), E) of
the training shapes holds the modes apart, and draws the parts and the top code of a shape from the *same* component.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp

from shapeforge.generative.inference import Latents, decode, descend, infer, logit, sigmoid
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import Observations

MOST_COMPONENTS = 100
DOUBT = 0.5
"""Shapes' worth of doubt added to every component's probabilities, spread as in the whole family."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """C components over the top layer and E: ``weight`` (C,), ``top`` (C, O) and ``existence`` (C, L) probabilities.

    ``patterns`` (S, L) are the combinations of parts seen in training and ``pattern_weight`` (C, S) how often each
    component has them: draws keep to them, so that no chair stands on two kinds of legs.
    """

    weight: Float[np.ndarray, " C"]
    top: Float[np.ndarray, "C O"]
    existence: Float[np.ndarray, "C L"]
    patterns: Bool[np.ndarray, "S L"]
    pattern_weight: Float[np.ndarray, "C S"]

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything as named arrays."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> Mixture:
        """The inverse of ``to_arrays``."""
        return cls(**{field.name: arrays[field.name] for field in fields(cls)})


@dataclass(frozen=True, eq=False)
class Draw:
    """n new shapes: ``points`` in normal coordinates (NaN where a part is absent), their parts and their latents."""

    points: Float[np.ndarray, "n K 3"]
    exists: Bool[np.ndarray, "n L"]
    latents: Latents


def fit_mixture(
    machine: BetaShapeMachine,
    observations: Observations,
    *,
    rng: np.random.Generator,
    components: int | None = None,
    rounds: int = 60,
) -> Mixture:
    """EM of a mixture of Bernoullis on (q(top), E) of the training shapes.

    ``components`` defaults to one per shape, at most 100: fewer draw less variety and were easier to tell from real
    shapes.  Starts from shapes picked far apart (k-means++).
    """
    q = infer(machine, observations.values, observations.exists).top.astype(float)
    exists = observations.exists.astype(float)
    n = len(q)
    count = min(n, MOST_COMPONENTS if components is None else components)
    data = np.concatenate([q, exists], axis=1)
    overall = (data.sum(axis=0) + 0.5) / (n + 1)
    centres = data[_spread_out(data, count, rng)] * 0.8 + 0.2 * overall
    weight = np.full(count, 1 / count)
    before = -np.inf
    for _ in range(rounds):
        joint = np.log(weight) + _log_bernoulli(data, centres)
        total = logsumexp(joint, axis=1, keepdims=True)
        share = np.exp(joint - total)
        mass = share.sum(axis=0)
        weight = (mass + 1e-3) / (mass + 1e-3).sum()
        centres = (share.T @ data + DOUBT * overall) / (mass[:, None] + DOUBT)
        if total.mean() - before < 1e-6 * abs(before):
            break
        before = float(total.mean())
    patterns, which = np.unique(observations.exists, axis=0, return_inverse=True)
    pattern_weight = np.stack([np.bincount(which, share[:, c], len(patterns)) for c in range(count)])
    pattern_weight += 1e-9
    return Mixture(
        weight, centres[:, : q.shape[1]], centres[:, q.shape[1] :], patterns,
        pattern_weight / pattern_weight.sum(axis=1, keepdims=True),
    )  # fmt: skip


def draw(
    machine: BetaShapeMachine,
    mixture: Mixture,
    n: int,
    *,
    rng: np.random.Generator,
    exists: Bool[np.ndarray, " L"] | None = None,
    temperature: float = 1.0,
) -> Draw:
    """n new shapes: a component, its parts, its top units, then top-down mean field and the mean of every Beta.

    ``exists`` asks for these parts (any combination): components are then chosen by how well it suits them.
    ``temperature`` below 1 draws more typical shapes, above 1 more unusual ones.
    """
    if n < 1:
        raise ValueError(f"n: wanted at least 1 shape, got {n}; usually a count of 0 was asked for")
    if temperature <= 0:
        raise ValueError(f"temperature: wanted a positive number, got {temperature}; use e.g. 0.1 for typical shapes")
    weight = mixture.weight
    if exists is not None:
        fit = np.log(weight) + _log_bernoulli(exists[None].astype(float), mixture.existence)[0]
        weight = np.exp(fit - logsumexp(fit))
    chosen = rng.choice(len(weight), n, p=weight / weight.sum())
    if exists is None:
        which = [rng.choice(len(mixture.patterns), p=mixture.pattern_weight[c]) for c in chosen]
        states = mixture.patterns[which]
    else:
        states = np.broadcast_to(exists, (n, len(exists))).copy()
    probability = sigmoid(logit(mixture.top[chosen]) / temperature)
    top = (rng.random(probability.shape) < probability).astype(machine.dtype)
    return shape_of_top(machine, top, states)


def shape_of_top(machine: BetaShapeMachine, top: Float[np.ndarray, "n O"], exists: Bool[np.ndarray, "n L"]) -> Draw:
    """The shapes of given values of the top layer (n, O), binary or probabilities, with these parts."""
    latents = Latents(descend(machine, top), exists)
    return Draw(machine.to_positions(decode(machine, latents), exists), exists, latents)


def _log_bernoulli(data: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Expected ln probability (n, C) of soft binary data (n, A) under centres (C, A)."""
    safe = np.clip(centres, 1e-4, 1 - 1e-4)
    return data @ np.log(safe).T + (1 - data) @ np.log1p(-safe).T


def _spread_out(data: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of ``count`` rows, each picked with probability proportional to its squared distance from the others."""
    picked = [int(rng.integers(len(data)))]
    nearest = ((data - data[picked[0]]) ** 2).sum(axis=1)
    while len(picked) < count:
        if nearest.sum() <= 1e-12:
            rest = np.setdiff1d(np.arange(len(data)), picked)
            picked.extend(rest[: count - len(picked)].tolist())
            break
        picked.append(int(rng.choice(len(data), p=nearest / nearest.sum())))
        nearest = np.minimum(nearest, ((data - data[picked[-1]]) ** 2).sum(axis=1))
    return np.array(picked)
