"""What is worth a slider: directions of the top layer, bundles of units, single units (§6, Figure 7).

Single units mostly move a shape by less than one can see, so everything is ranked by what it does: the measured
movement of the points while the slider goes from its 5th to its 95th percentile over the family.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.generative.inference import (
    Latents,
    carried,
    decode,
    descend,
    expected_values,
    infer,
    sigmoid,
    slider_logit,
)
from shapeforge.generative.machine import FLOOR, BetaShapeMachine
from shapeforge.generative.observations import Observations

BINS = 16
DRIVEN = 0.3
"""Correlation with an upper unit from which a lower unit belongs to its bundle."""

SAME = 0.7
"""Cosine from which two bundles are taken for one."""

MOST_PATTERNS = 8
"""Combinations of parts on which a slider's effect is measured."""

PROMISING = 4
"""So many times the single units wanted are measured."""

BIG_MOVE = 0.4
"""A part is named in a caption when its points move at least this share of what the part that moves most does."""


@dataclass(frozen=True, eq=False)
class Direction:
    """One slider.  Its value is added to the logits of a layer along ``vector``: of the top (O,) for kind "direction",
    of H1 (M,) for "bundle" and "unit"; 0 leaves a shape as it is.

    ``low`` and ``high`` are the 5th and 95th percentile over the training shapes, relative to their median;
    ``histogram`` (b,) counts the shapes between ``edges`` (b+1,).  ``moves`` (K,) is how far each point goes, in
    diagonals, from low to high; ``parts`` the names of the parts that move most.  ``unit`` is the number, in its layer,
    of the unit that leads a bundle or is alone; None for a direction.
    """

    name: str
    caption: str
    kind: str
    vector: Float[np.ndarray, " _"]
    low: float
    high: float
    histogram: Float[np.ndarray, " b"]
    edges: Float[np.ndarray, " e"]
    moves: Float[np.ndarray, " K"]
    parts: tuple[str, ...]
    unit: int | None = None

    @property
    def heat(self) -> Float[np.ndarray, " K"]:
        """``moves`` relative to the point that moves most, in [0, 1]: for colouring."""
        return self.moves / max(float(self.moves.max()), 1e-12)

    @property
    def size(self) -> float:
        """Mean movement of the points from low to high, in diagonals."""
        return float(self.moves.mean())


def directions(machine: BetaShapeMachine, observations: Observations, count: int = 8) -> list[Direction]:
    """The ``count`` directions of the top layer that change shapes most, the most effective first.

    Principal directions of what the family's shapes do while their parts stay the same: the positions that the machine
    gives back are decomposed within each combination of parts, and a direction is the change of the top's logits that
    goes along with one principal component.  Deterministic, signs included (the part that moves most grows or rises).
    """
    latents = infer(machine, observations.values, observations.exists)
    logits = slider_logit(latents.top)
    decoded = decode(machine, latents.top)
    counted = observations.exists[:, observations.part][..., None]
    flat = (decoded.astype(float) * counted).reshape(len(decoded), -1)
    logits_within = _within_patterns(logits, observations.exists)
    flat_within = _within_patterns(flat, observations.exists)
    left, strength, right = np.linalg.svd(flat_within, full_matrices=False)
    typical = _typical_shapes(latents, logits_within)
    found = []
    for index in range(min(2 * count, int((strength > 1e-4 * strength[0]).sum()))):
        scores = left[:, index] * strength[index] * _sign(right[index])
        vector = logits_within.T @ scores / max(float(scores @ scores), 1e-20)
        vector /= max(float(np.linalg.norm(vector)), 1e-12)
        found.append(_direction(machine, typical, vector, logits_within @ vector, "direction"))
    found.sort(key=lambda direction: -direction.size)
    return [_named(direction, index) for index, direction in enumerate(found[:count])]


