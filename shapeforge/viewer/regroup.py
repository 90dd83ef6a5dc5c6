"""Changing groups by hand: another exemplar, a shape left out or put back.  Written to the project; can be undone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from shapeforge.viewer.readiness import YES, Verdict, group_of, groups_of, needs_rest
from shapeforge.viewer.session import Session


def can_make_exemplar(session: Session) -> Verdict:
    """The selected shape belongs to a group that another stands for."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    if session.shape is None:
        return False, "Select a shape first."
    g = group_of(session, session.shape)
    if g < 0:
        return False, f"{session.shape} belongs to no group."
    if session.project.names[groups_of(session).exemplars[g]] == session.shape:
        return False, f"{session.shape} is the exemplar already."
    return YES


def make_exemplar(session: Session) -> None:
    """Let the selected shape stand for its group; can be undone."""
    project, name = session.project, session.shape
    g = group_of(session, name)
    before = groups_of(session)
    exemplars = before.exemplars.copy()
    exemplars[g] = project.names.index(name)
    _change_groups(session, f"exemplar {name}", before, dataclasses.replace(before, exemplars=exemplars))
    session.say(f"{name} is the exemplar of {before.names[g]}", "ok")


def can_leave_out(session: Session) -> Verdict:
    """The selected shape is grouped and no exemplar (or was left out: then it can be put back)."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    if session.shape is None or groups_of(session) is None:
        return False, "Select a grouped shape first."
    if session.project.names.index(session.shape) in groups_of(session).exemplars:
        return False, f"{session.shape} is an exemplar: choose another one for its group first."
    return YES


def leave_out(session: Session) -> None:
    """Take the selected shape out of its group; a shape left out joins the group of its nearest neighbour again."""
    project, name = session.project, session.shape
    t, before = project.names.index(name), groups_of(session)
    group = before.group.copy()
    if group[t] >= 0:
        group[t] = -1
        text = f"leave out {name}"
    else:
        distance = np.linalg.norm(before.embedding[before.exemplars] - before.embedding[t], axis=1)
        group[t] = int(distance.argmin())
        text = f"put back {name}"
    _change_groups(session, text, before, dataclasses.replace(before, group=group))


def rename_group(session: Session, g: int, name: str) -> None:
    """Call group ``g`` otherwise; nothing goes stale, and it can be undone.  Empty and taken names are refused."""
    before, name = groups_of(session), " ".join(name.split())
    if name == before.names[g]:
        return
    if not name or name in before.names:
        session.say(f"There is a group {name} already." if name else "A group needs a name.", "warning")
        session.touch("groups")
        return
    names = (*before.names[:g], name, *before.names[g + 1 :])
    _change_groups(session, f"rename {before.names[g]}", before, dataclasses.replace(before, names=names))


def _change_groups(session: Session, label: str, before: Any, after: Any) -> None:
    def put(groups: Any) -> None:
        session.project.set_groups(groups)
        session.touch("groups")

    session.do(label, lambda: put(after), lambda: put(before))
