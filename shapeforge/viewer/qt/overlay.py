"""Words and marks above the 3-D view, painted by Qt: sharp at any scale, and moving them redraws no 3-D."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QPainter, QPainterPath, QPen, QPolygonF
from PySide6.QtWidgets import QWidget
from vtkmodules.vtkRenderingCore import vtkCamera

from shapeforge.viewer.display import Display, Mark, View
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.picking import Rectangle, project
from shapeforge.viewer.qt import theme as look

ROLE_TOKEN = {
    "strong": "text",
    "plain": "text_2",
    "faint": "text_off",
    "accent": "accent_text",
    "ok": "ok",
    "warning": "warning",
    "error": "error",
}
LOW_CONFIDENCE = 0.5


def cell_rectangles(width: int, height: int, rows: int, columns: int) -> list[Rectangle]:
    """x, y, width, height of every cell, row by row, in logical pixels: where the scene's viewports lie."""
    xs = [round(c * width / columns) for c in range(columns + 1)]
    ys = [round(r * height / rows) for r in range(rows + 1)]
    return [
        (xs[c] + (c > 0), ys[r], xs[c + 1] - xs[c] - (c > 0), ys[r + 1] - ys[r] - (r < rows - 1))
        for r in range(rows)
        for c in range(columns)
    ]


