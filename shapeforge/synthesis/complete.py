"""Parts that a draw lacks and cannot do without: a swivel chair's column, without which seat and base don't meet."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import connected_components

USUALLY = 0.5
"""A part bridges two others if it touches either on at least this share of the shapes that have both."""
AT_TIMES = 0.25
"""Present parts count as joined if they touch on at least this share of the shapes that have both."""
MOST_ADDED = 2
ALMOST_ALL = 0.95
"""A part that at least this share of the shapes have is missing from the others by a slip of the fit."""


def completed_parts(
    exists: Bool[np.ndarray, " L"], touching: Float[np.ndarray, "L L"], having: Float[np.ndarray, " L"]
) -> Bool[np.ndarray, " L"]:
    """The parts of a draw, with those that almost all shapes have and those that join what falls asunder; (L,).

    ``having`` (L,) is the share of the training shapes that have each part.
    """
    return bridging_parts(np.asarray(exists, bool) | (having >= ALMOST_ALL), touching)


def bridging_parts(exists: Bool[np.ndarray, " L"], touching: Float[np.ndarray, "L L"]) -> Bool[np.ndarray, " L"]:
    """The parts ``exists`` (L,) and the fewest others that join them where they fall asunder; (L,).

    ``touching`` (L, L) is how often parts touch on the training shapes (see ``Sources``).  Fits lose a part now and
    then, and a draw may take over the pattern.  Where no one or two parts join everything, nothing is added.
    """
    exists = np.asarray(exists, bool)
    before = _islands(exists, touching, exists)
    if before < 2:
        return exists
    absent = np.flatnonzero(~exists)
    for count in range(1, MOST_ADDED + 1):
        best, best_total = None, 0.0
        for added in combinations(absent, count):
            whole = exists.copy()
            whole[list(added)] = True
            total = float(touching[np.ix_(list(added), np.flatnonzero(whole))].sum())
            if _islands(whole, touching, exists) == 1 and total > best_total:
                best, best_total = whole, total
        if best is not None:
            return best
    return exists


def _islands(parts: np.ndarray, touching: np.ndarray, given: np.ndarray) -> int:
    """How many groups of parts there are that touch none of another group."""
    index = np.flatnonzero(parts)
    both_given = given[index][:, None] & given[index][None]
    joined = touching[np.ix_(index, index)] >= np.where(both_given, AT_TIMES, USUALLY)
    return int(connected_components(joined, directed=False)[0])
