"""Proposed parts put right in the window: renamed, merged and split, as long as nobody has painted."""

from __future__ import annotations

from collections.abc import Iterator
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


def take_back_edit(session: Session) -> Iterator[Any]:
    """The stage without its last edit; the same parts are not sought again."""
    from shapeforge import stages
    from shapeforge.stages_collection import edits_of

    return stages.run(session.project, "cosegment", edits=edits_of(session.project)[:-1])
