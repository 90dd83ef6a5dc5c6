"""The top of the hierarchy on the shapes themselves: one set of templates for the whole family, fitted to every shape.

The groups' templates, once linked, give every part to the family from whichever exemplar has it.  Fitted to the shapes
directly, they explain shapes whose parts no single exemplar has together (the arms of one, the legs of another), and
their points are the same on every shape: no correspondence goes over two templates and the link between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import repeat

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.collection.align import FEWEST, Alignment, affine_align
from shapeforge.collection.parallel import in_order, shared
from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.components import mostly_spare
from shapeforge.deformation.exemplars import Candidate, blend, compact, weigh, weighted
from shapeforge.deformation.existence import given_parts, part_prevalence
from shapeforge.deformation.factors import FLOORS, Covariances
from shapeforge.deformation.hierarchy import Hierarchy, Link, deformed_family, family_templates
from shapeforge.deformation.partial import partial_starts
from shapeforge.deformation.shape_fit import work_on_shape
from shapeforge.deformation.starts import affine_beliefs, with_parts
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Problem, leaning_to, make_problem

ROUNDS = 8
"""Outer rounds of the family's templates."""

SIGMA = 0.03
"""σ1 (diagonals) they start with; by the last round it is at its floor."""

TRIAL_ROUNDS = 4
"""Rounds after which the better one of a shape's two starts goes on alone."""

ASKED, ASKED_SIGMA = 8, 0.02
"""Shapes asked which linked templates explain them best, and σ1 (diagonals) of the round that answers."""

TRUSTED = 0.7
"""What the exemplars say of the labels is believed to this share at the start; the rest is spread evenly."""

PART_SAMPLE = 300
"""Points of either side by which a part gets its affine start."""

LEAST_POINTS = 12
"""Points of a part, on either side, from which it gets an affine start of its own."""


def sigma_of_round(number: int, rounds: int) -> float:
    """σ1 (diagonals) after ``number`` of ``rounds`` rounds of the family's templates; falls by the same factor."""
    return SIGMA * (FLOORS["unary"] / SIGMA) ** min(1.0, number / max(rounds - 1, 1))


def link_family(
    executor: Executor | None,
    shapes: Sequence[Shape],
    labels: Sequence[np.ndarray | None],
    templates: tuple[PartTemplates, ...],
    candidates: Sequence[Sequence[Candidate]],
    covariances: Covariances,
) -> Hierarchy:
    """The linked templates that explain the shapes best, among those of ``family_templates``; a few shapes are asked.

    The last of the ``links`` belongs to the top-level templates themselves, as if they were one more exemplar's.
    """
    explained = np.bincount([blend(one).template for one in candidates], minlength=len(templates)).tolist()
    tried = [_with_itself(hierarchy) for hierarchy in family_templates(templates, explained)]
    if len(tried) == 1:
        return tried[0]
    asked = np.unique(np.linspace(0, len(shapes) - 1, ASKED).round().astype(int)).tolist()
    answers = in_order(
        executor, _misfits, (shapes[t] for t in asked), [labels[t] for t in asked], repeat(shared(executor, templates)),
        [candidates[t] for t in asked], repeat(shared(executor, tried)), repeat(covariances),
    )  # fmt: skip
    return tried[int(np.sum(list(answers), axis=0).argmin())]


def start_family(
    executor: Executor | None,
    shapes: Iterable[Shape],
    labels: Sequence[np.ndarray | None],
    templates: tuple[PartTemplates, ...],
    candidates: Sequence[Sequence[Candidate]],
    hierarchy: Hierarchy,
    seeds: Sequence[np.ndarray] | None = None,
) -> tuple[tuple[Candidate, ...], ...]:
    """Every shape's candidates, with two starts of the family's templates added (see ``family_starts``)."""
    starts = in_order(
        executor, family_starts, shapes, labels, repeat(shared(executor, templates)), candidates,
        repeat(shared(executor, hierarchy)), seeds if seeds is not None else repeat(None),
    )  # fmt: skip
    return tuple(weighted([*one, *start]) for one, start in zip(candidates, starts, strict=True))


def family_starts(
    shape: Shape,
    faces: Int[np.ndarray, " F"] | None,
    templates: tuple[PartTemplates, ...],
    candidates: Sequence[Candidate],
    hierarchy: Hierarchy,
    seed: Float[np.ndarray, "P L"] | None = None,
) -> tuple[Candidate, ...]:
    """Two starts of the family's templates on one shape that exemplars have explained.

    One with all parts under the affine map of the whole, which may find again what the exemplars had lost, or without
    those without which the rest explains the shape better, if any exemplar does without them, too; one with the parts
    and components that are believed in, each part under the affine map that takes it to the surface believed to be its
    own.
    """
    problem, beliefs = make_problem(shape, faces, leaning_to(seed)), blend(candidates)
    whole = _whole_start(shape, problem, beliefs, hierarchy, len(templates))
    kept = given_parts(problem, hierarchy.top.n_parts) | undisputed(candidates)
    starts = [
        _without_some(shape, problem, beliefs, hierarchy, whole, kept, part_prevalence(templates)),
        _believed_start(shape, beliefs, hierarchy, whole),
    ]
    return tuple(map(compact, weigh(problem, (*templates, hierarchy.top), starts, family=True)))


def _whole_start(shape: Shape, problem: Problem, beliefs: Beliefs, hierarchy: Hierarchy, index: int) -> Beliefs:
    """All parts of the top-level templates, under the affine map of what there is of them, if that is enough."""
    top = hierarchy.top
    there = _believed_points(beliefs, hierarchy)
    known = top.points[there] if there.sum() >= FEWEST else top.points
    found = affine_align(known, problem.points @ beliefs.pose.T)  # as the family lies
    alignment = _turned_back(found, beliefs.pose)
    return replace(affine_beliefs(shape, problem, top, index, alignment), pose=beliefs.pose)


