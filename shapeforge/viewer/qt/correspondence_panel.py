"""The Correspondence place: many shapes side by side; a point picked on one lights up on all, two measure all."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QRectF, Qt, QTimer
from PySide6.QtGui import QColor, QPainter, QPen
from PySide6.QtWidgets import QBoxLayout, QFrame, QWidget

from shapeforge.viewer.actions import YES, Action, Actions
from shapeforge.viewer.lightbox import Lightbox
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.picking import Pick
from shapeforge.viewer.qt.bars import HeatRamp, Histogram
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.theme import colours
from shapeforge.viewer.qt.widgets import (
    Choice,
    Clickable,
    ElidedLabel,
    Swatch,
    button,
    clear,
    column,
    framed,
    icon_label,
    label,
    row,
    scrolled,
    section,
    separator,
)
from shapeforge.viewer.session import Session

COUNTS = ("4", "6", "9", "12", "16", "20")
SORTS = (
    ("high", "confidence, high first"),
    ("low", "confidence, low first"),
    ("name", "name"),
    ("group", "group"),
)  # fmt: skip
COLOURS = (("spread", "spread of the point"), ("part", "part"), ("coordinate", "template coordinate"))
LOW = 0.5
HOVER_MS = 30


class CorrespondencePlace:
    """The lightbox.  ``session.picked`` is the first template point, ``second`` the one it is measured to."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.binding = Binding(session)
        self.box = Lightbox(session)
        self.second: int | None = None
        self.hovered: int | None = None
        self.sort, self.count, self.colour_by = "high", 12, "spread"
        self.names: tuple[str, ...] = ()
        self.landmarks: list[dict[str, Any]] = []
        self._overlaid = False
        self._entered = False
        self._view_factory = view_factory
        self._add_actions()
        self._build()
        self._hover_timer = QTimer(self.centre, singleShot=True, interval=HOVER_MS)
        self._hover_timer.timeout.connect(self._show_hover)
        self.binding.on(("picked", "selected", "theme", "compare"), self._show, now=False)
        self.binding.on(("data",), self._reload, now=False)

    # ---- building ------------------------------------------------------------------------------------------------

    def _add_actions(self) -> None:
        def add(
            name: str, text: str, run: Callable[[], None], key: str, tooltip: str, icon: str, enabled: Any = None
        ) -> None:
            verdict = enabled or (lambda _session: YES)
            self.actions.add(Action(name, text, lambda _s: run(), verdict, key, tooltip, icon, "correspondence"))

        add("clear_points", "Clear", self._clear, "Escape", "Forget the picked points", "close", self._has_point)
        add(
            "keep_landmark",
            "Keep as landmark",
            self._keep,
            "K",
            "Keep the picked point under a name",
            "pin",
            self._has_point,
        )
        add("show_worst", "Show the worst", self._show_worst, "W", "Sorts by confidence, low first", "sort")
        add(
            "correct",
            "Correct…",
            self._correct,
            "",
            "Paint a correction on the selected shape",
            "brush",
            self._one_shape,
        )
        add(
            "overlay",
            "Overlay two shapes",
            self._toggle_overlay,
            "O",
            "Look at two shapes in one view",
            "overlay",
            self._two,
        )
        add("export_points", "Export CSV…", self._export, "", "The landmarks on every shape, in its file's coordinates",
            "export", self._has_landmarks)  # fmt: skip
        add("home_lightbox", "Look from the front", lambda: self.view.fit(), "Home", "The usual view", "home")

    def _build(self) -> None:
        self.view = self._view_factory()
        self.view.clicked.connect(self._click)
        self.view.hovered.connect(self._hover)
        self.view.double_clicked.connect(self._choose)
        whole = column(self.view, spacing=0)
        self.centre = framed(whole, "centre")
        self.centre.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.colour = Choice("Colour by", COLOURS, self.colour_by)
        self.colour.chosen.connect(self._colour_chosen)
        self.sorting = Choice("Sort by", SORTS, self.sort)
        self.sorting.chosen.connect(self._sort_chosen)
        self.showing = Choice("Show", tuple((n, n) for n in COUNTS), str(self.count))
        self.showing.chosen.connect(self._count_chosen)
        home = action_button(self.actions, "home_lightbox", self.binding, text="", kind="tool")
        self.hint = label("click a point, click a second to measure", "off")
        self.toolbar_widget = framed(
            row(self.colour, self.sorting, self.showing, 4, self.hint, None, home, margins=(16, 0, 16, 0))
        )
        self._build_inspector()
        self._build_strip()

    def _build_inspector(self) -> None:
        clear_link = action_button(self.actions, "clear_points", self.binding, kind="link", icon=False)
        self.first_name, self.first_on = ElidedLabel("", "strong"), label("", "text2")
        self.second_name, self.second_on = ElidedLabel("", "strong"), label("", "text2")
        self.first_swatch, self.second_swatch = Swatch("#4F8CFF", size=12, disc=True), _Ring()
        keep = action_button(self.actions, "keep_landmark", self.binding)
        picked = section(
            row(label("Picked points", "heading"), None, clear_link),
            *self._point_rows(), keep, spacing=10,
        )  # fmt: skip
        self.histogram = Histogram()
        self.distance_of = label("", "caption")
        self.median, self.middle, self.here = label("", "strong"), label("", "strong"), label("", "strong")
        self.here_name = label("here", "caption")
        numbers = row(
            column(label("median", "caption"), self.median, spacing=2), None,
            column(label("middle half", "caption"), self.middle, spacing=2), None,
            column(self.here_name, self.here, spacing=2),
        )  # fmt: skip
        self.no_distance = label("Click a second point to measure on every shape.", "caption", wrap=True)
        self.distance_box = QWidget()
        self.distance_box.setLayout(column(self.histogram, numbers, spacing=6))
        distance = section(
            row(label("Distance", "heading"), None, self.distance_of), self.no_distance, self.distance_box
        )
        self.low_title, self.low_text = label("", "strong"), label("", "caption", wrap=True)
        self.low_icon = icon_label("warning", "error", 16)
        low = row(self.low_icon, column(self.low_title, self.low_text, spacing=2), spacing=8)
        low.setAlignment(self.low_icon, Qt.AlignmentFlag.AlignTop)
        low.setStretch(1, 1)
        buttons = row(action_button(self.actions, "show_worst", self.binding, icon=False),
                      action_button(self.actions, "correct", self.binding))  # fmt: skip
        buttons.setStretch(0, 1)
        buttons.setStretch(1, 1)
        sure = section(
            label("How sure is the point", "heading"), HeatRamp(),
            row(label("not here", "caption"), None, label("share of the point", "caption"), None, label("all here", "caption")),
            4, low, 4, buttons, line=False,
        )  # fmt: skip
        self.overlay_why = label("", "caption", wrap=True)
        foot = QFrame()
        foot.setObjectName("bar")
        foot.setLayout(
            column(
                label("Compare", "heading"),
                action_button(self.actions, "overlay", self.binding),
                self.overlay_why,
                spacing=8,
                margins=(16, 12, 16, 16),
            )  # fmt: skip
        )
        inside = column(scrolled(picked, distance, sure), foot, spacing=0)
        inside.setStretch(0, 1)
        self.inspector = framed(inside)

    def _point_rows(self) -> tuple[QBoxLayout, ...]:
        rows = (
            row(self.first_swatch, 4, self.first_name, self.first_on),
            row(self.second_swatch, 4, self.second_name, self.second_on),
        )
        for one in rows:
            one.setStretch(2, 1)
        return rows

    def _build_strip(self) -> None:
        self.strip_count = label("", "text2")
        head = framed(
            row(label("Landmarks", "heading"), self.strip_count, None,
                action_button(self.actions, "export_points", self.binding), margins=(16, 0, 16, 0)),
            height=44,
        )  # fmt: skip
        self.cards = row(spacing=8, margins=(16, 5, 16, 6))
        cards = QWidget()
        cards.setLayout(self.cards)
        self.strip = framed(column(head, separator(), cards, spacing=0))

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Show the fitted family."""
        self._entered = True
        self._reload()
        self._show(fit=True)

    def leave(self) -> None:
        """Nothing has to be saved here."""
        self._entered = False

    def close(self) -> None:
        """The window closes."""
        self._hover_timer.stop()
        self.binding.close()

    def _reload(self) -> None:
        if not self._entered or self.session.project is None or not self.session.project.fit_names:
            return
        if self.box.reload():
            self.second = None
            if self.session.picked is not None and self.session.picked >= self.box.n_points:
                self.session.picked = None
            self.landmarks = self._read_landmarks()
            self._arrange()
            self._show(fit=True)

    # ---- what is shown -------------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        """Which shapes are shown, in which order."""
        box, picked = self.box, self.session.picked
        names = [name for name in self.session.compare if name in box.names] or list(box.names)
        if self.sort in ("high", "low"):
            names.sort(key=lambda name: box.confidence(name, picked), reverse=self.sort == "high")
        elif self.sort == "name":
            names.sort()
        elif self.session.project.groups is not None:
            groups = self.session.project.groups
            index = {name: i for i, name in enumerate(groups.names)} if len(groups.names) == len(groups.group) else {}
            names.sort(key=lambda name: (int(groups.group[index[name]]) if name in index else 0, name))
        self.names = tuple(names[: self.count])
        self.showing.set_options(
            tuple((n, f"{min(int(n), len(names))} of {len(names)}") for n in COUNTS), str(self.count)
        )

    def _show(self, *, fit: bool = False) -> None:
        if not self._entered or self.session.project is None or not self.box.names:
            return
        session, view = self.session, self.view
        if self._overlaid and len(session.selected) == 2:
            view.display(self.box.overlay(*session.selected), fit=fit)
        else:
            self._overlaid = False
            aspect = view.width() / max(view.height(), 1)
            display = self.box.display(
                self.names, colour_by=self.colour_by, picked=session.picked, second=self.second, hover=self.hovered,
                selected=(*session.selected, *([session.shape] if session.shape else [])), aspect=aspect,
            )  # fmt: skip
            changed = (display.rows, display.columns) != (view.shown.rows, view.shown.columns)
            view.display(display, fit=fit or changed)
        self._show_numbers()

    def _show_numbers(self) -> None:
        box, picked, second = self.box, self.session.picked, self.second
        of = len(box.names)
        for point, name, on in ((picked, self.first_name, self.first_on), (second, self.second_name, self.second_on)):
            name.setText(
                "Click a point on a shape"
                if point is None and point is picked
                else ""
                if point is None
                else box.describe(point)
            )
            on.setText("" if point is None else f"on {len(box.present_on(point))}")
        self.first_swatch.set_colour(tokens(self.session.theme)["accent"])
        self.second_swatch.setVisible(second is not None)
        self.first_swatch.setEnabled(picked is not None)
        measured = picked is not None and second is not None
        self.distance_box.setVisible(measured)
        self.no_distance.setVisible(not measured)
        self.distance_of.setText("")
        if measured:
            lengths = {name: 100 * length for name, length in box.distances(picked, second).items()}
            self._show_distances(lengths)
        low = [name for name in box.names if box.confidence(name, picked) < LOW]
        low = [n for n in low if picked is None or box.shape(n).existence[picked]]
        self.low_icon.setVisible(bool(low))
        self.low_title.setText(f"{len(low)} shape{'s' * (len(low) != 1)} below 50%" if low else "No shape below 50%")
        self.low_text.setText("Left and right may be mixed up, or the part differs. Paint a correction and fit again." if low
                              else f"The chance that the point lies within 5% of where it is shown, on {of} shapes.")  # fmt: skip
        chosen = len(self.session.selected)
        self.overlay_why.setText(
            "" if chosen == 2 else f"Select exactly two shapes first (Ctrl-click), {chosen or 'none'} selected."
        )
        self._show_cards()
        self.session.edit_count += 1  # what can be done depends on what is picked

    def _show_distances(self, lengths: dict[str, float]) -> None:
        values = np.array(list(lengths.values()))
        self.distance_of.setText(f"% of size, {len(values)} shapes")
        self.distance_box.setVisible(len(values) > 0)
        if not len(values):
            return
        here = lengths.get(self.session.shape or "")
        self.histogram.set_values(values, here)
        low, middle, high = np.percentile(values, (25, 50, 75))
        self.median.setText(f"{middle:.1f}%")
        self.middle.setText(f"{low:.1f}–{high:.1f}%")
        self.here.setText("–" if here is None else f"{here:.1f}%")

    # ---- the pointer ---------------------------------------------------------------------------------------------

    def _point(self, pick: Pick | None) -> int | None:
        if pick is None or self._overlaid or pick.view >= len(self.names):
            return None
        return self.box.point_at(self.names[pick.view], pick.position)

    def _click(self, pick: Pick | None, modifiers: Qt.KeyboardModifier) -> None:
        if self._overlaid or pick is None:
            return
        name = self.names[pick.view]
        if modifiers & Qt.KeyboardModifier.ControlModifier:
            chosen = self.session.selected
            self.session.selected = tuple(n for n in chosen if n != name) if name in chosen else (*chosen, name)
            return
        point = self._point(pick)
        if point is None:
            return
        self.session.shape = name
        if self.session.picked is None or self.second is not None:
            self.second = None
            if self.session.picked == point:
                self._show()
            self.session.picked = point
        else:
            self.second = point
            self._show()

    def _hover(self, pick: Pick | None) -> None:
        point = self._point(pick)
        if point != self.hovered:
            self.hovered = point
            if not self._hover_timer.isActive():
                self._hover_timer.start()

    def _show_hover(self) -> None:
        if self._overlaid or not self._entered or len(self.view.shown.views) != len(self.names):
            return
        shapes = (self.box.shape(name) for name in self.names)
        self.view.set_marks([self.box.marks(s, self.session.picked, self.second, self.hovered) for s in shapes])

    def _choose(self, pick: Pick | None) -> None:
        if pick is not None and pick.view < len(self.names):
            self.session.shape = self.names[pick.view]

    # ---- doing ---------------------------------------------------------------------------------------------------

    def _colour_chosen(self, value: str) -> None:
        self.colour_by = value
        self._show()

    def _sort_chosen(self, value: str) -> None:
        self.sort = value
        self.sorting.set_value(value)
        self._arrange()
        self._show()

    def _count_chosen(self, value: str) -> None:
        self.count = int(value)
        self._arrange()
        self._show()

    def _show_worst(self) -> None:
        self._sort_chosen("low")

    def _clear(self) -> None:
        self.second = None
        if self.session.picked is None:
            self._show()
        self.session.picked = None

    def _correct(self) -> None:
        if len(self.session.selected) == 1:
            self.session.shape = self.session.selected[0]
        self.session.place = "paint"

    def _toggle_overlay(self) -> None:
        self._overlaid = not self._overlaid
        self._show(fit=True)

    def _has_point(self, session: Session) -> tuple[bool, str]:
        return YES if session.picked is not None else (False, "Click a point on a shape first.")

    def _one_shape(self, session: Session) -> tuple[bool, str]:
        if session.running:
            return False, f"Wait until {session.stage or 'the present stage'} is done."
        return YES if session.shape is not None or len(session.selected) == 1 else (False, "Select a shape first.")

    def _two(self, session: Session) -> tuple[bool, str]:
        return YES if len(session.selected) == 2 else (False, "Select exactly two shapes first (Ctrl-click).")

    # ---- landmarks -----------------------------------------------------------------------------------------------

    def _has_landmarks(self, _session: Session) -> tuple[bool, str]:
        return YES if self.landmarks else (False, "Keep a landmark first.")

    def _file(self) -> Path:
        return Path(self.session.project.path) / "landmarks_kept.json"

    def _read_landmarks(self) -> list[dict[str, Any]]:
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
        kept = {"version": 1, "fit": self.session.project.fit_id, "landmarks": self.landmarks}
        _write(self._file(), json.dumps(kept, indent=1))

    def _keep(self) -> None:
        point = self.session.picked
        if all(mark["point"] != point for mark in self.landmarks):
            name, taken = self.box.describe(point), {mark["name"] for mark in self.landmarks}
            number = 2
            base = name
            while name in taken:
                name, number = f"{base} {number}", number + 1
            self.landmarks.append({"name": name, "point": int(point)})
            self._write_landmarks()
        self._show_numbers()

    def _show_cards(self) -> None:
        clear(self.cards)
        for mark in self.landmarks[:6]:
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
            card.clicked.connect(lambda mark=mark: self._recall(mark))
            card.set_current(mark["point"] == self.session.picked)
            card.setMaximumWidth(260)
            self.cards.addWidget(card, 1)
        if not self.landmarks:
            self.cards.addWidget(
                label("Pick a point and keep it: it is placed once and carried to every shape.", "off")
            )
        self.cards.addStretch(1)
        self.strip_count.setText(
            f"{len(self.landmarks)} placed once, carried to {len(self.box.names)} shapes" if self.landmarks else ""
        )
        refresh(self.strip, self.session.theme)

    def _recall(self, mark: dict[str, Any]) -> None:
        self.second = None
        self.session.picked = mark["point"]

    def _forget(self, mark: dict[str, Any]) -> None:
        self.landmarks.remove(mark)
        self._write_landmarks()
        self._show_numbers()

    def _export(self) -> None:
        path = self.actions.desk.choose_save("Save the landmarks", "landmarks.csv")
        if path is None:
            return
        project = self.session.project
        rows = [["shape", "landmark", "x", "y", "z", "confidence"]]
        for name in self.box.names:
            frame = project.shapes[list(project.names).index(name)].frame
            for mark in self.landmarks:
                position = self.box.shape(name).positions[mark["point"]]
                if np.isfinite(position).all():
                    sure = self.box.confidence(name, mark["point"])
                    rows.append([name, mark["name"], *(f"{x:.6g}" for x in frame.to_input(position)), f"{sure:.3f}"])
        with tempfile.NamedTemporaryFile("w", newline="", encoding="utf-8", dir=path.parent, delete=False) as file:
            csv.writer(file).writerows(rows)
        os.replace(file.name, path)
        self.session.say(f"{len(rows) - 1} points saved as {path.name}", "ok")


def _write(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", dir=path.parent, delete=False) as file:
        file.write(text)
    os.replace(file.name, path)


class _Ring(Swatch):
    """The hollow mark of the second point."""

    def __init__(self) -> None:
        super().__init__("#000000", size=12, disc=True)

    def paintEvent(self, event: QEvent) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(QColor(colours(self)["text"]), 1.8))
        painter.drawEllipse(QRectF(1.5, 1.5, 9, 9))
        painter.end()
