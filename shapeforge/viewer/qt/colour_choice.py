"""Choosing the colour of a part: the palette's colours, those in use marked; any other; or the colour of its place."""

from __future__ import annotations

from collections.abc import Mapping

from PySide6.QtCore import QEvent, QPoint, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QPainter, QPen
from PySide6.QtWidgets import QAbstractButton, QColorDialog, QFrame, QWidget

from shapeforge.collection.colours import PARTS
from shapeforge.viewer.qt.theme import colours
from shapeforge.viewer.qt.widgets import button, column, label, row

COLUMNS = 4
SIDE = 30


class ColourButton(QAbstractButton):
    """A square of one colour that can be pressed; the chosen one has a frame, one in use by another part a dot."""

    def __init__(
        self, colour: str, tooltip: str, *, side: int = SIDE, chosen: bool = False, used: bool = False
    ) -> None:
        super().__init__()
        self.colour, self._side, self._chosen, self._used = colour, side, chosen, used
        self.setFixedSize(side, side)
        self.setToolTip(tooltip)
        self.setAccessibleName(tooltip)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)

    def sizeHint(self) -> QSize:
        return QSize(self._side, self._side)

    def paintEvent(self, event: QEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        gap = 1.0 if self._side < SIDE else 3.0
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(self.colour))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(gap, gap, -gap, -gap), 3, 3)
        if self._chosen or self.hasFocus() or self.underMouse():
            painter.setBrush(Qt.BrushStyle.NoBrush)
            ring = "accent" if self.hasFocus() or self._chosen else "text_2"
            painter.setPen(QPen(QColor(tokens[ring]), 1.5))
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.75, 0.75, -0.75, -0.75), 4.5, 4.5)
        if self._used:
            dark = QColor(self.colour).lightnessF() < 0.45
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor("#FFFFFF" if dark else "#1B1C1F"))
            painter.drawEllipse(QPointF(self.rect().center()) + QPointF(0.5, 0.5), 2.5, 2.5)
        painter.end()


class ColourChoice(QFrame):
    """A small sheet below what was clicked; arrows and Return choose, Escape closes.

    ``chosen`` says "#RRGGBB", or "" for the colour of the part's place.  ``used`` are the other parts' colours, each
    with the name of its part.
    """

    chosen = Signal(str)

    def __init__(self, parent: QWidget, part: str, present: str, used: Mapping[str, str]) -> None:
        super().__init__(parent, Qt.WindowType.Popup)
        self.setObjectName("sheet")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.buttons: list[ColourButton] = []
        for colour in PARTS:
            whose = used.get(colour, "")
            words = f"{colour}, the colour of {whose}" if whose else colour
            one = ColourButton(colour, words, chosen=colour == present, used=bool(whose))
            one.clicked.connect(lambda _=False, colour=colour: self._choose(colour))
            self.buttons.append(one)
        rows = [row(*self.buttons[i : i + COLUMNS], spacing=4) for i in range(0, len(PARTS), COLUMNS)]
        self.other = button("Another…", kind="link", tooltip="Any colour")
        self.other.clicked.connect(lambda: self._ask(present))
        self.own = button("Reset", kind="link", tooltip="The colour that parts at this place of the list have")
        self.own.clicked.connect(lambda: self._choose(""))
        title = label(f"Colour of {part}", "strong")
        self.setLayout(column(title, *rows, row(self.other, None, self.own), spacing=6, margins=(12, 10, 12, 8)))

    def open_below(self, place: QPoint) -> None:
        """Show it with its corner at a place of the screen, kept on it."""
        self.adjustSize()
        room = self.screen().availableGeometry()
        x = min(place.x(), room.right() - self.width() - 4)
        y = min(place.y(), room.bottom() - self.height() - 4)
        self.move(max(x, room.left() + 4), max(y, room.top() + 4))
        self.show()
        next((one for one in self.buttons if one._chosen), self.buttons[0]).setFocus()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        step = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Up: -COLUMNS, Qt.Key.Key_Down: COLUMNS}
        here = next((i for i, one in enumerate(self.buttons) if one.hasFocus()), None)
        if event.key() in step and here is not None:
            self.buttons[min(max(here + step[Qt.Key(event.key())], 0), len(self.buttons) - 1)].setFocus()
        elif event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and here is not None:
            self.buttons[here].click()
        elif event.key() == Qt.Key.Key_Escape:
            self.close()
        else:
            super().keyPressEvent(event)

    def _choose(self, colour: str) -> None:
        self.close()
        self.chosen.emit(colour)

    def _ask(self, present: str) -> None:
        dialog = QColorDialog(QColor(present), self.parentWidget().window())
        dialog.setOption(QColorDialog.ColorDialogOption.DontUseNativeDialog)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        emit = self.chosen.emit
        dialog.colorSelected.connect(lambda colour: emit(colour.name().upper()))
        self.hide()
        dialog.finished.connect(lambda _: self.close())
        dialog.open()
