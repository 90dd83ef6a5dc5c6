"""From scratch (§7): a new closed surface around a draw's points, which has no triangle of a training mesh.

The deformation of every part is known at its points; embedded deformation carries it between them, to the whole
surface of the training shapes whose part is most like the draw's.  Those surfaces, bent to one place and closed, are
turned into signed distances on a lattice, and their mean has the new part's surface at zero: as smooth and as thin as
theirs are, and in the middle between them.  Parts are united, so that the surface is one and closed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import label as connected
from scipy.ndimage import map_coordinates, maximum_filter
from scipy.sparse import csr_array

from shapeforge.collection.materials import PLAIN
from shapeforge.collection.surface import SearchedMesh, closest_points
from shapeforge.synthesis.assemble import SynthesizedShape, as_symmetric, put_together
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
SNAPS = 4
"""Times that vertices on a seam of two parts are moved onto one and the other in turn, the others twice onto their own:
the lenders' mean surfaces know of no lattice."""
HALVINGS, HOLDS = 5, 60
"""So many times vertices of triangles which that turned over are halved in their way; then they stay where they were,
in so many rounds at most."""
SEAM = 0.5
"""A vertex is on the seam if it is as near to both parts, but for this share of the lattice's step."""
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
    cell: float | None = None, symmetric: bool | Bool[np.ndarray, " L"] = True,
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
    points = as_symmetric(points, sources, symmetric)
    shapes = retrieve(points, exists, sources).shape
    bent = put_together(points, exists, sources, shapes, preview=False).bent
    if not bent:
        raise ValueError("points: wanted a draw with points, got none. Does it have any part?")
    lattice = _lattice_around(np.concatenate([part.vertices for part in bent.values()]), cell)
    means = {l: _mean(part, _others(part, points, int(shapes[l]), sources), lattice) for l, part in bent.items()}
    steps, triangles = isosurface(_without_crumbs(np.maximum.reduce([mean.field for mean in means.values()])), 0.0)
    steps = _fair(steps, triangles)
    part = _innermost(means, steps[triangles].mean(axis=1))[0]
    plain = lattice.origin + lattice.cell * steps
    vertices = held_back(plain, _snapped(plain, *_innermost(means, steps), means, lattice.cell), triangles)
    known = np.isfinite(points).all(axis=1)
    plane = sources.mirror.normal, sources.mirror.place(points, sources.part)
    measures = {
        "symmetry_error": symmetry_error(vertices, plane),
        "distance_from_draw": float(closest_points(as_mesh(vertices, triangles), points[known])[2].mean()),
        "open_edges": open_edges(triangles),
        "folded_triangles": int(_turned_over(plain, vertices, triangles).sum()),
        "n_triangles": len(triangles),
        "lenders": {sources.part_names[l]: list(mean.names) for l, mean in means.items()},
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


def _others(part: BentPart, points: np.ndarray, first: int, sources: Sources) -> list[BentPart]:
    """The part of further training shapes that are about as near to the draw as the ``first``, bent to where the
    ``part`` of that one was put: there it touches the others."""
    l, wanted = part.source.part, np.full(points.shape, np.nan)
    wanted[part.source.template] = part.placed
    away = part_distances(points, sources, l)
    found: list[BentPart] = []
    for t in np.argsort(away, kind="stable")[: 2 * LENDERS]:
        if len(found) == LENDERS - 1 or not away[t] <= FARTHER * away[first]:
            break
        source = None if t == first else sources.part_of(int(t), l)
        started = None if source is None or source.quality.badness else start_part(source, wanted)
        if started is not None:
            found.append(bend(started, {}, preview=True))
    return found


@dataclass(frozen=True, eq=False)
class _Mean:
    """The mean of bent parts: signed distance ``field`` on a lattice of step ``cell``, -BAND steps far away; their
    closed ``solids`` and ``names``."""

    field: Float[np.ndarray, "X Y Z"]
    cell: float
    solids: tuple[SearchedMesh, ...]
    names: tuple[str, ...]

    def nearest(self, places: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """The places moved as the ways to the nearest points of all lenders are on average: near the mean surface."""
        return np.mean([closest_points(solid, places)[0] for solid in self.solids], axis=0)


def _mean(part: BentPart, others: list[BentPart], lattice: _Lattice) -> _Mean:
    """The mean of a part and of those of the others that are like it."""
    reach = BAND * lattice.cell
    field = np.full(lattice.shape, -reach)
    at = part.vertices
    low = np.clip(((at.min(axis=0) - lattice.origin) / lattice.cell).astype(int) - MARGIN, 0, None)
    high = np.minimum(((at.max(axis=0) - lattice.origin) / lattice.cell).astype(int) + MARGIN + 2, lattice.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    origin, shape = lattice.origin + lattice.cell * low, tuple((high - low).tolist())
    solids = [_solid(part)]
    first = signed_distance(solids[0].vertices, solids[0].triangles, origin, lattice.cell, shape, reach)
    total, names, near = first.copy(), [part.source.shape], np.abs(first) < 0.5 * reach
    for lender in others:
        solid = _solid(lender)
        own = signed_distance(solid.vertices, solid.triangles, origin, lattice.cell, shape, reach)
        if near.any() and float(np.quantile(np.abs(own - first)[near], MOST)) <= ALIKE:
            total += own
            solids.append(solid)
            names.append(lender.source.shape)
    mean = total / len(names)
    least = THINNEST * lattice.cell
    field[box] = mean + np.clip(least - maximum_filter(mean, 3), 0, least)
    return _Mean(field, lattice.cell, tuple(solids), tuple(names))


def _innermost(means: Mapping[int, _Mean], steps: Float[np.ndarray, "P 3"]) -> tuple[np.ndarray, np.ndarray]:
    """The part (P,) that each place (lattice steps) is deepest in, or nearest to, and the next one (P,) if it is hardly
    less so (by SEAM times the lattice's step, which the fields tell); else -1."""
    inside = np.stack([map_coordinates(mean.field, steps.T, order=1, mode="nearest") for mean in means.values()])
    parts, cell = np.array(list(means), np.int32), next(iter(means.values())).cell
    first = inside.argmax(axis=0)
    depth = inside.max(axis=0)
    np.put_along_axis(inside, first[None], -np.inf, axis=0)
    return parts[first], np.where(inside.max(axis=0) > depth - SEAM * cell, parts[inside.argmax(axis=0)], -1)


def _snapped(
    vertices: Float[np.ndarray, "V 3"], part: Int[np.ndarray, " V"], other: Int[np.ndarray, " V"],
    means: Mapping[int, _Mean], most: float,
) -> Float[np.ndarray, "V 3"]:  # fmt: skip
    """The vertices on the mean surface of their part, and on the seam with the ``other`` part if there is one (not -1).

    A lattice tells a plate that is hardly thicker than its step only roughly: in terraces, and a seam in teeth.  No
    vertex goes farther than ``most`` (diagonals).
    """
    moved, seam = vertices.copy(), other >= 0
    for turn in range(SNAPS):
        # On their own part last: where two run along each other, there is no seam to be found.
        for which, rows in ((other, seam), (part, seam | (turn < 2))):
            for l, mean in means.items():
                own = np.flatnonzero(rows & (which == l))
                moved[own] = mean.nearest(moved[own])
    way = moved - vertices
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return vertices + way * np.minimum(1, most / np.maximum(length, 1e-12))


def held_back(
    plain: Float[np.ndarray, "V 3"], moved: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"]
) -> Float[np.ndarray, "V 3"]:
    """The ``moved`` vertices; those of triangles that would turn over go a part of their way from ``plain`` only.

    Along the edge of a wing many vertices have their nearest point on one line, and in another order than theirs.
    """
    share = np.ones((len(plain), 1))
    for turn in range(HALVINGS + HOLDS):
        vertices = plain + share * (moved - plain)
        turned = triangles[_turned_over(plain, vertices, triangles)]
        if not len(turned):
            break
        share[np.unique(turned)] *= 0.5 if turn < HALVINGS else 0.0
    return vertices


def _turned_over(
    plain: Float[np.ndarray, "V 3"], vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"]
) -> Bool[np.ndarray, " N"]:
    """Triangles that face the other way than on the ``plain`` surface, which has no folds."""
    facing, before = (
        np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]) for at in (vertices[triangles], plain[triangles])
    )
    return (facing * before).sum(axis=1) < 0


def _solid(part: BentPart) -> SearchedMesh:
    """The bent part as closed surfaces in one mesh."""
    vertices, triangles, count = [], [], 0
    for solid in closed_solids(part.vertices, part.source.triangles):
        vertices.append(solid.vertices)
        triangles.append(solid.triangles + count)
        count += len(solid.vertices)
    return as_mesh(np.concatenate(vertices), np.concatenate(triangles))


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
