"""Open and tangled surfaces made closed solids, with their own faces kept: what a boolean union needs.

Files have sheets, missing bottoms, halves that share the faces between them, and more than two faces at an edge.  Here
membranes inside go, surfaces that merely meet at an edge are told apart, holes get lids, and sheets a thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix, csr_array
from scipy.sparse.csgraph import breadth_first_order

from shapeforge.synthesis.capping import loops_of
from shapeforge.synthesis.cleaning import areas, components
from shapeforge.synthesis.surfaces import Triangles, Vertices, distinct_triangles, sides_of, split_sides, weld

SHEET = 0.006
"""Thickness (diagonals) that surfaces without one are given."""
LIDS = 0.25
"""Lids may have this share of a closed surface; one that would need more of them is a sheet, or a bowl."""
HOLLOW = 0.5
"""With lids a surface is at least this share of SHEET thick (twice its volume by its area), or it is a sheet."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface, wound outwards; every edge has two triangles.  ``area`` is that of the surface that was given,
    and ``mended`` whether it had to be closed."""

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    area: float
    mended: bool


def closed_solids(vertices: Vertices, triangles: Triangles) -> list[Solid]:
    """The connected surfaces of a mesh in diagonals as closed solids, which may overlap; coinciding vertices are one.

    What is closed stays as it is.
    """
    vertices, triangles = weld(vertices, triangles)
    collapsed = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    triangles = triangles[distinct_triangles(triangles) & ~collapsed]  # slivers stay: without them, holes
    triangles = triangles[_outer(vertices, triangles)]
    sides = _pairs(vertices, triangles)
    component = components(len(triangles), *(sides // 3).T)
    found = []
    for one in range(int(component.max()) + 1 if len(triangles) else 0):
        rows = np.flatnonzero(component == one)
        place = np.full(len(triangles), -1)
        place[rows] = np.arange(len(rows))
        own = sides[component[sides[:, 0] // 3] == one]
        found.append(_closed(vertices, triangles[rows], 3 * place[own // 3] + own % 3))
    return found


def _outer(vertices: np.ndarray, triangles: np.ndarray) -> Bool[np.ndarray, " N"]:
    """All triangles but the membranes: patches whose every border edge has an even number of triangles without them."""
    kept = np.ones(len(triangles), bool)
    area = areas(vertices, triangles)
    while True:
        rows = np.flatnonzero(kept)
        edge = sides_of(triangles[rows])[1]
        count = np.bincount(edge)[edge].reshape(-1, 3)
        if not (count > 2).any():
            return kept
        patch = components(len(rows), *(_simple_pairs(edge) // 3).T)
        rim = np.bincount(patch, (count != 2).sum(axis=1))
        odd = np.bincount(patch, ((count > 2) & (count % 2 == 1)).sum(axis=1))
        size = np.bincount(patch, area[rows])
        spare = (rim > 0) & (odd == rim) & (size < 0.5 * size.sum())
        if not spare.any():
            return kept
        kept[rows[patch == np.where(spare, size, np.inf).argmin()]] = False


def _simple_pairs(edge: np.ndarray) -> Int[np.ndarray, "P 2"]:
    """Pairs of sides whose edge only they have; ``edge`` (3N,) is the edge of each side."""
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero((np.diff(edge[order]) == 0) & (np.bincount(edge)[edge[order[:-1]]] == 2))
    return np.stack([order[first], order[first + 1]], axis=1)


def _pairs(vertices: np.ndarray, triangles: np.ndarray) -> Int[np.ndarray, "P 2"]:
    """Which sides (3 n + i: from corner i to i + 1 of triangle n) are joined; each at most once.

    Where more than two triangles have an edge those of one patch go together, else neighbours around the edge.
    """
    edges, edge = sides_of(triangles)
    pairs = _simple_pairs(edge)
    patch = components(len(triangles), *(pairs // 3).T)
    order = np.argsort(edge, kind="stable")
    start = np.searchsorted(edge[order], np.arange(len(edges) + 1))
    more = [pairs]
    for e in np.flatnonzero(np.diff(start) > 2):
        own = order[start[e] : start[e + 1]]
        own = own[np.argsort(_angles(vertices, triangles, own, edges[e]), kind="stable")]
        names, at, count = np.unique(patch[own // 3], return_inverse=True, return_counts=True)
        rest = count[at.reshape(-1)] != 2
        more += [own[patch[own // 3] == name][None] for name in names[count == 2]]
        left = own[rest]
        more.append(left[: len(left) // 2 * 2].reshape(-1, 2))
    return np.concatenate(more)


def _angles(vertices: np.ndarray, triangles: np.ndarray, sides: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Angles around an edge of the triangles that have these sides of it."""
    along = vertices[edge[1]] - vertices[edge[0]]
    along /= max(float(np.linalg.norm(along)), 1e-300)
    away = vertices[triangles[sides // 3, (sides % 3 + 2) % 3]] - vertices[edge[0]]
    away = away - (away @ along)[:, None] * along
    across = np.cross(along, away[0])
    return np.arctan2(away @ across / max(float(np.linalg.norm(across)), 1e-300),
                      away @ away[0] / max(float(np.linalg.norm(away[0])), 1e-300))  # fmt: skip


def _closed(vertices: np.ndarray, triangles: np.ndarray, pairs: np.ndarray) -> Solid:
    """One connected surface as a solid: as it is, or with lids, or as a sheet with two sides."""
    triangles, pairs = _wound_alike(triangles, pairs)
    vertices, triangles = _uncrowded(*_told_apart(vertices, triangles, pairs), pairs)
    area = float(areas(vertices, triangles).sum())
    rims = _rims(triangles)
    if not rims:
        return Solid(vertices, _outwards(vertices, triangles), area, mended=False)
    at, lids = _fans(vertices, rims)
    whole = np.concatenate([triangles, lids])
    lid_area = float(areas(at, lids).sum())
    thick = 2 * abs(_volume(at, whole)) / max(area, 1e-300)
    if lid_area > LIDS * (area + lid_area) or thick < HOLLOW * SHEET:
        at, whole = _thickened(vertices, triangles)
    return Solid(at, _outwards(at, whole), area, mended=True)


def _wound_alike(triangles: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The triangles of a connected surface turned so that neighbours agree, and the pairs of sides that do.

    Files wind faces at random; a surface with one side only comes apart somewhere.
    """
    one, other = pairs.T
    same = triangles[one // 3, one % 3] == triangles[other // 3, other % 3]  # run through the same way: wound apart
    n = len(triangles)
    graph = csr_array(coo_matrix((np.ones(len(pairs)), (one // 3, other // 3)), shape=(n, n)))
    order, before = breadth_first_order(graph, 0, directed=False)
    code = {}
    for a, b, apart in zip((one // 3).tolist(), (other // 3).tolist(), same.tolist(), strict=True):
        code[a, b] = code[b, a] = apart
    turned = np.zeros(n, bool)
    for t in order[1:].tolist():
        turned[t] = turned[before[t]] ^ code[int(before[t]), t]
    agree = (turned[one // 3] ^ turned[other // 3]) == same
    flipped = np.where(turned[:, None], triangles[:, ::-1], triangles)
    # Side i of (a, b, c) is side 1 - i (mod 3) of (c, b, a).
    place = np.where(turned[pairs // 3], (1 - pairs % 3) % 3, pairs % 3)
    return flipped, (3 * (pairs // 3) + place)[agree]


def _told_apart(vertices: np.ndarray, triangles: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of their own for surfaces that are joined by none of the pairs of sides (wound alike)."""
    one, other = pairs.T
    first = np.concatenate([one, 3 * (one // 3) + (one % 3 + 1) % 3])
    second = np.concatenate([3 * (other // 3) + (other % 3 + 1) % 3, other])
    corner = components(3 * len(triangles), first, second)
    at = np.empty((int(corner.max()) + 1, 3))
    at[corner] = vertices[triangles.ravel()]
    return at, corner.reshape(-1, 3)


def _uncrowded(vertices: np.ndarray, triangles: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with a vertex in the middle of edges that share both ends with another, joined to it by nothing else.

    Two surfaces may meet in both ends of an edge by way of other triangles; each then gets an edge of its own.
    """
    edge = sides_of(triangles)[1]
    partner = np.full(len(edge), -1)
    partner[pairs[:, 0]], partner[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    crowded = np.bincount(edge)[edge] != np.where(partner >= 0, 2, 1)
    first = crowded & ((partner < 0) | (partner > np.arange(len(edge))))
    middle = np.full(len(edge), -1)
    middle[first] = len(vertices) + np.arange(first.sum())
    follows = crowded & ~first
    middle[follows] = middle[partner[follows]]
    ends = np.stack([triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()], axis=1)[first]
    at = np.concatenate([vertices, vertices[ends].mean(axis=1)])
    return at, split_sides(at, triangles, middle.reshape(-1, 3))[0]


def _rims(triangles: np.ndarray) -> list[np.ndarray]:
    """Loops of vertices around the holes, run through as lids have to be."""
    edge = sides_of(triangles)[1]
    alone = np.bincount(edge)[edge] == 1
    starts, ends = triangles.ravel()[alone], np.roll(triangles, -1, axis=1).ravel()[alone]
    return loops_of(ends, starts)


def _fans(vertices: np.ndarray, rims: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """All vertices, those in the middles of the rims last, and triangles from there to each rim."""
    middles = [vertices[rim].mean(axis=0) for rim in rims]
    lids = [
        np.stack([rim, np.roll(rim, -1), np.full(len(rim), len(vertices) + i)], axis=1) for i, rim in enumerate(rims)
    ]
    return np.concatenate([vertices, middles]), np.concatenate(lids)


def _thickened(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A sheet as a plate SHEET thick."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    normal, spread = np.cross(b - a, c - a), np.zeros_like(vertices)
    for i in range(3):
        np.add.at(spread, triangles[:, i], normal)
    spread *= SHEET / 2 / np.maximum(np.linalg.norm(spread, axis=1, keepdims=True), 1e-300)
    n = len(vertices)
    edge = sides_of(triangles)[1]
    alone = np.bincount(edge)[edge] == 1
    starts, ends = triangles.ravel()[alone], np.roll(triangles, -1, axis=1).ravel()[alone]
    walls = [np.stack([ends, starts, starts + n], axis=1), np.stack([ends, starts + n, ends + n], axis=1)]
    return np.concatenate([vertices + spread, vertices - spread]), np.concatenate(
        [triangles, triangles[:, ::-1] + n, *walls]
    )


def _volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Signed volume within a closed surface: positive where it is wound outwards."""
    a, b, c = (vertices[triangles[:, i]] - vertices[0] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def _outwards(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return triangles if _volume(vertices, triangles) >= 0 else triangles[:, ::-1]
