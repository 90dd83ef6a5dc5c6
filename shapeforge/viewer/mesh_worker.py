"""Meshes of new shapes, made in a thread of their own: always the newest wish."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.assemble import synthesize as synthesize_mesh
from shapeforge.viewer.session import Session


@dataclass(frozen=True, eq=False)
class Made:
    """A mesh that came from the worker: for which wish, how fine, and the training shape nearest to it."""

    wish: int
    shape: SynthesizedShape
    preview: bool
    nearest: str
    nearest_distance: float


class MeshWorker:
    """A thread that makes the mesh of the newest wish; wishes overtaken meanwhile are forgotten.

    ``nearest(points)`` names the training shape nearest to a draw and how far it is; ``arrived()`` is called from the
    thread when ``take()`` has something new.
    """

    def __init__(
        self, session: Session, nearest: Callable[[np.ndarray], tuple[str, float]], arrived: Callable[[], None]
    ) -> None:
        self._session, self._nearest, self._arrived = session, nearest, arrived
        self._wake = threading.Condition()
        self._wish: tuple[int, np.ndarray, np.ndarray, bool] | None = None
        self._result: Made | Exception | None = None
        self._closed = False
        self._sources: tuple[Any, Any] = (None, None)
        self._retrieved: tuple[Any, np.ndarray | None] = (None, None)
        self.busy = False
        self._thread = threading.Thread(target=self._run, name="meshes", daemon=True)
        self._thread.start()

    def ask(self, wish: int, points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], preview: bool) -> None:
        """Make this next; a wish not yet begun is replaced."""
        with self._wake:
            self._wish = (wish, points, exists, preview)
            self.busy = True
            self._wake.notify()

    def take(self) -> Made | Exception | None:
        """The newest result not taken yet: a mesh, or what went wrong."""
        with self._wake:
            result, self._result = self._result, None
            return result

    def close(self, wait: float = 5.0) -> None:
        """Stop; waits for the mesh being made, at most ``wait`` seconds."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join(wait)

    def _run(self) -> None:
        while True:
            with self._wake:
                while self._wish is None and not self._closed:
                    self.busy = False
                    self._wake.wait()
                if self._closed:
                    return
                wish, self._wish = self._wish, None
            try:
                result: Made | Exception = self._make(*wish)
            except Exception as error:  # whatever it is, the window has to say it and go on
                result = error
            with self._wake:
                self._result = result
                self.busy = self._wish is not None
                closed = self._closed
            if not closed:
                self._arrived()

    def _make(self, wish: int, points: np.ndarray, exists: Bool[np.ndarray, " L"], preview: bool) -> Made:
        from shapeforge.stages_synthesis import sources_of
        from shapeforge.synthesis.retrieve import retrieve

        project = self._session.project
        if self._sources[0] != (str(project.path), project.fit_id):
            self._sources = ((str(project.path), project.fit_id), sources_of(project))
        sources = self._sources[1]
        # While a slider moves the parts keep their origin, else they flicker from one training shape to another.
        key = exists.tobytes()
        if not preview or self._retrieved[0] != key:
            self._retrieved = (key, retrieve(points, exists, sources).shape)
        shape = synthesize_mesh(points, exists, sources, preview=preview, shapes=self._retrieved[1])
        nearest, distance = self._nearest(points)
        return Made(wish, shape, preview, nearest, distance)
