"""From scratch (§7): a new closed surface around a draw's points, which has no triangle of a training mesh.

The deformation of every part is known at its points; embedded deformation carries it between them, to the whole
surface of the training shapes whose part is most like the draw's.  Those surfaces, bent to one place and closed, are
turned into signed distances on a lattice, and their mean has the new part's surface at zero: as smooth and as thin as
theirs are, and in the middle between them.  Parts are united, so that the surface is one and closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import label as connected
from scipy.ndimage import map_coordinates, maximum_filter
from scipy.sparse import csr_array

from shapeforge.collection.materials import PLAIN
from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.assemble import SynthesizedShape, put_together
from shapeforge.synthesis.bending import BentPart, bend, start_part
from shapeforge.synthesis.closing import closed_solids
from shapeforge.synthesis.distance_field import signed_distance
from shapeforge.synthesis.isosurface import isosurface
from shapeforge.synthesis.measures import open_edges, symmetry_error
from shapeforge.synthesis.retrieve import part_distances, retrieve
from shapeforge.synthesis.sources import Sources
from shapeforge.synthesis.surfaces import Triangles, Vertices, as_mesh

LENDERS = 3
"""Training shapes, at most, whose parts a new part is the mean of."""
FARTHER = 1.5
"""They are at most so many times as far from the draw as the nearest one ..."""
ALIKE, MOST = 0.012, 0.95
"""... and, once bent, so near (diagonals) to most of the surface of the first: means of unlike ones have holes."""
LATTICE = 2_500_000
"""Points of the lattice, as near as may be ..."""
FINEST, COARSEST = 0.0035, 0.008
"""... with a step (diagonals) between these."""
MARGIN = 4
"""Steps of the lattice around everything."""
BAND = 4.0
"""Distances are known so many steps to either side of a surface."""
THINNEST = 0.7
"""Half the thickness, in steps of the lattice, that thinner plates are given, or they would have holes."""
FAIRINGS = 4
SMALLEST = 2e-4
"""Pieces with a smaller share of the volume are left out: crumbs."""


@dataclass(frozen=True, eq=False)
class _Lattice:
    """Points ``origin`` + ``cell`` (i, j, k)."""

    origin: Float[np.ndarray, " 3"]
    cell: float
    shape: tuple[int, int, int]


def synthesize_surface(
    points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], sources: Sources, *,
    cell: float | None = None, symmetric: bool = True,
) -> SynthesizedShape:  # fmt: skip
    """A new closed mesh for a draw; ``points`` in normal coordinates, NaN where absent.

    Details finer than the lattice's step ``cell`` (diagonals; by default as its size asks for) are lost.
    ``symmetric`` as in ``assemble.synthesize``.  Colours are those of the nearest lender; ``measures["lenders"]`` tells
    them per part.  Raises ValueError for points of another fit than the sources, and for a draw without points.
    """
    if points.shape != (len(sources.part), 3) or exists.shape != (sources.n_parts,):
        raise ValueError(
            f"points, exists: wanted ({len(sources.part)}, 3) and ({sources.n_parts},), got {points.shape} and "
            f"{exists.shape}. Do the draw and the sources come from the same fit?"
        )
    points = np.where(exists[sources.part][:, None], np.asarray(points, float), np.nan)
    if symmetric:
        points = sources.mirror.made_symmetric(points, sources.part)
    shapes = retrieve(points, exists, sources).shape
    bent = put_together(points, exists, sources, shapes, preview=False).bent
    if not bent:
        raise ValueError("points: wanted a draw with points, got none. Does it have any part?")
    lattice = _lattice_around(np.concatenate([part.vertices for part in bent.values()]), cell)
    lenders = {l: [part, *_others(points, l, int(shapes[l]), sources)] for l, part in bent.items()}
    fields, counted = {}, {}
    for l, given in lenders.items():
        fields[l], counted[l] = _mean_field(given, lattice)
    steps, triangles = isosurface(_without_crumbs(np.maximum.reduce(list(fields.values()))), 0.0)
    steps = _fair(steps, triangles)
    vertices = lattice.origin + lattice.cell * steps
    centres = steps[triangles].mean(axis=1).T
    inside = np.stack([map_coordinates(field, centres, order=1, mode="nearest") for field in fields.values()])
    part = np.array(list(fields))[inside.argmax(axis=0)].astype(np.int32)
    known = np.isfinite(points).all(axis=1)
    plane = sources.mirror.normal, sources.mirror.place(points, sources.part)
    measures = {
        "symmetry_error": symmetry_error(vertices, plane),
        "distance_from_draw": float(closest_points(as_mesh(vertices, triangles), points[known])[2].mean()),
        "open_edges": open_edges(triangles),
        "n_triangles": len(triangles),
        "lenders": {sources.part_names[l]: counted[l] for l in counted},
    }
    return SynthesizedShape(
        vertices, triangles, part, sources.part_names, ("",) * sources.n_parts, measures,
        _colours(vertices, triangles, part, bent),
    )  # fmt: skip


def _lattice_around(vertices: np.ndarray, cell: float | None) -> _Lattice:
    """A lattice with a margin around these points; its step as LATTICE, FINEST and COARSEST ask for if it is None."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if cell is None:
        volume = float(np.prod(high - low + 2 * MARGIN * FINEST))
        cell = float(np.clip((volume / LATTICE) ** (1 / 3), FINEST, COARSEST))
    shape = tuple((np.ceil((high - low) / cell).astype(int) + 2 * MARGIN + 1).tolist())
    return _Lattice(low - MARGIN * cell, cell, shape)


