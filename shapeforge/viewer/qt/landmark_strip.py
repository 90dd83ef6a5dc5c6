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
from PySide6.QtWidgets import QFrame, QWidget

from shapeforge.viewer.actions import Actions
from shapeforge.viewer.lightbox import Lightbox
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.icons import refresh, set_icon
from shapeforge.viewer.qt.widgets import (
    Clickable,
    ElidedLabel,
    button,
    clear,
    column,
    framed,
    icon_label,
    label,
    row,
    separator,
)
from shapeforge.viewer.readiness import next_step
from shapeforge.viewer.session import Session


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
        self.cards = row(spacing=8, margins=(16, 5, 16, 6))
        cards = QWidget()
        cards.setLayout(self.cards)
        self.setLayout(column(head, separator(), cards, spacing=0))

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
        """Landmarks kept on this fit (template points mean nothing on another)."""
        try:
            kept = json.loads(self._file().read_text("utf-8"))
            if kept["fit"] == self.session.project.fit_id:
                return [
                    m for m in kept["landmarks"] if 0 <= m["point"] < self.box.n_points and isinstance(m["name"], str)
                ]
        except (OSError, ValueError, KeyError, TypeError):
            pass  # none kept, or not ours to read
        return []

    def _write_landmarks(self) -> None:
        kept = {"version": 1, "fit": self.session.project.fit_id, "landmarks": self.marks}
        _write(self._file(), json.dumps(kept, indent=1))

    def keep(self, point: int) -> None:
        """Keep a template point under the name of its place; one that is kept already stays."""
        if all(mark["point"] != point for mark in self.marks):
            name, taken = self.box.describe(point), {mark["name"] for mark in self.marks}
            number = 2
            base = name
            while name in taken:
                name, number = f"{base} {number}", number + 1
            self.marks.append({"name": name, "point": int(point)})
            self._write_landmarks()
        self.show_marks()

    def show_marks(self) -> None:
        """A card for each landmark."""
        clear(self.cards)
        for mark in self.marks[:6]:
            on = self.box.present_on(mark["point"])
            sure = np.mean([self.box.confidence(name, mark["point"]) for name in on]) if on else 0.0
            words = column(
                ElidedLabel(mark["name"], "strong"),
                label(f"{len(on)} shape{'s' * (len(on) != 1)} · {sure:.0%} sure", "caption"), spacing=1,
            )  # fmt: skip
            remove = button(icon="close", kind="icon", tooltip="Forget this landmark")
            remove.clicked.connect(lambda _=False, mark=mark: self._forget(mark))
            card = Clickable(
                row(icon_label("pin", "text_2"), words, remove, margins=(10, 0, 4, 0)), "card", tooltip="Show it"
            )
            card.clicked.connect(lambda mark=mark: self.chosen.emit(mark["point"]))
            card.set_current(mark["point"] == self.session.picked)
            card.setMaximumWidth(260)
            self.cards.addWidget(card, 1)
        if not self.marks:
            self.cards.addWidget(
                label("Pick a point and keep it: it is placed once and carried to every shape.", "off")
            )
        self.cards.addStretch(1)
        self.strip_count.setText(
            f"{len(self.marks)} placed once, carried to {len(self.box.names)} shapes" if self.marks else ""
        )
        refresh(self, self.session.theme)

    def _forget(self, mark: dict[str, Any]) -> None:
        self.marks.remove(mark)
        self._write_landmarks()
        self.show_marks()

    def export(self, path: Path) -> int:
        """Write every landmark on every shape, in its file's coordinates, as CSV; how many points."""
        project = self.session.project
        rows = [["shape", "landmark", "x", "y", "z", "confidence"]]
        for name in self.box.names:
            frame = project.shapes[list(project.names).index(name)].frame
            for mark in self.marks:
                position = self.box.known(name).positions[mark["point"]]
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
