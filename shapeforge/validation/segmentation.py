"""How right the labels of a shape's faces are (§6, segmentation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection.shape import Mesh


@dataclass(frozen=True)
class SegmentationScore:
    """Shares in 0..1 of one shape: right ``faces``, right ``area``, ``part_iou`` (by area, mean over true parts)."""

    faces: float
    area: float
    part_iou: float


def score_segmentation(
    mesh: Mesh, predicted: Int[np.ndarray, " F"], truth: Int[np.ndarray, " F"]
) -> SegmentationScore | None:
    """Score of labels per face record against the truth; None when the truth labels no face.

    Faces that the truth leaves unlabelled (negative) are left out; elsewhere a missing prediction is a wrong one.  The
    parts of the mean IoU are those that the truth has.  Faces without area count as faces, not as area.
    """
    if len(predicted) != mesh.n_faces or len(truth) != mesh.n_faces:
        raise ValueError(
            f"predicted, truth: wanted a label per face record ({mesh.n_faces}), got {len(predicted)} and "
            f"{len(truth)}. Face k is the k-th face record of the file; were labels counted per triangle?"
        )
    told = truth >= 0
    if not told.any():
        return None
    right = (predicted == truth) & told
    area = np.where(told, mesh.face_areas, 0.0)
    if area.sum() <= 0:
        area = told.astype(float)
    overlaps = []
    for part in np.unique(truth[told]):
        union = area[told & ((truth == part) | (predicted == part))].sum()
        if union > 0:
            overlaps.append(area[right & (truth == part)].sum() / union)
    return SegmentationScore(
        float(right[told].mean()), float(area[right].sum() / area.sum()), float(np.mean(overlaps)) if overlaps else 0.0
    )


def mean_score(scores: Sequence[SegmentationScore]) -> SegmentationScore | None:
    """The mean over shapes; None without any."""
    if not scores:
        return None
    rows: Float[np.ndarray, "n 3"] = np.array([(s.faces, s.area, s.part_iou) for s in scores])
    faces, area, part_iou = rows.mean(axis=0).tolist()
    return SegmentationScore(faces, area, part_iou)


def rename_parts(
    labels: Int[np.ndarray, " F"], names: Sequence[str], truth_names: Sequence[str]
) -> Int[np.ndarray, " F"]:
    """Labels whose index refers to ``names``, as indices into ``truth_names``.

    Parts are matched by name, whatever their order and case; one that the truth doesn't know becomes
    ``len(truth_names)``, which is never right, and unlabelled faces stay -1.
    """
    place = {name.strip().casefold(): i for i, name in enumerate(truth_names)}
    table = np.array([*(place.get(name.strip().casefold(), len(truth_names)) for name in names), -1], np.int32)
    if len(labels) and labels.max() >= len(names):
        raise ValueError(f"labels: wanted indices below {len(names)} (the part names), got {int(labels.max())}.")
    return table[np.maximum(labels, -1)]
