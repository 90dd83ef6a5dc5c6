"""The rail at the left: the five places in the order of the pipeline, each with a mark that says how far it is."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, QTimer
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QWidget

from shapeforge.viewer.actions import PLACE_NAMES, Actions, place_mark
from shapeforge.viewer.qt import icons
from shapeforge.viewer.qt.bind import ENABLING, Binding, native
from shapeforge.viewer.qt.theme import RAIL, colours, font
from shapeforge.viewer.qt.widgets import button, column, icon_label, row
from shapeforge.viewer.session import PLACES


class PlaceButton(QAbstractButton):
    """Icon, name and mark of a place: a tick is done, a ring running, ! stale, a lock not yet possible."""

    def __init__(self, place: str) -> None:
        super().__init__()
        self.place = place
        self.setText(PLACE_NAMES[place])
        self.setCheckable(True)
        self.setFixedSize(RAIL - 13, 60)
        self.mark = ""
        self._turn = 0
        self._timer = QTimer(self)
        self._timer.setInterval(60)
        self._timer.timeout.connect(self._spin)

    def sizeHint(self) -> QSize:
        return QSize(RAIL - 13, 60)

    def set_mark(self, mark: str) -> None:
        """Show another mark: done, running, stale, locked or ""."""
        self.mark = mark
        if mark == "running":
            self._timer.start()
        else:
            self._timer.stop()
        self.update()

    def _spin(self) -> None:
        self._turn = (self._turn + 20) % 360
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        tokens = colours(self)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        locked = self.mark == "locked"
        ground = ""
        if self.isChecked():
            ground = tokens["accent_ground"]
        elif self.underMouse() and not locked:
            ground = tokens["control"]
        if ground or self.hasFocus():
            painter.setBrush(QColor(ground) if ground else Qt.BrushStyle.NoBrush)
            painter.setPen(QPen(QColor(tokens["accent"]), 1) if self.hasFocus() and not ground else Qt.PenStyle.NoPen)
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5), 5, 5)
        role = "text_off" if locked else "accent_text" if self.isChecked() else "text_2"
        x = (self.width() - 20) // 2
        painter.drawPixmap(x, 10, icons.pixmap(self.place, tokens[role], 20))
        painter.setFont(font(11, 500))
        painter.setPen(QColor(tokens["text_off" if locked else "text" if self.isChecked() else "text_2"]))
        painter.drawText(QRectF(0, 35, self.width(), 18), Qt.AlignmentFlag.AlignCenter, self.text())
        self._paint_mark(painter, tokens)

    def _paint_mark(self, painter: QPainter, tokens: dict[str, str]) -> None:
        centre = QPointF(self.width() - 15, 12)
        painter.setPen(Qt.PenStyle.NoPen)
        if self.mark == "locked":
            painter.drawPixmap(round(centre.x() - 5), 7, icons.pixmap("lock", tokens["text_off"], 11))
        elif self.mark == "running":
            painter.setPen(QPen(QColor(tokens["accent"]), 2, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawArc(QRectF(centre.x() - 5, centre.y() - 5, 10, 10), -self._turn * 16, 270 * 16)
        elif self.mark in ("done", "stale"):
            painter.setBrush(QColor(tokens["ok" if self.mark == "done" else "warning"]))
            painter.drawEllipse(centre, 6.5, 6.5)
            if self.mark == "done":
                painter.drawPixmap(
                    round(centre.x() - 5), round(centre.y() - 5), icons.pixmap("check", tokens["window"], 10)
                )
            else:
                painter.setFont(font(11, 600))
                painter.setPen(QColor(tokens["window"]))
                painter.drawText(QRectF(centre.x() - 7, centre.y() - 7, 14, 14), Qt.AlignmentFlag.AlignCenter, "!")


class Rail(QWidget):
    """The five places and, at the foot, the theme and the help."""

    def __init__(self, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.setObjectName("rail")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setFixedWidth(RAIL)
        self._actions = actions
        self.places = {place: PlaceButton(place) for place in PLACES}
        for place, one in self.places.items():
            one.clicked.connect(lambda _=False, place=place: self._go(place))
        self.theme_button = button(icon="sun", kind="icon")
        self.theme_button.clicked.connect(lambda: actions.run("theme"))
        self.help_button = button(icon="help", kind="icon", tooltip=f"Keyboard shortcuts ({native('F1')})")
        self.help_button.clicked.connect(lambda: actions.run("help"))
        top = column(*self.places.values(), spacing=4)
        self.setLayout(
            column(
                row(None, icon_label("logo", "accent", 28), None, margins=(0, 14, 0, 14)),
                row(None, top, None),
                None,
                row(None, self.theme_button, None),
                row(None, self.help_button, None),
                spacing=2,
                margins=(0, 0, 0, 10),
            )
        )
        binding.on((*ENABLING, "stage"), self._show)
        binding.on(("theme",), self._show_theme)

    def _go(self, place: str) -> None:
        self._actions.run(f"go_{place}")
        self._show()

    def _show(self) -> None:
        session = self._actions.session
        for number, (place, one) in enumerate(self.places.items(), start=1):
            mark, why = place_mark(session, place)
            one.set_mark(mark)
            one.setChecked(session.project is not None and place == session.place)
            text = f"{PLACE_NAMES[place]}  ({native(f'Ctrl+{number}')})"
            one.setToolTip(f"{text}\n{why}" if why else text)

    def _show_theme(self) -> None:
        dark = self._actions.session.theme == "dark"
        icons.set_icon(self.theme_button, "sun" if dark else "moon")
        self.theme_button.setToolTip("Light theme" if dark else "Dark theme")
