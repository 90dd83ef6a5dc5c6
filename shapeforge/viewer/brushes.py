"""Which faces a tool touches: along the surface, through it, up to creases, a whole piece; and their mirror twins.

Everything works on face records (a quad counts once) of a mesh in normal coordinates, so lengths are in diagonals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh
from shapeforge.collection.symmetry import symmetry_plane
from shapeforge.viewer._kernels import flood, walk_within

WELD = 1e-5  # diagonals: corners nearer than this are one, so soups with coincident corners hang together
CREASE = np.radians(28.0)
SYMMETRIC = 0.03  # diagonals: a worse mean distance to the mirror image means there is no mirror to speak of
FARTHEST_TWIN = 0.03  # diagonals: a mirrored place farther than this from the surface has no twin


@dataclass(frozen=True, eq=False)
class FaceSurface:
    """Face records as a graph: the neighbours of face f are ``neighbour[start[f]:start[f + 1]]``.

    ``middle`` (E, 3) is the middle of the common edge, ``bend`` (E,) the angle between the two planes (radians, 0 to
    pi/2: winding cannot be trusted), ``piece`` (F,) the connected piece a face belongs to.
    """

    start: Int[np.ndarray, " G"]
    neighbour: Int[np.ndarray, " E"]
    middle: Float[np.ndarray, "E 3"]
    bend: Float[np.ndarray, " E"]
    centres: Float[np.ndarray, "F 3"]
    areas: Float[np.ndarray, " F"]
    piece: Int[np.ndarray, " F"]
    tree: cKDTree

    @property
    def n_faces(self) -> int:
        """Number of face records F."""
        return len(self.areas)


def face_surface(mesh: Mesh) -> FaceSurface:
    """The graph of a mesh's face records; faces are neighbours along edges whose ends coincide, manifold or not."""
    n = mesh.n_faces
    vertices, triangles = mesh.vertices, mesh.triangles
    centres = np.ascontiguousarray(mesh.face_centres, np.float64)
    pairs, middle = _neighbours(vertices, triangles, mesh.face_of_triangle)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(both[:, 0], kind="stable")
    both, middle = both[order], np.concatenate([middle, middle])[order]
    normals = mesh.face_normals
    cosine = np.abs((normals[both[:, 0]] * normals[both[:, 1]]).sum(axis=1))
    flat = (mesh.face_areas[both] <= 0).any(axis=1)  # a face without area has no plane to bend against
    bend = np.where(flat, 0.0, np.arccos(np.clip(cosine, 0, 1)))
    start = np.searchsorted(both[:, 0], np.arange(n + 1)).astype(np.int64)
    neighbour = np.ascontiguousarray(both[:, 1], np.int64)
    graph = csr_matrix((np.ones(len(neighbour), np.int8), neighbour, start), shape=(n, n))
    piece = connected_components(graph, directed=False)[1].astype(np.int64) if n else np.zeros(0, np.int64)
    return FaceSurface(
        start, neighbour, np.ascontiguousarray(middle), bend, centres, mesh.face_areas, piece, cKDTree(centres)
    )


