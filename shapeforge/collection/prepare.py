"""From a mesh to a shape for the model: turned, scaled, sampled, described, cut into patches (§3, §4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from shapeforge.collection.descriptors import descriptors_from_diameter, shape_diameter
from shapeforge.collection.meshes import repair_notes
from shapeforge.collection.orient import orient
from shapeforge.collection.patches import find_patches, patch_neighbours
from shapeforge.collection.points import nearest_neighbours, sample_points
from shapeforge.collection.shape import Frame, Mesh, Shape


def prepare_shape(name: str, mesh: Mesh, *, n_points: int = 5000, up: str = "auto", rng: np.random.Generator) -> Shape:
    """A shape in normal coordinates (y up, bounding box centred with diagonal 1), with the frame back to the file's.

    ``up`` is passed to ``orient``.  Deterministic in (mesh, state of ``rng``).  ``notes`` of the shape tell how it was
    turned and what is odd about the mesh.  Raises ValueError where the mesh has no area or ``up`` is unknown.
    """
    rotation, turned = orient(mesh, up)
    frame = normal_frame(mesh, rotation)
    mesh_here = mesh.moved(frame.to_normal(mesh.vertices))
    points, normals, triangle_of_point = sample_points(mesh_here, n_points, rng=rng)
    neighbours = nearest_neighbours(points, 20)
    diameter, normals = shape_diameter(mesh_here, points, normals, triangle_of_point, neighbours)
    descriptors = descriptors_from_diameter(points, diameter, neighbours)
    patch = find_patches(points, normals, descriptors, neighbours)
    return Shape(
        name=name,
        mesh=mesh_here,
        frame=frame,
        points=points,
        normals=normals,
        face_of_point=mesh.face_of_triangle[triangle_of_point],
        triangle_of_point=triangle_of_point,
        descriptors=descriptors,
        patch=patch,
        neighbours=patch_neighbours(points, patch),
        notes=(turned, *repair_notes(mesh)),
    )


def turned(shape: Shape, rotation: Float[np.ndarray, "3 3"], note: str) -> Shape:
    """The same shape, its file turned by ``rotation`` (3, 3) instead; ``note`` replaces the one on how it was turned.

    Samples, neighbours and patches stay. Descriptors do too, though taking a tilt away changes the diagonal and so
    the radii they were taken at, by a few percent.
    """
    mesh = shape.mesh.moved(shape.frame.to_input(shape.mesh.vertices))
    frame = normal_frame(mesh, rotation)
    return replace(
        shape,
        mesh=mesh.moved(frame.to_normal(mesh.vertices)),
        frame=frame,
        points=frame.to_normal(shape.frame.to_input(shape.points)),
        normals=shape.normals @ shape.frame.rotation @ rotation.T,
        notes=(note, *shape.notes[1:]),
    )


def normal_frame(mesh: Mesh, rotation: np.ndarray) -> Frame:
    """The frame that, after turning by ``rotation`` (3, 3), centres the bounding box and makes its diagonal 1.

    Vertices that no face uses do not count.
    """
    turned = mesh.vertices[np.unique(mesh.triangles)] @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    return Frame(1.0 / float(np.linalg.norm(high - low)), rotation, (low + high) / 2 @ rotation)
