"""What a view shows, as arrays: meshes, points, lines, marks and words.  Pure numpy; nothing here draws.

A place turns the Session into a :class:`Display`; ``scene.py`` puts its meshes, points and lines into a plotter, the
window paints its marks and words above them.  Layers are compared by the identity of their arrays: a place that keeps
an array object alive pays nothing for it in the next frame.  All positions are normal coordinates (diagonals, y up).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from shapeforge.viewer.palette import SWITCHED_OFF, label_colours, pale, rgb

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class MeshLayer:
    """Triangles with one colour each, or (``smooth_colours``) one colour per vertex, blended in between.

    ``record`` (N,) is the face record of each triangle: with ``edges`` the borders of the records are drawn.
    """

    key: str
    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    colours: UInt8[np.ndarray, "M 3"]
    smooth_colours: bool = False
    opacity: float | int = 1.0
    edges: bool = False
    record: Int[np.ndarray, " N"] | None = None
    pickable: bool = True


@dataclass(frozen=True, eq=False)
class PointLayer:
    """Round dots of ``size`` logical pixels, one colour each."""

    key: str
    positions: Float[np.ndarray, "n 3"]
    colours: UInt8[np.ndarray, "n 3"]
    size: float | int = 5.0
    opacity: float | int = 1.0


@dataclass(frozen=True, eq=False)
class LineLayer:
    """Straight segments (n, 2, 3), ``width`` logical pixels."""

    key: str
    segments: Float[np.ndarray, "n 2 3"]
    colour: Colour
    width: float | int = 1.0
    opacity: float | int = 1.0


@dataclass(frozen=True)
class Mark:
    """Something small drawn above the shape in window pixels, at a place on the shape.

    ``kind``: "dot" (filled, white rim), "ring" (hollow), "halo" (hollow, accent), "brush" (ring of ``radius``
    diagonals in the plane with normal ``to``), "twin" (dashed such ring), "line" (dashed, from ``at`` to ``to``),
    "arrow" (from ``at`` to ``to``), "note" (a word with a pin), "pin" (its tip at ``at``), "circle" (such a ring that
    can be taken hold of: its far half is faint). The last two are larger and thicker where ``text`` is "held".
    """

    kind: str
    at: tuple[float, float, float]
    to: tuple[float, float, float] | None = None
    radius: float = 0.0
    colour: Colour | None = None
    text: str = ""


@dataclass(frozen=True)
class Caption:
    """Words in a corner of a view ("top left", "top right", "bottom left", "bottom right"): lines of (text, role).

    Roles: "strong", "plain", "faint", "accent", "ok", "warning", "error".
    """

    corner: str
    lines: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class View:
    """One cell of the window: its layers, marks and words.  ``confidence`` (0..1) draws the bar at the bottom right.

    While it ``moves`` the shadow on the floor stays as it was.
    """

    layers: tuple[MeshLayer | PointLayer | LineLayer, ...] = ()
    marks: tuple[Mark, ...] = ()
    captions: tuple[Caption, ...] = ()
    confidence: float | None = None
    selected: bool = False
    ground: bool = True
    moves: bool = False
    name: str = ""

    def meshes(self) -> tuple[MeshLayer, ...]:
        """The mesh layers that can be picked."""
        return tuple(layer for layer in self.layers if isinstance(layer, MeshLayer) and layer.pickable)


@dataclass(frozen=True, eq=False)
class Display:
    """Everything a window's centre shows: ``views`` fill ``rows`` x ``columns`` cells, row by row."""

    views: tuple[View, ...] = field(default_factory=tuple)
    rows: int = 1
    columns: int = 1

    def with_marks(self, marks: Sequence[Sequence[Mark]]) -> Display:
        """The same display with other marks in each view: the arrays keep their identity, so nothing is redrawn."""
        return replace(
            self, views=tuple(replace(view, marks=tuple(new)) for view, new in zip(self.views, marks, strict=True))
        )


def face_colours(
    labels: Int[np.ndarray, " F"], inks: UInt8[np.ndarray, "L 3"], hidden: Collection[int] = ()
) -> UInt8[np.ndarray, "F 3"]:
    """Colour of every face record (F, 3) from its part index (-1: unpainted); ``hidden`` parts in switched-off grey."""
    colours = label_colours(labels, inks)
    for part in hidden:
        colours[labels == part] = rgb(SWITCHED_OFF)
    return colours


def probability_colours(
    probabilities: Float[np.ndarray, "F L"], inks: UInt8[np.ndarray, "L 3"]
) -> UInt8[np.ndarray, "F 3"]:
    """The probable part's colour (F, 3), paler the smaller its margin over the second part: a coin toss is all pale."""
    best = probabilities.argmax(axis=1)
    if probabilities.shape[1] == 1:
        return label_colours(best, inks)
    top = np.sort(probabilities, axis=1)[:, -2:]
    margin = (top[:, 1] - top[:, 0]) / np.maximum(top.sum(axis=1), 1e-12)
    return pale(label_colours(best, inks), np.clip(margin, 0, 1).astype(float) ** 0.7)


def record_borders(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], record: Int[np.ndarray, " N"]
) -> Float[np.ndarray, "n 2 3"]:
    """The edges of the face records as segments (n, 2, 3): a quad's diagonal is not among them."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    owner = np.repeat(np.asarray(record, np.int64), 3)
    key = edges[:, 0] * (len(vertices) + 1) + edges[:, 1]
    order = np.lexsort((owner, key))
    key, owner, edges = key[order], owner[order], edges[order]
    first = np.r_[True, key[1:] != key[:-1]]
    start = np.flatnonzero(first)
    count = np.diff(np.r_[start, len(key)])
    last = start + count - 1
    inner = (count >= 2) & (owner[start] == owner[last])
    return vertices[edges[start[~inner]]].astype(np.float32)


def grid_of(count: int, aspect: float = 1.4) -> tuple[int, int]:
    """Rows and columns for ``count`` cells in a space ``aspect`` times as wide as high, cells near square."""
    if count < 1:
        return 1, 1
    best = min(
        ((rows, -(-count // rows)) for rows in range(1, count + 1)),
        key=lambda rc: abs(np.log(aspect * rc[0] / rc[1])) + 0.15 * (rc[0] * rc[1] - count),
    )
    return best


def coordinate_colours(positions: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours that name a place of the template: x as red, y as green, z as blue, softened to stay light (n, 3)."""
    low, high = np.nanmin(positions, axis=0), np.nanmax(positions, axis=0)
    unit = (positions - low) / np.maximum(high - low, 1e-9)
    return np.round(60 + 180 * np.nan_to_num(unit, nan=0.4)).astype(np.uint8)
