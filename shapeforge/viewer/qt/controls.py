"""The small controls of all places: switches, segments, choices, rows that are clicked, names that are edited in place.

They hold no truth: each shows a value that it is given and emits what the user asks for.
"""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QEvent, QObject, QPoint, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QContextMenuEvent, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QBoxLayout,
    QFrame,
    QLineEdit,
    QMenu,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from shapeforge.viewer.qt.theme import colours
from shapeforge.viewer.qt.widgets import ElidedLabel, button, icon_label, label, row, set_style


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
        self._label = ElidedLabel(name, "strong", Qt.TextElideMode.ElideMiddle)
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
        """The name, which may be shown shortened."""
        return self._label.full_text()

    def start(self) -> None:
        """Edit it; the focus goes back to where it is now."""
        self._editing, self._before = True, QApplication.focusWidget()
        self._label.hide()
        self.editor.setText(self.text())
        self.editor.show()
        self.editor.setFocus()
        self.editor.selectAll()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.KeyPress, QEvent.Type.ShortcutOverride) and event.key() == Qt.Key.Key_Escape:
            event.accept()  # before the window's own Escape
            if event.type() == QEvent.Type.KeyPress:
                self.editor.setText(self.text())
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
            if self.editor.text() != self.text():
                self.renamed.emit(self.editor.text())