def bundles(machine: BetaShapeMachine, observations: Observations, count: int = 8) -> list[Direction]:
    """The ``count`` units of H2, each with the units of H1 that go with it (Figure 7), that change shapes most.

    Set alone, a unit moves a shape by less than one can see: its neighbours hold H1 where it was.  So H1's logits go
    along as they do over the family (least squares, within combinations of parts), where the two correlate at all.  The
    values are logits of the H2 unit; bundles that do nearly the same as a stronger one are left out.
    """
    latents = infer(machine, observations.values, observations.exists)
    upper = _within_patterns(slider_logit(latents.layers[_bundle_layer(machine)]), observations.exists)
    typical = _typical_shapes(latents, upper)
    lower = _within_patterns(slider_logit(latents.first), observations.exists)
    there = np.zeros(lower.shape, bool)
    for index, slot in enumerate(machine.units_of_part):
        there[:, slot] = observations.exists[:, [index]]
    lower = lower * there
    square = np.maximum((upper**2).T @ there, 1e-12)
    slopes = upper.T @ lower / square
    correlation = slopes * np.sqrt(square / np.maximum((lower**2).sum(axis=0), 1e-12))
    slopes = np.where(np.abs(correlation) >= DRIVEN, slopes, 0)
    swing = np.percentile(upper, 95, axis=0) - np.percentile(upper, 5, axis=0)
    found: list[Direction] = []
    for unit in np.argsort(-swing * np.linalg.norm(slopes, axis=1), kind="stable"):
        vector = slopes[unit]
        strength = float(np.linalg.norm(vector))
        if strength < 1e-9 or len(found) >= 2 * count:
            break
        alike = (abs(float(vector @ o.vector)) / (strength * np.linalg.norm(o.vector)) for o in found)
        if max(alike, default=0.0) < SAME:
            found.append(replace(_direction(machine, typical, vector, upper[:, unit], "bundle"), unit=int(unit)))
    found.sort(key=lambda direction: -direction.size)
    return [_named(direction, index) for index, direction in enumerate(found[:count])]


def single_units(machine: BetaShapeMachine, observations: Observations, count: int = 8) -> list[Direction]:
    """The ``count`` units of H1 that change shapes most, each by itself: measured displacement x observed swing.

    Which to measure is told by the derivative of the points at rest times the unit's swing over the shapes that have
    its part.
    """
    latents = infer(machine, observations.values, observations.exists)
    within = _within_patterns(slider_logit(latents.first), observations.exists)
    typical = _typical_shapes(latents, within)
    promise = np.zeros(machine.sizes[0])
    for index, slot in enumerate(machine.units_of_part):
        has = observations.exists[:, index]
        if not has.any() or slot.stop == slot.start:
            continue
        swing = np.subtract(*np.percentile(latents.first[has][:, slot], (95, 5), axis=0))
        alpha, beta = (np.maximum(rest, FLOOR) for rest in machine.rest[index])
        (up, down), both = machine.weights[index], (alpha + beta)[:, None] ** 2
        slope = (up * beta[:, None] - down * alpha[:, None]) / both
        promise[slot] = has.mean() * swing * np.abs(slope).sum(axis=0)
    found = []
    for unit in np.argsort(-promise, kind="stable")[: PROMISING * count]:
        part = next(l for l, slot in enumerate(machine.units_of_part) if slot.start <= unit < slot.stop)
        values = within[observations.exists[:, part], unit]
        if promise[unit] > 0 and np.ptp(values) > 0:
            vector = np.eye(1, machine.sizes[0], int(unit))[0]
            found.append(replace(_direction(machine, typical, vector, values, "unit"), unit=int(unit)))
    found.sort(key=lambda direction: -direction.size)
    return [_named(direction, index) for index, direction in enumerate(found[:count])]


def middle_shape(machine: BetaShapeMachine, observations: Observations) -> Latents:
    """The mean, in the logits of all layers, of the shapes with the commonest combination of parts (one shape).

    Figure 7's bundles show from here: on a shape of the family units are mostly all on or all off, and stay so.
    """
    patterns, which, counts = np.unique(observations.exists, axis=0, return_inverse=True, return_counts=True)
    common = int(counts.argmax())
    chosen = observations.subset(np.flatnonzero(which.reshape(-1) == common))
    latents = infer(machine, chosen.values, chosen.exists)
    means = (slider_logit(layer).mean(axis=0, keepdims=True) for layer in latents.layers)
    return Latents(tuple(sigmoid(mean).astype(machine.dtype) for mean in means), patterns[common : common + 1])


def drive(
    machine: BetaShapeMachine,
    base: Latents,
    settings: Mapping[int, float],
    exists: Bool[np.ndarray, " L"] | None = None,
    *,
    directions: Sequence[Direction],
) -> Float[np.ndarray, "K 3"]:
    """Points (K, 3) in normal coordinates of ``base`` (one shape) with sliders at ``settings`` {index: value}.

    With all sliders at 0 this is the base shape through its own H1; a slider changes H1 by what the top layers' change
    implies, so that details the top does not know stay.  ``exists`` overrides the base's parts.
    """
    points, _ = drive_latents(machine, base, settings, exists, directions=directions)
    return points


def drive_latents(
    machine: BetaShapeMachine,
    base: Latents,
    settings: Mapping[int, float],
    exists: Bool[np.ndarray, " L"] | None = None,
    *,
    directions: Sequence[Direction],
) -> tuple[Float[np.ndarray, "K 3"], Latents]:
    """As ``drive``, with the latents of the result."""
    dtype = machine.dtype
    present = base.exists[:1] if exists is None else exists[None]
    top, first = np.zeros(machine.sizes[-1]), np.zeros(machine.sizes[0])
    for index, value in settings.items():
        step = top if directions[index].kind == "direction" else first
        step += value * directions[index].vector
    moved = _moved(machine, base[:1], top[None].astype(dtype), first[None].astype(dtype))
    latents = Latents(moved.layers, present)
    return machine.to_positions(decode(machine, latents), present)[0], latents


