"""Algorithm 1: learn part templates, and fit them to every shape of the family.

``fit_templates`` is an iterator of states; whoever iterates prints, plots, saves, pauses and stops.  Shapes are worked
on one by one by a pure function, so any executor with the ``concurrent.futures`` interface may run them, and so may a
cluster of ``dask.distributed`` (``Client.get_executor()``); sums are taken in the order of the shapes, so the result
does not depend on the number of workers.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np
from jaxtyping import Float

from shapeforge.collection.groups import Groups
from shapeforge.collection.parallel import in_order, kept, shared
from shapeforge.collection.shape import Shape, Shapes
from shapeforge.deformation import family
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.exemplars import Candidate, blend, with_copies, worth_hearing
from shapeforge.deformation.existence import SHARPNESS, usual_flatness
from shapeforge.deformation.factors import FLOORS, Covariances, floored, initial_covariances
from shapeforge.deformation.hierarchy import Hierarchy, link_templates
from shapeforge.deformation.shape_fit import work_on_shape
from shapeforge.deformation.starts import exemplar_starts, exemplar_templates
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import GaussianOnDeformation, Summary, update_templates

ANNEALING = 0.87
"""σ1 shrinks by this factor a round below its first estimate: by maximum likelihood it stays wide and labels blur."""

SETTLED = 5e-4
"""Mean movement of the deformed points (diagonals) in a round below which the fit stops, once σ1 is sharp."""

EXEMPLARS_SHARE = 0.7
"""Share of the planned rounds that several exemplars get: the templates of the family bring their work to its end."""

SEED_WEIGHT, SEED_DECAY = 3.0, 0.95
"""Power with which proposed label probabilities count beside the templates in the first round, and its factor a round.
As a mere start they were forgotten in a round or two, and what all shapes had agreed on was lost on odd ones."""

HEARD_ROUNDS = 3
"""Rounds that every exemplar tried on a shape gets before its word may be found worthless there."""

EXEMPLARS_PER_SHAPE = 3
"""Exemplars tried on every shape: its own group's and the next best by affine residual."""


class FitDiverged(RuntimeError):
    """Numbers stopped being finite; ``state`` is the last good one."""

    def __init__(self, message: str, state: FitState) -> None:
        super().__init__(message)
        self.state = state


@dataclass(frozen=True, eq=False)
class FitState:
    """Progress report and result of a fit.  Lengths in diagonals, energy in nats per surface point.

    ``candidates[t]`` holds each exemplar tried on shape t, ``beliefs[t]`` what follows from them.  ``family_from`` is
    the round with which the exemplars were done (-1: they are not); from the next one on ``family`` links them, the
    last of the ``templates`` are the family's own, and these are among the candidates.
    """

    round: int
    of: int
    phase: str
    energy: float
    change: float
    covariances: Covariances
    annealed_from: float
    sigma_by_part: Float[np.ndarray, " L"]
    templates: tuple[PartTemplates, ...]
    candidates: tuple[tuple[Candidate, ...], ...]
    stop_reason: str | None = None
    family: Hierarchy | None = None
    family_from: int = -1

    @property
    def beliefs(self) -> tuple[Beliefs, ...]:
        """One ``Beliefs`` per shape: the leading candidate's, with the label probabilities of all of them blended."""
        return tuple(blend(candidates) for candidates in self.candidates)

    @property
    def sigmas(self) -> dict[str, np.ndarray]:
        """Standard deviations of the factors, for curves."""
        return self.covariances.sigmas()

    def hierarchy(self) -> Hierarchy:
        """The top-level templates and their links to all ``templates``."""
        if self.family is not None:
            return replace(self.family, top=self.templates[-1])
        return link_templates(
            self.templates, np.bincount([one.template for one in self.beliefs], minlength=len(self.templates)).tolist()
        )


@dataclass(frozen=True)
class Within:
    """Progress inside a round: ``shape`` of ``of_shapes`` are worked on; round 0 is the affine start."""

    round: int
    of: int
    shape: int
    of_shapes: int


