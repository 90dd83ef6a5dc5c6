"""Painting the parts of one shape: labels, and every stroke that made them.  Pure numpy; no window is known here.

One drag is one stroke is one item of the history.  The history is a list of strokes and a place in it, so that undo and
redo are the same walk back and forth, and it is kept with the project.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from shapeforge.collection.labels import UNLABELLED

HISTORY_LIMIT = 500  # strokes kept; older ones become the start
HISTORY_VERSION = 1


@dataclass(frozen=True, eq=False)
class Stroke:
    """One edit: ``faces`` (n,) went from part ``before`` (n,) to part ``after`` (n,); -1 is unpainted."""

    tool: str
    label: str
    faces: Int[np.ndarray, " n"]
    before: Int[np.ndarray, " n"]
    after: Int[np.ndarray, " n"]


class PaintState:
    """Labels of one shape's faces with their history.  ``changed`` (if set) is called after every change.

    ``start`` (F,) is where the history begins: part index per face record, -1 unpainted.  The arrays given are copied.
    """

    def __init__(self, start: Int[np.ndarray, " F"]) -> None:
        self._labels = np.array(start, np.int32)
        self._strokes: list[Stroke] = []
        self._done = 0
        self._open: tuple[str, str, np.ndarray] | None = None
        self.changed: Callable[[], None] | None = None

    # ---- what is painted -----------------------------------------------------------------------------------------

    @property
    def labels(self) -> Int[np.ndarray, " F"]:
        """Part index per face record (F,), -1 unpainted; a read-only view of the present."""
        view = self._labels.view()
        view.flags.writeable = False
        return view

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
        """Labels (F,) as they were (or will be) after ``count`` strokes."""
        labels = self._labels.copy()
        for stroke in reversed(self._strokes[count : self._done]):
            labels[stroke.faces] = stroke.before
        for stroke in self._strokes[self._done : count]:
            labels[stroke.faces] = stroke.after
        return labels

    # ---- strokes -------------------------------------------------------------------------------------------------

    def begin(self, tool: str, label: str) -> None:
        """Start a stroke: all paint until ``end`` is one item of the history.  An open stroke is ended first."""
        self.end()
        self._open = (tool, label, self._labels.copy())

    def paint(self, faces: Int[np.ndarray, " n"], part: int | Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
        """Give ``faces`` to ``part`` (-1 erases) within the open stroke; returns the faces that really changed."""
        if self._open is None:
            raise ValueError("paint needs an open stroke: call begin(tool, label) first")
        wanted = np.broadcast_to(np.asarray(part, np.int32), faces.shape)
        differs = self._labels[faces] != wanted
        changed = faces[differs]
        self._labels[changed] = wanted[differs]
        if len(changed):
            self._tell()
        return changed

    def end(self) -> Stroke | None:
        """Close the open stroke; None (and no item in the history) when it changed nothing."""
        if self._open is None:
            return None
        (tool, label, before), self._open = self._open, None
        faces = np.flatnonzero(self._labels != before)
        if not len(faces):
            return None
        stroke = Stroke(tool, label, faces, before[faces], self._labels[faces].copy())
        del self._strokes[self._done :]  # what had been undone is forgotten
        self._strokes.append(stroke)
        del self._strokes[: len(self._strokes) - HISTORY_LIMIT]
        self._done = len(self._strokes)
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
            self._labels[:] = self._open[2]
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
            self._labels[:] = self.labels_after(count)
            self._done = count
            self._tell()

    def rename_parts(self, new_index: Mapping[int, int]) -> None:
        """Give parts other indices, everywhere in the history too (after merging or removing parts)."""
        self.end()
        highest = max([int(self._labels.max(initial=-1)), *new_index, *(int(s.after.max()) for s in self._strokes)])
        highest = max([highest, *(int(s.before.max()) for s in self._strokes)])
        table = np.arange(-1, highest + 1, dtype=np.int32)
        for old, new in new_index.items():
            table[old + 1] = new
        self._labels[:] = table[self._labels + 1]
        self._strokes = [
            Stroke(s.tool, s.label, s.faces, table[s.before + 1], table[s.after + 1]) for s in self._strokes
        ]
        self._tell()

    def _tell(self) -> None:
        if self.changed is not None:
            self.changed()

    # ---- keeping it ----------------------------------------------------------------------------------------------

    def to_record(self) -> dict[str, Any]:
        """Everything as plain arrays, numbers and strings (what the project keeps)."""
        empty = np.zeros(0, np.int32)
        return {
            "version": HISTORY_VERSION,
            "labels": self._labels.copy(),
            "done": self._done,
            "tools": [s.tool for s in self._strokes],
            "names": [s.label for s in self._strokes],
            "lengths": np.array([len(s.faces) for s in self._strokes], np.int64),
            "faces": np.concatenate([empty, *(s.faces for s in self._strokes)]).astype(np.int64),
            "before": np.concatenate([empty, *(s.before for s in self._strokes)]).astype(np.int32),
            "after": np.concatenate([empty, *(s.after for s in self._strokes)]).astype(np.int32),
        }


def paint_state(
    n_faces: int, labels: Int[np.ndarray, " F"] | None = None, record: Mapping[str, Any] | None = None
) -> PaintState:
    """A shape's painting from its ``labels`` (None: unpainted) and the kept history ``record`` (None: none).

    A history that does not lead to these labels (they were imported anew, or it is damaged) is left out.
    """
    present = np.full(n_faces, UNLABELLED, np.int32) if labels is None else np.asarray(labels, np.int32)
    if len(present) != n_faces:
        raise ValueError(f"labels: wanted one for each of {n_faces} faces, got {len(present)}")
    state = PaintState(present)
    strokes = _strokes_of(record, n_faces)
    done = int(record["done"]) if strokes and record is not None else 0
    if strokes and 0 <= done <= len(strokes) and np.array_equal(np.asarray(record["labels"]), present):
        state._strokes, state._done = strokes, done
    return state


def _strokes_of(record: Mapping[str, Any] | None, n_faces: int) -> list[Stroke]:
    """The strokes of a kept history; none when it is not whole or not about a shape of ``n_faces`` faces."""
    try:
        if record is None or record["version"] != HISTORY_VERSION:
            return []
        lengths = np.asarray(record["lengths"], np.int64)
        faces, before, after = (np.asarray(record[key]) for key in ("faces", "before", "after"))
        tools, names = list(record["tools"]), list(record["names"])
    except (KeyError, TypeError, ValueError):
        return []
    total = int(lengths.sum())
    whole = len(faces) == len(before) == len(after) == total and len(tools) == len(names) == len(lengths)
    if not whole or (total and (faces.min() < 0 or faces.max() >= n_faces)):
        return []
    stop = np.cumsum(lengths)
    return [
        Stroke(str(tools[i]), str(names[i]), faces[b - n : b], before[b - n : b], after[b - n : b])
        for i, (n, b) in enumerate(zip(lengths, stop, strict=True))
    ]
