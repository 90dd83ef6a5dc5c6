"""Where a fit starts: the exemplars' templates, their affine maps onto every shape, and turned shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from shapeforge.collection.align import affine_align
from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.exemplars import Candidate, compact, weigh
from shapeforge.deformation.existence import given_parts, part_prevalence
from shapeforge.deformation.partial import LEFT_OUT, partial_starts
from shapeforge.deformation.pose import posed_starts
from shapeforge.deformation.templates import PartTemplates, painted_parts, template_from_exemplar, template_from_points
from shapeforge.deformation.updates import Problem, leaning_to, make_problem


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


def exemplar_starts(shape, faces, templates, own, how_many, seed) -> tuple[Candidate, ...]:
    """Affine starts of a shape: its own group's exemplar first, then the best of the others; turned ones and ones with
    fewer parts if these are better.

    Poses and sets of parts compete as exemplars do, by weight; those that are far behind are given up here.
    """
    problem = make_problem(shape, faces, leaning_to(seed))
    alignments = [affine_align(template.points, shape.points) for template in templates]
    order = sorted(range(len(templates)), key=lambda g: (g != own, alignments[g].residual))[:how_many]
    beliefs = [affine_beliefs(shape, problem, templates[g], g, alignments[g], seed) for g in order]
    turned = posed_starts(shape.points, [template.points for template in templates], alignments)
    given = given_parts(problem, templates[0].n_parts)
    partial = partial_starts(problem.points, problem.normals, templates, alignments, given, part_prevalence(templates))
    for start in partial:
        found = affine_beliefs(shape, problem, templates[start.template], start.template, start.alignment, seed)
        beliefs.append(with_parts(found, start.active))
    if not turned and not partial:
        return tuple(map(compact, weigh(problem, templates, beliefs)))
    for start in turned:
        found = affine_beliefs(shape, problem, templates[start.template], start.template, start.alignment, seed)
        beliefs.append(replace(found, pose=start.pose))
    candidates = weigh(problem, templates, beliefs)
    kept = sorted(candidates, key=lambda candidate: -candidate.weight)[: max(how_many, 2)]
    return tuple(compact(candidate) for candidate in candidates if candidate in kept)


def with_parts(beliefs: Beliefs, active: np.ndarray) -> Beliefs:
    """A start with these parts (L,) alone: the others that it had have no probability, and are doubted."""
    said = np.where(active, beliefs.segmentation, 0.0) + 1e-9 * active
    odds = np.where(beliefs.active & ~active, LEFT_OUT, beliefs.misfit)
    return replace(beliefs, active=active, segmentation=said / said.sum(axis=1, keepdims=True), misfit=odds)


def exemplar_templates(shapes, groups, labels, part_names, seeds) -> Iterator[PartTemplates]:
    """One template set per exemplar that has labels or proposed parts; the others' groups are explained by these."""
    found = False
    for t in groups.exemplars:
        faces = labels.get(int(t))
        if seeds is not None or (faces is not None and (np.asarray(faces) >= 0).any()):
            found = True
            yield exemplar_template(shapes[int(t)], faces, part_names, None if seeds is None else seeds[int(t)])
    if not found:
        names = ", ".join(shapes[int(t)].name for t in groups.exemplars)
        raise ValueError(
            f"labels: wanted painted faces on at least one exemplar ({names}), got none; paint one, or start from "
            "proposed parts (`shapeforge cosegment`)"
        )


def exemplar_template(
    shape: Shape, faces: np.ndarray | None, part_names: tuple[str, ...], seed: np.ndarray | None
) -> PartTemplates:
    """The templates of one exemplar: of its paint (``faces``), over the parts proposed for it (``seed``) if there are.

    A few strokes on proposed parts put these right there, and are not all that there is.
    """
    if faces is not None and (seed is None or (painted_parts(shape, faces) >= 0).all()):
        return template_from_exemplar(shape, faces, part_names)
    parts = exemplar_parts(shape, faces, seed)
    return template_from_points(shape.points, shape.normals, shape.descriptors, parts, part_names, shape.name)


def exemplar_parts(shape: Shape, faces: np.ndarray | None, seed: np.ndarray | None) -> np.ndarray:
    """The part (P,) that an exemplar has at every point: the one painted, else the likeliest proposed one, else -1."""
    parts = np.full(shape.n_points, -1, np.int32) if seed is None else np.argmax(seed, axis=1).astype(np.int32)
    if faces is None:
        return parts
    painted = painted_parts(shape, faces)
    return np.where(painted >= 0, painted, parts).astype(np.int32)
