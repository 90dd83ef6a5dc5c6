"""Pieces of the Fit place: little pictures of template points, and the scrubber over recorded rounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QImage, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QBoxLayout, QFrame, QWidget

from shapeforge.collection.counts import grouped
from shapeforge.viewer.fit_display import FULL_HEAT, TemplateLook, all_points, to_plane
from shapeforge.viewer.fit_record import FitRecord, look_at, moved_text
from shapeforge.viewer.palette import SWITCHED_OFF, as_hex, rgb, tokens
from shapeforge.viewer.qt.controls import Choice
from shapeforge.viewer.qt.theme import PADDING, colours, font
from shapeforge.viewer.qt.widgets import Swatch, clear, column, label, row
from shapeforge.viewer.session import Session


def draw_points(
    positions: np.ndarray,
    colours_of_points: np.ndarray,
    size: tuple[int, int],
    direction: tuple[float, ...],
    dot: int = 2,
) -> QImage:
    """A picture (device pixels) of points (n, 3) with colours (n, 3), far ones first; NaN rows are left out.

    What is switched off has no say in how large the rest is, and is left out where there is no room for all of it.
    """
    width, height = size
    picture = np.zeros((height, width, 4), np.uint8)
    there = np.isfinite(positions).all(axis=1)
    flat = to_plane(positions[there], direction)
    inks = colours_of_points[there]
    if len(flat):
        on = (inks != rgb(SWITCHED_OFF)).any(axis=1)
        seen = flat[on if on.any() else ~on, :2]
        low, high = seen.min(axis=0), seen.max(axis=0)
        room = np.array([width - dot - 4, height - dot - 4])
        scale = float((room / np.maximum(high - low, 1e-6)).min())
        at = (flat[:, :2] - (low + high) / 2) * scale + np.array([width, height]) / 2 - dot / 2
        order = np.argsort(flat[:, 2])
        if on.any() and not ((at[~on] >= 0) & (at[~on] <= np.array([width, height]) - dot)).all():
            order = order[on[order]]
        at, inks = np.round(at[order]).astype(int), inks[order]
        for dy in range(dot):
            for dx in range(dot):
                x, y = np.clip(at[:, 0] + dx, 0, width - 1), np.clip(at[:, 1] + dy, 0, height - 1)
                picture[y, x, :3] = inks
                picture[y, x, 3] = 255
    return QImage(picture.data, width, height, 4 * width, QImage.Format.Format_RGBA8888).copy()


LEGEND_AT_MOST = 12
PHASES = ("exemplars", "family")
"""What the rounds of a fit are called: those by the exemplars' templates, then those by the family's own."""
LOOK_BACK = "Drag to look back at a recorded round; the newest is at the right"
TWO_PHASES = "Up to round {} by the exemplars' templates, from round {} on by the family's own"


def show_legend(box: QBoxLayout, looks: Sequence[TemplateLook], by: str, number: int) -> None:
    """Fill ``box`` with what the colours of round ``number`` mean: parts, or movement."""
    clear(box)
    if by == "movement":
        box.addWidget(label(f"pale: at rest · dark red: moved {100 * FULL_HEAT:g}% of size or more", "caption"))
    elif looks:
        names = looks[0].part_names
        for part, name in enumerate(names[:LEGEND_AT_MOST]):
            box.addWidget(Swatch(as_hex(looks[0].inks[part]), size=10))
            box.addWidget(label(name, "caption"))
            box.addSpacing(6)
        box.addWidget(Swatch(SWITCHED_OFF, size=8, disc=True))
        box.addWidget(label("switched off", "caption"))
        if number > 0:
            box.addSpacing(6)
            box.addWidget(label(f"—  moved since round {number - 1}", "caption"))
    else:
        said = "The templates of the painted exemplars find their way to every shape."
        box.addWidget(label(said, "caption"))
    box.addStretch(1)


class PointPicture(QWidget):
    """Template points of one shape, small, with its name and how far they moved."""

    clicked = Signal(str)

    def __init__(self, name: str, size: tuple[int, int]) -> None:
        super().__init__()
        self.name = name
        self.caption, self.warn, self.current = "", False, False
        self._points: tuple[np.ndarray, np.ndarray] | None = None
        self._direction: tuple[float, ...] = (1.0, 0.6, 1.5)
        self._image: QImage | None = None
        self.setMinimumSize(*size)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setToolTip(f"Watch {name}")

    def show_points(self, positions: np.ndarray | None, inks: np.ndarray | None) -> None:
        """Show other points (None: none are known)."""
        known = positions is not None and inks is not None
        self._points = (positions, inks) if known else None
        self._image = None
        self.update()

    def look_from(self, direction: tuple[float, ...]) -> None:
        """Turn it."""
        if direction != self._direction:
            self._direction, self._image = direction, None
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self.rect().contains(event.position().toPoint()):
            self.clicked.emit(self.name)

    def paintEvent(self, event: QPaintEvent) -> None:
        look = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.current or self.underMouse():
            painter.setPen(QPen(QColor(look["accent" if self.current else "separator_strong"]), 1))
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5), 5, 5)
        box = QRectF(4, 4, self.width() - 8, self.height() - 44)
        ratio = self.devicePixelRatioF()
        size = (max(round(box.width() * ratio), 8), max(round(box.height() * ratio), 8))
        if self._points is not None:
            if self._image is None or (self._image.width(), self._image.height()) != size:
                self._image = draw_points(*self._points, size, self._direction, dot=max(round(1.6 * ratio), 2))
            painter.drawImage(box, self._image)
        else:
            painter.setPen(QColor(look["text_off"]))
            painter.setFont(font(11))
            painter.drawText(box, Qt.AlignmentFlag.AlignCenter, "not fitted")
        painter.setFont(font(11, 600))
        painter.setPen(QColor(look["text"]))
        words = painter.fontMetrics().elidedText(self.name, Qt.TextElideMode.ElideMiddle, self.width() - 8)
        painter.drawText(QRectF(2, self.height() - 38, self.width() - 4, 17), Qt.AlignmentFlag.AlignCenter, words)
        painter.setFont(font(11))
        painter.setPen(QColor(look["warning" if self.warn else "text_2"]))
        painter.drawText(
            QRectF(2, self.height() - 21, self.width() - 4, 16), Qt.AlignmentFlag.AlignCenter, self.caption
        )


class Scrubber(QWidget):
    """The rounds 0..of on a line: recorded ones are filled and can be looked at; a little picture above some.

    Where the family's own templates begin (``set_phase``) a line stands between two rounds, as in the curves.
    """

    moved = Signal(int)

    def __init__(self) -> None:
        super().__init__()
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMinimumSize(320, 96)
        self.of, self.recorded, self.at = 10, 0, 0
        self.share = 0.0
        self._family_after: int | None = None
        self._pictures: dict[int, QImage] = {}
        self.setToolTip(LOOK_BACK)

    def sizeHint(self) -> QSize:
        return QSize(700, 96)

    def set_state(self, of: int, recorded: int, at: int, pictures: dict[int, QImage]) -> None:
        """``recorded`` is the newest recorded round (-1: none), ``at`` the one looked at."""
        self.of, self.recorded, self.at = max(of, 1), recorded, at
        self._pictures = pictures
        self.update()

    def set_share(self, share: float) -> None:
        """How much of the round under way is done (0..1)."""
        if share != self.share:
            self.share = share
            self.update()

    def set_phase(self, after: int | None) -> None:
        """The rounds after the round ``after`` are the family's; None where there is but one phase."""
        if after != self._family_after:
            self._family_after = after
            self.setToolTip(LOOK_BACK if after is None else f"{LOOK_BACK}\n{TWO_PHASES.format(after, after + 1)}")
            self.update()

    def x_of(self, number: float | int) -> float:
        """Where a round is, in pixels."""
        return 26 + (self.width() - 52) * number / self.of

    def _pick(self, x: float) -> None:
        if self.recorded < 0:
            return
        number = round((x - 26) / (self.width() - 52) * self.of)
        number = min(max(number, 0), self.recorded)
        if number != self.at:
            self.moved.emit(number)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._pick(event.position().x())

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if event.buttons() & Qt.MouseButton.LeftButton:
            self._pick(event.position().x())

    def keyPressEvent(self, event: QKeyEvent) -> None:
        step = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1}.get(event.key())
        if step is None:
            super().keyPressEvent(event)
        elif 0 <= self.at + step <= self.recorded:
            self.moved.emit(self.at + step)

    def paintEvent(self, event: QPaintEvent) -> None:
        look = tokens(self.window().property("theme") or "dark")
        painter = QPainter(self)
        painter.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
        y = 66.0
        accent, rest = QColor(look["accent"]), QColor(look["separator_strong"])
        painter.setPen(QPen(rest, 4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        painter.drawLine(QPointF(self.x_of(0), y), QPointF(self.x_of(self.of), y))
        if self.recorded >= 0:
            done = min(self.recorded + self.share, self.of)
            painter.setPen(QPen(accent, 4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.drawLine(QPointF(self.x_of(0), y), QPointF(self.x_of(done), y))
        step = (self.width() - 52) / self.of
        every = max(1, int(np.ceil(26 / step)))
        if self._family_after is not None:
            self._draw_phase(painter, y)
        last_picture = -1e9
        for number in range(self.of + 1):
            x = self.x_of(number)
            known = number <= self.recorded
            here = known and number == self.at
            painter.setPen(QPen(accent, 2) if here else Qt.PenStyle.NoPen)
            painter.setBrush(QColor("#FFFFFF") if here else accent if known else rest)
            painter.drawEllipse(QPointF(x, y), 5.0 if here else 4.0, 5.0 if here else 4.0)
            if number % every == 0 or here:
                painter.setFont(font(11, 600 if here else 400))
                painter.setPen(QColor(look["text" if here else "text_2" if known else "text_off"]))
                painter.drawText(QRectF(x - 16, y + 9, 32, 16), Qt.AlignmentFlag.AlignCenter, str(number))
            picture = self._pictures.get(number)
            if picture is not None and x - last_picture >= 40:
                painter.drawImage(QRectF(x - 19, 17, 38, 40), picture)
                last_picture = x
        if self.hasFocus():
            painter.setPen(QPen(QColor(look["accent"]), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5), 5, 5)

    def _draw_phase(self, painter: QPainter, y: float) -> None:
        """A line where the family's rounds begin, and what the rounds on either side of it are called."""
        look = tokens(self.window().property("theme") or "dark")
        x = round(self.x_of(self._family_after + 0.5)) + 0.5
        painter.setPen(QPen(QColor(look["separator_strong"]), 1))
        painter.drawLine(QPointF(x, 3), QPointF(x, y - 4))
        painter.drawLine(QPointF(x, y + 4), QPointF(x, y + 12))
        painter.setFont(font(11))
        painter.setPen(QColor(look["text_2"]))
        middle, (before, after) = Qt.AlignmentFlag.AlignVCenter, PHASES
        wide = painter.fontMetrics().horizontalAdvance
        if wide(before) <= x - 6:
            painter.drawText(QRectF(0, 1, x - 6, 14), Qt.AlignmentFlag.AlignRight | middle, before)
        left = min(x + 6, self.width() - wide(after))
        painter.drawText(QRectF(left, 1, wide(after) + 1, 14), Qt.AlignmentFlag.AlignLeft | middle, after)


class AlsoWatching(QFrame):
    """A row of watched shapes below the views; a click looks at one."""

    clicked = Signal(str)

    def __init__(self, *more: QWidget) -> None:
        """``more`` widgets stand beside the choice of the order."""
        super().__init__()
        self.setObjectName("bar")
        self.setFixedHeight(186)
        self.pictures: list[PointPicture] = []
        self.count = label("", "text2")
        self.sort = Choice(
            "Sort by",
            [("name", "name"), ("movement", "movement")],
            "movement",
            tooltip="The order of the small pictures",
        )
        self._row = row(spacing=4, margins=(12, 0, 12, 6))
        head = row(
            label("Also watching", "heading"), self.count, None, *more, self.sort, margins=(PADDING, 4, PADDING, 0)
        )
        self.setLayout(column(head, self._row, spacing=2))

    def show_shapes(self, record: FitRecord, session: Session, number: int, direction: tuple[float, ...]) -> None:
        """Show the watched shapes after round ``number``, seen from ``direction``."""
        names = [name for name in session.watched if name in session.project.names]
        known = record.rounds.get(number)
        if self.sort.value_text() == "name":
            names.sort()
        elif known is not None and known.moved:
            names.sort(key=lambda name: -known.moved.get(name, 0.0))
        self.count.setText(f"{len(names)} of {grouped(len(session.project.names))}")
        if [one.name for one in self.pictures] != names:
            clear(self._row)
            self.pictures = [PointPicture(name, (84, 130)) for name in names]
            for one in self.pictures:
                one.clicked.connect(self.clicked)
                self._row.addWidget(one, 1)
        for one in self.pictures:
            now = record.points(one.name, number)
            look = look_at(record, now)
            if now is None or look is None or len(look.label) != len(now.positions):
                one.show_points(None, None)
            else:
                one.show_points(*all_points(look, now))
            one.caption, one.warn = moved_text(record, one.name, number)
            one.current = one.name == session.shape
            one.look_from(direction)
            one.update()
