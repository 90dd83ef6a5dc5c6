"""Landmarks: template points kept under a name, carried to every shape by the fit; in the strip, the project, a CSV."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent, QWheelEvent
from PySide6.QtWidgets import QFrame, QScrollArea, QWidget

from shapeforge.collection.counts import counted
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.lightbox import Lightbox
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Clickable, EditableName
from shapeforge.viewer.qt.icons import refresh, set_icon
from shapeforge.viewer.qt.widgets import button, clear, column, framed, icon_label, label, row, separator
from shapeforge.viewer.readiness import next_step
from shapeforge.viewer.session import Session


class _Sideways(QScrollArea):
    """Cards in a row; the wheel moves them sideways when they are more than the strip is wide."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)

    def wheelEvent(self, event: QWheelEvent) -> None:
        bar = self.horizontalScrollBar()
        bar.setValue(bar.value() - event.angleDelta().y() - event.angleDelta().x())


class LandmarkCard(Clickable):
    """A landmark: a click shows it, a double click or F2 renames it, Delete (or its cross) forgets it."""

    forgotten = Signal()

    def __init__(self, name: str, about: str) -> None:
        self.name = EditableName(name)
        remove = button(icon="close", kind="icon", tooltip="Forget this landmark  (Del)")
        super().__init__(
            row(icon_label("pin", "text_2"), column(self.name, label(about, "caption"), spacing=0), remove,
                margins=(10, 0, 4, 0)),
            "card", tooltip="Show it on every shape. Double-click or F2: rename it.",
        )  # fmt: skip
        remove.clicked.connect(self.forgotten)
        self.double_clicked.connect(self.name.start)
        self.setMinimumWidth(168)
        self.setMaximumHeight(46)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_F2:
            self.name.start()
        elif event.key() in (Qt.Key.Key_Delete, Qt.Key.Key_Backspace):
            self.forgotten.emit()
        else:
            super().keyPressEvent(event)


