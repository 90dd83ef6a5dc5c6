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
from shapeforge.deformation.existence import DOUBT
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Problem, mapped_normals

GAP_SCALE, TURN_SCALE = 0.006, 0.2
"""Gap (diagonals) between a deformed template and the surface, and 1 - |cos| between their normals, both in the mean
over the shape, that cost an exemplar one nat against the others."""

WORTHLESS = 4.0
"""Nats behind the best from which an exemplar's explanation of a shape is given up: its word counts for 2% there."""

LOCAL_GAP, LOCAL_TURN = 0.007, 0.15
"""The same around one point of the surface: an exemplar with arms may speak for the arms of a shape that another
exemplar explains better in all else."""

LENT = 0.1
"""A part that the best exemplar lacks is another's, if at least this share of what that one says of it is believed, and
if it is not doubted as a part of one's own is: by the log odds of its existence, both opinions together."""

BROUGHT, BROUGHT_ODDS = 0.4, -1.0
"""The same share, and log odds of all opinions together, from which a part is believed that the family's templates
bring to a shape whose best exemplar lacks it.  Half of the usual doubt: the odds hold already that few exemplars have
it, and armchairs whose own exemplar has no arms lost theirs when they had to be likelier there than not."""

NOWHERE = -6.0
"""Log odds that an exemplar's word counts for, to whose template of a part hardly any surface was left: it may sit
elsewhere on this shape, a tailplane on top of the fin, and another exemplar that is sure of it is to be believed."""

DISBELIEVED = 10.0
"""Nats that an explanation is behind in the end for giving all of a shape to parts that are not believed in: one that
needs a back to explain a bench is wrong about its seat, too."""

AS_GOOD = 1.0
"""Nats behind the best explanation up to which an exemplar explains a shape about as well."""

COMPACT = ("deformed", "variance", "segmentation")
"""Arrays of the beliefs that a fit holds in single precision, of every shape and exemplar."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One exemplar's templates on one shape: the beliefs, and the weight this explanation has among the shape's.

    ``misfit`` (nats) is what the weight follows from: the gap between the deformed template and the surface, and how
    far their normals differ; ``local`` (P,) the same around each point of the surface.  ``family`` tells that the
    templates are not an exemplar's but those of the whole family.
    """

    beliefs: Beliefs
    weight: float
    misfit: float
    local: Float[np.ndarray, " P"]
    family: bool = False


def weigh(
    problem: Problem, templates: Sequence[PartTemplates], beliefs: Sequence[Beliefs], *, family: bool = False
) -> tuple[Candidate, ...]:
    """Weigh the exemplars' explanations of a shape by how well each *deformed* template explains it.

    By the gap between template and surface, both ways, and by whether the surfaces that were brought together face the
    same way; over the whole shape and around every point.
    """
    found = []
    for belief in beliefs:
        template = templates[belief.template]
        alive = np.flatnonzero(belief.alive(template.label))
        nearest, distance = (one[:, 0] for one in nearest_points(belief.deformed[alive], problem.points))
        back = nearest_points(problem.points, thinned(belief.deformed[alive], 1500))[1]
        turn = 1.0 - np.abs((mapped_normals(template, belief)[alive[nearest]] * problem.normals).sum(axis=1))
        misfit = misfit_of(distance, back, turn)
        local = _around(problem, distance / LOCAL_GAP + turn / LOCAL_TURN).astype(np.float32)
        found.append(Candidate(belief, 1.0, misfit, local, family))
    return weighted(found)


def misfit_of(distance: np.ndarray, back: np.ndarray, turn: np.ndarray) -> float:
    """Nats that an explanation costs: gaps from the surface to the template and back (diagonals), and 1 - |cos| between
    the normals of what is nearest."""
    return float((distance.mean() + back.mean()) / GAP_SCALE + turn.mean() / TURN_SCALE)


