"""All that the window knows: one evented Session.  Widgets, scenes and the notebook hold no truth of their own."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

from psygnal import Signal, SignalGroupDescriptor

PLACES: tuple[str, ...] = ("collection", "paint", "fit", "correspondence", "synthesize")
TOOLS: tuple[str, ...] = ("brush", "eraser", "fill", "piece", "lasso", "scribble", "eyedropper")


@runtime_checkable
class UndoHistory(Protocol):
    """What Undo and Redo need of whatever remembers edits: the session's own list, or the painting of one shape."""

    @property
    def undo_label(self) -> str | None: ...

    @property
    def redo_label(self) -> str | None: ...

    def undo(self) -> None: ...

    def redo(self) -> None: ...


@dataclass(frozen=True, eq=False)
class Edit:
    """One thing the user did: how to take it back and how to do it again."""

    label: str
    undo: Callable[[], None]
    redo: Callable[[], None]


class Edits:
    """A linear list of edits: a new edit forgets what had been undone."""

    def __init__(self) -> None:
        self._done: list[Edit] = []
        self._undone: list[Edit] = []

    @property
    def undo_label(self) -> str | None:
        """What Undo would take back, None when nothing."""
        return self._done[-1].label if self._done else None

    @property
    def redo_label(self) -> str | None:
        """What Redo would do again, None when nothing."""
        return self._undone[-1].label if self._undone else None

    def push(self, edit: Edit) -> None:
        """Remember an edit that has just been done."""
        self._done.append(edit)
        self._undone.clear()

    def undo(self) -> None:
        """Take back the last edit, if any."""
        if self._done:
            edit = self._done.pop()
            edit.undo()
            self._undone.append(edit)

    def redo(self) -> None:
        """Do the last undone edit again, if any."""
        if self._undone:
            edit = self._undone.pop()
            edit.redo()
            self._done.append(edit)


@dataclass(eq=False)
class Session:
    """State of the window; every assignment that changes a field emits ``events.<field>(new, old)``.

    ``group`` is the group looked at (index), ``part`` the part painted with (index), ``brush_size`` a radius in
    diagonals, ``fill_to`` where the fill tool stops ("creases" or "patch"), ``watched`` the shapes seen during a fit,
    ``quality`` how well the next fit is done (a key of ``readiness.QUALITIES``; "": as the one before), ``round`` the
    recorded round looked at (None: the newest), ``compare`` the shapes compared, ``picked`` a template point (index),
    ``sliders`` direction index -> value (standard deviations), ``locked`` the sliders whose value is to stay,
    ``parts_on`` part index -> existence asked of a draw, ``pins`` template point -> where it is held (diagonals),
    ``mesh_colours`` whose colours new meshes have ("parts", or "sources": of the materials of the shapes),
    ``temperature`` how unusual draws are (1: as the family), ``near`` whether they stay near the shape in hand,
    ``arrangement`` how the collection is seen ("map", "grid" or "large"), ``turn`` the rotation (rows) by which the
    selected shapes are being turned, None while none is.  Assign new tuples and dicts; changing a dict in place tells
    nobody.
    """

    # Compared by identity: comparing their arrays would be slow and ambiguous.
    events: ClassVar[SignalGroupDescriptor] = SignalGroupDescriptor(
        equality_operators={"project": operator.is_, "progress": operator.is_, "history": operator.is_}
    )
    # Data of the project changed: "shapes", "groups", "labels", "fit", "machine" or "draws".
    data_changed: ClassVar[Signal] = Signal(str)

    project: Any = None
    place: str = "collection"
    shape: str | None = None
    group: int = 0
    part: int = 0
    tool: str = "brush"
    brush_size: float = 0.034
    reach: str = "surface"
    fill_to: str = "creases"
    mirror: bool = False
    theme: str = "dark"
    colour_by: str = "group"
    arrangement: str = "map"
    turn: tuple[tuple[float, ...], ...] | None = None
    watched: tuple[str, ...] = ()
    round: int | None = None
    compare: tuple[str, ...] = ()
    selected: tuple[str, ...] = ()
    picked: int | None = None
    quality: str = ""
    sliders: dict[int, float] = field(default_factory=dict)
    locked: frozenset[int] = frozenset()
    parts_on: dict[int, bool] = field(default_factory=dict)
    pins: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    mesh_colours: str = "parts"
    temperature: float = 1.0
    near: bool = False
    linked: bool = True
    status: str = ""
    status_kind: str = "info"
    progress: Any = None
    running: bool = False
    is_paused: bool = False
    stage: str | None = None
    history: UndoHistory = field(default_factory=Edits)
    edit_count: int = 0
    revision: int = 0

    def say(self, text: str, kind: str = "info") -> None:
        """Show one sentence in the status; ``kind`` is info, ok, warning or error."""
        self.status_kind = kind
        self.status = text

    def touch(self, what: str) -> None:
        """Tell all that data of the project changed ("shapes", "groups", "labels", "fit", "machine", "draws").

        ``revision`` counts these, so that whoever keeps something derived from the project knows when it is old.
        """
        self.revision += 1
        self.data_changed.emit(what)

    def open(self, project: Any) -> None:
        """Look at another project (None: none): selections of the old one are dropped first."""
        self.shape, self.group, self.selected, self.watched, self.compare = None, 0, (), (), ()
        self.round, self.picked, self.sliders, self.parts_on = None, None, {}, {}
        self.locked, self.pins = frozenset(), {}
        self.quality, self.near, self.temperature = "", False, 1.0
        self.progress, self.history, self.place = None, Edits(), "collection"
        self.turn = None
        self.revision += 1
        self.project = project
        self.say("" if project is None else f"Opened {getattr(project, 'name', Path(project.path).name)}")

    def do(self, label: str, redo: Callable[[], None], undo: Callable[[], None]) -> None:
        """Do something and remember how to take it back (where the current history takes single edits)."""
        redo()
        if isinstance(self.history, Edits):
            self.history.push(Edit(label, undo, redo))
        self.edit_count += 1

    def undo(self) -> None:
        """Take back the last edit of the current history."""
        self.history.undo()
        self.edit_count += 1

    def redo(self) -> None:
        """Do the last undone edit of the current history again."""
        self.history.redo()
        self.edit_count += 1
