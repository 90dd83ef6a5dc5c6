"""Part labels of faces: reading and writing ``.seg`` files and ``labels.json``."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int

from shapeforge.collection.mesh_files import write_atomically

UNLABELLED = -1
LABELS_FILE = "labels.json"
LARGEST_ID = 2**31 - 1
INTEGER = re.compile(r"[+-]?[0-9]{1,18}")


class LabelError(ValueError):
    """A file of labels that cannot be used: which file, what was wanted, what came, and the usual cause."""

    def __init__(self, path: str | Path, wanted: str, got: str, cause: str = ""):
        self.path = Path(path)
        self.wanted = wanted
        self.got = got
        self.cause = cause
        super().__init__(f"{self.path.name or self.path}: wanted {wanted}, got {got}." + (f" {cause}" if cause else ""))

    def __reduce__(self):
        # the default would call LabelError(message): errors must survive the way back from a worker process
        return LabelError, (self.path, self.wanted, self.got, self.cause)


@dataclass(frozen=True)
class PartNames:
    """The parts of a family, in order: part ``l`` is called ``names[l]`` and has id ``ids[l]`` in ``.seg`` files.

    ``colours`` are those that a user gave to parts, "#RRGGBB" by name; the others have the colour of their place.
    """

    ids: tuple[int, ...]
    names: tuple[str, ...]
    colours: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)


def read_part_names(path: str | Path) -> PartNames:
    """Parts of a ``labels.json`` ({"id": "name"}), by rising id.  Raises ``LabelError``."""
    path = Path(path)
    repeated: list[str] = []

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        repeated.extend(key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i]))
        return dict(pairs)

    try:
        content = json.loads(_read_text(path), object_pairs_hook=once)
    except json.JSONDecodeError as error:
        raise LabelError(path, 'JSON like {"1": "back"}', f"line {error.lineno}: {error.msg}") from None
    if not isinstance(content, dict) or not content:
        raise LabelError(path, 'at least one part, like {"1": "back"}', repr(content)[:60])
    if repeated:
        raise LabelError(path, "every id once", f"{repeated[0]!r} twice")
    parts = {}
    for key, name in content.items():
        try:
            identity = int(key)
        except ValueError:
            identity = -1
        if not 0 <= identity <= LARGEST_ID or identity in parts:
            cause = "-1 means unlabelled and has no name." if key.strip() == "-1" else ""
            raise LabelError(path, "whole numbers from 0 on as ids, each once", repr(key), cause)
        if not isinstance(name, str) or not name.strip():
            raise LabelError(path, f"a name for id {identity}", repr(name)[:60])
        parts[identity] = name.strip()
    if len(set(parts.values())) < len(parts):
        twice = next(n for n in parts.values() if list(parts.values()).count(n) > 1)
        raise LabelError(path, "a different name for every id", f"{twice!r} twice", "Give joined parts one id.")
    return PartNames(tuple(sorted(parts)), tuple(parts[i] for i in sorted(parts)))


def write_part_names(path: str | Path, part_names: PartNames) -> None:
    """Write ``labels.json``; ``read_part_names`` gives the same parts back (by rising id)."""
    content = {str(i): name for i, name in zip(part_names.ids, part_names.names, strict=True)}
    write_atomically(Path(path), (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())


def read_seg(path: str | Path, n_faces: int, part_names: PartNames | None = None) -> Int[np.ndarray, " F"]:
    """Part index (n_faces,) of each face record from a ``.seg`` file (an integer a line), -1 where unlabelled.

    Ids that ``part_names`` does not have are unlabelled.  With None every id from 0 on is a label, and the index counts
    the ids of this file by rising id; for a family use ``find_part_names``, so that all files count alike.
    Raises ``LabelError`` where a line is no integer or the number of lines is not ``n_faces``.
    """
    path = Path(path)
    ids = _read_ids(path)
    if len(ids) != n_faces:
        cause = "Labels count face records of the mesh file, a polygon once: is this the file that was labelled?"
        raise LabelError(path, f"{n_faces} labels, one per face", f"{len(ids)}", cause)
    known = np.array(part_names.ids if part_names else np.unique(ids[ids >= 0]), np.int64)
    if len(known) == 0:
        return np.full(n_faces, UNLABELLED, np.int32)
    by_id = np.argsort(known)
    at = np.minimum(np.searchsorted(known[by_id], ids), len(known) - 1)
    return np.where(known[by_id][at] == ids, by_id[at], UNLABELLED).astype(np.int32)


def unknown_ids(path: str | Path, part_names: PartNames) -> dict[int, int]:
    """Ids from 0 on in a ``.seg`` file that ``part_names`` does not have, and how many faces have each."""
    ids, times = np.unique(_read_ids(Path(path)), return_counts=True)
    return {i: n for i, n in zip(ids.tolist(), times.tolist(), strict=True) if i >= 0 and i not in part_names.ids}


def write_seg(path: str | Path, faces: Int[np.ndarray, " F"], part_names: PartNames) -> None:
    """Write the id of each face's part index (F,), -1 where unlabelled."""
    if len(faces) and not -1 <= faces.min() <= faces.max() < len(part_names):
        raise ValueError(f"faces: wanted part indices -1..{len(part_names) - 1}, got {faces.min()}..{faces.max()}")
    ids = np.array([*part_names.ids, UNLABELLED])[faces]
    write_atomically(Path(path), "".join(f"{i}\n" for i in ids.tolist()).encode())


def find_part_names(folder: str | Path) -> PartNames:
    """Parts of a folder of labels: its ``labels.json``, else every id from 0 on of its ``.seg`` files ("part 3").

    ``.seg`` files that cannot be read say nothing about the parts; ``LabelError`` when none can.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LabelError(folder, "a folder of .seg files", "a file" if folder.exists() else "no such folder")
    if (folder / LABELS_FILE).is_file():
        return read_part_names(folder / LABELS_FILE)
    found: set[int] = set()
    files = sorted(folder.rglob("*.seg"))
    failed: list[LabelError] = []
    for file in files:
        try:
            found.update(np.unique(_read_ids(file)).tolist())
        except LabelError as error:
            failed.append(error)
    ids = tuple(sorted(i for i in found if i >= 0))
    if failed and not ids:
        raise failed[0]
    if not ids:
        got = f"{len(files)} .seg files without labels" if files else "a folder without .seg files"
        raise LabelError(folder, f"{LABELS_FILE} or labelled .seg files", got)
    return PartNames(ids, tuple(f"part {i}" for i in ids))


def _read_ids(path: Path) -> np.ndarray:
    """The integers (F,) of a ``.seg`` file; blank lines do not count."""
    words = [word.strip() for word in _read_text(path).split("\n")]
    # int() alone would take 1_0 and the digits of other scripts
    wrong = next((i for i, word in enumerate(words) if word and not INTEGER.fullmatch(word)), None)
    if wrong is not None:
        raise LabelError(path, "one integer per line", f"{words[wrong][:40]!r} in line {wrong + 1}")
    return np.array([int(word) for word in words if word], np.int64)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise LabelError(path, "a text file", "bytes that are no text") from None
    except OSError as error:
        raise LabelError(path, "a file that can be read", error.strerror or type(error).__name__) from None