class LandmarkStrip(QFrame):
    """The landmarks kept on the present fit; a click chooses one."""

    chosen = Signal(int)

    def __init__(self, session: Session, actions: Actions, binding: Binding, box: Lightbox) -> None:
        super().__init__()
        self.session, self.box = session, box
        self.marks: list[dict[str, Any]] = []
        self.actions = actions
        self.strip_count = label("", "text2")
        self.next = button("Next", kind="primary")
        self.next.setLayoutDirection(Qt.LayoutDirection.RightToLeft)
        set_icon(self.next, "right", "on_accent")
        self.next.clicked.connect(lambda: actions.run(next_step(session)[0]))
        head = framed(
            row(label("Landmarks", "heading"), self.strip_count, None,
                action_button(actions, "export_points", binding), 4, separator(vertical=True), 4, self.next,
                margins=(16, 0, 16, 0)),
            height=44,
        )  # fmt: skip
        self.cards = row(spacing=8, margins=(16, 4, 16, 4))
        cards = QWidget()
        cards.setObjectName("strip_cards")
        cards.setLayout(self.cards)
        area = _Sideways()
        area.setWidget(cards)
        self.setLayout(column(head, separator(), area, spacing=0))

    def show_next(self) -> None:
        """Lead on: learn the family, or make new shapes."""
        if self.session.project is None:
            return
        name, text = next_step(self.session)
        can, why = self.actions.verdict(name)
        self.next.setText(text)
        self.next.setEnabled(can)
        self.next.setToolTip(self.actions[name].tooltip if can else why)

    def reload(self) -> None:
        """Look at what is kept on the present fit."""
        self.marks = self.read()

    def _file(self) -> Path:
        return Path(self.session.project.path) / "landmarks_kept.json"

    def read(self) -> list[dict[str, Any]]:
        """The landmarks kept with the project.

        A template point means nothing on another fit: then the place where the landmark was put, on the shape on which
        it was put, tells which point it is now.
        """
        try:
            kept = json.loads(self._file().read_text("utf-8"))
            same = kept["fit"] == self.session.project.fit_id
            found = [dict(mark) for mark in kept["landmarks"] if isinstance(mark["name"], str)]
        except (OSError, ValueError, KeyError, TypeError):
            return []  # none kept, or not ours to read
        if not same:
            found = [self._found_again(mark) for mark in found]
        valid = [m for m in found if m is not None and isinstance(m.get("point"), int)]
        return [mark for mark in valid if 0 <= mark["point"] < self.box.n_points]

    def _found_again(self, mark: dict[str, Any]) -> dict[str, Any] | None:
        shape, position = mark.get("shape"), np.asarray(mark.get("position", ()), float)
        if shape not in self.box.names or position.shape != (3,) or not np.isfinite(position).all():
            return None
        point = self.box.point_at(shape, position @ self.box.known(shape).turn.T)
        return None if point is None else mark | {"point": point}

    def _set(self, marks: list[dict[str, Any]]) -> None:
        self.marks = list(marks)
        kept = {"version": 2, "fit": self.session.project.fit_id, "landmarks": self.marks}
        _write(self._file(), json.dumps(kept, indent=1))
        self.show_marks()

    def _change(self, what: str, marks: list[dict[str, Any]]) -> None:
        """Other landmarks, as an edit that can be undone while this fit is looked at."""
        before, fit = list(self.marks), self.session.project.fit_id

        def put(wanted: list[dict[str, Any]]) -> None:
            if self.session.project is not None and self.session.project.fit_id == fit:
                self._set(wanted)

        self.session.do(what, lambda: put(marks), lambda: put(before))

    def keep(self, point: int) -> None:
        """Keep a template point under the name of its place; one that is kept already stays."""
        if all(mark["point"] != point for mark in self.marks):
            name, taken = self.box.describe(point), {mark["name"] for mark in self.marks}
            number = 2
            base = name
            while name in taken:
                name, number = f"{base} {number}", number + 1
            on = self.box.present_on(point)
            shape = self.session.shape if self.session.shape in on else on[0]
            known = self.box.known(shape)
            position = (known.positions[point] @ known.turn).tolist()  # as the shape lies, whatever the next fit says
            mark = {"name": name, "point": int(point), "shape": shape, "position": position}
            self._change(f"keeping {name}", [*self.marks, mark])
        self.show_marks()

    def forget(self, mark: dict[str, Any]) -> None:
        """Forget a landmark."""
        self._change(f"forgetting {mark['name']}", [one for one in self.marks if one is not mark])

    def rename(self, mark: dict[str, Any], name: str) -> None:
        """Call a landmark something else; an empty name, or one that is taken, is refused in the status."""
        name = " ".join(name.split())
        if not name or any(one["name"] == name for one in self.marks if one is not mark):
            self.session.say(f"A landmark needs a name of its own, {name or 'nothing'!r} is none.", "warning")
            self.show_marks()
            return
        renamed = [one | {"name": name} if one is mark else one for one in self.marks]
        self._change(f"calling {mark['name']} {name}", renamed)

    def show_marks(self) -> None:
        """A card for each landmark."""
        clear(self.cards)
        self.shown: list[LandmarkCard] = []
        for mark in self.marks:
            on = self.box.present_on(mark["point"])
            sure = np.mean([self.box.confidence(name, mark["point"]) for name in on]) if on else 0.0
            card = LandmarkCard(mark["name"], f"{counted(len(on), 'shape')} · {sure:.0%} sure")
            card.clicked.connect(lambda mark=mark: self.chosen.emit(mark["point"]))
            card.forgotten.connect(lambda mark=mark: self.forget(mark))
            card.name.renamed.connect(lambda name, mark=mark: self.rename(mark, name))
            card.set_current(mark["point"] == self.session.picked)
            self.shown.append(card)
            self.cards.addWidget(card)
        if not self.marks:
            self.cards.addWidget(
                label("Pick a point and keep it: it is placed once and carried to every shape.", "text2")
            )
        self.cards.addStretch(1)
        self.strip_count.setText(
            f"{len(self.marks)} placed once, carried to every shape that has the part" if self.marks else ""
        )
        refresh(self, self.session.theme)

    def export(self, path: Path) -> int:
        """Write every landmark on every shape, in its file's coordinates, as CSV; how many points."""
        project = self.session.project
        rows = [["shape", "landmark", "x", "y", "z", "confidence"]]
        for name in self.box.names:
            frame = project.shapes[list(project.names).index(name)].frame
            for mark in self.marks:
                position = project.positions(name)[mark["point"]]  # as the shape lies in its file
                if np.isfinite(position).all():
                    sure = self.box.confidence(name, mark["point"])
                    rows.append([name, mark["name"], *(f"{x:.6g}" for x in frame.to_input(position)), f"{sure:.3f}"])
        with tempfile.NamedTemporaryFile("w", newline="", encoding="utf-8", dir=path.parent, delete=False) as file:
            csv.writer(file).writerows(rows)
        os.replace(file.name, path)
        return len(rows) - 1


def _write(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", dir=path.parent, delete=False) as file:
        file.write(text)
    os.replace(file.name, path)
