"""A project on disk: a folder that any of its readers may open at any time, and one process may write.

::

    project.json                 version, names, problems, part names, what each stage did with which options
    shapeforge.log               what happened when, with the tracebacks the command line hides
    meshes/<name>.<ext>          copies of the input files; before/…: those whose labels no longer fit, and the labels
    shapes/<name>.zarr.zip       one prepared shape: mesh, samples, descriptors, patches (zarr v3 in a zip)
    labels/<name>/<key>.zarr.zip part of every face record, as given or painted; history/…: the strokes that led to it
    groups.zarr.zip              groups and exemplars
    <stage>/<key>/…              results of the fit and of everything after it, by the key of what they came from

Every file is written beside its place and renamed into it.  Metadata is JSON, arrays are zarr, nothing is unpickled.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import difflib
import hashlib
import json
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shapeforge.collection.groups import Groups
from shapeforge.collection.shape import Shape
from shapeforge.store_arrays import ProjectError, key_of, read_json, read_record, write_record, write_text
from shapeforge.store_labels import Labels
from shapeforge.store_lock import WriterLock
from shapeforge.store_results import Results

__all__ = ["FORMAT_VERSION", "Problem", "Project", "ProjectError", "StoredShapes", "key_of"]

FORMAT_VERSION = 1
SHAPES_IN_MEMORY = 256 << 20
"""Bytes of prepared shapes kept in memory; the shape used longest ago goes first."""
NAMES_SAID = 5
"""Names of shapes in a message, at most."""
_METADATA = {"name": str, "shapes": dict, "problems": list, "labels": dict, "stages": dict}
_SHAPE_RECORD = {"file", "source", "sha256", "key", "modified", "size", "n_faces"}
_OWN_FILES = {"project.json", "shapeforge.log", "lock", "meshes", "shapes", "labels"}


@dataclasses.dataclass(frozen=True)
class Problem:
    """Something about one input file: ``error`` (it is not in the project) or ``warning`` (it is, but doubtful)."""

    file: str
    kind: Literal["error", "warning"]
    reason: str
    remedy: str = ""

    def __str__(self) -> str:
        text = f"{self.file}: {self.reason.rstrip('.')}."
        return f"{text} {self.remedy.rstrip('.')}{'' if self.remedy.endswith('?') else '.'}" if self.remedy else text

    @classmethod
    def together(cls, problems: Sequence[Problem]) -> Problem:
        """All that is to be said about one file, in one: reasons and remedies one after the other."""
        reason = "; ".join(problem.reason.rstrip(".") for problem in problems)
        remedy = ". ".join(dict.fromkeys(problem.remedy.rstrip(".") for problem in problems if problem.remedy))
        return cls(problems[0].file, problems[0].kind, reason, remedy)


class StoredShapes(Sequence):
    """The prepared shapes of a project, read one at a time; the most recently used stay in memory."""

    def __init__(self, project: Project, capacity: int = SHAPES_IN_MEMORY) -> None:
        self._project, self._capacity = project, capacity
        self._kept: OrderedDict[str, tuple[str, Shape, int]] = OrderedDict()
        self._mutex = threading.Lock()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shapes, in order."""
        return self._project.names

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> Shape:
        """Shape number ``index`` (negative counts from the end); ``IndexError`` when there is none."""
        return self.named(self.names[index])

    def __iter__(self) -> Iterator[Shape]:
        return (self.named(name) for name in self.names)

    def named(self, name: str) -> Shape:
        """The shape called ``name``; :class:`ProjectError` when there is none or its file is damaged."""
        key = self._project.shape_record(name)["key"]
        with self._mutex:
            found = self._kept.get(name)
            if found is not None and found[0] == key:
                self._kept.move_to_end(name)
                return found[1]
        path = self._project.shape_path(name)
        try:
            shape, _ = read_record(path)
        except ProjectError as error:
            read_again = f"Delete it if it is there and read the mesh again: shapeforge import {self._project.path}"
            raise ProjectError(path, error.problem, read_again) from error
        size = sum(array.nbytes for array in vars(shape).values() if isinstance(array, np.ndarray))
        size += shape.mesh.vertices.nbytes + 9 * shape.mesh.triangles.nbytes  # with what the mesh caches
        with self._mutex:
            self._kept[name] = (key, shape, size)
            while sum(entry[2] for entry in self._kept.values()) > self._capacity and len(self._kept) > 1:
                self._kept.popitem(last=False)
        return shape

    def forget(self, name: str) -> None:
        """Read the shape called ``name`` anew the next time: its file was written, under whatever key."""
        with self._mutex:
            self._kept.pop(name, None)