class Overlay(QWidget):
    """Transparent to the mouse; paints captions, confidence bars and marks of each cell."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setAttribute(Qt.WidgetAttribute.WA_NoSystemBackground)
        self.display = Display()
        self.cameras: list[vtkCamera] = []
        self.theme = "dark"
        self.path: list[QPointF] = []  # a line being drawn, in logical pixels

    def paintEvent(self, event: object) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        cells = cell_rectangles(self.width(), self.height(), self.display.rows, self.display.columns)
        for i, view in enumerate(self.display.views[: len(cells)]):
            camera = self.cameras[i] if i < len(self.cameras) else None
            painter.save()
            painter.setClipRect(QRectF(*cells[i]))
            if camera is not None:
                for mark in view.marks:
                    self._mark(painter, mark, camera, cells[i])
            self._captions(painter, view, cells[i])
            if view.confidence is not None:
                self._confidence(painter, view.confidence, cells[i])
            painter.restore()
            if view.selected:
                painter.setPen(QPen(self._colour("accent"), 2))
                painter.setBrush(Qt.BrushStyle.NoBrush)
                x, y, w, h = cells[i]
                painter.drawRect(QRectF(x + 1, y + 1, w - 2, h - 2))
        if len(self.path) > 1:
            pen = QPen(self._colour("text"), 1.4, Qt.PenStyle.CustomDashLine)
            pen.setDashPattern([3, 2.2])
            painter.setPen(pen)
            painter.setBrush(QColor(255, 255, 255, 24))
            painter.drawPolygon(QPolygonF(self.path))
        painter.end()

    def _colour(self, token: str) -> QColor:
        return QColor(tokens(self.theme)[token])

    def _captions(self, painter: QPainter, view: View, cell: Rectangle) -> None:
        x, y, w, h = cell
        small = len(self.display.views) > 3
        margin = 12 if small else 16
        for caption in view.captions:
            heights = [16 if small or role != "strong" else 20 for _, role in caption.lines]
            top = y + margin - 2 if caption.corner.startswith("top") else y + h - margin - sum(heights) + 2
            align = Qt.AlignmentFlag.AlignLeft if caption.corner.endswith("left") else Qt.AlignmentFlag.AlignRight
            for (text, role), height in zip(caption.lines, heights, strict=True):
                strong = role == "strong"
                font = look.font((13 if small else 15) if strong else (11 if small else 13), 600 if strong else 400)
                painter.setFont(font)
                painter.setPen(self._colour(ROLE_TOKEN[role]))
                words = QFontMetricsF(font).elidedText(text, Qt.TextElideMode.ElideRight, w - 2 * margin)
                place = QRectF(x + margin, top, w - 2 * margin, height)
                painter.drawText(place, align | Qt.AlignmentFlag.AlignVCenter, words)
                top += height

    def _confidence(self, painter: QPainter, value: float, cell: Rectangle) -> None:
        x, y, w, h = cell
        low = value < LOW_CONFIDENCE
        bar = QRectF(x + w - 52, y + h - 18, 40, 4)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(self._colour("separator_strong"))
        painter.drawRoundedRect(bar, 2, 2)
        painter.setBrush(self._colour("error" if low else "accent"))
        painter.drawRoundedRect(QRectF(bar.x(), bar.y(), max(bar.width() * min(value, 1.0), 3), 4), 2, 2)
        painter.setFont(look.font(11, 600 if low else 400))
        painter.setPen(self._colour("error" if low else "text_2"))
        painter.drawText(QRectF(bar.x() - 46, bar.y() - 6, 40, 16), Qt.AlignmentFlag.AlignRight, whole_percent(value))
        if low:  # status is never colour alone
            cx, cy = bar.x() - 44, bar.y() + 2
            painter.setPen(QPen(self._colour("error"), 1.4))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            sign = [QPointF(cx, cy - 6), QPointF(cx + 6, cy + 5), QPointF(cx - 6, cy + 5)]
            painter.drawPolygon(QPolygonF(sign))
            painter.drawLine(QPointF(cx, cy - 2), QPointF(cx, cy + 1.2))
            painter.drawPoint(QPointF(cx, cy + 3.2))

    def _mark(self, painter: QPainter, mark: Mark, camera: vtkCamera, cell: Rectangle) -> None:
        at = project(camera, np.array([mark.at]), cell)[0]
        if not np.isfinite(at).all():
            return
        here = QPointF(*at)
        line = self._colour("text") if mark.colour is None else QColor(*mark.colour)
        ground = self._colour("view")
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if mark.kind in ("brush", "twin"):
            self._brush(painter, mark, camera, cell, line)
        elif mark.kind == "line" and mark.to is not None:
            pen = QPen(line, 1.4, Qt.PenStyle.CustomDashLine)
            pen.setDashPattern([3, 2.2])
            painter.setPen(pen)
            painter.drawLine(here, QPointF(*project(camera, np.array([mark.to]), cell)[0]))
        elif mark.kind == "arrow" and mark.to is not None:
            self._arrow(painter, here, QPointF(*project(camera, np.array([mark.to]), cell)[0]), line)
        elif mark.kind == "dot":
            painter.setPen(QPen(QColor("#FFFFFF"), 1.6))
            painter.setBrush(self._colour("accent") if mark.colour is None else line)
            size = 5.0 if len(self.display.views) <= 3 else 4.0  # what is under it is to be seen, too
            painter.drawEllipse(here, size, size)
        elif mark.kind == "halo":
            painter.setPen(QPen(QColor(0, 0, 0, 90), 3.6))
            painter.drawEllipse(here, 5.2, 5.2)
            painter.setPen(QPen(self._colour("accent"), 2.0))
            painter.drawEllipse(here, 5.2, 5.2)
        elif mark.kind == "ring":
            painter.setPen(QPen(line, 1.8))
            painter.setBrush(ground)
            painter.drawEllipse(here, 4.4, 4.4)
        elif mark.kind == "circle":
            self._circle(painter, mark, camera, cell, line)
        elif mark.kind == "pin":
            self._pin(painter, here, larger=mark.text == "held")
        elif mark.kind == "note":
            self._note(painter, here, mark.text, line, ground)

    def _brush(self, painter: QPainter, mark: Mark, camera: vtkCamera, cell: Rectangle, line: QColor) -> None:
        normal = np.array(mark.to if mark.to is not None else camera.GetDirectionOfProjection(), float)
        # Leaning towards the viewer keeps the ring open where the surface is seen from the side.
        normal = normal - 0.55 * np.array(camera.GetDirectionOfProjection())
        normal /= max(float(np.linalg.norm(normal)), 1e-9)
        first = np.cross(normal, (0.31, 0.87, 0.38))
        first /= max(float(np.linalg.norm(first)), 1e-9)
        second = np.cross(normal, first)
        turn = np.linspace(0, 2 * np.pi, 49)[:-1, None]
        circle = np.array(mark.at) + mark.radius * (np.cos(turn) * first + np.sin(turn) * second)
        places = project(camera, circle, cell)
        polygon = QPolygonF([QPointF(*p) for p in places])
        painter.setPen(QPen(QColor(0, 0, 0, 110), 3.2))  # a dark edge keeps the ring seen on light parts
        if mark.kind == "brush":
            painter.drawPolygon(polygon)
        pen = QPen(line if mark.colour else QColor("#FFFFFF"), 1.6)
        if mark.kind == "twin":
            pen.setStyle(Qt.PenStyle.CustomDashLine)
            pen.setDashPattern([3, 2.4])
        painter.setPen(pen)
        painter.drawPolygon(polygon)
        if mark.kind == "brush":
            centre = places.mean(axis=0)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor("#FFFFFF"))
            painter.drawEllipse(QPointF(*centre), 1.6, 1.6)

    def _circle(self, painter: QPainter, mark: Mark, camera: vtkCamera, cell: Rectangle, line: QColor) -> None:
        normal = np.array(mark.to, float)
        first = np.cross(normal, (0.31, 0.87, 0.38))
        first /= np.linalg.norm(first)
        turn = np.linspace(0, 2 * np.pi, 73)[:, None]
        spokes = np.cos(turn) * first + np.sin(turn) * np.cross(normal, first)
        places = project(camera, np.array(mark.at) + mark.radius * spokes, cell)
        near = spokes @ np.array(camera.GetDirectionOfProjection(), float) < 0.0
        faint, width = QColor(line), 3.4 if mark.text == "held" else 2.0
        faint.setAlphaF(0.28)
        for there in (False, True):
            painter.setPen(QPen(line if there else faint, width, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            for i in np.flatnonzero(near[:-1] == there):
                painter.drawLine(QPointF(*places[i]), QPointF(*places[i + 1]))

    def _arrow(self, painter: QPainter, start: QPointF, end: QPointF, line: QColor) -> None:
        painter.setPen(QPen(line, 1.6, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        painter.drawLine(start, end)
        along = np.array([end.x() - start.x(), end.y() - start.y()])
        length = float(np.linalg.norm(along))
        if length > 1:
            along /= length
            for side in (-0.5, 0.5):
                back = -7 * (np.cos(side) * along + np.sin(side) * np.array([-along[1], along[0]]))
                painter.drawLine(end, QPointF(end.x() + back[0], end.y() + back[1]))

    def _pin(self, painter: QPainter, tip: QPointF, larger: bool) -> None:
        """A drop whose tip is at the point, its head 13 pixels above."""
        radius, x, y = 7.0 if larger else 6.0, tip.x(), tip.y() - 13
        drop = QPainterPath(tip)
        drop.cubicTo(QPointF(x - 1.5, y + 8), QPointF(x - radius, y + 6), QPointF(x - radius, y))
        drop.arcTo(QRectF(x - radius, y - radius, 2 * radius, 2 * radius), 180, -180)
        drop.cubicTo(QPointF(x + radius, y + 6), QPointF(x + 1.5, y + 8), tip)
        painter.setPen(QPen(QColor(0, 0, 0, 90), 3.6))  # a dark edge keeps the white one seen on light parts
        painter.drawPath(drop)
        painter.setPen(QPen(QColor("#FFFFFF"), 1.6))
        painter.setBrush(self._colour("accent"))
        painter.drawPath(drop)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor("#FFFFFF"))
        painter.drawEllipse(QPointF(x, y), 2.0, 2.0)

    def _note(self, painter: QPainter, here: QPointF, text: str, line: QColor, ground: QColor) -> None:
        painter.setPen(QPen(line, 1.2))
        painter.drawLine(QPointF(here.x(), here.y() - 5), QPointF(here.x(), here.y() - 34))
        painter.setBrush(ground)
        painter.drawEllipse(here, 4.2, 4.2)
        painter.setFont(look.font(11, 600))
        painter.drawText(QRectF(here.x() - 80, here.y() - 54, 160, 16), Qt.AlignmentFlag.AlignCenter, text)


def whole_percent(value: float) -> str:
    """A confidence in whole percent, never rounded up: 49.7% is below 50%."""
    return f"{int(100 * value)}%"
