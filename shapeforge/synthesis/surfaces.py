"""Small operations on the triangles of one part: cutting out, welding, finer triangles, components."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from shapeforge.collection.surface import SearchedMesh

Vertices = Float[np.ndarray, "V 3"]
Triangles = Int[np.ndarray, "N 3"]

WELD = 1e-6


def cut_out(vertices: Vertices, triangles: Triangles, chosen: Bool[np.ndarray, " N"]) -> tuple[np.ndarray, np.ndarray]:
    """The chosen triangles with only the vertices they use, coinciding vertices (within 1e-6) made one.

    Triangles that have no area, or that repeat another one, are dropped.
    """
    used, corners = np.unique(triangles[chosen], return_inverse=True)
    return drop_bad(*weld(vertices[used], corners.reshape(-1, 3)))


def weld(vertices: Vertices, triangles: Triangles) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of which none coincide (within 1e-6), and the same triangles (N, 3) in their numbers."""
    cells = np.round(vertices / WELD).astype(np.int64)
    _, first, place = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return vertices[first], place.reshape(-1)[triangles]


def drop_bad(vertices: Vertices, triangles: Triangles, area: float = 1e-12) -> tuple[np.ndarray, np.ndarray]:
    """Without triangles that repeat another or have at most ``area`` (squared diagonals); no unused vertices."""
    keep = good_triangles(vertices, triangles, area)
    used, corners = np.unique(triangles[keep], return_inverse=True)
    return vertices[used], corners.reshape(-1, 3).astype(np.int32)


def good_triangles(vertices: Vertices, triangles: Triangles, area: float = 1e-12) -> Bool[np.ndarray, " N"]:
    """True for the first of equal triangles, if its area exceeds ``area``."""
    return sized_triangles(vertices, triangles, area) & distinct_triangles(triangles)


def sized_triangles(vertices: Vertices, triangles: Triangles, area: float = 1e-12) -> Bool[np.ndarray, " N"]:
    """True for triangles whose area exceeds ``area``."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return (np.cross(b - a, c - a) ** 2).sum(axis=1) > (2 * area) ** 2


def distinct_triangles(triangles: Triangles) -> Bool[np.ndarray, " N"]:
    """True for the first of equal triangles, whatever corner they start from."""
    unique = np.zeros(len(triangles), bool)
    if len(triangles):
        unique[np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]] = True
    return unique


def subdivide_long_edges(
    vertices: Vertices, triangles: Triangles, *, length: float, limit: int
) -> tuple[np.ndarray, np.ndarray]:
    """Split every edge longer than ``length`` at its middle, again and again, while at most ``limit`` triangles result.

    Both triangles of an edge are split alike, so no cracks open; a coarse box can then bend.
    """
    return refine(vertices, triangles, length=length, limit=limit)[:2]


def refine(
    vertices: Vertices, triangles: Triangles, *, length: float, limit: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """:func:`subdivide_long_edges`, and which of the given triangles each result (N,) is a piece of."""
    vertices, triangles = np.asarray(vertices, float), np.asarray(triangles, np.int64)
    parent = np.arange(len(triangles))
    while len(triangles):
        edges, edge_of_side = sides_of(triangles)
        long = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) > length
        count = long[edge_of_side].reshape(-1, 3).sum(axis=1)
        if not long.any() or len(triangles) + count.sum() > limit:
            break
        middle = np.full(len(edges), -1)
        middle[long] = len(vertices) + np.arange(long.sum())
        vertices = np.concatenate([vertices, vertices[edges[long]].mean(axis=1)])
        triangles, piece_of = split_sides(vertices, triangles, middle[edge_of_side].reshape(-1, 3))
        parent = parent[piece_of]
    return vertices, triangles.astype(np.int32), parent


def sides_of(triangles: Triangles) -> tuple[np.ndarray, np.ndarray]:
    """Every edge once, (E, 2) with the smaller vertex first, and the edge of each side (3N,); side i: corner i, i+1."""
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    sides = sides.astype(np.int64)
    base = int(sides.max()) + 1 if len(sides) else 1
    code, edge_of_side = np.unique(sides[:, 0] * base + sides[:, 1], return_inverse=True)
    return np.stack([code // base, code % base], axis=1), edge_of_side.reshape(-1)


def split_sides(vertices: np.ndarray, triangles: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (N, 3) with a new vertex on side i (corner i to i+1) where ``middle[:, i]`` >= 0, and their origin."""
    split = middle >= 0
    count = split.sum(axis=1)
    row = [np.flatnonzero(count == n) for n in range(4)]
    pieces, origin = [triangles[row[0]]], [row[0]]
    # Turn each triangle so that the pattern of split sides is (0), (0, 1) or (0, 1, 2).
    turn = np.where(count == 1, split.argmax(axis=1), np.where(count == 2, ((~split).argmax(axis=1) + 1) % 3, 0))
    columns = (turn[:, None] + np.arange(3)) % 3
    t, m = np.take_along_axis(triangles, columns, axis=1), np.take_along_axis(middle, columns, axis=1)
    one, two, three = t[row[1]], t[row[2]], t[row[3]]
    m1, m2, m3 = m[row[1]], m[row[2]], m[row[3]]
    pieces += [np.stack([one[:, 0], m1[:, 0], one[:, 2]], 1), np.stack([m1[:, 0], one[:, 1], one[:, 2]], 1)]
    pieces += [np.stack([m2[:, 0], two[:, 1], m2[:, 1]], 1)]
    # The rest of a twice split triangle is a quad; cut it along its shorter diagonal.
    shorter = np.linalg.norm(vertices[two[:, 0]] - vertices[m2[:, 1]], axis=1) <= np.linalg.norm(
        vertices[m2[:, 0]] - vertices[two[:, 2]], axis=1
    )
    s, ms, r, mr = two[shorter], m2[shorter], two[~shorter], m2[~shorter]
    pieces += [np.stack([s[:, 0], ms[:, 0], ms[:, 1]], 1), np.stack([s[:, 0], ms[:, 1], s[:, 2]], 1)]
    pieces += [np.stack([mr[:, 0], mr[:, 1], r[:, 2]], 1), np.stack([r[:, 0], mr[:, 0], r[:, 2]], 1)]
    pieces += [np.stack([three[:, i], m3[:, i], m3[:, i - 1]], 1) for i in range(3)] + [m3]
    origin += [row[1]] * 2 + [row[2]] + [row[2][shorter]] * 2 + [row[2][~shorter]] * 2 + [row[3]] * 4
    return np.concatenate(pieces), np.concatenate(origin)


