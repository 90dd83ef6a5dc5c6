"""Which parts exist together: the structure part of the machine (E and G of Eq. 2), one existence unit per *part*.

The print has one existence unit per point; all points of a part appear and vanish together, and with that many copies
contrastive divergence never mixes.  With one unit per part the 2^L states can be summed, so that the likelihood and its
gradient are exact.  Draws have the combinations of the family as often as it has them (no estimate comes nearer to new
shapes); where other parts are asked for, this says what goes with them.  See docs/paper.md for the departure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.special import expit, logsumexp

LARGEST_EXACT = 14
"""Parts up to which the 2^L states are summed; with more, states seen in training (and their neighbours) stand in."""


@dataclass(frozen=True, eq=False)
class StructureMachine:
    """ln p~(E, G) = bias . E + E' weights G + hidden_bias . G over L parts and R hidden units."""

    bias: Float[np.ndarray, " L"]
    weights: Float[np.ndarray, "L R"]
    hidden_bias: Float[np.ndarray, " R"]
    states: Bool[np.ndarray, "S L"]

    def log_probability(self, exists: Bool[np.ndarray, "n L"]) -> Float[np.ndarray, " n"]:
        """ln P(E) (n,), hidden units summed out, normalised over ``states``."""
        return self.log_unnormalized(exists) - logsumexp(self.log_unnormalized(self.states))

    def log_unnormalized(self, exists: Bool[np.ndarray, "n L"]) -> Float[np.ndarray, " n"]:
        """ln of the sum over G of p~(E, G) (n,)."""
        visible = exists.astype(float)
        return visible @ self.bias + np.logaddexp(0, self.hidden_bias + visible @ self.weights).sum(axis=1)

    def draw(self, n: int, *, rng: np.random.Generator) -> Bool[np.ndarray, "n L"]:
        """n exact draws of E."""
        logits = self.log_unnormalized(self.states)
        return self.states[rng.choice(len(self.states), n, p=np.exp(logits - logsumexp(logits)))]


def all_states(n_parts: int) -> Bool[np.ndarray, "S L"]:
    """All 2^L combinations of parts."""
    return ((np.arange(2**n_parts)[:, None] >> np.arange(n_parts)) & 1).astype(bool)


def fit_structure(
    exists: Bool[np.ndarray, "T L"], *, rng: np.random.Generator, n_hidden: int | None = None, ridge: float = 2e-4
) -> StructureMachine:
    """Exact maximum likelihood (L-BFGS) of the structure machine, with a small ridge on the weights.

    ``n_hidden`` defaults to 2 L (the print's "total H1" is for one unit per point).
    """
    n_shapes, n_parts = exists.shape
    hidden = 2 * n_parts if n_hidden is None else n_hidden
    states = all_states(n_parts) if n_parts <= LARGEST_EXACT else _seen_and_near(exists)
    visible, possible = exists.astype(float), states.astype(float)
    # Half a shape of doubt: a part that every shape has must not need an infinite bias.
    share = (visible.sum(axis=0) + 0.5) / (n_shapes + 1)
    start = np.concatenate([np.log(share / (1 - share)), rng.normal(0, 0.3, n_parts * hidden), np.zeros(hidden)])

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        bias, weights, hidden_bias = _unpack(flat, n_parts, hidden)
        machine = StructureMachine(bias, weights, hidden_bias, states)
        free = machine.log_unnormalized(states)
        log_z = float(logsumexp(free))
        probability = np.exp(free - log_z)
        on_data, on_model = (expit(hidden_bias + v @ weights) for v in (visible, possible))
        weighted = probability[:, None] * possible
        gradient = np.concatenate(
            [
                visible.mean(axis=0) - weighted.sum(axis=0),
                (visible.T @ on_data / n_shapes - weighted.T @ on_model).ravel(),
                on_data.mean(axis=0) - probability @ on_model,
            ]
        )
        value = float(machine.log_unnormalized(exists).mean()) - log_z - ridge * float(flat @ flat)
        return -value, -(gradient - 2 * ridge * flat)

    flat = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 400}).x
    return StructureMachine(*_unpack(flat, n_parts, hidden), states)


def _unpack(flat: np.ndarray, n_parts: int, hidden: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    middle = n_parts + n_parts * hidden
    return flat[:n_parts], flat[n_parts:middle].reshape(n_parts, hidden), flat[middle:]


def _seen_and_near(exists: np.ndarray) -> np.ndarray:
    """Combinations seen in training and those one part away, for families with very many parts."""
    seen = np.unique(exists, axis=0)
    near = seen[:, None, :] ^ np.eye(seen.shape[1], dtype=bool)[None]
    return np.unique(np.concatenate([seen, near.reshape(-1, seen.shape[1])]), axis=0)
