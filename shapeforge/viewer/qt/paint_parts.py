"""Pieces of the Paint place: the palette of parts, the column of tools, the bar of shares, the history as pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from PySide6.QtCore import QEvent, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QPainter, QPen, QPixmap
from PySide6.QtWidgets import QAbstractButton, QApplication, QFrame, QHBoxLayout, QVBoxLayout, QWidget

from shapeforge.viewer.painter import TOOL_NAMES
from shapeforge.viewer.qt.colour_choice import ColourButton
from shapeforge.viewer.qt.controls import Clickable, EditableName
from shapeforge.viewer.qt.icons import pixmap, set_icon
from shapeforge.viewer.qt.theme import colours, font
from shapeforge.viewer.qt.widgets import (
    ElidedLabel,
    Picture,
    button,
    clear,
    column,
    icon_label,
    label,
    row,
    separator,
    set_style,
)

TOOL_KEYS: dict[str, str] = {
    "brush": "B", "eraser": "E", "fill": "F", "piece": "P", "lasso": "L", "scribble": "S", "eyedropper": "I",
}  # fmt: skip
TOOL_HINTS: dict[str, str] = {
    "brush": "Paints along the surface under the ring.",
    "eraser": "Takes paint away.",
    "fill": "Paints the face under the pointer and all around it up to the next crease, or the edge of its patch.",
    "piece": "Paints the whole loose piece under the pointer with the current part.",
    "lasso": "Paints what is inside a line drawn around it: what is seen, or through and through (T).",
    "scribble": "One stroke on each part, the rest is filled in.",
    "eyedropper": "Takes the part under the pointer as the current one.",
}


class ShareBar(QWidget):
    """A thin bar of coloured shares (fractions of the whole); the rest is unpainted."""

    def __init__(self, height: int = 4) -> None:
        super().__init__()
        self._height = height
        self._shares: list[tuple[str, float]] = []
        self.setFixedHeight(height)

    def set_shares(self, shares: Sequence[tuple[str, float]]) -> None:
        """Show (colour, fraction) one after the other."""
        self._shares = list(shares)
        self.update()

    def paintEvent(self, event: QEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        radius = self._height / 2
        whole = QRectF(self.rect())
        painter.setBrush(QColor(colours(self)["separator_strong"]))
        painter.drawRoundedRect(whole, radius, radius)
        left = 0.0
        for colour, share in self._shares:
            painter.setBrush(QColor(colour))
            width = share * whole.width()
            if share > 0:
                painter.drawRoundedRect(QRectF(left, 0, max(width, self._height), self._height), radius, radius)
                if left > 0:  # square where two shares meet
                    painter.drawRect(QRectF(left, 0, min(radius, width), self._height))
            left += width
        painter.end()


class PartRow(Clickable):
    """One part: swatch, name, share, eye and key.  Double-click renames."""

    eye_clicked = Signal()
    renamed = Signal(str)
    ctrl_clicked = Signal()
    colour_clicked = Signal()

    def __init__(self, name: str, colour: str, key: str) -> None:
        # Made before QFrame's own start because the layout is its argument; signals are tied after it.
        self.name = EditableName(name)
        self.editor = self.name.editor
        self.share = label("0%", "text2")
        self.eye = button(icon="eye", kind="icon", tooltip="Show or hide this part  (Shift+H: the current one)")
        self.eye.setStyleSheet("min-width: 20px; max-width: 20px; min-height: 18px; max-height: 18px;")
        self.eye.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.bar = ShareBar(3)
        self.colour = colour
        self.swatch = ColourButton(colour, f"Colour of {name}  (Shift+C)", side=18)
        top = row(self.swatch, 2, self.name, None, self.share, self.eye, spacing=6)
        if key:
            top.addWidget(label(key, "keycap"))
        below = row(self.bar, margins=(26, 0, 0, 0))
        super().__init__(column(top, below, spacing=3, margins=(8, 4, 8, 5)), "row")
        self.eye.clicked.connect(self.eye_clicked)
        self.swatch.clicked.connect(self.colour_clicked)
        self.name.renamed.connect(self.renamed)
        self.setFixedHeight(38)
        self.setToolTip("Click to paint with it, double-click to rename, Ctrl-click to select a second")
        self.double_clicked.connect(self.rename)

    def mouseReleaseEvent(self, event: object) -> None:
        if QApplication.keyboardModifiers() & Qt.KeyboardModifier.ControlModifier:
            self.ctrl_clicked.emit()
        else:
            super().mouseReleaseEvent(event)

    def set_share(self, share: float) -> None:
        """Show a fraction of the area."""
        self.share.setText(f"{share:.0%}")
        self.bar.set_shares([(self.colour, share)])

    def set_hidden(self, hidden: bool) -> None:
        """Shut or open the eye."""
        set_icon(self.eye, "eye_off" if hidden else "eye", "text_off" if hidden else "text_2", 14)

    def rename(self) -> None:
        """Edit the name in place."""
        self.name.start()


class ToolButton(QAbstractButton):
    """A 34-px button of the tool column: icon and, small in the corner, its key.  ``primary`` is the tool in hand."""

    def __init__(self, icon: str, key: str, tooltip: str) -> None:
        super().__init__()
        self.icon_name, self.key, self.primary = icon, key, True
        self.setCheckable(True)
        self.setFixedSize(36, 36)
        self.setToolTip(tooltip)
        self.setAccessibleName(tooltip.split("  ")[0])
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)

    def nextCheckState(self) -> None:
        """A click asks only; what is in hand is shown by the Session: a click on that must not put it away."""

    def paintEvent(self, event: QEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
        held = self.isChecked()
        ground = "accent" if held and self.primary else "accent_ground" if held else "control_hover"
        painter.setPen(QPen(QColor(tokens["accent"]), 1) if self.hasFocus() else Qt.PenStyle.NoPen)
        if held or self.underMouse():
            painter.setBrush(QColor(tokens[ground]))
        painter.drawRoundedRect(QRectF(0.5, 0.5, 35, 35), 5, 5)
        role = "on_accent" if held and self.primary else "accent_text" if held else "text_2"
        role = role if self.isEnabled() else "text_off"
        painter.drawPixmap(8, 8, pixmap(self.icon_name, tokens[role], 18, self.devicePixelRatioF()))
        painter.setFont(font(9))
        painter.setPen(QColor(tokens["on_accent" if held and self.primary else "text_off"]))
        painter.drawText(QRectF(18, 20, 15, 13), Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignBottom, self.key)
        painter.end()


class ToolColumn(QFrame):
    """The tools, docked at the left of the view; each shows its key."""

    chosen = Signal(str)
    mirror_toggled = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("tools")
        self.setFixedWidth(49)
        self.buttons: dict[str, ToolButton] = {}
        box = QVBoxLayout(self)
        box.setContentsMargins(6, 6, 7, 6)
        box.setSpacing(3)
        for tool, key in TOOL_KEYS.items():
            if tool == "scribble":
                box.addWidget(separator())
            one = ToolButton(tool, key, f"{TOOL_NAMES[tool]}  ({key})\n{TOOL_HINTS[tool]}")
            one.clicked.connect(lambda _=False, tool=tool: self.chosen.emit(tool))
            self.buttons[tool] = one
            box.addWidget(one)
        box.addWidget(separator())
        self.mirror = ToolButton("mirror", "M", "Mirror  (M)\nPaints the opposite side too.")
        self.mirror.primary = False
        self.mirror.clicked.connect(self.mirror_toggled)
        box.addWidget(self.mirror)
        box.addStretch(1)

    def show_state(self, tool: str, mirror: bool) -> None:
        """Mark the tool in hand and whether mirroring is on."""
        for name, one in self.buttons.items():
            one.setChecked(name == tool)
        self.mirror.setChecked(mirror)

    def paintEvent(self, event: QEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(colours(self)["panel"]))
        painter.fillRect(self.width() - 1, 0, 1, self.height(), QColor(colours(self)["separator"]))
        painter.end()


class HistoryCard(Clickable):
    """One state of the history as a picture with a word below."""

    SIZE = (84, 84)

    def __init__(self, text: str, icon: str, current: bool, undone: bool) -> None:
        self.picture = Picture((64, 52))
        words = row(spacing=4, margins=(6, 0, 4, 0))
        if icon:
            words.addWidget(icon_label(icon, "text" if current else "text_2", 12))
        name = ElidedLabel(text, "caption_off" if undone else "caption")
        if current:
            set_style(name, "role", "strong")
            name.setStyleSheet("font-size: 11px;")
        words.addWidget(name, 1)
        inside = column(row(None, self.picture, None), words, spacing=2, margins=(0, 5, 0, 5))
        super().__init__(inside, "card", tooltip="Undone: click to do it again" if undone else "Click to go back here")
        self.setFixedSize(*self.SIZE)
        self.set_current(current)

    def set_pixmap(self, pixmap: QPixmap | None) -> None:
        """Show the picture of this state."""
        self.picture.set_pixmap(pixmap)


class HistoryStrip(QFrame):
    """The newest states that fit side by side, the present one marked, what was undone after it and pale."""

    chosen = Signal(int)

    def __init__(self, title: str) -> None:
        super().__init__()
        self.caption = label("", "caption")
        self.saved = label("", "caption_ok")
        words = column(None, label(title, "heading"), self.caption, self.saved, None, spacing=2)
        left = QWidget()
        left.setLayout(words)
        left.setFixedWidth(92)
        self._cards = QHBoxLayout()
        self._cards.setSpacing(8)
        self._cards.setContentsMargins(0, 0, 0, 0)
        outer = row(left, self._cards, None, spacing=0, margins=(16, 9, 12, 9))
        self.setLayout(outer)
        self.cards: dict[int, HistoryCard] = {}

    def show_states(
        self, states: Sequence[tuple[str, str]], present: int, picture: Callable[[int], QPixmap | None]
    ) -> None:
        """``states`` are (word, icon) of state 0, 1, …; ``present`` is the one in effect."""
        room = max((self.width() - 130) // (HistoryCard.SIZE[0] + 8), 3)
        last = min(len(states), max(present + 2, room))
        first = max(last - room, 0)
        clear(self._cards)
        self.cards = {}
        for i in range(first, last):
            text, icon = states[i]
            undone = i > present
            card = HistoryCard(f"redo: {text}" if i == present + 1 else text, icon, i == present, undone)
            card.set_pixmap(_faded(picture(i)) if undone else picture(i))
            card.clicked.connect(lambda i=i: self.chosen.emit(i))
            self._cards.addWidget(card)
            self.cards[i] = card

    def refresh_pictures(self, picture: Callable[[int], QPixmap | None], present: int) -> None:
        """Show pictures that have arrived meanwhile."""
        for i, card in self.cards.items():
            card.set_pixmap(_faded(picture(i)) if i > present else picture(i))


def _faded(pixmap: QPixmap | None) -> QPixmap | None:
    if pixmap is None:
        return None
    faded = QPixmap(pixmap.size())
    faded.setDevicePixelRatio(pixmap.devicePixelRatio())
    faded.fill(Qt.GlobalColor.transparent)
    painter = QPainter(faded)
    painter.setOpacity(0.35)
    painter.drawPixmap(0, 0, pixmap)
    painter.end()
    return faded


def percent(share: float) -> str:
    """A share as whole percent, "<1%" for what is not nothing."""
    return "<1%" if 0 < share < 0.005 else f"{share:.0%}"


def inside_polygon(places: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Which places (n, 2) lie inside the closed polygon (m, 2), by the even-odd rule."""
    x, y = places[:, :1], places[:, 1:]
    a, b = polygon, np.roll(polygon, -1, axis=0)
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
    return (crosses & (x < at)).sum(axis=1) % 2 == 1
