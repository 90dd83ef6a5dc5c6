"""What is known of the fit of a project: the rounds seen while it ran, else what is recorded on disk."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from shapeforge.viewer.fit_display import (
    FittedPoints,
    Round,
    TemplateLook,
    all_beliefs,
    best_beliefs,
    fitted_points,
    looks_of,
    movement,
    record_round,
)

WATCHED_AT_MOST = 9
STILL_MOVING = 0.02
"""Mean movement (diagonals) in a round above which a shape is said to be still moving."""


class FitRecord:
    """Rounds and templates of one project's fit, live or from disk.  It belongs to the GUI thread."""

    def __init__(self, project: Any) -> None:
        self.project = project
        self.rounds: dict[int, Round] = {}
        self.looks: tuple[TemplateLook, ...] = ()
        self.active = np.zeros((0, 0), bool)
        self.state: Any | None = None
        """The newest live state; None when nothing has run since the project was opened."""
        self._disk: dict[str, list[FittedPoints]] = {}
        self._loaded: str | None = None
        self._on_disk = -1
        self._names: tuple[str, ...] = ()
        self._templates: list[np.ndarray] = []
        self._off: dict[int, tuple[str, ...]] = {}

    # -- live ------------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """A fit starts: forget the rounds of the one before."""
        self.rounds, self.state, self._disk, self._loaded, self._on_disk = {}, None, {}, None, -1

    def add(self, state: Any, watched: tuple[str, ...]) -> bool:
        """Take a state of the running fit; False when it is no new round."""
        if not hasattr(state, "templates"):
            return False
        if state.round in self.rounds and self.state is not None and self.state.round == state.round:
            return False
        if state.round == 0:
            self.begin()
        looks = looks_of(state, self.project.part_inks)
        self.rounds[state.round] = record_round(state, self.project.names, watched, self.state, looks)
        self.state = state
        self._keep(state)
        return True

    # -- from disk -------------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Without a live fit: numbers and templates of the last complete one (its points are read when asked for)."""
        found = self.project.fit_id
        if self.state is not None or found is None or self._loaded == found:
            return
        self._loaded, self._disk = found, {}  # whatever comes of it, it is read once
        state = self.project.fit()
        if state is None:
            return
        self._keep(state)
        last = record_round(state, self.project.fit_names, (), None, self.looks)
        recorded = self.project.round_figures()
        self._templates = [figures["template"] for figures in recorded]
        self.rounds = {
            number: Round(number, last.of, figures["energy"], figures["change"], figures["sigma"])
            for number, figures in enumerate(recorded[: last.number])
        } | {last.number: last}
        self._on_disk = last.number

    @property
    def newest(self) -> int:
        """Number of the newest round, -1 before there is any."""
        return max(self.rounds, default=-1)

    @property
    def planned(self) -> int:
        """How many rounds were planned, 0 before there is any."""
        return self.rounds[self.newest].of if self.rounds else 0

    @property
    def family_after(self) -> int | None:
        """The last round of the exemplars' templates, once there is one of the family's own; None before that."""
        last = self.rounds[self.newest].family_from if self.rounds else -1
        return last if 0 <= last < self.newest else None

    def points(self, name: str, number: int) -> FittedPoints | None:
        """Template points of a shape after a round; None when they were not recorded, or the templates made anew."""
        one = self._points(name, number)
        return one if look_at(self, one) is not None else None

    def _points(self, name: str, number: int) -> FittedPoints | None:
        known = self.rounds.get(number)
        if known is not None and name in known.points:
            return known.points[name]
        if self.state is not None and not number <= self._on_disk < self.state.round:
            if number != self.state.round or name not in self._names:
                return None
            one = fitted_points(all_beliefs(self.state, self._names.index(name)), self.looks)
            self.rounds[number].points[name] = one
            return one
        recorded = self._read(name)
        return recorded[number] if 0 <= number < len(recorded) else None

    def _read(self, name: str) -> list[FittedPoints]:
        if name not in self._disk:
            beliefs = self.project.beliefs(name)
            if beliefs is None:
                return []
            index = self.project.fit_names.index(name)
            templates = [int(template[index]) for template in self._templates]
            end = fitted_points(beliefs, self.looks)
            rounds = [  # how a shape was turned is known at the end only: so are all its rounds shown
                FittedPoints(
                    np.asarray(beliefs.to_family(np.asarray(points, float)), np.float32),
                    template,
                    end.active,
                    end.turn,
                    spare=end.spare if template == end.template else np.zeros(0, bool),
                )  # fmt: skip
                for points, template in zip(self.project.rounds(name), templates, strict=False)
            ]
            newest = max(self._on_disk, 0)
            self._disk[name] = [*rounds[:newest], end] if len(rounds) >= newest else [end] * (newest + 1)
        return self._disk[name]

    def beliefs(self, name: str) -> Any | None:
        """The newest beliefs about a shape."""
        if self.state is not None and name in self._names:
            return all_beliefs(self.state, self._names.index(name))
        return self.project.beliefs(name)

    def off_on(self, part: int) -> tuple[str, ...]:
        """Shapes that have no such part, by the newest beliefs: neither their own template's nor one lent to them."""
        if part not in self._off:
            off = np.flatnonzero(~self.active[:, part]).tolist() if part < self.active.shape[1] else []
            state = self.state
            if state is not None:  # of a fit from disk the table knows what was lent
                off = [t for t in off if part not in lent_parts(state, t)]
            self._off[part] = tuple(self._names[t] for t in off if t < len(self._names))
        return self._off[part]

    def recolour(self) -> bool:
        """Take the parts' colours as they are now; True when they are others than before."""
        looks = tuple(replace(look, inks=self.project.part_inks(look.part_names)) for look in self.looks)
        changed = any(not np.array_equal(new.inks, old.inks) for new, old in zip(looks, self.looks, strict=True))
        if changed:
            self.looks = looks
        return changed

    def _keep(self, state: Any) -> None:
        self.looks, self._off = looks_of(state, self.project.part_inks), {}
        self._names = self.project.fit_names if self.state is None else self.project.names
        number = len(state.candidates) if hasattr(state, "candidates") else len(state.beliefs)
        self.active = np.stack([best_beliefs(state, t).active for t in range(number)])
        if self.state is None:
            for t in range(number):
                self.active[t, list(lent_parts(state, t))] = True


def lent_parts(state: Any, index: int) -> frozenset[int]:
    """Parts of shape number ``index`` that another exemplar brings."""
    if not hasattr(state, "candidates"):
        return frozenset()
    from shapeforge.deformation.exemplars import lenders

    return frozenset(lenders(state.candidates[index]))


def look_at(record: FitRecord, points: FittedPoints | None) -> TemplateLook | None:
    """The template that points are of, None when it is not known or has other points by now."""
    if points is None or not 0 <= points.template < len(record.looks):
        return None
    look = record.looks[points.template]
    return look if len(look.label) == len(points.positions) else None


def moved_text(record: FitRecord, name: str, number: int) -> tuple[str, bool]:
    """How far a shape's template points moved in a round, in words, and whether that is far; "" when not known."""
    known = record.rounds.get(number)
    moved = known.moved.get(name) if known is not None else None
    if moved is None:  # a fit from disk: its rounds tell
        now = record.points(name, number)
        far = None if now is None else movement(now, record.points(name, number - 1))
        if far is None:
            return "", False
        moved = float(far.mean())
    still = moved > STILL_MOVING
    return f"{'moving' if still else 'moved'} {100 * moved:.1f}%", still
