"""Many fitted shapes side by side: where one template point lies on each, how sure that is, what two of them measure.

No Qt here: the window and the notebook show the Displays made by :class:`Lightbox`.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree
from scipy.special import gammainc

from shapeforge.collection.surface import closest_points
from shapeforge.deformation.hierarchy import deformed_family
from shapeforge.viewer.display import (
    Caption,
    Display,
    LineLayer,
    Mark,
    MeshLayer,
    View,
    coordinate_colours,
    face_colours,
    grid_of,
)
from shapeforge.viewer.fine_mesh import fine_mesh
from shapeforge.viewer.fit_display import turned
from shapeforge.viewer.fuzzy import Fuzzy, fuzzy_correspondence, part_bits, where_it_may_lie
from shapeforge.viewer.palette import Theme, heat, rgb, tokens
from shapeforge.viewer.session import Session

CLOSE = 0.05  # diagonals: the confidence of a point is the chance that it lies this near to where it is shown
GAP = 0.04  # diagonals: a deformed point this far off the surface counts for little
FULL_PART_BITS = 1.0
"""Entropy of a face's part shown as the hottest colour: two parts as likely as each other."""
FARTHEST = 0.1
"""Distance (diagonals) between two overlaid shapes shown as the hottest colour."""
KEPT = 64


@dataclass(frozen=True, eq=False)
class Known:
    """What the fit says of one shape's K corresponding points, without its mesh: small, so it is kept for all shapes.

    Positions are turned as the family lies by ``turn`` (3, 3), so that shapes can be compared.
    ``spread`` (K,) is the standard deviation of each point in diagonals, ``confidence`` (K,) in 0..1, 0 where absent.
    """

    positions: Float[np.ndarray, "K 3"]
    existence: Bool[np.ndarray, " K"]
    spread: Float[np.ndarray, " K"]
    confidence: Float[np.ndarray, " K"]
    turn: Float[np.ndarray, "3 3"]


@dataclass(frozen=True, eq=False)
class Corresponded:
    """One fitted shape, ready to be shown: a mesh fine enough for heat, and what is :class:`Known` of its points.

    ``face`` (N,) is the face record of each shown triangle; ``nearest`` (V,) the template point nearest to each vertex.
    """

    name: str
    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    face: Int[np.ndarray, " N"]
    nearest: Int[np.ndarray, " V"]
    known: Known

    @property
    def positions(self) -> Float[np.ndarray, "K 3"]:
        """Places (K, 3) of the points, NaN where absent."""
        return self.known.positions

    @property
    def existence(self) -> Bool[np.ndarray, " K"]:
        """Which points the shape has (K,)."""
        return self.known.existence


