"""Changes of the family's parts by hand: kept with the project, undone and redone in one line with strokes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from shapeforge.collection.labels import PartNames
from shapeforge.viewer.first_parts import ProposedEdits
from shapeforge.viewer.painting import PaintState, paint_state
from shapeforge.viewer.part_table import PartTable, table_of

EDITS_LIMIT = 200  # edits kept; older ones become the start
ICONS: dict[str, str] = {
    "new": "plus",
    "rename": "paint",
    "recolour": "eyedropper",
    "merge": "link",
    "remove": "close",
}
"""Kinds of edits, and the icon that stands for each."""


Open = tuple[str, PaintState] | None
"""Name and painting of the shape that is being painted, None when there is none."""


@dataclass(frozen=True)
class PartEdit:
    """One change of the parts: from the table ``before`` to ``after``; ``when`` orders it among strokes."""

    kind: str
    label: str
    when: int
    before: PartTable
    after: PartTable


class PartEdits:
    """The parts of a project and the history of changing them: a list of edits and a place in it.

    A history that does not lead to the project's parts (labels were imported, or parts proposed anew) is left out.
    """

    def __init__(self, project: Any) -> None:
        self.project = project
        self.edits, self.done = _edits_of(project.part_edits)
        named = project.part_names or PartNames((), ())
        self.table = PartTable(named.ids, named.names, named.colours)
        kept = self._kept_table()
        if kept is not None and kept.named == named:
            self.table = kept
        else:
            self.edits, self.done = [], 0

    def _kept_table(self) -> PartTable | None:
        if self.done:
            return self.edits[self.done - 1].after
        return self.edits[0].before if self.edits else None

    @property
    def last(self) -> PartEdit | None:
        """The edit that Undo would take back, None when there is none."""
        return self.edits[self.done - 1] if self.done else None

    @property
    def next(self) -> PartEdit | None:
        """The edit that Redo would do again, None when there is none."""
        return self.edits[self.done] if self.done < len(self.edits) else None

    @property
    def undo_label(self) -> str | None:
        """What Undo would take back, None when nothing."""
        return None if self.last is None else self.last.label

    @property
    def redo_label(self) -> str | None:
        """What Redo would do again, None when nothing."""
        return None if self.next is None else self.next.label

    def fresh_id(self) -> int:
        """An id that no part has or had."""
        tables = [self.table, *(table for edit in self.edits for table in (edit.before, edit.after))]
        return 1 + max((identity for table in tables for identity in (*table.ids, *table.joined)), default=-1)

    def do(self, kind: str, label: str, after: PartTable, when: int, open_one: Open) -> None:
        """Change the parts; what had been undone is forgotten.  ``open_one`` is being painted (see ``put``)."""
        edit = PartEdit(kind, label, when, self.table, after)
        edits = [*self.edits[: self.done], edit][-EDITS_LIMIT:]
        self.put(after, edits, len(edits), open_one)

    def take_back(self, open_one: Open) -> None:
        """Take the last edit back, if any."""
        if self.last is not None:
            self.put(self.last.before, self.edits, self.done - 1, open_one)

    def do_again(self, open_one: Open) -> None:
        """Do the next edit again, if any."""
        if self.next is not None:
            self.put(self.next.after, self.edits, self.done + 1, open_one)

    def forget_undone(self) -> None:
        """What had been undone cannot be done again: something new was done instead."""
        if self.next is not None:
            self.put(self.table, self.edits[: self.done], self.done, None)

    def put(self, table: PartTable, edits: list[PartEdit], done: int, open_one: Open) -> None:
        """Have ``table`` for the parts; the labels of all shapes follow, in one step with them.

        ``open_one`` is the shape that is being painted, and its painting, which may not be saved yet."""
        record = {"done": done, "edits": [_record(edit) for edit in edits]}
        changed = self._relabelled(table, open_one) if table.part_of != self.table.part_of else []
        labels = {name: state.labels.copy() for name, state in changed}
        self.project.set_painting(
            {name: faces if (faces >= 0).any() else None for name, faces in labels.items()},
            {name: state.to_record() for name, state in changed},
            part_names=table.named, edits=record,
        )  # fmt: skip
        self.table, self.edits, self.done = table, edits, done

    def _relabelled(self, table: PartTable, open_one: Open) -> list[tuple[str, PaintState]]:
        """Paintings that mean something else by ``table``, each counted by it already."""
        lost_or_won = {identity for identity, _ in table.part_of.items() ^ self.table.part_of.items()}
        if not lost_or_won & self._ever_painted(table):
            return []
        found = []
        for name in self.project.names:
            unsaved = open_one is not None and name == open_one[0]
            if unsaved:
                labels, record = open_one[1].labels.copy(), open_one[1].to_record()
            else:
                labels, record = self.project.labels(name), self.project.read_history(name)
            if labels is None and record is None:
                continue
            state = paint_state(self.project.shape_record(name)["n_faces"], labels, record, self.table)
            before = state.labels
            state.set_table(table)
            if unsaved or (state.labels != before).any():
                found.append((name, state))
        return found

    def _ever_painted(self, table: PartTable) -> set[int]:
        """Ids that some face may be painted with: all but one that is new with ``table``."""
        known = set(self.table.part_of)
        return known | {identity for edit in self.edits for identity in edit.before.part_of | edit.after.part_of}


class PaintHistory:
    """Undo and Redo of Paint: the strokes of the shape being painted and the edits of parts, in the order made.

    Edits of parts that are only proposed come into it while there is nothing else.
    """

    def __init__(self, painter: Any) -> None:
        self.painter = painter

    def _last(self) -> PaintState | PartEdits | ProposedEdits | None:
        """Whose last step Undo takes back."""
        painter = self.painter
        stroke = painter.state.strokes[painter.state.done - 1].when if painter.state.done else None
        edit = None if painter.edits.last is None else painter.edits.last.when
        if edit is not None and (stroke is None or edit >= stroke):
            return painter.edits
        return painter.state if stroke is not None else painter.proposed if painter.proposed.undo_label else None

    def _next(self) -> PaintState | PartEdits | ProposedEdits | None:
        """Whose next step Redo does again."""
        painter = self.painter
        state, next_edit = painter.state, painter.edits.next
        stroke = state.strokes[state.done].when if state.done < len(state.strokes) else None
        edit = None if next_edit is None else next_edit.when
        if edit is not None and (stroke is None or edit < stroke):
            return painter.edits
        return state if stroke is not None else painter.proposed if painter.proposed.redo_label else None

    @property
    def undo_label(self) -> str | None:
        """What Undo would take back, None when nothing."""
        found = self._last()
        return None if found is None else found.undo_label

    @property
    def redo_label(self) -> str | None:
        """What Redo would do again, None when nothing."""
        found = self._next()
        return None if found is None else found.redo_label

    def undo(self) -> None:
        """Take back the last stroke or edit of the parts, if any."""
        self.painter.state.end()
        found = self._last()
        if found is self.painter.edits:
            self.painter.change_parts(self.painter.edits.take_back)
        elif found is not None:
            found.undo()

    def redo(self) -> None:
        """Do the last undone stroke or edit of the parts again, if any."""
        self.painter.state.end()
        found = self._next()
        if found is self.painter.edits:
            self.painter.change_parts(self.painter.edits.do_again)
        elif found is not None:
            found.redo()

    def steps(self) -> list[tuple[str, str, int]]:
        """Every step, those undone last: its label, icon or tool, and how many strokes are in effect after it."""
        state, edits = self.painter.state, self.painter.edits
        found = []
        for strokes, changes, count in (
            (state.strokes[: state.done], edits.edits[: edits.done], 0),
            (state.strokes[state.done :], edits.edits[edits.done :], state.done),
        ):
            both = [(s.when, 1, s.label, s.tool) for s in strokes]
            both += [(e.when, 0, e.label, ICONS.get(e.kind, "paint")) for e in changes]
            for _, is_stroke, label, icon in sorted(both, key=lambda step: step[0]):
                count += is_stroke
                found.append((label, icon, count))
        return found

    @property
    def done(self) -> int:
        """How many steps are in effect."""
        return self.painter.state.done + self.painter.edits.done

    def go_to(self, count: int) -> None:
        """Go to the state after ``count`` steps; beyond either end it stays there."""
        while self.done > max(count, 0):
            self.undo()
        while self.done < count and self._next() is not None:
            self.redo()


def clock(state: PaintState, edits: PartEdits) -> int:
    """The time of a new step: later than that of all others, whatever the computer's clock says."""
    known = [stroke.when for stroke in state.strokes] + [edit.when for edit in edits.edits]
    return max([time.time_ns() // 1000, *(when + 1 for when in known)])


def _record(edit: PartEdit) -> dict[str, Any]:
    tables = {"before": edit.before.to_record(), "after": edit.after.to_record()}
    return {"kind": edit.kind, "label": edit.label, "when": edit.when, **tables}


def _edits_of(record: Mapping[str, Any]) -> tuple[list[PartEdit], int]:
    """Edits and how many of them are in effect; none when the record is not whole."""
    try:
        edits = [
            PartEdit(str(e["kind"]), str(e["label"]), int(e["when"]), table_of(e["before"]), table_of(e["after"]))
            for e in record["edits"]
        ]
        done = int(record["done"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return [], 0
    return (edits, done) if 0 <= done <= len(edits) else ([], 0)
