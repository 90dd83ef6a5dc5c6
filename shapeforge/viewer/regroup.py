"""Changing groups by hand: exemplars, members, merging, splitting.  Written to the project; all of it can be undone.

Every group keeps at least one member and an exemplar of its own: a group that loses its exemplar is represented by the
most typical shape that is left, and one that loses its last shape is gone.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection.counts import counted
from shapeforge.collection.groups import Groups
from shapeforge.viewer.readiness import YES, Verdict, group_of, groups_of, needs_rest
from shapeforge.viewer.session import Session

# -- what is chosen --------------------------------------------------------------------------------------------------


def chosen_shapes(session: Session) -> tuple[str, ...]:
    """Names of the shapes that are selected: those marked, else the current one."""
    return session.selected or ((session.shape,) if session.shape is not None else ())


def _can_change(session: Session, *, shapes: bool) -> Verdict:
    can, why = needs_rest(session)
    if not can:
        return can, why
    if groups_of(session) is None:
        return False, "Group the shapes first."
    if shapes and not chosen_shapes(session):
        return False, "Select a shape first."
    return YES


def _indices(session: Session) -> Int[np.ndarray, " n"]:
    names = session.project.names
    return np.array([names.index(name) for name in chosen_shapes(session)], int)


def _some(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else counted(len(names), "shape")


# -- exemplars and members -------------------------------------------------------------------------------------------


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
    """Let the selected shape stand for its group."""
    project, name = session.project, session.shape
    g = group_of(session, name)
    before = groups_of(session)
    exemplars = before.exemplars.copy()
    exemplars[g] = project.names.index(name)
    _change_groups(session, f"exemplar {name}", before, dataclasses.replace(before, exemplars=exemplars))
    session.say(f"{name} is the exemplar of {before.names[g]}", "ok")


def can_leave_out(session: Session) -> Verdict:
    """Shapes are selected, and none of them is an exemplar (those left out can be put back)."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    names = chosen_shapes(session)
    if not names or groups_of(session) is None:
        return False, "Select a grouped shape first."
    exemplars = set(groups_of(session).exemplars.tolist())
    for name in names:
        if session.project.names.index(name) in exemplars:
            return False, f"{name} is an exemplar: choose another one for its group first."
    return YES


def is_left_out(session: Session) -> bool:
    """All that is selected was left out, so that leaving out means putting back."""
    names = chosen_shapes(session)
    return bool(names) and groups_of(session) is not None and all(group_of(session, name) < 0 for name in names)


def leave_out(session: Session) -> None:
    """Take the selected shapes out of their groups; when all are out, each joins the group of its nearest exemplar."""
    chosen, before, names = _indices(session), groups_of(session), chosen_shapes(session)
    group = before.group.copy()
    if is_left_out(session):
        away = before.embedding[chosen][:, None] - before.embedding[before.exemplars][None]
        group[chosen] = np.linalg.norm(away, axis=2).argmin(axis=1)
        text = f"put back {_some(names)}"
    else:
        group[chosen] = -1
        text = f"leave out {_some(names)}"
    _change_groups(session, text, before, dataclasses.replace(before, group=group))


# -- moving, merging, splitting --------------------------------------------------------------------------------------


def can_move(session: Session) -> Verdict:
    """Shapes are selected, and there is a group that not all of them belong to."""
    can, why = _can_change(session, shapes=True)
    if not can:
        return can, why
    if not targets(session):
        return False, "There is no other group. A new one can be made of these shapes."
    return YES


def targets(session: Session) -> list[int]:
    """Groups that the selected shapes can be moved to: all but the one that all of them are in."""
    groups, chosen = groups_of(session), _indices(session)
    return [g for g in range(len(groups)) if (groups.group[chosen] != g).any()]


def move_to(session: Session, g: int) -> None:
    """Let the selected shapes belong to group ``g``."""
    before, names = groups_of(session), chosen_shapes(session)
    group = before.group.copy()
    group[_indices(session)] = g
    called = before.names[g]
    _change_groups(session, f"move {_some(names)}", before, tidied(dataclasses.replace(before, group=group)))
    session.group = groups_of(session).names.index(called)
    session.say(f"{_some(names)} moved to {called}", "ok")


def can_make_group(session: Session) -> Verdict:
    """Shapes are selected that are not the whole of one group already."""
    can, why = _can_change(session, shapes=True)
    if not can:
        return can, why
    groups, chosen = groups_of(session), _indices(session)
    found = set(groups.group[chosen].tolist())
    if len(found) == 1 and min(found) >= 0 and len(groups.members(min(found))) == len(chosen):
        return False, f"They are all of {groups.names[min(found)]} already: select some of a group."
    return YES


def make_group(session: Session) -> None:
    """Make a group of the selected shapes; its exemplar is the most typical of them."""
    before, chosen, names = groups_of(session), _indices(session), chosen_shapes(session)
    _split_off(session, before, chosen, f"group of {_some(names)}")


