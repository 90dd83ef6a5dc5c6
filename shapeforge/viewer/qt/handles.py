"""Handles on the shape in hand: pull one and the rest follows; where it is let go it is pinned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QMenu

from shapeforge.viewer.display import Mark
from shapeforge.viewer.picking import Number, Pick, camera_axes
from shapeforge.viewer.pulling import MET, as_place, handles_of, nearest_point, off_by
from shapeforge.viewer.qt.view3d import CLICK_SLACK, View3D
from shapeforge.viewer.sculptor import Sculptor
from shapeforge.viewer.session import Session

GRAB_PIXELS = 11
FREE = "drag it, the rest follows; a click pins it where it is"
PINNED = "pinned here; drag it elsewhere, Ctrl+click or Delete takes the pin away"
PIN_HEAD = 13  # pixels from the tip of a pin up to the middle of its head


@dataclass(frozen=True, eq=False)
class Held:
    """A handle in hand: its template point, where it was seen, and where the point was or was held."""

    point: int
    seen: Float[np.ndarray, " 3"]
    start: Float[np.ndarray, " 3"]


class Handles:
    """Ties pulls in a view to the Session's pins.  ``let_go(words)`` is called when one was put, moved or taken off."""

    def __init__(self, session: Session, view: View3D, sculptor: Sculptor, let_go: Callable[[str], None]) -> None:
        self.session, self.view, self.sculptor, self.let_go = session, view, sculptor, let_go
        self.points = self.shown = np.zeros(0, int)
        self.places = self._seen = np.zeros((0, 3))
        self.held: Held | None = None
        self.pointed: int | None = None
        """The point whose handle is under the pointer."""
        self.menu: QMenu | None = None
        self._pressed: int | None = None
        self._moved = False
        view.hold = self._grab
        view.pulled.connect(self._pull)
        view.released.connect(self._let_handle_go)
        view.clicked.connect(self._click)
        view.hovered.connect(self._hover)
        view.menu_wanted.connect(self.open_menu)

    def follow(self, points: Float[np.ndarray, "K 3"], surface: Float[np.ndarray, "V 3"] | None = None) -> None:
        """The shape has these points now; the handle in hand stays the same template point.

        Where a mesh is on show, whose vertices are the ``surface``, handles sit on it and not beside it.  A pin that
        the shape does not reach stays where it was put.
        """
        pins = self.sculptor.pinned()
        if self.held is None:
            self.shown = handles_of(points, pinned=pins)
        self.points, self.places = points, points[self.shown]
        if surface is not None and len(surface):
            away = [((surface - place) ** 2).sum(axis=1).argmin() for place in self.places]
            self.places = np.asarray(surface, float)[away]
        self._seen = self.places.copy()
        for row, point in enumerate(self.shown):
            if point in pins and off_by(points, int(point), pins[int(point)]) > MET:
                self.places[row] = pins[int(point)]

    def at(self, x: Number, y: Number) -> int | None:
        """The point whose handle is seen at (x, y), the nearest one first."""
        pins, best, found = self.sculptor.pinned(), float(GRAB_PIXELS), None
        for k, place in zip(self.shown, self.places, strict=True):
            left, top = self.view.place_of(place)
            ups = (0, PIN_HEAD) if int(k) in pins else (0,)
            away = min(float(np.hypot(left - x, top - up - y)) for up in ups)
            if away < best:
                best, found = away, int(k)
        return found

    # ---- the hand ------------------------------------------------------------------------------------------------

    def _grab(self, x: float, y: float) -> bool:
        """Take hold of the handle under the pointer, if there is one."""
        self._pressed = point = self.at(x, y)
        if point is None:
            return False
        seen = self.places[np.flatnonzero(self.shown == point)[0]].copy()
        start = np.array(self.sculptor.pinned().get(point, self.points[point]), float)
        self.held, self._moved = Held(point, seen, start), False
        return True

    def _pull(self, x: float, y: float) -> None:
        if self.held is None:
            return
        left, top = self.view.place_of(self.held.seen)
        if not self._moved and np.hypot(*np.subtract(self.view.pressed_at, (x, y))) <= CLICK_SLACK:
            return
        self._moved = True
        camera, height = self.view.scene.camera, self.view.rectangles()[0][3]
        unit = 2 * camera.GetParallelScale() / height
        displacement = np.array([x - left, top - y]) * unit @ camera_axes(camera)[:2]
        self._put(self.held.point, self.held.start + displacement)

    def _let_handle_go(self) -> None:
        held, self.held = self.held, None
        if held is not None and self._moved:
            self._pressed = None
            self.let_go(f"{self.part_of(held.point)} pulled")

    def _click(self, _pick: Pick | None, keys: Qt.KeyboardModifier) -> None:
        """A handle that is clicked is pinned where it is; with Ctrl a pin is taken away."""
        point, self._pressed = self._pressed, None
        if point is None:
            return
        if keys & Qt.KeyboardModifier.ControlModifier:
            self.unpin(point)
        else:
            self.pin(point)

    def _hover(self, _pick: Pick | None) -> None:
        self.point_at(self.at(*self.view.pointer))

    def point_at(self, point: int | None) -> None:
        """The pointer is at the handle of a point (None: at none), here or in the list of pins."""
        if point == self.pointed:
            return
        self.pointed = point
        if point is None:
            self.view.plotter.unsetCursor()
            self.view.plotter.setToolTip("")
        else:
            self.view.plotter.setCursor(Qt.CursorShape.OpenHandCursor)
            words = PINNED if point in self.session.pins else FREE
            self.view.plotter.setToolTip(f"{self.part_of(point).capitalize()}: {words}")
        if self.view.shown.views:
            self.view.set_marks([self.marks()])

    def open_menu(self, x: float, y: float) -> None:
        """What can be done with the handle, or the place of the surface, at (x, y)."""
        point, pick = self.at(x, y), self.view.pick_near(x, y)
        if point is None and pick is not None:
            point = nearest_point(self.points, pick.position)
        if point is None and not self.session.pins:
            return
        if self.menu is not None:
            self.menu.deleteLater()
        self.menu = menu = QMenu(self.view)
        if point is not None and point in self.session.pins:
            menu.addAction("Take the pin away", lambda: self.unpin(point))
        elif point is not None:
            menu.addAction(f"Pin the {self.part_of(point)} here", lambda: self.pin(point))
        everything = menu.addAction("Take all pins away", self.unpin_all)
        everything.setEnabled(bool(self.session.pins))
        menu.popup(self.view.plotter.mapToGlobal(QPoint(round(x), round(y))))

    # ---- pins ----------------------------------------------------------------------------------------------------

    def part_of(self, point: int) -> str:
        """The name of the part that a point belongs to."""
        return str(self.sculptor.part_names[self.sculptor.part[point]])

    def _put(self, point: int, place: Float[np.ndarray, " 3"]) -> None:
        """Hold a point somewhere; it becomes the newest pin."""
        others = {k: at for k, at in self.session.pins.items() if k != point}
        self.session.pins = {**others, point: as_place(place)}

    def pin(self, point: int) -> None:
        """Hold a point where it is."""
        if point not in self.session.pins:
            self._put(point, self.points[point])
            self.let_go(f"{self.part_of(point)} pinned")

    def unpin(self, point: int) -> None:
        """Let a pinned point go: the shape is what the other pins and the sliders make of it."""
        if point in self.session.pins:
            self.session.pins = {k: at for k, at in self.session.pins.items() if k != point}
            self.let_go(f"{self.part_of(point)} unpinned")

    def unpin_newest(self) -> None:
        """Take away the pin under the pointer, else the one put last."""
        pins = self.sculptor.pinned() or self.session.pins
        self.unpin(self.pointed if self.pointed in pins else list(pins)[-1])

    def unpin_all(self) -> None:
        """Take all pins away."""
        self.session.pins = {}
        self.let_go("pins away")

    def marks(self) -> tuple[Mark, ...]:
        """Rings to pull at and pins, the one in hand with an arrow from where it was.

        From a pin that the shape does not reach a dashed line leads to where the point is seen."""
        marks, pins = [], self.sculptor.pinned()
        for k, place, seen in zip(self.shown, self.places, self._seen, strict=True):
            at, point = as_place(place), int(k)
            held = self.held is not None and self.held.point == point
            if held and self._moved:
                marks.append(Mark("arrow", as_place(self.held.seen), to=at))
            if point in pins:
                if off_by(self.points, point, pins[point]) > MET:
                    marks += [Mark("line", at, to=as_place(seen)), Mark("ring", as_place(seen))]
                marks.append(Mark("pin", at, text="held" if held or point == self.pointed else ""))
            else:
                marks.append(Mark("dot" if held or point == self.pointed else "ring", at))
        return tuple(marks)
