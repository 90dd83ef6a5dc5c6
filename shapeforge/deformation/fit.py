"""Algorithm 1: learn part templates, and fit them to every shape of the family.

``fit_templates`` is an iterator of states; whoever iterates prints, plots, saves, pauses and stops.  Shapes are worked
on one by one by a pure function, so any executor with the ``concurrent.futures`` interface may run them, and so may a
cluster of ``dask.distributed`` (``Client.get_executor()``); sums are taken in the order of the shapes, so the result
does not depend on the number of workers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
from jaxtyping import Float

from shapeforge.collection.align import affine_align
from shapeforge.collection.groups import Groups
from shapeforge.collection.parallel import in_order, kept, shared
from shapeforge.collection.shape import Shape, Shapes
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.energy import free_energy
from shapeforge.deformation.exemplars import Candidate, blend, compact, unpacked, weigh
from shapeforge.deformation.existence import part_prevalence, switch_off_missing
from shapeforge.deformation.factors import FLOORS, Covariances, attraction, floored, initial_covariances
from shapeforge.deformation.pose import posed_starts
from shapeforge.deformation.templates import PartTemplates, template_from_exemplar
from shapeforge.deformation.updates import (
    Candidates,
    Correspondence,
    GaussianOnDeformation,
    Problem,
    Summary,
    candidates_without,
    find_candidates,
    make_problem,
    summarize,
    update_correspondences,
    update_deformations,
    update_maps,
    update_segmentation,
    update_templates,
)

ANNEALING = 0.87
"""σ1 shrinks by this factor a round below its first estimate: by maximum likelihood it stays wide and labels blur."""

SETTLED = 5e-4
"""Mean movement of the deformed points (diagonals) in a round below which the fit stops, once σ1 is sharp."""

SEED_WEIGHT, SEED_DECAY = 3.0, 0.8
"""Power with which proposed label probabilities count beside the templates in the first round, and its factor a round.
As a mere start they were forgotten in a round or two, and what all shapes had agreed on was lost on odd ones."""

EXEMPLARS_PER_SHAPE = 3
"""Exemplars tried on every shape: its own group's and the next best by affine residual."""


class FitDiverged(RuntimeError):
    """Numbers stopped being finite; ``state`` is the last good one."""

    def __init__(self, message: str, state: FitState) -> None:
        super().__init__(message)
        self.state = state


@dataclass(frozen=True, eq=False)
class FitState:
    """Progress report and result of a fit.  Lengths in diagonals, energy in nats per surface point.

    ``candidates[t]`` holds each exemplar tried on shape t, ``beliefs[t]`` what follows from them.
    """

    round: int
    of: int
    phase: str
    energy: float
    change: float
    covariances: Covariances
    annealed_from: float
    sigma_by_part: Float[np.ndarray, " L"]
    templates: tuple[PartTemplates, ...]
    candidates: tuple[tuple[Candidate, ...], ...]
    stop_reason: str | None = None

    @property
    def beliefs(self) -> tuple[Beliefs, ...]:
        """One ``Beliefs`` per shape: the best exemplar's, with the label probabilities of all of them blended."""
        return tuple(blend(candidates) for candidates in self.candidates)

    @property
    def sigmas(self) -> dict[str, np.ndarray]:
        """Standard deviations of the factors, for curves."""
        return self.covariances.sigmas()


def fit_templates(
    shapes: Shapes | Sequence[Shape],
    groups: Groups,
    labels: Mapping[int, np.ndarray],
    part_names: tuple[str, ...],
    *,
    rng: np.random.Generator,
    rounds: int = 10,
    inner: int = 3,
    exemplars_per_shape: int = EXEMPLARS_PER_SHAPE,
    executor: Executor | None = None,
    prior: GaussianOnDeformation | None = None,
    seeds: Sequence[np.ndarray] | None = None,
    resume: FitState | None = None,
) -> Iterator[FitState]:
    """Learn part templates from painted exemplars and fit them to every shape (§4, Algorithm 1).

    ``labels[t]`` are part indices per face record (-1: unpainted) of shape t; every group's exemplar needs some, unless
    ``seeds`` gives label probabilities (P, L) of every shape (automatic start): the start of Q(S), and soft evidence
    whose weight falls from round to round.  ``prior(t, g)`` is a Gaussian on D.
    ``resume`` goes on from a state that an earlier call yielded.  Yields the affine start and then one state a round.

    Raises ValueError when no exemplar has labels, FitDiverged (with the last good state) on non-finite numbers.
    """
    del rng  # the fit itself is deterministic; the argument is part of every algorithm's face
    each_shape = kept(executor, shapes)
    if resume is None:
        templates = tuple(_exemplar_templates(shapes, groups, labels, part_names, seeds))
        owners = _template_of_group(groups, templates, shapes)
        starts = in_order(
            executor, _start, each_shape(), [labels.get(t) for t in range(len(shapes))],
            repeat(shared(executor, templates)), [owners[g] if g >= 0 else 0 for g in groups.group],
            repeat(exemplars_per_shape), seeds if seeds is not None else repeat(None),
        )  # fmt: skip
        state = FitState(
            0, rounds, "affine start", float("nan"), float("nan"), initial_covariances(), float("nan"),
            np.full(len(part_names), np.nan), templates, tuple(starts),
        )  # fmt: skip
        yield state
    else:
        state = replace(resume, of=rounds, stop_reason=None)
    while state.round < rounds:
        state = _one_round(state, shapes, each_shape, groups, labels, seeds, rounds, inner, executor, prior)
        yield state
        if state.stop_reason is not None:
            return


