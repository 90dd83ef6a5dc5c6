"""Mean field in both directions (supplement 3): a shape's latents, and the shape of given latents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.generative.machine import FLOOR, BetaShapeMachine

UP_ROUNDS = 3
"""Rounds upwards from a given shape ("3 rounds", supplement 3)."""

DOWN_ROUNDS = 2
"""Rounds downwards from a given top; the shape itself is read off at the end."""

LARGEST_SLIDER_LOGIT = 6.0


@dataclass(frozen=True, eq=False)
class Latents:
    """Probabilities of the hidden units of n shapes, ``layers[0]`` (n, M) of H1 first, and which parts these have."""

    layers: tuple[Float[np.ndarray, "n _"], ...]
    exists: Bool[np.ndarray, "n L"]

    @property
    def first(self) -> Float[np.ndarray, "n M"]:
        """H1: what each part looks like."""
        return self.layers[0]

    @property
    def top(self) -> Float[np.ndarray, "n O"]:
        """The top layer (H3 in the print): the shape as a whole."""
        return self.layers[-1]

    def __getitem__(self, shapes: int | slice | Int[np.ndarray, " m"]) -> Latents:
        """The latents of some shapes; an int keeps the leading axis."""
        rows = slice(shapes, shapes + 1 or None) if isinstance(shapes, int) else shapes
        return Latents(tuple(layer[rows] for layer in self.layers), self.exists[rows])


def sigmoid(x: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-x)) in the precision of x, without overflow."""
    return 0.5 * (1 + np.tanh(0.5 * x))


def logit(q: np.ndarray) -> np.ndarray:
    """The inverse of ``sigmoid``, of probabilities kept 1e-6 away from 0 and 1."""
    clipped = np.clip(q, 1e-6, 1 - 1e-6)
    return np.log(clipped) - np.log1p(-clipped)


def slider_logit(q: np.ndarray) -> np.ndarray:
    """The logit of probabilities as sliders count it, in float64: beyond ±LARGEST_SLIDER_LOGIT a unit is on or off, and
    how far beyond is noise."""
    return np.clip(logit(q), -LARGEST_SLIDER_LOGIT, LARGEST_SLIDER_LOGIT).astype(np.float64)


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
    total = np.broadcast_to(machine.biases[0], (len(values), machine.sizes[0])).copy()
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
    """Bottom-up mean field (supplement 3): latents of shapes, layers above H1 starting at their centres."""
    pull = [first_layer_input(machine, values, exists), *machine.biases[1:]]
    known = (exists - machine.existence_centre).astype(machine.dtype)
    pull[-1] = pull[-1] + known @ machine.existence_top
    moved: list[np.ndarray | None] = [None] * machine.n_layers  # None: at its centre
    for _ in range(rounds):
        for index in range(machine.n_layers):
            moved[index] = settle(machine, index, pull[index], moved)
    return Latents(tuple(m + centre for m, centre in zip(moved, machine.centres, strict=True)), exists)


def settle(machine: BetaShapeMachine, index: int, total: np.ndarray, moved: Sequence[np.ndarray | None]) -> np.ndarray:
    """One layer given its neighbours: σ(``total`` + what the layers below and above say) - ν.

    ``moved`` are the layers less their centres, None for one that is at its centre.
    """
    if index > 0 and moved[index - 1] is not None:
        total = total + moved[index - 1] @ machine.couplings[index - 1]
    if index + 1 < machine.n_layers and moved[index + 1] is not None:
        total = total + moved[index + 1] @ machine.couplings[index].T
    return sigmoid(total) - machine.centres[index]


def descend(
    machine: BetaShapeMachine, top: Float[np.ndarray, "n O"], rounds: int = DOWN_ROUNDS
) -> tuple[Float[np.ndarray, "n _"], ...]:
    """Top-down mean field without the points (H1 starts at its centre): all layers, H1 first, ``top`` itself last."""
    last = machine.n_layers - 1
    moved: list[np.ndarray | None] = [None] * last + [top.astype(machine.dtype) - machine.centres[-1]]
    for _ in range(rounds):
        for index in reversed(range(last)):
            moved[index] = settle(machine, index, machine.biases[index], moved)
    below = (m + centre for m, centre in zip(moved[:last], machine.centres[:last], strict=True))
    return *below, top.astype(machine.dtype)


def carried(
    own: Float[np.ndarray, "n _"], before: Float[np.ndarray, "n _"], after: Float[np.ndarray, "n _"]
) -> Float[np.ndarray, "n _"]:
    """Probabilities ``own`` of a layer, changed by as much as the layers above change it, from ``before`` to ``after``.

    What the layers above don't explain of a shape stays.  Differences are of probabilities, in which α and β are
    linear: in logits a unit that is quite on or off on the shape would stay so whatever the layers above say.
    """
    return np.clip(own + (after - before), 0, 1)


def beta_parameters(
    machine: BetaShapeMachine, hidden1: Float[np.ndarray, "n M"], part: int
) -> Float[np.ndarray, "n 2 F"]:
    """[α, β] of one part's coordinates given H1: Ā + W (h - ν), not below FLOOR."""
    weight = machine.weights[part]
    moved = hidden1[:, machine.units_of_part[part]] - machine.centres[0][machine.units_of_part[part]]
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


def expected_at(
    machine: BetaShapeMachine, hidden1: Float[np.ndarray, "n M"], points: Int[np.ndarray, " m"]
) -> Float[np.ndarray, "n m 3"]:
    """As ``expected_values``, of some points only (n, m, 3): a few cost next to nothing."""
    found = np.empty((len(hidden1), len(points), 3), hidden1.dtype)
    moved = hidden1 - machine.centres[0]
    for index in np.unique(machine.part[points]):
        asked = np.flatnonzero(machine.part[points] == index)
        local = np.searchsorted(machine.points_of_part[index], points[asked])
        rows = (3 * local[:, None] + np.arange(3)).reshape(-1)
        weight = machine.weights[index][:, rows].reshape(2 * len(rows), -1)
        both = (moved[:, machine.units_of_part[index]] @ weight.T).reshape(len(hidden1), 2, -1)
        both = np.maximum(both + machine.rest[index][:, rows], FLOOR)
        found[:, asked] = (both[:, 0] / both.sum(axis=1)).reshape(len(hidden1), -1, 3)
    return found


def decode(
    machine: BetaShapeMachine, top: Latents | Float[np.ndarray, "n O"], rounds: int = DOWN_ROUNDS
) -> Float[np.ndarray, "n K 3"]:
    """Values in (0, 1) of latents (from their H1) or of the top alone (n, O) (top-down mean field first)."""
    if isinstance(top, Latents):
        return expected_values(machine, top.first)
    return expected_values(machine, descend(machine, top, rounds)[0])
