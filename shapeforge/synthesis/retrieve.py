"""Which training part should become which part of a draw (§5, mesh synthesis)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.synthesis.sources import Sources

MEASURES = ("position", "translation", "affine")
CANDIDATES = 8
SWITCH = 0.006
"""Cost (mean distance, diagonals) of taking neighbouring parts from different shapes."""
STRANGE = 0.03
"""Parts that differ by so much (mean distance, diagonals) double that cost: see :func:`_unlikeness`."""
BLEMISH = 0.006
"""Cost (mean distance, diagonals) of a part as flawed as is bearable in one respect (see ``PartQuality.blemish``)."""


@dataclass(frozen=True, eq=False)
class Retrieved:
    """``shape[l]`` is the training shape for part l (-1: absent), ``distance`` (L,) that from the draw."""

    shape: Int[np.ndarray, " L"]
    distance: Float[np.ndarray, " L"]


def part_distances(
    points: Float[np.ndarray, "K 3"], sources: Sources, part: int, *, measure: str = "blend"
) -> Float[np.ndarray, " T"]:
    """Mean Euclidean distance (diagonals) of a part's points on every training shape from the draw's; inf where absent.

    ``position`` is the paper's. ``translation`` first moves the centres together, ``affine`` takes the best affine
    map, since placing and stretching a part costs its looks little. ``blend``, the default, is the mean of the first
    and the last: of two parts that bend equally well the one in place and in proportion wins.
    """
    if measure == "blend":
        return 0.5 * (
            part_distances(points, sources, part, measure="position")
            + part_distances(points, sources, part, measure="affine")
        )
    if measure not in MEASURES:
        raise ValueError(f"measure: wanted blend, {', '.join(MEASURES)}, got {measure!r}.")
    index = np.flatnonzero((sources.part == part) & np.isfinite(points).all(axis=1))
    distance = np.full(len(sources.names), np.inf)
    rows = np.flatnonzero(sources.exists[:, part])
    if len(index) == 0 or len(rows) == 0:
        return distance
    training = np.asarray(sources.positions[np.ix_(rows, index)], float)
    known = np.isfinite(training).all(axis=2)
    weight = known / np.maximum(known.sum(axis=1, keepdims=True), 1)
    training = np.where(known[..., None], training, 0.0)
    target = np.broadcast_to(np.asarray(points[index], float), training.shape)
    if measure != "position":
        training = training - np.einsum("tk,tkd->td", weight, training)[:, None]
        target = target - np.einsum("tk,tkd->td", weight, target)[:, None]
    if measure == "affine":
        second = np.einsum("tk,tki,tkj->tij", weight, training, training)
        cross = np.einsum("tk,tki,tkj->tij", weight, training, target)
        ridge = 1e-3 * np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
        training = training @ np.linalg.solve(second + ridge, cross + ridge)
    away = np.linalg.norm(training - target, axis=2)
    distance[rows] = np.where(known.any(axis=1), (weight * away).sum(axis=1), np.inf)
    return distance


def retrieve(
    points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], sources: Sources, *, measure: str = "blend",
    switch: float = SWITCH, candidates: int = CANDIDATES, fixed: Mapping[int, int] | None = None,
    joined: Iterable[tuple[int, int]] = (), barred: Iterable[tuple[int, int]] = (),
) -> Retrieved:  # fmt: skip
    """The training shape for every part of a draw: near points, usable faces, neighbours from one shape if close.

    Each part keeps its ``candidates`` nearest usable training parts (ragged, tiny or unexplained ones are passed over);
    then the sum of distances, BLEMISH times the parts' flaws and ``switch`` per touching pair from different shapes
    (more if these parts are unlike on the two) is lowered part by part from several starts.  Mirrored parts come from
    one shape, and so do pairs of parts that are to be ``joined``, if any shape has both.  A training
    shape that is ``barred`` from lending a part (part, shape) does so only where no other has it.

    ``fixed`` {part: training shape} are taken from there whatever they cost, if that shape has them, and the others are
    chosen to go with them.
    """
    n_parts = sources.n_parts
    joined = [pair for pair in joined if sources.exists[:, list(pair)].all(axis=1).any()]
    tied = _tied(n_parts, [*sources.mirror.parts, *joined], exists)
    cost = np.full((n_parts, len(sources.names)), np.inf)
    for l in np.flatnonzero(exists):
        cost[l] = part_distances(points, sources, int(l), measure=measure)
    for l, t in barred:
        if np.isfinite(np.delete(cost[l], t)).any():
            cost[l, t] = np.inf
    together = np.stack([cost[tied == tied[l]][exists[tied == tied[l]]].sum(axis=0) if exists[l] else cost[l]
                         for l in range(n_parts)])  # fmt: skip
    choices = {
        int(g): _usable(together[g], [int(l) for l in np.flatnonzero((tied == g) & exists)], sources, candidates)
        for g in np.unique(tied[exists])
    }
    wanted = {l: t for l, t in (fixed or {}).items() if exists[l] and sources.part_of(t, l) is not None}
    for l, t in wanted.items():
        if np.isfinite(together[l, t]):
            choices[int(tied[l])] = [t]
    choices = {g: found for g, found in choices.items() if len(found)}
    for g, found in choices.items():
        for t in found:
            read = [sources.part_of(t, int(l)) for l in np.flatnonzero((tied == g) & exists)]
            together[g, t] += BLEMISH * sum(p.quality.blemish for p in read if p is not None)
    chosen = _choose(choices, together, tied, exists, sources, switch)
    shape = np.array([chosen.get(int(tied[l]), -1) if exists[l] else -1 for l in range(n_parts)])
    for l, t in wanted.items():  # also where its mirror image cannot be had from there
        shape[l] = t
    distance = np.array([cost[l, shape[l]] if shape[l] >= 0 else np.inf for l in range(n_parts)])
    return Retrieved(shape, distance)


def _tied(n_parts: int, partners: Iterable[tuple[int, int]], exists: np.ndarray) -> np.ndarray:
    """Group number (the smallest part) of the parts that must come from one shape."""
    tied = np.arange(n_parts)
    for l, other in partners:
        if exists[l] and exists[other]:
            tied[tied == tied[other]] = tied[l]
    return tied


def _usable(cost: np.ndarray, parts: list[int], sources: Sources, wanted: int) -> list[int]:
    """Nearest training shapes whose parts are all usable; the least bad of the nearest ones if none is."""
    found, bad = [], []
    for t in np.argsort(cost, kind="stable")[: 4 * wanted]:
        if not np.isfinite(cost[t]):
            break
        read = [sources.part_of(int(t), l) for l in parts]
        if any(p is None for p in read):
            continue
        badness = sum(p.quality.badness for p in read if p is not None)
        if badness == 0:
            found.append(int(t))
        else:
            bad.append((badness, int(t)))
        if len(found) == wanted:
            break
    return found or [t for _, t in sorted(bad)[:1]]


def _choose(choices: dict[int, list[int]], cost: np.ndarray, tied: np.ndarray, exists: np.ndarray,
            sources: Sources, switch: float) -> dict[int, int]:  # fmt: skip
    """Coordinate descent on distances plus switching costs, from the independent best and from each single shape."""
    groups = list(choices)
    members = [np.flatnonzero((tied == g) & exists) for g in groups]
    bond = np.zeros((len(groups), len(groups)))
    for i, own in enumerate(members):
        for j, others in enumerate(members):
            if i != j:
                bond[i, j] = switch * (sources.touching[np.ix_(own, others)] >= 0.5).any()
    shapes = sorted({t for found in choices.values() for t in found})
    place = {t: n for n, t in enumerate(shapes)}
    unlike = [_unlikeness(shapes, own, sources) for own in members]

    def total(choice: list[int]) -> float:
        lost = sum(cost[g, t] for g, t in zip(groups, choice, strict=True))
        at = [place[t] for t in choice]
        for i, j in zip(*np.nonzero(np.triu(bond)), strict=True):
            if at[i] != at[j]:
                lost += bond[i, j] * (1 + (unlike[i][at[i], at[j]] + unlike[j][at[i], at[j]]) / 2)
        return float(lost)

    starts = [[choices[g][0] for g in groups]]
    for t in sorted({t for found in choices.values() for t in found}):
        starts.append([t if t in choices[g] else choices[g][0] for g in groups])
    best, best_total = starts[0], np.inf
    for choice in starts:
        value = total(choice)
        while True:
            for i, g in enumerate(groups):
                trials = [choice[:i] + [t] + choice[i + 1 :] for t in choices[g]]
                choice = min([choice, *trials], key=total)
            if total(choice) >= value - 1e-12:
                break
            value = total(choice)
        if value < best_total:
            best, best_total = choice, value
    return dict(zip(groups, best, strict=True))


def _unlikeness(shapes: list[int], parts: np.ndarray, sources: Sources) -> Float[np.ndarray, "n n"]:
    """How much the parts of training shapes differ in place and form, in units of STRANGE; 1 where one lacks them.

    A seat goes with the legs of a shape whose own seat is like it.
    """
    points = np.asarray(sources.positions[np.ix_(shapes, np.flatnonzero(np.isin(sources.part, parts)))], float)
    there = np.isfinite(points).all(axis=2)
    points = np.where(there[..., None], points, 0.0)
    found = np.ones((len(shapes), len(shapes)))
    for i in range(len(shapes)):
        both = there & there[i]
        away = np.where(both, np.linalg.norm(points - points[i], axis=2), 0.0).sum(axis=1)
        count = both.sum(axis=1)
        found[i] = np.where(count > 0, away / np.maximum(count, 1) / STRANGE, 1.0)
    return found
