"""The Beta Shape Machine (§5, Eq. 2), conditioned on E, in natural centred form.

The print writes α = a0 + Σ (a h + c (1-h)).  Only the differences a-c matter to h, so the machine keeps W^α = a-c,
W^β = b-d and, because everything is centred (h - ν, X - μ with X = [ln D, ln(1-D)]), the value Ā that α takes at
h = ν.  With E the existence of parts, and every sum over points running over existing parts only:

    ln p~(D, H | E) = Σ (Ā - 1) X + (h1-ν1)' W' (X-μ) + Σ_i b_i h_i + Σ_i (h_i-ν_i)' C_i (h_i+1-ν_i+1) + (E-ε)' V h_top

with any number of layers of hidden units (three in the print).  V, the last term, is ours: parts tell the top layer of
their existence.  ``to_paper`` and ``from_paper`` (in
``paper_form``) are the exact two-way map to a, b, c, d, a0, b0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.generative.observations import Observations, diagonals_per_unit, to_positions
from shapeforge.generative.structure import StructureMachine, fit_structure

FLOOR = 0.01
"""Smallest α and β: at 0, which the print's projection max(., 0) can reach, a Beta does not exist."""

PER_PART = ("weights", "rest", "data_centre")
PER_LAYER = ("biases", "centres", "couplings")


@dataclass(frozen=True, eq=False)
class BetaShapeMachine:
    """Parameters of one machine.  The first layer is kept per part, as a tuple over the L parts.

    ``weights[l]`` (2, F_l, M_l) is [W^α, W^β] of the F_l = 3 K_l coordinates and M_l units of part l; ``rest[l]``
    (2, F_l) is [Ā^α, Ā^β]; ``data_centre[l]`` (2, F_l) is μ.  ``biases`` and ``centres`` hold b and ν of every layer,
    H1 (M,) first and the top (O,) last; ``couplings[i]`` is C between layer i and the one above.  ``existence_top``
    (L, O) is V, ``existence_centre`` (L,) is ε.  ``spread`` (K, 3) is the standard deviation, in diagonals, of what
    the machine leaves unexplained on shapes it was not fitted to.
    """

    part: Int[np.ndarray, " K"]
    part_names: tuple[str, ...]
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    weights: tuple[Float[np.ndarray, "2 _ _"], ...]
    rest: tuple[Float[np.ndarray, "2 _"], ...]
    data_centre: tuple[Float[np.ndarray, "2 _"], ...]
    biases: tuple[Float[np.ndarray, " _"], ...]
    centres: tuple[Float[np.ndarray, " _"], ...]
    couplings: tuple[Float[np.ndarray, "_ _"], ...]
    existence_top: Float[np.ndarray, "L O"]
    existence_centre: Float[np.ndarray, " L"]
    spread: Float[np.ndarray, "K 3"]
    structure: StructureMachine

    @property
    def n_points(self) -> int:
        """Number of points K."""
        return len(self.part)

    @property
    def n_parts(self) -> int:
        """Number of parts L."""
        return len(self.part_names)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Units of every layer, H1 first: (M, N, O) with three."""
        return tuple(len(bias) for bias in self.biases)

    @property
    def n_layers(self) -> int:
        """Number of layers of hidden units."""
        return len(self.biases)

    @property
    def dtype(self) -> np.dtype:
        """Precision of the parameters."""
        return self.biases[0].dtype

    @property
    def n_weights(self) -> int:
        """Number of pairwise weights, all layers."""
        return sum(w.size for w in (*self.weights, *self.couplings))

    @cached_property
    def points_of_part(self) -> tuple[Int[np.ndarray, " n"], ...]:
        """Indices of the points of each part."""
        return tuple(np.flatnonzero(self.part == index) for index in range(self.n_parts))

    @cached_property
    def units_of_part(self) -> tuple[slice, ...]:
        """The units of H1 that belong to each part (N(k) of the print)."""
        stops = np.cumsum([0, *(w.shape[2] for w in self.weights)])
        return tuple(slice(int(a), int(b)) for a, b in zip(stops[:-1], stops[1:], strict=True))

    @property
    def diagonals_per_unit(self) -> float:
        """Length in diagonals of a step of 1 in the unit interval."""
        return diagonals_per_unit(self.low, self.high)

    def coordinates(self, values: Float[np.ndarray, "n K 3"], part: int) -> Float[np.ndarray, "n F"]:
        """The coordinates (n, F_l) of one part, in the machine's precision."""
        chosen = values[:, self.points_of_part[part]]
        return chosen.reshape(len(values), 3 * chosen.shape[1]).astype(self.dtype, copy=False)

    def to_positions(
        self, values: Float[np.ndarray, "n K 3"], exists: Bool[np.ndarray, "n L"]
    ) -> Float[np.ndarray, "n K 3"]:
        """Values in (0, 1) in normal coordinates (float64), NaN where the part is absent."""
        return to_positions(values.astype(np.float64), exists, self.part, self.low, self.high)

    def astype(self, dtype: type) -> BetaShapeMachine:
        """A copy with every parameter in another precision (float64 for tests, float32 for work)."""
        changed = {name: _map(getattr(self, name), lambda a: np.array(a, dtype=dtype)) for name in PARAMETERS}
        return replace(self, **changed)

    def copy(self) -> BetaShapeMachine:
        """A machine that shares no parameter array with this one."""
        return replace(self, **{name: _map(getattr(self, name), np.copy) for name in PARAMETERS})