def _others(points: np.ndarray, part: int, first: int, sources: Sources) -> list[BentPart]:
    """The part of further training shapes that are about as near to the draw as the ``first``, bent to it."""
    away = part_distances(points, sources, part)
    found: list[BentPart] = []
    for t in np.argsort(away, kind="stable")[: 2 * LENDERS]:
        if len(found) == LENDERS - 1 or not away[t] <= FARTHER * away[first]:
            break
        source = None if t == first else sources.part_of(int(t), part)
        started = None if source is None or source.quality.badness else start_part(source, points)
        if started is not None:
            found.append(bend(started, {}, preview=True))
    return found


def _mean_field(lenders: list[BentPart], lattice: _Lattice) -> tuple[Float[np.ndarray, "X Y Z"], list[str]]:
    """Signed distance from the mean surface of the lenders that are like the first, and their names; -BAND far away."""
    reach = BAND * lattice.cell
    field = np.full(lattice.shape, -reach)
    at = lenders[0].vertices
    low = np.clip(((at.min(axis=0) - lattice.origin) / lattice.cell).astype(int) - MARGIN, 0, None)
    high = np.minimum(((at.max(axis=0) - lattice.origin) / lattice.cell).astype(int) + MARGIN + 2, lattice.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    origin, shape = lattice.origin + lattice.cell * low, tuple((high - low).tolist())
    total, names = None, []
    for lender in lenders:
        vertices, triangles = _solid(lender)
        own = signed_distance(vertices, triangles, origin, lattice.cell, shape, reach)
        if total is None:
            first, total = own, own.copy()
            near = np.abs(first) < 0.5 * reach
        elif near.any() and float(np.quantile(np.abs(own - first)[near], MOST)) <= ALIKE:
            total += own
        else:
            continue
        names.append(lender.source.shape)
    mean = total / len(names)
    least = THINNEST * lattice.cell
    field[box] = mean + np.clip(least - maximum_filter(mean, 3), 0, least)
    return field, names


def _solid(part: BentPart) -> tuple[Vertices, Triangles]:
    """The bent part as closed surfaces in one mesh."""
    vertices, triangles, count = [], [], 0
    for solid in closed_solids(part.vertices, part.source.triangles):
        vertices.append(solid.vertices)
        triangles.append(solid.triangles + count)
        count += len(solid.vertices)
    return np.concatenate(vertices), np.concatenate(triangles)


def _colours(
    vertices: Vertices, triangles: Triangles, part: Int[np.ndarray, " N"], bent: dict[int, BentPart]
) -> UInt8[np.ndarray, "N 3"] | None:
    """Colours of the nearest triangle of the part that was bent; None where no part has any."""
    if all(piece.source.colours is None for piece in bent.values()):
        return None
    found = np.tile(np.uint8(PLAIN), (len(triangles), 1))
    centres = vertices[triangles].mean(axis=1)
    for l, piece in bent.items():
        rows = np.flatnonzero(part == l)
        if piece.source.colours is not None and len(rows):
            found[rows] = piece.source.colours[closest_points(piece.surface, centres[rows])[1]]
    return found


def _fair(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"]) -> Float[np.ndarray, "V 3"]:
    """The vertices without the lattice's steps and small bumps: smoothing that does not shrink (Taubin 1995)."""
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    joined = csr_array((np.ones(len(ends)), ends.T), shape=(len(vertices),) * 2)  # closed: every edge both ways
    degree = np.maximum(joined.sum(axis=1), 1)[:, None]
    for _ in range(FAIRINGS):
        for step in (0.5, -0.53):
            vertices = vertices + step * (joined @ vertices / degree - vertices)
    return vertices


def _without_crumbs(field: np.ndarray) -> Float[np.ndarray, "X Y Z"]:
    """The field without connected insides that hold less than SMALLEST of the whole inside."""
    piece, count = connected(field > 0)
    size = np.bincount(piece.ravel(), minlength=count + 1)
    size[0] = 0
    return np.where(((size < SMALLEST * size.sum()) & (size > 0))[piece], field.min(), field)
