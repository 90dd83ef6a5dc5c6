"""Completing a painting beside the hand that paints: large meshes are cut in a thread, the newest strokes win."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from jaxtyping import Int

from shapeforge.viewer import spreading
from shapeforge.viewer.painter import Painter

AT_ONCE = 30000  # faces up to which the cut takes no longer than a blink


class Completion:
    """Fills in what is unpainted from the strokes made by hand.

    ``on_result()`` is called from the thread when something lies ready; then `take` applies it, on the thread of the
    painter, unless strokes were made meanwhile: then it is computed again from those.
    """

    def __init__(self, painter: Painter, on_result: Callable[[], None]) -> None:
        self.painter, self.on_result = painter, on_result
        self._thread: threading.Thread | None = None
        self._ready: tuple[object, Int[np.ndarray, " F"], Int[np.ndarray, " F"]] | None = None
        self._wanted = False

    @property
    def busy(self) -> bool:
        """Whether something is still being computed or waits to be applied."""
        return self._thread is not None

    def ask(self) -> bool:
        """Complete now, or (a large mesh) begin to; True when it was done at once and changed something."""
        painter = self.painter
        if painter.mesh.n_faces <= AT_ONCE:
            return painter.complete(by_hand_only=True)
        self._wanted = True
        self._begin()
        return False

    def forget(self) -> None:
        """Another shape, or the end: what is under way is for nobody."""
        self._wanted = False

    def join(self, seconds: float | int) -> None:
        """Wait for the thread (a closing window)."""
        self.forget()
        if self._thread is not None:
            self._thread.join(seconds)

    def take(self) -> bool:
        """Apply what lies ready; True when it changed the painting."""
        self._thread, ready, self._ready = None, self._ready, None
        painter = self.painter
        if not self._wanted or painter.name is None:
            return False
        if ready is None or ready[0] is not painter.mesh or painter.state.is_drawing:
            if not painter.state.is_drawing:  # the end of the stroke asks again
                self._begin()
            return False
        if not np.array_equal(ready[1], painter.strokes_only()):
            self._begin()
            return False
        self._wanted = False
        return painter.apply_completion(ready[2])

    def _begin(self) -> None:
        if self._thread is not None:
            return
        painter = self.painter
        seeds = painter.strokes_only()
        if len(np.unique(seeds[seeds >= 0])) < 2:
            self._wanted = False
            return
        mesh, ground = painter.mesh, painter.ground

        def work() -> None:
            try:
                self._ready = (mesh, seeds, spreading.complete(ground, seeds))
            except (ValueError, MemoryError):
                self._wanted = False
            self.on_result()

        self._thread = threading.Thread(target=work, name="completing", daemon=True)
        self._thread.start()