PARAMETERS = (
    *PER_PART, *PER_LAYER, "existence_top", "existence_centre", "spread",
)  # fmt: skip
"""Names of the fields that learning may change."""


def _map(value, change):
    return tuple(change(item) for item in value) if isinstance(value, tuple) else change(value)


LEAST_UNITS = 40
"""Units of H1 that a part gets however few its points: a tailplane of 40 points varies no less than one of 400."""

SMALL_FAMILY = 150
"""Shapes up to which two layers give back held-out shapes better than three, from H1 as from the top; with more three
are better from H1, which draws and sliders start from (docs/paper.md)."""

Sizes = tuple[list[int] | int, ...]
"""Units of every layer: of H1 a list, one number per part; of each further layer a number."""


def layer_sizes(points_per_part: list[int], n_shapes: int, layers: int | None = None) -> Sizes:
    """Units of H1 per part, then of each further layer (by default three layers, or two for a SMALL_FAMILY).

    The print: H1 = a tenth of the part's coordinates, H2 = H1/5, H3 = H2/2.5.  Wider tops (/3, /1.5) reconstruct
    better, and so do small parts with at least LEAST_UNITS.  With few shapes more units than shapes explain nothing
    further, so a part's share is capped by T.

    Raises ValueError without a layer.
    """
    if layers is None:
        layers = 2 if n_shapes <= SMALL_FAMILY else 3
    if layers < 1:
        raise ValueError(f"layers: wanted at least 1, got {layers}; the paper has 3")
    cap = max(16, n_shapes)
    first = [min(max(round(3 * n / 10), min(LEAST_UNITS, 3 * n), 4), cap) for n in points_per_part]
    above, size = [], float(sum(first))
    for index in range(layers - 1):
        size = max(8, round(size / (3 if index == 0 else 1.5)))
        above.append(int(size))
    return first, *above


