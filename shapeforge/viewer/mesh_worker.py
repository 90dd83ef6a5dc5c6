"""Meshes of new shapes, made in a thread of their own: always the newest wish."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.assemble import synthesize as synthesize_mesh
from shapeforge.viewer.resemblance import resemblance
from shapeforge.viewer.session import Session

AHEAD, REST = 16, 1.0
"""So many shapes, the nearest to the newest wish, are read before they are wanted, after so many seconds of rest."""
COARSE = 0.014
"""Step (diagonals) of the lattice of previews from scratch: an eighth of the work or less."""


@dataclass(frozen=True, eq=False)
class Wish:
    """A mesh that is wanted: its ``number``, the draw, whether a ``preview`` will do, parts that are to be ``taken``
    from a shape of the user's choice ({part: name}), how it is made (see ``sculptor.Recipe``), and which parts (L,) are
    made ``symmetric`` where the family has them so."""

    number: int
    points: Float[np.ndarray, "K 3"]
    exists: Bool[np.ndarray, " L"]
    preview: bool
    taken: Mapping[int, str] = field(default_factory=dict)
    route: str = "parts"
    union: bool = False
    symmetric: bool | Bool[np.ndarray, " L"] = True


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
    thread when ``take()`` has something new; ``prepare()`` when there is nothing to do after a wish.
    """

    def __init__(
        self,
        session: Session,
        nearest: Callable[[np.ndarray], tuple[str, float]],
        arrived: Callable[[], None],
        prepare: Callable[[], object] | None = None,
    ) -> None:
        self._session, self._nearest, self._arrived = session, nearest, arrived
        self._prepare, self._prepared = prepare, prepare is None
        self._wake = threading.Condition()
        self._wish: Wish | None = None
        self._result: Made | Exception | None = None
        self._closed = False
        self._sources: tuple[Any, Any] = (None, None)
        self._makers: dict[tuple[str, bool], Callable[..., SynthesizedShape]] = {}
        self._retrieved: tuple[Any, np.ndarray | None] = (None, None)
        self._current: tuple[int, bool] | None = None
        self._besides: list[Wish] = []
        self._ahead: list[int] = []
        self._made_besides: dict[int, Made] = {}
        self._asked_besides = 0
        self.busy = False
        self._thread = threading.Thread(target=self._run, name="meshes", daemon=True)
        self._thread.start()

    def ask(self, wish: Wish) -> None:
        """Make this next; a wish not yet begun is replaced, one under way is not made twice."""
        with self._wake:
            if self._current == (wish.number, wish.preview):
                self._wish = None
                return
            self._wish = wish
            self.busy = True
            self._wake.notify()

    def ask_besides(self, wanted: Sequence[Wish]) -> None:
        """Make these while there is nothing better to do; instead of those asked before."""
        with self._wake:
            self._besides = list(wanted)
            self._made_besides = {}
            self._asked_besides += 1
            self._wake.notify()

    def ask_besides_too(self, wish: Wish) -> None:
        """Make this, too, after the others asked for besides; its mesh takes the place of one with its number."""
        with self._wake:
            self._besides.append(wish)
            self._wake.notify()

    def made_besides(self) -> dict[int, Made]:
        """Those made so far, by the number of their wish."""
        with self._wake:
            return dict(self._made_besides)

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
                while self._wish is None and not self._besides and not self._closed:
                    self.busy = False
                    if not self._wake.wait(REST if self._ahead or not self._prepared else None):
                        break
                if self._closed:
                    return
                wish, self._wish = self._wish, None
                self._current = None if wish is None else (wish.number, wish.preview)
                now = wish is None and bool(self._besides)
                beside, asked = (self._besides.pop(0) if now else None), self._asked_besides
            if beside is not None:
                self._make_beside(asked, beside)
                continue
            if wish is None:
                self._do_ahead()
                continue
            self._prepared = self._prepare is None
            try:
                result: Made | Exception = self._make(wish)
            except Exception as error:  # whatever it is, the window has to say it and go on
                result = error
            with self._wake:
                self._result, self._current = result, None
                self.busy = self._wish is not None
                closed = self._closed
            if not closed:
                self._arrived()

    def _do_ahead(self) -> None:
        """What may be wanted next: ``prepare``, then parts of one more shape; one that cannot be read is left out."""
        with contextlib.suppress(Exception):  # who wants it will hear of it
            if not self._prepared:
                self._prepared = True
                self._prepare()
                return
            index = self._ahead.pop(0)
            sources = self._sources_now()
            for part in sources.parts_of(index).values():
                part.prepare()

    def _make_beside(self, asked: int, wish: Wish) -> None:
        """One of those besides.  One that fails stays a cloud of points: nobody waits for it."""
        try:
            made = self._made(wish, None)
        except Exception:
            return
        with self._wake:
            wanted = asked == self._asked_besides and not self._closed
            if wanted:
                self._made_besides[wish.number] = made
        if wanted:
            self._arrived()

    def _sources_now(self) -> Any:
        from shapeforge.stages_synthesis import sources_of

        project = self._session.project
        if self._sources[0] != (str(project.path), project.fit_id):
            self._sources, self._makers = ((str(project.path), project.fit_id), sources_of(project)), {}
        return self._sources[1]

    def _maker(self, route: str, union: bool) -> Callable[..., SynthesizedShape]:
        from shapeforge.stages_synthesis import mesh_maker

        sources = self._sources_now()
        if (
            route,
            union,
        ) not in self._makers:  # a route from scratch learns normals and thickness when it is first used
            self._makers[route, union] = mesh_maker(sources, route, union=union)
        return self._makers[route, union]

    def _make(self, wish: Wish) -> Made:
        from shapeforge.synthesis.retrieve import retrieve

        if wish.route != "parts":
            return self._made(wish, None)
        sources = self._sources_now()
        # While a slider moves the parts keep their origin, else they flicker from one training shape to another.
        key = wish.exists.tobytes(), tuple(sorted(wish.taken.items()))
        if not wish.preview or self._retrieved[0] != key:
            fixed = {part: sources.names.index(name) for part, name in wish.taken.items() if name in sources.names}
            self._retrieved = (key, retrieve(wish.points, wish.exists, sources, fixed=fixed).shape)
        return self._made(wish, self._retrieved[1])

    def _made(self, wish: Wish, shapes: np.ndarray | None) -> Made:
        """The mesh of a wish; its parts from the training ``shapes`` (None: retrieved)."""
        with threadpool_limits(1, "blas"):  # a recipe makes it again to the byte, on any number of processors
            more: dict[str, Any] = {"shapes": shapes}
            if wish.route == "surface":
                make, more = self._maker("surface", False), {"cell": COARSE} if wish.preview else {}
            elif wish.preview:
                make = partial(synthesize_mesh, sources=self._sources_now(), preview=True)
            else:
                make = self._maker("parts", wish.union)
            shape = make(wish.points, wish.exists, symmetric=wish.symmetric, **more)
        if wish.route == "parts" and not wish.preview:
            sources = self._sources_now()
            order = np.argsort(-resemblance(sources.positions, wish.points), kind="stable")[:AHEAD]
            self._ahead = [int(t) for t in order if not sources.is_read(int(t))]
        nearest, distance = self._nearest(wish.points)
        return Made(wish.number, shape, wish.preview, nearest, distance)