def _one_round(state, shapes, each_shape, groups, labels, seeds, rounds, inner, executor, prior) -> FitState:
    """One outer round of Algorithm 1: every shape, then Σ, then Y."""
    templates = state.templates
    owners = _template_of_group(groups, templates, shapes)
    number = len(shapes)
    priors = (
        {c.beliefs.template: prior(t, c.beliefs.template) for c in state.candidates[t]} if prior is not None else None
        for t in range(number)
    )
    candidates, moves = [], []
    own: dict[int, Summary] = {}
    learners = [0] * len(templates)
    total: Summary | None = None
    try:
        results = in_order(
            executor, _work_on_shape, each_shape(), [labels.get(t) for t in range(number)],
            repeat(shared(executor, templates)), state.candidates, repeat(state.covariances), repeat(inner), priors,
            seeds if seeds is not None else repeat(None), repeat(SEED_WEIGHT * SEED_DECAY**state.round),
        )  # fmt: skip
        for t, (found, summaries, moved) in enumerate(results):
            candidates.append(found)
            moves.append(moved)
            # a template is learnt from the shapes of its own group; Σ from every shape's best explanation
            for candidate, summary in zip(found, summaries, strict=True):
                g = candidate.beliefs.template
                if groups.group[t] >= 0 and owners[groups.group[t]] == g:
                    own[g] = own[g] + summary if g in own else summary
                    learners[g] += 1
            alone = replace(summaries[_best(found)], template_moment=np.zeros((1, 3)))
            total = alone if total is None else total + alone
    except FloatingPointError as error:
        raise FitDiverged(
            f"{error}: its fit produced numbers that are not finite, usually from broken descriptors; "
            "import the shape again or leave it out", state,
        ) from error  # fmt: skip
    learnt = tuple(
        update_templates(template, own[g]) if learners[g] > 1 else template for g, template in enumerate(templates)
    )
    assert total is not None, "there is no family without shapes"
    covariances, first = _update_covariances(total, state)
    energy = total.energy / total.points
    moved = float(np.mean(moves))
    number_round = state.round + 1
    sharp = np.sqrt(covariances.unary.mean()) <= 1.5 * FLOORS["unary"]
    reason = None
    if number_round >= rounds:
        reason = "the planned number of rounds is done"
    elif sharp and moved < SETTLED:
        reason = "the deformed templates have come to rest"
    sigma_by_part = np.sqrt(total.by_part[:, 1] / np.maximum(total.by_part[:, 0], 1e-9) / 3)
    return FitState(
        number_round, rounds, "fit", energy, moved, covariances, first, sigma_by_part, learnt, tuple(candidates), reason
    )


def _update_covariances(total: Summary, state: FitState) -> tuple[Covariances, float]:
    """Piecewise maximum likelihood with floors; σ1 is annealed below its first estimate (a departure, by name)."""
    likely = total.unary / max(total.weight, 1e-9)
    spread = float(np.sqrt(likely.mean()))
    first = spread if np.isnan(state.annealed_from) else state.annealed_from
    wanted = max(FLOORS["unary"], first * ANNEALING ** (state.round + 1))
    unary = likely * min(1.0, (wanted / spread) ** 2) if spread > 0 else likely
    return Covariances(
        floored("unary", unary),
        floored("smooth", total.smooth / max(total.pairs, 1)),
        floored("descriptor", total.descriptor / max(total.weight, 1e-9)),
        floored("segment", total.segment / max(total.segment_pairs, 1)),
    ), first


def _work_on_shape(
    shape: Shape, faces, templates, candidates, covariances, inner, priors, seed=None, seed_weight=0.0
) -> tuple[tuple[Candidate, ...], tuple[Summary, ...], float]:
    """One outer round on one shape: all its candidates, then their weights. A pure function of its arguments."""
    leaning = None if seed is None else seed_weight * np.log(np.asarray(seed, np.float64) + 1e-6)
    problem = make_problem(shape, faces, leaning)
    prevalence = part_prevalence(templates)
    pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)
    done, sums, moves = [], [], []
    for candidate in candidates:
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
    weighed = weigh(problem, templates, done)
    return tuple(map(compact, weighed)), tuple(sums), moves[_best(weighed)]