def confidence_of(spread: Float[np.ndarray, " K"], gap: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """Chance (K,) that a point with this isotropic standard deviation lies within CLOSE of where it is shown, times a
    penalty for the ``gap`` (diagonals) between the deformed point and the surface."""
    near = gammainc(1.5, 0.5 * (CLOSE / np.maximum(spread, 1e-6)) ** 2)  # chi squared, three degrees of freedom
    return near * np.exp(-0.5 * (gap / GAP) ** 2)


def describe_point(points: Float[np.ndarray, "K 3"], part: Int[np.ndarray, " K"], names: Sequence[str], k: int) -> str:
    """Words for template point k: its part and where on the part it lies, as "Back, top right" seen from the front."""
    own = points[part == part[k]]
    low, high = own.min(axis=0), own.max(axis=0)
    extent = np.maximum(high - low, 1e-9)
    place = (points[k] - low) / extent - 0.5
    whole = max(float(np.ptp(points, axis=0).max()), 1e-9)
    words = []
    for axis, (minus, plus) in ((1, ("bottom", "top")), (2, ("back", "front")), (0, ("left", "right"))):
        if abs(place[axis]) > 0.22 and extent[axis] > 0.06 * whole:
            words.append((abs(place[axis]), plus if place[axis] > 0 else minus))
    kept = {word for _, word in sorted(words, reverse=True)[:2]}
    ordered = [word for _, word in words if word in kept]
    name = names[part[k]]
    return name[:1].upper() + name[1:] + (", " + " ".join(ordered) if ordered else ", middle")


class Lightbox:
    """The fitted shapes of the session's project.  Shapes are loaded when first asked for and kept while shown."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._fit_id: Any = None
        self._shapes: OrderedDict[str, Corresponded] = OrderedDict()
        self._known: dict[str, Known] = {}
        self._layers: dict[tuple, MeshLayer] = {}
        self._fuzzy: dict[str, Fuzzy | None] = {}
        self._overlaid: tuple[tuple, Display] | None = None
        self.names: tuple[str, ...] = ()
        self.in_slices = False
        """Whether somebody calls `read_some` until all is read; else shapes are read when first asked for."""

    def reload(self) -> bool:
        """Look at the project's present fit; True when it is another than before."""
        project = self.session.project
        fit_id = None if project is None else (str(project.path), project.fit_id)
        if fit_id == self._fit_id:
            return False
        self._fit_id = fit_id
        self._shapes.clear()
        self._known.clear()
        self._layers.clear()
        self._fuzzy.clear()
        self._overlaid = None
        self.names = () if project is None else project.fit_names
        hierarchy = None if project is None else project.hierarchy()
        if hierarchy is not None:
            fit = project.fit()
            self.top, self._hierarchy = hierarchy.top, hierarchy
            self._noise = 0.01**2 if fit is None else float(np.mean(fit.covariances.unary))
            # of the fit only what all shapes share is kept: memory does not grow with the collection
            self._shared = None if fit is None else (fit.templates, fit.covariances)
            self.coordinate = coordinate_colours(self.top.points)
        return True

    @property
    def inks(self) -> UInt8[np.ndarray, "L 3"]:
        """Colours (L, 3) of the parts."""
        return self.session.project.part_inks(self.top.part_names)

    @property
    def n_points(self) -> int:
        """Number of top-level template points K."""
        return self.top.n_points

    def known(self, name: str) -> Known:
        """What is known of a shape's points, read now when it has not been."""
        if name not in self._known:
            project = self.session.project
            positions, existence = project.positions(name), np.asarray(project.existence(name), bool)
            beliefs = project.beliefs(name)
            deformed, variance, _ = deformed_family(beliefs, self._hierarchy)
            gap = np.nan_to_num(np.linalg.norm(deformed - positions, axis=1), nan=1.0)
            spread = np.sqrt(variance + self._noise)
            sure = np.where(existence, confidence_of(spread, gap), 0.0)
            turn = np.asarray(beliefs.pose, float)
            self._known[name] = Known(turned(positions, turn), existence, spread, sure, turn)
        return self._known[name]

    @property
    def unread(self) -> tuple[str, ...]:
        """Shapes of which nothing is known yet.  While there are any, sums over the family are over the others."""
        return tuple(name for name in self.names if name not in self._known) if self.in_slices else ()

    def read_some(self, seconds: float) -> bool:
        """Read what is known of unread shapes for ``seconds``; True when all are read."""
        end = time.monotonic() + seconds
        for name in self.unread:
            self.known(name)
            if time.monotonic() > end:
                break
        return not self.unread

    def _at_hand(self) -> tuple[str, ...]:
        return tuple(name for name in self.names if name in self._known) if self.in_slices else self.names

    def shape(self, name: str) -> Corresponded:
        """One fitted shape, loaded now when it has not been."""
        if name in self._shapes:
            self._shapes.move_to_end(name)
            return self._shapes[name]
        project = self.session.project
        mesh = project.shapes[list(project.names).index(name)].mesh
        known = self.known(name)
        vertices, triangles, face = fine_mesh(turned(mesh.vertices, known.turn), mesh.triangles, mesh.face_of_triangle)
        positions, existence = known.positions, known.existence
        present = np.flatnonzero(existence & np.isfinite(positions).all(axis=1))
        nearest = np.zeros(len(vertices), int)
        if len(present):
            nearest = present[cKDTree(positions[present]).query(vertices)[1]]
        made = Corresponded(name, vertices, triangles, face, nearest, known)
        self._shapes[name] = made
        while len(self._shapes) > KEPT:
            old, _ = self._shapes.popitem(last=False)
            self._layers = {key: layer for key, layer in self._layers.items() if key[0] != old}
            self._fuzzy.pop(old, None)
        return made

    def is_ready(self, name: str) -> bool:
        """Whether the heat of a point on a shape can be shown at once."""
        return name in self._fuzzy

    def fuzzy(self, name: str) -> Fuzzy | None:
        """The fuzzy correspondence of a shape, computed when first asked for; None when its fit is not complete."""
        if name not in self._fuzzy:
            project, shape = self.session.project, self.shape(name)
            beliefs = project.beliefs(name)
            found = None
            if self._shared is not None and beliefs is not None:
                own = shape.vertices @ shape.known.turn  # back to how the shape lies
                found = fuzzy_correspondence(
                    project.shapes.named(name), beliefs, *self._shared, own, project.labels(name)
                )
            self._fuzzy[name] = found
        return self._fuzzy[name]

    # ---- questions -----------------------------------------------------------------------------------------------

    def confidence(self, name: str, point: int | None) -> float:
        """Confidence in 0..1 of one template point on a shape (0 where absent), or the mean over those present."""
        known = self.known(name)
        if point is not None:
            return float(known.confidence[point])
        return float(known.confidence[known.existence].mean()) if known.existence.any() else 0.0

    def point_at(self, name: str, position: Float[np.ndarray, " 3"]) -> int | None:
        """The template point that lies nearest to a place on a shape; None when the shape has none."""
        positions = self.known(name).positions
        present = np.flatnonzero(np.isfinite(positions).all(axis=1))
        if not len(present):
            return None
        return int(present[np.linalg.norm(positions[present] - position, axis=1).argmin()])

    def distances(self, first: int, second: int) -> dict[str, float]:
        """Straight distance in diagonals between two template points on every shape that has both."""
        found = {}
        for name in self._at_hand():
            positions = self.known(name).positions
            length = float(np.linalg.norm(positions[first] - positions[second]))
            if np.isfinite(length):
                found[name] = length
        return found

    def present_on(self, point: int) -> tuple[str, ...]:
        """Names of the shapes that have a template point."""
        return tuple(name for name in self._at_hand() if self.known(name).existence[point])

    def describe(self, point: int) -> str:
        """Words for a template point."""
        return describe_point(self.top.points, self.top.label, self.top.part_names, point)

    # ---- what is shown -------------------------------------------------------------------------------------------

    def display(
        self, names: Sequence[str], *, colour_by: str, picked: int | None = None, second: int | None = None,
        hover: int | None = None, selected: Sequence[str] = (), aspect: float = 1.4,
    ) -> Display:  # fmt: skip
        """One cell per name, coloured by "spread", "part", "coordinate" or "plain", the picked points on each."""
        rows, columns = grid_of(len(names), aspect)
        views = []
        for name in names:
            shape = self.shape(name)
            layer = self._layer(shape, colour_by, picked)
            views.append(
                View(
                    (layer,),
                    marks=self.marks(shape, picked, second, hover),
                    captions=self._captions(shape, picked, second),
                    confidence=self.confidence(name, picked) if picked is None or shape.existence[picked] else None,
                    selected=name in selected,
                    name=name,
                )
            )
        return Display(tuple(views), rows, columns)

    def marks(self, shape: Corresponded, picked: int | None, second: int | None, hover: int | None) -> tuple[Mark, ...]:
        """The picked points, the line between them and the point under the pointer, on one shape."""
        found: list[Mark] = []
        places = [
            None if k is None or not shape.existence[k] else _place(shape.positions[k]) for k in (picked, second, hover)
        ]
        if places[0] is not None and places[1] is not None:
            found.append(Mark("line", places[0], to=places[1]))
        if places[2] is not None:
            found.append(Mark("halo", places[2]))
        if places[1] is not None:
            found.append(Mark("ring", places[1]))
        if places[0] is not None:
            found.append(Mark("dot", places[0]))
        return tuple(found)

    def _captions(self, shape: Corresponded, picked: int | None, second: int | None) -> tuple[Caption, ...]:
        lines = [(shape.name, "strong")]
        if picked is not None and not shape.existence[picked]:
            lines.append((f"has no {self.top.part_names[self.top.label[picked]]} here", "faint"))
        elif picked is not None and second is not None and shape.existence[second]:
            length = float(np.linalg.norm(shape.positions[picked] - shape.positions[second]))
            lines.append((f"{100 * length:.1f}% of size", "plain"))
        return (Caption("top left", tuple(lines)),)

    def _layer(self, shape: Corresponded, colour_by: str, picked: int | None) -> MeshLayer:
        """The coloured mesh; the same object as long as it would look the same."""
        theme = self.session.theme
        inks = self.inks.tobytes() if colour_by == "part" else b""
        key = (shape.name, colour_by, picked if colour_by == "spread" else None, theme, inks)
        if key not in self._layers:
            for old in [k for k in self._layers if k[0] == shape.name and k[1] == colour_by]:
                del self._layers[old]
            self._layers[key] = self._coloured(shape, colour_by, picked, theme)
        return self._layers[key]

    def _coloured(self, shape: Corresponded, colour_by: str, picked: int | None, theme: Theme) -> MeshLayer:
        plain = np.array(rgb(tokens(theme)["shape"]), np.uint8)
        project = self.session.project
        if colour_by in ("part", "part_entropy"):
            if colour_by == "part":
                of_face = face_colours(project.face_labels(shape.name), self.inks)
            else:
                of_face = heat(part_bits(project.face_probabilities(shape.name)) / FULL_PART_BITS)
            return MeshLayer("shape", shape.vertices, shape.triangles, of_face[shape.face])
        colours = np.tile(plain, (len(shape.vertices), 1))
        fuzzy = (
            self.fuzzy(shape.name)
            if colour_by in ("entropy", "spread") and (picked, colour_by) != (None, "spread")
            else None
        )
        if colour_by == "coordinate":
            colours = self.coordinate[shape.nearest]
        elif fuzzy is not None and colour_by == "entropy":
            colours = heat(fuzzy.at_vertices(fuzzy.unsure))
        elif fuzzy is not None and picked is not None and shape.existence[picked]:
            share = fuzzy.at_vertices(where_it_may_lie(fuzzy, self._hierarchy, self._shared[0], picked))
            warm = share >= 0.02
            colours[warm] = heat(share[warm])
        return MeshLayer("shape", shape.vertices, shape.triangles, colours, smooth_colours=True)

    def overlay(self, first: str, second: str, moves: int = 90) -> Display:
        """Two shapes in one view: the first coloured by its distance to the second, which is see-through; lines from
        point to point."""
        theme = self.session.theme
        key = (first, second, theme)
        if self._overlaid is not None and self._overlaid[0] == key:
            return self._overlaid[1]
        a, b = self.shape(first), self.shape(second)
        away = self.distance_to(first, second)
        blue = np.tile(np.array(rgb(tokens(theme)["accent"]), np.uint8), (len(b.triangles), 1))
        both = np.flatnonzero(np.isfinite(a.positions).all(axis=1) & np.isfinite(b.positions).all(axis=1))
        both = both[:: max(len(both) // moves, 1)]
        segments = np.stack([a.positions[both], b.positions[both]], axis=1)
        layers = (
            MeshLayer("shape", a.vertices, a.triangles, heat(away / FARTHEST), smooth_colours=True),
            MeshLayer("other", b.vertices, b.triangles, blue, opacity=0.22, pickable=False),
            LineLayer("moves", segments, rgb(tokens(theme)["text"]), 1.0, 0.4),
        )
        mean = float(np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1).mean()) if len(both) else float("nan")
        of_face = away[a.triangles].mean(axis=1)
        corners = a.vertices[a.triangles]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        apart = float((of_face * area).sum() / max(area.sum(), 1e-12))
        words = (
            (f"{first}, by its distance to {second}", "strong"),
            (f"surface {100 * apart:.1f}% of size apart in the mean, at most {100 * away.max():.1f}%", "plain"),
            (f"the same points {100 * mean:.1f}% apart", "plain"),
        )
        self._overlaid = (key, Display((View(layers, captions=(Caption("top left", words),), name=first),)))
        return self._overlaid[1]

    def distance_to(self, first: str, second: str) -> Float[np.ndarray, " V"]:
        """Distance (V,) in diagonals of every shown vertex of a shape to the other's surface, both turned alike."""
        project, turn = self.session.project, self.known(second).turn
        own = self.shape(first).vertices @ turn  # as the second shape lies
        return closest_points(project.shapes.named(second).mesh, own)[2]


def _place(position: np.ndarray) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
