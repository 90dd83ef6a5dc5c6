"""Points to faces: what the model believes of every face of the input mesh, and the labels that follow.

Samples alone know little of small faces: screws, dense hardware and narrow bevels carry none.  So the deformed
templates are asked at the faces themselves, and the samples on a face speak louder the more there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.facecut import cut_faces
from shapeforge.collection.points import nearest_points
from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.exemplars import Candidate, believed_parts, voices_for
from shapeforge.deformation.factors import NORMAL_WEIGHT
from shapeforge.deformation.fit import FitState
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import mapped_normals

NEAREST = 4
NORMAL_REACH = 0.03
"""A surface point on a surface at right angles counts as this much (diagonals) farther away."""

LEAST_PROBABILITY = 1e-3

TEMPLATE_CANDIDATES = 15
"""Template points that may correspond to a face: the nearest."""

TEMPLATE_SHARE = 0.4
"""What the templates' voice is worth on a face with very many samples; on one without samples it is all."""

LEAST_VOICE = 0.05
"""An explanation whose word is worth less than this at a face is not asked there."""

BORDER = 60.0
"""Width of a border in thousandths of the root of the area (see ``cut_faces``)."""


@dataclass(frozen=True, eq=False)
class Explanations:
    """What explains one shape: the beliefs by exemplars and by the family's own templates, with their voices; the
    templates that they deform, Σ1 (variances)."""

    candidates: Sequence[Candidate]
    templates: Sequence[PartTemplates]
    unary: Float[np.ndarray, " 3"]


def explanations(state: FitState, shape: int) -> Explanations:
    """The explanations of shape number ``shape`` of a fit."""
    return Explanations(state.candidates[shape], state.templates, state.covariances.unary)


def face_probabilities(
    shape: Shape, beliefs: Beliefs, explained: Explanations | None = None
) -> Float[np.ndarray, "F L"]:
    """Label probabilities of every face record (n_faces, L): of the samples on it and nearest to its centre, and of the
    deformed template points that would correspond to its centre, where ``explained`` tells of them.

    Nearness takes the normal into account (up to its sign: soup has no orientation), so that a thin arm rest does not
    borrow from the seat beneath it.
    """
    sampled, count = _of_samples(shape, beliefs.segmentation)
    if explained is None:
        return sampled
    share = (TEMPLATE_SHARE + (1.0 - TEMPLATE_SHARE) / (1.0 + count))[:, None]
    if len(beliefs.copies):  # no template knows of a copy
        on_copy = np.stack([beliefs.copies < 0, beliefs.copies >= 0], axis=1).astype(np.float64)
        share = share * _of_samples(shape, on_copy)[0][:, :1]
    return (1.0 - share) * sampled + share * template_probabilities(shape, explained)


def _of_samples(shape: Shape, segmentation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities of faces (n_faces, L) by the samples on them and the nearest ones, and their numbers (n_faces,)."""
    mesh = shape.mesh
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
    return mixed / mixed.sum(axis=1, keepdims=True), count


def template_probabilities(shape: Shape, explained: Explanations) -> Float[np.ndarray, "F L"]:
    """Label probabilities of every face (n_faces, L) by φ1 and the normals alone: the correspondence update for its
    centre, summed over the template points of each part, averaged over the explanations by their voices there.
    """
    centres, normals = shape.mesh.face_centres, shape.mesh.face_normals
    parts = believed_parts(explained.candidates)
    worth = voices_for(explained.candidates, parts)[:, nearest_points(shape.points, centres)[0][:, 0]]
    mixed = np.full((len(centres), explained.templates[0].n_parts), 1e-9)
    for candidate, voice in zip(explained.candidates, worth, strict=True):
        heard = np.flatnonzero(voice >= LEAST_VOICE)
        beliefs = candidate.beliefs
        template = explained.templates[beliefs.template]
        alive = np.flatnonzero(beliefs.alive(template.label))
        if not len(alive):
            continue
        near = alive[nearest_points(beliefs.deformed[alive], centres[heard], TEMPLATE_CANDIDATES)[0]]
        apart = (centres[heard, None] - beliefs.deformed[near]) ** 2 @ (1.0 / explained.unary)
        turned = np.abs(np.einsum("fki,fi->fk", mapped_normals(template, beliefs)[near], normals[heard]))
        log = -0.5 * apart - NORMAL_WEIGHT * (1.0 - turned)
        q = np.exp(log - log.max(axis=1, keepdims=True))
        q *= (voice[heard] / q.sum(axis=1))[:, None]
        label = template.label[near]
        mixed[heard] += np.stack([(q * (label == part)).sum(axis=1) for part in range(template.n_parts)], axis=1)
    mixed *= parts
    return mixed / mixed.sum(axis=1, keepdims=True)


def label_faces(
    shape: Shape,
    beliefs: Beliefs,
    painted: Int[np.ndarray, " F"] | None = None,
    *,
    explained: Explanations | None = None,
) -> tuple[Int[np.ndarray, " F"], Float[np.ndarray, "F L"]]:
    """Part label (n_faces,) of every face by a graph cut over the faces, and the probabilities (n_faces, L) it used.

    ``explained`` lets the templates speak for the faces (see ``explanations``).  Faces painted by the user
    (``painted`` >= 0) keep their label.
    """
    probabilities = face_probabilities(shape, beliefs, explained)
    if painted is not None:
        known = np.flatnonzero(np.asarray(painted) >= 0)
        probabilities[known] = np.eye(probabilities.shape[1])[painted[known]]
    cost = -np.log(np.maximum(probabilities, LEAST_PROBABILITY))
    labels = cut_faces(shape.mesh, cost, weight=BORDER)
    if painted is not None:
        labels[known] = painted[known]
    return labels.astype(np.int32), probabilities.astype(np.float32)
