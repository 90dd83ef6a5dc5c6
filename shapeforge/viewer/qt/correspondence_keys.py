"""The Correspondence place by keyboard: from shape to shape, and a point moved along the surface."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from shapeforge.viewer.actions import YES, Action, Verdict
from shapeforge.viewer.picking import project
from shapeforge.viewer.session import Session

STEPS = {
    "Left": (-1, 0, "to the left"), "Right": (1, 0, "to the right"), "Up": (0, -1, "above"), "Down": (0, 1, "below")
}  # fmt: skip
TRIED = 40
"""Points about the middle of a shape of which the first one that is seen is picked."""


class PointKeys:
    """Arrows go to another shape, Shift and arrows move the picked point, M measures from it, S selects the shape."""

    def __init__(self, place: Any) -> None:
        self.place = place

    def actions(self) -> list[Action]:
        """The actions, for the table."""
        tell = "Pick a point in the middle of the shape, then move it along the surface"
        found = [
            self._action("measure", "Measure from here", self.measure, "M",
                         "Keep the first point and move a second one (Shift and arrows) to measure to", self.has_point),
            self._action("select_shape", "Select for the overlay", self.select, "S",
                         "Select the shape with the frame for the overlay, or no longer (Ctrl-click)", self.has_shape),
        ]  # fmt: skip
        for key, (right, down, where) in STEPS.items():
            go, move = partial(self.step_shape, right, down), partial(self.step_point, right, down)
            shape, point = f"shape_{key.lower()}", f"point_{key.lower()}"
            found.append(self._action(shape, f"Shape {where}", go, key, f"Go to the shape {where}"))
            found.append(self._action(point, f"Point {where}", move, f"Shift+{key}", tell, self.has_shape))
        return found

    def _action(
        self, name: str, text: str, run: Callable[[], None], key: str, tooltip: str,
        enabled: Callable[[Session], Verdict] = lambda _s: YES,
    ) -> Action:  # fmt: skip
        return Action(name, text, lambda _s: run(), enabled, key, tooltip, "", "correspondence")

    def step_shape(self, right: int, down: int) -> None:
        """Go to the shape beside, above or below; over the edge of the page to the next one."""
        place = self.place
        if place.overlaid or not place.order:
            return
        if place.session.shape not in place.names:
            place.session.shape = place.names[0]
            return
        at = place.order.index(place.session.shape) + right + down * place.view.shown.columns
        if 0 <= at < len(place.order):
            place.session.shape = place.order[at]

    def step_point(self, right: int, down: int) -> None:
        """Move the picked point (the second one, when there is one) to the next template point in that direction."""
        place = self.place
        name = place.session.shape
        if place.overlaid or name not in place.names:
            return
        cell, positions = place.names.index(name), place.box.known(name).positions
        there = np.flatnonzero(np.isfinite(positions).all(axis=1))
        now = place.session.picked if place.second is None else place.second
        x, y, width, height = place.view.rectangles()[cell]
        flat = project(place.view.scene.camera, positions[there], (x, y, width, height))
        if now is None or now not in there:
            middle = np.linalg.norm(flat - (x + width / 2, y + height / 2), axis=1)
            seen = [k for k in middle.argsort()[:TRIED] if self._is_seen(flat[k], positions[there[k]], cell)]
            place.pick(int(there[(seen or [int(middle.argmin())])[0]]), second=False)
            return
        way = flat - flat[int(np.flatnonzero(there == now)[0])]
        along = way @ (right, down)
        aside = np.abs(way @ (down, right))
        # on the surface: far in depth is as far as far to the side
        apart = np.linalg.norm(positions[there] - positions[now], axis=1)
        cost = np.where((along > 1.0) & (along >= aside), apart, np.inf)
        if np.isfinite(cost).any():
            place.pick(int(there[cost.argmin()]), second=place.second is not None)

    def _is_seen(self, at: np.ndarray, position: np.ndarray, cell: int) -> bool:
        found = self.place.view.pick(float(at[0]), float(at[1]))
        return found is not None and found.view == cell and bool(np.abs(found.position - position).max() < 0.03)

    def measure(self) -> None:
        """Begin a second point where the first one is, or give it up."""
        place = self.place
        place.second = place.session.picked if place.second is None else None
        place.show()

    def select(self) -> None:
        """Select the shape with the frame for the overlay, or no longer."""
        self.place.select(self.place.session.shape)

    def has_point(self, session: Session) -> tuple[bool, str]:
        """Whether a first point is picked."""
        return YES if session.picked is not None else (False, "Pick a point first (Shift and arrows).")

    def has_shape(self, session: Session) -> tuple[bool, str]:
        """Whether one of the shapes shown is the chosen one."""
        place = self.place
        if place.overlaid:
            return False, "Go back to all shapes first (O)."
        return YES if session.shape in place.names else (False, "Go to a shape first (arrow keys).")
