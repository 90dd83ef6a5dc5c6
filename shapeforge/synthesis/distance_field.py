"""Signed distances from closed surfaces on a lattice: inside by winding numbers along its columns, exact where near."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt

from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.surfaces import Triangles, Vertices, as_mesh, refine

ASIDE = (0.0031, 0.0017, 0.0)
"""Columns pass the vertices by so much (steps of the lattice): none runs along an edge."""
FINE = 400_000
"""Triangles that the surface is cut into, at most, to find the lattice points near it."""


def signed_distance(
    vertices: Vertices, triangles: Triangles, origin: Float[np.ndarray, " 3"], cell: float,
    shape: tuple[int, int, int], reach: float,
) -> Float[np.ndarray, "X Y Z"]:  # fmt: skip
    """Distance to a closed surface that is wound outwards, positive inside, at ``origin`` + ``cell`` (i, j, k).

    In the units of the vertices; clipped to ``reach`` either way.  Surfaces may overlap: inside is what any encloses.
    """
    inside = winding_number(vertices, triangles, origin, cell, shape) > 0
    field = np.where(inside, reach, -reach)
    at, corners = refine(vertices, triangles, length=1.5 * cell, limit=FINE)[:2]
    at = np.concatenate([at, at[corners].mean(axis=1)])
    row = np.round((at - origin) / cell).astype(int)
    row = row[((row >= 0) & (row < np.array(shape))).all(axis=1)]
    away = np.ones(shape, bool)
    away[tuple(row.T)] = False
    near = np.argwhere(distance_transform_edt(away) <= reach / cell + 1)
    if len(near):
        distance = closest_points(as_mesh(vertices, triangles), origin + cell * near)[2]
        place = tuple(near.T)
        field[place] = np.where(inside[place], 1, -1) * np.minimum(distance, reach)
    return field


def winding_number(
    vertices: Vertices, triangles: Triangles, origin: Float[np.ndarray, " 3"], cell: float, shape: tuple[int, int, int]
) -> Int[np.ndarray, "X Y Z"]:
    """How often closed surfaces go around each lattice point: crossings below it in its column, with their sign."""
    a, b, c = (((vertices - origin) / cell + ASIDE)[triangles[:, i]] for i in range(3))
    corners = np.stack([a, b, c])[..., :2]
    low = np.clip(np.ceil(corners.min(axis=0)), 0, None).astype(int)
    high = np.minimum(np.floor(corners.max(axis=0)), np.array(shape[:2]) - 1).astype(int)
    size = np.maximum(high - low + 1, 0)
    count = size.prod(axis=1)
    t = np.repeat(np.arange(len(triangles)), count)
    k = np.arange(len(t)) - np.repeat(np.cumsum(count) - count, count)
    i, j = low[t, 0] + k // size[t, 1], low[t, 1] + k % size[t, 1]
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a[t].T, b[t].T, c[t].T
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    with np.errstate(divide="ignore", invalid="ignore"):  # triangles on edge are crossed by no column
        u = ((i - ax) * (cy - ay) - (j - ay) * (cx - ax)) / area
        v = ((bx - ax) * (j - ay) - (by - ay) * (i - ax)) / area
        hit = (area != 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
        height = (az + u * (bz - az) + v * (cz - az))[hit]
    step = np.clip(np.ceil(height), 0, shape[2]).astype(int)
    change = np.zeros((*shape[:2], shape[2] + 1), np.int32)
    np.add.at(change, (i[hit], j[hit], step), np.where(area[hit] < 0, 1, -1))
    return np.cumsum(change, axis=2)[..., :-1]
