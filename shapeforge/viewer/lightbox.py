"""Many fitted shapes side by side: where one template point lies on each, how sure that is, what two of them measure.

No Qt here: the window and the notebook show the Displays made by :class:`Lightbox`.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from scipy.stats import chi2

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
from shapeforge.viewer.palette import UNPAINTED, Theme, heat, rgb, tokens
from shapeforge.viewer.session import Session

CLOSE = 0.05  # diagonals: the confidence of a point is the chance that it lies this near to where it is shown
GAP = 0.04  # diagonals: a deformed point this far off the surface counts for little
FINEST_EDGE = 0.045  # diagonals: longer edges are halved for display, so that heat can vary over large faces
MOST_TRIANGLES = 60_000
KEPT = 64


@dataclass(frozen=True, eq=False)
class Known:
    """What the fit says of one shape's K corresponding points, without its mesh: small, so it is kept for all shapes.

    ``spread`` (K,) is the standard deviation of each point in diagonals, ``confidence`` (K,) in 0..1, 0 where absent.
    """

    positions: Float[np.ndarray, "K 3"]
    existence: Bool[np.ndarray, " K"]
    spread: Float[np.ndarray, " K"]
    confidence: Float[np.ndarray, " K"]


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


def fine_mesh(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], record: Int[np.ndarray, " N"],
    longest: float = FINEST_EDGE, most: int = MOST_TRIANGLES,
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "M 3"], Int[np.ndarray, " M"]]:  # fmt: skip
    """The same surface with edges longer than ``longest`` halved until none is, or there are ``most`` triangles.

    Each split edge gets one new vertex that its neighbours share, so there are no cracks.
    """
    vertices, triangles, record = np.asarray(vertices, float), np.asarray(triangles), np.asarray(record)
    for _ in range(8):
        ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        long = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1) > longest
        if not long.any() or len(triangles) + 2 * long.sum() > most:
            break
        edges, which = np.unique(ends[long], axis=0, return_inverse=True)
        middle = np.full(len(ends), -1)
        middle[long] = len(vertices) + which
        vertices = np.vstack([vertices, vertices[edges].mean(axis=1)])
        triangles, record = _split(triangles, middle.reshape(-1, 3), record)
    return vertices, triangles, record


def _split(triangles: np.ndarray, middle: np.ndarray, record: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles with some edges' middles given (N, 3), -1 where an edge stays; into one to four triangles each."""
    count = (middle >= 0).sum(axis=1)
    parts, owners = [triangles[count == 0]], [record[count == 0]]
    one = np.flatnonzero(count == 1)
    turn = middle[one].argmax(axis=1)[:, None]
    a, b, c = (np.take_along_axis(triangles[one], (turn + i) % 3, axis=1)[:, 0] for i in range(3))
    m = middle[one].max(axis=1)
    parts += [np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
    owners += [record[one]] * 2
    two = np.flatnonzero(count == 2)
    whole = (middle[two] < 0).argmax(axis=1)[:, None]  # the edge that stays: a to b; c is opposite
    a, b, c = (np.take_along_axis(triangles[two], (whole + i) % 3, axis=1)[:, 0] for i in range(3))
    bc, ca = (np.take_along_axis(middle[two], (whole + i) % 3, axis=1)[:, 0] for i in (1, 2))
    parts += [np.stack([a, b, bc], axis=1), np.stack([a, bc, ca], axis=1), np.stack([ca, bc, c], axis=1)]
    owners += [record[two]] * 3
    three = np.flatnonzero(count == 3)
    (a, b, c), (ab, bc, ca) = triangles[three].T, middle[three].T
    parts += [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    owners += [record[three]] * 4
    return np.concatenate(parts), np.concatenate(owners)


def confidence_of(spread: Float[np.ndarray, " K"], gap: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """Chance (K,) that a point with this isotropic standard deviation lies within CLOSE of where it is shown, times a
    penalty for the ``gap`` (diagonals) between the deformed point and the surface."""
    near = chi2.cdf((CLOSE / np.maximum(spread, 1e-6)) ** 2, 3)
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
        self.names = () if project is None else project.fit_names
        hierarchy = None if project is None else project.hierarchy()
        if hierarchy is not None:
            fit = project.fit()
            self.top, self._hierarchy = hierarchy.top, hierarchy
            self._noise = 0.01**2 if fit is None else float(np.mean(fit.covariances.unary))
            self.coordinate = coordinate_colours(self.top.points)
        return True

    @property
    def n_points(self) -> int:
        """Number of top-level template points K."""
        return self.top.n_points

    def known(self, name: str) -> Known:
        """What is known of a shape's points, read now when it has not been."""
        if name not in self._known:
            project = self.session.project
            positions, existence = project.positions(name), np.asarray(project.existence(name), bool)
            deformed, variance, _ = deformed_family(project.beliefs(name), self._hierarchy)
            gap = np.nan_to_num(np.linalg.norm(deformed - positions, axis=1), nan=1.0)
            spread = np.sqrt(variance + self._noise)
            sure = np.where(existence, confidence_of(spread, gap), 0.0)
            self._known[name] = Known(np.asarray(positions, float), existence, spread, sure)
        return self._known[name]

    def shape(self, name: str) -> Corresponded:
        """One fitted shape, loaded now when it has not been."""
        if name in self._shapes:
            self._shapes.move_to_end(name)
            return self._shapes[name]
        project = self.session.project
        mesh = project.shapes[list(project.names).index(name)].mesh
        vertices, triangles, face = fine_mesh(mesh.vertices, mesh.triangles, mesh.face_of_triangle)
        known = self.known(name)
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
        return made

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
        for name in self.names:
            positions = self.known(name).positions
            length = float(np.linalg.norm(positions[first] - positions[second]))
            if np.isfinite(length):
                found[name] = length
        return found

    def present_on(self, point: int) -> tuple[str, ...]:
        """Names of the shapes that have a template point."""
        return tuple(name for name in self.names if self.known(name).existence[point])

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
        key = (shape.name, colour_by, picked if colour_by == "spread" else None, theme)
        if key not in self._layers:
            for old in [k for k in self._layers if k[0] == shape.name and k[1] == colour_by]:
                del self._layers[old]
            self._layers[key] = self._coloured(shape, colour_by, picked, theme)
        return self._layers[key]

    def _coloured(self, shape: Corresponded, colour_by: str, picked: int | None, theme: Theme) -> MeshLayer:
        if colour_by == "part":
            labels = self.session.project.face_labels(shape.name)
            colours = face_colours(labels, len(self.top.part_names))[shape.face]
            return MeshLayer("shape", shape.vertices, shape.triangles, colours)
        if colour_by == "coordinate":
            colours = self.coordinate[shape.nearest]
        elif colour_by == "spread" and picked is not None and shape.existence[picked]:
            away = ((shape.vertices - shape.positions[picked]) ** 2).sum(axis=1)
            share = np.exp(-0.5 * away / max(float(shape.known.spread[picked]), FINEST_EDGE / 1.5) ** 2)
            # Only where the point's own part is: a place on another part is not where it may lie.
            share = share * (self.top.label[shape.nearest] == self.top.label[picked])
            colours = heat(share)
            colours[share < 0.02] = rgb(tokens(theme)["shape"])
        else:
            colours = np.broadcast_to(np.array(rgb(tokens(theme)["shape"]), np.uint8), shape.vertices.shape).copy()
        return MeshLayer("shape", shape.vertices, shape.triangles, colours, smooth_colours=True)

    def overlay(self, first: str, second: str, moves: int = 90) -> Display:
        """Two shapes in one view: the first in grey, the second see-through, lines from point to point."""
        a, b = self.shape(first), self.shape(second)
        theme = self.session.theme
        grey = np.tile(np.array(rgb(UNPAINTED), np.uint8), (len(a.triangles), 1))
        blue = np.tile(np.array(rgb(tokens(theme)["accent"]), np.uint8), (len(b.triangles), 1))
        both = np.flatnonzero(np.isfinite(a.positions).all(axis=1) & np.isfinite(b.positions).all(axis=1))
        both = both[:: max(len(both) // moves, 1)]
        segments = np.stack([a.positions[both], b.positions[both]], axis=1)
        layers = (
            MeshLayer("shape", a.vertices, a.triangles, grey),
            MeshLayer("other", b.vertices, b.triangles, blue, opacity=0.35, pickable=False),
            LineLayer("moves", segments, rgb(tokens(theme)["text"]), 1.0, 0.4),
        )
        mean = float(np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1).mean()) if len(both) else float("nan")
        words = ((f"{first} and {second}", "strong"), (f"points {100 * mean:.1f}% of size apart", "plain"))
        return Display((View(layers, captions=(Caption("top left", words),), name=first),))


def _place(position: np.ndarray) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
