"""What tests of the Synthesize place do again and again."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QImage

from shapeforge.collection.colours import rgb

LEFT, RIGHT = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton
NONE, CONTROL = Qt.KeyboardModifier.NoModifier, Qt.KeyboardModifier.ControlModifier
LONG = 30_000


def layer_kinds(place) -> list[type]:
    return [type(layer) for layer in place.view.shown.views[0].layers]


def wait_for_mesh(place, qtbot) -> None:
    def there() -> bool:
        if place.session.status_kind == "error":  # not an AssertionError, for which Qt's clock would be run down
            raise RuntimeError(place.session.status)
        return place.made is not None and not place.made.preview

    qtbot.waitUntil(there, timeout=LONG)


def at(place: tuple[float, float]) -> QPoint:
    return QPoint(round(place[0]), round(place[1]))


def seen(place, qtbot) -> np.ndarray:
    """The pixels (h, w, 3) of the view, marks and words included, once it has been drawn."""
    qtbot.waitUntil(lambda: place.view.at_rest, timeout=LONG)
    return place.view.picture().astype(int)


def pixels(widget) -> np.ndarray:
    """The pixels (h, w, 3) of a widget."""
    image = widget.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


def shown_of(picture: np.ndarray, colour: str) -> np.ndarray:
    """Places (n, 2), x and y, of the pixels of just this colour."""
    return np.argwhere((picture == rgb(colour)).all(axis=2))[:, ::-1]


def hue_share(picture: np.ndarray, ink: np.ndarray) -> float:
    """The share of pixels that have the hue of an ink, however shaded."""
    length = np.linalg.norm(picture, axis=2)
    along = picture @ (ink / np.linalg.norm(ink.astype(float)))
    return float(((length > 60) & (along > 0.985 * length)).mean())


def drag(place, qtbot, row: int, by: tuple[int, int], *, let_go: bool = True) -> int:
    """Drag a handle of the view; which template point it is."""
    target, start = place.view.plotter, place.view.place_of(place.handles.places[row])
    qtbot.mousePress(target, LEFT, NONE, at(start))
    held = place.handles.held
    assert held is not None
    for share in (0.3, 0.6, 1.0):
        qtbot.mouseMove(target, at((start[0] + share * by[0], start[1] + share * by[1])))
    if let_go:
        qtbot.mouseRelease(target, LEFT, NONE, at((start[0] + by[0], start[1] + by[1])))
    return held.point


def towards(place, row: int, share: float = 0.6) -> tuple[int, int]:
    """By how many pixels a handle has to be dragged to come towards where a shape of the family has it."""
    sculptor, point = place.sculptor, int(place.handles.shown[row])
    alike = np.flatnonzero((sculptor.observations.exists == sculptor.exists()).all(axis=1))
    away = sculptor.positions[alike, point] - place.points[point]
    farthest = away[np.linalg.norm(away, axis=1).argmax()]
    start, end = (
        np.array(place.view.place_of(at)) for at in (place.points[point], place.points[point] + share * farthest)
    )
    return tuple(int(x) for x in np.round(end - start))


def row_of(place, point: int) -> int:
    return int(np.flatnonzero(place.handles.shown == point)[0])


def free_row(place) -> int:
    """A handle that is not pinned."""
    return next(i for i, point in enumerate(place.handles.shown) if int(point) not in place.session.pins)


def choose(menu, words: str, qtbot) -> None:
    """Click an entry of a menu."""
    qtbot.waitUntil(menu.isVisible)
    entry = next(action for action in menu.actions() if action.text() == words)
    qtbot.mouseClick(menu, LEFT, NONE, menu.actionGeometry(entry).center())


def slide(qtbot, slider, value: float) -> None:
    y, start, end = slider.height() - 10, slider.x_of(slider.value), slider.x_of(value)
    qtbot.mousePress(slider, LEFT, NONE, at((start, y)))
    qtbot.mouseMove(slider, at(((start + end) / 2, y)))
    qtbot.mouseMove(slider, at((end, y)))
    qtbot.mouseRelease(slider, LEFT, NONE, at((end, y)))
