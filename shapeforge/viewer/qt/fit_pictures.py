"""What the Fit place draws and keeps: the meshes of its views, and the small pictures of the rounds."""

from __future__ import annotations

import numpy as np
from PySide6.QtGui import QImage

from shapeforge.viewer.fit_display import UNTURNED, MeshLayer, all_points, mesh_layer, probable_layer
from shapeforge.viewer.fit_record import FitRecord, look_at
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.qt.fit_widgets import draw_points
from shapeforge.viewer.session import Session

LAYERS_KEPT = 60


class FitPictures:
    """Mesh layers that keep their identity, so that an unchanged view is not drawn again, and pictures of rounds."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._layers: dict[tuple, MeshLayer] = {}
        self._rounds: dict[tuple, QImage] = {}

    def forget(self) -> None:
        """Another project is looked at."""
        self._layers.clear()
        self._rounds.clear()

    def forget_rounds(self) -> None:
        """The rounds, or the colours, are others than before."""
        self._rounds.clear()

    def layer(self, record: FitRecord, name: str, kind: str, number: int) -> MeshLayer:
        """The mesh of a shape in round ``number``: "plain", "ghost" (see-through) or by its probable "parts"."""
        newest = record.newest if kind == "parts" else 0
        points = record.points(name, number)
        turn = UNTURNED if points is None else points.turn
        stamp = (name, kind, self.session.theme, newest, self.session.revision, turn.tobytes())
        if stamp not in self._layers:
            if len(self._layers) > LAYERS_KEPT:
                self._layers.clear()
            shape = self.session.project.shapes.named(name)
            if kind == "parts":
                chances = self._probabilities(record, name, shape)
                self._layers[stamp] = probable_layer(shape, chances, record.looks[0].inks, turn)
            else:
                colour = tokens(self.session.theme)["shape"]
                self._layers[stamp] = mesh_layer(shape, colour, 1.0 if kind == "plain" else 0.16, kind, turn)
        return self._layers[stamp]

    def _probabilities(self, record: FitRecord, name: str, shape: object) -> np.ndarray:
        if record.state is None:
            known = self.session.project.face_probabilities(name)
            if known is not None:
                return known
        from shapeforge.deformation.faces import face_probabilities

        return face_probabilities(shape, record.beliefs(name))

    def of_rounds(self, record: FitRecord, name: str | None) -> dict[int, QImage]:
        """A picture of a shape's template points after every round that is known."""
        found: dict[int, QImage] = {}
        for number in range(record.newest + 1):
            points = record.points(name, number) if name else None
            look = look_at(record, points)
            if look is None:
                continue
            stamp = (name, number)
            if stamp not in self._rounds:
                self._rounds[stamp] = draw_points(*all_points(look, points), (76, 80), (1.0, 0.6, 1.5), 2)
            found[number] = self._rounds[stamp]
        return found