def _neighbours(vertices: np.ndarray, triangles: np.ndarray, record: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of face records (E, 2) with a common edge, and the edge's middle (E, 3)."""
    if not len(triangles):
        return np.zeros((0, 2), np.int64), np.zeros((0, 3))
    step = max(float(np.linalg.norm(np.ptp(vertices, axis=0))), 1e-12) * WELD
    cell = np.round((vertices - vertices.min(axis=0)) / step).astype(np.int64)
    _, welded = np.unique((cell[:, 0] << 42) ^ (cell[:, 1] << 21) ^ cell[:, 2], return_inverse=True)
    corner = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    owner = np.tile(record, 3).astype(np.int64)
    ends = np.sort(welded[corner], axis=1)
    real = ends[:, 0] != ends[:, 1]
    corner, owner, ends = corner[real], owner[real], ends[real]
    key = ends[:, 0] * (int(welded.max()) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    key, owner, corner = key[order], owner[order], corner[order]
    first, second, edge = [], [], []
    for apart in (1, 2, 3):  # edges of more than four faces become a chain with rungs instead of a clique
        same = np.flatnonzero((key[apart:] == key[:-apart]) & (owner[apart:] != owner[:-apart]))
        first.append(owner[same])
        second.append(owner[same + apart])
        edge.append(corner[same])
    edges = np.concatenate(edge)
    middle = (vertices[edges[:, 0]] + vertices[edges[:, 1]]) / 2
    return np.stack([np.concatenate(first), np.concatenate(second)], axis=1), middle


def along(surface: FaceSurface, face: int, position: Float[np.ndarray, " 3"], radius: float) -> Int[np.ndarray, " n"]:
    """Faces within ``radius`` diagonals of ``position`` on ``face``, measured along the surface; ``face`` always."""
    return walk_within(
        surface.start, surface.neighbour, surface.middle, surface.centres, face,
        np.ascontiguousarray(position, np.float64), float(radius),
    )  # fmt: skip


def through(surface: FaceSurface, face: int, position: Float[np.ndarray, " 3"], radius: float) -> Int[np.ndarray, " n"]:
    """Faces whose centre is within ``radius`` diagonals of ``position`` in space, seen or not; ``face`` always."""
    near = np.asarray(surface.tree.query_ball_point(position, radius), np.int64)
    return np.union1d(near, [face])


def up_to_creases(surface: FaceSurface, face: int, angle: float = CREASE) -> Int[np.ndarray, " n"]:
    """Faces reached from ``face`` without crossing an edge that bends more than ``angle`` radians."""
    return np.sort(flood(surface.start, surface.neighbour, surface.bend, face, angle))


def up_to_patch(surface: FaceSurface, face: int, patch: Int[np.ndarray, " F"]) -> Int[np.ndarray, " n"]:
    """Faces reached from ``face`` without leaving its patch (F,): where the surface folds inward or grows thick."""
    row = np.repeat(np.arange(surface.n_faces), np.diff(surface.start))
    across = np.where(patch[row] == patch[surface.neighbour], 0.0, np.pi)
    return np.sort(flood(surface.start, surface.neighbour, across, face, 1.0))


def patch_of_faces(
    surface: FaceSurface, points: Float[np.ndarray, "P 3"], patch: Int[np.ndarray, " P"]
) -> Int[np.ndarray, " F"]:
    """Patch number (F,) of every face: that of the sample point nearest to its middle."""
    return np.asarray(patch, np.int64)[cKDTree(points).query(surface.centres)[1]]


def mirror_plane(points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, " 3"], float, float] | None:
    """Normal, offset and error (diagonals, beyond the sampling's) of the mirror plane; None without a good one."""
    normal, offset, error = symmetry_plane(points)
    # Between samples even a perfect mirror misses by their spacing; what is left is the shape's own.
    spacing = float(cKDTree(points).query(points, k=2)[0][:, 1].mean()) if len(points) > 1 else 0.0
    error = max(float(error) - spacing, 0.0)
    return (np.asarray(normal, float), float(offset), error) if error < SYMMETRIC else None


def mirrored_faces(
    surface: FaceSurface, faces: Int[np.ndarray, " n"], normal: Float[np.ndarray, " 3"], offset: float
) -> Int[np.ndarray, " m"]:
    """Faces opposite ``faces`` across the plane normal . x = offset: those whose own mirror image is near one of them.

    Asked from the far side, so that a coarse half answers a fine one without holes.
    """
    return np.flatnonzero(np.isin(opposite_faces(surface, normal, offset), faces)) if len(faces) else faces


def opposite_faces(surface: FaceSurface, normal: Float[np.ndarray, " 3"], offset: float) -> Int[np.ndarray, " F"]:
    """The face (F,) whose centre is nearest to the mirror image of each face's; -1 where none is near."""
    twins = surface.centres - 2 * (surface.centres @ normal - offset)[:, None] * normal
    distance, nearest = surface.tree.query(twins)
    return np.where(distance <= FARTHEST_TWIN + 0.75 * np.sqrt(surface.areas[nearest]), nearest, -1)


def whole_piece(surface: FaceSurface, face: int) -> Int[np.ndarray, " n"]:
    """All faces of the connected piece of ``face``."""
    return np.flatnonzero(surface.piece == surface.piece[face])


def mirrored(
    surface: FaceSurface, position: Float[np.ndarray, " 3"], normal: Float[np.ndarray, " 3"], offset: float
) -> tuple[int, Float[np.ndarray, " 3"]] | None:
    """The face and place opposite ``position`` across the plane normal . x = offset; None where nothing is near.

    The place is the reflection itself, the face the one whose centre is nearest to it.
    """
    twin = position - 2 * (position @ normal - offset) * normal
    distance, face = surface.tree.query(twin)
    reach = FARTHEST_TWIN + 0.75 * np.sqrt(surface.areas[face])
    return (int(face), twin) if distance <= reach else None


def unpainted_pieces(
    surface: FaceSurface, labels: Int[np.ndarray, " F"], smallest: float = 1e-5
) -> list[Int[np.ndarray, " n"]]:
    """The connected unpainted regions, largest area first; slivers below ``smallest`` of the area are left out."""
    blank = np.flatnonzero(labels < 0)
    if not len(blank):
        return []
    row = np.repeat(np.arange(surface.n_faces), np.diff(surface.start))
    kept = (labels[row] < 0) & (labels[surface.neighbour] < 0)
    place = np.full(surface.n_faces, -1)
    place[blank] = np.arange(len(blank))
    graph = csr_matrix(
        (np.ones(int(kept.sum()), np.int8), (place[row[kept]], place[surface.neighbour[kept]])),
        shape=(len(blank), len(blank)),
    )
    count, component = connected_components(graph, directed=False)
    area = np.bincount(component, surface.areas[blank], count)
    order = np.argsort(-area, kind="stable")
    order = order[area[order] > smallest * max(float(surface.areas.sum()), 1e-300)]
    by_component = np.argsort(component, kind="stable")
    bounds = np.searchsorted(component[by_component], np.arange(count + 1))
    return [blank[by_component[bounds[c] : bounds[c + 1]]] for c in order]


def shares(surface: FaceSurface, labels: Int[np.ndarray, " F"], n_parts: int) -> Float[np.ndarray, " L"]:
    """Share of the area that each part has (n_parts,); what is missing to 1 is unpainted."""
    painted = labels >= 0
    area = np.bincount(labels[painted], surface.areas[painted], n_parts)[:n_parts]
    return area / max(float(surface.areas.sum()), 1e-300)