def _believed_points(beliefs: Beliefs, hierarchy: Hierarchy) -> Bool[np.ndarray, " K"]:
    """Top-level template points (K,) that a shape is believed to have; all where it is believed to have none."""
    there = deformed_family(beliefs, hierarchy)[2]
    return there if there.any() else np.ones(len(there), bool)


def undisputed(candidates: Sequence[Candidate]) -> Bool[np.ndarray, " L"]:
    """Parts (L,) that every exemplar finds on the shape, whatever else it says.

    All parts of the family together may explain a bench as back and seat alone, and its box is called a back: that it
    has legs was said by benches and chairs alike.
    """
    return np.all([one.beliefs.active for one in candidates if not one.family], axis=0)


def _without_some(
    shape: Shape, problem: Problem, beliefs: Beliefs, hierarchy: Hierarchy, whole: Beliefs, kept: np.ndarray,
    prevalence: np.ndarray,
) -> Beliefs:  # fmt: skip
    """The start with all parts, or a better one without some of them, but with those ``kept`` (L,)."""
    top, pose = hierarchy.top, beliefs.pose
    alignment = Alignment(pose @ whole.maps[0], pose @ whole.offsets[0], np.nan)
    lying = problem.points @ pose.T, problem.normals @ pose.T
    for start in partial_starts(*lying, [top], [alignment], kept, prevalence):  # one at most
        found = affine_beliefs(shape, problem, top, whole.template, _turned_back(start.alignment, pose))
        whole = replace(with_parts(found, start.active), pose=pose)
    return _believing(whole, beliefs, whole.active)


def _believed_start(shape: Shape, beliefs: Beliefs, hierarchy: Hierarchy, whole: Beliefs) -> Beliefs:
    """The parts and components that are believed in, each part moved on to its own surface."""
    top, there = hierarchy.top, _believed_points(beliefs, hierarchy)
    believed = np.bincount(top.label[there], minlength=top.n_parts) > 0
    deformed, maps, offsets = whole.deformed.copy(), whole.maps.copy(), whole.offsets.copy()
    likeliest = beliefs.segmentation.argmax(axis=1)
    for part in np.flatnonzero(believed).tolist():
        mine, theirs = top.label == part, likeliest == part
        if min((mine & there).sum(), theirs.sum()) >= LEAST_POINTS:
            own = affine_align(deformed[mine & there], shape.points[theirs], n_points=PART_SAMPLE)
            maps[part], offsets[part] = own.matrix @ maps[part], own(offsets[part][None])[0]
            deformed[mine] = own(deformed[mine])
    return replace(
        _believing(whole, beliefs, believed), deformed=deformed, maps=maps, offsets=offsets,
        spare=mostly_spare(top, believed[top.label] & ~there),
    )  # fmt: skip


def better_start(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The candidates without all of the family's but the one that explains the shape best."""
    best = min((one for one in candidates if one.family), key=lambda one: one.misfit)
    return tuple(one for one in candidates if one is best or not one.family)


def _turned_back(found: Alignment, pose: Float[np.ndarray, "3 3"]) -> Alignment:
    """An affine map that was found as the family lies, to the shape as it lies itself."""
    return Alignment(pose.T @ found.matrix, pose.T @ found.offset, found.residual, found.start)


def _believing(start: Beliefs, known: Beliefs, active: np.ndarray) -> Beliefs:
    """A start with these active parts (L,), which trusts what is known of the labels, but not blindly.

    Parts that it lacks stay as doubted as they were: else an exemplar that nobody asked would bring them back.
    """
    said = TRUSTED * known.segmentation + (1.0 - TRUSTED) * active / active.sum()
    said = np.where(active, said, 0.0) + 1e-9 * active
    said /= said.sum(axis=1, keepdims=True)
    painted = start.evidence >= 0
    said[painted] = np.eye(len(active))[start.evidence[painted]]
    odds = np.where(active, np.nan, np.fmin(start.misfit, known.misfit))
    return replace(start, active=active, segmentation=said, misfit=odds)


def _misfits(shape, faces, templates, candidates, hierarchies, covariances) -> Float[np.ndarray, " H"]:
    """Misfit (H,) of each of the hierarchies' top-level templates on a shape, a round after the parts' own start."""
    sharp = replace(covariances, unary=np.full(3, ASKED_SIGMA**2))
    problem, beliefs = make_problem(shape, faces), blend(candidates)
    found = []
    for hierarchy in hierarchies:
        with_top = (*templates, hierarchy.top)
        start = _believed_start(
            shape, beliefs, hierarchy, _whole_start(shape, problem, beliefs, hierarchy, len(templates))
        )
        known = tuple(map(compact, weigh(problem, with_top, [start], family=True)))
        worked = work_on_shape(shape, faces, with_top, known, sharp, 3, None, True)
        found.append(worked.candidates[0].misfit)
    return np.array(found)


def _with_itself(hierarchy: Hierarchy) -> Hierarchy:
    """The hierarchy with a last link, from the top-level templates to themselves."""
    number = hierarchy.top.n_points
    index, weight = np.zeros((number, 3), np.int32), np.zeros((number, 3))
    index[:, 0], weight[:, 0] = np.arange(number), 1.0
    over = np.concatenate([hierarchy.over, np.full((1, hierarchy.top.n_parts), -1, np.int32)])
    return replace(hierarchy, links=(*hierarchy.links, Link(index, weight, np.ones(number, bool))), over=over)
