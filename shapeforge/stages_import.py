"""The stage that reads meshes into a project: check, orient, sample and describe; what is there already stays."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.collection.counts import counted, grouped
from shapeforge.collection.labels import write_seg
from shapeforge.stages import Progress, StageError, Task
from shapeforge.stages_pose import BY_HAND, settle_poses, turned_key
from shapeforge.store import Problem, Project, ProjectError, key_of
from shapeforge.store_arrays import copy_file

TEMPORARY = re.compile(r"\.tmp-[0-9]+-[0-9a-f]{6}$")
SECONDS_BETWEEN_SAVES = 2.0
"""The list of shapes is written at most so often during an import: a kill costs no more work than this."""


@dataclass(frozen=True)
class Reading:
    """A file to import: the shape's name, where to read it, where it came from, what its result will be filed under.

    ``stamp`` is size and time of change of the source when it was as in ``sha256``; ``by_hand`` is how the user turned
    the shape (see ``stages_pose.turn_by_hand``), None where nobody did.
    """

    name: str
    file: Path
    source: Path
    sha256: str
    key: str
    stamp: tuple[int, int]
    by_hand: Mapping[str, Any] | None = None


def import_meshes(task: Task) -> Iterator[Progress]:
    """Read, check, orient, sample and describe meshes (``meshes``: files and folders, None: those read before).

    A file that cannot be read is reported and skipped.  Shapes that are there already, from the same bytes and by the
    same options, are not read again; a changed file is.  Of files that are gone the project's copies are taken.
    """
    from shapeforge.collection.meshes import MeshError, find_meshes

    project, given = task.project, task.arguments["meshes"]
    try:
        found = find_meshes([given] if isinstance(given, str | Path) else list(given)) if given else []
    except MeshError as error:
        raise StageError(str(error)) from error
    if not found and not project.names:
        raise StageError(f"meshes: wanted files or folders to import into {project.path}, got none")
    _sweep(project)
    named = _named(project, found)
    readings, kept, failed = _plan(task, named)
    total = len(readings) + len(kept)
    problems: list[Problem] = list(failed)
    for problem in failed:
        yield task.progress("read", 0, total, str(problem), problem=problem)
    if kept and readings:
        yield task.progress("read", len(kept), total, f"{counted(len(kept), 'shape')} there already")
    records: dict[str, dict[str, Any]] = {}
    records_read, saved = set(), time.monotonic()
    results = task.workers.map(lambda reading: _import_one(project, reading, task.options), readings)
    for step, (reading, (record, found_problems, error)) in enumerate(zip(readings, results, strict=True), len(kept)):
        problems += found_problems
        if error is not None:
            project.log(f"import: {reading.source}", error)
        if record is not None:
            records[reading.name] = record
            records_read.add(reading.name)
        if time.monotonic() - saved > SECONDS_BETWEEN_SAVES:
            project.add_shapes(records)
            records, saved = {}, time.monotonic()
        message = f"{reading.name}: {counted(record['n_faces'], 'face')}" if record else str(found_problems[0])
        problem = Problem.together(found_problems) if found_problems else None
        yield task.progress("read", step + 1, total, message, problem=problem)
    project.add_shapes(records)
    about = [str(reading.source) for reading in readings] + [problem.file for problem in failed]
    about += [old.file for old in project.problems if old.kind == "error" and not Path(old.file).exists()]
    project.set_problems(problems, about)
    yield from settle_poses(task)
    errors = sum(problem.kind == "error" for problem in problems)
    text = counted(len(project.names), "shape") + (f", {counted(errors, 'file')} not read" if errors else "")
    task.summary |= {
        "text": text,
        "shapes": len(project.names),
        "read": len(records_read),
        "kept": len(kept),
        "not_read": errors,
    }
    if not project.names:
        raise StageError(f"none of the {errors} files could be read: {problems[0]}")
    given_names = {name for name, _ in named}
    if named and not given_names & {*kept, *records_read}:
        raise StageError(f"nothing new was read: {problems[0]}")
    yield task.progress("read", total, total, text)


def _sweep(project: Project) -> None:
    """Delete the half-written files that a killed import left."""
    for folder in (project.path / "meshes", project.path / "shapes"):
        for file in folder.iterdir() if folder.is_dir() else ():
            if TEMPORARY.search(file.name):
                file.unlink(missing_ok=True)


def _named(project: Project, found: Sequence[tuple[str, Path]]) -> list[tuple[str, Path]]:
    """Names for the files found: a file keeps the name it has; a second file of that name gets its folders before.

    A name whose file is gone is free: a collection that was moved is still the same collection.
    """
    source_of = {name: project.shape_record(name)["source"] for name in project.names}
    name_of = {source: name for name, source in source_of.items()}
    taken = {name for name, source in source_of.items() if Path(source).exists()}
    named = []
    for name, path in found:
        source = path.resolve()
        if str(source) in name_of:
            name = name_of[str(source)]
        elif name in taken:
            folders = source.parent.parts[1:]
            longer = ["__".join([*folders[-depth:], source.stem]) for depth in range(1, len(folders) + 1)]
            others = taken | {other for other, _ in found}
            name = next((word for word in longer if word not in others), "__".join([*folders, source.name]))
        taken.add(name)
        named.append((name, path))
    return named


def _plan(task: Task, found: Sequence[tuple[str, Path]]) -> tuple[list[Reading], list[str], list[Problem]]:
    """What to read (files given, and shapes whose options changed), what stays, and files that cannot be opened."""
    project, readings, kept, failed = task.project, [], [], []
    given = set()
    for name, path in found:
        source = path.resolve()
        try:
            stamp, sha256 = _stamp_and_digest(path)
        except OSError as error:
            reason = f"cannot be opened ({error.strerror or error})"
            failed.append(Problem(str(source), "error", reason, "Check the path and its permissions"))
            continue
        given.add(name)
        readings.append(_reading(task, name, path, source, sha256, stamp))
    readings += [_reading_again(task, name, changed=not found) for name in project.names if name not in given]
    wanted = []
    for reading in readings:
        known = reading.name in project.names and project.shape_record(reading.name)["key"] == reading.key
        if known and not task.restart and project.shape_path(reading.name).is_file():
            kept.append(reading.name)
        else:
            wanted.append(reading)
    return wanted, kept, failed


def _reading_again(task: Task, name: str, *, changed: bool) -> Reading:
    """What to read of a shape whose file was not given: the file, if it is as it was or ``changed`` ones are wanted,
    else the project's copy, which keeps the stamp of what it is a copy of: that the file changed can still be seen."""
    record = task.project.shape_record(name)
    source = Path(record["source"])
    try:
        stamp, sha256 = _stamp_and_digest(source)
    except OSError:  # gone, or not to be opened
        sha256 = None
    if sha256 is not None and (changed or sha256 == record["sha256"]):
        return _reading(task, name, source, source, sha256, stamp)
    stamp = record["size"], record["modified"]
    return _reading(task, name, task.project.mesh_path(name), source, record["sha256"], stamp)


