"""The painter's hand: turns presses and drags on a shape into strokes, by the tool the Session says.  No Qt here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.iterate import last
from shapeforge.collection.labels import UNLABELLED, PartNames
from shapeforge.stages_status import starts_from_proposal
from shapeforge.viewer import brushes, spreading
from shapeforge.viewer.display import Mark, MeshLayer, View, face_colours
from shapeforge.viewer.first_parts import ProposedEdits, are_proposed
from shapeforge.viewer.painting import PaintState, paint_state
from shapeforge.viewer.palette import label_colours, pale
from shapeforge.viewer.part_edits import Open, PaintHistory, PartEdits, clock
from shapeforge.viewer.part_table import PartTable
from shapeforge.viewer.session import Session

BRUSH_LIMITS = (0.004, 0.25)
SUGGESTED = 0.55
"""How much of their colour proposed parts have: to be told from painted ones."""
TOOL_NAMES: dict[str, str] = {
    "brush": "Brush",
    "eraser": "Eraser",
    "fill": "Fill",
    "piece": "Connected piece",
    "lasso": "Lasso",
    "scribble": "Scribble",
    "eyedropper": "Pick a part",
}


class Painter:
    """One shape being painted.  ``state`` is its labels and strokes; ``hidden`` parts are not drawn and not painted.

    ``edits`` are the changes of the family's parts, ``history`` both in one line.  ``parts_changed`` (if set) is called
    after the parts are others; ``run(make)`` iterates a stage.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.name: str | None = None
        self.hidden: frozenset[int] = frozenset()
        self.isolated = False
        self.edges = False
        self.state = PaintState(np.zeros(0, np.int32), PartTable())
        self.history = PaintHistory(self)
        self.parts_changed: Callable[[], None] | None = None
        self.run: Callable[[Callable[[], Iterator[Any]]], None] = lambda make: last(make())
        self.proposed = ProposedEdits(session, lambda make: self.run(make))
        self._edits: PartEdits | None = None
        self._proposal: tuple[Any, list[np.ndarray] | None] | None = None
        self._suggested: np.ndarray | None = None
        self._plane: tuple[np.ndarray, float, float] | None = None
        self._plane_known = False
        self._saved: np.ndarray | None = None
        self._saved_done = 0
        self._patches: np.ndarray | None = None
        self._ground: spreading.Ground | None = None

    # ---- the shape -----------------------------------------------------------------------------------------------

    def open(self, name: str) -> None:
        """Paint the shape ``name`` of the project; what was painted before is saved first."""
        self.save()
        self.read(name)

    def read(self, name: str) -> None:
        """Take the shape ``name`` as the project has it."""
        project = self.session.project
        self.shape = project.shapes[list(project.names).index(name)]
        self.mesh = self.shape.mesh
        self.surface = brushes.face_surface(self.mesh)
        table = self.edits.table
        self.state = paint_state(self.mesh.n_faces, project.labels(name), project.read_history(name), table)
        self.state.clock = lambda: clock(self.state, self.edits)
        self.state.recorded = lambda: self.edits.forget_undone()
        self._remember_saved()
        self._suggested = self._proposed_faces(name) if starts_from_proposal(project) else None
        self._plane_known = False
        self._patches = self._ground = None
        self.hidden = frozenset()
        self.name = name
        self._drawn: tuple[Any, ...] | None = None
        self._vertices = np.asarray(self.mesh.vertices, float)

    def _proposed_faces(self, name: str) -> Int[np.ndarray, " F"] | None:
        """The proposed part (F,) of every face: that of the nearest sample."""
        from shapeforge.stages_collection import proposed_points

        project = self.session.project
        folder = project.current_folder("cosegment")
        if self._proposal is None or self._proposal[0] != folder:
            self._proposal = folder, proposed_points(project)
        index, labels = project.index(name), self._proposal[1]
        if labels is None or index >= len(labels) or len(labels[index]) != len(self.shape.points):
            return None
        return labels[index][cKDTree(self.shape.points).query(self.surface.centres)[1]].astype(np.int32)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the family's parts, in order."""
        named = self.session.project.part_names
        return () if named is None else tuple(named.names)

    @property
    def is_saved(self) -> bool:
        """Nothing has changed since the last save."""
        if self.name is None:
            return True
        return self._saved_done == self.state.done and np.array_equal(self._saved, self.state.labels)

    def save(self) -> bool:
        """Write labels and history into the project; True when there was anything to write.

        A shape whose last paint was taken away has no labels again.  Raises what the project raises.
        """
        if self.is_saved:
            return False
        self.state.end()
        labels = self.state.labels.copy()
        faces = labels if (labels >= 0).any() else None
        self.session.project.set_painting({self.name: faces}, {self.name: self.state.to_record()})
        self._remember_saved()
        return True

    def _remember_saved(self) -> None:
        self._saved, self._saved_done = self.state.labels.copy(), self.state.done

    @property
    def is_outdated(self) -> bool:
        """Somebody else changed the parts, or the labels of this shape, while it was open."""
        if self.name is None:
            return False
        project = self.session.project
        if self.state.table.named != (project.part_names or PartNames((), ())):
            return True
        labels = project.labels(self.name) if self.is_saved else None
        return labels is not None and not np.array_equal(labels, self.state.labels)

    @property
    def mirror_plane(self) -> tuple[Float[np.ndarray, " 3"], float, float] | None:
        """Normal, offset and error (diagonals, beyond the sampling's) of the mirror plane; None without a good one."""
        if not self._plane_known:
            self._plane = brushes.mirror_plane(np.asarray(self.shape.points, float))
            self._plane_known = True
        return self._plane

    @property
    def ground(self) -> spreading.Ground:
        """What completing needs to know of the shape, found when it is first asked for."""
        if self._ground is None:
            plane = self.mirror_plane
            self._ground = spreading.Ground(self.mesh, self.surface, None if plane is None else plane[:2])
        return self._ground

    @property
    def face_patches(self) -> Int[np.ndarray, " F"]:
        """Patch number (F,) of every face, found when it is first asked for."""
        if self._patches is None:
            points = np.asarray(self.shape.points, float)
            self._patches = brushes.patch_of_faces(self.surface, points, self.shape.patch)
        return self._patches

    # ---- parts ---------------------------------------------------------------------------------------------------

    @property
    def _are_proposed(self) -> bool:
        """The parts are proposed ones, and nothing is painted here that is not saved yet."""
        return are_proposed(self.session) and not (self.state.labels >= 0).any()

    @property
    def proposed_faces(self) -> Int[np.ndarray, " F"] | None:
        """The proposed part (F,) of every face, as long as parts are only proposed; else None."""
        return self._suggested if self._are_proposed else None

    @property
    def edits(self) -> PartEdits:
        """The parts and the history of changing them, read anew when somebody else changed them."""
        project = self.session.project
        kept = self._edits
        if kept is None or kept.project is not project or kept.table.named != (project.part_names or PartNames((), ())):
            kept = self._edits = PartEdits(project)
        return kept

    def change_parts(self, change: Callable[[Open], None]) -> None:
        """Have ``change(the shape being painted)`` change the parts; all that is shown here follows."""
        self.state.end()
        before, part = self.edits.table, self.session.part
        change(None if self.name is None else (self.name, self.state))
        after = self.edits.table
        if (before.ids, before.names) != (after.ids, after.names):
            self._suggested = None  # paint is no longer of the proposed parts, and a fit does without these
        self.state.set_table(after)
        where = after.part_of
        self.hidden = frozenset(where[before.ids[p]] for p in self.hidden if before.ids[p] in where)
        if part < len(before.ids):
            self.session.part = where.get(before.ids[part], max(min(part, len(after.ids) - 1), 0))
        self.save()
        if self.parts_changed is not None:
            self.parts_changed()

    def _edit_parts(self, kind: str, label: str, after: PartTable) -> None:
        self.state.end()
        self.state.forget_undone()
        when = clock(self.state, self.edits)
        self.change_parts(lambda open_one: self.edits.do(kind, label, after, when, open_one))

    def add_part(self, name: str) -> int:
        """Add a part to the family; returns its index.  Raises ValueError when the name is empty or taken."""
        name = self._free_name(name, None)
        self._edit_parts("new", f"new {name}", self.edits.table.with_new(self.edits.fresh_id(), name))
        return len(self.part_names) - 1

    def rename_part(self, part: int, name: str) -> None:
        """Call a part otherwise, in the whole family.  Raises ValueError when the name is empty or taken."""
        old, name = self.part_names[part], self._free_name(name, part)
        if self._are_proposed:
            self.proposed.do("rename", old, name)
        elif name != old:
            self._edit_parts("rename", f"{old} → {name}", self.edits.table.renamed(part, name))

    def recolour_part(self, part: int, colour: str | None) -> None:
        """Give a part another colour ("#RRGGBB"; None: that of its place), wherever the family is shown."""
        after = self.edits.table.recoloured(part, colour)
        if after != self.edits.table:
            self._edit_parts("recolour", f"colour {self.part_names[part]}", after)

    def _free_name(self, name: str, but: int | None) -> str:
        name = " ".join(name.split())
        taken = {other for i, other in enumerate(self.part_names) if i != but}
        if not name or name in taken:
            raise ValueError(f"The part needs a name of its own; {name!r} is " + ("taken." if name else "empty."))
        return name

    def merge_parts(self, kept: int, gone: int) -> None:
        """All paint of ``gone`` counts as ``kept`` and ``gone`` leaves the list, on every shape of the family."""
        names = self.part_names
        if self._are_proposed:
            self.proposed.do("merge", names[kept], names[gone])
            self.hidden, self.session.part = frozenset(), kept - (kept > gone)
            return
        self.session.part = kept
        self._edit_parts("merge", f"{names[gone]} into {names[kept]}", self.edits.table.without(gone, kept))

    def remove_part(self, part: int) -> None:
        """Take a part off the list; what was painted with it is unpainted, on every shape of the family."""
        self._edit_parts("remove", f"no {self.part_names[part]}", self.edits.table.without(part))

    # ---- tools ---------------------------------------------------------------------------------------------------

    def face_of(self, triangle: int) -> int:
        """Face record of a triangle of the drawn layer."""
        return int(self.mesh.face_of_triangle[self._shown[triangle]])

    def touched(self, face: int, position: Float[np.ndarray, " 3"], tool: str) -> Int[np.ndarray, " n"]:
        """Faces that ``tool`` touches at ``position`` on ``face``, the mirror twins included where mirroring is on."""
        faces = self._touched(face, position, tool)
        if self.session.mirror and (twin := self.twin(position)) is not None:
            faces = np.union1d(faces, self._touched(twin[0], twin[1], tool))
        return faces[~self._is_hidden(faces)]

    def with_twins(self, faces: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
        """The faces and, where mirroring is on, those opposite; hidden ones are left out."""
        if self.session.mirror and self.mirror_plane is not None:
            normal, offset, _ = self.mirror_plane
            faces = np.union1d(faces, brushes.mirrored_faces(self.surface, faces, normal, offset))
        return faces[~self._is_hidden(faces)]

    def twin(self, position: Float[np.ndarray, " 3"]) -> tuple[int, Float[np.ndarray, " 3"]] | None:
        """Face and place opposite ``position``; None without mirroring or where there is nothing."""
        if not self.session.mirror or self.mirror_plane is None:
            return None
        normal, offset, _ = self.mirror_plane
        return brushes.mirrored(self.surface, position, normal, offset)

    def _touched(self, face: int, position: np.ndarray, tool: str) -> np.ndarray:
        if tool == "fill" and self.session.fill_to == "patch":
            return brushes.up_to_patch(self.surface, face, self.face_patches)
        if tool == "fill":
            return brushes.up_to_creases(self.surface, face)
        if tool == "piece":
            return brushes.whole_piece(self.surface, face)
        radius = self.session.brush_size * (0.4 if tool == "scribble" else 1.0)
        reach = brushes.through if self.session.reach == "through" and tool != "scribble" else brushes.along
        return reach(self.surface, face, position, radius)

    def _is_hidden(self, faces: np.ndarray) -> np.ndarray:
        hidden = self.hidden_parts
        return np.isin(self.state.labels[faces], list(hidden)) if hidden else np.zeros(len(faces), bool)

    @property
    def hidden_parts(self) -> frozenset[int]:
        """Parts not drawn now: those whose eye is shut, and with ``isolated`` all but the current one."""
        others = set(range(len(self.part_names))) - {self.session.part} if self.isolated else set()
        return frozenset(self.hidden | others)

    def begin(self, erase: bool = False) -> None:
        """Start a stroke with the Session's tool and part; ``erase`` takes paint away whatever the tool."""
        if not self.part_names:
            self.session.part = self.add_part("part 1")
        self._erases = erase or self.session.tool == "eraser"
        tool = "eraser" if self._erases else self.session.tool
        label = "erase" if self._erases else self.part_names[self.session.part]
        self.state.begin(tool, label)

    def dab(self, face: int, position: Float[np.ndarray, " 3"]) -> None:
        """One touch of the tool within the stroke."""
        tool = self.session.tool
        self.paint(self.touched(face, position, "brush" if tool == "eraser" else tool))

    def paint(self, faces: Int[np.ndarray, " n"]) -> None:
        """Give faces to the stroke's part."""
        self.state.paint(faces, UNLABELLED if self._erases else self.session.part)

    def end(self) -> bool:
        """End the stroke; True when it changed something."""
        return self.state.end() is not None

    def complete(self, *, by_hand_only: bool = False) -> bool:
        """Fill in what is unpainted from what is painted (``by_hand_only``: from strokes, redoing earlier fillings)."""
        seeds = self.strokes_only() if by_hand_only else self.state.labels.copy()
        return self.apply_completion(spreading.complete(self.ground, seeds))

    def apply_completion(self, faces: Int[np.ndarray, " F"]) -> bool:
        """Paint a completed painting (F,) as one item of the history; True when it changed something."""
        change = np.flatnonzero(faces != self.state.labels)
        self.state.stroke("complete", "complete", change, faces[change])
        return len(change) > 0

    def strokes_only(self) -> Int[np.ndarray, " F"]:
        """Labels (F,) without what earlier completing filled in."""
        seeds = self.state.labels.copy()
        seeds[~self._by_hand()] = UNLABELLED
        return seeds

    def _by_hand(self) -> np.ndarray:
        """Faces whose paint came from a stroke (or was there before), not from completing."""
        hand = self.state.labels_after(0) >= 0
        for stroke in self.state.strokes[: self.state.done]:
            hand[stroke.faces] = stroke.tool != "complete"
        return hand & (self.state.labels >= 0)

    # ---- what is shown -------------------------------------------------------------------------------------------

    def view(self, marks: tuple[Mark, ...] = ()) -> View:
        """The View of the shape now; arrays keep their identity while they do not change."""
        labels = self.state.labels
        hidden = self.hidden_parts
        inks = self.session.project.part_inks()
        colours = face_colours(labels, inks)
        if self._suggested is not None:  # what a fit takes where nothing is painted
            suggested = pale(label_colours(self._suggested, inks), np.full(len(labels), SUGGESTED))
            colours = np.where((labels < 0)[:, None], suggested, colours)
        colours = colours[self.mesh.face_of_triangle]
        gone = np.isin(labels, list(hidden))[self.mesh.face_of_triangle] if hidden else None
        key = None if gone is None else gone.tobytes()
        if self._drawn is None or self._drawn[0] != key:
            shown = np.arange(len(self.mesh.triangles)) if gone is None else np.flatnonzero(~gone)
            self._drawn = (key, shown, self.mesh.triangles[shown], self.mesh.face_of_triangle[shown])
        _, self._shown, triangles, record = self._drawn
        layer = MeshLayer("shape", self._vertices, triangles, colours[self._shown], edges=self.edges, record=record)
        return View((layer,), marks)
