"""Proposed parts put right in the window: renamed, merged and split, as long as nobody has painted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from shapeforge.viewer.readiness import YES, Verdict, needs_rest
from shapeforge.viewer.session import Session


def are_proposed(session: Session) -> bool:
    """The parts of the project are proposed ones: there is a proposal and no shape is labelled."""
    project = session.project
    return project is not None and not project.labelled and project.current_folder("cosegment") is not None


def can_edit_proposed(session: Session) -> Verdict:
    """Whether proposed parts can be renamed, merged or split now, and why not."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    if not are_proposed(session):
        return False, "Parts are proposed first (First parts automatically); painted ones are changed in the palette."
    return YES


def edit_proposed(session: Session, *edit: str) -> Iterator[Any]:
    """The stage that makes one edit, for the runner or to iterate here: ("rename", part, new name), ("merge", part that
    stays, part that joins it) or ("split", part).  Raises ``StageError`` or ValueError on iteration for what cannot be.
    """
    from shapeforge import stages
    from shapeforge.stages_collection import edits_of

    return stages.run(session.project, "cosegment", edits=edits_of(session.project, edit))


class ProposedEdits:
    """Undo and Redo of the edits of proposed parts.  ``run(make)`` iterates a stage, here or beside the window."""

    def __init__(self, session: Session, run: Callable[[Callable[[], Iterator[Any]]], None]) -> None:
        self.session, self.run = session, run
        self._undone: list[list[str]] = []

    def do(self, *edit: str) -> None:
        """Make an edit (see ``edit_proposed``); what had been undone is forgotten."""
        self._undone.clear()
        self.run(lambda: edit_proposed(self.session, *edit))

    @property
    def undo_label(self) -> str | None:
        """What Undo would take back, None when nothing."""
        done = _edits(self.session)
        return edit_text(done[-1]) if done else None

    @property
    def redo_label(self) -> str | None:
        """What Redo would do again, None when nothing."""
        return edit_text(self._undone[-1]) if self._undone and are_proposed(self.session) else None

    def undo(self) -> None:
        """Take back the last edit, if any."""
        done = _edits(self.session)
        if done:
            self._undone.append(done[-1])
            self.run(lambda: take_back_edit(self.session))

    def redo(self) -> None:
        """Do the last undone edit again, if any."""
        if self._undone:
            edit = self._undone.pop()
            self.run(lambda: edit_proposed(self.session, *edit))


def edit_text(edit: Sequence[str]) -> str:
    """An edit of proposed parts in words."""
    kind, *names = edit
    return {"rename": "rename {}", "merge": "merge {1} into {0}", "split": "split {}"}[kind].format(*names)


def _edits(session: Session) -> list[list[str]]:
    from shapeforge.stages_collection import edits_of

    return edits_of(session.project) if are_proposed(session) else []


def take_back_edit(session: Session) -> Iterator[Any]:
    """The stage without its last edit; the same parts are not sought again."""
    from shapeforge import stages
    from shapeforge.stages_collection import edits_of

    return stages.run(session.project, "cosegment", edits=edits_of(session.project)[:-1])
