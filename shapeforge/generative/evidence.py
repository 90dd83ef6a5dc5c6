"""Draws that agree with what is known of the shape: some points, some units; and ways between two shapes.

The posterior has no closed form.  Units are held through the top-down mean field.  Points are taken in by an ensemble
smoother: some hundred draws tell how the logits of H1 and the known points vary together, and every draw is moved by
what its own miss then implies, a few times over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.generative.draw import Draw, Mixture, codes_near, draw_codes
from shapeforge.generative.inference import (
    DOWN_ROUNDS,
    Latents,
    carried,
    decode,
    descend,
    expected_at,
    expected_values,
    infer,
    logit,
    settle,
    sigmoid,
)  # fmt: skip
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import to_values

ENSEMBLE = 150
ROUNDS = 4
LEAST_SHARE = 0.25
"""Shapes are preferred by the points given so far only that this share of them is still in play: the smoother needs
draws that differ, to tell what varies with what."""

Clamped = Mapping[tuple[int, int], float]
"""(layer, unit) -> value in [0, 1] it is held at; layer 0 is H1."""


def draw_given(
    machine: BetaShapeMachine,
    mixture: Mixture,
    n: int,
    *,
    rng: np.random.Generator,
    points: Float[np.ndarray, "K 3"] | None = None,
    clamped: Clamped | None = None,
    exists: Bool[np.ndarray, " L"] | None = None,
    needed: Int[np.ndarray, " m"] | None = None,
    unwanted: Int[np.ndarray, " m2"] | None = None,
    start: Latents | None = None,
    tolerance: float = 0.005,
    temperature: float = 1.0,
) -> Draw:
    """n new shapes that agree with what is known, from the posterior as far as the approximations reach.

    ``points`` (normal coordinates, NaN where nothing is known) are met up to about ``tolerance`` diagonals, as far as
    the family can; their parts exist.  ``clamped`` units stay at their values, and shapes are drawn that suit them.
    ``exists`` asks for these parts; or parts ``needed`` (by index) are there, ``unwanted`` ones are not, and the rest
    as the family has them; where no shape is like that, as ``structure`` finds likely.  With ``start`` all are near
    that shape, and have its parts where none are asked for.  ``temperature`` is that of ``draw``.

    Raises ValueError for a unit that does not exist, or a point whose part is not to be there.
    """
    clamped = _checked(machine, clamped)
    known = np.zeros(0, np.int64) if points is None else np.flatnonzero(np.isfinite(points).all(axis=1))
    on, off = (np.zeros(0, np.int64) if some is None else some for some in (needed, unwanted))
    on = np.union1d(on, np.unique(machine.part[known])).astype(np.int64)
    possible = ~np.isin(np.arange(machine.n_parts), off) if exists is None else exists
    if not possible[on].all():
        missing = ", ".join(machine.part_names[part] for part in on if not possible[part])
        raise ValueError(
            f"exists: wanted the parts that are needed or whose points are given, got none of {missing}; "
            "give no points of parts that the shape is not to have"
        )
    count = max(n, ENSEMBLE) if len(known) else n
    if start is None:
        prefer = _preference(machine, mixture, points, known, clamped)
        codes, states = draw_codes(
            mixture, count, rng=rng, exists=exists, temperature=temperature, prefer=prefer, needed=on, unwanted=off,
            structure=machine.structure,
        )  # fmt: skip
    else:
        codes = codes_near(mixture, start, count, rng=rng, temperature=temperature)
        states = np.repeat(start.exists[:1] if exists is None else exists[None], count, axis=0)
        states[:, on], states[:, off] = True, False
    latents = Latents(held(machine, mixture.layers(codes.astype(machine.dtype)), clamped), states)
    if len(known):
        latents = _met(machine, latents, points, known, clamped, tolerance, rng)[:n]
    return Draw(machine.to_positions(decode(machine, latents), latents.exists), latents.exists, latents)


def _checked(machine: BetaShapeMachine, clamped: Clamped | None) -> dict[tuple[int, int], float]:
    """The units to hold; raises ValueError for one that does not exist or a value that no unit can have."""
    held_at = dict(clamped or {})
    for (layer, unit), value in held_at.items():
        if not (0 <= layer < machine.n_layers and 0 <= unit < machine.sizes[layer] and 0 <= value <= 1):
            raise ValueError(
                f"clamped: wanted (layer, unit) within layers of {machine.sizes} units and a value in [0, 1], got "
                f"({layer}, {unit}): {value}; layers and units count from 0"
            )
    return held_at


def _preference(
    machine: BetaShapeMachine, mixture: Mixture, points: np.ndarray | None, known: np.ndarray, clamped: Clamped
) -> np.ndarray:
    """How well each of the family's shapes suits what is known, in nats (T,)."""
    layers, prefer = mixture.layers(mixture.codes), np.zeros(len(mixture.codes))
    for (layer, unit), value in clamped.items():
        q = np.clip(layers[layer][:, unit].astype(float), 1e-4, 1 - 1e-4)
        prefer += value * np.log(q) + (1 - value) * np.log1p(-q)
    if len(known):
        squares = np.concatenate(
            [
                ((_points_of(machine, layers[0][first : first + 100])[:, known] - points[known]) ** 2).mean(axis=(1, 2))
                for first in range(0, len(prefer), 100)
            ]
        )
        prefer -= _tempered(squares)
    return prefer