def fit_templates(
    shapes: Shapes | Sequence[Shape],
    groups: Groups,
    labels: Mapping[int, np.ndarray],
    part_names: tuple[str, ...],
    *,
    rng: np.random.Generator,
    rounds: int = 10,
    family_rounds: int | None = None,
    inner: int = 3,
    exemplars_per_shape: int = EXEMPLARS_PER_SHAPE,
    executor: Executor | None = None,
    prior: GaussianOnDeformation | None = None,
    seeds: Sequence[np.ndarray] | None = None,
    resume: FitState | None = None,
    within: bool = False,
) -> Iterator[FitState | Within]:
    """Learn part templates from painted exemplars and fit them to every shape (§4, Algorithm 1).

    ``labels[t]`` are part indices per face record (-1: unpainted) of shape t; every group's exemplar needs some, unless
    ``seeds`` gives label probabilities (P, L) of every shape (automatic start): the parts of exemplars where these are
    not painted, the start of Q(S), and soft evidence whose weight falls from round to round.  ``prior(t, g)`` is a
    Gaussian on D.
    Several exemplars get only the first seven tenths of the ``rounds``, and are followed by ``family_rounds`` of the
    family's own templates (see ``family``; None: as many as ``rounds``, at most 8).  ``resume`` goes on from a state
    that an earlier call yielded; one whose fit is at its end is worked on further if ``rounds`` says so.  Yields the
    affine start and then one state a round; ``within`` rounds also a ``Within`` after every shape.

    Raises ValueError when no exemplar has labels or ``seeds`` are of other shapes, FitDiverged (with the last good
    state) on non-finite numbers.
    """
    del rng  # the fit itself is deterministic; the argument is part of every algorithm's face
    family_rounds = min(family.ROUNDS, rounds) if family_rounds is None else family_rounds
    if seeds is not None and len(seeds) != len(shapes):
        raise ValueError(
            f"seeds: wanted label probabilities of each of the {len(shapes)} shapes, got {len(seeds)}; the parts were "
            "proposed for others: propose them again"
        )
    each_shape, painted = kept(executor, shapes), [labels.get(t) for t in range(len(shapes))]
    if resume is None:
        templates = tuple(exemplar_templates(shapes, groups, labels, part_names, seeds))
        owners = _template_of_group(groups, templates, shapes)
        starts = in_order(
            executor, exemplar_starts, each_shape(), painted, repeat(shared(executor, templates)),
            [owners[g] if g >= 0 else 0 for g in groups.group], repeat(exemplars_per_shape),
            seeds if seeds is not None else repeat(None),
        )  # fmt: skip
        of = planned_rounds(rounds, len(templates), family_rounds)
        steps = told(starts, Within(0, of, 0, len(shapes)))
        state = FitState(
            0, 0, "affine start", float("nan"), float("nan"), initial_covariances(), float("nan"),
            np.full(len(part_names), np.nan), templates, tuple((yield from steps) if within else end_of(steps)),
        )  # fmt: skip
        state = replace(state, of=_last_round(state, rounds, family_rounds))
        yield state
    else:
        state = replace(resume, stop_reason=None)
    while state.round < _last_round(state, rounds, family_rounds):
        first = state.family_from if state.family_from >= 0 else exemplar_rounds(rounds)
        if state.family is None and state.round >= first and len(state.templates) > 1 and family_rounds > 0:
            state = _begin_family(state, shapes, each_shape, painted, seeds, executor)
        steps = _one_round(
            state, shapes, each_shape, groups, painted, seeds, rounds, family_rounds, inner, executor, prior
        )
        state = (yield from steps) if within else end_of(steps)
        yield state
        if state.stop_reason is not None:
            return


def _last_round(state: FitState, rounds: int, family_rounds: int) -> int:
    """Number of the round after which a fit ends, as far as can be told from this state."""
    if state.family_from < 0:
        return planned_rounds(rounds, len(state.templates), family_rounds)
    return max(rounds, state.family_from + family_rounds)


def planned_rounds(rounds: int, exemplars: int, family_rounds: int | None = None) -> int:
    """Rounds that a fit of so many exemplars is planned to have, those of the family's own templates included."""
    family_rounds = min(family.ROUNDS, rounds) if family_rounds is None else family_rounds
    return rounds if exemplars < 2 or family_rounds == 0 else max(rounds, exemplar_rounds(rounds) + family_rounds)


def exemplar_rounds(rounds: int) -> int:
    """Rounds that several exemplars' own templates get of those planned; the family's come after them."""
    return max(1, round(EXEMPLARS_SHARE * rounds))


def told(results: Iterable[Any], start: Within) -> Generator[Within, None, list[Any]]:
    """A list of the results; after each but the last, how far it is."""
    found = []
    for result in results:
        found.append(result)
        if len(found) < start.of_shapes:
            yield replace(start, shape=len(found))
    return found


def end_of(steps: Generator[Within, None, Any]) -> Any:
    """What a generator returns, nobody being told how far it is."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def _begin_family(state: FitState, shapes, each_shape, painted, seeds, executor) -> FitState:
    """The exemplars are done: their templates are linked, and the family's start on every shape."""
    known = (state.templates, state.candidates)
    linked = family.link_family(executor, shapes, painted, *known, state.covariances)
    return replace(
        state, family=linked, templates=(*state.templates, linked.top),
        family_from=state.family_from if state.family_from >= 0 else state.round,
        candidates=family.start_family(executor, each_shape(), painted, *known, linked, seeds),
        covariances=replace(state.covariances, unary=np.full(3, family.SIGMA**2)),
    )  # fmt: skip