def _bundle_layer(machine: BetaShapeMachine) -> int:
    """The layer whose units lead bundles: H2, or H1 in a machine without."""
    return min(1, machine.n_layers - 1)


def layer_of(machine: BetaShapeMachine, direction: Direction) -> int:
    """The layer whose logits a slider's values are."""
    layers = {"direction": machine.n_layers - 1, "bundle": _bundle_layer(machine), "unit": 0}
    return layers[direction.kind]


def _moved(machine: BetaShapeMachine, base: Latents, top_step: np.ndarray, first_step: np.ndarray) -> Latents:
    """Latents after steps in the logits of the top (n, O) and of H1 (n, M): the layers below the top keep what it does
    not explain."""
    last = machine.n_layers - 1
    before, after = _stepped(base.top, top_step if last else top_step + first_step)
    sides = zip(base.layers, descend(machine, before), descend(machine, after), strict=True)
    layers = [carried(own, b, a) for own, b, a in sides]
    if last:
        layers[0] = carried(layers[0], *_stepped(layers[0], first_step))
    return Latents(tuple(layers), base.exists)


def _stepped(layer: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A layer as sliders count it, and after a step in its logits."""
    start = slider_logit(layer).astype(layer.dtype)
    return sigmoid(start), sigmoid(start + step)


def _within_patterns(data: np.ndarray, exists: np.ndarray) -> np.ndarray:
    """``data`` (T, A) minus the mean over the shapes with the same parts."""
    _, which = np.unique(exists, axis=0, return_inverse=True)
    means = np.stack([data[which == index].mean(axis=0) for index in range(which.max() + 1)])
    return data - means[which]


def _typical_shapes(latents: Latents, within: np.ndarray) -> tuple[Latents, np.ndarray]:
    """For each of the commonest combinations of parts the shape nearest to its middle, and its share of the family."""
    _, which, counts = np.unique(latents.exists, axis=0, return_inverse=True, return_counts=True)
    chosen = []
    common = np.argsort(-counts, kind="stable")[:MOST_PATTERNS]
    for pattern in common:
        members = np.flatnonzero(which == pattern)
        chosen.append(int(members[np.linalg.norm(within[members], axis=1).argmin()]))
    return latents[np.array(chosen)], counts[common] / counts[common].sum()


def _direction(
    machine: BetaShapeMachine, typical: tuple[Latents, np.ndarray], vector: np.ndarray, values: np.ndarray, kind: str
) -> Direction:
    """Measure what a vector does to typical shapes: every point is judged on those that have it."""
    shapes, share = typical
    values = values - np.median(values)
    low, high = float(np.percentile(values, 5)), float(np.percentile(values, 95))
    ends = []
    for value in (low, high):
        step = np.broadcast_to((value * vector).astype(machine.dtype), (len(share), len(vector)))
        none_top, none = np.zeros_like(shapes.top), np.zeros_like(shapes.first)
        moved = _moved(machine, shapes, *((step, none) if kind == "direction" else (none_top, step)))
        ends.append(expected_values(machine, moved.first).astype(float))
    distance = np.linalg.norm(ends[1] - ends[0], axis=2) * machine.diagonals_per_unit
    weight = share[:, None] * shapes.exists[:, machine.part]
    moves = (weight * distance).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-12)
    counts, edges = np.histogram(values, BINS)
    by_part = {
        name: float(moves[members].mean())
        for name, members in zip(machine.part_names, machine.points_of_part, strict=True)
        if len(members)
    }
    ordered = sorted(by_part, key=lambda name: -by_part[name])
    named = tuple(name for name in ordered if by_part[name] >= BIG_MOVE * by_part[ordered[0]])[:3]
    caption = ", ".join(f"{name} {100 * by_part[name]:.1f}%" for name in named)
    return Direction("", caption, kind, vector, low, high, counts.astype(float), edges, moves, named)


def _named(direction: Direction, index: int) -> Direction:
    name = f"{direction.kind.capitalize()} {index + 1 if direction.kind != 'unit' else direction.unit + 1}"
    caption = f"moves {direction.caption} of the shape's size"
    return replace(direction, name=name, caption=caption)


def _sign(component: np.ndarray) -> float:
    """+1 or -1 such that the coordinate that changes most increases."""
    return 1.0 if component[np.abs(component).argmax()] >= 0 else -1.0
