"""Pieces of the Synthesize place: one direction with its slider, and the map of the family."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QEvent, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPen
from PySide6.QtWidgets import QFrame, QWidget

from shapeforge.viewer.palette import group_colours
from shapeforge.viewer.qt.bars import RangeSlider
from shapeforge.viewer.qt.icons import set_icon
from shapeforge.viewer.qt.theme import colours, font
from shapeforge.viewer.qt.widgets import ElidedLabel, button, column, label, row


class DirectionRow(QFrame):
    """Name, value, slider over its histogram, lock, and what it moves."""

    moved = Signal(float)
    released = Signal()
    locked = Signal(bool)
    entered = Signal()
    left = Signal()

    def __init__(
        self, name: str, caption: str, low: float, high: float, histogram: np.ndarray, edges: np.ndarray
    ) -> None:
        super().__init__()
        self.setObjectName("row")
        self.slider = RangeSlider(low, high, histogram, edges)
        self.slider.setAccessibleName(name)
        self.slider.setToolTip(
            f"{name}\nBars: the shapes of the family.\nNotch: the shape by itself.\n"
            "Double-click resets, L locks,\narrow keys move it."
        )
        self.caption = ElidedLabel(caption, "caption")
        self.name, self.value = ElidedLabel(name, "strong"), label("0.0", "text2")
        self.lock = button(
            icon="unlock", kind="icon", tooltip="Keep this value when another shape is drawn", checkable=True
        )
        self.lock.setStyleSheet("min-width: 22px; max-width: 22px; min-height: 22px; max-height: 22px;")
        self.lock.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.lock.toggled.connect(self._lock)
        top = row(self.name, self.value, spacing=6)
        top.setStretch(0, 1)
        middle = row(self.slider, self.lock, spacing=4)
        middle.setStretch(0, 1)
        middle.setAlignment(self.lock, Qt.AlignmentFlag.AlignBottom)
        self.setLayout(column(top, middle, self.caption, spacing=1, margins=(16, 4, 16, 4)))
        self.slider.moved.connect(self.moved)
        self.slider.released.connect(self.released)
        self.slider.lock_wanted.connect(self.lock.toggle)
        self.setFixedHeight(84)

    def _lock(self, on: bool) -> None:
        self._show_lock(on)
        self.locked.emit(on)

    def _show_lock(self, on: bool) -> None:
        self.slider.set_locked(on)
        set_icon(self.lock, "lock" if on else "unlock", "accent_text" if on else "text_off", 14)

    def show_lock(self, on: bool) -> None:
        """Show whether it is locked, without telling."""
        if on != self.lock.isChecked():
            self.lock.blockSignals(True)
            self.lock.setChecked(on)
            self.lock.blockSignals(False)
            self._show_lock(on)

    def set_value(self, value: float, home: float) -> None:
        """Show a value in standard deviations, and where the shape stands by itself."""
        self.slider.set_value(value, home)
        self.value.setText("0" if abs(value) < 0.05 else f"{value:+.1f}".replace("-", "−"))

    def enterEvent(self, event: QEvent) -> None:
        self.entered.emit()

    def leaveEvent(self, event: QEvent) -> None:
        self.left.emit()


class FamilyMap(QWidget):
    """The family's shapes as dots in their groups' colours; where the shape in hand lies; a click takes a shape."""

    chosen = Signal(int)

    def __init__(self, height: int = 150) -> None:
        super().__init__()
        self.setFixedHeight(height)
        self.setMouseTracking(True)
        self.places = np.zeros((0, 2))
        self._group = np.zeros(0, int)
        self._names: tuple[str, ...] = ()
        self.here: tuple[float, float] | None = None
        self.ends: tuple[int, int] | None = None

    def set_family(self, places: np.ndarray, group: np.ndarray, names: tuple[str, ...]) -> None:
        """Places (T, 2) on the map, group (T,) and names of the shapes."""
        self.places, self._group, self._names = np.asarray(places, float), np.asarray(group, int), names
        self.update()

    def set_here(self, here: tuple[float, float] | None, ends: tuple[int, int] | None = None) -> None:
        """Where the shape in hand lies; ``ends`` are the shapes A and B when it is between two."""
        self.here, self.ends = here, ends
        self.update()

    def _to_pixels(self, places: np.ndarray) -> np.ndarray:
        if not len(self.places):
            return places
        low, high = self.places.min(axis=0), self.places.max(axis=0)
        size = np.array([self.width() - 44, self.height() - 40])
        scale = float((size / np.maximum(high - low, 1e-9)).min())
        middle = np.array([self.width(), self.height()]) / 2
        return middle + (places - (low + high) / 2) * [scale, -scale]

    def dot(self, index: int) -> tuple[float, float]:
        """Pixel place of a shape's dot."""
        x, y = self._to_pixels(self.places)[index]
        return float(x), float(y)

    def paintEvent(self, event: QEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(tokens["view"]))
        painter.drawRoundedRect(QRectF(self.rect()), 5, 5)
        palette = group_colours(int(self._group.max(initial=0)) + 1)
        pixels = self._to_pixels(self.places)
        for (x, y), g in zip(pixels, self._group, strict=True):
            painter.setBrush(QColor(*palette[g].tolist()) if g >= 0 else QColor(tokens["text_off"]))
            painter.drawEllipse(QPointF(x, y), 2.6, 2.6)
        if self.ends is not None:
            (ax, ay), (bx, by) = pixels[list(self.ends)]
            pen = QPen(QColor(tokens["text_2"]), 1, Qt.PenStyle.DashLine)
            painter.setPen(pen)
            painter.drawLine(QPointF(ax, ay), QPointF(bx, by))
            painter.setFont(font(11, 600))
            side = 1 if ax <= bx else -1  # each letter on the side away from the other end
            for x, y, name, way in ((ax, ay, "A", -side), (bx, by, "B", side)):
                painter.setPen(QPen(QColor(tokens["text"]), 1.6))
                painter.setBrush(QColor(tokens["view"]))
                painter.drawEllipse(QPointF(x, y), 4, 4)
                painter.drawText(QPointF(x + (8 if way > 0 else -16), y + 4), name)
        if self.here is not None and len(self.places):
            x, y = self._to_pixels(np.array(self.here))
            painter.setPen(QPen(QColor("#FFFFFF"), 1.6))
            painter.setBrush(QColor(tokens["accent"]))
            painter.drawEllipse(QPointF(x, y), 5, 5)
            painter.setPen(QColor(tokens["text"]))
            painter.setFont(font(11, 600))
            left = min(max(x - 50, 2), self.width() - 102)
            if self.ends is not None and np.linalg.norm(pixels[list(self.ends)] - (x, y), axis=1).min() < 40:
                return  # between two shapes close by, their letters say where
            painter.drawText(
                QRectF(left, y - 22 if y > 26 else y + 8, 100, 14), Qt.AlignmentFlag.AlignCenter, "you are here"
            )
        painter.end()

    def _at(self, event: QMouseEvent) -> int | None:
        if not len(self.places):
            return None
        here = np.array([event.position().x(), event.position().y()])
        away = np.linalg.norm(self._to_pixels(self.places) - here, axis=1)
        return int(away.argmin()) if away.min() < 14 else None

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        index = self._at(event)
        self.setToolTip("" if index is None else self._names[index])
        self.setCursor(Qt.CursorShape.ArrowCursor if index is None else Qt.CursorShape.PointingHandCursor)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        index = self._at(event)
        if index is not None:
            self.chosen.emit(index)
