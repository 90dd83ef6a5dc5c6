"""The Beta Shape Machine (§5, Eq. 2), conditioned on E, in natural centred form.

The print writes α = a0 + Σ (a h + c (1-h)).  Only the differences a-c matter to h, so the machine keeps W^α = a-c,
W^β = b-d and, because everything is centred (h - ν, X - μ with X = [ln D, ln(1-D)]), the value Ā that α takes at
h = ν.  With E the existence of parts, and every sum over points running over existing parts only:

    ln p~(D, H | E) = Σ (Ā - 1) X + (h1-ν1)' W' (X-μ) + b1 h1 + (h1-ν1)' W12 (h2-ν2) + b2 h2
                      + (h2-ν2)' W23 (h3-ν3) + b3 h3 + (E-ε)' V h3

V, the last term, is ours: parts tell the top layer of their existence.  ``to_paper`` and ``from_paper`` (in
``paper_form``) are the exact two-way map to a, b, c, d, a0, b0.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.generative.observations import Observations, diagonals_per_unit, to_positions
from shapeforge.generative.structure import StructureMachine, fit_structure

FLOOR = 0.01
"""Smallest α and β: at 0, which the print's projection max(., 0) can reach, a Beta does not exist."""

PER_PART = ("weights", "rest", "data_centre")


