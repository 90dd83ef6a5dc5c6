"""Summaries of measured values with honest intervals, and plain tables of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Summary:
    """Mean of ``n`` values with the bounds of its bootstrap interval, the median, and the worst tenth's bound."""

    mean: float
    low: float
    high: float
    median: float
    tenth: float
    n: int


def bootstrap_interval(
    values: Float[np.ndarray, " n"], *, level: float = 0.95, n_resamples: int = 1000, rng: np.random.Generator
) -> tuple[float, float]:
    """Percentile interval of the mean at ``level``, resampling the values (shapes: faces are not independent)."""
    if len(values) == 0:
        return float("nan"), float("nan")
    means = values[rng.integers(0, len(values), (n_resamples, len(values)))].mean(axis=1)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def summarize(values: Sequence[float] | Float[np.ndarray, " n"], *, rng: np.random.Generator) -> Summary:
    """Summary of one value per shape; ``tenth`` is the first decile."""
    array = np.asarray(values, float)
    if len(array) == 0:
        nan = float("nan")
        return Summary(nan, nan, nan, nan, nan, 0)
    low, high = bootstrap_interval(array, rng=rng)
    return Summary(float(array.mean()), low, high, float(np.median(array)), float(np.quantile(array, 0.1)), len(array))


def paired_difference(
    ours: Float[np.ndarray, " n"], theirs: Float[np.ndarray, " n"], *, rng: np.random.Generator
) -> Summary:
    """Summary of ours - theirs on the same shapes: the interval says whether a difference is more than luck."""
    return summarize(ours - theirs, rng=rng)


def format_table(columns: Sequence[str], rows: Sequence[Sequence[str | float | int]]) -> str:
    """Plain text: the first column to the left, the others to the right, fractions with three digits."""
    cells = [list(columns)] + [[f"{v:.3f}" if isinstance(v, float) else str(v) for v in row] for row in rows]
    wrong = [row for row in rows if len(row) != len(columns)]
    if wrong:
        raise ValueError(f"rows: wanted {len(columns)} cells in each, got {len(wrong[0])} in {wrong[0]!r}.")
    width = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    lines = []
    for row in cells:
        first = row[0].ljust(width[0])
        lines.append("  ".join([first, *(cell.rjust(w) for cell, w in zip(row[1:], width[1:], strict=True))]).rstrip())
    return "\n".join([lines[0], "  ".join("-" * w for w in width), *lines[1:]])