def weighted(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The candidates with weights that follow from their misfits; the best one's is 1."""
    least = min(candidate.misfit for candidate in candidates)
    return tuple(replace(candidate, weight=float(np.exp(least - candidate.misfit))) for candidate in candidates)


def worth_hearing(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The candidates without those that explain the shape so much worse than the best that nobody would hear them."""
    least = min(candidate.misfit for candidate in candidates)
    return tuple(candidate for candidate in candidates if candidate.misfit < least + WORTHLESS)


def as_good(candidates: Sequence[Candidate]) -> tuple[int, ...]:
    """Template sets of the exemplars that explain the shape about as well as the best explanation, the best first; none
    where only the family's own templates do."""
    least = min(candidate.misfit for candidate in candidates)
    near = (one for one in candidates if not one.family and one.misfit < least + AS_GOOD)
    return tuple(dict.fromkeys(one.beliefs.template for one in sorted(near, key=lambda one: one.misfit)))


def leading(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate that tells where the corresponding points are: the best of the family's own templates, which have
    the same points on every shape, and of the exemplars' before there are any.
    """
    return max(candidates, key=lambda candidate: (candidate.family, candidate.weight))


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


def voices_for(candidates: Sequence[Candidate], parts: Bool[np.ndarray, " L"]) -> Float[np.ndarray, "C P"]:
    """The ``voices`` of candidates (C, P) once these ``parts`` (L,) are believed in: who gives much of the shape to
    others is heard less (``DISBELIEVED``).

    Not before the family's templates have brought every part: until then an exemplar's arms are not believed in where a
    better one has none, and that is no fault.
    """
    if any(candidate.family for candidate in candidates):
        shares = [candidate.beliefs.segmentation.mean(axis=0, dtype=np.float64) for candidate in candidates]
        candidates = [
            replace(candidate, misfit=candidate.misfit + DISBELIEVED * float(share[~parts].sum()))
            for candidate, share in zip(candidates, shares, strict=True)
        ]
    return voices(candidates)


def best_of(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate that explains the shape best."""
    return max(candidates, key=lambda candidate: candidate.weight)


def lenders(candidates: Sequence[Candidate]) -> dict[int, int]:
    """Parts that the best candidate lacks, and which candidate brings each: its index.

    A part is lent when the shape believes enough of what the lender says of it, and unless all opinions together doubt
    that it exists, as an exemplar's own part is doubted: one whose template does not know the part has none, one that
    switched it off speaks against it, the louder the better it explains the shape beside the lender.  The family's
    templates know every part of every exemplar: what they lend must be likelier there (``BROUGHT_ODDS``).
    """
    best = best_of(candidates)
    said = [
        voice @ candidate.beliefs.segmentation for voice, candidate in zip(voices(candidates), candidates, strict=True)
    ]
    found = {}
    for part in np.flatnonzero(~best.beliefs.active).tolist():
        lender = max(range(len(candidates)), key=lambda i: said[i][part])
        theirs = candidates[lender].beliefs
        own = theirs.segmentation[:, part].sum(dtype=np.float64)
        odds = _together(candidates, candidates[lender].weight)[part]
        share, least = (BROUGHT, BROUGHT_ODDS) if candidates[lender].family else (LENT, DOUBT)
        if theirs.active[part] and said[lender][part] > share * own and not odds < least:
            found[part] = lender
    return found


def _together(candidates: Sequence[Candidate], weight: float) -> Float[np.ndarray, " L"]:
    """Log odds (L,) of the parts by the opinions of all candidates: in full of those of this ``weight`` or more, of
    others as far as theirs goes; who was not asked has none, NaN where nobody was."""
    said = np.stack([np.maximum(one.beliefs.misfit, NOWHERE) for one in candidates])  # NaN stays
    heard = np.array([min(1.0, one.weight / weight) for one in candidates])
    return np.where(np.isnan(said).all(axis=0), np.nan, np.nansum(said * heard[:, None], axis=0))


def believed_parts(candidates: Sequence[Candidate]) -> Bool[np.ndarray, " L"]:
    """Parts (L,) that the shape has: those of the best candidate, and those lent to it.

    A part that the best was never asked about is doubted by what the others say.  The family's templates bring every
    part of every exemplar to a shape: one that the best exemplar lacks must be likelier there than usual parts
    must (``BROUGHT_ODDS``), unless it is painted.
    """
    best = best_of(candidates)
    doubted = np.isnan(best.beliefs.misfit) & (_together(candidates, best.weight) < DOUBT)
    parts = best.beliefs.active & ~doubted
    if not parts.any():
        parts = best.beliefs.active.copy()
    exemplars = [candidate for candidate in candidates if not candidate.family]
    if best.family and exemplars:
        lacking = best_of(exemplars)
        odds = _together((best, lacking), lacking.weight)
        parts &= lacking.beliefs.active | ~(odds < BROUGHT_ODDS) | np.isin(np.arange(len(parts)), best.beliefs.evidence)
        if not parts.any():
            parts = best.beliefs.active.copy()
    parts[list(lenders(candidates))] = True
    return parts


def blend(candidates: Sequence[Candidate]) -> Beliefs:
    """The leading candidate's beliefs with what all candidates say: the segmentations averaged by their voices, and the
    parts that are believed in, of which those that the leading one lacks are lent by the others."""
    own = leading(candidates).beliefs
    said = np.stack([candidate.beliefs.segmentation.astype(np.float64) for candidate in candidates])
    brought = lenders(candidates)
    parts = believed_parts(candidates)
    mixed = (said * voices_for(candidates, parts)[:, :, None]).sum(axis=0) + 1e-9
    mixed *= parts
    best = best_of(candidates).beliefs
    lent = tuple(
        (part, unpacked(candidates[brought[part]].beliefs if part in brought else best))
        for part in np.flatnonzero(parts & ~own.active).tolist()
    )
    mixed /= mixed.sum(axis=1, keepdims=True)
    if len(own.copies):
        known = np.flatnonzero(own.copies >= 0)
        mixed[known] = np.eye(len(parts))[own.copies[known]]
    return replace(unpacked(own), segmentation=mixed, active=own.active & parts, lent=lent)


def with_copies(
    shape: Shape, templates: Sequence[PartTemplates], candidates: tuple[Candidate, ...]
) -> tuple[Candidate, ...]:
    """The candidates of a shape, with the copies of components that no template reached (``Beliefs.copies``)."""
    bare = [
        replace(one, beliefs=replace(one.beliefs, copies=np.zeros(0, np.int32))) if len(one.beliefs.copies) else one
        for one in candidates
    ]
    blended = blend(bare)
    # The leading templates are learnt from all shapes.  What they do not know looks like an exemplar's, perhaps: in the
    # family's, what touches is one component, an engine and its pylon, which look like no engine.
    in_turn = [compared for compared in dict.fromkeys([(blended.template,), as_good(bare)]) if compared]
    found = find_copies(shape, templates, blended, blended.segmentation.argmax(axis=1), in_turn)
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