class Project(Labels, Results):
    """A project folder.  Reading needs no lock; whatever writes takes it (see :meth:`writing`)."""

    def __init__(self, path: Path, metadata: dict[str, Any]) -> None:
        self.path = path
        self._metadata = metadata
        self._mutex = threading.RLock()
        self._lock = WriterLock(path / "lock")
        self.shapes = StoredShapes(self)

    @classmethod
    def create(cls, path: str | Path) -> Project:
        """Make a new project in an absent or empty folder; :class:`ProjectError` when something else is there."""
        path = Path(path)
        if (path / "project.json").exists():
            raise ProjectError(path, "is a project already", "Open it, or name another folder")
        if path.exists() and not path.is_dir():
            raise ProjectError(path, "is a file, a project is a folder", "Name another folder")
        if path.is_dir() and any(entry.name not in _OWN_FILES for entry in path.iterdir()):
            raise ProjectError(path, "has other files in it", "Name a new or an empty folder")
        metadata = {"format": "shapeforge project", "version": FORMAT_VERSION, "name": path.resolve().name}
        metadata |= {"shapes": {}, "problems": [], "part_names": None, "labels": {}, "groups": None, "stages": {}}
        project = cls(path, metadata)
        write_text(path / "project.json", json.dumps(metadata, indent=1))
        return project

    def unrefined(self) -> Project:
        """The same project, to be read as if ``refine`` had never been run: what it starts from, however often."""
        seen = copy.copy(self)
        seen.heeds_refine = False
        return seen

    @classmethod
    def open(cls, path: str | Path) -> Project:
        """Open a project folder; :class:`ProjectError` names what is wrong and the remedy."""
        path = Path(path)
        if not path.exists():
            raise ProjectError(path, "does not exist", f"Make it: shapeforge import {path} MESHES")
        if not (path / "project.json").is_file():
            raise ProjectError(path, "is not a shapeforge project (no project.json)", "Name a project's folder")
        return cls(path, _read_metadata(path))

    @classmethod
    def open_or_create(cls, path: str | Path) -> Project:
        """Open the project, or make it when there is none yet."""
        return cls.open(path) if (Path(path) / "project.json").exists() else cls.create(path)

    @property
    def name(self) -> str:
        """Name of the project: its folder's when it was made."""
        return self._metadata["name"]

    # -- writing ---------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the project for writing; :class:`ProjectError` while another process (or object) writes it."""
        if self._lock.acquire():
            try:
                with self._mutex:
                    self._metadata = _read_metadata(self.path)  # another process may have written since
            except BaseException:
                self._lock.release()
                raise
        try:
            yield
        finally:
            self._lock.release()

    @contextlib.contextmanager
    def _changing(self) -> Iterator[dict[str, Any]]:
        """Change a copy of the metadata; it counts once it is on disk."""
        with self.writing(), self._mutex:
            changed = json.loads(json.dumps(self._metadata))
            yield changed
            write_text(self.path / "project.json", json.dumps(changed, indent=1))
            self._metadata = changed

    def log(self, text: str, error: BaseException | None = None) -> None:
        """Add a line (and the traceback of ``error``) to ``shapeforge.log``; a full disk loses only the line."""
        stamp = time.strftime("%Y-%m-%d %H:%M:%S")
        lines = [f"{stamp} {text}"] + (traceback.format_exception(error) if error else [])
        with contextlib.suppress(OSError), open(self.path / "shapeforge.log", "a", encoding="utf-8") as file:
            file.write("\n".join(line.rstrip("\n") for line in lines) + "\n")

    # -- shapes ----------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shapes, sorted: the order does not depend on when each was imported."""
        return tuple(sorted(self._metadata["shapes"]))

    def index(self, name: str) -> int:
        """Number of the shape called ``name``; :class:`ProjectError` when there is none."""
        self.shape_record(name)
        return self.names.index(name)

    def shape_record(self, name: str) -> dict[str, Any]:
        """What is known of a shape without reading it: key, file, source, n_faces, n_triangles, notes."""
        try:
            return self._metadata["shapes"][name]
        except KeyError:
            raise ProjectError(self.path, f"has no shape {name!r}", self.names_near(name)) from None

    def names_near(self, name: str) -> str:
        """What shapes there are, in words: those called much like ``name``, where there are many."""
        near = difflib.get_close_matches(name, self.names, n=NAMES_SAID) if len(self.names) > NAMES_SAID else []
        if near:
            return f"Called much like it: {', '.join(near)}"
        known = ", ".join(self.names[:NAMES_SAID]) + (", …" if len(self.names) > NAMES_SAID else "")
        return f"Its shapes: {known or 'none yet'}"

    def shape_path(self, name: str) -> Path:
        """Where the prepared shape lies."""
        return self.path / "shapes" / f"{name}.zarr.zip"

    def mesh_path(self, name: str) -> Path:
        """The project's copy of the shape's input file."""
        return self.path / self.shape_record(name)["file"]

    def changed_sources(self) -> list[str]:
        """Names of the shapes whose input file, where it still exists, is no longer as it was read."""
        changed = []
        for name in self.names:
            record = self.shape_record(name)
            source = Path(record["source"])
            with contextlib.suppress(OSError):
                stamp = source.stat()
                if (stamp.st_size, stamp.st_mtime_ns) != (record["size"], record["modified"]):
                    if hashlib.sha256(source.read_bytes()).hexdigest() != record["sha256"]:
                        changed.append(name)
        return changed

    def save_shape(self, shape: Shape, key: str) -> None:
        """Write one prepared shape; it joins the project with :meth:`add_shapes`."""
        write_record(self.shape_path(shape.name), shape, {"key": key})
        # one that the family's vote turns keeps its key, so that importing its file again finds nothing to do
        self.shapes.forget(shape.name)

    def add_shapes(self, records: Mapping[str, Mapping[str, Any]]) -> None:
        """Add (or replace) shapes whose arrays are written; labels of another number of faces are dropped."""
        with self._changing() as metadata:
            for name, record in records.items():
                old = metadata["shapes"].get(name)
                if old is not None and old["n_faces"] != record["n_faces"]:
                    metadata["labels"].pop(name, None)
                metadata["shapes"][name] = dict(record)

    def remove_shapes(self, names: Sequence[str]) -> None:
        """Take shapes out of the project (their mesh copies and arrays are deleted)."""
        files = [path for name in names for path in (self.mesh_path(name), self.shape_path(name))]
        with self._changing() as metadata:
            for name in names:
                del metadata["shapes"][name]
                metadata["labels"].pop(name, None)
        for path in files:
            path.unlink(missing_ok=True)

    @property
    def problems(self) -> list[Problem]:
        """Files not read, and files that are doubtful, each with reason and remedy."""
        return [Problem(**problem) for problem in self._metadata["problems"]]

    def set_problems(self, problems: Sequence[Problem], about: Sequence[str]) -> None:
        """Replace all problems of the files ``about`` by ``problems``."""
        with self._changing() as metadata:
            kept = [problem for problem in metadata["problems"] if problem["file"] not in set(about)]
            metadata["problems"] = kept + [dataclasses.asdict(problem) for problem in problems]

    # -- groups ----------------------------------------------------------------------------------------------------

    @property
    def groups(self) -> Groups | None:
        """Groups and exemplars, for the shapes of now: shapes added since have group -1.  None before grouping."""
        path = self.path / "groups.zarr.zip"
        if self._metadata["groups"] is None or not path.is_file():
            return None
        try:
            groups, attributes = read_record(path)
        except ProjectError as error:
            remedy = f"Delete it and group again: shapeforge group {self.path}"
            raise ProjectError(path, error.problem, remedy) from error
        about = tuple(attributes["shapes"])
        return groups if about == self.names else _regrouped(groups, about, self.names)

    @property
    def groups_key(self) -> str | None:
        """Key of groups and exemplars, None before grouping."""
        return self._metadata["groups"]

    @property
    def ungrouped_names(self) -> tuple[str, ...]:
        """Names of the shapes that came after the groups were made (those left out by hand are not among them)."""
        path = self.path / "groups.zarr.zip"
        known = set(read_record(path)[1]["shapes"]) if self.groups is not None else set()
        return tuple(name for name in self.names if name not in known)

    @property
    def grouped_by_hand(self) -> bool:
        """Whether somebody changed the groups or the exemplars after they were found."""
        return self.groups_key is not None and bool(self._metadata.get("grouped_by_hand", False))

    def set_groups(self, groups: Groups, *, by_hand: bool = False) -> None:
        """Replace the groups; ``ValueError`` when they are about another number of shapes."""
        names = self.names
        if len(groups.group) != len(names):
            raise ValueError(f"groups: wanted a group for each of {len(names)} shapes, got {len(groups.group)}")
        with self.writing():
            write_record(self.path / "groups.zarr.zip", groups, {"shapes": list(names)})
            with self._changing() as metadata:
                metadata["groups"] = key_of(list(names), groups.group, groups.exemplars)
                metadata["grouped_by_hand"] = by_hand

    # -- what the stages did ---------------------------------------------------------------------------------------

    @property
    def stage_records(self) -> dict[str, dict[str, Any]]:
        """Stage -> key, options, state ("partial" or "done"), finished, summary."""
        return json.loads(json.dumps(self._metadata["stages"]))

    def stage_record(self, stage: str) -> dict[str, Any] | None:
        """The record of one stage, None when it was never run."""
        record = self._metadata["stages"].get(stage)
        return dict(record) if record else None

    def set_stage_record(self, stage: str, record: Mapping[str, Any] | None) -> None:
        """Write down what a stage did; None forgets it."""
        with self._changing() as metadata:
            metadata["stages"].pop(stage, None)
            if record is not None:
                metadata["stages"][stage] = dict(record)


