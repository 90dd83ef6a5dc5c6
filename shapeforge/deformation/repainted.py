"""Exemplars painted otherwise after a fit: their templates made of the new paint, carried onto the shapes by the old.

What a fit has found out about a shape is where every point of an exemplar lies on it; which part the point belongs to
is only its name there.  So a template of other paint starts on every shape where the old one ended, and few rounds
bring the labels after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.parallel import in_order, shared
from shapeforge.collection.points import nearest_points
from shapeforge.collection.shape import Shape, Shapes
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.exemplars import Candidate, compact, unpacked, weigh, weighted
from shapeforge.deformation.family import TRUSTED
from shapeforge.deformation.starts import exemplar_template
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import make_problem


@dataclass(frozen=True, eq=False)
class Carried:
    """A template set of new paint: ``near`` (K,) is the point of the old one that each of its points comes from, and
    ``beside`` (K, 3) how far from it the point lies on the exemplar (zero where both are the same surface point)."""

    templates: PartTemplates
    near: Int[np.ndarray, " K"]
    beside: Float[np.ndarray, "K 3"]


def surface_rows(templates: PartTemplates, shape: Shape) -> Int[np.ndarray, " K"] | None:
    """Which surface point of the exemplar each template point was made of; None when it was made of another surface.

    Templates move as they are learnt, their normals and descriptors are the exemplar's.
    """
    known = np.column_stack([shape.normals, shape.descriptors]).astype(np.float64)
    wanted = np.column_stack([templates.normals, templates.descriptors])
    distance, rows = cKDTree(known).query(wanted)
    return rows if distance.max() < 1e-6 else None


def carried(
    old: PartTemplates, shape: Shape, faces: Int[np.ndarray, " F"], seed: Float[np.ndarray, "P L"] | None = None
) -> Carried:
    """The templates of the exemplar ``shape`` as it is painted now (``faces``), where the old ones had moved to.

    Where it is not painted, it has the parts that were proposed for it (``seed``), if any were.

    Raises ValueError when the old ones were made of another surface, or nothing is painted.
    """
    rows, fresh = surface_rows(old, shape), exemplar_template(shape, faces, old.part_names, seed)
    now = surface_rows(fresh, shape)
    if rows is None or now is None:
        raise ValueError(f"old: its points are not those of {shape.name}; it was read anew since. Fit from the start.")
    near = nearest_points(shape.points[rows], shape.points[now])[0][:, 0]
    beside = (shape.points[now] - shape.points[rows[near]]).astype(np.float64)
    return Carried(fresh.moved(old.points[near] + beside), near, beside)


def carried_beliefs(shape: Shape, evidence: np.ndarray, old: PartTemplates, new: Carried, known: Beliefs) -> Beliefs:
    """What is believed of ``shape`` under the new templates: every point where the old template's is.

    A part is there when half of its points were, whatever they were called; later rounds switch off what is not.
    """
    templates, near = new.templates, new.near
    label, before = templates.label, old.label[near]
    deformed = known.deformed[near] + np.einsum("kij,kj->ki", known.maps[before], new.beside)
    alive = known.alive(old.label)[near]
    size = np.maximum(np.bincount(label, minlength=templates.n_parts), 1)
    active = np.bincount(label, alive, templates.n_parts) / size >= 0.5
    active |= np.isin(np.arange(len(active)), evidence) & templates.has_part()
    if not active.any():
        active = templates.has_part()
    spare = known.spare[near] if len(known.spare) else known.spare
    counts = np.zeros((templates.n_parts, templates.n_parts))
    np.add.at(counts, (label, before), 1)
    origin = np.where(counts.any(axis=1), counts.argmax(axis=1), np.arange(templates.n_parts))
    return replace(
        known, deformed=deformed, variance=known.variance[near], maps=known.maps[origin],
        offsets=known.offsets[origin], active=active, evidence=evidence,
        misfit=np.where(counts.any(axis=1), known.misfit[origin], np.nan), copies=np.zeros(0, np.int32), spare=spare,
        segmentation=_labels_of(shape, evidence, deformed[active[label]], label[active[label]], active),
    )  # fmt: skip


def _labels_of(shape: Shape, evidence: np.ndarray, points: np.ndarray, label: np.ndarray, active: np.ndarray):
    """Label probabilities (P, L): mostly the part of the nearest template point, and the paint."""
    nearest = nearest_points(points, shape.points)[0][:, 0]
    said = (1.0 - TRUSTED) * np.tile(active / active.sum(), (shape.n_points, 1))
    said[np.arange(shape.n_points), label[nearest]] += TRUSTED
    painted = evidence >= 0
    said[painted] = np.eye(len(active))[evidence[painted]]
    return said


def carry_candidates(
    executor: Executor | None,
    shapes: Shapes | Sequence[Shape],
    labels: Mapping[int, np.ndarray],
    templates: tuple[PartTemplates, ...],
    candidates: Sequence[Sequence[Candidate]],
    repainted: Mapping[int, int],
    seeds: Sequence[np.ndarray] | None = None,
) -> tuple[tuple[PartTemplates, ...], tuple[tuple[Candidate, ...], ...]]:
    """Exemplars' templates and every shape's candidates after ``repainted`` (template set -> shape index) exemplars.

    ``seeds`` are the parts proposed for every shape, if any were.  Candidates of the family's own templates are left
    out: these have to be linked anew.
    """
    new = {
        g: carried(templates[g], shapes[t], labels[t], None if seeds is None else seeds[t])
        for g, t in repainted.items()
    }
    after = tuple(new[g].templates if g in new else template for g, template in enumerate(templates))
    found = in_order(
        executor, _carry_shape, (shapes[t] for t in range(len(shapes))), [labels.get(t) for t in range(len(shapes))],
        candidates, repeat(shared(executor, (templates, after, new))),
    )  # fmt: skip
    return after, tuple(found)


def _carry_shape(shape: Shape, faces: np.ndarray | None, candidates: Sequence[Candidate], known) -> tuple:
    """One shape's candidates under the new templates; those of other exemplars stay as they are, but for its paint.

    Whether a shape was painted otherwise since is later told by the paint that its candidates have.
    """
    templates, after, new = known
    own = [one for one in candidates if not one.family]
    touched = [one for one in own if one.beliefs.template in new]
    if not touched:
        return weighted(own) if own else ()
    problem = make_problem(shape, faces)
    beliefs = []
    for one in touched:
        g = one.beliefs.template
        beliefs.append(carried_beliefs(shape, problem.evidence, templates[g], new[g], unpacked(one.beliefs)))
    others = [
        replace(one, beliefs=replace(one.beliefs, evidence=problem.evidence))
        for one in own if one.beliefs.template not in new
    ]  # fmt: skip
    return weighted([*others, *map(compact, weigh(problem, after, beliefs))])
