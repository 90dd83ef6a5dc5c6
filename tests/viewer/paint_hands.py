"""Hands for the Paint place: real mouse and key events into the window."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QApplication

LEFT = Qt.MouseButton.LeftButton


class Painting:
    """The Paint place of a window, with hands."""

    def __init__(self, window, qtbot) -> None:
        self.window, self.session, self.qtbot = window, window.session, qtbot
        self.place = window.places["paint"]
        self.view, self.painter = self.place.view, self.place.painter
        self.target = self.view.plotter

    @property
    def labels(self) -> np.ndarray:
        return self.painter.state.labels

    def visible(self) -> np.ndarray:
        """Some faces whose centre is seen and clear of other faces."""
        seen: list[int] = []
        for face in np.random.default_rng(0).permutation(self.painter.mesh.n_faces)[:400].tolist():
            x, y = self.view.place_of(self.painter.surface.centres[face])
            hit = self.view.pick(round(x), round(y))
            if hit is not None and self.painter.face_of(hit.triangle) == face:
                seen.append(face)
        return np.array(seen)

    def at(self, face: int) -> QPoint:
        x, y = self.view.place_of(self.painter.surface.centres[face])
        return QPoint(round(x), round(y))

    def click(self, face: int, modifiers: Qt.KeyboardModifier = Qt.KeyboardModifier.NoModifier) -> None:
        self.qtbot.mouseClick(self.target, LEFT, modifiers, self.at(face))

    def drag(self, *places: QPoint, button=LEFT, modifiers=Qt.KeyboardModifier.NoModifier) -> None:
        self.qtbot.mousePress(self.target, button, modifiers, places[0])
        for place in places[1:]:
            move(self.target, place, button, modifiers)
        self.qtbot.mouseRelease(self.target, button, modifiers, places[-1])

    def key(self, key: Qt.Key, modifiers=Qt.KeyboardModifier.NoModifier) -> None:
        self.qtbot.keyClick(self.place.centre, key, modifiers)


def move(target, place: QPoint, button, modifiers) -> None:
    """A mouse move with a button held (QTest's own move forgets the modifiers)."""
    at = QPointF(place)
    event = QMouseEvent(
        QEvent.Type.MouseMove, at, QPointF(target.mapToGlobal(place)), Qt.MouseButton.NoButton, button, modifiers
    )
    QApplication.sendEvent(target, event)


def hands_of(window, qtbot) -> Painting:
    """Hands on the Paint place of a window, once its shape is drawn."""
    hands = Painting(window, qtbot)
    qtbot.waitUntil(lambda: hands.view.frames > 0, timeout=10000)
    window.activateWindow()
    hands.place.centre.setFocus()
    return hands