@dataclass(frozen=True, eq=False)
class BetaShapeMachine:
    """Parameters of one machine.  The first layer is kept per part, as a tuple over the L parts.

    ``weights[l]`` (2, F_l, M_l) is [W^α, W^β] of the F_l = 3 K_l coordinates and M_l units of part l; ``rest[l]``
    (2, F_l) is [Ā^α, Ā^β]; ``data_centre[l]`` (2, F_l) is μ.  ``centre1`` (M,), ``centre2`` (N,), ``centre3`` (O,)
    are the ν of the hidden layers, ``existence_centre`` (L,) is ε.  ``spread`` (K, 3) is the standard deviation, in
    diagonals, of what the machine leaves unexplained on shapes it was not fitted to.
    """

    part: Int[np.ndarray, " K"]
    part_names: tuple[str, ...]
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    weights: tuple[Float[np.ndarray, "2 _ _"], ...]
    rest: tuple[Float[np.ndarray, "2 _"], ...]
    data_centre: tuple[Float[np.ndarray, "2 _"], ...]
    bias1: Float[np.ndarray, " M"]
    centre1: Float[np.ndarray, " M"]
    weights12: Float[np.ndarray, "M N"]
    bias2: Float[np.ndarray, " N"]
    centre2: Float[np.ndarray, " N"]
    weights23: Float[np.ndarray, "N O"]
    bias3: Float[np.ndarray, " O"]
    centre3: Float[np.ndarray, " O"]
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
    def sizes(self) -> tuple[int, int, int]:
        """Units in H1, H2, H3: (M, N, O)."""
        return len(self.bias1), len(self.bias2), len(self.bias3)

    @property
    def n_weights(self) -> int:
        """Number of pairwise weights, all layers."""
        return sum(w.size for w in self.weights) + self.weights12.size + self.weights23.size

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
        return chosen.reshape(len(values), 3 * chosen.shape[1]).astype(self.bias1.dtype, copy=False)

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

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything as named numeric arrays (no objects, no strings), for any array store."""
        arrays: dict[str, np.ndarray] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "part_names":
                arrays[field.name] = np.frombuffer("\n".join(value).encode(), dtype=np.uint8).copy()
            elif field.name == "structure":
                arrays.update({f"structure.{inner.name}": getattr(value, inner.name) for inner in fields(value)})
            elif isinstance(value, tuple):
                arrays.update({f"{field.name}.{index}": item for index, item in enumerate(value)})
            else:
                arrays[field.name] = value
        return arrays

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> BetaShapeMachine:
        """The inverse of ``to_arrays``.  Raises ValueError naming an array that is missing."""
        wanted = {field.name for field in fields(cls)} - {"structure", *PER_PART}
        missing = sorted(wanted - set(arrays))
        if missing:
            raise ValueError(
                f"arrays: wanted {missing[0]!r} among them, got {sorted(arrays)[:5]}...; "
                "usually the folder holds another kind of model, or one written by another version"
            )
        values: dict = {name: arrays[name] for name in wanted}
        values["part_names"] = tuple(bytes(arrays["part_names"]).decode().split("\n"))
        for name in PER_PART:
            values[name] = tuple(arrays[f"{name}.{index}"] for index in range(len(values["part_names"])))
        values["structure"] = StructureMachine(
            **{field.name: arrays[f"structure.{field.name}"] for field in fields(StructureMachine)}
        )
        return cls(**values)


PARAMETERS = (
    *PER_PART, "bias1", "centre1", "weights12", "bias2", "centre2", "weights23", "bias3", "centre3",
    "existence_top", "existence_centre", "spread",
)  # fmt: skip
"""Names of the fields that learning may change."""


def _map(value, change):
    return tuple(change(item) for item in value) if isinstance(value, tuple) else change(value)


def layer_sizes(points_per_part: list[int], n_shapes: int) -> tuple[list[int], int, int]:
    """Units of H1 per part, H2 and H3.

    The print: H1 = a tenth of the part's coordinates, H2 = H1/5, H3 = H2/2.5.  Wider tops (/3, /1.5) reconstruct
    better.  With few shapes more units than shapes explain nothing further, so a part's share is capped by T.
    """
    cap = max(16, n_shapes)
    first = [min(max(round(3 * n / 10), 4), cap) for n in points_per_part]
    second = max(8, round(sum(first) / 3))
    return first, second, max(8, round(second / 1.5))


def start_machine(
    observations: Observations,
    *,
    rng: np.random.Generator,
    concentration: float = 20.0,
    sizes: tuple[list[int], int, int] | None = None,
    structure: StructureMachine | None = None,
) -> BetaShapeMachine:
    """A machine before learning: every Beta at the family's mean with α + β = ``concentration``, small weights.

    The concentration has to be set here because contrastive divergence on expectations cannot find it.  ``sizes`` =
    (H1 units per part, H2, H3); by default ``layer_sizes``.
    """
    n_parts = len(observations.part_names)
    counts = np.bincount(observations.part, minlength=n_parts)
    first, second, third = layer_sizes(counts.tolist(), observations.n_shapes) if sizes is None else sizes
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
    total = sum(first)
    as32 = lambda items: tuple(np.ascontiguousarray(item, dtype=np.float32) for item in items)  # noqa: E731
    zeros, halves = (lambda n: np.zeros(n, np.float32)), (lambda n: np.full(n, 0.5, np.float32))
    normal = lambda *shape: (0.05 * rng.standard_normal(shape)).astype(np.float32)  # noqa: E731
    if structure is None:
        structure = fit_structure(observations.exists, rng=rng)
    return BetaShapeMachine(
        part=observations.part, part_names=observations.part_names, low=observations.low, high=observations.high,
        weights=as32(weights), rest=as32(rest), data_centre=as32(centre),
        bias1=zeros(total), centre1=halves(total),
        weights12=normal(total, second), bias2=zeros(second), centre2=halves(second),
        weights23=normal(second, third), bias3=zeros(third), centre3=halves(third),
        existence_top=np.zeros((n_parts, third), np.float32),
        existence_centre=observations.exists.mean(axis=0).astype(np.float32),
        spread=np.full((len(observations.part), 3), 0.02, np.float32),
        structure=structure,
    )  # fmt: skip


def project(machine: BetaShapeMachine) -> BetaShapeMachine:
    """The machine with a, b, c, d, a0, b0 >= 0 and α, β >= FLOOR for every h (the print's max(., 0)).

    In natural form that is A + Σ_m min(W_m, 0) >= FLOOR, per coordinate, where A = Ā - W ν.  A row of weights that
    breaks it is shrunk as a whole, which keeps Ā and thus the mean shape.
    """
    weights = []
    for slot, weight, rest in zip(machine.units_of_part, machine.weights, machine.rest, strict=True):
        centre = machine.centre1[slot]
        reach = np.maximum(weight, 0) @ centre + np.maximum(-weight, 0) @ (1 - centre)
        room = np.maximum(rest - FLOOR, 0)
        shrink = np.where(reach > room, room / np.maximum(reach, 1e-30), 1).astype(weight.dtype)
        weights.append(weight * shrink[..., None])
    rest = tuple(np.maximum(item, FLOOR).astype(item.dtype) for item in machine.rest)
    return replace(machine, weights=tuple(weights), rest=rest)


def recentre(machine: BetaShapeMachine, centre1: np.ndarray, centre2: np.ndarray, centre3: np.ndarray):
    """The same distribution written with other ν: when ν moves by δ, Ā moves by W δ and the biases by w δ."""
    d1, d2, d3 = centre1 - machine.centre1, centre2 - machine.centre2, centre3 - machine.centre3
    rest = tuple(
        (rest + weight @ d1[slot]).astype(rest.dtype)
        for rest, weight, slot in zip(machine.rest, machine.weights, machine.units_of_part, strict=True)
    )
    same = lambda a: a.astype(machine.bias1.dtype)  # noqa: E731
    return replace(
        machine,
        rest=rest,
        bias1=same(machine.bias1 + machine.weights12 @ d2),
        bias2=same(machine.bias2 + d1 @ machine.weights12 + machine.weights23 @ d3),
        bias3=same(machine.bias3 + d2 @ machine.weights23),
        centre1=same(centre1), centre2=same(centre2), centre3=same(centre3),
    )  # fmt: skip
