"""Pieces to one mesh, and the ways in which real models are broken."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection.families.solids import Piece, triangulate
from shapeforge.collection.shape import Mesh

DAMAGES = ("open", "duplicated", "flipped", "polygons", "soup")


def assemble(
    pieces: list[Piece], part_names: tuple[str, ...], component_names: tuple[str, ...], *, polygons: bool = False
) -> tuple[Mesh, Int[np.ndarray, " F"], Float[np.ndarray, "N 3 5"]]:
    """One mesh of all pieces, the part index of every face, the address (component, u, v, w, 1) of every corner.

    Faces are triangles, or with ``polygons`` quads wherever the surface has them.
    """
    offsets = np.cumsum([0] + [len(p.vertices) for p in pieces])
    vertices = np.concatenate([p.vertices for p in pieces])
    triangles, faces, part, address = [], [], [], []
    n_faces = 0
    for piece, offset in zip(pieces, offsets[:-1], strict=True):
        index, face = triangulate(piece.faces)
        if not polygons:
            face = np.arange(len(index))
        corners = np.empty((len(index), 3, 5))
        corners[..., 0] = component_names.index(piece.component)
        corners[..., 1:4] = piece.address[index]
        corners[..., 4] = 1.0
        triangles.append(index + offset)
        faces.append(face + n_faces)
        part.append(np.full(face[-1] + 1, part_names.index(piece.part)))
        address.append(corners)
        n_faces += int(face[-1]) + 1
    mesh = Mesh(vertices, np.concatenate(triangles), np.concatenate(faces), n_faces)
    return mesh, np.concatenate(part), np.concatenate(address)


def damaged(
    mesh: Mesh, part: np.ndarray, address: np.ndarray, kinds: tuple[str, ...], *, rng: np.random.Generator
) -> tuple[Mesh, Int[np.ndarray, " F"], Float[np.ndarray, "N 3 5"]]:
    """The mesh with some of its faces missing, doubled or turned over, or with no shared vertices at all.

    Kinds: "open" (holes and missing caps), "duplicated" (the same faces twice), "flipped" (winding), "soup" (every
    face has its own vertices).  "polygons" is decided when the mesh is assembled.
    """
    vertices = mesh.vertices
    triangles, face = mesh.triangles, mesh.face_of_triangle
    if "open" in kinds:
        gone = np.zeros(mesh.n_faces, dtype=bool)
        component = address[:, 0, 0].astype(int)
        for one in rng.permutation(np.unique(component))[:3]:
            # one end of the component: its cap and a little more
            u = address[:, :, 1].mean(axis=1)
            inside = (component == one) & ((u > 0.985) if rng.random() < 0.5 else (u < 0.015))
            if inside.sum() < 0.3 * (component == one).sum():
                gone[face[inside]] = True
        gone |= rng.random(mesh.n_faces) < 0.01
        triangles, face, part, address = _kept(~gone, triangles, face, part, address)
    if "flipped" in kinds:
        component = address[:, 0, 0].astype(int)
        chosen = rng.permutation(np.unique(component))[:2]
        turn = np.isin(component, chosen) | (rng.random(len(part)) < 0.03)[face]
        triangles = triangles.copy()
        address = address.copy()
        triangles[turn] = triangles[turn][:, ::-1]
        address[turn] = address[turn][:, ::-1]
    if "duplicated" in kinds:
        twice = np.flatnonzero(rng.random(len(part)) < 0.05)
        again = np.isin(face, twice)
        renumber = np.full(len(part), -1)
        renumber[twice] = len(part) + np.arange(len(twice))
        triangles = np.concatenate([triangles, triangles[again]])
        face = np.concatenate([face, renumber[face[again]]])
        address = np.concatenate([address, address[again]])
        part = np.concatenate([part, part[twice]])
    if "soup" in kinds:
        vertices = vertices[triangles].reshape(-1, 3)
        triangles = np.arange(len(vertices)).reshape(-1, 3)
        face, part = np.arange(len(triangles)), part[face]
    return Mesh(vertices, triangles, face, len(part)), part, address


def _kept(keep, triangles, face, part, address):
    inside = keep[face]
    renumber = np.cumsum(keep) - 1
    return triangles[inside], renumber[face[inside]], part[keep], address[inside]


def face_records(mesh: Mesh) -> list[Int[np.ndarray, " c"]]:
    """The polygons (vertex indices) that the fans of triangles of each face came from, in face order."""
    order = np.argsort(mesh.face_of_triangle, kind="stable")
    starts = np.searchsorted(mesh.face_of_triangle[order], np.arange(mesh.n_faces + 1))
    triangles = mesh.triangles[order]
    records = []
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        fan = triangles[first:last]
        # a fan a b c, a c d, ... or, turned over, c b a, d c a, ...: its polygon once around
        if len(fan) > 1 and fan[0, 2] == fan[1, 2]:
            records.append(np.concatenate([fan[::-1, 0], fan[0, 1:]]))
        else:
            records.append(np.concatenate([fan[0], fan[1:, 2]]))
    return records
