"""A fit taken up again after corrections: what was learned stays, only the corrected shapes are found anew.

A corrected shape is explained by the family as it was learned, annealed from the start with its paint as evidence: in
its old explanation, sharp as it is, a template that sits on the wrong surface would stay there.  So is a shape that
came since.  Of an exemplar that was painted otherwise the templates are made again, and carried onto all shapes by the
old ones; then the family's are linked and fitted anew.  A few rounds of all shapes follow, in which the templates learn
from the correction.  All else goes on from where it was.
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
from shapeforge.deformation.fit import FitState, Within, end_of, fit_templates, told
from shapeforge.deformation.repainted import carry_candidates, surface_rows
from shapeforge.deformation.starts import exemplar_parts

WARM_ROUNDS = 2
"""Rounds of all shapes after the corrected ones were found anew."""

FAMILY_ROUNDS = 4
"""Rounds of the family's own templates after exemplars were painted otherwise: they are linked anew."""

MOST_UNSEEN = 0.1
"""Share of an exemplar's painted surface that may have been unpainted in the fit: where it lies on the other shapes is
only guessed from its neighbourhood.  With a whole part of chairs unseen the labels ended worse than after a new fit.
Of what was painted in the fit, as little may be unpainted now: templates of what is left could not tell the rest."""

UNSEEN = "Much of {name} was unpainted in the fit: nobody knows where that is on the other shapes."
BARE = "Much of {name} was painted in the fit and no longer is: that would be lost on the other shapes, too."


def gathered(state: FitState, known: Sequence[str], names: Sequence[str]) -> FitState:
    """The state of a fit of the shapes ``known`` for the shapes ``names``: those that it does not know have no
    candidates, and are to be found anew."""
    where = {name: t for t, name in enumerate(known)}
    candidates = tuple(state.candidates[where[name]] if name in where else () for name in names)
    return replace(state, candidates=candidates)


def corrected_shapes(
    state: FitState, shapes: Shapes | Sequence[Shape], labels: Mapping[int, np.ndarray]
) -> tuple[int, ...]:
    """Indices of the shapes that are painted otherwise than when ``state`` was fitted, or that it does not know."""
    found = []
    for t, candidates in enumerate(state.candidates):
        if not candidates:
            found.append(t)
            continue
        before = candidates[0].beliefs.evidence
        if t not in labels and (before < 0).all():
            continue  # unpainted then and now: the shape need not be read
        if not np.array_equal(_evidence(shapes[t], labels.get(t)), before):
            found.append(t)
    return tuple(found)


def why_not_warm(
    state: FitState, shapes: Shapes | Sequence[Shape], groups: Groups, labels: Mapping[int, np.ndarray],
    part_names: Sequence[str], seeds: Sequence[np.ndarray] | None = None,
) -> str:  # fmt: skip
    """Why a fit cannot be taken up again from ``state``, in a sentence; "" when it can.

    Arguments as those of ``fit_templates``.  Its templates are those of certain parts and exemplars: where these are
    others, they need a new start.
    """
    names = _names(shapes)
    if len(state.candidates) != len(names):
        return "There are other shapes than in the fit."
    if tuple(part_names) != tuple(state.templates[0].part_names):
        return "The parts are others than in the fit."
    exemplars = {names[int(t)]: int(t) for t in groups.exemplars}
    sources = {template.source: template for template in state.templates if template.source}
    if not sources.keys() <= exemplars.keys():
        return "The exemplars are others than in the fit."
    for name, t in exemplars.items():
        painted = t in labels and (np.asarray(labels[t]) >= 0).any()
        if name not in sources and painted:
            return f"{name} is an exemplar, and the fit had no templates of it."
        if name not in sources:
            continue
        if not state.candidates[t]:
            return f"{name} is an exemplar, and was read anew since the fit."
        if not painted and (state.candidates[t][0].beliefs.evidence >= 0).any():
            return f"{name} is an exemplar, and is no longer painted."
    for g, t in _repainted(state, shapes, groups, labels).items():
        rows = surface_rows(state.templates[g], shapes[t])
        if rows is None:
            return f"{names[t]} is an exemplar, and was read anew since the fit."
        seen = np.isin(np.arange(shapes[t].n_points), rows)
        known = exemplar_parts(shapes[t], labels[t], None if seeds is None else seeds[t]) >= 0
        if why := why_other_surface(names[t], seen, known):
            return why
    return ""


