"""Which parts does a shape have?  (§4, deactivation; E in the paper.)

The printed rule (label probability below 1e-3 at every sample) almost never switches a missing part off, because the
part's template settles on some other surface and claims it.  Here several signs are weighed.  A part that is there has
its template points on the surface, each with its share of it, facing the same way; a ghost hangs in the air or crowds
on a neighbour, or lies squashed on a rail that no template knows.  And a part must *pay for itself*: it is taken away
on trial, the other parts may spread over what it claimed, and a part that merely looks different leaves surface behind
that nobody else reaches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import eigh

from shapeforge.collection.points import nearest_points
from shapeforge.deformation import _kernels_soft
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Candidates, Correspondence, Problem, mapped_normals

SHARPNESS = 0.0125
"""σ1 (diagonals) below which the question may be asked: earlier, thin parts still look dispensable."""

LOSS_CAP = 10.0
"""Nats per point: what a far outlier may add to a part's evidence at most."""

SUPPORTED = 0.3
"""Share of the surface per template point, relative to an even one, from which a template point counts as supported."""

FLAT, FLATTEST = 0.3, 0.003
"""Share of its extent from which on a part is pressed flat, and standard deviation (diagonals) that is added to the
extents: thinner is flat already."""

INTERCEPT = -12.5
SIGNS = {"support": 3.5, "gap": -1.3, "worth": 0.63, "facing": 2.9, "prior": 1.0, "flatness": -3.2}
"""Log odds that a part exists: the intercept and, per unit, its share of supported points; log of its points' distance
to the surface (diagonals, plus .003); nats per claimed point it is worth; |cos| between its normals and those it
claimed; the log odds that a shape has it, by its prevalence among exemplars; how flat it is pressed (see ``flatness``).
By logistic regression over 1100 parts, 200 of them absent, of six families; each family was predicted from the other
five with an area under the curve of .96 (the nats alone: .82).  The flatness came later, with the intercept for as many
absent ones and the other weights as they were: over 1725 parts, 93 of them absent, where 14 instead of 16 that are
there are below -2 for it, and 49 instead of 69 absent ones above.  Then the prior became its log odds, and flat what is
flatter than usual: over 4830 parts, 382 absent, of seven families 81 instead of 146 that are there are below -2, and
156 instead of 141 absent ones above (area under the curve .960, was .955)."""

USUAL, UNKNOWN = 1 / 3, 2
"""Quantile over the shapes up to which being pressed flat is usual for a part, and how many more count as not flat."""

DOUBT = -2.0
"""Log odds below which a part is switched off: losing a part that is there costs far more than keeping a ghost."""

NEGLIGIBLE_SHARE = 0.05
"""Share of the surface claimed, relative to the part's share of the template, below which a part is off anyway."""

SEEDED = 0.05
"""Share of the surface from which a part that was proposed for a shape counts as there, as a painted one does."""

Settle = Callable[[Beliefs], tuple[Beliefs, Candidates, Correspondence]]
"""Lets the beliefs settle for a few updates; returns them with the candidates and correspondences that were used."""


def part_prevalence(templates: Sequence[PartTemplates]) -> Float[np.ndarray, " L"]:
    """How usual each part is (L,): the share of the exemplars that have it, with one more yes and one more no."""
    has = np.array([template.has_part() for template in templates])
    return (has.sum(axis=0) + 1.0) / (len(has) + 2.0)


def given_parts(problem: Problem, n_parts: int) -> Bool[np.ndarray, " L"]:
    """Parts (L,) that are not in question: painted on the shape, or proposed for enough of it."""
    given = np.bincount(problem.evidence[problem.evidence >= 0], minlength=n_parts) > 0
    if problem.leaning is not None:
        proposed = np.bincount(problem.leaning.argmax(axis=1), minlength=n_parts)
        given |= proposed > SEEDED * len(problem.points)
    return given


