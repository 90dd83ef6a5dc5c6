"""Measuring a project against truth that the user has: labels, landmarks, fine classes."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.collection.counts import counted
from shapeforge.collection.labels import LabelError, PartNames, find_part_names, read_seg
from shapeforge.collection.shape import Mesh
from shapeforge.stages import Progress, StageError, refresh
from shapeforge.stages_collection import read_proposal
from shapeforge.stages_status import starts_from_proposal
from shapeforge.stages_synthesis import fitted_part_names
from shapeforge.store import Problem, Project
from shapeforge.workers import Workers

RADII_SHOWN = ("0.025", "0.05", "0.1")


def validate(
    project: Project,
    *,
    labels: str | Path | None = None,
    landmarks: str | Path | None = None,
    classes: str | Path | None = None,
    seed: int = 0,
    jobs: int | None = None,
) -> Iterator[Progress]:
    """Compare the fit with whichever truth is given, beside plain affine nearest-neighbour transfer.

    ``labels`` is a folder of ``.seg`` files, ``landmarks`` a ``landmarks.json`` in the coordinates of the input files,
    ``classes`` a ``classes.csv``.  Shapes whose labels the fit was given are left out.  The last progress has the
    figures as ``state``, ready for JSON (see ``shapeforge.validation.family``); ``undone`` among them says what could
    not be measured yet.  Raises :class:`StageError` when a
    file cannot be used or no truth is given.
    """
    from shapeforge.validation.family import validate_family

    if labels is None and landmarks is None and classes is None:
        raise StageError("nothing to compare with: give --labels DIR, --landmarks FILE or --classes FILE")
    true_marks = None if landmarks is None else read_landmarks(Path(landmarks))
    true_classes = None if classes is None else read_classes(Path(classes))
    yield from refresh(project, ("fit", "learn"), jobs=jobs, wanted_by="validate", optional=("learn",))
    names, parts = project.fit_names, fitted_part_names(project)
    for file, known in ((landmarks, true_marks), (classes, true_classes)):
        if known is not None and not set(known) & set(names):
            got = ", ".join(list(known)[:3]) or "none"
            raise StageError(f"{file}: wanted shapes of {project.path} (e.g. {names[0]}), got {got}.")
    truth: dict[str, np.ndarray] | None = None
    truth_parts = PartNames((), ())
    if labels is not None:
        truth_parts = _part_names_of(Path(labels))
        truth = {}
        for name in names:
            problem = None
            file = Path(labels) / f"{name}.seg"
            if file.is_file():
                try:
                    truth[name] = read_seg(file, project.shape_record(name)["n_faces"], truth_parts)
                except LabelError as error:
                    problem = Problem(str(file), "error", f"wanted {error.wanted}, got {error.got}", error.cause)
            if problem is not None:
                yield Progress("validate", "read", len(truth), len(names), str(problem), problem=problem)
        if not truth:
            raise StageError(f"{labels}: no .seg file in it fits a shape of the project (e.g. {names[0]}.seg)")
    found = project.descriptors()
    undone = None
    if true_classes is not None and found is None:
        undone = f"classes need descriptors. Learn first: shapeforge learn {project.path}"
        if truth is None and true_marks is None:
            raise StageError(undone)
        true_classes = None

    @lru_cache(maxsize=32)
    def mesh_of(name: str) -> Mesh:
        shape = project.shapes.named(name)
        return shape.mesh.moved(shape.frame.to_input(shape.mesh.vertices))

    predicted = {name: project.face_labels(name) for name in names}
    points = {name: project.shapes.named(name).frame.to_input(project.positions(name)) for name in names}
    evidence = [name for name in project.labelled if name in names]
    part_names, matched = parts.names, None
    if truth is not None and starts_from_proposal(project):
        part_names, matched = _matched(mesh_of, predicted, truth, parts.names, truth_parts.names)
    baseline: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    if truth is not None or true_marks is not None:
        for step, (name, faces, positions) in enumerate(_affine_transfer(project, jobs)):
            baseline[name] = faces, positions
            yield Progress("validate", "affine transfer", step + 1, len(names), name)
    figures = validate_family(
        mesh_of, rng=np.random.default_rng(seed), part_names=part_names, predicted=predicted, truth=truth,
        truth_part_names=truth_parts.names, landmarks=true_marks, points=points, classes=true_classes,
        descriptors=None if found is None else dict(zip(found[0], found[1], strict=True)), evidence=evidence,
        baseline_faces={name: faces for name, (faces, _) in baseline.items()} or None,
        baseline_points={name: positions for name, (_, positions) in baseline.items()} or None,
    )  # fmt: skip
    if undone is not None:
        figures["undone"] = undone
    if matched is not None:
        figures["proposed_parts_are"] = matched
    text = f"compared with truth without {counted(len(evidence), 'shape')} that gave evidence"
    yield Progress("validate", "done", 1, 1, text, state=figures)


def _affine_transfer(project: Project, jobs: int | None) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Per shape: name, labels (n_faces,) and corresponding points (K, 3, input coordinates) of the plain baseline.

    It sees what the fit saw: the labels of the exemplars, or the proposed parts where it started from these.
    """
    from shapeforge.validation.transfer import affine_transfer, reference_points

    names, labelled = project.fit_names, list(project.labelled)
    groups = project.groups
    exemplars = [project.names[t] for t in groups.exemplars] if groups is not None else []
    proposal = read_proposal(project) if starts_from_proposal(project) else None
    known = exemplars
    if proposal is None:
        known = [name for name in exemplars if name in labelled] or labelled
    shapes = [project.shapes.named(name) for name in known]
    faces = [
        project.labels(name)
        if proposal is None
        else _faces_of(shape, proposal.segmentation[project.index(name)], project.labels(name))
        for name, shape in zip(known, shapes, strict=True)
    ]
    references = reference_points(shapes)
    workers = Workers(jobs)
    try:
        for name, result in zip(
            names,
            workers.map(lambda name: affine_transfer(project.shapes.named(name), shapes, faces, references), names),
            strict=True,
        ):
            yield name, result.faces, project.shapes.named(name).frame.to_input(result.positions)
    finally:
        workers.close()


