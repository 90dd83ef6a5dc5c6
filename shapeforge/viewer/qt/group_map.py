"""The map of a collection: pictures placed by likeness inside the soft hulls of their groups; or in rows.

It shows what it is given (`MapContent`) and says what the user does; the choice itself lives in the Session.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, Qt, Signal
from PySide6.QtGui import (
    QContextMenuEvent,
    QHelpEvent,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPixmap,
    QPolygonF,
    QResizeEvent,
    QWheelEvent,
)
from PySide6.QtWidgets import QToolTip, QWidget

from shapeforge.viewer.layout import hull, place_by_likeness, place_in_rows
from shapeforge.viewer.qt.map_drawing import MapContent, MapDrawing
from shapeforge.viewer.qt.theme import colours

TILE = 74.0  # logical pixels of a tile at most when all of the map is seen
ROW_TILE = 104.0
ZOOM_LIMITS = (8.0, 320.0)  # pixels a tile
CLICK_SLACK = 4


class GroupMap(QWidget):
    """Wheel zooms, drag pans, a click selects, Shift-drag selects with a lasso, Enter opens."""

    clicked = Signal(str, bool)
    lassoed = Signal(tuple)
    opened = Signal(str)
    group_clicked = Signal(int)
    hovered = Signal(str)
    menu_wanted = Signal(str, int, QPoint)

    def __init__(
        self, picture: Callable[[str, int], QPixmap | None], about: Callable[[str], str], parent: QWidget | None = None
    ) -> None:
        """``picture(name, group)`` gives a shape's picture (None: to come), ``about(name)`` its hover card (HTML)."""
        super().__init__(parent)
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setObjectName("centre")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.picture, self._about = picture, about
        self.content = MapContent()
        self.rows = False
        self.lasso_always = False
        self.current: str | None = None
        self.selected: frozenset[str] = frozenset()
        self.current_group = -1
        self.place = np.zeros((0, 2))
        self.hulls: list[tuple[int, np.ndarray]] = []
        self.headings: list[tuple[int, float]] = []
        self.tile = TILE
        self.offset = QPointF()
        self._touched = False
        self.hover: int | None = None
        self._press: QPointF | None = None
        self._last = QPointF()
        self._moved = False
        self.lasso: list[QPointF] | None = None

    # -- content ---------------------------------------------------------------------------------------------------

    def set_content(self, content: MapContent, *, rows: bool | None = None) -> None:
        """Show other shapes or groups; where the user had zoomed or panned to is kept while the shapes are the same."""
        old = self.content
        same = content.names == old.names and (rows is None or rows == self.rows)
        alike = same and np.array_equal(content.group, old.group) and np.array_equal(content.embedding, old.embedding)
        self.content = content
        self.rows = self.rows if rows is None else rows
        if not (alike and content.grouped == old.grouped):
            self._arrange()
        if not (same and self._touched):
            self.fit()
        self.update()

    def set_selection(self, current: str | None, selected: tuple[str, ...], current_group: int) -> None:
        """Show another selection."""
        self.current, self.selected, self.current_group = current, frozenset(selected), current_group
        self.update()

    def _arrange(self) -> None:
        content = self.content
        self.hulls, self.headings = [], []
        if not len(content.names):
            self.place = np.zeros((0, 2))
        elif self.rows or not content.grouped:
            columns = max(int((self.width() - 32) // ROW_TILE), 1)
            self.place, self.headings = place_in_rows(content.group, columns)
        else:
            self.place = place_by_likeness(content.embedding, content.group)
            for g in range(len(content.exemplars)):
                self.hulls.append((g, hull(self.place[content.group == g])))

    def fit(self) -> None:
        """Show all of it (in rows: the top)."""
        self._touched = False
        if self.rows or not self.content.grouped:
            self.tile, self.offset = ROW_TILE, QPointF(16, 8)
            self.update()
            return
        if not len(self.place):
            return
        edges = np.concatenate([self.place - 0.5, self.place + 0.5, *(corners for _, corners in self.hulls)])
        low, high = edges.min(axis=0), edges.max(axis=0)
        # Space for the names above the hulls.
        size = (max(self.width() - 56, 80), max(self.height() - 64, 80))
        self.tile = float(np.clip(min(size[0] / (high[0] - low[0]), size[1] / (high[1] - low[1])), 4, TILE * 1.6))
        middle = (low + high) / 2 * self.tile
        self.offset = QPointF(self.width() / 2 - middle[0], self.height() / 2 + 10 - middle[1])
        self.update()

    def at(self, index: int) -> QPointF:
        """Where the picture's centre is, in pixels of the widget."""
        x, y = self.place[index] * self.tile
        return self.offset + QPointF(x, y)

    def name_at(self, position: QPointF) -> str | None:
        """The shape whose picture is at a place of the widget."""
        index = self._index_at(position)
        return None if index is None else self.content.names[index]

    def _index_at(self, position: QPointF) -> int | None:
        if not len(self.place):
            return None
        at = np.array([position.x() - self.offset.x(), position.y() - self.offset.y()]) / self.tile
        away = np.abs(self.place - at).max(axis=1)
        best = int(away.argmin())
        return best if away[best] <= 0.5 else None

    def paintEvent(self, event: QPaintEvent) -> None:
        MapDrawing(self, QPainter(self), colours(self)).draw()

    # -- mouse and keys --------------------------------------------------------------------------------------------

    def wheelEvent(self, event: QWheelEvent) -> None:
        steps = event.angleDelta().y() / 120
        if (self.rows or not self.content.grouped) and not event.modifiers() & Qt.KeyboardModifier.ControlModifier:
            self._pan(QPointF(0, steps * 64))
            return
        factor = 1.18**steps
        new = float(np.clip(self.tile * factor, *ZOOM_LIMITS))
        share = new / self.tile
        at = event.position()
        self.offset = at + (self.offset - at) * share
        self.tile = new
        self._touched = True
        self.update()

    def _pan(self, by: QPointF) -> None:
        self.offset += by
        self._touched = True
        if self.rows or not self.content.grouped:
            bottom = (float(self.place[:, 1].max(initial=0)) + 0.8) * self.tile
            self.offset.setX(16)
            self.offset.setY(min(8.0, max(self.offset.y(), self.height() - bottom)))
        self.update()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._press = self._last = event.position()
        self._moved = False
        lasso = self.lasso_always != bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
        if event.button() == Qt.MouseButton.LeftButton and lasso:
            self.lasso = [event.position()]

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        at = event.position()
        if self._press is None:
            index = self._index_at(at)
            if index != self.hover:
                self.hover = index
                self.hovered.emit("" if index is None else self.content.names[index])
                self.update()
            return
        self._moved |= (at - self._press).manhattanLength() > CLICK_SLACK
        if self._moved and self.lasso is not None:
            self.lasso.append(at)
            self.update()
        elif self._moved:
            self._pan(at - self._last)
        self._last = at

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        press, self._press = self._press, None
        lasso, self.lasso = self.lasso, None
        if press is None:
            return
        if lasso is not None and self._moved:
            polygon = QPolygonF(lasso)
            inside = [i for i in range(len(self.place)) if polygon.containsPoint(self.at(i), Qt.FillRule.OddEvenFill)]
            self.lassoed.emit(tuple(self.content.names[i] for i in inside))
        elif not self._moved and event.button() == Qt.MouseButton.LeftButton:
            name = self.name_at(event.position())
            if name is not None:
                self.clicked.emit(name, bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier))
            else:
                self.group_clicked.emit(self._group_at(event.position()))
        self.update()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        name = self.name_at(event.position())
        if name is not None:
            self.opened.emit(name)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.reason() == QContextMenuEvent.Reason.Keyboard and self.current in self.content.names:
            at = self.at(self.content.names.index(self.current))
            self.menu_wanted.emit(self.current, -1, self.mapToGlobal(at.toPoint()))
        else:
            at = QPointF(event.pos())
            self.menu_wanted.emit(self.name_at(at) or "", self._group_at(at), event.globalPos())

    def leaveEvent(self, event: QEvent) -> None:
        self.hover = None
        self.hovered.emit("")
        self.update()

    def _group_at(self, position: QPointF) -> int:
        for g, corners in self.hulls:
            polygon = QPolygonF([self.offset + QPointF(*(corner * self.tile)) for corner in corners])
            if polygon.containsPoint(position, Qt.FillRule.OddEvenFill):
                return g
        return -1

    def keyPressEvent(self, event: QKeyEvent) -> None:
        step = {Qt.Key.Key_Left: (-1, 0), Qt.Key.Key_Right: (1, 0), Qt.Key.Key_Up: (0, -1), Qt.Key.Key_Down: (0, 1)}
        if event.key() in step and len(self.place):
            self._go(np.array(step[event.key()], float))
        elif event.key() == Qt.Key.Key_Home:
            self.fit()
        else:
            super().keyPressEvent(event)

    def _go(self, towards: np.ndarray) -> None:
        """Select the next shape in a direction."""
        if self.current not in self.content.names:
            self.clicked.emit(self.content.names[0], False)
            return
        away = self.place - self.place[self.content.names.index(self.current)]
        ahead = away @ towards
        aside = np.abs(away @ towards[::-1])
        cost = np.where(ahead > 0.2, ahead + 2 * aside, np.inf)
        if np.isfinite(cost).any():
            self.clicked.emit(self.content.names[int(cost.argmin())], False)

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            name = self.name_at(QPointF(event.pos()))
            if name is None:
                QToolTip.hideText()
            else:
                box = QRect(event.pos() - QPoint(8, 8), event.pos() + QPoint(8, 8))
                QToolTip.showText(event.globalPos() + QPoint(8, 4), self._about(name), self, box)
            return True
        return super().event(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self.rows or not self.content.grouped:
            self._arrange()
        if not self._touched:
            self.fit()
