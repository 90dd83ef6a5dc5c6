"""Patches of one component merge into the convex pieces that it is made of: a guitar's body, its neck, its head.

Two patches are one piece where most of their points see each other from within, after the weakly convex components of
Asafi (2013) and van Kaick (2014), and where they are two sides of one wall: the cup of a goblet is one thing, though
its inside sees nothing of its outside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.align import thinned
from shapeforge.collection.patches import GRAPH_NEIGHBOURS
from shapeforge.collection.points import nearest_neighbours
from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Shape

LEVEL = 0.01  # diagonals above the tangent plane that still count as below
CONVEX = 0.8  # share of the pairs of points that see each other, from which on a piece, or two of them, are one
ONE_WALL = 0.7  # share of a piece's points behind which the same other piece lies, from which on they are one
WALL = 0.06  # diagonals: what is thicker is no wall
LIFT = 2e-3  # diagonals below its point where a ray starts, so that it doesn't meet the surface it leaves
BEHIND, FACING = 8, -0.5  # points looked at around where a ray leaves, and the cosine of normals that face apart
LOOKED_AT = 500  # points of a component whose pairs are looked at


def see_each_other(points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n n"]:
    """Whether neither of two surface points lies above the other's tangent plane: so for all pairs of a convex body."""
    height = np.einsum("ijk,ik->ij", points[None] - points[:, None], normals)
    return (height <= LEVEL) & (height.T <= LEVEL)


def across(shape: Shape) -> Int[np.ndarray, " P"]:
    """The point (P,) on the other side of the wall on which a point lies, -1 where there is no wall as thin as that."""
    found = np.full(shape.n_points, -1, np.int64)
    far = first_hits(shape.mesh, shape.points - LIFT * shape.normals, -shape.normals)
    rows = np.flatnonzero(far < WALL)
    if len(rows):
        out = shape.points[rows] - (LIFT + far[rows, None]) * shape.normals[rows]
        distance, near = cKDTree(shape.points).query(out, k=min(BEHIND, shape.n_points))
        cosine = np.einsum("ijk,ik->ij", shape.normals[near], shape.normals[rows])
        other = (cosine < FACING) & (distance < WALL)
        found[rows] = np.where(other.any(axis=1), near[np.arange(len(rows)), other.argmax(axis=1)], -1)
    return found


def merged_patches(
    shape: Shape, rows: Int[np.ndarray, " n"], patch: Int[np.ndarray, " n"], opposite: Int[np.ndarray, " P"],
    tallest: float,
) -> Int[np.ndarray, " n"]:  # fmt: skip
    """Piece (n,) of the points ``rows`` of one component, from their ``patch`` (n,), both from 0 and without gaps.

    ``opposite`` is as ``across`` gives it.  Nothing merges into what is taller than ``tallest``.
    """
    points, heights = shape.points[rows], shape.points[rows, 1]
    near = rows[nearest_neighbours(points, min(GRAPH_NEIGHBOURS, len(rows) - 1))]
    touching = _pairs(shape.n_points, rows, patch, near) > 0
    few = thinned(np.arange(len(rows)), LOOKED_AT)
    member = np.eye(patch.max() + 1)[patch[few]]
    seen = member.T @ see_each_other(points[few], shape.normals[rows[few]]) @ member
    piece = _merged(patch, heights, tallest, seen, member.sum(axis=0), np.outer, touching | touching.T, CONVEX)
    behind = _pairs(shape.n_points, rows, piece, opposite[rows, None])
    count = np.bincount(piece).astype(np.float64)
    return _merged(piece, heights, tallest, behind, count, _of_the_first, np.ones(behind.shape, bool), ONE_WALL)


def _pairs(number: int, rows: np.ndarray, label: np.ndarray, others: np.ndarray) -> Float[np.ndarray, "L L"]:
    """How often ``others`` (n, k; -1 for none) of points with one label have another, both among ``rows``."""
    at = np.full(number + 1, -1, np.int64)  # the last stands for none
    at[rows] = label
    met = at[others]
    table = np.zeros((label.max() + 1, label.max() + 1))
    np.add.at(table, (np.broadcast_to(label[:, None], met.shape)[met >= 0], met[met >= 0]), 1.0)
    return table


def _of_the_first(count: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.broadcast_to(count[:, None], (len(count), len(count)))


def _merged(
    label: Int[np.ndarray, " n"], heights: Float[np.ndarray, " n"], tallest: float, links: Float[np.ndarray, "L L"],
    count: Float[np.ndarray, " L"], most: Callable[[np.ndarray, np.ndarray], np.ndarray],
    allowed: Bool[np.ndarray, "L L"], least: float,
) -> Int[np.ndarray, " n"]:  # fmt: skip
    """``label`` (n,) after the closest pair has merged, again and again, until none is as close as ``least``.

    Close is the number of ``links`` from a to b, as a share of the ``most`` that such counts allow, or that from b to
    a, if it is larger: average linkage.  Only ``allowed`` pairs merge, and what touches one touches what it joins.
    """
    links, count, allowed = links.copy(), count.copy(), allowed.copy()
    low, high = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(low, label, heights)
    np.maximum.at(high, label, heights)
    name, gone = np.arange(len(count)), np.zeros(len(count), bool)
    while True:
        close = links / np.maximum(most(count, count), 1e-12)
        close = np.maximum(close, close.T)
        tall = np.maximum(high[:, None], high) - np.minimum(low[:, None], low) > tallest
        close[tall | ~allowed | gone | gone[:, None] | np.eye(len(count), dtype=bool)] = -1.0
        one, other = np.unravel_index(int(close.argmax()), close.shape)
        if close[one, other] < least:
            return np.unique(name[label], return_inverse=True)[1].reshape(-1)
        links[one] += links[other]
        links[:, one] += links[:, other]
        allowed[one] |= allowed[other]
        allowed[:, one] |= allowed[:, other]
        count[one] += count[other]
        low[one], high[one] = min(low[one], low[other]), max(high[one], high[other])
        gone[other] = True
        name[name == other] = one
