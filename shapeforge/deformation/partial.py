"""Starts with some of a template's parts only: a stool beside chairs with backs.

The affine map of a whole chair presses the back into a stool's seat, and what has become flat and crowded there is
never told apart again: every part sits on some surface.  So the template is also tried without the parts without which
the rest explains the shape far better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.collection.align import Alignment, affine_align, thinned
from shapeforge.collection.points import nearest_points
from shapeforge.deformation import _kernels
from shapeforge.deformation.exemplars import misfit_of
from shapeforge.deformation.templates import FEWEST_LABELLED, PartTemplates

GLANCED, STEPS, STARTS = 150, 8, ("box", "spread")
"""Points of either side, steps and starts of the affine map by which sets of parts are screened."""

BEAM, FINALISTS = 2, 3
"""Sets of parts of which smaller ones are tried, and sets that are looked at closely."""

CLOSELY = 600
"""Points of either side by which a set of parts is looked at closely: those that ``affine_align`` takes by itself.  By
fewer, sets of parts fit the very points that they are judged by better than whole templates, aligned by others, do."""

GAIN, BETTER = 1.0, 1.0
"""Nats by which a set of parts must explain the shape better than larger ones at a glance, and than any template with
all of its parts when looked at closely."""

HOPELESS, BEHIND = 6.0, 3.0
"""Nats behind the best from which a template is not tried with fewer parts, and from which what it found is dropped."""

LEFT_OUT = -3.0
"""Log odds of the existence of a part that was left out: of 32 sets of parts left out on generated chairs, 30 were
indeed not there."""

LEAST_SHARE = 0.1
"""Share of the template's points that must be left; and as many points as a template needs."""


@dataclass(frozen=True, eq=False)
class PartialStart:
    """An affine map onto a shape of the ``active`` parts (L,) of a template alone."""

    template: int
    active: Bool[np.ndarray, " L"]
    alignment: Alignment


def partial_starts(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    templates: Sequence[PartTemplates],
    alignments: Sequence[Alignment],
    kept: Bool[np.ndarray, " L"],
    prevalence: Float[np.ndarray, " L"],
) -> list[PartialStart]:
    """Starts without some parts that explain a shape's ``points`` and ``normals`` (P, 3) better than all whole ones do.

    At most one of each template; ``alignments`` are the maps of all of it.  Parts ``kept`` (L,) stay (see
    ``existence.given_parts``), the others are left out one by one: at a glance, then closely, where one that is there
    as a rule, by its ``prevalence`` (L,) among the exemplars, must be worth its prior log odds.
    """
    prior = np.maximum(np.log(prevalence / (1.0 - prevalence)), 0.0)
    few = thinned(points, CLOSELY), thinned(normals, CLOSELY)
    whole = [
        misfit(*few, template, _evenly(template, template.has_part(), CLOSELY), alignment)
        for template, alignment in zip(templates, alignments, strict=True)
    ]
    found: list[tuple[float, PartialStart]] = []
    for g, template in enumerate(templates):
        if whole[g] > min(whole) + HOPELESS or min(whole) < BETTER:
            continue
        best, least = None, min(whole) - BETTER
        for active in _screened(points, normals, template, alignments[g], kept):
            rows = _evenly(template, active, CLOSELY)
            alignment = affine_align(template.points[rows], few[0])
            cost = misfit(*few, template, rows, alignment) + prior[template.has_part() & ~active].sum()
            if cost < least:
                best, least = PartialStart(g, active, alignment), cost
        if best is not None:
            found.append((least, best))
    return [start for cost, start in found if cost < min(cost for cost, _ in found) + BEHIND]


def _screened(points, normals, template: PartTemplates, whole: Alignment, kept) -> list[np.ndarray]:
    """Sets of parts that explain the shape clearly better at a glance than larger ones: the best few, best first."""
    few = thinned(points, GLANCED), thinned(normals, GLANCED)
    size = np.bincount(template.label, minlength=template.n_parts)
    share = size / template.n_points

    def glance(active: np.ndarray, alignment: Alignment | None = None) -> float:
        rows = _evenly(template, active, GLANCED)
        if alignment is None:
            alignment = affine_align(template.points[rows], few[0], starts=STARTS, max_iterations=STEPS)
        return misfit(*few, template, rows, alignment)

    has = template.has_part()
    beam, least = [has], glance(has, whole)
    costs: dict[bytes, float] = {}
    while beam:
        smaller = {}
        for active in beam:
            for part in np.flatnonzero(active & ~kept):
                left = active & (np.arange(len(active)) != part)
                if share[left].sum() >= LEAST_SHARE and size[left].sum() >= FEWEST_LABELLED:
                    smaller[left.tobytes()] = left
        tried = sorted((glance(left), key) for key, left in smaller.items() if key not in costs)
        costs |= {key: cost for cost, key in tried if cost < least - GAIN}
        beam = [smaller[key] for cost, key in tried[:BEAM] if cost < least - GAIN]
        least = min(least, *(cost for cost, _ in tried)) if tried else least
    best = sorted(costs, key=costs.__getitem__)[:FINALISTS]
    return [np.frombuffer(key, bool) for key in best]


def _evenly(template: PartTemplates, active: np.ndarray, count: int) -> np.ndarray:
    """About ``count`` template points of active parts, evenly over their order: points are in no order of parts."""
    return thinned(np.flatnonzero(active[template.label]), count)


def misfit(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    template: PartTemplates,
    rows: Int[np.ndarray, " n"],
    alignment: Alignment,
) -> float:
    """What gaps and angles between a shape and the template points ``rows`` under an affine map cost (nats)."""
    moved = alignment(template.points[rows])
    facing = _kernels.carried_normals(alignment.matrix[None], np.zeros(len(rows), np.int32), template.normals[rows])
    nearest, distance = (one[:, 0] for one in nearest_points(moved, points))
    back = nearest_points(points, moved)[1]
    turn = 1.0 - np.abs((facing[nearest] * normals).sum(axis=1))
    return misfit_of(distance, back, turn)
