"""Points spread evenly over the surface of a mesh (§4: "each shape is sampled uniformly")."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection import _kernels as kernels
from shapeforge.collection import _kernels_near
from shapeforge.collection.shape import Mesh

CANDIDATES_PER_POINT = 3
QUOTA = 16  # points kept of as many candidates in a row, which lie on neighbouring triangles of the file


def sample_points(
    mesh: Mesh, n_points: int, *, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "P 3"], Int[np.ndarray, " P"]]:
    """Exactly ``n_points`` points: positions (P, 3) in the mesh's units, unit normals (P, 3), triangles (P,).

    Density follows area.  Stratified candidates, three per point, are thinned by sample elimination (Yuksel 2015),
    which leaves no two points close: about half the sampling error of independent points.  Only points that face the
    same way crowd each other, so both sides of a thin plate get their share.  Normals are the triangles' own, as the
    file winds them; ``shape_diameter`` turns them outward.  The order is random: any prefix is a sample of the whole
    surface.
    """
    if n_points < 1:
        raise ValueError(f"n_points: wanted at least 1, got {n_points}")
    areas = mesh.triangle_areas
    total = areas.sum()
    if not 0 < total < np.inf:
        raise ValueError(f"mesh: wanted a surface with an area, got area {total} (are all faces degenerate?)")
    n = CANDIDATES_PER_POINT * n_points
    # one candidate in each of n equal slices of the total area: each triangle gets its share to within one
    at = (np.arange(n) + rng.random(n)) * (total / n)
    edges = np.cumsum(areas)
    triangle = np.searchsorted(edges, at, side="right")
    # rounding may carry the last slice past the end, onto a triangle that has no area
    triangle = np.minimum(triangle, np.flatnonzero(areas > 0)[-1])
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weight = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    points = np.einsum("nk,nkd->nd", weight, mesh.vertices[mesh.triangles[triangle]])
    normals = mesh.triangle_normals[triangle]
    kept = rng.permutation(np.flatnonzero(_spread_out(points, normals, n_points, total)))
    return points[kept], normals[kept], triangle[kept].astype(np.int32)


def _spread_out(points: np.ndarray, normals: np.ndarray, n_points: int, area: float) -> np.ndarray:
    """True for the ``n_points`` of ``points`` that elimination leaves."""
    # twice the spacing of the densest packing of n points on this area (Yuksel 2015, Eq. 3)
    radius = 2 * np.sqrt(area / (2 * np.sqrt(3) * n_points))
    # a needle of large extent and no area would ask for more cells than there is memory
    radius = max(radius, np.ptp(points, axis=0).max() / 200)
    scaled = (points - points.min(axis=0)) / radius
    # without quotas, surfaces that lie close above each other would count as one and lose half their points
    group = np.arange(len(points)) // (CANDIDATES_PER_POINT * QUOTA)
    size = np.bincount(group)
    surplus = size - size // CANDIDATES_PER_POINT
    return kernels.eliminate(*kernels.crowding_pairs(scaled, normals, 1.0), group, surplus)


def nearest_neighbours(points: Float[np.ndarray, "P 3"], k: int) -> Int[np.ndarray, "P k"]:
    """The ``k`` points nearest to each point, itself left out, nearest first; fewer columns where P <= k."""
    k = min(k, len(points) - 1)
    if k < 1:
        return np.empty((len(points), 0), np.int32)
    index = cKDTree(points).query(points, k + 1)[1]
    # where points coincide, a point need not be its own first neighbour: drop it wherever it is, else the last
    itself = index == np.arange(len(points))[:, None]
    itself[~itself.any(axis=1), -1] = True
    return index[~itself].reshape(len(points), k).astype(np.int32)


CELL, ONE_CELL = 80, 40
"""Points that the ball around a cell of the search grid holds, for several neighbours (at least) and for one."""


def nearest_points(
    points: Float[np.ndarray, "n 3"], queries: Float[np.ndarray, "Q 3"], k: int = 1
) -> tuple[Int[np.ndarray, "Q k"], Float[np.ndarray, "Q k"]]:
    """The ``k`` of ``points`` nearest to every query, in no order, and their distances; fewer columns where n < k.

    Which of two points is nearer is told in single precision.
    Raises FloatingPointError where a coordinate is not finite.
    """
    k = min(k, len(points))
    index, squared = np.empty((len(queries), k), np.int32), np.empty((len(queries), k))
    if k == 0 or len(queries) == 0:
        return index, squared
    points, queries = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(queries, np.float64)
    if not (np.isfinite(points).all() and np.isfinite(queries).all()):
        raise FloatingPointError("points: wanted finite coordinates, got NaN or infinity")
    if k == 1:
        _kernels_near.nearest_1(points, queries, _kernels_near.cell_size(points, ONE_CELL), index, squared)
    else:
        _kernels_near.nearest_k(points, queries, k, _kernels_near.cell_size(points, max(k, CELL)), index, squared)
    return index, np.sqrt(squared)


def neighbour_pairs(neighbours: Int[np.ndarray, "P n"]) -> tuple[Int[np.ndarray, " E"], Int[np.ndarray, " E"]]:
    """The edges (E,), (E,) of the graph of neighbours, each pair once and the smaller index first."""
    n_points, k = neighbours.shape
    here, there = np.repeat(np.arange(n_points), k), neighbours.reshape(-1).astype(np.int64)
    pairs = np.unique(np.minimum(here, there) * n_points + np.maximum(here, there))
    return pairs // n_points, pairs % n_points
