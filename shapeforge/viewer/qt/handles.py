"""Handles on the shape in hand: pull one, the sliders move so that the rest follows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from shapeforge.viewer.display import Mark
from shapeforge.viewer.picking import camera_axes
from shapeforge.viewer.pulling import handles_of, pull
from shapeforge.viewer.qt.view3d import View3D
from shapeforge.viewer.sculptor import Sculptor
from shapeforge.viewer.session import Session

GRAB_PIXELS = 11


class Handles:
    """Ties pulls in a view to the Session's sliders.  ``locked()`` names sliders to leave alone; ``let_go(words)`` is
    called when a handle is let go."""

    def __init__(
        self, session: Session, view: View3D, sculptor: Sculptor, locked: Callable[[], frozenset[int]],
        let_go: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.session, self.view, self.sculptor = session, view, sculptor
        self.locked, self.let_go = locked, let_go
        self.shown = np.zeros(0, int)
        self.places = np.zeros((0, 3))
        self.held: tuple[int, np.ndarray, Callable[[np.ndarray], dict[int, float]]] | None = None
        view.hold = self._grab
        view.pulled.connect(self._pull)
        view.released.connect(self._let_handle_go)

    def follow(self, points: Float[np.ndarray, "K 3"], surface: Float[np.ndarray, "V 3"] | None = None) -> None:
        """The shape has these points now; the handle in hand stays the same template point.

        Where a mesh is on show, whose vertices are the ``surface``, handles sit on it and not beside it.
        """
        if self.held is None:
            self.shown = handles_of(points)
        self.places = points[self.shown]
        if surface is not None and len(surface):
            away = [((surface - place) ** 2).sum(axis=1).argmin() for place in self.places]
            self.places = np.asarray(surface, float)[away]

    def _grab(self, x: float, y: float) -> bool:
        """Take hold of the handle under the pointer, if there is one."""
        for k, at in zip(self.shown, self.places, strict=True):
            place = self.view.place_of(at)
            if np.hypot(place[0] - x, place[1] - y) < GRAB_PIXELS:
                self.held = (int(k), at.copy(), pull(self.sculptor, int(k), self.locked()))
                return True
        return False

    def _pull(self, x: float, y: float) -> None:
        if self.held is None:
            return
        _, start, wanted = self.held
        place = self.view.place_of(start)
        camera, height = self.view.scene.camera, self.view.rectangles()[0][3]
        unit = 2 * camera.GetParallelScale() / height
        displacement = np.array([x - place[0], place[1] - y]) * unit @ camera_axes(camera)[:2]
        self.session.sliders = wanted(displacement)

    def _let_handle_go(self) -> None:
        if self.held is not None:
            part = self.sculptor.part_names[self.sculptor.part[self.held[0]]]
            self.held = None
            self.let_go(f"{part} pulled")

    def marks(self) -> tuple[Mark, ...]:
        """The handles, the one in hand filled and with an arrow from where it was."""
        marks = []
        for k, place in zip(self.shown, self.places, strict=True):
            at = tuple(float(x) for x in place)
            held = self.held is not None and self.held[0] == k
            if held:
                marks.append(Mark("arrow", tuple(float(x) for x in self.held[1]), to=at))
            marks.append(Mark("dot" if held else "ring", at))
        return tuple(marks)