def why_other_surface(name: str, seen: np.ndarray, painted: np.ndarray) -> str:
    """Why the templates of an exemplar, which have ``seen`` (P,) its points, cannot be made again of those ``painted``
    (P,), in a sentence; "" when they can."""
    if much_unseen(seen, painted):
        return UNSEEN.format(name=name)
    return BARE.format(name=name) if much_unseen(painted, seen) else ""


def much_unseen(seen: np.ndarray, painted: np.ndarray) -> bool:
    """Whether too many of an exemplar's ``painted`` points (P,) are none that its templates have ``seen`` (P,)."""
    return bool(painted.any() and (painted & ~seen).sum() > MOST_UNSEEN * painted.sum())


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
    """Take a finished fit up again with other paint or more shapes (see above): ``state`` corrected, then every round.

    Arguments as those of ``fit_templates``; of a fit of other shapes ``state`` is ``gathered``.  With ``within`` the
    shapes that are found anew are told, too, as steps of the round that ``state`` is at.  A state that this yielded
    goes on in the same way: its corrections are part of it.  Raises ValueError with the reason where ``why_not_warm``
    gives one.
    """
    reason = why_not_warm(state, shapes, groups, labels, part_names, seeds)
    if reason:
        raise ValueError(f"state: {reason} Fit from the start.")
    changed = corrected_shapes(state, shapes, labels)
    if changed or state.stop_reason is not None:
        repainted = _repainted(state, shapes, groups, labels)
        if repainted:
            state = _with_new_templates(state, shapes, labels, repainted, rounds, executor, seeds)
            changed = tuple(t for t in changed if t not in repainted.values())
        of = state.family_from + FAMILY_ROUNDS if repainted and state.family_from >= 0 else state.round + rounds
        state = replace(state, stop_reason=None, of=of, phase="corrected")
        hierarchy = state.hierarchy() if state.family is not None else None
        known = (state.templates, state.covariances, hierarchy, state.annealed_from, inner)
        found = in_order(
            executor, _found_anew, (shapes[t] for t in changed), [labels.get(t) for t in changed],
            repeat(shared(executor, known)),
        )  # fmt: skip
        steps = told(found, Within(state.round, of, 0, len(changed)))
        candidates = list(state.candidates)
        for t, one in zip(changed, (yield from steps) if within else end_of(steps), strict=True):
            candidates[t] = one
        state = replace(state, candidates=tuple(candidates))
        yield state
    family_rounds = min(FAMILY_ROUNDS, state.of - state.family_from) if state.family_from >= 0 else 0
    yield from fit_templates(
        shapes, groups, labels, part_names, rng=rng, rounds=state.of, family_rounds=family_rounds, inner=inner,
        executor=executor, seeds=seeds, resume=state, within=within,
    )  # fmt: skip


def _with_new_templates(state, shapes, labels, repainted, rounds, executor, seeds) -> FitState:
    """The state after exemplars were painted otherwise; the family's own templates follow after ``rounds``."""
    templates = state.templates[:-1] if state.family is not None else state.templates
    templates, candidates = carry_candidates(executor, shapes, labels, templates, state.candidates, repainted, seeds)
    after = state.round + rounds if state.family_from >= 0 else -1
    return replace(state, templates=templates, candidates=candidates, family=None, family_from=after)


def _repainted(state: FitState, shapes, groups: Groups, labels: Mapping[int, np.ndarray]) -> dict[int, int]:
    """Template sets whose exemplar is painted otherwise than when they were made, and its shape index."""
    names = _names(shapes)
    exemplars = {names[int(t)]: int(t) for t in groups.exemplars}
    found = {}
    for g, template in enumerate(state.templates):
        t = exemplars.get(template.source)
        if t is not None and t in labels and state.candidates[t]:
            if not np.array_equal(_evidence(shapes[t], labels[t]), state.candidates[t][0].beliefs.evidence):
                found[g] = t
    return found


def _names(shapes: Shapes | Sequence[Shape]) -> tuple[str, ...]:
    return tuple(shapes.names) if hasattr(shapes, "names") else tuple(shape.name for shape in shapes)


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
