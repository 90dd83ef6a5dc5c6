"""Points to faces: what the model believes of every face of the input mesh, and the labels that follow."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.facecut import cut_faces
from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs

NEAREST = 4
NORMAL_REACH = 0.03
"""A surface point on a surface at right angles counts as this much (diagonals) farther away."""

LEAST_PROBABILITY = 1e-3


def face_probabilities(shape: Shape, beliefs: Beliefs) -> Float[np.ndarray, "F L"]:
    """Label probabilities of every face record (n_faces, L): of the samples on it, else of those nearest to its centre.

    Nearness takes the normal into account (up to its sign: soup has no orientation), so that a thin arm rest does not
    borrow from the seat beneath it.
    """
    mesh, segmentation = shape.mesh, beliefs.segmentation
    n_parts = segmentation.shape[1]
    count = np.bincount(shape.face_of_point, minlength=mesh.n_faces).astype(np.float64)
    total = np.stack(
        [np.bincount(shape.face_of_point, segmentation[:, part], mesh.n_faces) for part in range(n_parts)], axis=1
    )
    k = min(8, shape.n_points)
    distance, near = cKDTree(shape.points).query(mesh.face_centres, k=k)
    distance, near = distance.reshape(-1, k), near.reshape(-1, k)
    cosine = np.abs(np.einsum("fki,fi->fk", shape.normals[near], mesh.face_normals))
    effective = distance + NORMAL_REACH * (1.0 - cosine)
    order = np.argsort(effective, axis=1, kind="stable")[:, :NEAREST]
    weight = 1.0 / (np.take_along_axis(effective, order, 1) + 1e-3) ** 2
    borrowed = np.einsum("fk,fkl->fl", weight, segmentation[np.take_along_axis(near, order, 1)])
    borrowed /= weight.sum(axis=1, keepdims=True)
    # the face's own samples speak louder the more there are; one borrowed voice keeps sparse faces honest
    mixed = (total + borrowed) / (count + 1.0)[:, None]
    return mixed / mixed.sum(axis=1, keepdims=True)


def label_faces(
    shape: Shape, beliefs: Beliefs, painted: Int[np.ndarray, " F"] | None = None, *, weight: float = 20.0
) -> tuple[Int[np.ndarray, " F"], Float[np.ndarray, "F L"]]:
    """Part label (n_faces,) of every face by a graph cut over the faces, and the probabilities (n_faces, L) it used.

    Faces painted by the user (``painted`` >= 0) keep their label.
    """
    probabilities = face_probabilities(shape, beliefs)
    if painted is not None:
        known = np.flatnonzero(np.asarray(painted) >= 0)
        probabilities[known] = np.eye(probabilities.shape[1])[painted[known]]
    cost = -np.log(np.maximum(probabilities, LEAST_PROBABILITY))
    labels = cut_faces(shape.mesh, cost, weight=weight)
    if painted is not None:
        labels[known] = painted[known]
    return labels.astype(np.int32), probabilities.astype(np.float32)
