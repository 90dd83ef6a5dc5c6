"""Small plots of the inspector: curves over the rounds, in the colours and the type of the window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QWidget

from shapeforge.viewer import palette
from shapeforge.viewer.qt.theme import font

HEIGHT = 110
LEFT, RIGHT, TOP, BOTTOM = 44, 8, 8, 24
"""Pixels around the plot: numbers of the value axis, room for the last dot, numbers of the other axis."""

PHASES = 14
"""Pixels above a plot for the names of its phases."""

Series = tuple[np.ndarray, np.ndarray, str]


class Curves(QWidget):
    """One or several curves over whole numbers, with a dotted line at the one looked at.

    Where another phase begins (``set_phase``) there is a line from top to bottom, and no curve goes across it.
    """

    def __init__(
        self, x_name: str = "round", *, from_zero: bool = False, height: int = HEIGHT, numbered: bool = True,
        phases: tuple[str, str] | None = None,
    ) -> None:  # fmt: skip
        """``from_zero`` keeps 0 in sight on the value axis; one that is not ``numbered`` stands above one that is.

        ``phases`` are what the curve is called before and after the line; they are written above it.
        """
        super().__init__()
        self._from_zero, self._numbered = from_zero, numbered
        self._phases = phases
        self._divider: float | None = None
        self._series: list[Series] = []
        self._at: float | None = None
        self._last = 10
        self._theme: palette.Theme = "dark"
        self._x_name = x_name
        self.setFixedHeight(height)

    def set_theme(self, theme: palette.Theme) -> None:
        """Draw in the colours of another theme."""
        self._theme = theme
        self.update()

    def set_series(
        self, series: Sequence[tuple[Sequence[float | int], Sequence[float], str]], last: int, at: float | None
    ) -> None:
        """``series`` are (x, y, "#RRGGBB"); ``last`` is the end of the x axis, ``at`` where the dotted line stands."""
        self._series = [(np.asarray(x, float), np.asarray(y, float), colour) for x, y, colour in series]
        self._last, self._at = max(last, 1), at
        self.update()

    def set_phase(self, after: int | None) -> None:
        """Another phase begins with the round after the round ``after``; None where there is but one."""
        self._divider = None if after is None else after + 0.5
        self.update()

    @property
    def values(self) -> list[np.ndarray]:
        """The y of every curve shown, for tests."""
        return [y for _, y, _ in self._series]

    def paintEvent(self, event: QPaintEvent) -> None:
        tokens = palette.tokens(self._theme)
        known = [y[np.isfinite(y)] for _, y, _ in self._series]
        flat = np.concatenate(known) if known else np.zeros(0)
        ticks = self._ticks(flat)
        top = TOP + (PHASES if self._phases and self._divider is not None else 0)
        box = QRectF(LEFT, top, self.width() - LEFT - RIGHT, self.height() - top - (BOTTOM if self._numbered else TOP))

        def place(x: float | int, y: float | int) -> QPointF:
            up = (y - ticks[0]) / (ticks[-1] - ticks[0])
            return QPointF(box.left() + box.width() * x / self._last, box.bottom() - box.height() * up)

        painter = QPainter(self)
        painter.setFont(font(11))
        middle, right = Qt.AlignmentFlag.AlignCenter, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        for tick in ticks:
            y = round(place(0, tick).y()) + 0.5  # on whole pixels a thin line is thin
            painter.setPen(QPen(QColor(tokens["separator"]), 1))
            painter.drawLine(QPointF(box.left(), y), QPointF(box.right(), y))
            if len(flat):
                painter.setPen(QColor(tokens["text_2"]))
                painter.drawText(QRectF(0, y - 8, LEFT - 8, 16), right, f"{tick:g}".replace("-", "−"))
        painter.setPen(QColor(tokens["text_2"]))
        for number in range(0, self._last + 1, max(1, int(np.ceil(self._last / 5)))) if self._numbered else ():
            painter.drawText(QRectF(place(number, 0).x() - 16, box.bottom() + 8, 32, 14), middle, str(number))
        if self._numbered:
            painter.drawText(QRectF(0, box.bottom() + 8, LEFT - 8, 14), right, self._x_name)
        if self._divider is not None:
            self._draw_divider(painter, box, round(place(self._divider, 0).x()) + 0.5)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self._at is not None and len(flat):
            painter.setPen(QPen(QColor(tokens["text_2"]), 1, Qt.PenStyle.DotLine))
            x = round(place(self._at, 0).x()) + 0.5
            painter.drawLine(QPointF(x, box.top()), QPointF(x, box.bottom()))
        for x, y, colour in self._series:
            there = np.flatnonzero(np.isfinite(y))
            if not len(there):
                continue
            for run in split_at(x, there, self._divider):
                points = [place(float(x[i]), float(y[i])) for i in run]
                painter.setPen(QPen(QColor(colour), 1.6))
                painter.setBrush(QColor(colour) if len(points) == 1 else Qt.BrushStyle.NoBrush)
                if len(points) == 1:  # a line has two ends
                    painter.drawEllipse(points[0], 1.6, 1.6)
                else:
                    painter.drawPolyline(QPolygonF(points))
            marked = there[-1] if self._at is None else there[np.abs(x[there] - self._at).argmin()]
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor(colour))
            painter.drawEllipse(place(float(x[marked]), float(y[marked])), 3.2, 3.2)
        painter.end()

    def _draw_divider(self, painter: QPainter, box: QRectF, x: float) -> None:
        """The line where another phase begins, and what each phase is called, as far as there is room for it."""
        tokens = palette.tokens(self._theme)
        painter.setPen(QPen(QColor(tokens["separator_strong"]), 1))
        painter.drawLine(QPointF(x, box.top() - (PHASES if self._phases else 0)), QPointF(x, box.bottom()))
        if self._phases is None:
            return
        before, after = self._phases
        y, wide = box.top() - PHASES - 2, painter.fontMetrics().horizontalAdvance
        painter.setPen(QColor(tokens["text_2"]))
        if wide(before) <= x - 6 - box.left():
            left = QRectF(box.left(), y, x - 6 - box.left(), PHASES)
            painter.drawText(left, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, before)
        start = min(x + 6, self.width() - wide(after))
        right = QRectF(start, y, wide(after) + 1, PHASES)
        painter.drawText(right, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, after)

    def _ticks(self, flat: np.ndarray) -> list[float]:
        low, high = (float(flat.min()), float(flat.max())) if len(flat) else (0.0, 1.0)
        if self._from_zero:
            low = min(low, 0.0)
        if high - low < 1e-9:
            high, low = high + 0.5, low - (0.0 if self._from_zero else 0.5)
        return nice_ticks(low, high)


def split_at(x: np.ndarray, there: np.ndarray, divider: float | None) -> list[np.ndarray]:
    """The places ``there`` among ``x``, in one piece or in those on either side of the ``divider``; none is empty."""
    if divider is None:
        return [there] if len(there) else []
    return [part for part in (there[x[there] < divider], there[x[there] >= divider]) if len(part)]


def nice_ticks(low: float, high: float, most: int = 4) -> list[float]:
    """At most ``most`` + 1 round numbers, evenly apart, that enclose low..high."""
    span = max(high - low, 1e-12)
    power = 10.0 ** np.floor(np.log10(span / most))
    step = next(s * power for s in (1, 2, 2.5, 5, 10, 20) if span / (s * power) <= most - 1 or s == 20)
    first = np.floor(low / step + 1e-9)
    last = np.ceil(high / step - 1e-9)
    return [float(round(i * step, 12)) for i in np.arange(first, max(last, first + 1) + 1)]
