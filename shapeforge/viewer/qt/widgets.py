"""The small widgets all places are made of: rows, headings, segmented controls, switches, choices, cards.

They hold no truth: each shows a value that it is given and emits what the user asks for.
"""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QEvent, QObject, QPoint, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QContextMenuEvent,
    QFontMetrics,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPainterPath,
    QPaintEvent,
    QPen,
    QPixmap,
)
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QBoxLayout,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QMenu,
    QPushButton,
    QScrollArea,
    QSizePolicy,
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


def grouped(number: int) -> str:
    """A whole number with a thin space every three digits: 12 640, the same in every locale."""
    return f"{number:,}".replace(",", "\u2009")


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
    """A label that shortens its text with an ellipsis, and shows all of it as its tooltip, when space is short."""

    def __init__(self, text: str = "", role: str = "", mode: Qt.TextElideMode = Qt.TextElideMode.ElideRight) -> None:
        super().__init__()
        self._full = ""
        self._mode = mode
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
        self.setToolTip(self._full if shown != self._full else "")


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


def scrolled(*items: QWidget) -> QScrollArea:
    """Sections one below the other; they scroll when the window is low."""
    inside = QWidget()
    inside.setLayout(column(*items, None, spacing=0))
    area = QScrollArea()
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


class Switch(QAbstractButton):
    """An on/off switch, 30 x 16."""

    def __init__(self, on: bool = False, tooltip: str = "") -> None:
        super().__init__()
        self.setCheckable(True)
        self.setChecked(on)
        self.setToolTip(tooltip)
        self.setFixedSize(30, 16)

    def sizeHint(self) -> QSize:
        return QSize(30, 16)

    def paintEvent(self, event: QPaintEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(QColor(tokens["accent_text"]), 1) if self.hasFocus() else Qt.PenStyle.NoPen)
        ground = QColor(tokens["accent"] if self.isChecked() else tokens["separator_strong"])
        ground.setAlphaF(1.0 if self.isEnabled() else 0.5)
        painter.setBrush(ground)
        painter.drawRoundedRect(QRectF(0.5, 0.5, 29, 15), 7.5, 7.5)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor("#FFFFFF" if self.isEnabled() else tokens["text_off"]))
        painter.drawEllipse(QPointF(22 if self.isChecked() else 8, 8), 5.5, 5.5)


class Segments(QFrame):
    """One of a few values, all of them on show."""

    chosen = Signal(str)

    def __init__(self, options: Sequence[tuple[str, str, str]], value: str) -> None:
        """``options`` are (value, label, icon or "")."""
        super().__init__()
        self.setObjectName("segments")
        self._buttons: dict[str, QPushButton] = {}
        box = row(spacing=0)
        for key, text, icon in options:
            one = button(text, icon=icon, kind="segment", checkable=True)
            one.clicked.connect(lambda _=False, key=key: self._click(key))
            self._buttons[key] = one
            box.addWidget(one)
        self.setLayout(box)
        self.setFixedHeight(30)
        self.set_value(value)

    def _click(self, value: str) -> None:
        self.set_value(value)
        self.chosen.emit(value)

    def set_value(self, value: str) -> None:
        """Show ``value`` as the chosen one."""
        for key, one in self._buttons.items():
            one.setChecked(key == value)

    def button(self, value: str) -> QPushButton:
        """The button of one value."""
        return self._buttons[value]


class Choice(QPushButton):
    """A quiet "Colour by **group** ⌄" that opens a menu of values."""

    chosen = Signal(str)

    def __init__(self, prefix: str, options: Sequence[tuple[str, str]], value: str, *, tooltip: str = "") -> None:
        """``options`` are (value, label)."""
        super().__init__()
        self._options: list[tuple[str, str]] = []
        self._prefix, self._value = label(prefix, "text2"), label("", "strong")
        self._prefix.setVisible(bool(prefix))
        self._arrow = icon_label("down", "text_2", 14)
        for part in (self._prefix, self._value, self._arrow):
            part.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._row = row(self._prefix, self._value, 2, self._arrow, spacing=5, margins=(10, 0, 8, 0))
        self.setLayout(self._row)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        self.setToolTip(tooltip)
        self.clicked.connect(self._open)
        self.set_options(options, value)

    def set_options(self, options: Sequence[tuple[str, str]], value: str) -> None:
        """Offer other values."""
        self._options = list(options)
        self.set_value(value)

    def set_value(self, value: str) -> None:
        """Show ``value`` (its label, or itself when it is not among the options)."""
        self._value.setText(dict(self._options).get(value, value))
        self.updateGeometry()

    def value_text(self) -> str:
        """The label shown."""
        return self._value.text()

    def sizeHint(self) -> QSize:
        return QSize(self._row.sizeHint().width() + 2, 30)

    def _open(self) -> None:
        menu = QMenu(self)
        for value, text in self._options:
            menu.addAction(text, lambda value=value: self._choose(value))
        menu.popup(self.mapToGlobal(self.rect().bottomLeft()))

    def _choose(self, value: str) -> None:
        self.set_value(value)
        self.chosen.emit(value)


class Clickable(QFrame):
    """A frame that can be clicked, double-clicked or chosen with Enter or Space."""

    clicked = Signal()
    double_clicked = Signal()
    menu_wanted = Signal(QPoint)

    def __init__(self, layout: QBoxLayout, name: str = "row", *, tooltip: str = "") -> None:
        super().__init__()
        self.setObjectName(name)
        self.setLayout(layout)
        self.setToolTip(tooltip)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)

    def set_current(self, current: bool) -> None:
        """Show it as the chosen one."""
        set_style(self, "current", "true" if current else "false")

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self.rect().contains(event.position().toPoint()):
            self.clicked.emit()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        self.double_clicked.emit()

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        self.menu_wanted.emit(event.globalPos())

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Space):
            self.clicked.emit()
        else:
            super().keyPressEvent(event)


class EditableName(QWidget):
    """A name that can be edited in place: ``start()`` opens the editor, Return ends it, Escape gives it up."""

    renamed = Signal(str)

    def __init__(self, name: str) -> None:
        super().__init__()
        self._label = label(name, "strong")
        self.editor = QLineEdit(name)
        self.editor.setFixedHeight(22)
        self.editor.setVisible(False)
        self.editor.setAccessibleName("Name")
        self.editor.installEventFilter(self)
        self.editor.editingFinished.connect(self._end)
        self._editing = False
        self._before: QWidget | None = None
        self.setLayout(row(self._label, self.editor, spacing=0))

    def text(self) -> str:
        """The name shown."""
        return self._label.text()

    def start(self) -> None:
        """Edit it; the focus goes back to where it is now."""
        self._editing, self._before = True, QApplication.focusWidget()
        self._label.hide()
        self.editor.setText(self._label.text())
        self.editor.show()
        self.editor.setFocus()
        self.editor.selectAll()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.KeyPress, QEvent.Type.ShortcutOverride) and event.key() == Qt.Key.Key_Escape:
            event.accept()  # before the window's own Escape
            if event.type() == QEvent.Type.KeyPress:
                self.editor.setText(self._label.text())
                self._end()
            return True
        return False

    def _end(self) -> None:
        if self._editing:  # told twice: by Return, and again when the editor loses the focus
            self._editing = False
            if self.editor.hasFocus() and self._before is not None:
                self._before.setFocus()
            self.editor.hide()
            self._label.show()
            if self.editor.text() != self._label.text():
                self.renamed.emit(self.editor.text())


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