def between(first: Latents, second: Latents, shares: Sequence[float] | Float[np.ndarray, " n"]) -> Latents:
    """The way from one shape to another, one row for each share in [0, 1]: in the logits of every layer, with the
    parts of the nearer end.  Both are single shapes."""
    share = np.asarray(shares, float)[:, None]
    layers = tuple(
        sigmoid((1 - share) * logit(a[:1]) + share * logit(b[:1])).astype(a.dtype)
        for a, b in zip(first.layers, second.layers, strict=True)
    )
    return Latents(layers, np.where(share < 0.5, first.exists[:1], second.exists[:1]))


def _points_of(machine: BetaShapeMachine, first: np.ndarray) -> np.ndarray:
    """All points (n, K, 3) of rows of H1, whatever parts exist."""
    return machine.to_positions(expected_values(machine, first), np.ones((len(first), machine.n_parts), bool))


def _tempered(cost: np.ndarray) -> np.ndarray:
    """``cost`` (T,) scaled as high as LEAST_SHARE allows (in effective shapes) when its negative is a log weight."""
    low, high = 0.0, 1e3 / max(float(np.ptp(cost)), 1e-12)
    for _ in range(60):
        middle = (low + high) / 2
        share = np.exp(-middle * (cost - cost.min()))
        share /= share.sum()
        low, high = (middle, high) if 1 / (share**2).sum() > LEAST_SHARE * len(cost) else (low, middle)
    return low * (cost - cost.min())


def held(machine: BetaShapeMachine, layers: tuple[np.ndarray, ...], clamped: Clamped) -> tuple[np.ndarray, ...]:
    """All layers with some units held: the layers below change by what holding them changes in the top-down mean field,
    and keep what it does not explain."""
    if not clamped:
        return layers
    last = machine.n_layers - 1
    moved: list[np.ndarray | None] = [None] * last + [layers[-1] - machine.centres[-1]]

    def hold(index: int) -> None:
        for (layer, unit), value in clamped.items():
            if layer == index:
                moved[index][:, unit] = value - machine.centres[index][unit]

    hold(last)
    for _ in range(DOWN_ROUNDS):
        for index in reversed(range(last)):
            moved[index] = settle(machine, index, machine.biases[index], moved)
            hold(index)
    after = [m + centre for m, centre in zip(moved, machine.centres, strict=True)]
    free = descend(machine, layers[-1])
    found = [carried(own, f, h) for own, f, h in zip(layers[:-1], free, after, strict=False)]
    found.append(after[-1])
    for (layer, unit), value in clamped.items():
        found[layer][:, unit] = value
    return tuple(found)


def _met(
    machine: BetaShapeMachine, latents: Latents, points: np.ndarray, known: Int[np.ndarray, " n"], clamped: Clamped,
    tolerance: float, rng: np.random.Generator,
) -> Latents:  # fmt: skip
    """The ensemble moved until its known points are where they should be."""
    sd = tolerance / machine.diagonals_per_unit
    target = to_values(points[known], machine.low, machine.high).reshape(-1) / sd

    def see(first: np.ndarray) -> np.ndarray:
        return expected_at(machine, sigmoid(first).astype(machine.dtype), known).reshape(len(first), -1) / sd

    fixed = np.array([unit for layer, unit in clamped if layer == 0], np.int64)
    first = smoothed(logit(latents.first).astype(float), see, target, rng=rng, fixed=fixed)
    found = sigmoid(first).astype(machine.dtype)
    values = expected_values(machine, found)
    above = infer(machine, values, latents.exists).layers[1:] if machine.n_layers > 1 else ()
    layers = (found, *above)
    for (layer, unit), value in clamped.items():
        layers[layer][:, unit] = value
    return Latents(layers, latents.exists)


def smoothed(
    states: Float[np.ndarray, "n A"],
    see: Callable[[np.ndarray], np.ndarray],
    target: Float[np.ndarray, " s"],
    *,
    rng: np.random.Generator,
    fixed: Int[np.ndarray, " f"] | None = None,
    exact: int = 0,
) -> Float[np.ndarray, "n A"]:
    """The rows of an ensemble moved until ``see(states)`` (n, s) is at ``target``: Kalman's gain, ``ROUNDS`` times.

    Both are in units of the standard deviation that what is known has.  The first ``exact`` rows are told it as it is,
    the others with that much noise, so that they keep varying; columns ``fixed`` do not move.
    """
    for _ in range(ROUNDS):
        seen = see(states).astype(float)
        wanted = target + np.sqrt(ROUNDS) * rng.standard_normal(seen.shape)
        wanted[:exact] = target
        vary, move = seen - seen.mean(axis=0), states - states.mean(axis=0)
        if fixed is not None:
            move[:, fixed] = 0
        noise = (len(states) - 1) * ROUNDS
        if seen.shape[1] < len(states):  # the same gain, whichever of the two systems is the smaller
            gain = np.linalg.solve(vary.T @ vary + noise * np.eye(seen.shape[1]), vary.T @ move)
        else:
            gain = vary.T @ np.linalg.solve(vary @ vary.T + noise * np.eye(len(states)), move)
        states = states + (wanted - seen) @ gain
    return states
