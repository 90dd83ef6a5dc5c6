"""What the Collection place says of a shape and of an exemplar."""

from __future__ import annotations

from html import escape

import numpy as np

from shapeforge.collection.counts import counted
from shapeforge.collection.groups import Groups
from shapeforge.viewer.readiness import group_of, groups_of
from shapeforge.viewer.session import Session


def hover_card(session: Session, name: str) -> str:
    """What the pointer is told about a shape (HTML)."""
    project, groups = session.project, groups_of(session)
    record = project.shape_record(name)
    g = group_of(session, name)
    group = f" · {groups.names[g]}" if g >= 0 else " · left out" if groups is not None else ""
    facts = [counted(record["n_faces"], "face")]
    facts += [note for note in record.get("notes", ()) if len(note) < 40][:1]
    if g >= 0 and groups.dissimilarity is not None:
        t, e = project.names.index(name), int(groups.exemplars[g])
        facts.append("the exemplar" if t == e else f"{groups.dissimilarity[t, e]:.2f} from its exemplar")
    out = "X: put it back" if g < 0 and groups is not None else "X: leave it out"
    keys = "Enter: paint it · 3: large · O: turn" + (f" · {out}" if groups is not None else "")
    lines = (f"<b>{escape(name)}</b>{escape(group)}", escape(" · ".join(facts)), escape(keys))
    return f"<div style='white-space: nowrap'>{'<br>'.join(lines)}</div>"


def typical_text(groups: Groups, g: int) -> str:
    """How typical the exemplar is: its rank in the group by mean distance to the others; "" when not known."""
    members = groups.members(g)
    if groups.dissimilarity is None or len(members) < 2:
        return f"1 of {len(members)}" if len(members) < 2 else ""
    total = groups.dissimilarity[np.ix_(members, members)].sum(axis=1)
    rank = int((total < total[list(members).index(groups.exemplars[g])] - 1e-12).sum()) + 1
    ending = {1: "st", 2: "nd", 3: "rd"}.get(rank % 10 if rank % 100 not in (11, 12, 13) else 0, "th")
    return f"typical: {rank}{ending} of {len(members)}"
