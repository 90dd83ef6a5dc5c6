"""The list of pins in the Synthesize inspector: what is held, how far off the shape is, and a way to take it away."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from PySide6.QtCore import QEvent, Qt, Signal
from PySide6.QtWidgets import QApplication, QFrame, QWidget

from shapeforge.viewer.actions import Actions
from shapeforge.viewer.palette import as_hex
from shapeforge.viewer.pulling import MET, off_by
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.widgets import Swatch, button, clear, column, label, row, section, set_style
from shapeforge.viewer.sculptor import Sculptor

OUT_OF_REACH = ".\nThe family has no shape that reaches it together with all else that is asked for."


class PinRow(QFrame):
    """One pin: its part, how far off the point is, and a button that takes it away."""

    entered = Signal()
    left = Signal()

    def __init__(self, name: str, colour: str) -> None:
        super().__init__()
        self.setObjectName("row")
        self.off = label("", "caption")
        self.away = button(icon="close", kind="icon", tooltip="Take this pin away")
        self.away.setFocusPolicy(Qt.FocusPolicy.TabFocus)  # a click leaves the keys with the view
        self.away.setAccessibleName(f"Take the pin of the {name} away")
        self.setLayout(row(Swatch(colour), 2, label(name), None, self.off, self.away, spacing=6))
        self.setFixedHeight(26)

    def show_distance(self, distance: float) -> None:
        """Show how far (diagonals) the point is from where it is held."""
        reached = distance <= MET
        self.off.setText(f"{100 * distance:.1f}% off")
        set_style(self.off, "role", "caption" if reached else "caption_warning")
        self.off.setToolTip(f"of the shape's size from where it is held{'' if reached else OUT_OF_REACH}")

    def enterEvent(self, event: QEvent) -> None:
        self.entered.emit()

    def leaveEvent(self, event: QEvent) -> None:
        self.left.emit()


class PinSection(QWidget):
    """The pins of the shape in hand; out of sight while there are none."""

    pointed = Signal(object)
    unpinned = Signal(int)
    focus_lost = Signal()

    def __init__(self, sculptor: Sculptor, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self._sculptor = sculptor
        self.count = label("", "off")
        self.rows: dict[int, PinRow] = {}
        self._rows = column(spacing=0)
        away = action_button(actions, "unpin_all", binding, kind="link", icon=False)
        head = row(label("Pins", "heading"), self.count, None, away)
        self.unlike = label("", "caption", wrap=True)
        self.setLayout(column(section(head, self._rows, self.unlike), spacing=0))
        self.setVisible(False)

    def show_pins(self, points: Float[np.ndarray, "K 3"]) -> None:
        """Show the pins of the shape in hand, which has these points."""
        sculptor, focus = self._sculptor, QApplication.focusWidget()
        pins = sculptor.pinned()
        others = sorted(pins) != sorted(self.rows)
        if others and focus is not None and self.isAncestorOf(focus):
            self.focus_lost.emit()  # it may be gone in a moment, and Qt would give the keys to whatever comes next
        if others:
            self._fill(sorted(pins))
        for point, place in pins.items():
            self.rows[point].show_distance(off_by(points, point, place))
        unlike = [name for name, on in zip(sculptor.part_names, sculptor.symmetric(), strict=True) if not on]
        self.unlike.setText(f"Pinned unlike on both sides, so not made symmetric: {', '.join(unlike)}.")
        self.unlike.setVisible(bool(unlike))
        self.count.setText(str(len(pins)))
        self.setVisible(bool(pins))

    def _fill(self, points: list[int]) -> None:
        clear(self._rows)
        self.rows, seen = {}, {}
        for point in points:
            part = int(self._sculptor.part[point])
            seen[part] = seen.get(part, 0) + 1
            name = self._sculptor.part_names[part] + (f" {seen[part]}" if seen[part] > 1 else "")
            one = PinRow(name, as_hex(self._sculptor.inks[part]))
            one.away.clicked.connect(lambda _=False, point=point: self.unpinned.emit(point))
            one.entered.connect(lambda point=point: self.pointed.emit(point))
            one.left.connect(lambda: self.pointed.emit(None))
            self._rows.addWidget(one)
            one.show()
            self.rows[point] = one
