"""Handles on the shape in hand: the points that are offered to pull at, and how far off they are held."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float, Int

from shapeforge.viewer.recipe import Place

MET = 0.02
"""Diagonals within which a point is where it is held."""

Found = TypeVar("Found")


class FoundOnce(Generic[Found]):
    """What takes long to find: called from whichever thread first, it is found; from then on it is known."""

    def __init__(self, find: Callable[[], Found]) -> None:
        self._find, self._lock = find, threading.Lock()

    def __call__(self) -> Found:
        with self._lock:
            if not hasattr(self, "_found"):
                self._found = self._find()
            return self._found


def handles_of(points: Float[np.ndarray, "K 3"], count: int = 9, pinned: Collection[int] = ()) -> Int[np.ndarray, " h"]:
    """Points to pull at (NaN where absent): those ``pinned``, and more, far from these and from each other.

    There are ``count`` of them, or as many as are pinned.
    """
    there = np.flatnonzero(np.isfinite(points).all(axis=1))
    if not len(there):
        return there
    own = points[there]
    chosen = [int(i) for i in np.flatnonzero(np.isin(there, list(pinned)))]
    if not chosen:
        chosen = [int(np.linalg.norm(own - own.mean(axis=0), axis=1).argmax())]
    away = np.linalg.norm(own[:, None] - own[chosen], axis=2).min(axis=1)
    while len(chosen) < min(count, len(there)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(own - own[chosen[-1]], axis=1))
    return there[chosen]


def nearest_point(points: Float[np.ndarray, "K 3"], place: Float[np.ndarray, " 3"]) -> int:
    """The point (NaN where absent) that lies nearest to a place of the surface."""
    return int(np.nanargmin(np.linalg.norm(points - place, axis=1)))


def off_by(points: Float[np.ndarray, "K 3"], point: int, place: Place) -> float:
    """How far (diagonals) a point is from where it is held."""
    return float(np.linalg.norm(points[point] - place))


def as_place(at: Float[np.ndarray, " 3"]) -> Place:
    """A position as it is kept in the Session."""
    x, y, z = (float(number) for number in at)
    return x, y, z
