"""Which parts does a shape have?  (§4, deactivation; E in the paper.)

The printed rule (label probability below 1e-3 at every sample) almost never switches a missing part off, because the
part's template settles on some other surface and claims it.  Here a part must *pay for itself*: it is taken away on
trial, the other parts may spread over what it claimed, and only if they explain that surface about as well was the
part never there.  A part that merely looks different leaves surface behind that nobody else reaches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from shapeforge.deformation import _kernels
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Candidates, Problem

SHARPNESS = 0.0165
"""σ1 (diagonals) below which the question may be asked: earlier, thin parts still look dispensable."""

LOSS_CAP = 10.0
"""Nats per point: what a far outlier may add to a part's evidence at most."""

CERTAIN_LOSS = 8.0
"""A part worth this many nats per claimed point, the others staying where they are, is not put on trial."""

WANTED_LOSS = (0.5, 6.0)
"""Nats per claimed point that a part has to be worth once the others have adapted: for a part that every shape has, and
for one that none has; in between by its prevalence among the exemplars."""

NEGLIGIBLE_SHARE = 0.05
"""Share of the surface claimed, relative to the part's share of the template, below which a part is off anyway."""

Refit = Callable[[Beliefs], tuple[Beliefs, Candidates]]
"""Lets the beliefs settle for a few updates; returns them with the candidates that were used."""


def part_prevalence(templates: Sequence[PartTemplates]) -> Float[np.ndarray, " L"]:
    """How usual each part is (L,): the share of the exemplars that have it, with one more yes and one more no."""
    has = np.array([template.has_part() for template in templates])
    return (has.sum(axis=0) + 1.0) / (len(has) + 2.0)


def explained(
    problem: Problem, templates: PartTemplates, candidates: Candidates, beliefs: Beliefs, unary: Float[np.ndarray, " 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Favourite part (P,), loss without it (P,) and log density under all parts (P,), nats, from φ1 and φ3 alone.

    φ4 and φ5 are left out, so that smoothness of labels cannot talk a part into existence.
    """
    favourite, loss, by_part = _kernels.explained_without(
        candidates.offsets, candidates.template_index, candidates.costs, problem.points, beliefs.deformed,
        1.0 / unary, templates.label, templates.n_parts, LOSS_CAP,
    )  # fmt: skip
    best = np.maximum(by_part.max(axis=1), -1e6)
    return favourite, loss, best + np.log(np.exp(by_part - best[:, None]).sum(axis=1) + 1e-300)


def switch_off_missing(
    problem: Problem,
    templates: PartTemplates,
    candidates: Candidates,
    beliefs: Beliefs,
    unary: Float[np.ndarray, " 3"],
    prevalence: Float[np.ndarray, " L"],
    refit: Refit,
) -> Beliefs:
    """Deactivate the parts that the shape does not have; parts painted on it always stay, and one part always stays.

    ``prevalence`` (see ``part_prevalence``) makes a part that is usual harder to lose than one that is rare.
    ``misfit`` of the result holds what each part is worth in nats per claimed point, after its trial if there was one.
    """
    if np.sqrt(unary.mean()) > SHARPNESS:
        return beliefs
    favourite, loss, density = explained(problem, templates, candidates, beliefs, unary)
    painted = np.bincount(problem.evidence[problem.evidence >= 0], minlength=templates.n_parts) > 0
    own = np.bincount(templates.label, minlength=templates.n_parts) * beliefs.active
    wanted = WANTED_LOSS[0] * prevalence + WANTED_LOSS[1] * (1.0 - prevalence)
    worth, missing = beliefs.misfit.copy(), np.zeros(templates.n_parts, bool)
    for part in np.flatnonzero(beliefs.active).tolist():
        claimed = favourite == part
        expected = own[part] / own.sum() * len(problem.points)
        worth[part] = float(loss[claimed].mean()) if claimed.any() else 0.0
        if painted[part] or beliefs.active.sum() == 1:
            continue
        if claimed.sum() < NEGLIGIBLE_SHARE * expected:
            missing[part] = True
        elif worth[part] < CERTAIN_LOSS:
            trial, tried = refit(without(beliefs, part))
            after = explained(problem, templates, tried, trial, unary)[2]
            worth[part] = float(np.clip(density - after, 0.0, LOSS_CAP)[claimed].mean())
            missing[part] = worth[part] < wanted[part]
    if missing[beliefs.active].all():  # the part that is worth most stays
        missing[np.nanargmax(np.where(beliefs.active, worth, np.nan))] = False
    beliefs = replace(beliefs, misfit=worth)
    # one part a round: two parts on one surface must not condemn each other
    gone = np.flatnonzero(missing)
    return without(beliefs, int(gone[np.argmin((worth - wanted)[gone])])) if len(gone) else beliefs


def without(beliefs: Beliefs, part: int) -> Beliefs:
    """The beliefs with one part switched off and its label probability handed to the others."""
    active = beliefs.active.copy()
    active[part] = False
    segmentation = np.where(active, beliefs.segmentation, 0.0) + 1e-9 * active
    return replace(beliefs, active=active, segmentation=segmentation / segmentation.sum(axis=1, keepdims=True))
