"""High-level templates: the groups' templates linked into one family (Algorithm 1, line 4).

The same model, with the groups' learnt templates as its input "shapes" and their labels as evidence.  Each label is
started from several groups' templates in turn, and the start that explains the other groups best is kept; a part that
one group alone has moves up unchanged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.align import Alignment, affine_align
from shapeforge.collection.shape import Shape
from shapeforge.collection.surface import closest_points
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.components import mostly_spare
from shapeforge.deformation.factors import FLOORS, initial_covariances
from shapeforge.deformation.templates import PartTemplates, pair_graph, template_from_points
from shapeforge.deformation.updates import (
    Problem,
    find_candidates,
    update_correspondences,
    update_deformations,
    update_maps,
)

STARTS_PER_PART = 3
"""Groups whose template is tried as the start of a label."""

ROUNDS = 8

HUBS = 3
"""Groups that are tried as the one that gives the family all the parts it has."""

LEAST_POINTS = 12
"""Points of a part on both sides from which its own affine start is found: what the labels tell, the start may use."""


@dataclass(frozen=True, eq=False)
class Link:
    """Where each top-level template point lies on one group's templates: a convex mix of three of its points."""

    index: Int[np.ndarray, "K 3"]
    weight: Float[np.ndarray, "K 3"]
    exists: Bool[np.ndarray, " K"]


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The top-level templates and their link to every group's templates (same order as the fit's templates)."""

    top: PartTemplates
    links: tuple[Link, ...]


def link_templates(templates: Sequence[PartTemplates], shapes: Sequence[int] | None = None) -> Hierarchy:
    """Link the groups' templates (all with the same part names) into one set of top-level templates.

    ``shapes[g]`` is the number of shapes that template set g explains: among starts, one that needs no link for many
    shapes is worth more.  Raises ValueError when there are none or their part names differ.
    """
    return family_templates(templates, shapes, hubs=0)[0]


def family_templates(
    templates: Sequence[PartTemplates], shapes: Sequence[int] | None = None, *, hubs: int = HUBS
) -> list[Hierarchy]:
    """The ways to link the groups' templates that are worth a try: first that of ``link_templates``.

    In the others one group gives all the parts that it has, for parts taken from different groups may not go together:
    one of those with the most parts, at most ``hubs`` of them, those that explain most shapes.  Arguments and errors as
    of ``link_templates``.
    """
    if not templates:
        raise ValueError("templates: wanted at least one set, got none; fit the family first")
    if any(template.part_names != templates[0].part_names for template in templates):
        raise ValueError("templates: wanted the same part names in every group, got different ones")
    number, n_parts = len(templates), templates[0].n_parts
    has = np.array([template.has_part() for template in templates])
    size = np.asarray([1] * number if shapes is None else shapes, np.float64)
    sources = [_starts(templates, has, size, part) for part in range(n_parts)]
    fits: dict[tuple[int, int], np.ndarray] = {}

    def need(wanted: Iterable[int]) -> None:
        for a in sorted(set(wanted)):
            for b in range(number):
                if a != b and (a, b) not in fits and (has[a] & has[b]).any():
                    fits[a, b] = register(templates[a], templates[b])

    need(a for tried in sources for a in tried)
    best = [_best_start(part, tried, templates, has, size, fits) for part, tried in enumerate(sources)]
    choices = [best]
    most = has.sum(axis=1)
    for hub in sorted(np.flatnonzero(most == most.max()).tolist(), key=lambda g: (-size[g], g))[:hubs]:
        choice = [hub if has[hub, part] else best[part] for part in range(n_parts)]
        if choice not in choices:
            need([hub])
            choices.append(choice)
    return [_assemble(templates, has, chosen, fits) for chosen in choices]


def register(source: PartTemplates, target: PartTemplates) -> Float[np.ndarray, "K 3"]:
    """``source``'s points (K, 3) deformed onto ``target``'s of the same part; parts it lacks only ride along.

    The labels are known on both sides, so every part is fitted by itself, from the affine map of the whole and from
    one of its own, and keeps the outcome that leaves the smaller gap.
    """
    shared = source.has_part() & target.has_part()
    on_source, on_target = shared[source.label], shared[target.label]
    alignment = affine_align(source.points[on_source], target.points[on_target])
    deformed = alignment(source.points)
    for part in np.flatnonzero(shared).tolist():
        mine, theirs = _of_part(source, part), _of_part(target, part)
        starts = [alignment]
        if min(mine.n_points, theirs.n_points) >= LEAST_POINTS:
            starts.append(affine_align(mine.points, theirs.points))
        outcomes = [_settled(mine, theirs, start) for start in starts]
        deformed[source.label == part] = min(outcomes, key=lambda points: _gap(points, theirs.points))
    return deformed


def _of_part(templates: PartTemplates, part: int) -> PartTemplates:
    """The template of one part, as a family of one part."""
    rows = np.flatnonzero(templates.label == part)
    place = np.full(templates.n_points + 1, -1, np.int32)  # the last: neighbours that are none
    place[rows] = np.arange(len(rows))
    return replace(
        templates, points=templates.points[rows], normals=templates.normals[rows], label=np.zeros(len(rows), np.int32),
        component=templates.component[rows], neighbours=place[templates.neighbours[rows]],
        descriptors=templates.descriptors[rows], part_names=templates.part_names[part : part + 1],
    )  # fmt: skip


def _settled(source: PartTemplates, target: PartTemplates, start: Alignment) -> Float[np.ndarray, "K 3"]:
    """A part's points (K, 3) after the model's updates against another template of the part."""
    problem = Problem(
        np.ascontiguousarray(target.points), np.ascontiguousarray(target.normals),
        np.ascontiguousarray(target.descriptors), np.zeros(target.n_points + 1, np.int64), np.zeros(0, np.int32),
        target.label,
    )  # fmt: skip
    deformed = start(source.points)
    beliefs = Beliefs(
        0, deformed, np.full_like(deformed, 1e-4), start.matrix[None], start.offset[None],
        np.ones((target.n_points, 1)), np.ones(1, bool), problem.evidence, np.full(1, np.nan),
    )  # fmt: skip
    graph = pair_graph(source.neighbours)
    wide = initial_covariances(source.descriptors.shape[1])
    for sigma in np.geomspace(0.05, 1.5 * FLOORS["unary"], ROUNDS):
        covariances = replace(wide, unary=np.full(3, sigma**2))
        candidates = find_candidates(problem, source, beliefs, covariances.descriptor)
        for _ in range(3):
            correspondence = update_correspondences(problem, source, candidates, beliefs, covariances.unary)
            beliefs = update_deformations(source, graph, correspondence, beliefs, covariances)
        beliefs = update_maps(source, correspondence, beliefs)
    return beliefs.deformed


def _gap(a: np.ndarray, b: np.ndarray) -> float:
    """Mean distance to the nearest point, both ways (diagonals)."""
    return float(cKDTree(a).query(b)[0].mean() + cKDTree(b).query(a)[0].mean())


def _starts(templates: Sequence[PartTemplates], has: np.ndarray, size: np.ndarray, part: int) -> list[int]:
    """Groups to try as the start of a part: those that explain most shapes, then with the most points of this part."""
    owners = [g for g in range(len(templates)) if has[g, part]]
    points = [int((templates[g].label == part).sum()) for g in range(len(templates))]
    return sorted(owners, key=lambda g: (-size[g], -points[g], g))[:STARTS_PER_PART]


def _best_start(part, tried, templates, has, size, fits) -> int:
    """The start whose deformed part leaves the smallest gap on the shapes of groups that have the part; -1: none."""
    gaps = []
    for a in tried:
        total, weight = 0.0, 0.0
        for b in range(len(templates)):
            if not has[b, part]:
                continue
            weight += size[b]
            if b != a:
                mine = fits[a, b][templates[a].label == part]
                total += size[b] * _gap(mine, templates[b].points[templates[b].label == part])
        gaps.append(total / max(weight, 1e-12))
    return tried[int(np.argmin(gaps))] if tried else -1


def _assemble(templates, has, chosen, fits) -> Hierarchy:
    present = [part for part, a in enumerate(chosen) if a >= 0]
    rows = {part: np.flatnonzero(templates[chosen[part]].label == part) for part in present}
    # all parts are drawn in the frame of the group that gave most of them
    reference = max(set(chosen) - {-1}, key=lambda a: (sum(len(rows[p]) for p in present if chosen[p] == a), -a))

    def gathered(attribute: str) -> np.ndarray:
        return np.concatenate([getattr(templates[chosen[part]], attribute)[rows[part]] for part in present])

    points = np.concatenate(
        [
            templates[reference].points[rows[part]]
            if chosen[part] == reference
            else fits.get((chosen[part], reference), templates[chosen[part]].points)[rows[part]]
            for part in present
        ]
    )
    label = gathered("label")
    # a single exemplar's components are the family's; of several, put together, what touches is taken for one
    surface = gathered("component") if len(templates) == 1 else None
    top = template_from_points(
        points, gathered("normals"), gathered("descriptors"), label, templates[0].part_names, surface=surface
    )
    links = []
    for b, template in enumerate(templates):
        index, weight = np.zeros((len(label), 3), np.int32), np.zeros((len(label), 3))
        for part in present:
            here = label == part
            a = chosen[part]
            if not has[b, part]:
                continue
            if a == b:
                index[here, 0], weight[here, 0] = rows[part], 1.0
                continue
            own = np.flatnonzero(template.label == part)
            near = min(3, len(own))
            distance, nearest = cKDTree(template.points[own]).query(fits[a, b][rows[part]], k=near)
            distance, nearest = distance.reshape(-1, near), nearest.reshape(-1, near)
            inverse = 1.0 / np.maximum(distance, 1e-9)
            index[here, :near] = own[nearest]
            weight[here, :near] = inverse / inverse.sum(axis=1, keepdims=True)
        links.append(Link(index, weight, has[b][label]))
    return Hierarchy(top, tuple(links))


def deformed_family(
    beliefs: Beliefs, hierarchy: Hierarchy
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, " K"], Bool[np.ndarray, " K"]]:
    """The top-level template points on a shape: places (K, 3), variance (K,) per axis, existence (K,).

    From the templates that explain the shape best; parts that they lack from those that lent them.
    """
    part = hierarchy.top.label
    link = hierarchy.links[beliefs.template]
    exists = _there(hierarchy, beliefs) & beliefs.active[part]
    deformed = np.einsum("kj,kji->ki", link.weight, beliefs.deformed[link.index])
    variance = (link.weight * beliefs.variance.mean(axis=1)[link.index]).sum(axis=1)
    for lent, lender in beliefs.lent:
        from_lender, places, spread = part == lent, *deformed_family(lender, hierarchy)[:2]
        deformed[from_lender], variance[from_lender] = places[from_lender], spread[from_lender]
        exists = np.where(from_lender, _there(hierarchy, lender), exists)
    return deformed, variance, exists


def _there(hierarchy: Hierarchy, beliefs: Beliefs) -> Bool[np.ndarray, " K"]:
    """Top-level template points (K,) that a template knows, without the components that lie mostly on spare ones."""
    link = hierarchy.links[beliefs.template]
    if not len(beliefs.spare):
        return link.exists
    spare = mostly_spare(hierarchy.top, (link.weight * beliefs.spare[link.index]).sum(axis=1) > 0.5)
    return link.exists & ~spare if len(spare) else link.exists


def corresponding_points(
    shape: Shape, beliefs: Beliefs, hierarchy: Hierarchy
) -> tuple[Float[np.ndarray, "K 3"], Bool[np.ndarray, " K"]]:
    """The surface point (K, 3) nearest to each deformed top-level template point, NaN where absent; existence (K,)."""
    deformed, _, exists = deformed_family(beliefs, hierarchy)
    positions = np.full((len(exists), 3), np.nan)
    if exists.any():
        positions[exists] = closest_points(shape.mesh, deformed[exists])[0]
    return positions, exists
