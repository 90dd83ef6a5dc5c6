"""Levels between the top and the groups: a group's part is linked over templates that are nearer to it (§4).

Of many groups some are so unlike the top that a registration goes astray, while others lie in between: the paper's
further levels.  That a registration went astray is seen without any truth: points that go to another group's template
and come back should be where they were (cycle consistency, as in Nguyen et al. 2011, "An optimization approach to
improving collections of shape maps").  Errors of registrations that follow each other add like variances, so a group
hangs from that before it on the path from the top with the least sum of squared round trips; but from the top itself
where the round trip to the top is as exact as the points are dense, or where over the path it would not be clearly
shorter and nearly as exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from shapeforge.collection.align import affine_align
from shapeforge.collection.points import nearest_points
from shapeforge.deformation.registration import LEAST_POINTS, Registrations, carried

FEWEST_GROUPS = 6
"""Groups that have a part from which on there may be levels between them and the top: of fewer none is in between."""

NEAREST = 5
"""Templates of a part, the nearest by what an affine map leaves, over which each may be linked."""

SHORTER = 0.6
"""Share of its direct round trip to the top that a group's round trip over another must stay below."""

REACHED = 2.0
"""How far apart, in the distance of the top's points from each other, points may be after a round trip over another
group: further, and neither way is right."""

PART_SAMPLE = 300
"""Points of either side by which nearness is told."""


@dataclass(frozen=True, eq=False)
class Levels:
    """One part of one group, the top, on the others: ``places[g]`` of its points (k, 3) on the template of group g,
    and the group ``over[g]`` between them, where there is one."""

    places: dict[int, np.ndarray]
    over: dict[int, int]


def link_part(registrations: Registrations, top: int, part: int) -> Levels:
    """Link a part of the group ``top`` to every other group that has it: directly, or over others."""
    owners = [int(g) for g in np.flatnonzero(registrations.has[:, part]) if g != top]
    places = {g: registrations.of_part(top, g, part) for g in owners}
    large = [g for g in (top, *owners) if registrations.part(g, part).n_points >= LEAST_POINTS]
    if top not in large or len(large) < FEWEST_GROUPS:
        return Levels(places, {})
    back = {g: registrations.of_part(g, top, part) for g in large if g != top}
    own, over = registrations.part(top, part).points, {}
    exact = nearest_points(own, own, 2)[1].max(axis=1).mean()

    def trip(g: int, there: np.ndarray, again: np.ndarray) -> float:
        return _round_trips(own, there, registrations.part(g, part).points, again)

    astray = [g for g in back if trip(g, places[g], back[g]) > exact]
    for g, before in _paths(registrations, part, large, top) if astray else ():
        if g not in astray or before == top:
            continue
        middle = registrations.part(before, part).points
        there = carried(places[before], middle, registrations.of_part(before, g, part))
        there = registrations.onward(top, g, part, there)
        again = carried(registrations.of_part(g, before, part), middle, back[before])
        again = registrations.onward(g, top, part, again)
        if trip(g, there, again) < min(SHORTER * trip(g, places[g], back[g]), REACHED * exact):
            places[g], back[g], over[g] = there, again, before
    return Levels(places, over)


def _paths(registrations: Registrations, part: int, groups: list[int], top: int) -> list[tuple[int, int]]:
    """Each group but the top, with the one before it on the path from the top; the latter come first."""
    number, near = len(groups), min(NEAREST, len(groups) - 1)
    residual = np.full((number, number), np.inf)
    for i, a in enumerate(groups):
        for j, b in enumerate(groups[:i]):
            mine, theirs = registrations.part(a, part).points, registrations.part(b, part).points
            residual[i, j] = residual[j, i] = affine_align(mine, theirs, n_points=PART_SAMPLE).residual
    joined = residual <= np.sort(residual, axis=1)[:, near - 1, None]
    joined |= joined.T
    start = groups.index(top)
    joined[start], joined[:, start] = True, True
    cost = np.zeros((number, number))
    for i, j in np.argwhere(np.triu(joined, 1)):
        a, b = groups[i], groups[j]
        on_a, on_b = registrations.part(a, part).points, registrations.part(b, part).points
        trip = _round_trips(on_a, registrations.of_part(a, b, part), on_b, registrations.of_part(b, a, part))
        cost[i, j] = cost[j, i] = max(trip**2, 1e-12)
    total, before = dijkstra(csr_array(cost), indices=start, return_predecessors=True)
    return [(groups[i], groups[before[i]]) for i in np.argsort(total, kind="stable") if i != start]


def _round_trips(a: np.ndarray, on_b: np.ndarray, b: np.ndarray, on_a: np.ndarray) -> float:
    """Mean distance (diagonals) from where they were of points a (n, 3) that lie at ``on_b`` (n, 3) on template b, and
    go back as b (m, 3) goes to ``on_a`` (m, 3), and of points b likewise."""
    return 0.5 * float(
        np.linalg.norm(carried(on_b, b, on_a) - a, axis=1).mean()
        + np.linalg.norm(carried(on_a, a, on_b) - b, axis=1).mean()
    )
