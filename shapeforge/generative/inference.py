"""Mean field in both directions (supplement 3): a shape's latents, and the shape of given latents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.generative.machine import FLOOR, BetaShapeMachine

UP_ROUNDS = 3
"""Rounds of H1, H2, H3 from a given shape ("3 rounds", supplement 3)."""

DOWN_ROUNDS = 2
"""Rounds of H2, H1 from a given H3; the shape itself is read off at the end."""


@dataclass(frozen=True, eq=False)
class Latents:
    """Probabilities of the hidden units of n shapes, and which parts these have."""

    hidden1: Float[np.ndarray, "n M"]
    hidden2: Float[np.ndarray, "n N"]
    hidden3: Float[np.ndarray, "n O"]
    exists: Bool[np.ndarray, "n L"]

    def __getitem__(self, shapes: int | slice | Int[np.ndarray, " m"]) -> Latents:
        """The latents of some shapes; an int keeps the leading axis."""
        rows = slice(shapes, shapes + 1 or None) if isinstance(shapes, int) else shapes
        return Latents(self.hidden1[rows], self.hidden2[rows], self.hidden3[rows], self.exists[rows])


def sigmoid(x: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-x)) in the precision of x, without overflow."""
    return 0.5 * (1 + np.tanh(0.5 * x))


def logit(q: np.ndarray) -> np.ndarray:
    """The inverse of ``sigmoid``, of probabilities kept 1e-6 away from 0 and 1."""
    clipped = np.clip(q, 1e-6, 1 - 1e-6)
    return np.log(clipped) - np.log1p(-clipped)


def gated_features(
    machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"], part: int
) -> Float[np.ndarray, "n F2"]:
    """E (X - μ) of one part (n, 2 F_l): what its points say to its units, nothing where the part is absent."""
    own = machine.coordinates(values, part)
    features = np.concatenate([np.log(own), np.log1p(-own)], axis=1)
    features -= machine.data_centre[part].reshape(-1)
    features *= exists[:, part, None]
    return features


def first_layer_input(
    machine: BetaShapeMachine, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"]
) -> Float[np.ndarray, "n M"]:
    """Input to H1 from its bias and the points (n, M); H2's part is not in it."""
    total = np.broadcast_to(machine.bias1, (len(values), len(machine.bias1))).copy()
    for index, slot in enumerate(machine.units_of_part):
        weight = machine.weights[index]
        total[:, slot] += gated_features(machine, values, exists, index) @ weight.reshape(-1, weight.shape[2])
    return total


def infer(
    machine: BetaShapeMachine,
    values: Float[np.ndarray, "n K 3"],
    exists: Bool[np.ndarray, "n L"],
    rounds: int = UP_ROUNDS,
) -> Latents:
    """Bottom-up mean field (supplement 3): latents of shapes, H2 and H3 starting at their centres."""
    pull = first_layer_input(machine, values, exists)
    told = (exists - machine.existence_centre).astype(pull.dtype) @ machine.existence_top + machine.bias3
    moved2 = np.zeros((len(values), len(machine.bias2)), pull.dtype)
    moved3 = np.zeros((len(values), len(machine.bias3)), pull.dtype)
    hidden1 = sigmoid(pull)
    for _ in range(rounds):
        hidden1 = sigmoid(pull + moved2 @ machine.weights12.T)
        hidden2 = sigmoid(
            machine.bias2 + (hidden1 - machine.centre1) @ machine.weights12 + moved3 @ machine.weights23.T
        )
        moved2 = hidden2 - machine.centre2
        moved3 = sigmoid(told + moved2 @ machine.weights23) - machine.centre3
    return Latents(hidden1, moved2 + machine.centre2, moved3 + machine.centre3, exists)


def descend(
    machine: BetaShapeMachine, hidden3: Float[np.ndarray, "n O"], rounds: int = DOWN_ROUNDS
) -> tuple[Float[np.ndarray, "n M"], Float[np.ndarray, "n N"]]:
    """Top-down mean field of H1 and H2 given H3, without the points (H1 starts at its centre)."""
    from_top = machine.bias2 + (hidden3.astype(machine.bias1.dtype) - machine.centre3) @ machine.weights23.T
    moved1 = np.zeros((len(hidden3), len(machine.bias1)), from_top.dtype)
    for _ in range(rounds):
        hidden2 = sigmoid(from_top + moved1 @ machine.weights12)
        hidden1 = sigmoid(machine.bias1 + (hidden2 - machine.centre2) @ machine.weights12.T)
        moved1 = hidden1 - machine.centre1
    return hidden1, hidden2


def beta_parameters(
    machine: BetaShapeMachine, hidden1: Float[np.ndarray, "n M"], part: int
) -> Float[np.ndarray, "n 2 F"]:
    """[α, β] of one part's coordinates given H1: Ā + W (h - ν), not below FLOOR."""
    weight = machine.weights[part]
    moved = hidden1[:, machine.units_of_part[part]] - machine.centre1[machine.units_of_part[part]]
    both = (moved @ weight.reshape(-1, weight.shape[2]).T).reshape(len(hidden1), 2, -1)
    both += machine.rest[part]
    return np.maximum(both, FLOOR, out=both)


def expected_values(machine: BetaShapeMachine, hidden1: Float[np.ndarray, "n M"]) -> Float[np.ndarray, "n K 3"]:
    """The mean α / (α + β) of every point's Beta given H1, in (0, 1), for all parts (n, K, 3)."""
    values = np.empty((len(hidden1), machine.n_points, 3), hidden1.dtype)
    for index, members in enumerate(machine.points_of_part):
        both = beta_parameters(machine, hidden1, index)
        values[:, members] = (both[:, 0] / both.sum(axis=1)).reshape(len(hidden1), -1, 3)
    return values


def decode(
    machine: BetaShapeMachine, top: Latents | Float[np.ndarray, "n O"], rounds: int = DOWN_ROUNDS
) -> Float[np.ndarray, "n K 3"]:
    """Values in (0, 1) of latents (from their H1) or of H3 alone (n, O) (top-down mean field first)."""
    if isinstance(top, Latents):
        return expected_values(machine, top.hidden1)
    return expected_values(machine, descend(machine, top, rounds)[0])
