"""ln p~ of Eq. 2 and its gradient, and mean field's bound; written for clarity (tests and diagnosis), not for speed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.generative.machine import BetaShapeMachine

Hidden = Sequence[np.ndarray]
"""Values or expectations of the hidden layers, H1 first: (n, M), (n, N), (n, O) with three."""


def log_features(values: np.ndarray) -> np.ndarray:
    """X = [ln D, ln(1-D)] (n, 2, F) of coordinates (n, F)."""
    return np.stack([np.log(values), np.log1p(-values)], axis=1)


def _centred(machine: BetaShapeMachine, hidden: Hidden) -> Hidden:
    return [layer - centre for layer, centre in zip(hidden, machine.centres, strict=True)]


def log_unnormalized(
    machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"], hidden: Hidden
) -> Float[np.ndarray, " n"]:
    """ln p~(D, H | E) (n,), Eq. 2 without its structure terms (see the head of ``machine`` for the centred form)."""
    moved = _centred(machine, hidden)
    total = np.einsum("nl,lo,no->n", exists - machine.existence_centre, machine.existence_top, hidden[-1])
    for layer, bias in zip(hidden, machine.biases, strict=True):
        total = total + layer @ bias
    for index, coupling in enumerate(machine.couplings):
        total = total + np.einsum("nm,mo,no->n", moved[index], coupling, moved[index + 1])
    for index, slot in enumerate(machine.units_of_part):
        features = log_features(machine.coordinates(values, index))
        own = np.einsum("nsf,sf->n", features, machine.rest[index] - 1)
        own = own + np.einsum(
            "nsf,sfm,nm->n", features - machine.data_centre[index], machine.weights[index], moved[0][:, slot]
        )
        total = total + np.where(exists[:, index], own, 0)
    return total


def log_unnormalized_gradient(
    machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"], hidden: Hidden
) -> dict[str, np.ndarray | tuple[np.ndarray, ...]]:
    """Gradient of the *sum* over the n shapes of ln p~ with respect to every learned parameter, by field name.

    Contrastive divergence is this on the data minus this on the reconstruction.  Points of absent parts give nothing
    (the printed updates omit E, though Eq. 2 has it).
    """
    moved = _centred(machine, hidden)
    weights, rest = [], []
    for index, slot in enumerate(machine.units_of_part):
        features = log_features(machine.coordinates(values, index)) * exists[:, index, None, None]
        centred = features - machine.data_centre[index] * exists[:, index, None, None]
        weights.append(np.einsum("nsf,nm->sfm", centred, moved[0][:, slot]))
        rest.append(features.sum(axis=0))
    return {
        "weights": tuple(weights),
        "rest": tuple(rest),
        "biases": tuple(layer.sum(axis=0) for layer in hidden),
        "couplings": tuple(below.T @ above for below, above in pairwise(moved)),
        "existence_top": (exists - machine.existence_centre).T @ hidden[-1],
    }


def entropy(hidden: Hidden) -> Float[np.ndarray, " n"]:
    """Entropy (n,) in nats of independent binary units with these probabilities."""
    total = np.zeros(len(hidden[0]))
    for layer in hidden:
        q = np.clip(layer, 1e-12, 1 - 1e-12)
        total -= (q * np.log(q) + (1 - q) * np.log1p(-q)).sum(axis=1)
    return total


def mean_field_bound(
    machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"], hidden: Hidden
) -> Float[np.ndarray, " n"]:
    """⟨ln p~(D, H | E)⟩_q + entropy of q (n,): a lower bound of ln Σ_H p~ for any factorised q(H).

    Exact expectations, since ln p~ is linear in each unit.
    """
    return log_unnormalized(machine, values, exists, hidden) + entropy(hidden)