def _faces_of(shape: Any, segmentation: np.ndarray, painted: np.ndarray | None) -> np.ndarray:
    """Part per face record (n_faces,): the one painted, else by the votes of the face's own samples, else -1."""
    votes = np.zeros((shape.mesh.n_faces, segmentation.shape[1]))
    np.add.at(votes, shape.face_of_point, segmentation)
    faces = np.where(votes.sum(axis=1) > 0, votes.argmax(axis=1), -1).astype(np.int32)
    return faces if painted is None else np.where(painted >= 0, painted, faces).astype(np.int32)


def _matched(
    mesh_of: Any, predicted: Mapping[str, Any], truth: Mapping[str, Any], names: tuple[str, ...],
    truth_names: tuple[str, ...],
) -> tuple[tuple[str, ...], dict[str, str]]:  # fmt: skip
    """Proposed parts have no names: each is called like the true part that it shares most area with."""
    shared = np.zeros((len(names), len(truth_names)))
    for name, labels in truth.items():
        both = (labels >= 0) & (predicted[name] >= 0)
        np.add.at(shared, (predicted[name][both], labels[both]), mesh_of(name).face_areas[both])
    called = tuple(truth_names[i] for i in shared.argmax(axis=1))
    return called, dict(zip(names, called, strict=True))


def _part_names_of(folder: Path) -> PartNames:
    try:
        return find_part_names(folder)
    except LabelError as error:
        raise StageError(str(error)) from error


def read_landmarks(path: Path) -> dict[str, dict[str, np.ndarray]]:
    """``landmarks.json``: {shape: {landmark: [x, y, z]}}; :class:`StageError` when it is something else."""
    wanted = "wanted {shape: {landmark: [x, y, z]}}"
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:
        raise StageError(f"{path}: cannot be read ({error}). Name a landmarks.json.") from error
    if not isinstance(content, dict):
        raise StageError(f"{path}: {wanted}, got a {type(content).__name__}.")
    found: dict[str, dict[str, np.ndarray]] = {}
    for shape, marks in content.items():
        if not isinstance(marks, dict):
            raise StageError(f"{path}: {wanted}, got a {type(marks).__name__} for {shape}.")
        found[shape] = {}
        for mark, place in marks.items():
            try:
                position = np.asarray(place, np.float64)
            except (TypeError, ValueError):
                position = np.zeros(0)
            if position.shape != (3,) or not np.isfinite(position).all():
                raise StageError(f"{path}: wanted three finite numbers for {mark} of {shape}, got {place!r}.")
            found[shape][mark] = position
    return found


def read_classes(path: Path) -> dict[str, str]:
    """``classes.csv`` with the columns name and class; :class:`StageError` when it is something else."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StageError(f"{path}: cannot be read ({error}). Name a classes.csv.") from error
    if not rows or not {"name", "class"} <= set(rows[0]):
        got = ", ".join(rows[0]) if rows else "no rows"
        raise StageError(f"{path}: wanted a table with the columns name and class, got {got}.")
    return {row["name"]: row["class"] for row in rows if row["name"] and row["class"]}


def table(figures: Mapping[str, Any]) -> str:
    """The figures of :func:`validate` as plain text, ours beside the baseline."""
    from shapeforge.validation.statistics import format_table

    rows: list[tuple[str, str, str, str]] = []

    def add(what: str, ours: Any, theirs: Any, n: str) -> None:
        rows.append((what, _shown(ours), _shown(theirs), n))

    segmentation, correspondence = figures.get("segmentation"), figures.get("correspondence")
    if segmentation:
        theirs = segmentation.get("affine_transfer", {})
        for key, words in (("faces", "faces"), ("area", "area"), ("part_iou", "part IoU")):
            add(words, segmentation.get(key), theirs.get(key), counted(segmentation["n"], "shape"))
    if correspondence:
        theirs = correspondence.get("affine_transfer", {}).get("corr", {})
        for radius in RADII_SHOWN:
            n = f"{counted(correspondence['n'], 'landmark')} of {counted(correspondence['n_pairs'], 'pair')}"
            add(f"corr@{radius}", correspondence["corr"].get(radius), theirs.get(radius), n)
    classification = figures.get("classification")
    if classification:
        add("fine classes, 1-NN", classification.get("accuracy"), None, counted(classification["n"], "shape"))
    lines = [format_table(("measure", "ours", "affine transfer", "n"), rows)]
    left_out = figures.get("left_out") or []
    if left_out:
        lines.append(f"left out, as they gave evidence: {', '.join(left_out)}")
    for proposed, true in (figures.get("proposed_parts_are") or {}).items():
        lines.append(f"{proposed} is taken as {true}, with which it shares most area")
    return "\n".join(lines)


def _shown(value: Any) -> str:
    return "–" if value is None else f"{value:.3f}"
