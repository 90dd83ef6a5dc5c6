"""Arrays on disk: one zarr v3 group in one zip file, written beside its place and renamed into it.

A reader sees the old file or the new one, never half of one; a killed writer leaves at most a file ``*.tmp-<pid>``.
:func:`encode` turns the records of the rooms (frozen dataclasses of arrays, tuples and dicts of them) into plain
arrays plus a JSON outline, :func:`decode` turns them back.  Only the classes of ``RECORD_CLASSES`` are ever built and
only numbers are read, so nothing loaded from a file executes code.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import importlib
import json
import os
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

RECORD_CLASSES: dict[str, str] = {
    "Frame": "shapeforge.collection.shape",
    "Mesh": "shapeforge.collection.shape",
    "Shape": "shapeforge.collection.shape",
    "Groups": "shapeforge.collection.groups",
    "PartNames": "shapeforge.collection.labels",
    "PartTemplates": "shapeforge.deformation.templates",
    "Beliefs": "shapeforge.deformation.beliefs",
    "Covariances": "shapeforge.deformation.factors",
    "FitState": "shapeforge.deformation.fit",
    "Candidate": "shapeforge.deformation.exemplars",
    "Proposal": "shapeforge.deformation.boxes",
    "Link": "shapeforge.deformation.hierarchy",
    "Hierarchy": "shapeforge.deformation.hierarchy",
    "PartCounts": "shapeforge.deformation.components",
    "Observations": "shapeforge.generative.observations",
    "BetaShapeMachine": "shapeforge.generative.machine",
    "StructureMachine": "shapeforge.generative.structure",
    "LearnState": "shapeforge.generative.learning",
    "Latents": "shapeforge.generative.inference",
    "Mixture": "shapeforge.generative.draw",
    "Draw": "shapeforge.generative.draw",
    "Direction": "shapeforge.generative.units",
}
"""Records that may be stored, and the module each is defined in."""

_SMALLEST_CHUNK = 1 << 16
_REMEDIES = {
    errno.ENOSPC: "Free some disk space and run the same command again: what was saved before is still there",
    errno.EDQUOT: "Free some of your quota and run the same command again: what was saved before is still there",
    errno.EFBIG: "Allow larger files (ulimit -f) and run the same command again: what was saved before is still there",
    errno.EACCES: "Make the folder writable, or use a project in another place",
    errno.EPERM: "Make the folder writable, or use a project in another place",
    errno.EROFS: "The disk is read-only: use a project in another place",
    errno.ENOTDIR: "Name a folder: one part of this path is a file",
    errno.EEXIST: "Name a folder: one part of this path is a file",
    errno.ENOENT: "The folder was moved or deleted meanwhile: open the project at its new place",
}


class ProjectError(ValueError):
    """Something is wrong with a project folder; ``str`` is one sentence: PATH: problem. remedy."""

    def __init__(self, path: str | Path, problem: str, remedy: str) -> None:
        super().__init__(f"{path}: {problem}. {remedy}.")
        self.path, self.problem, self.remedy = Path(path), problem, remedy


@contextlib.contextmanager
def clear_disk_errors(path: Path) -> Iterator[None]:
    """Turn an ``OSError`` while ``path`` is written into a :class:`ProjectError` that says what to do."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        remedy = _REMEDIES.get(error.errno or 0, "Check the disk and run the same command again")
        raise ProjectError(path, f"cannot be written ({reason})", remedy) from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` to write to; on success it is flushed and renamed to ``path``.

    A link stays one: what it points to is replaced.  Raises :class:`ProjectError` for a full disk, missing rights and
    the like, and for what is no ordinary file (a device); ``path`` is then as it was.
    """
    if path.is_symlink():
        path = path.resolve()
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ProjectError(path, "is no ordinary file, which could be replaced", "Name another file")
    temporary = path.with_name(f"{path.name}.tmp-{os.getpid()}-{os.urandom(3).hex()}")
    with clear_disk_errors(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically (UTF-8)."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def copy_file(source: Path, path: Path) -> None:
    """Copy a file's bytes atomically."""
    with replacing(path) as temporary:
        shutil.copyfile(source, temporary)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any] | None = None) -> None:
    """Write named arrays (bool, integer or float) and JSON ``attributes`` as one zarr group in a zip, atomically."""
    import zarr
    from zarr.codecs import ZstdCodec
    from zarr.storage import ZipStore

    with replacing(path) as temporary:
        store = ZipStore(temporary, mode="w")
        try:
            group = zarr.create_group(store, attributes=dict(attributes or {}), zarr_format=3)
            for name, array in arrays.items():
                array = np.asarray(array)
                if array.dtype.kind not in "biuf":
                    raise TypeError(f"array {name!r}: wanted bool, integer or float, got dtype {array.dtype}")
                chunks = _chunks(array.shape)
                group.create_array(name, data=array, chunks=chunks, compressors=ZstdCodec(level=1))
        finally:
            _close(store)


def _close(store: Any) -> None:
    """Close a zip store; one that could not be opened has nothing to close and says so by an AttributeError."""
    with contextlib.suppress(AttributeError):
        store.close()


def _chunks(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Whole rows, as many as make a chunk of a reasonable size."""
    if not shape:
        return ()
    row = max(1, int(np.prod(shape[1:], dtype=np.int64)))
    rows = max(1, min(shape[0], max(1, (16 * _SMALLEST_CHUNK) // row)))
    return (rows, *(max(1, n) for n in shape[1:]))


def read_arrays(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and attributes of a file of :func:`write_arrays`; :class:`ProjectError` when it is damaged or missing."""
    import zarr
    from zarr.storage import ZipStore

    if not path.is_file():
        raise ProjectError(path, "is missing", "Run the stage that makes it again with --restart")
    try:
        store = ZipStore(path, mode="r")
        try:
            group = zarr.open_group(store, mode="r")
            arrays = {name: np.asarray(array[...], order="C") for name, array in group.arrays()}
            return {name: _native(array) for name, array in arrays.items()}, dict(group.attrs)
        finally:
            _close(store)
    except (zipfile.BadZipFile, KeyError, ValueError, FileNotFoundError, RuntimeError, OSError) as error:
        problem = f"is damaged ({type(error).__name__}: {error})"
        raise ProjectError(path, problem, "Delete it and run the stage that makes it again") from error


def _native(array: np.ndarray) -> np.ndarray:
    """The same numbers in this machine's byte order, with numpy's canonical dtype object."""
    return array.astype(np.dtype(array.dtype.kind + str(array.dtype.itemsize)), copy=False)


def write_record(path: Path, record: Any, attributes: Mapping[str, Any] | None = None) -> None:
    """Write a record of the rooms (see :func:`encode`) atomically, with JSON ``attributes`` beside it."""
    outline, arrays = encode(record)
    write_arrays(path, arrays, {**(attributes or {}), "outline": outline})


def read_record(path: Path) -> tuple[Any, dict[str, Any]]:
    """The record of :func:`write_record` and its attributes."""
    arrays, attributes = read_arrays(path)
    try:
        return decode(attributes.pop("outline"), arrays), attributes
    except (KeyError, TypeError) as error:
        problem = f"was written by another version of shapeforge ({error})"
        raise ProjectError(path, problem, "Run the stage that makes it again with --restart") from error


def encode(value: Any) -> tuple[Any, dict[str, np.ndarray]]:
    """Split a value into a JSON outline and plain arrays.

    Values: arrays, numbers, strings, None, dataclasses of ``RECORD_CLASSES``, and lists, tuples and string-keyed
    dicts of these.  A tuple of records of one class is stored by columns, rows of all of them in one array.
    """
    arrays: dict[str, np.ndarray] = {}
    return _encode(value, "", arrays), arrays


def _encode(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    if isinstance(value, np.generic):
        return {"value": value.item()}
    if isinstance(value, np.ndarray):
        name = name or "array"
        if value.dtype.kind == "U":
            return {"words": value.tolist()}
        arrays[name] = value
        return {"array": name}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}
        return {"record": _known(value), "fields": _encode_fields(fields, name, arrays)}
    if isinstance(value, Mapping):
        return {"dict": _encode_fields(value, name, arrays)}
    if isinstance(value, (list, tuple)):
        kind = "tuple" if isinstance(value, tuple) else "list"
        if kind == "tuple" and len(value) > 1 and not isinstance(value[0], (str, int, float)):
            found: dict[str, np.ndarray] = {}
            column = _encode_column(value, name, found)
            if column is not None:
                arrays.update(found)
                return {"column": column, "count": len(value)}
        return {kind: [_encode(item, f"{name}.{i}", arrays) for i, item in enumerate(value)]}
    raise TypeError(f"{name or 'value'}: cannot be stored (a {type(value).__name__})")


def _encode_fields(fields: Mapping[str, Any], name: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    return {key: _encode(item, f"{name}.{key}" if name else str(key), arrays) for key, item in fields.items()}


def _encode_column(values: Sequence[Any], name: str, arrays: dict[str, np.ndarray]) -> Any:
    """Many values of one kind as one column; None when they are not alike."""
    first = values[0] if values else None
    if all(item is None or isinstance(item, (bool, int, float, str, np.generic)) for item in values):
        return {"values": [item.item() if isinstance(item, np.generic) else item for item in values]}
    if all(isinstance(item, np.ndarray) and item.ndim > 0 for item in values):
        if len({(item.shape[1:], item.dtype) for item in values}) > 1 or first.dtype.kind not in "biuf":
            return None
        arrays[name] = np.concatenate(values)
        return {"rows": name, "lengths": [len(item) for item in values]}
    if all(isinstance(item, tuple) for item in values):
        items = _encode_column([item for row in values for item in row], name, arrays)
        return items and {"tuples": items, "lengths": [len(item) for item in values]}
    if dataclasses.is_dataclass(first) and all(type(item) is type(first) for item in values):
        columns = {}
        for field in dataclasses.fields(first):
            label = f"{name}.{field.name}" if name else field.name
            columns[field.name] = _encode_column([getattr(item, field.name) for item in values], label, arrays)
        return None if None in columns.values() else {"records": _known(first), "columns": columns}
    return None


def _known(record: Any) -> str:
    name = type(record).__name__
    if RECORD_CLASSES.get(name) != type(record).__module__:
        raise TypeError(f"{type(record).__module__}.{name} is not among the records that may be stored")
    return name


def decode(outline: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """The value that :func:`encode` split; ``KeyError`` or ``TypeError`` when the outline does not fit."""
    if "value" in outline:
        return outline["value"]
    if "array" in outline:
        return arrays[outline["array"]]
    if "words" in outline:
        return np.array(outline["words"], dtype=str)
    if "dict" in outline:
        return {key: decode(item, arrays) for key, item in outline["dict"].items()}
    if "list" in outline:
        return [decode(item, arrays) for item in outline["list"]]
    if "tuple" in outline:
        return tuple(decode(item, arrays) for item in outline["tuple"])
    if "record" in outline:
        fields = {key: decode(item, arrays) for key, item in outline["fields"].items()}
        return _class(outline["record"])(**fields)
    return tuple(_column(outline["column"], outline["count"], arrays))


def _column(column: Mapping[str, Any], count: int, arrays: Mapping[str, np.ndarray]) -> list[Any]:
    if "values" in column:
        return column["values"]
    if "records" in column:
        fields = {key: _column(item, count, arrays) for key, item in column["columns"].items()}
        cls = _class(column["records"])
        return [cls(**{key: values[i] for key, values in fields.items()}) for i in range(count)]
    ends = np.cumsum(column["lengths"], dtype=np.int64).tolist()
    items = arrays[column["rows"]] if "rows" in column else tuple(_column(column["tuples"], (ends or [0])[-1], arrays))
    return [items[end - length : end] for end, length in zip(ends, column["lengths"], strict=True)]


def _class(name: str) -> type:
    return getattr(importlib.import_module(RECORD_CLASSES[name]), name)


def key_of(*parts: Any) -> str:
    """A short hash of numbers, strings, arrays and JSON values: equal content, equal key."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif isinstance(part, bytes):
            digest.update(part)
        else:
            digest.update(json.dumps(part, sort_keys=True).encode())
        digest.update(b"\0")
    return digest.hexdigest()[:16]


def read_json(path: Path) -> Any:
    """A JSON file of the project; :class:`ProjectError` when it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ProjectError(
            path, f"cannot be read ({error})", "Restore it from a copy, or import the meshes into a new project"
        ) from error