def as_mesh(vertices: Vertices, triangles: Triangles) -> SearchedMesh:
    """A mesh whose face records are its triangles."""
    return SearchedMesh(vertices, triangles, np.arange(len(triangles)), len(triangles))


def vertex_components(n_vertices: int, triangles: Triangles) -> Int[np.ndarray, " V"]:
    """Number of the connected component of every vertex."""
    rows = np.concatenate([triangles[:, 0], triangles[:, 1]])
    columns = np.concatenate([triangles[:, 1], triangles[:, 2]])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n_vertices, n_vertices))
    return connected_components(graph, directed=False)[1]


def touching_pieces(vertices: Vertices, triangles: Triangles, *, reach: float = 0.03) -> Int[np.ndarray, " V"]:
    """Number of the piece of every vertex: connected components, joined where vertices come within ``reach``.

    Models are full of components that only touch: a winglet belongs to its wing, while legs stand apart.
    """
    component = vertex_components(len(vertices), triangles)
    if component.max() == 0:
        return component
    # One vertex per component and cell is enough, and keeps the number of pairs small on dense meshes.
    cell = np.column_stack([component, np.floor(vertices / (reach / 3)).astype(np.int64)])
    kept = np.unique(cell, axis=0, return_index=True)[1]
    pairs = cKDTree(vertices[kept]).query_pairs(reach, output_type="ndarray")
    ends = component[kept][pairs]
    n = int(component.max()) + 1
    joined = connected_components(coo_matrix((np.ones(len(ends)), ends.T), shape=(n, n)), directed=False)[1]
    return joined[component]


def farthest_points(points: Float[np.ndarray, "P 3"], count: int) -> Int[np.ndarray, " n"]:
    """Indices of ``count`` (or all) points spread evenly: each the farthest from those before, the outermost first."""
    count = min(count, len(points))
    if count == 0:
        return np.zeros(0, np.int64)
    chosen = np.empty(count, np.int64)
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen[0] = distance.argmax()
    distance = np.full(len(points), np.inf)
    for i in range(1, count):
        distance = np.minimum(distance, ((points - points[chosen[i - 1]]) ** 2).sum(axis=1))
        chosen[i] = distance.argmax()
    return chosen
