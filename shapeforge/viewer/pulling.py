"""Handles on the shape in hand, and which sliders move how far when one is pulled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from shapeforge.generative.units import drive
from shapeforge.viewer.sculptor import Sculptor

PULL_STEP, PULL_COST, FARTHEST = 0.25, 0.01, 3.0  # standard deviations, diagonals, standard deviations


def handles_of(points: Float[np.ndarray, "K 3"], count: int = 9) -> Int[np.ndarray, " h"]:
    """Points to pull at (NaN where absent): far apart from each other, the outermost first."""
    there = np.flatnonzero(np.isfinite(points).all(axis=1))
    if not len(there):
        return there
    own = points[there]
    chosen = [int(np.linalg.norm(own - own.mean(axis=0), axis=1).argmax())]
    away = np.linalg.norm(own - own[chosen[0]], axis=1)
    while len(chosen) < min(count, len(there)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(own - own[chosen[-1]], axis=1))
    return there[chosen]


def pull(
    sculptor: Sculptor, point: int, locked: frozenset[int] = frozenset()
) -> Callable[[Float[np.ndarray, " 3"]], dict[int, float]]:
    """Take hold of template point ``point``: the result maps a wanted displacement (diagonals) to slider values.

    The most likely change that moves the point there: least squares with one standard deviation of any slider
    costing as much as PULL_COST diagonals of miss, about the present state.
    """
    start = dict(sculptor.session.sliders)
    free = [i for i in range(sculptor.coarse) if i not in locked]
    before = sculptor.points()[point]
    jacobian = np.zeros((3, len(free)))
    for column, index in enumerate(free):
        settings = {i: v * sculptor.unit(i) for i, v in start.items()}
        settings[index] = settings.get(index, 0.0) + PULL_STEP * sculptor.unit(index)
        moved = drive(
            sculptor.machine, sculptor.recipe.base, settings, sculptor.exists(), directions=sculptor.directions
        )[point]
        jacobian[:, column] = (moved - before) / PULL_STEP
    matrix = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + PULL_COST**2 * np.eye(3))

    def wanted(displacement: np.ndarray) -> dict[int, float]:
        step = matrix @ displacement
        values = {i: start.get(i, 0.0) + float(d) for i, d in zip(free, step, strict=True)}
        return {**start, **{i: float(np.clip(v, -FARTHEST, FARTHEST)) for i, v in values.items()}}

    return wanted
