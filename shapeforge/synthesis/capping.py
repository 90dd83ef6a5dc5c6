"""Lids on what cutting opened: a part sawn out of a closed surface gets the faces that the saw left."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from shapeforge.collection.meshes import triangulate_records
from shapeforge.synthesis.cleaning import areas, components, neighbours
from shapeforge.synthesis.surfaces import Triangles, Vertices, sides_of

OPEN = 0.02
"""A component counts as closed with at most this share of its edges open."""
FLAT = 0.12
"""A lid's corners lie within this share of its width of a plane: the saw cut straight, more or less."""
LARGEST = 0.03
"""Largest area of a lid (squared diagonals): what would need more was hardly solid."""


def closed_components(triangles: Triangles) -> tuple[Bool[np.ndarray, " E"], Bool[np.ndarray, " N"]]:
    """Which edges (of :func:`sides_of`) have two triangles or more, and which triangles are of a closed component."""
    edges, edge_of_side = sides_of(triangles)
    joined = np.bincount(edge_of_side, minlength=len(edges)) > 1
    first, second, _ = neighbours(np.zeros((int(triangles.max()) + 1 if len(triangles) else 0, 3)), triangles)
    component = components(len(triangles), first, second)
    n_open = np.bincount(component, (~joined)[edge_of_side].reshape(-1, 3).sum(axis=1))
    closed = n_open <= OPEN * 1.5 * np.bincount(component)  # a closed surface has 1.5 edges a triangle
    return joined, closed[component]


def cap(vertices: Vertices, triangles: Triangles, chosen: Bool[np.ndarray, " N"]) -> tuple[np.ndarray, float]:
    """Triangles (M, 3) that close the chosen ones where the rest of a closed surface was cut off, and the length
    (units of the vertices) of such cuts that stay open: they do not close, or lie in no plane.
    """
    if not chosen.any() or chosen.all():
        return np.zeros((0, 3), np.int32), 0.0
    edges, edge_of_side = sides_of(triangles)
    joined, closed = closed_components(triangles)
    own = np.bincount(edge_of_side, np.repeat(chosen, 3), len(edges))
    cut = (joined & (own == 1))[edge_of_side] & np.repeat(chosen, 3)
    starts, ends = triangles.ravel()[cut], np.roll(triangles, -1, axis=1).ravel()[cut]
    hollow = np.repeat(closed, 3)[cut]
    length = np.linalg.norm(vertices[starts] - vertices[ends], axis=1)[hollow]
    made, around = [np.zeros((0, 3), np.int32)], 0.0
    for loop in loops_of(ends[hollow], starts[hollow]):
        lid = _lid(vertices, loop)
        if len(lid):
            made.append(lid)
            around += float(np.linalg.norm(vertices[loop] - vertices[np.roll(loop, 1)], axis=1).sum())
    return np.concatenate(made), max(float(length.sum()) - around, 0.0)


def loops_of(starts: Int[np.ndarray, " E"], ends: Int[np.ndarray, " E"]) -> list[np.ndarray]:
    """Closed loops of the directed edges, each vertex once; where loops touch they part at the touching vertex."""
    following: dict[int, list[int]] = {}
    for a, b in zip(starts.tolist(), ends.tolist(), strict=True):
        following.setdefault(a, []).append(b)
    found = []
    for first in list(following):
        while following.get(first):
            path, place = [first], {first: 0}
            while following.get(path[-1]):
                after = following[path[-1]].pop()
                if after in place:
                    loop = path[place[after] :]
                    for vertex in loop[1:]:
                        del place[vertex]
                    del path[place[after] + 1 :]
                    if len(loop) >= 3:
                        found.append(np.array(loop))
                else:
                    place[after] = len(path)
                    path.append(after)
    return found


def _lid(vertices: Vertices, loop: Int[np.ndarray, " n"]) -> np.ndarray:
    """Triangles (n-2, 3) within the loop; none if it is not flat, too wide, or crosses itself."""
    points = vertices[loop] - vertices[loop].mean(axis=0)
    spread = np.linalg.svd(points, compute_uv=False)
    area = float(np.linalg.norm(np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0))) / 2
    if spread[1] <= 1e-6 * np.sqrt(len(loop)) or spread[2] > FLAT * spread[1] or not 0 < area <= LARGEST:
        return np.zeros((0, 3), np.int32)
    lid = triangulate_records(vertices, loop, np.array([len(loop)]))[0]
    return lid if areas(vertices, lid).sum() <= 1.1 * area else lid[:0]
