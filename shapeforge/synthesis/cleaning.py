"""Labels that can be cut along: specks and islands of a segmentation go to the part that they belong to.

A fit decides about one face after the other; a mesh is made of pieces.  The top of a leg that was called seat, or a
rail between legs that was, leaves torn bits when legs and seat go different ways.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from shapeforge.synthesis.surfaces import Triangles, Vertices, sides_of

MINOR = 0.15
"""A region with less than this share of its part's area is no main piece of it ..."""
MINOR_OF_LARGEST = 0.3
"""... if it also has less than this share of the part's largest piece (none of twenty lone slats is minor)."""
SPECK = 0.04
"""In a component that holds main pieces of the same part only smaller regions than this are given away."""
WELL_HELD = 1.0
"""Nothing is given away that has more than this share of the corresponding points which its area lets expect."""
TOUCHING = 0.03
"""Pieces whose vertices come this near (diagonals; edges are at most .05 long) touch."""


def clean_labels(
    vertices: Vertices, triangles: Triangles, label: Int[np.ndarray, " N"], n_parts: int,
    points: Int[np.ndarray, "N L"] | None = None,
) -> Int[np.ndarray, " N"]:  # fmt: skip
    """Part per triangle (N,) of a welded mesh, specks and islands reassigned; -1 (unlabelled) where nothing is near.

    A minor region that grows out of a larger region of another part goes to that one, the smallest first; minor pieces
    that touch no other piece of their part go to the part which they touch most.  ``points`` counts the corresponding
    points of every part on every triangle: what has its fair share of them is no mistake, and stays.
    """
    points = np.zeros((len(label), n_parts), np.int64) if points is None else points
    label = np.array(label, np.int64)
    area = areas(vertices, triangles)
    first, second, length = neighbours(vertices, triangles)
    component = components(len(label), first, second)
    pieces = _pieces(vertices, triangles, label, component)
    largest = np.zeros(n_parts + 1)
    np.maximum.at(largest, label + 1, np.bincount(pieces, area)[pieces])
    for _ in range(12):
        if not _give_regions_away(label, area, component, first, second, length, largest, points):
            break
    _give_pieces_away(label, area, vertices, triangles, component, points)
    return label.astype(np.int32)


def areas(vertices: Vertices, triangles: Triangles) -> Float[np.ndarray, " N"]:
    """Area of every triangle, in squared units of the vertices."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def neighbours(vertices: Vertices, triangles: Triangles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of triangles with a common edge, and its length; the triangles of an edge of many form a chain."""
    edges, edge_of_side = sides_of(triangles)
    order = np.argsort(edge_of_side, kind="stable")
    same = np.flatnonzero(np.diff(edge_of_side[order]) == 0)
    edge = edges[edge_of_side[order[same]]]
    length = np.linalg.norm(vertices[edge[:, 0]] - vertices[edge[:, 1]], axis=1)
    return order[same] // 3, order[same + 1] // 3, length


def components(n: int, first: np.ndarray, second: np.ndarray) -> Int[np.ndarray, " n"]:
    """Number of the connected component of each of ``n`` nodes."""
    return connected_components(coo_matrix((np.ones(len(first)), (first, second)), shape=(n, n)), directed=False)[1]


def _minor(
    area: np.ndarray, part: np.ndarray, largest: np.ndarray, share: float | np.ndarray
) -> Bool[np.ndarray, " R"]:
    """Which regions with this area and part are no main pieces; ``largest`` (L+1,) by part + 1. All of part -1 are."""
    total = np.bincount(part + 1, area, len(largest))[part + 1]
    return (part < 0) | ((area < share * total) & (area < MINOR_OF_LARGEST * largest[part + 1]))


def _well_held(region: np.ndarray, label: np.ndarray, area: np.ndarray, points: np.ndarray) -> Bool[np.ndarray, " R"]:
    """Which regions (their number per triangle) hold a fair share of their part's corresponding points."""
    n_parts = points.shape[1]
    own = np.where(label >= 0, points[np.arange(len(label)), label], 0)
    part = np.full(int(region.max()) + 1 if len(region) else 0, -1)
    part[region] = label
    size, held = np.bincount(region, area, len(part)), np.bincount(region, own, len(part))
    all_area, all_points = np.bincount(label + 1, area, n_parts + 1)[part + 1], np.r_[0, points.sum(axis=0)][part + 1]
    return held * all_area > WELL_HELD * size * np.maximum(all_points, 1)


