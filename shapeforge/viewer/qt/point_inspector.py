"""The inspector of the Correspondence place: the picked points, what they measure, how sure they are."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QEvent, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPen
from PySide6.QtWidgets import QBoxLayout, QFrame, QWidget

from shapeforge.collection.counts import counted
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.fuzzy import MOST_SHARE
from shapeforge.viewer.lightbox import FARTHEST, FULL_PART_BITS, Lightbox
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.qt.bars import HeatRamp, Histogram
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.overlay import LOW_CONFIDENCE
from shapeforge.viewer.qt.stale_note import stale_note
from shapeforge.viewer.qt.theme import colours
from shapeforge.viewer.qt.widgets import ElidedLabel, Swatch, column, framed, icon_label, label, row, scrolled, section
from shapeforge.viewer.session import Session

LEGENDS: dict[str, tuple[str, tuple[str, str, str], str]] = {
    "spread": ("How sure is the point", ("not here", "chance of the point", "surely here"), ""),
    "entropy": (
        "How sure is each place", ("one point", "entropy", f"{100 * MOST_SHARE:g}% of points"),
        f"Entropy of which template point a place is, up to where {100 * MOST_SHARE:g}% of all are as likely.",
    ),
    "part_entropy": (
        "How sure is the part", ("sure", "bits", f"{FULL_PART_BITS:g} or more"),
        "Entropy of which part a face is of: at 1 bit two are as likely.",
    ),
    "part": ("Parts", ("", "", ""), "The parts of the fit, in the colours of the palette."),
    "coordinate": (
        "Template coordinate", ("", "", ""), "Like colours are the same place of the template: x red, y green, z blue."
    ),
    "distance": ("Distance of the surfaces", ("0%", "of size", f"{100 * FARTHEST:g}% or more"), ""),
}  # fmt: skip
"""What the colours mean: a title, the ends and the middle of the ramp of heat (none: no ramp), a sentence."""


class PointInspector(QFrame):
    """Shows; the place decides."""

    def __init__(self, session: Session, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.session = session
        stale = stale_note(actions, binding, "fit", "go_fit", "Fit again")
        body = scrolled(
            stale, self._make_picked(actions, binding), self._make_distance(), self._make_sureness(actions, binding)
        )
        inside = column(body, self._make_foot(actions, binding), spacing=0)
        inside.setStretch(0, 1)
        self.setLayout(inside)

    def _make_picked(self, actions: Actions, binding: Binding) -> QWidget:
        clear_link = action_button(actions, "clear_points", binding, kind="link", icon=False)
        self.first_name, self.first_on = ElidedLabel("", "strong"), label("", "text2")
        self.second_name, self.second_on = ElidedLabel("", "strong"), label("", "text2")
        self.first_swatch, self.second_swatch = Swatch("#4F8CFF", size=12, disc=True), _Ring()
        keep = action_button(actions, "keep_landmark", binding)
        return section(
            row(label("Picked points", "heading"), None, clear_link),
            *self._point_rows(), keep, spacing=10,
        )  # fmt: skip

    def _make_distance(self) -> QWidget:
        self.histogram = Histogram()
        self.distance_of = label("", "caption")
        self.median, self.middle, self.here = label("", "strong"), label("", "strong"), label("", "strong")
        numbers = row(
            column(label("median", "caption"), self.median, spacing=2), None,
            column(label("middle half", "caption"), self.middle, spacing=2), None,
            column(label("here", "caption"), self.here, spacing=2),
        )  # fmt: skip
        self.no_distance = label("Click a second point to measure on every shape.", "caption", wrap=True)
        self.distance_box = QWidget()
        self.distance_box.setLayout(column(self.histogram, numbers, spacing=6))
        title = row(label("Distance", "heading"), None, self.distance_of)
        return section(title, self.no_distance, self.distance_box)

    def _make_sureness(self, actions: Actions, binding: Binding) -> QWidget:
        self.low_title, self.low_text = label("", "strong"), label("", "caption", wrap=True)
        self.low_icon = icon_label("warning", "error", 16)
        low = row(self.low_icon, column(self.low_title, self.low_text, spacing=2), spacing=8)
        low.setAlignment(self.low_icon, Qt.AlignmentFlag.AlignTop)
        low.setStretch(1, 1)
        buttons = row(action_button(actions, "show_worst", binding, icon=False),
                      action_button(actions, "correct_here", binding))  # fmt: skip
        buttons.setStretch(0, 1)
        buttons.setStretch(1, 1)
        self.ramp = HeatRamp()
        self.legend_title = label("", "heading")
        self.legend = (label("", "caption"), label("", "caption"), label("", "caption"))
        self.legend_text = label("", "caption", wrap=True)
        ends = row(self.legend[0], None, self.legend[1], None, self.legend[2])
        return section(self.legend_title, self.ramp, ends, self.legend_text, 4, low, 4, buttons, line=False)

    def _make_foot(self, actions: Actions, binding: Binding) -> QFrame:
        self.overlay = action_button(actions, "overlay", binding)
        self.overlay_why = label("", "caption", wrap=True)
        inside = column(
            label("Compare", "heading"), self.overlay, self.overlay_why, spacing=8, margins=(16, 12, 16, 16)
        )
        return framed(inside, "bar")

    def _point_rows(self) -> tuple[QBoxLayout, ...]:
        rows = (
            row(self.first_swatch, 4, self.first_name, self.first_on),
            row(self.second_swatch, 4, self.second_name, self.second_on),
        )
        for one in rows:
            one.setStretch(2, 1)
        return rows

    def show_legend(self, colour_by: str, waiting: bool = False) -> None:
        """Say what the colours mean: COLOURS of the place, or "distance" of two overlaid shapes.

        ``waiting``: it is what is shown as long as no point is picked.
        """
        title, ends, text = LEGENDS[colour_by]
        if waiting:
            text = "Until a point is picked: the parts. Then: where on each shape it may lie."
        self.legend_title.setText(title)
        for one, words in zip(self.legend, ends, strict=True):
            one.setText(words)
            one.setVisible(bool(ends[0]))
        self.ramp.setVisible(bool(ends[0]))
        self.legend_text.setText(text)
        self.legend_text.setVisible(bool(text))

    def show_points(self, box: Lightbox, second: int | None) -> None:
        """Show the picked points of the session and ``second``, what they measure and how sure they are."""
        picked = self.session.picked
        for point, name, on in ((picked, self.first_name, self.first_on), (second, self.second_name, self.second_on)):
            hint = "Click a point on a shape" if name is self.first_name else ""
            name.setText(hint if point is None else box.describe(point))
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
        present = [name for name in box.names if name not in set(box.unread)]
        of = len(present)
        present = present if picked is None else box.present_on(picked)
        low = [name for name in present if box.confidence(name, picked) < LOW_CONFIDENCE]
        self.low_icon.setVisible(bool(low))
        self.low_title.setText(f"{counted(len(low), 'shape')} below 50%" if low else "No shape below 50%")
        doubt = "Left and right may be mixed up, or the part differs. Paint a correction and fit again."
        which = "the point" if picked is not None else "a point, in the mean over all,"
        meaning = f"The chance that {which} lies within 5% of where it is shown, on {counted(of, 'shape')}."
        self.low_text.setText(doubt if low else meaning)
        chosen = len(self.session.selected)
        self.overlay_why.setText(
            "" if chosen == 2 else f"Select exactly two shapes first (Ctrl-click, or S), {chosen or 'none'} selected."
        )

    def _show_distances(self, lengths: dict[str, float]) -> None:
        values = np.array(list(lengths.values()))
        self.distance_of.setText(f"% of size, {counted(len(values), 'shape')}")
        self.distance_box.setVisible(len(values) > 0)
        if not len(values):
            return
        here = lengths.get(self.session.shape or "")
        self.histogram.set_values(values, here)
        low, middle, high = np.percentile(values, (25, 50, 75))
        self.median.setText(f"{middle:.1f}%")
        self.middle.setText(f"{low:.1f}–{high:.1f}%")
        self.here.setText("–" if here is None else f"{here:.1f}%")


class _Ring(Swatch):
    """The hollow mark of the second point."""

    def __init__(self) -> None:
        super().__init__("#000000", size=12, disc=True)

    def paintEvent(self, event: QEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(QColor(colours(self)["text"]), 1.8))
        painter.drawEllipse(QRectF(1.5, 1.5, 9, 9))
        painter.end()
