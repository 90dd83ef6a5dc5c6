"""Names for sliders from what they measurably do to a shape: "Height of the back", "Splay of the legs", "Width"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

WHOLE_COUNTS = 1.15
"""The whole shape's change wins over a part's unless the part's is this much larger."""
SECOND_BEST = 0.6
"""A name that is taken gives way to the next one, if that one describes at least this share of the change."""
LEAST = 0.004  # diagonals: less than this is no change worth a name
BIG_MOVE = 0.4
ENDS = 0.2


def _span(values: np.ndarray) -> float:
    low, high = np.percentile(values, (2, 98))
    return float(high - low)


def changes(
    before: Float[np.ndarray, "K 3"],
    after: Float[np.ndarray, "K 3"],
    part: Int[np.ndarray, " K"],
    part_names: Sequence[str],
    exists: Bool[np.ndarray, " L"],
) -> list[tuple[float, str]]:
    """What changed between two states of a shape, largest first: (size in diagonals, name).

    Only parts that the shape has (``exists``) are looked at; y is up and z is the front.
    """
    shown = exists[part]
    found = []
    for axis, word in enumerate(("Width", "Height", "Depth")):
        change = abs(_span(after[shown, axis]) - _span(before[shown, axis]))
        found.append((WHOLE_COUNTS * change, word))
    floor = [float(np.percentile(state[shown, 1], 1)) for state in (before, after)]
    for l in np.flatnonzero(exists):
        own = part == l
        if own.sum() < 8:
            continue
        a, b, name = before[own], after[own], part_names[l]
        for axis, word in enumerate(("Width", "Height", "Depth")):
            found.append((abs(_span(b[:, axis]) - _span(a[:, axis])), f"{word} of the {name}"))
        level = abs((b[:, 1].mean() - floor[1]) - (a[:, 1].mean() - floor[0]))
        found.append((0.8 * float(level), f"Level of the {name}"))
        found.append((0.8 * float(abs(b[:, 2].mean() - a[:, 2].mean())), f"Place of the {name}, back to front"))
        order = np.argsort(a[:, 1])
        count = max(int(ENDS * len(order)), 2)
        low, high = order[:count], order[-count:]
        lean = (b[high, 2].mean() - b[low, 2].mean()) - (a[high, 2].mean() - a[low, 2].mean())
        found.append((0.9 * float(abs(lean)), f"Lean of the {name}"))
        splay = (_span(b[low, 0]) - _span(b[high, 0])) - (_span(a[low, 0]) - _span(a[high, 0]))
        found.append((0.9 * float(abs(splay)), f"Splay of the {name}"))
    return sorted(found, key=lambda item: -item[0])


def choose_names(candidates: Sequence[Sequence[tuple[float, str]]], otherwise: Sequence[str]) -> list[str]:
    """One name per slider, no name twice: the largest change not named yet, else the largest with a number."""
    taken: dict[str, int] = {}
    names = []
    for found, plain in zip(candidates, otherwise, strict=True):
        if not found or found[0][0] < LEAST:
            name = plain
        else:
            worthy = [word for size, word in found if size >= SECOND_BEST * found[0][0]]
            name = next((word for word in worthy if word not in taken), worthy[0])
        taken[name] = taken.get(name, 0) + 1
        names.append(name if taken[name] == 1 else f"{name} ({taken[name]})")
    return names


def what_moves(
    moves: Float[np.ndarray, " K"],
    part: Int[np.ndarray, " K"],
    part_names: Sequence[str],
    exists: Bool[np.ndarray, " L"],
) -> str:
    """Caption of a slider: the parts (of those the shape has) that move most, and how far in percent of its size."""
    by_part = {l: float(moves[part == l].mean()) for l in np.flatnonzero(exists) if (part == l).any()}
    if not by_part:
        return ""
    most = max(by_part.values())
    named = [part_names[l] for l in sorted(by_part, key=lambda l: -by_part[l]) if by_part[l] >= BIG_MOVE * most]
    words = "all parts" if len(named) == len(by_part) > 2 else ", ".join(named[:3])
    return f"moves: {words} · {100 * most:.0f}% of size" if most >= 0.005 else f"moves: {words} · <1% of size"
