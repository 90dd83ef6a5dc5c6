"""High-level templates: the groups' templates linked into one family (Algorithm 1, line 4).

The same model, with the groups' learnt templates as its input "shapes" and their labels as evidence.  Each label is
started from several groups' templates in turn, and the start that explains the other groups best is kept; a part that
one group alone has moves up unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.align import affine_align
from shapeforge.collection.shape import Shape
from shapeforge.collection.surface import closest_points
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import FLOORS, Covariances, initial_covariances
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


def link_templates(templates: Sequence[PartTemplates]) -> Hierarchy:
    """Link the groups' templates (all with the same part names) into one set of top-level templates.

    Raises ValueError when there are none or their part names differ.
    """
    if not templates:
        raise ValueError("templates: wanted at least one set, got none; fit the family first")
    if any(template.part_names != templates[0].part_names for template in templates):
        raise ValueError("templates: wanted the same part names in every group, got different ones")
    number, n_parts = len(templates), templates[0].n_parts
    has = np.array([template.has_part() for template in templates])
    sources = [_starts(templates, has, part) for part in range(n_parts)]
    wanted = sorted({a for tried in sources for a in tried})
    fits: dict[tuple[int, int], np.ndarray] = {}
    for a in wanted:
        for b in range(number):
            if a != b and (has[a] & has[b]).any():
                fits[a, b] = register(templates[a], templates[b])
    chosen = [_best_start(part, tried, templates, has, fits) for part, tried in enumerate(sources)]
    return _assemble(templates, has, chosen, fits)


def register(source: PartTemplates, target: PartTemplates) -> Float[np.ndarray, "K 3"]:
    """``source``'s points (K, 3) deformed onto ``target``'s of the same part; parts it lacks only ride along."""
    shared = source.has_part() & target.has_part()
    on_source, on_target = shared[source.label], shared[target.label]
    alignment = affine_align(source.points[on_source], target.points[on_target])
    problem = Problem(
        np.ascontiguousarray(target.points[on_target]), np.ascontiguousarray(target.normals[on_target]),
        np.ascontiguousarray(target.descriptors[on_target]), np.zeros(on_target.sum() + 1, np.int64),
        np.zeros(0, np.int32), target.label[on_target].astype(np.int32),
    )  # fmt: skip
    n_parts = source.n_parts
    deformed = alignment(source.points)
    beliefs = Beliefs(
        0, deformed, np.full_like(deformed, 1e-4), np.tile(alignment.matrix, (n_parts, 1, 1)),
        np.tile(alignment.offset, (n_parts, 1)), np.eye(n_parts)[problem.evidence], shared, problem.evidence,
        np.full(n_parts, np.nan),
    )  # fmt: skip
    graph = pair_graph(source.neighbours)
    wide = initial_covariances(source.descriptors.shape[1])
    for sigma in np.geomspace(0.05, 1.5 * FLOORS["unary"], ROUNDS):
        covariances = replace(wide, unary=np.full(3, sigma**2))
        beliefs = _one_round(problem, source, graph, beliefs, covariances)
    # parts that the target lacks follow the affine map: their place is only a place to draw them
    return np.where(on_source[:, None], beliefs.deformed, deformed)


def _one_round(problem, source, graph, beliefs: Beliefs, covariances: Covariances) -> Beliefs:
    candidates = find_candidates(problem, source, beliefs, covariances.descriptor)
    for _ in range(3):
        correspondence = update_correspondences(problem, source, candidates, beliefs, covariances.unary)
        beliefs = update_deformations(source, graph, correspondence, beliefs, covariances)
    return update_maps(source, correspondence, beliefs)


def _starts(templates: Sequence[PartTemplates], has: np.ndarray, part: int) -> list[int]:
    """Groups to try as the start of a part: those with the most parts, then the most points of this part."""
    owners = [g for g in range(len(templates)) if has[g, part]]
    size = [int((templates[g].label == part).sum()) for g in range(len(templates))]
    return sorted(owners, key=lambda g: (-int(has[g].sum()), -size[g], g))[:STARTS_PER_PART]


def _best_start(part, tried, templates, has, fits) -> int:
    """The start whose deformed part leaves the smallest gap (both ways) on the groups that have the part; -1: none."""
    gaps = []
    for a in tried:
        total = []
        for b in range(len(templates)):
            if b == a or not has[b, part]:
                continue
            mine = fits[a, b][templates[a].label == part]
            theirs = templates[b].points[templates[b].label == part]
            total.append(cKDTree(mine).query(theirs)[0].mean() + cKDTree(theirs).query(mine)[0].mean())
        gaps.append(float(np.mean(total)) if total else 0.0)
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
    top = template_from_points(
        points, gathered("normals"), gathered("descriptors"), label, templates[0].part_names, "family"
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


def corresponding_points(
    shape: Shape, beliefs: Beliefs, hierarchy: Hierarchy
) -> tuple[Float[np.ndarray, "K 3"], Bool[np.ndarray, " K"]]:
    """The surface point (K, 3) nearest to each deformed top-level template point, NaN where absent; existence (K,)."""
    link = hierarchy.links[beliefs.template]
    exists = link.exists & beliefs.active[hierarchy.top.label]
    deformed = np.einsum("kj,kji->ki", link.weight, beliefs.deformed[link.index])
    positions = np.full((len(exists), 3), np.nan)
    if exists.any():
        positions[exists] = closest_points(shape.mesh, deformed[exists])[0]
    return positions, exists