def _stamp_and_digest(path: Path) -> tuple[tuple[int, int], str]:
    """(size, time of change) and SHA-256 of a file; ``OSError`` where there is none."""
    if path.exists() and not path.is_file():  # reading a pipe or a device might never end
        raise OSError("it is no ordinary file")
    found = path.stat()  # first: a change that comes in between is seen at the next look
    return (found.st_size, found.st_mtime_ns), hashlib.sha256(path.read_bytes()).hexdigest()


def _reading(task: Task, name: str, file: Path, source: Path, sha256: str, stamp: tuple[int, int]) -> Reading:
    """What to read, turned as the user turned the same bytes under the same ``up``: what was said last counts."""
    record = task.project.shape_record(name) if name in task.project.names else {}
    by_hand = record.get("by_hand")
    if by_hand is not None and (record["sha256"] != sha256 or by_hand["up"] != task.options["up"]):
        by_hand = None
    key = key_of(sha256, {name: task.options[name] for name in ("points", "up", "seed")})
    return Reading(name, file, source, sha256, key if by_hand is None else turned_key(key, by_hand), stamp, by_hand)


def _import_one(
    project: Project, reading: Reading, options: Mapping[str, Any]
) -> tuple[dict[str, Any] | None, list[Problem], BaseException | None]:
    """Prepare and write one shape; its record, what is odd about it, and the error if it could not be read."""
    from shapeforge.collection.meshes import MeshError, read_mesh, repair_notes, too_little
    from shapeforge.collection.prepare import prepare_shape, turned

    source = str(reading.source)
    try:
        mesh = read_mesh(reading.file)
        rng = np.random.default_rng([int(options["seed"]), int(reading.sha256[:15], 16)])
        shape = prepare_shape(reading.name, mesh, n_points=int(options["points"]), up=options["up"], rng=rng)
        if reading.by_hand is not None:
            shape = turned(shape, np.array(reading.by_hand["rotation"]), BY_HAND)
        doubts, little = list(repair_notes(mesh)), too_little(mesh)
    except MeshError as error:
        return None, [Problem(source, "error", error.problem, error.remedy)], error
    except (ValueError, ArithmeticError, MemoryError, IndexError) as error:
        remedy = "Repair it in a mesh editor; the project's log has the details"
        return None, [Problem(source, "error", f"cannot be prepared ({error})", remedy)], error
    if any(character in reading.name for character in "/\\\0"):
        raise ProjectError(source, "has a name that cannot be a file's", "Rename it")
    warnings = [Problem(source, "warning", doubt) for doubt in doubts]
    warnings += [Problem(source, "warning", little, "Check that the file holds the whole shape")] if little else []
    warnings += _labels_set_aside(project, reading, mesh.n_faces)
    copy = Path("meshes") / f"{reading.name}{reading.file.suffix.lower()}"
    if reading.file != project.path / copy:
        copy_file(reading.file, project.path / copy)
    project.save_shape(shape, reading.key)
    size, modified = reading.stamp
    record = {
        "file": str(copy), "source": source, "sha256": reading.sha256, "key": reading.key,
        "modified": modified, "size": size,
        "n_faces": int(mesh.n_faces), "n_triangles": len(mesh.triangles), "notes": list(shape.notes),
        "pose": "open" if options["up"] == "auto" and reading.by_hand is None else "settled",
    }  # fmt: skip
    if reading.by_hand is not None:
        record["by_hand"] = dict(reading.by_hand)
    return record, warnings, None


