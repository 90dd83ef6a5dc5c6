"""Closest points on a mesh: exact, and without any assumption on its topology."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection import _kernels_surface
from shapeforge.collection.shape import Mesh


@dataclass(frozen=True, eq=False)
class SearchedMesh(Mesh):
    """A mesh that is asked for closest points again and again: it keeps its tree of boxes.

    Moved, it has the tree of the mesh at ``rest`` with other boxes: answers are exact, however far it has moved.
    """

    rest: Mesh | None = None

    @cached_property
    def boxes(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Corners (N, 3, 3) of the triangles and the tree over them."""
        if not isinstance(self.rest, SearchedMesh):
            return _boxes(self)
        corners = np.ascontiguousarray(self.vertices[self.triangles], np.float64)
        order, _, _, first, count, right = self.rest.boxes[1]
        low, high = _kernels_surface.refit_tree(corners, order, first, count, right)
        return corners, (order, low, high, first, count, right)

    def moved(self, vertices: Float[np.ndarray, "V 3"]) -> SearchedMesh:
        """The same connectivity with other vertex positions."""
        rest = self if self.rest is None else self.rest
        return SearchedMesh(
            vertices, self.triangles, self.face_of_triangle, self.n_faces, self.source, self.colours, rest
        )


def boxes_of(mesh: Mesh) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Corners (N, 3, 3) of the triangles and a tree over them (see ``build_tree``): kept, or made now."""
    return mesh.boxes if isinstance(mesh, SearchedMesh) else _boxes(mesh)


def _boxes(mesh: Mesh) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    corners = np.ascontiguousarray(mesh.vertices[mesh.triangles], np.float64)
    return corners, _kernels_surface.build_tree(corners.min(axis=1), corners.max(axis=1), corners.mean(axis=1))


def closest_points(
    mesh: Mesh, queries: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Closest surface point (n, 3), its triangle (n,) and its distance (n,) of every query, in the mesh's units.

    Raises ValueError for a mesh without triangles or queries that are not finite.
    """
    if not len(mesh.triangles):
        raise ValueError("mesh: wanted at least one triangle, got none; usually a mesh of lines or points only")
    queries = np.ascontiguousarray(queries, np.float64)
    if not np.isfinite(queries).all():
        raise ValueError("queries: wanted finite positions, got NaN or infinity; leave absent points out")
    corners, tree = boxes_of(mesh)
    positions, triangle = np.empty_like(queries), np.empty(len(queries), np.int64)
    distance = _kernels_surface.closest_points(corners, *tree, queries, positions, triangle)
    return positions, triangle, distance
