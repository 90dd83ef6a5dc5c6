"""The pieces that proposed parts are put together from, described in frames that all shapes share.

A modeller builds a chair of boards: faces that hang together mostly belong together.  So a *piece* is a connected
component of the mesh where that is convex enough to be one thing, else one of the convex pieces that it is made of
(``convex_pieces``).  What is one component from the floor to the top is cut, too, and crumbs fall into their patches.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from shapeforge.collection.align import LARGEST_STRETCH, SMALLEST_STRETCH, Alignment, affine_align, thinned
from shapeforge.collection.facecut import edge_neighbours, surface_diagonal
from shapeforge.collection.groups import Groups
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.deformation.convex_pieces import CONVEX, across, merged_patches, see_each_other

TALL = 0.66  # of the shape's height: a post from the floor to the top is leg and back, however convex
CRUMB = 0.01  # of the points: smaller components are cut as the patches are
SLIVER = 0.004  # of the points: what is left of a patch in a component; smaller ones join their neighbours
PAIRED = 150  # points of a component whose pairs are looked at
SAME_EXTENT, LEAST_EXTENT = 0.2, 0.006  # share, and diagonals, by which extents of copies may differ
SAME_AREA, DRAWN = 1.3, 3.0  # their areas' ratio, and deviations of the numbers of points that fall on them by chance
MOST_COPIES = 8  # more are as telling
UPRIGHT_COUNTS = 0.02  # of a level point: what an upright one says of how open its piece is above


def find_pieces(shape: Shape) -> tuple[Int[np.ndarray, " P"], Bool[np.ndarray, " n"]]:
    """Piece number (P,) of every point, from 0 and without gaps, and which pieces are whole components (n,)."""
    component = point_components(shape)
    number, height = len(component), float(np.ptp(shape.points[:, 1]))
    piece = np.full(number, -1, np.int64)
    whole: list[bool] = []
    opposite = None
    for one in np.flatnonzero(np.bincount(component) >= CRUMB * number):
        rows = np.flatnonzero(component == one)
        inside = np.zeros(len(rows), np.int64)
        tall = np.ptp(shape.points[rows, 1]) > TALL * height
        if tall or convexity(shape.points[rows], shape.normals[rows]) <= CONVEX:
            inside = _without_slivers(shape.points[rows], shape.patch[rows], max(2.0, SLIVER * number))
            opposite = across(shape) if opposite is None else opposite
            inside = merged_patches(shape, rows, inside, opposite, TALL * height)
        piece[rows] = len(whole) + inside
        whole += [bool(inside.max() == 0)] * (int(inside.max()) + 1)
    crumbs = np.flatnonzero(piece < 0)
    if len(crumbs):
        numbers, inside = np.unique(shape.patch[crumbs], return_inverse=True)
        piece[crumbs] = len(whole) + inside.reshape(-1)
        whole += [False] * len(numbers)
    return piece, np.array(whole)


def point_components(shape: Shape) -> Int[np.ndarray, " P"]:
    """Connected component of the mesh (P,) that every point lies on, numbered from 0 and without gaps."""
    component = face_components(shape.mesh)[shape.face_of_point]
    return np.unique(component, return_inverse=True)[1].reshape(-1)


def face_components(mesh: Mesh) -> Int[np.ndarray, " F"]:
    """Connected component of every face record (n_faces,): faces that share an edge, also of coincident corners."""
    diagonal = surface_diagonal(mesh)
    if diagonal == 0:
        return np.zeros(mesh.n_faces, np.int32)
    pairs, _ = edge_neighbours(mesh, diagonal)
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(mesh.n_faces, mesh.n_faces))
    return connected_components(graph, directed=False)[1]


def convexity(points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> float:
    """Share of the pairs of surface points that see each other from within (``see_each_other``): 1 for convex."""
    points, normals = thinned(points, PAIRED), thinned(normals, PAIRED)
    if len(points) < 2:
        return 1.0
    return float(see_each_other(points, normals)[~np.eye(len(points), dtype=bool)].mean())


def _without_slivers(points: np.ndarray, patch: np.ndarray, least: float) -> np.ndarray:
    """Patches numbered from 0; those of fewer than ``least`` points go to the nearest others."""
    keep = np.bincount(patch)[patch] >= least
    if not keep.any():
        return np.zeros(len(patch), np.int64)
    if not keep.all():
        patch = patch.copy()
        patch[~keep] = patch[keep][cKDTree(points[keep]).query(points[~keep])[1]]
    return np.unique(patch, return_inverse=True)[1].reshape(-1)


# -- frames ----------------------------------------------------------------------------------------------------------


def common_frame(shapes: Any, groups: Groups) -> list[Alignment]:
    """The map of every shape into the first (largest) group's exemplar: through the exemplar of its own group.

    Shapes of no group go straight there.
    """
    root = int(groups.exemplars[0])
    target = shapes[root].points
    same = Alignment(np.eye(3), np.zeros(3), 0.0)
    onwards = [same] + [affine_align(shapes[int(e)].points, target) for e in groups.exemplars[1:]]
    exemplar_points = [shapes[int(e)].points for e in groups.exemplars]
    frames = []
    for t in range(len(shapes)):
        g = int(groups.group[t])
        if g < 0:
            frames.append(affine_align(shapes[t].points, target))
        elif t == groups.exemplars[g]:
            frames.append(onwards[g])
        else:
            frames.append(_then(affine_align(shapes[t].points, exemplar_points[g]), onwards[g]))
    return frames


def _then(first: Alignment, second: Alignment) -> Alignment:
    return Alignment(
        second.matrix @ first.matrix, second(first.offset[None])[0], first.residual + second.residual, first.start
    )


def box_frame(points: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "m 3"]) -> Alignment:
    """The map of the bounding box of ``points`` onto that of ``target``, its stretches bounded."""
    size, wanted = np.ptp(points, axis=0), np.ptp(target, axis=0)
    stretch = np.clip(wanted / np.maximum(size, 1e-9), SMALLEST_STRETCH, LARGEST_STRETCH)
    middle, wanted_middle = (points.min(axis=0) + points.max(axis=0)) / 2, (target.min(axis=0) + target.max(axis=0)) / 2
    return Alignment(np.diag(stretch), wanted_middle - stretch * middle, 0.0)


# -- description -----------------------------------------------------------------------------------------------------


def piece_features(
    shape: Shape, piece: Int[np.ndarray, " P"], frame: Alignment, normal: Float[np.ndarray, " 3"], offset: float
) -> Float[np.ndarray, "n F"]:
    """What tells pieces apart (n_pieces, 21), in a common frame whose mirror plane is ``normal · x = offset``.

    Distance from the plane, height and depth of the middle; lowest and highest height; extents; mean squared normal;
    mean descriptors.  Folding at the mirror plane makes left and right one part.
    """
    places, normals = placed(shape, frame, normal, offset)
    count = np.maximum(np.bincount(piece), 1)[:, None]
    folded = np.concatenate([np.abs(places[:, :1]), places[:, 1:], normals**2, shape.descriptors], axis=1)
    means = np.stack([np.bincount(piece, column) for column in folded.T], axis=1) / count
    low, high = np.zeros((len(count), 3)), np.zeros((len(count), 3))
    order = np.argsort(piece, kind="stable")
    for p, members in enumerate(np.split(order, np.cumsum(np.bincount(piece))[:-1])):
        if len(members):  # not the very ends: one stray point would move them
            low[p], high[p] = np.quantile(places[members], [0.05, 0.95], axis=0)
    return np.concatenate([means[:, :3], low[:, 1:2], high[:, 1:2], high - low, means[:, 3:]], axis=1)


def piece_looks(
    shape: Shape, piece: Int[np.ndarray, " P"], exposure: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, "n 5"]:
    """What pieces are by themselves, wherever they lie: how many of a kind there are in the shape (log2, with itself),
    how long and how flat they are (0 to 1), how open they are above, and how much they see of what is below.

    Legs, arms and engines come in twos and fours, a seat or a fuselage but once.  A top is open above, though its
    underside sees none of the sky; what it covers is not.  ``exposure`` is as in ``voting``.
    """
    count = np.bincount(piece)
    many = np.maximum(count, 1)[:, None]
    means = np.stack([np.bincount(piece, column) for column in shape.points.T], axis=1) / many
    below = np.bincount(piece, exposure[:, 1])[:, None] / many
    off = shape.points - means[piece]
    spread = np.stack([np.bincount(piece, off[:, i] * off[:, j]) for i in range(3) for j in range(3)], axis=1) / many
    extent = np.sqrt(np.maximum(np.linalg.eigvalsh(spread.reshape(-1, 3, 3)), 0.0))[:, ::-1]
    longest = np.maximum(extent[:, :1], 1e-9)
    copies = np.log2(_copies(extent, count))[:, None]
    return np.concatenate([copies, -np.diff(extent) / longest, _open_above(shape, piece, exposure), below], axis=1)


def _open_above(
    shape: Shape, piece: Int[np.ndarray, " P"], exposure: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, "n 1"]:
    """What the level points of every piece see of the sky: the upper quartile, as half of them look down."""
    order = np.lexsort((exposure[:, 0], piece))
    level = shape.normals[order, 1] ** 2 + UPRIGHT_COUNTS
    whole = np.bincount(piece[order], level)
    count = np.bincount(piece)
    so_far = np.cumsum(level)
    at = np.searchsorted(so_far, np.cumsum(whole) - 0.25 * whole)
    found = exposure[order[np.minimum(at, np.maximum(np.cumsum(count) - 1, 0))], 0]
    return np.where(count > 0, found, 0.0)[:, None]


def _copies(extent: Float[np.ndarray, "n 3"], count: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """How many pieces of ``count`` points each, itself among them, are as large as each, by their extents (n, 3)."""
    larger = np.maximum(extent[:, None], extent)
    alike = (np.abs(extent[:, None] - extent) < np.maximum(SAME_EXTENT * larger, LEAST_EXTENT)).all(axis=2)
    count = np.maximum(count, 1)
    fewer = np.minimum(count[:, None], count)
    alike &= np.maximum(count[:, None], count) / fewer < SAME_AREA + DRAWN / np.sqrt(fewer)
    return np.minimum(alike.sum(axis=1), MOST_COPIES)


def placed(
    shape: Shape, frame: Alignment, normal: Float[np.ndarray, " 3"], offset: float
) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "P 3"]]:
    """Points and unit normals (P, 3) in the common frame: distance from the mirror plane, height, depth."""
    normals = shape.normals @ np.linalg.inv(frame.matrix)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    sideways = np.cross(normal, [0.0, 1.0, 0.0])
    axes = np.stack([normal, [0.0, 1.0, 0.0], sideways / np.linalg.norm(sideways)])
    return frame(shape.points) @ axes.T - [offset, 0, 0], normals @ axes.T