def explained(
    problem: Problem, owner: Int[np.ndarray, " K"], candidates: Candidates, beliefs: Beliefs,
    unary: Float[np.ndarray, " 3"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Favourite part (P,), loss without it (P,) and log density under all parts (P,), nats, from φ1 and φ3 alone.

    ``owner`` is the part of each template point, or whatever else is asked about, counted from 0.  φ4 and φ5 are left
    out, so that smoothness of labels cannot talk a part into existence.
    """
    favourite, loss, by_part = _kernels_soft.explained_without(
        candidates.offsets, candidates.template_index, candidates.costs, problem.points, beliefs.deformed,
        1.0 / unary, owner, int(owner.max()) + 1, LOSS_CAP,
    )  # fmt: skip
    best = np.maximum(by_part.max(axis=1), -1e6)
    return favourite, loss, best + np.log(np.exp(by_part - best[:, None]).sum(axis=1) + 1e-300)


def gap_to_surface(problem: Problem, beliefs: Beliefs) -> Float[np.ndarray, " K"]:
    """Distance of each deformed template point (K,) to the surface, diagonals.

    From samples to the surface between them: half their spacing says nothing.
    """
    return np.maximum(nearest_points(problem.points, beliefs.deformed)[1][:, 0] - 0.5 * problem.spacing, 0.0)


def signs_of(
    problem: Problem, beliefs: Beliefs, normals: Float[np.ndarray, "K 3"], gap: Float[np.ndarray, " K"],
    supported: Bool[np.ndarray, " K"], mine: Bool[np.ndarray, " K"], claimed: Bool[np.ndarray, " P"],
    loss: Float[np.ndarray, " P"],
) -> dict[str, float]:  # fmt: skip
    """What speaks for or against the template points ``mine`` (K,), whose favourite points are ``claimed`` (P,)."""
    nearest = nearest_points(beliefs.deformed[mine], problem.points[claimed])[0][:, 0]
    return {
        "support": float(supported[mine].mean()), "gap": float(np.log(gap[mine].mean() + 0.003)),
        "worth": min(float(loss[claimed].mean()), LOSS_CAP),
        "facing": float(np.abs((normals[mine][nearest] * problem.normals[claimed]).sum(axis=1)).mean()),
    }  # fmt: skip


def flatness(templates: PartTemplates, beliefs: Beliefs) -> Float[np.ndarray, " L"]:
    """How much flatter than ``FLAT`` each part (L,) is pressed, as a logarithm; 0 of those that are not.

    By its own map, in the direction in which it lost most of the extent that the one affine map of the whole template
    leaves it.  A part that is there is nearly as long, wide and thick as the rest says, whatever it looks like.
    """
    alive = np.flatnonzero(beliefs.alive(templates.label))
    label, points = templates.label[alive], templates.points[alive] - templates.points[alive].mean(axis=0)
    # not by BLAS, whose sums over many rows depend on its number of threads
    second = np.einsum("ni,nj->ij", points, points)
    cross = np.einsum("ni,nj->ij", beliefs.deformed[alive] - beliefs.deformed[alive].mean(axis=0), points)
    whole = cross @ np.linalg.inv(second + 1e-6 * np.trace(second) * np.eye(3))
    least, flat = FLATTEST**2 * np.eye(3), np.zeros(templates.n_parts)
    for part in np.unique(label).tolist():
        mine, own = points[label == part], beliefs.maps[part]
        mine = mine - mine.mean(axis=0)
        spread = np.einsum("ni,nj->ij", mine, mine) / len(mine)
        left, wanted = (by @ spread @ by.T + least for by in (own, whole))
        flat[part] = max(0.0, np.log(FLAT) - 0.5 * np.log(eigh(left, wanted, eigvals_only=True)[0]))
    return flat


def usual_flatness(found: Sequence[Float[np.ndarray, " L"]]) -> Float[np.ndarray, " L"]:
    """How flat each part (L,) is usually pressed, from its ``flatness`` on shapes, NaN on those without it.

    A cabinet that stands for all shelves is pressed flat on every shelf that is a board.  That is how the exemplar is,
    and says nothing against the part; being flatter than on other shapes does.
    """
    usual = np.zeros(len(found[0]))
    for part, values in enumerate(np.transpose(found)):
        there = values[~np.isnan(values)]
        usual[part] = np.quantile(np.concatenate([there, np.zeros(UNKNOWN)]), USUAL)
    return usual


def worth_on_trial(
    before: Float[np.ndarray, " P"], after: Float[np.ndarray, " P"], claimed: Bool[np.ndarray, " P"]
) -> float:
    """Nats that ``claimed`` points (P,) lose on average by a trial; of the log density of all, before and after it."""
    return float(np.clip(before - after, 0.0, LOSS_CAP)[claimed].mean())


def existence_odds(
    problem: Problem,
    templates: PartTemplates,
    candidates: Candidates,
    correspondence: Correspondence,
    beliefs: Beliefs,
    unary: Float[np.ndarray, " 3"],
    settle: Settle,
    *,
    owner: Int[np.ndarray, " K"],
    asked: Bool[np.ndarray, " N"],
    intercept: float,
    weights: Mapping[str, float],
    known: Mapping[str, Float[np.ndarray, " N"]],
    without: Callable[[int], Beliefs | None],
) -> Float[np.ndarray, " N"]:
    """Log odds (N,) that parts, or whatever else template points are of, exist: -inf of those that hardly a point of
    the surface is left to, NaN of those not ``asked`` about (N,) and of those without points.

    ``owner`` (K,) is whose each template point is, counted from 0.  ``weights`` are per unit of each sign (see
    ``signs_of``) and of what is ``known`` without looking.  ``without`` gives the beliefs without one of them, None
    where it stays anyway.
    """
    favourite, loss, density = explained(problem, owner, candidates, beliefs, unary)
    alive = beliefs.alive(templates.label)
    supported = correspondence.mass > SUPPORTED * len(problem.points) / alive.sum()
    gap, normals = gap_to_surface(problem, beliefs), mapped_normals(templates, beliefs)
    odds = np.full(len(asked), np.nan)
    for one in np.flatnonzero(asked).tolist():
        claimed, mine = favourite == one, alive & (owner == one)
        if not mine.any():
            continue
        if claimed.sum() < NEGLIGIBLE_SHARE * mine.sum() / alive.sum() * len(problem.points):
            odds[one] = -np.inf
            continue
        signs = signs_of(problem, beliefs, normals, gap, supported, mine, claimed, loss)
        signs |= {name: float(value[one]) for name, value in known.items()}
        odds[one] = intercept + sum(weights[name] * value for name, value in signs.items())
        # the loss with the others staying where they are is an upper bound; the trial is for those that it may condemn
        if odds[one] - weights["worth"] * signs["worth"] < DOUBT:
            left = without(one)
            if left is not None:
                trial, tried, _ = settle(left)
                after = explained(problem, owner, tried, trial, unary)[2]
                odds[one] += weights["worth"] * (worth_on_trial(density, after, claimed) - signs["worth"])
    return odds


def switch_off_missing(
    problem: Problem,
    templates: PartTemplates,
    candidates: Candidates,
    correspondence: Correspondence,
    beliefs: Beliefs,
    unary: Float[np.ndarray, " 3"],
    prevalence: Float[np.ndarray, " L"],
    settle: Settle,
) -> Beliefs:
    """Deactivate the part that the shape most likely does not have; painted parts always stay, and one part always.

    ``prevalence`` (see ``part_prevalence``) makes a part that is usual harder to lose than one that is rare.
    ``misfit`` of the result holds the log odds of each part's existence; nobody asks about painted ones.
    """
    if np.sqrt(unary.mean()) > SHARPNESS:
        return beliefs
    painted = given_parts(problem, templates.n_parts)
    flatter = np.maximum(flatness(templates, beliefs) - templates.flatness, 0.0)
    found = existence_odds(
        problem, templates, candidates, correspondence, beliefs, unary, settle, owner=templates.label,
        asked=beliefs.active & ~painted, intercept=INTERCEPT, weights=SIGNS,
        known={"prior": np.log(prevalence / (1.0 - prevalence)), "flatness": flatter},
        without=lambda part: without(beliefs, part) if beliefs.active.sum() > 1 else None,
    )  # fmt: skip
    # those of parts found missing before are kept: the window shows them
    odds = np.where(np.isnan(found), beliefs.misfit, found)
    beliefs = replace(beliefs, misfit=odds)
    missing = beliefs.active & ~painted & (odds < DOUBT)
    if (missing == beliefs.active).all():  # the likeliest part stays
        missing[np.argmax(np.where(beliefs.active, odds, -np.inf))] = False
    # one part a round: two parts on one surface must not condemn each other
    gone = np.flatnonzero(missing)
    return without(beliefs, int(gone[np.argmin(odds[gone])])) if len(gone) else beliefs


def without(beliefs: Beliefs, part: int) -> Beliefs:
    """The beliefs with one part switched off and its label probability handed to the others."""
    active = beliefs.active.copy()
    active[part] = False
    segmentation = np.where(active, beliefs.segmentation, 0.0) + 1e-9 * active
    return replace(beliefs, active=active, segmentation=segmentation / segmentation.sum(axis=1, keepdims=True))
