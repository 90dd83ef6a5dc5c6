"""Which components of a part does a shape have?  Symmetric components (§7): four engines or two, six legs or four.

A template has the components of its exemplar.  On a shape with fewer of them the spare ones hang in the air or crowd on
what belongs to another; their points correspond to nothing.  They are told by the signs that tell absent parts, with
weights of their own: a component is never alone, so the question is which of several a shape has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.existence import DOUBT, SHARPNESS, Settle, existence_odds
from shapeforge.deformation.pieces import face_components
from shapeforge.deformation.templates import Components, PartTemplates
from shapeforge.deformation.updates import Candidates, Correspondence, Problem, mapped_template

INTERCEPT = -16.4
SIGNS = {"support": 3.9, "gap": -2.9, "worth": 0.32, "facing": 3.2}
"""Log odds that a component exists, by the signs of ``existence``.  By logistic regression over 8100 questions, a tenth
of them about absent ones, of generated chairs, benches and airliners with one exemplar; the same components are asked
about in several rounds, so fewer are independent.  Left out were fighters, rails and fins whose names do not tell what
corresponds, and components present by name without any surface of their own (engines at the tail instead of the wing).
Each set predicted from the others: area under the curve .989; below -2 lie .7% of those present, mostly slats that a
back may lack indeed, and 89% of the absent ones."""


def switch_off_spare(
    problem: Problem,
    templates: PartTemplates,
    candidates: Candidates,
    correspondence: Correspondence,
    beliefs: Beliefs,
    unary: Float[np.ndarray, " 3"],
    settle: Settle,
) -> tuple[Beliefs, Candidates, Correspondence]:
    """Mark the components that the shape most likely does not have as spare, one by one, the least likely first.

    A component goes when its log odds are low (hardly a point of the surface its own, say) and a copy of it is there
    for sure: one that merely looks different, as its copies then do, is not missing.  Left and right go together.  So
    something of every part stays; whether the part exists is another question (see ``existence``).  After each one that
    goes the beliefs settle anew.
    """
    known = templates.components
    if np.sqrt(unary.mean()) > SHARPNESS or not len(known.part):
        return beliefs, candidates, correspondence
    for _ in range(len(known.part)):
        odds = _log_odds(problem, templates, known, candidates, correspondence, beliefs, unary, settle)
        gone = least_likely(known, odds)
        if gone is None:
            break
        beliefs, candidates, correspondence = settle(without_component(beliefs, known, gone))
    return beliefs, candidates, correspondence


def without_component(beliefs: Beliefs, known: Components, component: int) -> Beliefs:
    """The beliefs with one more component spare."""
    mine = known.number == component
    return replace(beliefs, spare=mine | beliefs.spare if len(beliefs.spare) else mine)


def mostly_spare(templates: PartTemplates, missing: Bool[np.ndarray, " K"]) -> Bool[np.ndarray, " S"]:
    """The components most of whose points are ``missing`` (K,), as ``Beliefs.spare``: empty when there are none."""
    number = templates.components.number
    asked = np.flatnonzero(number >= 0)
    total = np.bincount(number[asked], minlength=1)
    share = np.bincount(number[asked], missing[asked], len(total)) / np.maximum(total, 1)
    spare = (number >= 0) & (share[number] > 0.5)
    return spare if spare.any() else np.zeros(0, bool)


def spare_in_place(templates: PartTemplates, beliefs: Beliefs) -> Beliefs:
    """The beliefs with spare points where the part's map would have them, so that they pull at nothing: neither at
    their neighbours nor, in the sums over shapes, at the template."""
    if not beliefs.spare.any():
        return beliefs
    mapped = mapped_template(templates, beliefs) + beliefs.offsets[templates.label]
    return replace(beliefs, deformed=np.where(beliefs.spare[:, None], mapped, beliefs.deformed))


@dataclass(frozen=True, eq=False)
class PartCounts:
    """How many components of each part (L,) a shape has that correspond to the templates', and ``copies`` beside them:
    pieces of its mesh that are of the part by their looks, and to which no template point corresponds."""

    components: Int[np.ndarray, " L"]
    copies: Int[np.ndarray, " L"]


def count_parts(shape: Shape, top: PartTemplates, exists: Bool[np.ndarray, " K"], beliefs: Beliefs) -> PartCounts:
    """What a shape has of each part, by which points (K,) of the top-level templates exist on it, and its copies."""
    number = top.components.number
    components, copies = np.zeros(top.n_parts, np.int32), np.zeros(top.n_parts, np.int32)
    for part in np.unique(top.label[exists]).tolist():
        components[part] = len(np.unique(number[exists & (top.label == part)]))
    on_copy = np.flatnonzero(beliefs.copies >= 0)
    if len(on_copy):
        piece = face_components(shape.mesh)[shape.face_of_point[on_copy]]
        part, count = np.unique(np.unique(np.stack([beliefs.copies[on_copy], piece]), axis=1)[0], return_counts=True)
        copies[part] = count
    return PartCounts(components, copies)


def least_likely(known: Components, odds: Float[np.ndarray, " C"]) -> int | None:
    """The component that is likeliest not to be there, if any is to go by its odds (C,); NaN: not asked."""
    copied = (known.alike & (odds > 0.0)).any(axis=1)  # NaN is not
    spare = copied & (odds < DOUBT) & ~(odds[known.twin] >= DOUBT)
    return int(np.where(spare, odds, np.inf).argmin()) if spare.any() else None


def _log_odds(problem, templates, known, candidates, correspondence, beliefs, unary, settle) -> Float[np.ndarray, " C"]:
    """Log odds of each component's existence (C,); -inf where hardly a point is its own, NaN where it is not asked."""
    count = len(known.part)
    # the components first, then what else there is of each part
    owner = np.where(known.number >= 0, known.number, count + templates.label).astype(np.int32)
    return existence_odds(
        problem, templates, candidates, correspondence, beliefs, unary, settle, owner=owner,
        asked=np.ones(count, bool), intercept=INTERCEPT, weights=SIGNS, known={},
        without=lambda one: without_component(beliefs, known, one) if known.alike[one].any() else None,
    )  # fmt: skip
