"""One outer round of the fit on one shape: pure functions of their arguments, which any executor may run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.components import spare_in_place, switch_off_spare
from shapeforge.deformation.energy import free_energy
from shapeforge.deformation.exemplars import Candidate, compact, unpacked, weigh, weighted
from shapeforge.deformation.existence import flatness, given_parts, part_prevalence, switch_off_missing
from shapeforge.deformation.factors import Covariances, attraction
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import (
    Candidates,
    Correspondence,
    Problem,
    Summary,
    candidates_without,
    find_candidates,
    leaning_to,
    make_problem,
    summarize,
    update_correspondences,
    update_deformations,
    update_maps,
    update_segmentation,
)


@dataclass(frozen=True, eq=False)
class Worked:
    """What a round makes of one shape: all its candidates, and of those that were worked on the template set, the
    summary, the mean movement (diagonals) and the flatness of its parts (L,), NaN of absent and of given ones, each;
    ``best`` is the place among them of the one that explains most."""

    candidates: tuple[Candidate, ...]
    templates: tuple[int, ...]
    summaries: tuple[Summary, ...]
    moved: tuple[float, ...]
    flatness: tuple[np.ndarray, ...]
    best: int


def work_on_shape(
    shape: Shape,
    faces: np.ndarray | None,
    templates: Sequence[PartTemplates],
    candidates: Sequence[Candidate],
    covariances: Covariances,
    inner: int,
    priors: Mapping[int, tuple[np.ndarray, np.ndarray]] | None,
    family: bool,
    seed: np.ndarray | None = None,
    seed_weight: float = 0.0,
) -> Worked:
    """One outer round on one shape: the exemplars' candidates, or those of the family's own templates; all weights.

    Proposed label probabilities ``seed`` (P, L) count as soft evidence, with the power ``seed_weight``.
    Raises FloatingPointError with the shape's name on numbers that are not finite.
    """
    problem = make_problem(shape, faces, leaning_to(seed, seed_weight))
    prevalence = part_prevalence(templates[: len(templates) - family])
    pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)
    done, sums, moves = [], [], []
    for candidate in candidates:
        if candidate.family != family:
            continue
        before, g = unpacked(candidate.beliefs), candidate.beliefs.template
        prior = priors.get(g) if priors is not None else None
        if prior is not None:
            prior = before.from_family(*prior)
        try:
            beliefs, summary = fit_shape(
                problem, templates[g], before, covariances, prevalence, inner=inner, prior=prior, pull=pull
            )
        except FloatingPointError as error:
            raise FloatingPointError(shape.name) from error
        if not np.isfinite([beliefs.deformed.sum(), beliefs.maps.sum(), summary.energy]).all():
            raise FloatingPointError(shape.name)
        moves.append(float(np.linalg.norm(beliefs.deformed - before.deformed, axis=1).mean()))
        done.append(beliefs)
        sums.append(summary)
    given = given_parts(problem, templates[0].n_parts)
    weighed = weigh(problem, templates, done, family=family)
    best = min(range(len(weighed)), key=lambda i: weighed[i].misfit)
    others = [candidate for candidate in candidates if candidate.family != family]
    return Worked(
        weighted([*others, *map(compact, weighed)]),
        tuple(one.template for one in done),
        tuple(sums),
        tuple(moves),
        tuple(np.where(one.active & ~given, flatness(templates[one.template], one), np.nan) for one in done),
        best,
    )


def fit_shape(
    problem: Problem,
    templates: PartTemplates,
    beliefs: Beliefs,
    covariances: Covariances,
    prevalence: Float[np.ndarray, " L"],
    *,
    inner: int = 3,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    pull: np.ndarray | None = None,
) -> tuple[Beliefs, Summary]:
    """One outer round of one template set on one shape: q, s, D ``inner`` times, then existence and the maps.

    ``pull`` is φ5's logit Φ per neighbour pair if it is at hand: it is the same for every template set.
    """
    graph = templates.graph
    if pull is None:
        pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)

    def settle(beliefs: Beliefs, candidates: Candidates, times: int) -> tuple[Beliefs, Correspondence]:
        for _ in range(times):
            correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
            beliefs = update_segmentation(problem, correspondence, beliefs, pull)
            beliefs = update_deformations(templates, graph, correspondence, beliefs, covariances, prior)
        return beliefs, correspondence

    def resettle(beliefs: Beliefs) -> tuple[Beliefs, Candidates, Correspondence]:
        left = candidates_without(problem, templates, candidates, beliefs, covariances.descriptor)
        beliefs, correspondence = settle(beliefs, left, 2)
        return beliefs, left, correspondence

    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    beliefs, correspondence = settle(beliefs, candidates, inner)
    energy = free_energy(problem, templates, graph, candidates, correspondence, beliefs, covariances, pull)
    summary = summarize(problem, templates, graph, candidates, correspondence, beliefs, energy)
    beliefs, left, correspondence = switch_off_spare(
        problem, templates, candidates, correspondence, beliefs, covariances.unary, resettle
    )
    beliefs = switch_off_missing(
        problem, templates, left, correspondence, beliefs, covariances.unary, prevalence, resettle
    )
    return spare_in_place(templates, update_maps(templates, correspondence, beliefs)), summary
