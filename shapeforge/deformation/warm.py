"""A fit taken up again after corrections: what was learned stays, only the corrected shapes are found anew.

A corrected shape is explained by the family as it was learned, annealed from the start with its paint as evidence: in
its old explanation, sharp as it is, a template that sits on the wrong surface would stay there.  A few rounds of all
shapes follow, in which the templates learn from the correction.  All others go on from where they were.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import repeat

import numpy as np

from shapeforge.collection.groups import Groups
from shapeforge.collection.parallel import in_order, shared
from shapeforge.collection.shape import Shape, Shapes
from shapeforge.deformation.apply import fit_candidates
from shapeforge.deformation.exemplars import Candidate
from shapeforge.deformation.fit import FitState, Within, fit_templates

WARM_ROUNDS = 2
"""Rounds of all shapes after the corrected ones were found anew."""


def corrected_shapes(
    state: FitState, shapes: Shapes | Sequence[Shape], labels: Mapping[int, np.ndarray]
) -> tuple[int, ...]:
    """Indices of the shapes that are painted otherwise than when ``state`` was fitted."""
    found = []
    for t, candidates in enumerate(state.candidates):
        before = candidates[0].beliefs.evidence
        if t not in labels and (before < 0).all():
            continue
        if not np.array_equal(_evidence(shapes[t], labels.get(t)), before):
            found.append(t)
    return tuple(found)


def why_not_warm(
    state: FitState, shapes: Shapes | Sequence[Shape], groups: Groups, labels: Mapping[int, np.ndarray],
    part_names: Sequence[str],
) -> str:  # fmt: skip
    """Why a fit cannot be taken up again from ``state``, in a sentence; "" when it can.

    Its templates were made of the exemplars' paint: other parts, exemplars or paint on these need a new start.
    """
    names = shapes.names if hasattr(shapes, "names") else tuple(shape.name for shape in shapes)
    if len(state.candidates) != len(names):
        return "There are other shapes than in the fit."
    if tuple(part_names) != tuple(state.templates[0].part_names):
        return "The parts are others than in the fit."
    exemplars = {names[int(t)]: int(t) for t in groups.exemplars}
    sources = {template.source for template in state.templates if template.source}
    if not sources <= set(exemplars):
        return "The exemplars are others than in the fit."
    changed = corrected_shapes(state, shapes, {t: labels[t] for t in exemplars.values() if t in labels})
    repainted = [name for name, t in exemplars.items() if t in changed]
    if repainted:
        return f"{repainted[0]} is an exemplar: its paint makes the templates."
    return ""


def refit_templates(
    state: FitState,
    shapes: Shapes | Sequence[Shape],
    groups: Groups,
    labels: Mapping[int, np.ndarray],
    part_names: tuple[str, ...],
    *,
    rng: np.random.Generator,
    rounds: int = WARM_ROUNDS,
    inner: int = 3,
    executor: Executor | None = None,
    seeds: Sequence[np.ndarray] | None = None,
    within: bool = False,
) -> Iterator[FitState | Within]:
    """Take a finished fit up again with other paint (see above): ``state`` corrected, then a state for each round.

    Arguments as those of ``fit_templates``.  A state that this yielded goes on in the same way: its corrections are
    part of it.  Raises ValueError with the reason where ``why_not_warm`` gives one.
    """
    reason = why_not_warm(state, shapes, groups, labels, part_names)
    if reason:
        raise ValueError(f"state: {reason} Fit from the start.")
    changed = corrected_shapes(state, shapes, labels)
    if changed or state.stop_reason is not None:
        state = replace(state, stop_reason=None, of=state.round + rounds, phase="corrected")
        hierarchy = state.hierarchy() if state.family is not None else None
        known = (state.templates, state.covariances, hierarchy, state.annealed_from, inner)
        found = in_order(
            executor, _found_anew, (shapes[t] for t in changed), [labels.get(t) for t in changed],
            repeat(shared(executor, known)),
        )  # fmt: skip
        candidates = list(state.candidates)
        for t, one in zip(changed, found, strict=True):
            candidates[t] = one
        state = replace(state, candidates=tuple(candidates))
        yield state
    done_in_family = state.round - state.family_from if state.family is not None else 0
    yield from fit_templates(
        shapes, groups, labels, part_names, rng=rng, rounds=state.of, family_rounds=done_in_family, inner=inner,
        executor=executor, seeds=seeds, resume=state, within=within,
    )  # fmt: skip


def _found_anew(shape: Shape, faces: np.ndarray | None, known: tuple) -> tuple[Candidate, ...]:
    templates, covariances, hierarchy, annealed_from, inner = known
    return fit_candidates(
        shape, templates, covariances, hierarchy, annealed_from=annealed_from, inner=inner, faces=faces
    )


def _evidence(shape: Shape, faces: np.ndarray | None) -> np.ndarray:
    """The part painted at every point (P,), -1 where nothing is."""
    if faces is None:
        return np.full(shape.n_points, -1, np.int32)
    return np.asarray(faces)[shape.face_of_point]
