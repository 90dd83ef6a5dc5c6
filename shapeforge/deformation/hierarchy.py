"""High-level templates: the groups' templates linked into one family (Algorithm 1, line 4).

The same model, with the groups' learnt templates as its input "shapes" and their labels as evidence.  Each label is
started from several groups' templates in turn, and the start that explains the other groups best is kept; a part that
one group alone has moves up unchanged.  Of many groups some may be linked over others (see ``levels``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Shape
from shapeforge.collection.surface import closest_points
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.components import mostly_spare
from shapeforge.deformation.levels import Levels, link_part
from shapeforge.deformation.registration import Registrations, gap
from shapeforge.deformation.templates import PartTemplates, template_from_points

STARTS_PER_PART = 3
"""Groups whose template is tried as the start of a label."""

HUBS = 3
"""Groups that are tried as the one that gives the family all the parts it has."""


@dataclass(frozen=True, eq=False)
class Link:
    """Where each top-level template point lies on one group's templates: a convex mix of three of its points."""

    index: Int[np.ndarray, "K 3"]
    weight: Float[np.ndarray, "K 3"]
    exists: Bool[np.ndarray, " K"]


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The top-level templates and their link to every group's templates (same order as the fit's templates).

    ``over[g, part]`` is the group over whose templates those of group g are linked, the level in between; -1 where they
    are linked directly, as all are where ``over`` is None.
    """

    top: PartTemplates
    links: tuple[Link, ...]
    over: Int[np.ndarray, "G L"] | None = None

    @property
    def levels(self) -> int:
        """Levels of templates from the top to the groups' own; two where every group is linked directly."""
        depth, over = 2, self.over
        while over is not None and (over >= 0).any():
            depth += 1
            above = np.take_along_axis(self.over, np.maximum(over, 0), axis=0)
            over = np.where(over >= 0, above, -1)
        return depth


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
    registrations = Registrations(templates)
    best = [_best_start(part, tried, registrations, size) for part, tried in enumerate(sources)]
    choices = [best]
    most = has.sum(axis=1)
    for hub in sorted(np.flatnonzero(most == most.max()).tolist(), key=lambda g: (-size[g], g))[:hubs]:
        choice = [hub if has[hub, part] else best[part] for part in range(n_parts)]
        if choice not in choices:
            choices.append(choice)
    needed = {(top, part) for chosen in choices for part, top in enumerate(chosen) if top >= 0}
    linked = {one: link_part(registrations, *one) for one in sorted(needed)}
    return [_assemble(registrations, chosen, linked) for chosen in choices]


def _starts(templates: Sequence[PartTemplates], has: np.ndarray, size: np.ndarray, part: int) -> list[int]:
    """Groups to try as the start of a part: those that explain most shapes, then with the most points of this part."""
    owners = [g for g in range(len(templates)) if has[g, part]]
    points = [int((templates[g].label == part).sum()) for g in range(len(templates))]
    return sorted(owners, key=lambda g: (-size[g], -points[g], g))[:STARTS_PER_PART]


def _best_start(part: int, tried: list[int], registrations: Registrations, size: np.ndarray) -> int:
    """The start whose deformed part leaves the smallest gap on the shapes of groups that have the part; -1: none."""
    owners, gaps = np.flatnonzero(registrations.has[:, part]).tolist(), []
    for a in tried:
        total, weight = 0.0, 0.0
        for b in owners:
            weight += size[b]
            if b != a:
                total += size[b] * gap(registrations.of_part(a, b, part), registrations.part(b, part).points)
        gaps.append(total / max(weight, 1e-12))
    return tried[int(np.argmin(gaps))] if tried else -1


def _assemble(registrations: Registrations, chosen: list[int], linked: Mapping[tuple[int, int], Levels]) -> Hierarchy:
    templates, has = registrations.templates, registrations.has
    present = [part for part, a in enumerate(chosen) if a >= 0]
    own = {part: registrations.part(chosen[part], part) for part in present}
    # all parts are drawn in the frame of the group that gave most of them
    reference = max(set(chosen) - {-1}, key=lambda a: (sum(own[p].n_points for p in present if chosen[p] == a), -a))

    def in_frame(part: int) -> np.ndarray:
        if chosen[part] == reference:
            return own[part].points
        if has[reference, part]:
            return linked[chosen[part], part].places[reference]
        shared = (has[chosen[part]] & has[reference]).any()
        return registrations.whole(chosen[part], reference)(own[part].points) if shared else own[part].points

    def gathered(attribute: str) -> np.ndarray:
        return np.concatenate([getattr(own[part], attribute) for part in present])

    label = np.repeat(present, [own[part].n_points for part in present]).astype(np.int32)
    # a single exemplar's components are the family's; of several, put together, what touches is taken for one
    surface = gathered("component") if len(templates) == 1 else None
    top = template_from_points(
        np.concatenate([in_frame(part) for part in present]), gathered("normals"), gathered("descriptors"), label,
        templates[0].part_names, surface=surface,
    )  # fmt: skip
    links, over = [], np.full(has.shape, -1, np.int32)
    for b, template in enumerate(templates):
        index, weight = np.zeros((len(label), 3), np.int32), np.zeros((len(label), 3))
        for part in present:
            if not has[b, part]:
                continue
            here, a, rows = label == part, chosen[part], np.flatnonzero(template.label == part)
            if a == b:
                index[here, 0], weight[here, 0] = rows, 1.0
                continue
            found = linked[a, part]
            over[b, part] = found.over.get(b, -1)
            near = min(3, len(rows))
            distance, nearest = cKDTree(template.points[rows]).query(found.places[b], k=near)
            distance, nearest = distance.reshape(-1, near), nearest.reshape(-1, near)
            inverse = 1.0 / np.maximum(distance, 1e-9)
            index[here, :near] = rows[nearest]
            weight[here, :near] = inverse / inverse.sum(axis=1, keepdims=True)
        links.append(Link(index, weight, has[b][label]))
    return Hierarchy(top, tuple(links), over)


def deformed_family(
    beliefs: Beliefs, hierarchy: Hierarchy
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, " K"], Bool[np.ndarray, " K"]]:
    """The top-level template points on a shape: places (K, 3), variance (K,) per axis, existence (K,).

    From the leading templates on the shape (see ``exemplars.leading``); parts that they lack from those that lent them.
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
