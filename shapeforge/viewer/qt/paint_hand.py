"""The hand on the painted shape: presses, drags and the ring at the pointer become dabs, lassos and marks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QPointF, Qt

from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Mesh
from shapeforge.viewer.display import Mark
from shapeforge.viewer.painter import Painter
from shapeforge.viewer.picking import Pick, camera_axes, project
from shapeforge.viewer.qt.paint_parts import inside_polygon
from shapeforge.viewer.qt.view3d import View3D
from shapeforge.viewer.session import Session

DABS_PER_MOVE = 24
SEEN = 2e-3  # diagonals: a face hit this near to its centre is the one that is seen
RINGED = ("brush", "eraser", "scribble")


class PaintHand:
    """Ties a view to a painter.  ``ended`` is called after a stroke that changed something, ``parts_made`` when a
    stroke had to make the first part."""

    def __init__(
        self,
        session: Session,
        view: View3D,
        painter: Painter,
        ended: Callable[[], None],
    ) -> None:
        self.session, self.view, self.painter = session, view, painter
        self.ended = ended
        self.note: np.ndarray | None = None
        self._last_place = (0.0, 0.0)
        self._lasso: list[tuple[float, float]] | None = None
        view.left_paints = True
        view.pressed.connect(self._press)
        view.dragged.connect(self._drag)
        view.released.connect(self._release)
        view.hovered.connect(self._hover)
        view.setCursor(Qt.CursorShape.CrossCursor)

    def _press(self, pick: Pick | None, modifiers: Qt.KeyboardModifier) -> None:
        session = self.session
        self.note = None
        if session.tool == "eyedropper":
            if pick is not None:
                part = int(self.painter.state.labels[self.painter.face_of(pick.triangle)])
                if part >= 0:
                    session.part = part
                    session.say(f"Painting with {self.painter.part_names[part]}")
                session.tool = "brush"
            return
        self.painter.begin(erase=bool(modifiers & Qt.KeyboardModifier.ControlModifier))
        if session.tool == "lasso":
            self._lasso = [self.view.pointer]
        elif pick is not None:
            self.painter.dab(self.painter.face_of(pick.triangle), pick.position)
        self._last_place = self.view.pointer
        self.mark(pick)

    def _drag(self, pick: Pick | None, modifiers: Qt.KeyboardModifier) -> None:
        if not self.painter.state.is_drawing:
            return  # the press was not a stroke (it took a part, say)
        here = self.view.pointer
        if self._lasso is not None:
            self._lasso.append(here)
            self.view.overlay.path = [QPointF(*place) for place in self._lasso]
            self.view.overlay.update()
            return
        if self.session.tool in RINGED:
            # Dabs along the way, so that a fast drag leaves no gaps; the steps are half a brush on the screen.
            way = np.subtract(here, self._last_place)
            pixels = self.view.height() / (2 * self.view.scene.camera.GetParallelScale())
            steps = int(min(np.ceil(np.hypot(*way) / max(0.5 * self.session.brush_size * pixels, 2.0)), DABS_PER_MOVE))
            for i in range(1, steps + 1):
                place = np.add(self._last_place, way * i / steps)
                between = pick if i == steps else self.view.pick(float(place[0]), float(place[1]))
                if between is not None:
                    self.painter.dab(self.painter.face_of(between.triangle), between.position)
        elif pick is not None and self.session.tool in ("fill", "piece"):
            self.painter.dab(self.painter.face_of(pick.triangle), pick.position)
        self._last_place = here
        self.mark(pick)

    def _release(self) -> None:
        if self._lasso is not None:
            lasso, self._lasso = np.array(self._lasso), None
            self.view.overlay.path = []
            self.painter.paint(self.painter.with_twins(self._encircled(lasso)))
        if self.painter.state.is_drawing and self.painter.end():
            self.ended()
        self.view.overlay.update()

    def _encircled(self, lasso: np.ndarray) -> np.ndarray:
        """Faces whose centre lies inside the line and, unless the reach is through, is seen."""
        painter = self.painter
        faces = np.unique(self.view.shown.views[0].layers[0].record)
        rectangle = self.view.rectangles()[0]
        places = project(self.view.scene.camera, painter.surface.centres[faces], rectangle)
        inside = np.flatnonzero(inside_polygon(places, lasso)) if len(lasso) > 2 else np.zeros(0, int)
        if self.session.reach == "through":
            return faces[inside]
        away = camera_axes(self.view.scene.camera)[2]
        layer = self.view.shown.views[0].layers[0]
        shown = Mesh(layer.vertices, layer.triangles, layer.record, painter.mesh.n_faces)
        start = painter.surface.centres[faces[inside]] + 4 * away
        hits = first_hits(shown, start, np.broadcast_to(-away, start.shape).copy())
        return faces[inside[np.abs(hits - 4) < SEEN]]

    def _hover(self, pick: Pick | None) -> None:
        if self.painter.name is not None:
            self.mark(pick)

    def mark(self, pick: Pick | None) -> None:
        """The ring at the pointer and its dashed twin; moving them redraws no 3-D."""
        marks: list[Mark] = []
        if self.note is not None:
            marks.append(Mark("note", tuple(float(x) for x in self.note), text="next piece"))
        if pick is not None and self.session.tool in RINGED:
            radius = self.session.brush_size * (0.4 if self.session.tool == "scribble" else 1.0)
            at, normal = _tuple(pick.position), pick.normal
            marks.append(Mark("brush", at, to=_tuple(normal), radius=radius))
            twin = self.painter.twin(pick.position)
            if twin is not None and self.painter.mirror_plane is not None:
                across = self.painter.mirror_plane[0]
                turned = normal - 2 * (normal @ across) * across
                marks.append(Mark("twin", _tuple(twin[1]), to=_tuple(turned), radius=radius))
        self.view.set_marks([tuple(marks)])

    def point_at(self, piece: np.ndarray) -> None:
        """Turn the view so that some of the faces ``piece`` are seen, and point at their middle."""
        surface, mesh = self.painter.surface, self.painter.mesh
        facing = (mesh.face_normals[piece] * surface.areas[piece][:, None]).sum(axis=0)
        largest = piece[surface.areas[piece].argmax()]
        direction = mesh.face_normals[largest] if np.linalg.norm(facing) < 1e-6 else facing / np.linalg.norm(facing)
        centre = surface.centres[piece].mean(axis=0)
        self.note = surface.centres[piece[np.linalg.norm(surface.centres[piece] - centre, axis=1).argmin()]]
        if not self.sees(piece):
            azimuth = float(np.degrees(np.arctan2(direction[0], direction[2])))
            elevation = float(np.degrees(np.arcsin(np.clip(direction[1], -1, 1))))
            self.view.turn_to(azimuth + 20, min(max(elevation + 15, -50), 60))
        self.mark(None)

    def sees(self, piece: np.ndarray) -> bool:
        """Whether any of (some of) these faces is seen from here."""
        places = project(self.view.scene.camera, self.painter.surface.centres[piece[:12]], self.view.rectangles()[0])
        picks = [self.view.pick(float(x), float(y)) for x, y in places]
        members = set(piece.tolist())
        return any(p is not None and self.painter.face_of(p.triangle) in members for p in picks)


def _tuple(position: np.ndarray) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
