"""The nouns of a collection: a mesh as its file has it, and a shape ready for the model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, UInt8


@dataclass(frozen=True, eq=False)
class Frame:
    """A similarity from a file's coordinates to normal ones: ``normal = scale * (input - centre) @ rotation.T``.

    In normal coordinates the bounding box is centred at the origin and its diagonal is 1; y is up.
    """

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, " 3"]

    def to_normal(self, positions: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Positions (..., 3) of the file, in normal coordinates (diagonals)."""
        return self.scale * (positions - self.centre) @ self.rotation.T

    def to_input(self, positions: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Positions (..., 3) in normal coordinates, in the file's own units and axes."""
        return positions @ self.rotation / self.scale + self.centre


@dataclass(frozen=True, eq=False)
class Mesh:
    """Polygon records, triangulated, with the way back: face ``k`` is the k-th face record of the file.

    Degenerate records keep their number: a record may own no triangle at all.  ``colours`` (n_faces, 3), red, green,
    blue, are those of the file's materials, where it has any.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    face_of_triangle: Int[np.ndarray, " N"]
    n_faces: int
    source: str = ""
    colours: UInt8[np.ndarray, "F 3"] | None = None

    @cached_property
    def triangle_areas(self) -> Float[np.ndarray, " N"]:
        """Area of every triangle (N,), in squared units of ``vertices``."""
        return 0.5 * np.linalg.norm(self._crosses, axis=1)

    @cached_property
    def triangle_normals(self) -> Float[np.ndarray, "N 3"]:
        """Unit normal of every triangle (N, 3); zero where the triangle has no area."""
        length = np.linalg.norm(self._crosses, axis=1, keepdims=True)
        return np.divide(self._crosses, length, out=np.zeros_like(self._crosses), where=length > 0)

    @cached_property
    def _crosses(self) -> np.ndarray:
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def face_areas(self) -> Float[np.ndarray, " F"]:
        """Area of every face record (n_faces,); 0 for records without triangles."""
        return np.bincount(self.face_of_triangle, self.triangle_areas, self.n_faces)

    @cached_property
    def face_centres(self) -> Float[np.ndarray, "F 3"]:
        """Area-weighted centre of every face record (n_faces, 3); the mean corner where the area is 0."""
        corners = self.vertices[self.triangles].mean(axis=1)
        weight = self.triangle_areas + 1e-300
        total = np.bincount(self.face_of_triangle, weight, self.n_faces)
        sums = [np.bincount(self.face_of_triangle, weight * corners[:, i], self.n_faces) for i in range(3)]
        return np.stack(sums, axis=1) / np.maximum(total, 1e-300)[:, None]

    @cached_property
    def face_normals(self) -> Float[np.ndarray, "F 3"]:
        """Unit area-weighted normal of every face record (n_faces, 3); zero where the area is 0."""
        sums = np.stack(
            [np.bincount(self.face_of_triangle, self._crosses[:, i], self.n_faces) for i in range(3)], axis=1
        )
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        return np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)

    def moved(self, vertices: Float[np.ndarray, "V 3"]) -> Mesh:
        """The same connectivity with other vertex positions."""
        return Mesh(vertices, self.triangles, self.face_of_triangle, self.n_faces, self.source, self.colours)


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of the family, normalised and sampled.  ``mesh`` and ``points`` are in normal coordinates.

    ``face_of_point`` is a face record (as labels are), ``triangle_of_point`` a row of ``mesh.triangles``;
    ``neighbours`` holds point indices inside the same patch, -1 where the patch is smaller; ``normals`` point outward
    as far as rays can tell, however the file winds its faces; ``notes`` says what was odd about the file.
    """

    name: str
    mesh: Mesh
    frame: Frame
    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    face_of_point: Int[np.ndarray, " P"]
    triangle_of_point: Int[np.ndarray, " P"]
    descriptors: Float[np.ndarray, "P 10"]
    patch: Int[np.ndarray, " P"]
    neighbours: Int[np.ndarray, "P n"]
    notes: tuple[str, ...] = ()

    @property
    def n_points(self) -> int:
        """Number of surface points P."""
        return len(self.points)


@runtime_checkable
class Shapes(Protocol):
    """A lazy sequence of shapes: a list will do; a store fulfils it from disk, one shape at a time."""

    @property
    def names(self) -> Sequence[str]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Shape: ...

    def __iter__(self) -> Iterator[Shape]: ...
