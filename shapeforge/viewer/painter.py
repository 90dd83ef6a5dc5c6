"""The painter's hand: turns presses and drags on a shape into strokes, by the tool the Session says.  No Qt here."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.iterate import last
from shapeforge.collection.labels import UNLABELLED, PartNames
from shapeforge.viewer import brushes
from shapeforge.viewer.display import Mark, MeshLayer, View, face_colours
from shapeforge.viewer.first_parts import are_proposed, edit_proposed
from shapeforge.viewer.painting import PaintState, paint_state
from shapeforge.viewer.session import Session

BRUSH_LIMITS = (0.004, 0.25)
SYMMETRIC = 0.03  # diagonals: a worse mean distance to the mirror image means there is no mirror to speak of
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
    """One shape being painted.  ``state`` is its labels and history; ``hidden`` parts are not drawn and not painted."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.name: str | None = None
        self.hidden: frozenset[int] = frozenset()
        self.isolated = False
        self.edges = False
        self.state = PaintState(np.zeros(0, np.int32))
        self._plane: tuple[np.ndarray, float, float] | None = None
        self._plane_known = False
        self._saved: np.ndarray | None = None
        self._saved_done = 0
        self._patches: np.ndarray | None = None

    # ---- the shape -----------------------------------------------------------------------------------------------

    def open(self, name: str) -> None:
        """Paint the shape ``name`` of the project; what was painted before is saved first."""
        self.save()
        project = self.session.project
        self.shape = project.shapes[list(project.names).index(name)]
        self.mesh = self.shape.mesh
        self.surface = brushes.face_surface(self.mesh)
        self.state = paint_state(self.mesh.n_faces, project.labels(name), project.read_history(name))
        self._saved, self._saved_done = self.state.labels.copy(), self.state.done
        self._plane_known = False
        self._patches = None
        self.hidden = frozenset()
        self.name = name
        self._drawn: tuple[Any, ...] | None = None
        self._vertices = np.asarray(self.mesh.vertices, float)

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
        project = self.session.project
        project.set_labels(self.name, labels if (labels >= 0).any() else None)
        project.write_history(self.name, self.state.to_record())
        self._saved, self._saved_done = labels, self.state.done
        return True

    @property
    def mirror_plane(self) -> tuple[Float[np.ndarray, " 3"], float, float] | None:
        """Normal, offset and error (diagonals, beyond the sampling's) of the mirror plane; None without a good one."""
        if not self._plane_known:
            from shapeforge.collection.symmetry import symmetry_plane

            points = np.asarray(self.shape.points, float)
            normal, offset, error = symmetry_plane(points)
            # Between samples even a perfect mirror misses by their spacing; what is left is the shape's own.
            spacing = float(cKDTree(points).query(points, k=2)[0][:, 1].mean()) if len(points) > 1 else 0.0
            error = max(float(error) - spacing, 0.0)
            self._plane = (np.asarray(normal, float), float(offset), error) if error < SYMMETRIC else None
            self._plane_known = True
        return self._plane

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

    def add_part(self, name: str) -> int:
        """Add a part to the family; returns its index.  Raises ValueError when the name is empty or taken."""
        named = self.session.project.part_names or PartNames((), ())
        name = self._free_name(name, None)
        fresh = max(named.ids, default=-1) + 1
        self.session.project.set_part_names(PartNames((*named.ids, fresh), (*named.names, name)))
        return len(named)

    def rename_part(self, part: int, name: str) -> None:
        """Call a part otherwise, in the whole family.  Raises ValueError when the name is empty or taken."""
        named = self.session.project.part_names
        names = list(named.names)
        names[part] = self._free_name(name, part)
        if self._are_proposed:
            last(edit_proposed(self.session, "rename", named.names[part], names[part]))
            return
        self.session.project.set_part_names(PartNames(named.ids, tuple(names)))

    def _free_name(self, name: str, but: int | None) -> str:
        name = " ".join(name.split())
        taken = {other for i, other in enumerate(self.part_names) if i != but}
        if not name or name in taken:
            raise ValueError(f"The part needs a name of its own; {name!r} is " + ("taken." if name else "empty."))
        return name

    def merge_parts(self, kept: int, gone: int) -> None:
        """Everything labelled ``gone`` becomes ``kept`` and ``gone`` leaves the list, on every shape of the family."""
        project = self.session.project
        named = project.part_names
        if self._are_proposed:
            last(edit_proposed(self.session, "merge", named.names[kept], named.names[gone]))
            self.hidden, self.session.part = frozenset(), kept - (kept > gone)
            return
        new_index = {i: i - (i > gone) for i in range(len(named))}
        new_index[gone] = new_index[kept]
        self.state.end()
        table = np.array([UNLABELLED] + [new_index[i] for i in range(len(named))], np.int32)
        for name in project.labelled:
            if name != self.name:
                labels, record = project.labels(name), project.read_history(name)
                other = paint_state(len(labels), labels, record)
                other.rename_parts(new_index)
                project.set_labels(name, table[labels + 1])
                project.write_history(name, other.to_record())
        self.state.rename_parts(new_index)
        self.save()
        keep = [i for i in range(len(named)) if i != gone]
        project.set_part_names(PartNames(tuple(named.ids[i] for i in keep), tuple(named.names[i] for i in keep)))
        self.hidden = frozenset()
        self.session.part = new_index[kept]

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
        return self.apply_completion(brushes.complete(self.mesh, self.surface, seeds, len(self.part_names)))

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
        colours = face_colours(labels, self.session.project.part_inks())[self.mesh.face_of_triangle]
        gone = np.isin(labels, list(hidden))[self.mesh.face_of_triangle] if hidden else None
        key = None if gone is None else gone.tobytes()
        if self._drawn is None or self._drawn[0] != key:
            shown = np.arange(len(self.mesh.triangles)) if gone is None else np.flatnonzero(~gone)
            self._drawn = (key, shown, self.mesh.triangles[shown], self.mesh.face_of_triangle[shown])
        _, self._shown, triangles, record = self._drawn
        layer = MeshLayer("shape", self._vertices, triangles, colours[self._shown], edges=self.edges, record=record)
        return View((layer,), marks)
