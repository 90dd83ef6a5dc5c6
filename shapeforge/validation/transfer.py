"""The plain baseline: labels and correspondences carried over from the nearest exemplar by an affine map alone.

No model, no learning: what an hour of scripting gives.  Printed beside ours, it says what the model is for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.align import Alignment, affine_align
from shapeforge.collection.shape import Shape
from shapeforge.collection.surface import closest_points


@dataclass(frozen=True, eq=False)
class Transferred:
    """What an exemplar says of a shape: a part index per face record (-1 where the exemplar is unlabelled), and the
    surface points (K, 3, normal coordinates) that correspond to the family's reference points; ``residual`` in
    diagonals.
    """

    exemplar: int
    residual: float
    faces: Int[np.ndarray, " F"]
    positions: Float[np.ndarray, "K 3"]


def reference_points(exemplars: Sequence[Shape]) -> tuple[Float[np.ndarray, "K 3"], ...]:
    """The first exemplar's surface points and where they fall on each exemplar: affine, then to the surface."""
    if not exemplars:
        raise ValueError("exemplars: wanted at least one shape, got none. Group the family or label a shape first.")
    first = exemplars[0]
    found = [first.points]
    for exemplar in exemplars[1:]:
        moved = affine_align(first.points, exemplar.points)(first.points)
        found.append(closest_points(exemplar.mesh, moved)[0])
    return tuple(found)


def nearest_exemplar(shape: Shape, exemplars: Sequence[Shape]) -> tuple[int, Alignment]:
    """The exemplar that an affine map brings nearest to the shape, and that map (exemplar to shape)."""
    alignments = [affine_align(exemplar.points, shape.points) for exemplar in exemplars]
    best = int(np.argmin([alignment.residual for alignment in alignments]))
    return best, alignments[best]


def affine_transfer(
    shape: Shape,
    exemplars: Sequence[Shape],
    exemplar_faces: Sequence[np.ndarray],
    references: Sequence[np.ndarray] | None = None,
) -> Transferred:
    """Labels and correspondences of ``shape`` from the nearest exemplar.

    ``exemplar_faces[e]`` is a part index per face record of exemplar e, ``references`` comes from
    :func:`reference_points` (made anew if None: give it when there are several shapes).
    """
    if len(exemplars) != len(exemplar_faces):
        raise ValueError(
            f"exemplar_faces: wanted labels for each of {len(exemplars)} exemplars, got {len(exemplar_faces)}."
        )
    references = reference_points(exemplars) if references is None else references
    chosen, alignment = nearest_exemplar(shape, exemplars)
    exemplar = exemplars[chosen]
    faces = transfer_labels(shape, alignment(exemplar.points), exemplar_faces[chosen][exemplar.face_of_point])
    positions = closest_points(shape.mesh, alignment(references[chosen]))[0]
    return Transferred(chosen, alignment.residual, faces, positions)


def transfer_labels(
    shape: Shape, points: Float[np.ndarray, "n 3"], labels: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " F"]:
    """Label per face record from labelled ``points``: its surface points vote by their nearest one, else its centre."""
    mesh = shape.mesh
    tree = cKDTree(points)
    nearest = labels[tree.query(shape.points)[1]]
    n_labels = int(labels.max(initial=-1)) + 2  # -1 is counted too, in the last place
    votes = np.zeros((mesh.n_faces, n_labels))
    np.add.at(votes, (shape.face_of_point, nearest % n_labels), 1)
    won = votes.argmax(axis=1)
    faces = np.where(won == n_labels - 1, -1, won)
    empty = np.flatnonzero(votes.sum(axis=1) == 0)
    faces[empty] = labels[tree.query(mesh.face_centres[empty])[1]]
    return faces.astype(np.int32)