def can_merge(session: Session) -> Verdict:
    """There is another group to merge the current one into."""
    return _beside_others(session, "There is only one group.")


def _beside_others(session: Session, alone: str) -> Verdict:
    """There are other groups than the current one, else ``alone`` is why not."""
    can, why = _can_change(session, shapes=False)
    if not can:
        return can, why
    return YES if len(groups_of(session)) > 1 else (False, alone)


def merge_into(session: Session, g: int) -> None:
    """Let all of the current group belong to group ``g``, which keeps its name and its exemplar."""
    before, gone = groups_of(session), session.group
    group = np.where(before.group == gone, g, before.group)
    called = before.names[g]
    _change_groups(session, f"merge {before.names[gone]}", before, tidied(dataclasses.replace(before, group=group)))
    session.group = groups_of(session).names.index(called)
    session.say(f"{before.names[gone]} is part of {called} now", "ok")


def can_leave_group(session: Session) -> Verdict:
    """There is another group left when the current one goes."""
    return _beside_others(session, "It is the only group: nothing would be left to fit.")


def leave_group_out(session: Session) -> None:
    """Leave out all shapes of the current group, its exemplar too: the group is gone."""
    before, g = groups_of(session), session.group
    group = np.where(before.group == g, -1, before.group)
    after = tidied(dataclasses.replace(before, group=group))
    _change_groups(session, f"leave out {before.names[g]}", before, after)
    session.say(f"{before.names[g]} is left out. Its shapes can be put back one by one.", "ok")


def can_split(session: Session) -> Verdict:
    """The current group has at least two shapes."""
    can, why = _can_change(session, shapes=False)
    if not can:
        return can, why
    groups = groups_of(session)
    if len(groups.members(session.group)) < 2:
        return False, f"{groups.names[session.group]} has one shape only."
    return YES


def split(session: Session) -> None:
    """Cut the current group in two: the exemplar keeps what is more like it than like the second one found."""
    before, g = groups_of(session), session.group
    _split_off(session, before, second_half(before, g), f"split {before.names[g]}")


def _split_off(session: Session, before: Groups, chosen: Int[np.ndarray, " n"], text: str) -> None:
    fresh = next(f"Group {i}" for i in range(1, len(before) + 2) if f"Group {i}" not in before.names)
    group = before.group.copy()
    group[chosen] = len(before)
    exemplars = np.append(before.exemplars, most_typical(before, chosen)).astype(before.exemplars.dtype)
    after = dataclasses.replace(before, names=(*before.names, fresh), group=group, exemplars=exemplars)
    _change_groups(session, text, before, tidied(after))
    session.group = groups_of(session).names.index(fresh)
    session.say(f"{fresh} has {counted(len(chosen), 'shape')}. Double-click its name to rename it.", "ok")


# -- the arithmetic of it --------------------------------------------------------------------------------------------


def _apart(groups: Groups, members: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m m"]:
    """How unlike the members are: the dissimilarity where it is known, else their distance on the map."""
    if groups.dissimilarity is not None:
        return groups.dissimilarity[np.ix_(members, members)]
    place = groups.embedding[members]
    return np.linalg.norm(place[:, None] - place[None], axis=2)


def most_typical(groups: Groups, members: Int[np.ndarray, " m"]) -> int:
    """The one of ``members`` (shape indices) that is nearest to all others."""
    return int(members[_apart(groups, members).sum(axis=1).argmin()])


def second_half(groups: Groups, g: int) -> Int[np.ndarray, " n"]:
    """Members of group ``g`` that are more like some second shape than like the exemplar; never all, never none.

    The second shape is the one that leaves the least distance from each member to the nearer of the two.
    """
    members = groups.members(g)
    apart = _apart(groups, members)
    own = int(np.flatnonzero(members == groups.exemplars[g])[0])
    cost = np.minimum(apart, apart[own]).sum(axis=1)
    cost[own] = np.inf
    second = int(cost.argmin())
    away = apart[second] < apart[own]
    away[own], away[second] = False, True
    return members[away]


def tidied(groups: Groups) -> Groups:
    """The groups without those that have no member, each with an exemplar of its own (the old one where it is one)."""
    kept, exemplars = [], []
    group = np.full_like(groups.group, -1)
    for g, exemplar in enumerate(groups.exemplars):
        members = groups.members(g)
        if len(members):
            group[members] = len(kept)
            kept.append(groups.names[g])
            exemplars.append(int(exemplar) if exemplar in members else most_typical(groups, members))
    exemplars = np.array(exemplars, groups.exemplars.dtype)
    return dataclasses.replace(groups, names=tuple(kept), group=group, exemplars=exemplars)


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
        session.project.set_groups(groups, by_hand=True)
        session.group = min(max(session.group, 0), max(len(groups) - 1, 0))
        session.touch("groups")

    session.do(label, lambda: put(after), lambda: put(before))
