"""Painting the parts of one shape: labels, and every stroke that made them.  Pure numpy; no window is known here.

One drag is one stroke is one item of the history.  The history is a list of strokes and a place in it, so that undo and
redo are the same walk back and forth, and it is kept with the project.  Strokes and paint are kept by the ids of parts
(see ``part_table``), so that they outlast whatever happens to the list of parts; labels are indices into that list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from shapeforge.collection.labels import UNLABELLED
from shapeforge.viewer.part_table import PartTable

HISTORY_LIMIT = 500  # strokes kept; older ones become the start
HISTORY_VERSION = 2


@dataclass(frozen=True, eq=False)
class Stroke:
    """One edit: ``faces`` (n,) went from the id ``before`` (n,) to ``after`` (n,), -1 is unpainted; ``when`` orders it
    among all edits."""

    tool: str
    label: str
    faces: Int[np.ndarray, " n"]
    before: Int[np.ndarray, " n"]
    after: Int[np.ndarray, " n"]
    when: int = 0


class PaintState:
    """Labels of one shape's faces with their history.

    ``start`` (F,) is where the history begins: part index per face record in ``table``, -1 unpainted; it is copied.
    ``changed`` (if set) is called after every change, ``recorded`` after every new stroke; ``clock()`` says when a
    stroke is made.
    """

    def __init__(self, start: Int[np.ndarray, " F"], table: PartTable) -> None:
        self._table = table
        self._labels = np.array(start, np.int32)
        self._paint = self._table.paint(self._labels)
        self._strokes: list[Stroke] = []
        self._done = 0
        self._open: tuple[str, str, np.ndarray] | None = None
        self.changed: Callable[[], None] | None = None
        self.recorded: Callable[[], None] | None = None
        self.clock: Callable[[], int] = lambda: 0

    # ---- what is painted -----------------------------------------------------------------------------------------

    @property
    def labels(self) -> Int[np.ndarray, " F"]:
        """Part index per face record (F,), -1 unpainted; a read-only view of the present."""
        view = self._labels.view()
        view.flags.writeable = False
        return view

    @property
    def table(self) -> PartTable:
        """The parts that labels are indices into."""
        return self._table

    @property
    def is_drawing(self) -> bool:
        """A stroke has begun and not ended."""
        return self._open is not None

    @property
    def strokes(self) -> Sequence[Stroke]:
        """All strokes, those undone included; the first ``done`` of them are in effect."""
        return tuple(self._strokes)

    @property
    def done(self) -> int:
        """How many strokes are in effect."""
        return self._done

    def labels_after(self, count: int) -> Int[np.ndarray, " F"]:
        """Labels (F,) as they were (or will be) after ``count`` strokes, in the parts there are now."""
        return self._table.labels(self._paint_after(count))

    def _paint_after(self, count: int) -> Int[np.ndarray, " F"]:
        paint = self._paint.copy()
        for stroke in reversed(self._strokes[count : self._done]):
            paint[stroke.faces] = stroke.before
        for stroke in self._strokes[self._done : count]:
            paint[stroke.faces] = stroke.after
        return paint

    # ---- strokes -------------------------------------------------------------------------------------------------

    def begin(self, tool: str, label: str) -> None:
        """Start a stroke: all paint until ``end`` is one item of the history.  An open stroke is ended first."""
        self.end()
        self._open = (tool, label, self._paint.copy())

    def paint(self, faces: Int[np.ndarray, " n"], part: int | Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
        """Give ``faces`` to ``part`` (-1 erases) within the open stroke; returns the faces that really changed."""
        if self._open is None:
            raise ValueError("paint needs an open stroke: call begin(tool, label) first")
        wanted = np.broadcast_to(np.asarray(part, np.int32), faces.shape)
        differs = self._labels[faces] != wanted
        changed = faces[differs]
        self._labels[changed] = wanted[differs]
        self._paint[changed] = self._table.paint(wanted[differs])
        if len(changed):
            self._tell()
        return changed

    def end(self) -> Stroke | None:
        """Close the open stroke; None (and no item in the history) when it changed nothing."""
        if self._open is None:
            return None
        (tool, label, before), self._open = self._open, None
        faces = np.flatnonzero(self._paint != before)
        if not len(faces):
            return None
        stroke = Stroke(tool, label, faces, before[faces], self._paint[faces].copy(), self.clock())
        self.forget_undone()
        self._strokes.append(stroke)
        del self._strokes[: len(self._strokes) - HISTORY_LIMIT]
        self._done = len(self._strokes)
        if self.recorded is not None:
            self.recorded()
        self._tell()
        return stroke

    def stroke(self, tool: str, label: str, faces: Int[np.ndarray, " n"], part: int | Int[np.ndarray, " n"]) -> None:
        """A whole stroke at once."""
        self.begin(tool, label)
        self.paint(faces, part)
        self.end()

    def cancel(self) -> None:
        """Take the open stroke back as if it had not begun."""
        if self._open is not None:
            self._set_paint(self._open[2])
            self._open = None
            self._tell()

    # ---- history -------------------------------------------------------------------------------------------------

    @property
    def undo_label(self) -> str | None:
        """What Undo would take back, None when nothing."""
        return self._strokes[self._done - 1].label if self._done else None

    @property
    def redo_label(self) -> str | None:
        """What Redo would do again, None when nothing."""
        return self._strokes[self._done].label if self._done < len(self._strokes) else None

    def undo(self) -> None:
        """Take back the last stroke, if any."""
        self.go_to(self._done - 1)

    def redo(self) -> None:
        """Do the last undone stroke again, if any."""
        self.go_to(self._done + 1)

    def go_to(self, count: int) -> None:
        """Go to the state after ``count`` strokes; beyond either end it stays there.  An open stroke is ended first."""
        self.end()
        count = min(max(count, 0), len(self._strokes))
        if count != self._done:
            self._set_paint(self._paint_after(count))
            self._done = count
            self._tell()

    def forget_undone(self) -> None:
        """What had been undone cannot be done again: something new was done instead."""
        del self._strokes[self._done :]

    def set_table(self, table: PartTable) -> None:
        """Other parts: the paint stays as it is and counts as what ``table`` says."""
        self.end()
        self._table = table
        self._set_paint(self._paint)
        self._tell()

    def _set_paint(self, paint: Int[np.ndarray, " F"]) -> None:
        self._paint = paint
        self._labels = self._table.labels(paint)

    def _tell(self) -> None:
        if self.changed is not None:
            self.changed()

    # ---- keeping it ----------------------------------------------------------------------------------------------

    def to_record(self) -> dict[str, Any]:
        """Everything as plain arrays, numbers and strings (what the project keeps)."""
        empty = np.zeros(0, np.int32)
        return {
            "version": HISTORY_VERSION,
            "paint": self._paint.copy(),
            "done": self._done,
            "tools": [s.tool for s in self._strokes],
            "names": [s.label for s in self._strokes],
            "when": np.array([s.when for s in self._strokes], np.int64),
            "lengths": np.array([len(s.faces) for s in self._strokes], np.int64),
            "faces": np.concatenate([empty, *(s.faces for s in self._strokes)]).astype(np.int64),
            "before": np.concatenate([empty, *(s.before for s in self._strokes)]).astype(np.int32),
            "after": np.concatenate([empty, *(s.after for s in self._strokes)]).astype(np.int32),
        }


def paint_state(
    n_faces: int, labels: Int[np.ndarray, " F"] | None, record: Mapping[str, Any] | None, table: PartTable
) -> PaintState:
    """A shape's painting from its ``labels`` (None: unpainted) and the kept history ``record`` (None: none).

    A history that does not lead to these labels (they were imported anew, or it is damaged) is left out.
    """
    present = np.full(n_faces, UNLABELLED, np.int32) if labels is None else np.asarray(labels, np.int32)
    if len(present) != n_faces:
        raise ValueError(f"labels: wanted one for each of {n_faces} faces, got {len(present)}")
    state = PaintState(present, table)
    found = _strokes_of(record, n_faces)
    if found is not None and record is not None and np.array_equal(state.table.labels(found[0]), present):
        paint, strokes = found
        done = int(record["done"])
        if 0 <= done <= len(strokes):
            state._paint, state._strokes, state._done = paint.astype(np.int32), strokes, done
    return state


def _strokes_of(record: Mapping[str, Any] | None, n_faces: int) -> tuple[np.ndarray, list[Stroke]] | None:
    """Paint (F,) and strokes of a kept history; None when it is not whole or not about a shape of ``n_faces`` faces."""
    try:
        if record is None or record["version"] != HISTORY_VERSION:
            return None
        paint, lengths, when = (np.asarray(record[key], np.int64) for key in ("paint", "lengths", "when"))
        faces, before, after = (np.asarray(record[key]) for key in ("faces", "before", "after"))
        tools, names = list(record["tools"]), list(record["names"])
    except (KeyError, TypeError, ValueError):
        return None
    total = int(lengths.sum())
    whole = len(faces) == len(before) == len(after) == total and len(tools) == len(names) == len(lengths) == len(when)
    if not whole or len(paint) != n_faces or (total and (faces.min() < 0 or faces.max() >= n_faces)):
        return None
    stop = np.cumsum(lengths)
    return paint, [
        Stroke(str(tools[i]), str(names[i]), faces[b - n : b], before[b - n : b], after[b - n : b], int(when[i]))
        for i, (n, b) in enumerate(zip(lengths, stop, strict=True))
    ]
