"""Small meshes with known answers, for the tests of this room."""

from __future__ import annotations

import numpy as np
import trimesh

from shapeforge.collection.shape import Mesh


def as_mesh(solid: trimesh.Trimesh) -> Mesh:
    """A Mesh with one record per triangle."""
    triangles = np.asarray(solid.faces, np.int32)
    record = np.arange(len(triangles), dtype=np.int32)
    return Mesh(np.asarray(solid.vertices, np.float64), triangles, record, len(triangles))


def joined(*solids: trimesh.Trimesh) -> Mesh:
    """Several solids as one mesh, not welded."""
    return as_mesh(trimesh.util.concatenate(solids))


def box(size: tuple[float, float, float], centre: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    """A closed box."""
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre))


def stool() -> Mesh:
    """A thick seat on four thin legs, closed, about one diagonal large, y up."""
    legs = [box((0.06, 0.5, 0.06), (x, -0.25, z)) for x in (-0.22, 0.22) for z in (-0.22, 0.22)]
    return joined(box((0.5, 0.12, 0.5), (0, 0.06, 0)), *legs)


def soup(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """The same surface as loose triangles, half of them wound the other way."""
    triangles = np.arange(3 * len(mesh.triangles), dtype=np.int32).reshape(-1, 3)
    turned = rng.random(len(triangles)) < 0.5
    triangles[turned] = triangles[turned][:, ::-1]
    return Mesh(mesh.vertices[mesh.triangles].reshape(-1, 3), triangles, mesh.face_of_triangle, mesh.n_faces)


def random_turn(rng: np.random.Generator) -> np.ndarray:
    """A rotation, evenly distributed."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))
