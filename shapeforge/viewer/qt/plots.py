"""Small plots of the inspector: curves over the rounds, in the colours and the type of the window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QVBoxLayout, QWidget

from shapeforge.viewer import palette
from shapeforge.viewer.qt.theme import font

HEIGHT = 128


class Curves(QWidget):
    """One or several curves over whole numbers, with a dotted line at the one looked at."""

    def __init__(self, x_name: str = "round", *, from_zero: bool = False, height: int = HEIGHT) -> None:
        """``from_zero`` keeps 0 in sight on the value axis."""
        super().__init__()
        self._from_zero = from_zero
        self._series: list[tuple[np.ndarray, np.ndarray, str]] = []
        self._at: float | None = None
        self._last = 10
        self._theme: palette.Theme = "dark"
        self.plot = pg.PlotWidget(background=None)
        self.plot.setFixedHeight(height)
        self.plot.setFrameShape(self.plot.Shape.NoFrame)
        self.plot.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.plot.setStyleSheet("background: transparent;")
        item = self.plot.getPlotItem()
        item.hideButtons()
        item.setMenuEnabled(False)
        item.setMouseEnabled(False, False)
        item.layout.setContentsMargins(0, 2, 4, 0)
        self._x_name = x_name
        for side in ("left", "bottom"):
            axis = item.getAxis(side)
            axis.setStyle(tickFont=font(11), tickTextOffset=6, tickLength=0)
        item.getAxis("left").setWidth(34)
        item.getAxis("bottom").setHeight(32)
        box = QVBoxLayout(self)
        box.setContentsMargins(0, 0, 0, 0)
        box.addWidget(self.plot)

    def set_theme(self, theme: palette.Theme) -> None:
        """Draw in the colours of another theme."""
        self._theme = theme
        self._draw()

    def set_series(
        self, series: Sequence[tuple[Sequence[float | int], Sequence[float], str]], last: int, at: float | None
    ) -> None:
        """``series`` are (x, y, "#RRGGBB"); ``last`` is the end of the x axis, ``at`` where the dotted line stands."""
        self._series = [(np.asarray(x, float), np.asarray(y, float), colour) for x, y, colour in series]
        self._last, self._at = max(last, 1), at
        self._draw()

    @property
    def values(self) -> list[np.ndarray]:
        """The y of every curve shown, for tests."""
        return [y for _, y, _ in self._series]

    def _draw(self) -> None:
        tokens = palette.tokens(self._theme)
        item = self.plot.getPlotItem()
        item.clear()
        quiet, line = pg.mkColor(tokens["text_2"]), pg.mkPen(tokens["separator"])
        for side in ("left", "bottom"):
            axis = item.getAxis(side)
            axis.setPen(line)
            axis.setTextPen(quiet)
        item.getAxis("left").setPen(pg.mkPen(None))
        item.setLabel("bottom", self._x_name, **{"color": tokens["text_2"], "font-size": "11px"})
        known = [y[np.isfinite(y)] for _, y, _ in self._series]
        flat = np.concatenate(known) if known else np.zeros(0)
        low, high = (float(flat.min()), float(flat.max())) if len(flat) else (0.0, 1.0)
        if self._from_zero:
            low = min(low, 0.0)
        if high - low < 1e-9:
            high, low = high + 0.5, low - (0.0 if self._from_zero else 0.5)
        ticks = nice_ticks(low, high)
        for tick in ticks:
            item.addItem(pg.InfiniteLine(tick, angle=0, pen=line))
        item.getAxis("left").setTicks([[(tick, f"{tick:g}" if len(flat) else "") for tick in ticks]])
        step = max(1, int(np.ceil(self._last / 5)))
        item.getAxis("bottom").setTicks([[(i, str(i)) for i in range(0, self._last + 1, step)]])
        margin = 0.04 * (ticks[-1] - ticks[0])
        item.setYRange(ticks[0] - margin, ticks[-1] + margin, padding=0)
        item.setXRange(0, self._last, padding=0.02)
        if self._at is not None and len(flat):
            item.addItem(pg.InfiniteLine(self._at, pen=pg.mkPen(tokens["text_2"], style=Qt.PenStyle.DotLine)))
        for x, y, colour in self._series:
            there = np.isfinite(y)
            if there.any():
                item.plot(x[there], y[there], pen=pg.mkPen(colour, width=1.6), antialias=True)
                at = np.flatnonzero(there)
                if self._at is not None:
                    nearest = at[np.abs(x[at] - self._at).argmin()]
                    at = np.array([nearest])
                else:
                    at = at[-1:]
                item.plot(x[at], y[at], pen=None, symbol="o", symbolSize=6, symbolPen=None, symbolBrush=colour)


def nice_ticks(low: float, high: float, most: int = 4) -> list[float]:
    """At most ``most`` + 1 round numbers, evenly apart, that enclose low..high."""
    span = max(high - low, 1e-12)
    power = 10.0 ** np.floor(np.log10(span / most))
    step = next(s * power for s in (1, 2, 2.5, 5, 10, 20) if span / (s * power) <= most - 1 or s == 20)
    first = np.floor(low / step + 1e-9)
    last = np.ceil(high / step - 1e-9)
    return [float(round(i * step, 12)) for i in np.arange(first, max(last, first + 1) + 1)]
