"""What all places are made of: rows and columns, headings, labels, buttons, swatches, pictures.

They hold no truth: each shows a value that it is given (`controls` has those that emit what the user asks for).
"""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QFontMetrics, QPainter, QPainterPath, QPaintEvent, QPen, QPixmap, QResizeEvent
from PySide6.QtWidgets import (
    QBoxLayout,
    QFrame,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from shapeforge.viewer.qt.icons import set_icon
from shapeforge.viewer.qt.theme import PADDING, colours

Margins = tuple[int, int, int, int]


def _fill(box: QBoxLayout, items: Sequence[QWidget | QBoxLayout | int | None], spacing: int, margins: Margins) -> None:
    box.setSpacing(spacing)
    box.setContentsMargins(*margins)
    for item in items:
        if item is None:
            box.addStretch(1)
        elif isinstance(item, int):
            box.addSpacing(item)
        elif isinstance(item, QBoxLayout):
            box.addLayout(item)
        else:
            box.addWidget(item)


def row(*items: QWidget | QBoxLayout | int | None, spacing: int = 8, margins: Margins = (0, 0, 0, 0)) -> QHBoxLayout:
    """A row of widgets, layouts, spaces (pixels) and stretches (None)."""
    box = QHBoxLayout()
    _fill(box, items, spacing, margins)
    return box


def column(*items: QWidget | QBoxLayout | int | None, spacing: int = 8, margins: Margins = (0, 0, 0, 0)) -> QVBoxLayout:
    """A column of widgets, layouts, spaces (pixels) and stretches (None)."""
    box = QVBoxLayout()
    _fill(box, items, spacing, margins)
    return box


def framed(layout: QBoxLayout, name: str = "", *, height: int | None = None, width: int | None = None) -> QFrame:
    """A frame around a layout; ``name`` chooses its style (strip, card, note, …)."""
    frame = QFrame()
    frame.setObjectName(name)
    frame.setLayout(layout)
    if height is not None:
        frame.setFixedHeight(height)
    if width is not None:
        frame.setFixedWidth(width)
    return frame


def clear(layout: QBoxLayout) -> None:
    """Take everything out of a layout and delete it."""
    while layout.count():
        item = layout.takeAt(0)
        if item.widget() is not None:
            item.widget().hide()
            item.widget().deleteLater()
        elif item.layout() is not None:
            clear(item.layout())


def set_style(widget: QWidget, key: str, value: str) -> None:
    """Change a property that the style sheet looks at, and show it."""
    if widget.property(key) != value:
        widget.setProperty(key, value)
        widget.style().unpolish(widget)
        widget.style().polish(widget)


def label(text: str = "", role: str = "", *, wrap: bool = False, tooltip: str = "") -> QLabel:
    """A text; ``role`` is heading, title, strong, text2, off, caption, caption_ok, …, keycap."""
    result = QLabel(text)
    result.setTextFormat(Qt.TextFormat.PlainText)
    if role:
        result.setProperty("role", role)
    result.setWordWrap(wrap)
    result.setToolTip(tooltip)
    return result


class ElidedLabel(QLabel):
    """A label that shortens its text with an ellipsis, and shows all of it as its tooltip, when space is short.

    ``about`` is the tooltip besides.
    """

    def __init__(
        self, text: str = "", role: str = "", mode: Qt.TextElideMode = Qt.TextElideMode.ElideRight, *, about: str = ""
    ) -> None:
        super().__init__()
        self._full = ""
        self._mode, self._about = mode, about
        if role:
            self.setProperty("role", role)
        self.setText(text)

    def setText(self, text: str) -> None:
        self._full = text
        self._elide()
        self.updateGeometry()

    def full_text(self) -> str:
        """The whole text."""
        return self._full

    def sizeHint(self) -> QSize:
        self.ensurePolished()
        return QSize(QFontMetrics(self.font()).horizontalAdvance(self._full) + 2, super().sizeHint().height())

    def minimumSizeHint(self) -> QSize:
        return QSize(16, super().minimumSizeHint().height())

    def resizeEvent(self, event: object) -> None:
        super().resizeEvent(event)
        self._elide()

    def _elide(self) -> None:
        self.ensurePolished()
        shown = QFontMetrics(self.font()).elidedText(self._full, self._mode, max(self.width(), 8))
        super().setText(shown)
        self.setToolTip("\n".join(line for line in (self._full if shown != self._full else "", self._about) if line))


def button(
    text: str = "", *, icon: str = "", kind: str = "", role: str = "text_2", tooltip: str = "", checkable: bool = False
) -> QPushButton:
    """A button; ``kind`` is "" (plain), primary (one per place), link, icon, tool or segment."""
    result = QPushButton(text)
    if kind:
        result.setProperty("kind", kind)
    if icon:
        set_icon(result, icon, "on_accent" if kind == "primary" else role)
    result.setToolTip(tooltip)
    result.setCheckable(checkable)
    result.setCursor(Qt.CursorShape.PointingHandCursor if kind in ("link", "crumb") else Qt.CursorShape.ArrowCursor)
    return result


def shortened(text: str, most: int = 26) -> str:
    """A name of at most ``most`` characters, an ellipsis in its middle: the ends tell names apart."""
    return text if len(text) <= most else f"{text[: (most - 1) // 2]}…{text[len(text) - most // 2 :]}"


def separator(*, vertical: bool = False, height: int = 20) -> QFrame:
    """A 1-px line; a vertical one is ``height`` pixels high."""
    line = QFrame()
    line.setObjectName("vline" if vertical else "hline")
    if vertical:
        line.setFixedSize(1, height)
    else:
        line.setFixedHeight(1)
    return line


def icon_label(name: str, role: str = "text_2", size: int = 16) -> QLabel:
    """A picture of an icon."""
    result = QLabel()
    result.setFixedSize(size, size)
    set_icon(result, name, role, size)
    return result


def heading(text: str, count: str = "", *right: QWidget) -> QHBoxLayout:
    """A section's heading with a quiet count after it and widgets at the right."""
    return row(label(text, "heading"), label(count, "off"), None, *right)


def section(*items: QWidget | QBoxLayout | int | None, spacing: int = 8, line: bool = True) -> QWidget:
    """A block of the inspector: padding 16 and a line below."""
    box = column(*items, spacing=spacing, margins=(PADDING, 14, PADDING, PADDING))
    outer = column(box, spacing=0)
    if line:
        outer.addWidget(separator())
    result = QWidget()
    result.setLayout(outer)
    return result


class _Upright(QScrollArea):
    """Scrolls up and down only: what is too wide for it is cut at its own end and pushes nothing else out."""

    def resizeEvent(self, event: QResizeEvent) -> None:
        if self.widget() is not None:
            self.widget().setMaximumWidth(self.viewport().width())
        super().resizeEvent(event)


def scrolled(*items: QWidget) -> QScrollArea:
    """Sections one below the other; they scroll when the window is low."""
    inside = QWidget()
    inside.setLayout(column(*items, None, spacing=0))
    area = _Upright()
    area.setObjectName("panel")
    area.setWidget(inside)
    area.setWidgetResizable(True)
    area.setFrameShape(QFrame.Shape.NoFrame)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setFocusPolicy(Qt.FocusPolicy.TabFocus)  # a click beside a control leaves the keys with the view
    return area


class Swatch(QWidget):
    """A small square (radius 3) or disc of one colour."""

    def __init__(self, colour: str, *, size: int = 14, disc: bool = False) -> None:
        super().__init__()
        self._colour, self._disc = colour, disc
        self.setFixedSize(size, size)

    def set_colour(self, colour: str) -> None:
        """Show another colour ("#RRGGBB")."""
        self._colour = colour
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        colour = QColor(self._colour)
        colour.setAlphaF(1.0 if self.isEnabled() else 0.45)
        painter.setBrush(colour)
        radius = self.width() / 2 if self._disc else 3
        painter.drawRoundedRect(QRectF(self.rect()), radius, radius)


class Picture(QWidget):
    """A picture that keeps its proportions and is centred; a quiet outline stands for one that is still to come."""

    def __init__(self, size: tuple[int, int], *, radius: int = 4, top: int = 0) -> None:
        """``top`` pixels stay free above the picture, for words."""
        super().__init__()
        self.setFixedSize(*size)
        self._radius, self._top = radius, top
        self._pixmap: QPixmap | None = None

    def set_pixmap(self, pixmap: QPixmap | None) -> None:
        """Show another picture (None: still to come)."""
        self._pixmap = pixmap
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
        if self._pixmap is None:
            outline = QPainterPath()
            outline.addRoundedRect(QRectF(self.rect()).adjusted(2.5, 2.5, -2.5, -2.5), self._radius, self._radius)
            painter.setPen(QPen(QColor(colours(self)["separator"]), 1))
            painter.drawPath(outline)
            return
        # The pixmap may carry its own device pixel ratio; only its proportions matter here.
        room = QSize(self.width(), self.height() - self._top)
        size = self._pixmap.size().scaled(room, Qt.AspectRatioMode.KeepAspectRatio)
        corner = QPointF((room.width() - size.width()) / 2, self._top + (room.height() - size.height()) / 2)
        painter.drawPixmap(QRectF(corner, size.toSizeF()), self._pixmap, QRectF(self._pixmap.rect()))