def _pieces(vertices: np.ndarray, triangles: np.ndarray, label: np.ndarray, component: np.ndarray) -> np.ndarray:
    """Number of the piece of each triangle (N,): what one part has of one component, and what that touches."""
    _, node = np.unique(np.stack([label, component]), axis=1, return_inverse=True)
    node = node.reshape(-1)
    corner, at = node[:, None].repeat(3, axis=1).ravel(), triangles.ravel()
    # One point per node and cell is enough, and keeps the number of pairs small on dense meshes.
    cell = np.column_stack([corner, np.floor(vertices[at] / (TOUCHING / 3)).astype(np.int64)])
    kept = np.unique(cell, axis=0, return_index=True)[1]
    pairs = cKDTree(vertices[at[kept]]).query_pairs(TOUCHING, output_type="ndarray")
    same = label[kept[pairs[:, 0]] // 3] == label[kept[pairs[:, 1]] // 3]
    ends = corner[kept][pairs[same]]
    return components(int(node.max()) + 1 if len(node) else 0, ends[:, 0], ends[:, 1])[node]


def _give_regions_away(
    label: np.ndarray, area: np.ndarray, component: np.ndarray, first: np.ndarray, second: np.ndarray,
    length: np.ndarray, largest: np.ndarray, points: np.ndarray,
) -> bool:  # fmt: skip
    """One round: minor regions take the label of the larger region with which they share most border; in place."""
    same = label[first] == label[second]
    region = components(len(label), first[same], second[same])
    n = int(region.max()) + 1 if len(region) else 0
    size = np.bincount(region, area, n)
    part = np.full(n, -1)
    part[region] = label
    # Where a component has main pieces of the region's part as well, it does not tell whose the region is.
    belongs = np.zeros(n, np.int64)
    belongs[region] = component
    home = belongs * len(largest) + part + 1
    at_home = np.isin(home, home[~_minor(size, part, largest, MINOR)])
    minor = _minor(size, part, largest, np.where(at_home, SPECK, MINOR))
    minor &= ~_well_held(region, label, area, points)
    a, b = region[first[~same]], region[second[~same]]
    a, b, shared = np.concatenate([a, b]), np.concatenate([b, a]), np.tile(length[~same], 2)
    may = minor[a] & (part[b] >= 0) & ((size[a] < size[b]) | (part[a] < 0))
    if not may.any():
        return False
    border = coo_matrix((shared[may], (a[may], part[b[may]])), shape=(n, len(largest) - 1)).toarray()
    giving = border.max(axis=1) > 0
    # A region beside one that changes in this round waits for the next: else two specks would swap.
    for r in np.flatnonzero(giving)[np.argsort(size[giving], kind="stable")]:
        if giving[r]:
            giving[b[(a == r) & (size[b] >= size[r]) & (b != r)]] = False
    new = np.where(giving, border.argmax(axis=1), part)
    label[:] = new[region]
    return True


def _give_pieces_away(
    label: np.ndarray, area: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, component: np.ndarray,
    points: np.ndarray,
) -> None:  # fmt: skip
    """Minor pieces go to the part that they touch most; one that touches no other part stays.  In place."""
    piece = _pieces(vertices, triangles, label, component)
    size = np.bincount(piece, area)
    part = np.full(len(size), -1)
    part[piece] = label
    n_parts = points.shape[1]
    largest = np.zeros(n_parts + 1)
    np.maximum.at(largest, part + 1, size)
    trees = {l: cKDTree(vertices[np.unique(triangles[label == l])]) for l in range(n_parts) if (label == l).any()}
    for p in np.flatnonzero(_minor(size, part, largest, MINOR) & ~_well_held(piece, label, area, points)):
        mine = piece == p
        at = vertices[np.unique(triangles[mine])]
        touched = {
            l: int((tree.query(at, distance_upper_bound=TOUCHING)[0] < np.inf).sum())
            for l, tree in trees.items() if l != part[p]
        }  # fmt: skip
        best = max(touched, key=lambda l: touched[l], default=-1)
        if touched.get(best, 0):
            label[mine] = best
