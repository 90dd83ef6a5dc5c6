"""Small painted widgets: a histogram with one bar marked, the ramp of heat, a slider above its histogram."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QEvent, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QLinearGradient, QMouseEvent, QPainter, QPen
from PySide6.QtWidgets import QWidget

from shapeforge.viewer.palette import HEAT, mix
from shapeforge.viewer.qt.theme import colours, font


class Histogram(QWidget):
    """How often values occur; the bar that holds ``here`` is marked.  The axis carries round numbers."""

    def __init__(self, height: int = 112) -> None:
        super().__init__()
        self._values = np.zeros(0)
        self._here: float | None = None
        self.setFixedHeight(height)

    def set_values(self, values: np.ndarray, here: float | None = None) -> None:
        """Show the distribution of ``values``; ``here`` is the value to mark."""
        self._values = np.asarray(values, float)
        self._here = here
        self.update()

    def paintEvent(self, event: QEvent) -> None:
        if not len(self._values):
            return
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setFont(font(11))
        low, high = float(self._values.min()), float(self._values.max())
        step = _round_step((high - low) / 12 if high > low else 0.5)
        first = np.floor(low / step) * step
        count = max(int(np.ceil((high - first) / step + 1e-9)), 1)
        edges = first + step * np.arange(count + 1)
        counts, _ = np.histogram(self._values, edges)
        bottom, top = self.height() - 20, 16
        left, width = 4.0, self.width() - 8.0
        bar = width / count
        marked = -1 if self._here is None else int(np.clip((self._here - first) / step, 0, count - 1))
        for i, n in enumerate(counts):
            high_bar = (bottom - top) * n / max(counts.max(), 1)
            place = QRectF(left + i * bar + 1, bottom - high_bar, max(bar - 2, 1), high_bar)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(
                QColor(tokens["accent"] if i == marked else mix(tokens["accent"], tokens["separator_strong"], 0.22))
            )
            painter.drawRoundedRect(place, 1.5, 1.5)
            if n and (i == marked or n == counts.max() and marked not in np.flatnonzero(counts == n)):
                painter.setPen(QColor(tokens["text_2"]))
                painter.drawText(
                    QRectF(place.center().x() - 20, place.top() - 15, 40, 14), Qt.AlignmentFlag.AlignCenter, str(n)
                )
        painter.setPen(QPen(QColor(tokens["separator_strong"]), 1))
        painter.drawLine(QPointF(left, bottom + 0.5), QPointF(left + width, bottom + 0.5))
        painter.setPen(QColor(tokens["text_2"]))
        every = max(int(np.ceil(count / 5)), 1)
        for i in range(0, count + 1, every):
            x = left + i * bar
            words = f"{edges[i]:g}" if step >= 1 else f"{edges[i]:.1f}"
            x = min(max(x, 12.0), self.width() - 12.0)
            painter.drawText(QRectF(x - 24, bottom + 4, 48, 14), Qt.AlignmentFlag.AlignCenter, words)
        painter.end()


def _round_step(step: float) -> float:
    """The round number (1, 2 or 5 times a power of ten) next above ``step``."""
    power = 10.0 ** np.floor(np.log10(max(step, 1e-9)))
    return float(next(power * m for m in (1, 2, 5, 10) if power * m >= step * (1 - 1e-9)))


class HeatRamp(QWidget):
    """The colours of heat from nothing to all."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedHeight(10)

    def paintEvent(self, event: QEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ramp = QLinearGradient(0, 0, self.width(), 0)
        for i, colour in enumerate(HEAT):
            ramp.setColorAt(i / (len(HEAT) - 1), QColor(colour))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(ramp)
        painter.drawRoundedRect(QRectF(self.rect()), 3, 3)
        painter.end()


class RangeSlider(QWidget):
    """A slider under the distribution of the data; the accent runs from where the shape stands by itself (``home``, a
    notch) to the handle.

    ``moved`` while dragging, ``released`` once at the end.  Arrow keys move by a fiftieth, Home and double-click reset,
    L locks.
    """

    moved = Signal(float)
    released = Signal()
    lock_wanted = Signal()
    MARGIN = 8

    def __init__(self, low: float, high: float, histogram: np.ndarray, edges: np.ndarray) -> None:
        super().__init__()
        span = max(high - low, 1e-9)
        self.low, self.high = low - 0.25 * span, high + 0.25 * span  # a little beyond the data may be asked for
        self.inner = (low, high)
        self._histogram, self._edges = np.asarray(histogram, float), np.asarray(edges, float)
        self.value = self.home = 0.0
        self.locked = False
        self.is_dragged = False
        self.setFixedHeight(40)
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)

    def set_value(self, value: float, home: float | None = None) -> None:
        """Show a value (of the data's unit) and its new ``home``, if any; both cut to the slider's range."""
        if home is not None:
            self.home = float(min(max(home, self.low), self.high))
        self.value = float(min(max(value, self.low), self.high))
        self.update()

    def set_locked(self, locked: bool) -> None:
        """A locked slider keeps its value, whatever is drawn."""
        self.locked = locked
        self.update()

    def x_of(self, value: float) -> float:
        """Place of a value along the widget (pixels)."""
        share = (value - self.low) / (self.high - self.low)
        return self.MARGIN + share * (self.width() - 2 * self.MARGIN)

    def _value_at(self, x: float) -> float:
        share = (x - self.MARGIN) / max(self.width() - 2 * self.MARGIN, 1)
        value = self.low + min(max(share, 0.0), 1.0) * (self.high - self.low)
        return self.home if abs(self.x_of(value) - self.x_of(self.home)) < 3 else value  # it is easy to find again

    def paintEvent(self, event: QEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        groove = self.height() - 10.0
        active = self.is_dragged or self.underMouse()
        tallest = max(float(self._histogram.max(initial=0)), 1.0)
        painter.setBrush(QColor(tokens["accent" if active and not self.locked else "separator_strong"]))
        painter.setOpacity(0.75)
        for count, a, b in zip(self._histogram, self._edges[:-1], self._edges[1:], strict=True):
            left, right = max(self.x_of(a), self.MARGIN), min(self.x_of(b), self.width() - self.MARGIN)
            tall = (groove - 6) * count / tallest
            if right > left and count:
                painter.drawRect(QRectF(left + 0.5, groove - 3 - tall, max(right - left - 1, 1), tall))
        painter.setOpacity(1)
        painter.setBrush(QColor(tokens["separator_strong"]))
        painter.drawRoundedRect(QRectF(self.MARGIN, groove - 1.5, self.width() - 2 * self.MARGIN, 3), 1.5, 1.5)
        home, here = self.x_of(self.home), self.x_of(self.value)
        painter.setBrush(QColor(tokens["text_off" if self.locked or not self.isEnabled() else "accent"]))
        painter.drawRect(QRectF(min(home, here), groove - 1.5, abs(here - home), 3))
        painter.drawRect(QRectF(home - 0.75, groove - 4.5, 1.5, 9))
        painter.setBrush(QColor(tokens["text_off"] if self.locked or not self.isEnabled() else "#FFFFFF"))
        painter.setPen(QPen(QColor(tokens["accent"] if self.hasFocus() else tokens["text_off"]), 1.2))
        painter.drawEllipse(QPointF(here, groove), 6.5, 6.5)
        painter.end()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and not self.locked:
            self.is_dragged = True
            self._move(self._value_at(event.position().x()))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self.is_dragged:
            self._move(self._value_at(event.position().x()))

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if self.is_dragged:
            self.is_dragged = False
            self.update()
            self.released.emit()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        self._reset()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        steps = {Qt.Key.Key_Left: -1, Qt.Key.Key_Down: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Up: 1}
        if event.key() in steps and not self.locked:
            self._move(self.value + steps[event.key()] * (self.inner[1] - self.inner[0]) / 50)
            self.released.emit()
        elif event.key() == Qt.Key.Key_Home:
            self._reset()
        elif event.key() == Qt.Key.Key_L:
            self.lock_wanted.emit()
        else:
            super().keyPressEvent(event)

    def _reset(self) -> None:
        if not self.locked:
            self.is_dragged = False
            self._move(self.home)
            self.released.emit()

    def _move(self, value: float) -> None:
        self.set_value(value)
        self.moved.emit(self.value)