def _best(candidates: Sequence[Candidate]) -> int:
    return max(range(len(candidates)), key=lambda i: candidates[i].weight)


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
    """One outer round of one template set on one shape: q, s, D ``inner`` times, then existence and the part maps.

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

    def refit(trial: Beliefs) -> tuple[Beliefs, Candidates]:
        left = candidates_without(problem, templates, candidates, trial, covariances.descriptor)
        return settle(trial, left, 2)[0], left

    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    beliefs, correspondence = settle(beliefs, candidates, inner)
    energy = free_energy(problem, templates, graph, candidates, correspondence, beliefs, covariances, pull)
    summary = summarize(problem, templates, graph, candidates, correspondence, beliefs, energy)
    beliefs = switch_off_missing(
        problem, templates, candidates, correspondence, beliefs, covariances.unary, prevalence, refit
    )
    return update_maps(templates, correspondence, beliefs), summary


def affine_beliefs(
    shape: Shape, problem: Problem, templates: PartTemplates, index: int, alignment, seed: np.ndarray | None = None
) -> Beliefs:
    """The affine start: template under the exemplar's affine map, s uniform over the template's parts (or seeded)."""
    has = templates.has_part()
    n_parts = templates.n_parts
    deformed = alignment(templates.points)
    segmentation = np.tile(has / has.sum(), (shape.n_points, 1))
    if seed is not None:
        segmentation = np.where(has, np.asarray(seed, np.float64) + 1e-6, 0.0)
        segmentation /= segmentation.sum(axis=1, keepdims=True)
    painted = problem.evidence >= 0
    segmentation[painted] = np.eye(n_parts)[problem.evidence[painted]]
    return Beliefs(
        template=index,
        deformed=deformed,
        variance=np.full_like(deformed, 1e-4),
        maps=np.tile(alignment.matrix, (n_parts, 1, 1)),
        offsets=np.tile(alignment.offset, (n_parts, 1)),
        segmentation=segmentation,
        active=has,
        evidence=problem.evidence,
        misfit=np.full(n_parts, np.nan),
    )


def _start(shape, faces, templates, own, how_many, seed) -> tuple[Candidate, ...]:
    """Affine starts of a shape: its own group's exemplar first, then the best of the others; turned ones if better.

    Poses compete as exemplars do, by weight; those that are far behind are given up here.
    """
    problem = make_problem(shape, faces)
    alignments = [affine_align(template.points, shape.points) for template in templates]
    order = sorted(range(len(templates)), key=lambda g: (g != own, alignments[g].residual))[:how_many]
    beliefs = [affine_beliefs(shape, problem, templates[g], g, alignments[g], seed) for g in order]
    turned = posed_starts(shape.points, [template.points for template in templates], alignments)
    if not turned:
        return tuple(map(compact, weigh(problem, templates, beliefs)))
    for start in turned:
        found = affine_beliefs(shape, problem, templates[start.template], start.template, start.alignment, seed)
        beliefs.append(replace(found, pose=start.pose))
    candidates = weigh(problem, templates, beliefs)
    kept = sorted(candidates, key=lambda candidate: -candidate.weight)[: max(how_many, 2)]
    return tuple(compact(candidate) for candidate in candidates if candidate in kept)


def _exemplar_templates(shapes, groups, labels, part_names, seeds) -> Iterator[PartTemplates]:
    """One template set per exemplar that has labels; the others' groups are explained by these."""
    found = False
    for t in groups.exemplars:
        shape = shapes[int(t)]
        faces = labels.get(int(t))
        if faces is not None and (np.asarray(faces) >= 0).any():
            found = True
            yield template_from_exemplar(shape, faces, part_names)
        elif seeds is not None:
            found = True
            yield _seeded_template(shape, seeds[int(t)], part_names)
    if not found:
        names = ", ".join(shapes[int(t)].name for t in groups.exemplars)
        raise ValueError(
            f"labels: wanted painted faces on at least one exemplar ({names}), got none; paint one, or start from "
            "proposed parts (`shapeforge cosegment`)"
        )


def _seeded_template(shape: Shape, seed: np.ndarray, part_names: tuple[str, ...]) -> PartTemplates:
    from shapeforge.deformation.templates import template_from_points

    return template_from_points(
        shape.points, shape.normals, shape.descriptors, np.argmax(seed, axis=1).astype(np.int32), part_names, shape.name
    )


def _template_of_group(groups: Groups, templates: tuple[PartTemplates, ...], shapes) -> list[int]:
    """Index into ``templates`` of every group's own exemplar; -1 where that exemplar was not painted."""
    by_source = {template.source: i for i, template in enumerate(templates)}
    names = shapes.names if hasattr(shapes, "names") else [shape.name for shape in shapes]
    return [by_source.get(names[int(t)], -1) for t in groups.exemplars]