def _one_round(
    state, shapes, each_shape, groups, painted, seeds, rounds, family_rounds, inner, executor, prior
) -> Generator[Within, None, FitState]:  # fmt: skip
    """One outer round of Algorithm 1: every shape, then Σ, then Y."""
    templates, of_family = state.templates, state.family is not None
    owners = _template_of_group(groups, templates, shapes)
    number = state.round + 1
    in_family = number - state.family_from if of_family else 0
    priors = (
        {c.beliefs.template: prior(t, c.beliefs.template) for c in found if c.family == of_family}
        if prior is not None else None
        for t, found in enumerate(state.candidates)
    )  # fmt: skip
    candidates, moves = [], []
    own: dict[int, Summary] = {}
    pressed: dict[int, list[np.ndarray]] = {}
    learners = [0] * len(templates)
    total: Summary | None = None
    try:
        results = in_order(
            executor, work_on_shape, each_shape(), painted, repeat(shared(executor, templates)), state.candidates,
            repeat(state.covariances), repeat(inner), priors, repeat(of_family),
            seeds if seeds is not None else repeat(None), repeat(SEED_WEIGHT * SEED_DECAY**state.round),
        )  # fmt: skip
        for t, worked in enumerate(results):
            going_on = worked.candidates
            if in_family >= family.TRIAL_ROUNDS:
                going_on = family.better_start(going_on)
            elif not of_family and number >= HEARD_ROUNDS:
                going_on = worth_hearing(going_on)
            candidates.append(going_on)
            moves.append(worked.moved[worked.best])
            for g, flatness in zip(worked.templates, worked.flatness, strict=True):
                pressed.setdefault(g, []).append(flatness)
            best = worked.summaries[worked.best]
            # a template is learnt from the shapes of its own group, the family's from all; Σ from every shape's best
            home = owners[groups.group[t]] if groups.group[t] >= 0 else -1
            said = [(len(templates) - 1, best)] if of_family else zip(worked.templates, worked.summaries, strict=True)
            for g, summary in said:
                if of_family or g == home:
                    own[g] = own[g] + summary if g in own else summary
                    learners[g] += 1
            alone = replace(best, template_moment=np.zeros((1, 3)))
            total = alone if total is None else total + alone
            if t + 1 < len(shapes):
                yield Within(number, state.of, t + 1, len(shapes))
    except FloatingPointError as error:
        raise FitDiverged(
            f"{error}: its fit produced numbers that are not finite, usually from broken descriptors; "
            "import the shape again or leave it out", state,
        ) from error  # fmt: skip
    learnt = tuple(
        update_templates(template, own[g]) if learners[g] > 1 else template for g, template in enumerate(templates)
    )
    # once parts may be found missing, those that are left are not as flat as is usual
    sharp = np.sqrt(state.covariances.unary.mean()) <= SHARPNESS
    learnt = tuple(
        template.moved(template.points, usual_flatness(pressed[g])) if g in pressed and not sharp else template
        for g, template in enumerate(learnt)
    )
    assert total is not None, "there is no family without shapes"
    covariances, first = _update_covariances(total, state, in_family, family_rounds)
    moved = float(np.mean(moves))
    state = FitState(
        number, state.of, "family" if of_family else "fit", total.energy / total.points, moved, covariances, first,
        np.sqrt(total.by_part[:, 1] / np.maximum(total.by_part[:, 0], 1e-9) / 3), learnt, tuple(candidates),
        family=state.family, family_from=state.family_from,
    )  # fmt: skip
    at_rest = np.sqrt(covariances.unary.mean()) <= 1.5 * FLOORS["unary"] and moved < SETTLED
    if at_rest and not of_family and len(templates) > 1 and family_rounds > 0:
        state = replace(state, family_from=number)
    last = _last_round(state, rounds, family_rounds)
    reason = "the planned number of rounds is done" if number >= last else None
    if at_rest and number < last and (of_family or state.family_from < 0):
        reason = "the deformed templates have come to rest"
    if reason is not None:  # the last round: what is left unexplained now stays so
        shared_templates = repeat(shared(executor, templates))
        candidates = list(in_order(executor, with_copies, each_shape(), shared_templates, candidates))
    return replace(state, of=last, stop_reason=reason, candidates=tuple(candidates))


def _update_covariances(
    total: Summary, state: FitState, in_family: int, family_rounds: int
) -> tuple[Covariances, float]:
    """Piecewise maximum likelihood with floors; σ1 is annealed below its first estimate (a departure, by name)."""
    likely = total.unary / max(total.weight, 1e-9)
    spread = float(np.sqrt(likely.mean()))
    first = spread if np.isnan(state.annealed_from) else state.annealed_from
    wanted = max(FLOORS["unary"], first * ANNEALING ** (state.round + 1))
    if in_family:
        wanted = family.sigma_of_round(in_family, family_rounds)
    unary = likely * min(1.0, (wanted / spread) ** 2) if spread > 0 else likely
    return Covariances(
        floored("unary", unary),
        floored("smooth", total.smooth / max(total.pairs, 1)),
        floored("descriptor", total.descriptor / max(total.weight, 1e-9)),
        floored("segment", total.segment / max(total.segment_pairs, 1)),
    ), first


def _template_of_group(groups: Groups, templates: tuple[PartTemplates, ...], shapes) -> list[int]:
    """Index into ``templates`` of every group's own exemplar; -1 where that exemplar was not painted."""
    by_source = {template.source: i for i, template in enumerate(templates)}
    names = shapes.names if hasattr(shapes, "names") else [shape.name for shape in shapes]
    return [by_source.get(names[int(t)], -1) for t in groups.exemplars]