def _labels_set_aside(project: Project, reading: Reading, n_faces: int) -> list[Problem]:
    """Keep the labels of a shape that is about to have ``n_faces`` faces, which they do not fit, beside their mesh.

    They are written as a ``.seg`` file, before the copy of the mesh is replaced; a warning that says where.
    """
    name, source = reading.name, str(reading.source)
    record = project.shape_record(name) if name in project.names else {}
    parts, key = project.part_names, project.label_key(name)
    if key is None or parts is None or record.get("n_faces", n_faces) == n_faces:
        return []
    reason = f"it had {counted(record['n_faces'], 'face')} and now has {grouped(n_faces)}: "
    reason += f"the labels of {name} no longer fit and were taken away"
    try:
        faces = project.labels(name)
    except ProjectError:  # damaged: there is nothing to keep
        return [Problem(source, "warning", reason, "Label it again")]
    old = project.mesh_path(name)
    place = project.path / "meshes" / "before" / f"{name}-{key[:8]}{old.suffix}"
    place.parent.mkdir(parents=True, exist_ok=True)
    if old.is_file() and not place.is_file():  # after a kill it may be the new mesh that lies there
        copy_file(old, place)
    write_seg(place.with_name(f"{name}-{key[:8]}.seg"), faces, parts)
    remedy = f"They are kept in {place.parent / place.stem}.seg, beside the mesh that they fit"
    return [Problem(source, "warning", reason, remedy)]
