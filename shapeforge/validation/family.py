"""All figures of a family for which truth is at hand, as one dictionary ready for JSON."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from itertools import permutations

import numpy as np

from shapeforge.collection.shape import Mesh
from shapeforge.validation.classification import nearest_neighbour_accuracy
from shapeforge.validation.correspondence import RADII, corr_curve, landmark_errors
from shapeforge.validation.segmentation import mean_score, rename_parts, score_segmentation
from shapeforge.validation.statistics import bootstrap_interval

Arrays = Mapping[str, np.ndarray]


def validate_family(
    mesh_of: Callable[[str], Mesh],
    *,
    rng: np.random.Generator,
    part_names: Sequence[str] = (),
    predicted: Arrays | None = None,
    truth: Arrays | None = None,
    truth_part_names: Sequence[str] = (),
    landmarks: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    points: Arrays | None = None,
    classes: Mapping[str, str] | None = None,
    descriptors: Arrays | None = None,
    evidence: Collection[str] = (),
    baseline_faces: Arrays | None = None,
    baseline_points: Arrays | None = None,
) -> dict:
    """Segmentation, correspondence and classes, each where truth and answer are given; keys are shape names.

    ``predicted`` and ``baseline_faces`` index ``part_names``, ``truth`` indexes ``truth_part_names``; parts are matched
    by name.  ``landmarks``, ``points`` (K, 3; NaN absent) and the meshes share the files' coordinates.  Shapes in
    ``evidence`` taught the model and are left out of segmentation and correspondence.  Shapes with a truth but no
    answer count as left out too and are named under ``unanswered``.
    """
    figures: dict = {"left_out": sorted(evidence)}
    if truth is not None and predicted is not None:
        figures["segmentation"] = _segmentation(
            mesh_of, predicted, truth, part_names, truth_part_names, evidence, baseline_faces, rng
        )
    if landmarks is not None and points is not None:
        figures["correspondence"] = _correspondence(mesh_of, landmarks, points, evidence, baseline_points)
    if classes is not None and descriptors is not None:
        figures["classification"] = _classification(classes, descriptors, rng)
    return figures


def _segmentation(mesh_of, predicted, truth, part_names, truth_part_names, evidence, baseline, rng) -> dict:
    asked = [name for name in truth if name not in evidence]
    ours, theirs, missing = {}, {}, []
    for name in asked:
        if name not in predicted:
            missing.append(name)
            continue
        mesh = mesh_of(name)
        score = score_segmentation(mesh, rename_parts(predicted[name], part_names, truth_part_names), truth[name])
        if score is None:
            continue
        ours[name] = score
        if baseline is not None and name in baseline:
            labels = rename_parts(baseline[name], part_names, truth_part_names)
            theirs[name] = score_segmentation(mesh, labels, truth[name])
    found: dict = {"n": len(ours), "unanswered": missing}
    known = {name.strip().casefold() for name in part_names}
    found["parts_without_answer"] = [name for name in truth_part_names if name.strip().casefold() not in known]
    if ours:
        found |= asdict(mean_score(list(ours.values())))
        for figure in ("faces", "part_iou"):
            values = np.array([getattr(score, figure) for score in ours.values()])
            found[f"{figure}_interval"] = list(bootstrap_interval(values, rng=rng))
        found["shapes"] = {name: asdict(score) for name, score in ours.items()}
    if theirs:
        found["affine_transfer"] = {"n": len(theirs)} | asdict(mean_score(list(theirs.values())))
    return found


def _correspondence(mesh_of, landmarks, points, evidence, baseline) -> dict:
    marked = {name: marks for name, marks in landmarks.items() if name not in evidence and marks}
    unanswered = [name for name in marked if name not in points]
    asked = {name: marks for name, marks in marked.items() if name in points}
    found = {"n_shapes": len(asked), "unanswered": unanswered}
    found |= _curve(landmark_errors(asked, points, mesh_of))
    found["n_pairs"] = sum(1 for a, b in permutations(asked, 2) if asked[a].keys() & asked[b].keys())
    if baseline is not None:
        shared = {name: marks for name, marks in asked.items() if name in baseline}
        found["affine_transfer"] = {"n_shapes": len(shared)} | _curve(landmark_errors(shared, baseline, mesh_of))
    return found


def _curve(errors: np.ndarray) -> dict:
    """n landmarks and corr@r per radius (None without any), and the share of misses: points absent on the target."""
    values = [None if np.isnan(v) else float(v) for v in corr_curve(errors)]
    misses = float(np.isinf(errors).mean()) if len(errors) else None
    return {"n": len(errors), "corr": {f"{r:g}": v for r, v in zip(RADII, values, strict=True)}, "missing": misses}


def _classification(classes, descriptors, rng) -> dict:
    names = [name for name in classes if name in descriptors]
    found: dict = {"n": len(names), "unanswered": [name for name in classes if name not in descriptors]}
    if names:
        values = np.stack([np.asarray(descriptors[name], float) for name in names])
        score = nearest_neighbour_accuracy(values, [classes[name] for name in names], rng=rng)
        if score is not None:
            found |= asdict(score)
    return found