def _read_metadata(path: Path) -> dict[str, Any]:
    metadata = read_json(path / "project.json")
    if not isinstance(metadata, dict) or metadata.get("format") != "shapeforge project":
        raise ProjectError(path, "project.json is not a shapeforge project's", "Name a project's folder")
    if metadata.get("version") != FORMAT_VERSION:
        problem = f"has format version {metadata.get('version')}, this shapeforge reads {FORMAT_VERSION}"
        raise ProjectError(path, problem, "Update shapeforge, or import the meshes into a new project")
    wrong = [name for name, kind in _METADATA.items() if not isinstance(metadata.get(name), kind)]
    shapes = metadata["shapes"].values() if not wrong else ()
    if wrong or any(not isinstance(record, dict) or not record.keys() >= _SHAPE_RECORD for record in shapes):
        problem = f"is incomplete ({wrong[0] if wrong else 'a shape'} is not as it was written)"
        remedy = "Restore it from a copy, or import the meshes into a new project"
        raise ProjectError(path / "project.json", problem, remedy)
    return metadata


def _regrouped(groups: Groups, about: tuple[str, ...], names: tuple[str, ...]) -> Groups:
    """The same groups for other shapes: new ones belong to none; groups whose exemplar is gone are dissolved."""
    where = {name: t for t, name in enumerate(about)}
    now = {name: t for t, name in enumerate(names)}
    kept = [g for g, exemplar in enumerate(groups.exemplars) if about[exemplar] in now]
    renumber = {g: i for i, g in enumerate(kept)}
    group = [renumber.get(int(groups.group[where[name]]), -1) if name in where else -1 for name in names]
    embedding = np.zeros((len(names), 2), groups.embedding.dtype)
    for name in now.keys() & where.keys():
        embedding[now[name]] = groups.embedding[where[name]]
    exemplars = np.array([now[about[groups.exemplars[g]]] for g in kept], groups.exemplars.dtype)
    called = tuple(groups.names[g] for g in kept)
    return Groups(called, np.array(group, groups.group.dtype), exemplars, embedding)
