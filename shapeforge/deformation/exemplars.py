"""Several exemplars on one shape: how well each explains it, where each may speak, which parts one lends another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.collection.align import thinned
from shapeforge.collection.points import nearest_points
from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.copies import find_copies
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Problem, mapped_normals

GAP_SCALE, TURN_SCALE = 0.006, 0.2
"""Gap (diagonals) between a deformed template and the surface, and 1 - |cos| between their normals, both in the mean
over the shape, that cost an exemplar one nat against the others."""

LOCAL_GAP, LOCAL_TURN = 0.007, 0.15
"""The same around one point of the surface: an exemplar with arms may speak for the arms of a shape that another
exemplar explains better in all else."""

LENT, LENT_ODDS = 0.1, 1.0
"""A part that the best exemplar lacks is another's, if at least this share of what that one says of it is believed, and
if the log odds of its existence, both opinions together, are at least these (or nobody was asked yet)."""

COMPACT = ("deformed", "variance", "segmentation")
"""Arrays of the beliefs that a fit holds in single precision, of every shape and exemplar."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One exemplar's templates on one shape: the beliefs, and the weight this explanation has among the shape's.

    ``misfit`` (nats) is what the weight follows from: the gap between the deformed template and the surface, and how
    far their normals differ; ``local`` (P,) the same around each point of the surface.
    """

    beliefs: Beliefs
    weight: float
    misfit: float
    local: Float[np.ndarray, " P"]


def weigh(problem: Problem, templates: Sequence[PartTemplates], beliefs: Sequence[Beliefs]) -> tuple[Candidate, ...]:
    """Weigh the exemplars' explanations of a shape by how well each *deformed* template explains it.

    By the gap between template and surface, both ways, and by whether the surfaces that were brought together face the
    same way; over the whole shape and around every point.
    """
    misfits, locals_ = [], []
    for belief in beliefs:
        template = templates[belief.template]
        alive = np.flatnonzero(belief.active[template.label])
        nearest, distance = (found[:, 0] for found in nearest_points(belief.deformed[alive], problem.points))
        back = nearest_points(problem.points, thinned(belief.deformed[alive], 1500))[1]
        turn = 1.0 - np.abs((mapped_normals(template, belief)[alive[nearest]] * problem.normals).sum(axis=1))
        misfits.append(float((distance.mean() + back.mean()) / GAP_SCALE + turn.mean() / TURN_SCALE))
        locals_.append(_around(problem, distance / LOCAL_GAP + turn / LOCAL_TURN).astype(np.float32))
    weights = [float(np.exp(min(misfits) - misfit)) for misfit in misfits]
    return tuple(Candidate(*one) for one in zip(beliefs, weights, misfits, locals_, strict=True))


def _around(problem: Problem, value: Float[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
    """Mean of a value over every point and its neighbours within the patch."""
    count = np.diff(problem.offsets)
    row = np.repeat(np.arange(len(value)), count)
    return (value + np.bincount(row, value[problem.neighbour], len(value))) / (count + 1)


def voices(candidates: Sequence[Candidate]) -> Float[np.ndarray, "C P"]:
    """What each candidate's word is worth at every point of the surface (C, P); sums to 1 over the candidates.

    It falls with the misfit of the whole and with that around the point.
    """
    against = np.stack([candidate.misfit + candidate.local.astype(np.float64) for candidate in candidates])
    worth = np.exp(against.min(axis=0) - against)
    return worth / worth.sum(axis=0)


def lenders(candidates: Sequence[Candidate]) -> dict[int, int]:
    """Parts that the best candidate lacks, and which candidate brings each: its index.

    A part is lent when the shape believes enough of what the lender says of it, and when it likely exists by the
    opinions of both: one whose template does not know the part has none, one that switched it off speaks against it.
    """
    best = max(candidates, key=lambda candidate: candidate.weight).beliefs
    said = [
        voice @ candidate.beliefs.segmentation for voice, candidate in zip(voices(candidates), candidates, strict=True)
    ]
    found = {}
    for part in np.flatnonzero(~best.active).tolist():
        lender = max(range(len(candidates)), key=lambda i: said[i][part])
        theirs = candidates[lender].beliefs
        own = theirs.segmentation[:, part].sum(dtype=np.float64)
        odds = theirs.misfit[part] + (0.0 if np.isnan(best.misfit[part]) else best.misfit[part])
        if theirs.active[part] and said[lender][part] > LENT * own and not odds < LENT_ODDS:
            found[part] = lender
    return found


def believed_parts(candidates: Sequence[Candidate]) -> Bool[np.ndarray, " L"]:
    """Parts (L,) that the shape has: those of the best candidate, and those lent to it."""
    parts = max(candidates, key=lambda candidate: candidate.weight).beliefs.active.copy()
    parts[list(lenders(candidates))] = True
    return parts


def blend(candidates: Sequence[Candidate]) -> Beliefs:
    """The best candidate's beliefs, with the segmentations of all candidates of the shape averaged by their voices."""
    best = max(candidates, key=lambda candidate: candidate.weight).beliefs
    said = np.stack([candidate.beliefs.segmentation.astype(np.float64) for candidate in candidates])
    mixed = (said * voices(candidates)[:, :, None]).sum(axis=0) + 1e-9 * best.segmentation
    brought = lenders(candidates)
    parts = best.active.copy()
    parts[list(brought)] = True
    mixed *= parts
    lent = tuple((part, unpacked(candidates[i].beliefs)) for part, i in brought.items())
    mixed /= mixed.sum(axis=1, keepdims=True)
    if len(best.copies):
        known = np.flatnonzero(best.copies >= 0)
        mixed[known] = np.eye(len(parts))[best.copies[known]]
    return replace(unpacked(best), segmentation=mixed, lent=lent)


def with_copies(
    shape: Shape, templates: Sequence[PartTemplates], candidates: tuple[Candidate, ...]
) -> tuple[Candidate, ...]:
    """The candidates of a shape, with the copies of components that no template reached (``Beliefs.copies``)."""
    bare = [
        replace(one, beliefs=replace(one.beliefs, copies=np.zeros(0, np.int32))) if len(one.beliefs.copies) else one
        for one in candidates
    ]
    blended = blend(bare)
    found = find_copies(shape, templates, blended, blended.segmentation.argmax(axis=1))
    if not found:
        return tuple(bare)
    copies = np.full(shape.n_points, -1, np.int32)
    for one in found:
        copies[one.rows] = one.part
    return tuple(replace(one, beliefs=replace(one.beliefs, copies=copies)) for one in bare)


def compact(candidate: Candidate) -> Candidate:
    """In single precision, which is plenty between rounds: the candidates of all shapes are what a fit holds."""
    arrays = {name: getattr(candidate.beliefs, name).astype(np.float32) for name in COMPACT}
    return replace(candidate, beliefs=replace(candidate.beliefs, **arrays))


def unpacked(beliefs: Beliefs) -> Beliefs:
    """In double precision, for the updates; probabilities sum to one again."""
    arrays = {name: getattr(beliefs, name).astype(np.float64) for name in COMPACT}
    arrays["segmentation"] /= arrays["segmentation"].sum(axis=1, keepdims=True)
    return replace(beliefs, **arrays)
