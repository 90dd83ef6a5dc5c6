"""The map of a collection: pictures placed by likeness inside the soft hulls of their groups; or in rows.

It shows what it is given (`MapContent`) and says what the user does; the choice itself lives in the Session.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QContextMenuEvent,
    QFontMetricsF,
    QHelpEvent,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
    QWheelEvent,
)
from PySide6.QtWidgets import QToolTip, QWidget

from shapeforge.viewer.layout import hull, place_by_likeness, place_in_rows
from shapeforge.viewer.palette import SWITCHED_OFF, group_colours
from shapeforge.viewer.qt import icons
from shapeforge.viewer.qt.theme import colours, font

TILE = 74.0  # logical pixels of a tile at most when all of the map is seen
ROW_TILE = 104.0
ZOOM_LIMITS = (8.0, 320.0)  # pixels a tile
DOT_BELOW = 20.0  # pixels a tile below which pictures become dots
CLICK_SLACK = 4


@dataclass(frozen=True, eq=False)
class MapContent:
    """What the map shows: names (T), group (T,) with -1 left out, exemplars (G,), embedding (T, 2)."""

    names: tuple[str, ...] = ()
    group: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    exemplars: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    embedding: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    group_names: tuple[str, ...] = ()
    grouped: bool = False


def group_colour(g: int, count: int) -> str:
    """Colour "#RRGGBB" of group ``g``; grey for shapes left out."""
    if g < 0:
        return SWITCHED_OFF
    return "#{:02X}{:02X}{:02X}".format(*group_colours(max(count, g + 1))[g])


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
        self._picture, self._about = picture, about
        self.content = MapContent()
        self.rows = False
        self.lasso_always = False
        self.current: str | None = None
        self.selected: frozenset[str] = frozenset()
        self.current_group = -1
        self.place = np.zeros((0, 2))
        self._hulls: list[tuple[int, np.ndarray]] = []
        self._headings: list[tuple[int, float]] = []
        self._tile = TILE
        self._offset = QPointF()
        self._touched = False
        self._hover: int | None = None
        self._press: QPointF | None = None
        self._last = QPointF()
        self._moved = False
        self._lasso: list[QPointF] | None = None

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
        self._hulls, self._headings = [], []
        if not len(content.names):
            self.place = np.zeros((0, 2))
        elif self.rows or not content.grouped:
            columns = max(int((self.width() - 32) // ROW_TILE), 1)
            self.place, self._headings = place_in_rows(content.group, columns)
        else:
            self.place = place_by_likeness(content.embedding, content.group)
            for g in range(len(content.exemplars)):
                self._hulls.append((g, hull(self.place[content.group == g])))

    def fit(self) -> None:
        """Show all of it (in rows: the top)."""
        self._touched = False
        if self.rows or not self.content.grouped:
            self._tile, self._offset = ROW_TILE, QPointF(16, 8)
            self.update()
            return
        if not len(self.place):
            return
        edges = np.concatenate([self.place - 0.5, self.place + 0.5, *(corners for _, corners in self._hulls)])
        low, high = edges.min(axis=0), edges.max(axis=0)
        # Space for the names above the hulls.
        size = (max(self.width() - 56, 80), max(self.height() - 64, 80))
        self._tile = float(np.clip(min(size[0] / (high[0] - low[0]), size[1] / (high[1] - low[1])), 4, TILE * 1.6))
        middle = (low + high) / 2 * self._tile
        self._offset = QPointF(self.width() / 2 - middle[0], self.height() / 2 + 10 - middle[1])
        self.update()

    def at(self, index: int) -> QPointF:
        """Where the picture's centre is, in pixels of the widget."""
        x, y = self.place[index] * self._tile
        return self._offset + QPointF(x, y)

    def name_at(self, position: QPointF) -> str | None:
        """The shape whose picture is at a place of the widget."""
        index = self._index_at(position)
        return None if index is None else self.content.names[index]

    def _index_at(self, position: QPointF) -> int | None:
        if not len(self.place):
            return None
        at = np.array([position.x() - self._offset.x(), position.y() - self._offset.y()]) / self._tile
        away = np.abs(self.place - at).max(axis=1)
        best = int(away.argmin())
        return best if away[best] <= 0.5 else None

    # -- painting --------------------------------------------------------------------------------------------------

    def paintEvent(self, event: QPaintEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
        painter.fillRect(self.rect(), QColor(tokens["view"]))
        self._paint_hulls(painter, tokens)
        self._paint_headings(painter, tokens)
        seen = QRectF(self.rect()).adjusted(-self._tile, -self._tile, self._tile, self._tile)
        exemplars = set(self.content.exemplars.tolist()) if self.content.grouped else set()
        for index in range(len(self.place)):
            if seen.contains(self.at(index)):
                self._paint_shape(painter, tokens, index, index in exemplars)
        if self._lasso:
            painter.setPen(QPen(QColor(tokens["accent"]), 1.2, Qt.PenStyle.DashLine))
            ground = QColor(tokens["accent"])
            ground.setAlphaF(0.12)
            painter.setBrush(ground)
            painter.drawPolygon(QPolygonF(self._lasso))

    def _paint_hulls(self, painter: QPainter, tokens: dict[str, str]) -> None:
        count = len(self.content.exemplars)
        for g, corners in self._hulls:
            polygon = QPolygonF([self._offset + QPointF(*(corner * self._tile)) for corner in corners])
            current = g == self.current_group
            colour = QColor(group_colour(g, count))
            line, fill = QColor(colour), QColor(colour)
            line.setAlphaF(0.9 if current else 0.4)
            fill.setAlphaF(0.15 if current else 0.10)
            painter.setPen(QPen(line, 1.4 if current else 1.0))
            painter.setBrush(fill)
            painter.drawPolygon(polygon)
            top = polygon.boundingRect().top()
            high = [point.x() for point in polygon if point.y() < top + 0.12 * self._tile]
            self._paint_name(painter, tokens, g, QPointF((min(high) + max(high)) / 2, top - 9), centred=True)

    def _paint_headings(self, painter: QPainter, tokens: dict[str, str]) -> None:
        if not self.content.grouped:
            return
        for g, y in self._headings:
            self._paint_name(painter, tokens, g, self._offset + QPointF(4, y * self._tile + 26), centred=False)

    def _paint_name(self, painter: QPainter, tokens: dict[str, str], g: int, at: QPointF, *, centred: bool) -> None:
        """The group's name in its colour and how many it has; ``at`` is the middle (or left end) of the base line."""
        name = self.content.group_names[g] if g >= 0 else "Left out"
        number = str(int((self.content.group == g).sum()))
        bold, plain = font(11, 600), font(11, 400)
        widths = QFontMetricsF(bold).horizontalAdvance(name + " "), QFontMetricsF(plain).horizontalAdvance(number)
        x = at.x() - sum(widths) / 2 if centred else at.x()
        colour = QColor(group_colour(g, len(self.content.exemplars)))
        if tokens["view"] > "#888888":  # the soft colours are too pale for words on a light ground
            colour = colour.darker(165)
        painter.setFont(bold)
        painter.setPen(colour)
        painter.drawText(QPointF(x, at.y()), name)
        painter.setFont(plain)
        painter.setPen(QColor(tokens["text_2"]))
        painter.drawText(QPointF(x + widths[0], at.y()), number)

    def _paint_shape(self, painter: QPainter, tokens: dict[str, str], index: int, exemplar: bool) -> None:
        name, g = self.content.names[index], int(self.content.group[index])
        centre, tile = self.at(index), self._tile
        colour = QColor(group_colour(g if self.content.grouped else 0, len(self.content.exemplars)))
        in_rows = self.rows or not self.content.grouped
        box = QRectF(centre.x() - tile / 2, centre.y() - tile / 2, tile, tile)
        if tile < DOT_BELOW:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(colour)
            radius = max(tile * (0.34 if exemplar else 0.22), 1.5)
            painter.drawEllipse(centre, radius, radius)
            if name in self.selected or name == self.current:
                painter.setPen(QPen(QColor(tokens["accent"]), 1.5))
                painter.setBrush(Qt.BrushStyle.NoBrush)
                painter.drawEllipse(centre, radius + 2, radius + 2)
            return
        chosen = name == self.current
        if in_rows:
            self._paint_frame(painter, tokens, box.adjusted(3, 3, -3, -3), chosen, index)
            picture_box = box.adjusted(10, 6, -10, -22)
        elif exemplar:
            marked = chosen or name in self.selected
            accent = QColor(tokens["accent"]) if marked else colour
            fill = QColor(accent)
            fill.setAlphaF(0.25 if marked else 0.10)
            painter.setPen(QPen(accent, 2))
            painter.setBrush(fill)
            painter.drawEllipse(centre, tile * 0.56, tile * 0.56)
            picture_box = box.adjusted(*(v * tile * 0.07 for v in (1, 1, -1, -1)))
        else:
            self._paint_frame(painter, tokens, box, chosen, index)
            picture_box = box.adjusted(*(v * tile * 0.03 for v in (1, 1, -1, -1)))
        pixmap = self._picture(name, g)
        if pixmap is not None:
            side = min(picture_box.width(), picture_box.height())
            target = QRectF(0, 0, side, side)
            target.moveCenter(picture_box.center())
            painter.drawPixmap(target, pixmap, QRectF(pixmap.rect()))
        else:
            faint = QColor(colour)
            faint.setAlphaF(0.3)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(faint)
            painter.drawEllipse(centre, 3, 3)
        if in_rows:
            painter.setFont(font(11, 500 if chosen else 400))
            painter.setPen(QColor(tokens["text" if chosen else "text_2"]))
            words = QFontMetricsF(painter.font()).elidedText(name, Qt.TextElideMode.ElideMiddle, tile - 16)
            painter.drawText(
                box.adjusted(4, 0, -4, -5), Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignBottom, words
            )
        if exemplar:
            corner = box.topRight() + QPointF(-13, 13) if in_rows else centre + QPointF(0.4, -0.4) * tile
            self._paint_star(painter, tokens, corner, QColor(tokens["accent"]) if chosen else colour)

    def _paint_frame(self, painter: QPainter, tokens: dict[str, str], box: QRectF, chosen: bool, index: int) -> None:
        name = self.content.names[index]
        if chosen or name in self.selected:
            ground = QColor(tokens["accent"])
            ground.setAlphaF(0.16)
            painter.setPen(QPen(QColor(tokens["accent"]), 1.5))
            painter.setBrush(ground)
            painter.drawRoundedRect(box, 5, 5)
        elif index == self._hover:
            painter.setPen(QPen(QColor(tokens["text_2"]), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(box, 3, 3)

    def _paint_star(self, painter: QPainter, tokens: dict[str, str], at: QPointF, colour: QColor) -> None:
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(colour)
        painter.drawEllipse(at, 9, 9)
        star = icons.pixmap("star", tokens["view"], 11)
        painter.drawPixmap(QPointF(at.x() - 5.5, at.y() - 5.5), star)

    # -- mouse and keys --------------------------------------------------------------------------------------------

    def wheelEvent(self, event: QWheelEvent) -> None:
        steps = event.angleDelta().y() / 120
        if (self.rows or not self.content.grouped) and not event.modifiers() & Qt.KeyboardModifier.ControlModifier:
            self._pan(QPointF(0, steps * 64))
            return
        factor = 1.18**steps
        new = float(np.clip(self._tile * factor, *ZOOM_LIMITS))
        share = new / self._tile
        at = event.position()
        self._offset = at + (self._offset - at) * share
        self._tile = new
        self._touched = True
        self.update()

    def _pan(self, by: QPointF) -> None:
        self._offset += by
        self._touched = True
        if self.rows or not self.content.grouped:
            bottom = (float(self.place[:, 1].max(initial=0)) + 0.8) * self._tile
            self._offset.setX(16)
            self._offset.setY(min(8.0, max(self._offset.y(), self.height() - bottom)))
        self.update()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._press = self._last = event.position()
        self._moved = False
        lasso = self.lasso_always != bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
        if event.button() == Qt.MouseButton.LeftButton and lasso:
            self._lasso = [event.position()]

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        at = event.position()
        if self._press is None:
            index = self._index_at(at)
            if index != self._hover:
                self._hover = index
                self.hovered.emit("" if index is None else self.content.names[index])
                self.update()
            return
        self._moved |= (at - self._press).manhattanLength() > CLICK_SLACK
        if self._moved and self._lasso is not None:
            self._lasso.append(at)
            self.update()
        elif self._moved:
            self._pan(at - self._last)
        self._last = at

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        press, self._press = self._press, None
        lasso, self._lasso = self._lasso, None
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
        self._hover = None
        self.hovered.emit("")
        self.update()

    def _group_at(self, position: QPointF) -> int:
        for g, corners in self._hulls:
            polygon = QPolygonF([self._offset + QPointF(*(corner * self._tile)) for corner in corners])
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