def start_machine(
    observations: Observations,
    *,
    rng: np.random.Generator,
    concentration: float = 20.0,
    sizes: Sizes | None = None,
    structure: StructureMachine | None = None,
) -> BetaShapeMachine:
    """A machine before learning: every Beta at the family's mean with α + β = ``concentration``, small weights.

    The concentration has to be set here because contrastive divergence on expectations cannot find it.  ``sizes`` =
    ([H1 units per part], H2, H3, ...); by default ``layer_sizes``.
    """
    n_parts = len(observations.part_names)
    counts = np.bincount(observations.part, minlength=n_parts)
    first, *above = layer_sizes(counts.tolist(), observations.n_shapes) if sizes is None else sizes
    if not isinstance(first, list) or len(first) != n_parts:
        raise ValueError(f"sizes: wanted first a list of {n_parts} numbers of units, one per part, got {first}")
    weights, rest, centre = [], [], []
    for index in range(n_parts):
        members = np.flatnonzero(observations.part == index)
        present = observations.exists[:, index]
        shapes = observations.values[present] if present.any() else observations.values
        values = shapes[:, members].reshape(len(shapes), -1).astype(np.float64)
        mean = values.mean(axis=0)
        rest.append(concentration * np.stack([mean, 1 - mean]))
        centre.append(np.stack([np.log(values).mean(axis=0), np.log1p(-values).mean(axis=0)]))
        scale = 0.01 * np.sqrt(20 * concentration / first[index])
        weights.append(scale * rng.standard_normal((2, values.shape[1], first[index])))
    every = [sum(first), *(int(size) for size in above)]
    if structure is None:
        structure = fit_structure(observations.exists, rng=rng)
    return BetaShapeMachine(
        part=observations.part, part_names=observations.part_names, low=observations.low, high=observations.high,
        weights=_float32(weights), rest=_float32(rest), data_centre=_float32(centre),
        biases=tuple(np.zeros(size, np.float32) for size in every),
        centres=tuple(np.full(size, 0.5, np.float32) for size in every),
        couplings=_float32([0.05 * rng.standard_normal(pair) for pair in pairwise(every)]),
        existence_top=np.zeros((n_parts, every[-1]), np.float32),
        existence_centre=observations.exists.mean(axis=0).astype(np.float32),
        spread=np.full((len(observations.part), 3), 0.02, np.float32),
        structure=structure,
    )  # fmt: skip


def _float32(items: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(item, dtype=np.float32) for item in items)


def project(machine: BetaShapeMachine) -> BetaShapeMachine:
    """The machine with a, b, c, d, a0, b0 >= 0 and α, β >= FLOOR for every h (the print's max(., 0)).

    In natural form that is A + Σ_m min(W_m, 0) >= FLOOR, per coordinate, where A = Ā - W ν.  A row of weights that
    breaks it is shrunk as a whole, which keeps Ā and thus the mean shape.
    """
    weights = []
    for slot, weight, rest in zip(machine.units_of_part, machine.weights, machine.rest, strict=True):
        centre = machine.centres[0][slot]
        reach = np.maximum(weight, 0) @ centre + np.maximum(-weight, 0) @ (1 - centre)
        room = np.maximum(rest - FLOOR, 0)
        shrink = np.where(reach > room, room / np.maximum(reach, 1e-30), 1).astype(weight.dtype)
        weights.append(weight * shrink[..., None])
    rest = tuple(np.maximum(item, FLOOR).astype(item.dtype) for item in machine.rest)
    return replace(machine, weights=tuple(weights), rest=rest)


def recentre(machine: BetaShapeMachine, centres: Sequence[np.ndarray]) -> BetaShapeMachine:
    """The same distribution written with other ν, one per layer: when ν moves by δ, Ā moves by W δ and the biases of
    the layers next to it by C δ."""
    shifts = [new - old for new, old in zip(centres, machine.centres, strict=True)]
    rest = tuple(
        (rest + weight @ shifts[0][slot]).astype(rest.dtype)
        for rest, weight, slot in zip(machine.rest, machine.weights, machine.units_of_part, strict=True)
    )
    biases = [bias.copy() for bias in machine.biases]
    for index, coupling in enumerate(machine.couplings):
        biases[index] += (coupling @ shifts[index + 1]).astype(machine.dtype)
        biases[index + 1] += (shifts[index] @ coupling).astype(machine.dtype)
    moved = tuple(np.asarray(centre).astype(machine.dtype) for centre in centres)
    return replace(machine, rest=rest, biases=tuple(biases), centres=moved)
