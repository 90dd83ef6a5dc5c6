"""How the map of a collection is drawn: hulls and names of groups, pictures of shapes, exemplars, what is selected."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QPainter, QPen, QPixmap, QPolygonF

from shapeforge.viewer.palette import SWITCHED_OFF, group_colours
from shapeforge.viewer.qt import icons
from shapeforge.viewer.qt.theme import font

if TYPE_CHECKING:
    from shapeforge.viewer.qt.group_map import GroupMap

DOT_BELOW = 20.0  # pixels a tile below which pictures become dots


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


class MapDrawing:
    """Draws a map once: ``painter`` paints on it, ``tokens`` are the colours of its theme."""

    def __init__(self, of: GroupMap, painter: QPainter, tokens: dict[str, str]) -> None:
        self.map, self.painter, self.tokens = of, painter, tokens

    def draw(self) -> None:
        """All of it, back to front."""
        painter, tokens = self.painter, self.tokens
        painter.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
        painter.fillRect(self.map.rect(), QColor(tokens["view"]))
        self._paint_hulls()
        self._paint_headings()
        seen = QRectF(self.map.rect()).adjusted(-self.map.tile, -self.map.tile, self.map.tile, self.map.tile)
        exemplars = set(self.map.content.exemplars.tolist()) if self.map.content.grouped else set()
        for index in range(len(self.map.place)):
            if seen.contains(self.map.at(index)):
                self._paint_shape(index, index in exemplars)
        if self.map.lasso:
            painter.setPen(QPen(QColor(tokens["accent"]), 1.2, Qt.PenStyle.DashLine))
            ground = QColor(tokens["accent"])
            ground.setAlphaF(0.12)
            painter.setBrush(ground)
            painter.drawPolygon(QPolygonF(self.map.lasso))

    def _paint_hulls(self) -> None:
        painter = self.painter
        count = len(self.map.content.exemplars)
        for g, corners in self.map.hulls:
            polygon = QPolygonF([self.map.offset + QPointF(*(corner * self.map.tile)) for corner in corners])
            current = g == self.map.current_group
            colour = QColor(group_colour(g, count))
            line, fill = QColor(colour), QColor(colour)
            line.setAlphaF(0.9 if current else 0.4)
            fill.setAlphaF(0.15 if current else 0.10)
            painter.setPen(QPen(line, 1.4 if current else 1.0))
            painter.setBrush(fill)
            painter.drawPolygon(polygon)
            top = polygon.boundingRect().top()
            high = [point.x() for point in polygon if point.y() < top + 0.12 * self.map.tile]
            self._paint_name(g, QPointF((min(high) + max(high)) / 2, top - 9), centred=True)

    def _paint_headings(self) -> None:
        if not self.map.content.grouped:
            return
        for g, y in self.map.headings:
            self._paint_name(g, self.map.offset + QPointF(4, y * self.map.tile + 26), centred=False)

    def _paint_name(self, g: int, at: QPointF, *, centred: bool) -> None:
        """The group's name in its colour and how many it has; ``at`` is the middle (or left end) of the base line."""
        painter, tokens = self.painter, self.tokens
        name = self.map.content.group_names[g] if g >= 0 else "Left out"
        number = str(int((self.map.content.group == g).sum()))
        bold, plain = font(11, 600), font(11, 400)
        widths = QFontMetricsF(bold).horizontalAdvance(name + " "), QFontMetricsF(plain).horizontalAdvance(number)
        x = at.x() - sum(widths) / 2 if centred else at.x()
        colour = QColor(group_colour(g, len(self.map.content.exemplars)))
        if tokens["view"] > "#888888":  # the soft colours are too pale for words on a light ground
            colour = colour.darker(165)
        painter.setFont(bold)
        painter.setPen(colour)
        painter.drawText(QPointF(x, at.y()), name)
        painter.setFont(plain)
        painter.setPen(QColor(tokens["text_2"]))
        painter.drawText(QPointF(x + widths[0], at.y()), number)

    def _paint_shape(self, index: int, exemplar: bool) -> None:
        content, tile, centre = self.map.content, self.map.tile, self.map.at(index)
        name, g = content.names[index], int(content.group[index])
        colour = QColor(group_colour(g if content.grouped else 0, len(content.exemplars)))
        if tile < DOT_BELOW:
            self._paint_dot(index, colour, max(tile * (0.34 if exemplar else 0.22), 1.5))
            return
        chosen, in_rows = name == self.map.current, self.map.rows or not content.grouped
        box = QRectF(centre.x() - tile / 2, centre.y() - tile / 2, tile, tile)
        if in_rows:
            self._paint_frame(box.adjusted(3, 3, -3, -3), chosen, index)
            inner = box.adjusted(10, 6, -10, -22)
        elif exemplar:
            self._paint_ring(index, colour)
            inner = box.adjusted(*(v * tile * 0.07 for v in (1, 1, -1, -1)))
        else:
            self._paint_frame(box, chosen, index)
            inner = box.adjusted(*(v * tile * 0.03 for v in (1, 1, -1, -1)))
        self._paint_picture(inner, self.map.picture(name, g), colour)
        if in_rows:
            self._paint_words(box, name, chosen)
        if exemplar:
            corner = box.topRight() + QPointF(-13, 13) if in_rows else centre + QPointF(0.4, -0.4) * tile
            self._paint_star(corner, QColor(self.tokens["accent"]) if chosen else colour)

    def _paint_dot(self, index: int, colour: QColor, radius: float) -> None:
        """A shape seen from so far that its picture would say nothing."""
        painter, centre, name = self.painter, self.map.at(index), self.map.content.names[index]
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(colour)
        painter.drawEllipse(centre, radius, radius)
        if name in self.map.selected or name == self.map.current:
            painter.setPen(QPen(QColor(self.tokens["accent"]), 1.5))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(centre, radius + 2, radius + 2)

    def _paint_ring(self, index: int, colour: QColor) -> None:
        """Round an exemplar."""
        name = self.map.content.names[index]
        marked = name == self.map.current or name in self.map.selected
        ink = QColor(self.tokens["accent"]) if marked else colour
        fill = QColor(ink)
        fill.setAlphaF(0.25 if marked else 0.10)
        self.painter.setPen(QPen(ink, 2))
        self.painter.setBrush(fill)
        self.painter.drawEllipse(self.map.at(index), self.map.tile * 0.56, self.map.tile * 0.56)

    def _paint_picture(self, box: QRectF, pixmap: QPixmap | None, colour: QColor) -> None:
        """The picture in the middle of ``box``; a faint dot where it is still to come."""
        if pixmap is not None:
            side = min(box.width(), box.height())
            target = QRectF(0, 0, side, side)
            target.moveCenter(box.center())
            self.painter.drawPixmap(target, pixmap, QRectF(pixmap.rect()))
            return
        faint = QColor(colour)
        faint.setAlphaF(0.3)
        self.painter.setPen(Qt.PenStyle.NoPen)
        self.painter.setBrush(faint)
        self.painter.drawEllipse(box.center(), 3, 3)

    def _paint_words(self, box: QRectF, name: str, chosen: bool) -> None:
        painter = self.painter
        painter.setFont(font(11, 500 if chosen else 400))
        painter.setPen(QColor(self.tokens["text" if chosen else "text_2"]))
        words = QFontMetricsF(painter.font()).elidedText(name, Qt.TextElideMode.ElideMiddle, box.width() - 16)
        below = Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignBottom
        painter.drawText(box.adjusted(4, 0, -4, -5), below, words)

    def _paint_frame(self, box: QRectF, chosen: bool, index: int) -> None:
        painter, tokens = self.painter, self.tokens
        name = self.map.content.names[index]
        if chosen or name in self.map.selected:
            ground = QColor(tokens["accent"])
            ground.setAlphaF(0.16)
            painter.setPen(QPen(QColor(tokens["accent"]), 1.5))
            painter.setBrush(ground)
            painter.drawRoundedRect(box, 5, 5)
        elif index == self.map.hover:
            painter.setPen(QPen(QColor(tokens["text_2"]), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(box, 3, 3)

    def _paint_star(self, at: QPointF, colour: QColor) -> None:
        painter, tokens = self.painter, self.tokens
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(colour)
        painter.drawEllipse(at, 9, 9)
        star = icons.pixmap("star", tokens["view"], 11)
        painter.drawPixmap(QPointF(at.x() - 5.5, at.y() - 5.5), star)
