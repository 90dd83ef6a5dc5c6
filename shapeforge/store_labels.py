"""The half of a project that users edit: parts, labels, and the history of painting them, changed in one step.

What is new is written beside what is there, under a key of its own, and counts once ``project.json`` names it: whoever
is killed in between leaves everything as it was, and no label that means another part.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int, UInt8

from shapeforge.collection.colours import inks_of
from shapeforge.collection.labels import PartNames
from shapeforge.store_arrays import ProjectError, key_of, read_arrays, read_record, write_arrays, write_record


class Labels:
    """Parts and labels of a project (see the project for the names that are only declared here)."""

    path: Path
    _metadata: dict[str, Any]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shapes (see the project)."""
        raise NotImplementedError

    def shape_record(self, name: str) -> dict[str, Any]:
        """What is known of a shape (see the project)."""
        raise NotImplementedError

    def writing(self) -> Any:
        """Hold the project for writing (see the project)."""
        raise NotImplementedError

    def _changing(self) -> Any:
        raise NotImplementedError

    # -- parts -----------------------------------------------------------------------------------------------------

    @property
    def part_names(self) -> PartNames | None:
        """Parts of the family, None before any label is known."""
        stored = self._metadata["part_names"]
        if not stored:
            return None
        return PartNames(tuple(stored["ids"]), tuple(stored["names"]), dict(stored.get("colours", {})))

    def part_inks(self, names: Sequence[str] | None = None) -> UInt8[np.ndarray, "L 3"]:
        """Colours (L, 3) of the parts called ``names`` (None: the project's): those chosen, else by their place."""
        known = self.part_names or PartNames((), ())
        return inks_of(known.names if names is None else names, known.colours)

    @property
    def part_edits(self) -> dict[str, Any]:
        """The history of changing the parts by hand as it was written, empty before there is any."""
        return json.loads(json.dumps(self._metadata.get("part_edits", {})))

    def set_part_names(self, part_names: PartNames, edits: Mapping[str, Any] | None = None) -> None:
        """Name the parts; parts may be added or renamed, labels keep their part index (see ``set_painting``)."""
        self.set_painting({}, part_names=part_names, edits=edits)

    # -- labels ----------------------------------------------------------------------------------------------------

    @property
    def labelled(self) -> tuple[str, ...]:
        """Names of the shapes that have labels."""
        return tuple(name for name in self.names if name in self._metadata["labels"])

    def label_key(self, name: str) -> str | None:
        """Key of the labels of a shape, None without labels."""
        return self._metadata["labels"].get(name)

    def labels(self, name: str) -> Int[np.ndarray, " F"] | None:
        """Part index per face record (n_faces,), -1 where nothing is said; None when the shape has no labels."""
        self.shape_record(name)
        key = self.label_key(name)
        return None if key is None else read_arrays(self._kept_as("labels", name, key))[0]["faces"]

    def set_labels(self, name: str, faces: Int[np.ndarray, " F"] | None) -> None:
        """Label a shape: part index per face record, -1 unlabelled; None takes its labels away."""
        self.set_painting({name: faces})

    def read_history(self, name: str) -> Any | None:
        """The edit history of a shape as it was written, None when there is none or it is damaged."""
        key = self._metadata.get("history", {}).get(name)
        try:
            return read_record(self._kept_as("history", name, key))[0]
        except ProjectError:
            return None

    def set_painting(
        self,
        labels: Mapping[str, Int[np.ndarray, " F"] | None],
        histories: Mapping[str, Any] | None = None,
        *,
        part_names: PartNames | None = None,
        edits: Mapping[str, Any] | None = None,
    ) -> None:
        """Change all of this at once: killed at any moment, the project has all of it or none.

        ``labels`` of shapes, part index per face record (n_faces,), -1 unlabelled, None takes a shape's labels away;
        the ``histories`` of painting them (arrays, numbers, strings, lists and dicts of them); ``part_names`` (None: as
        they are), and ``edits``, the history of changing the parts by hand that leads to these.
        Raises ValueError for labels that do not fit their shape or the parts.
        """
        parts = self.part_names if part_names is None else part_names
        faces = {name: self._checked(name, one, len(parts or ())) for name, one in labels.items()}
        with self.writing():
            keys = {name: None if one is None else key_of(one) for name, one in faces.items()}
            for name, one in faces.items():
                if one is not None:
                    write_arrays(self._place("labels", name, keys[name]), {"faces": one})
            kept = {name: _key_of_record(one) for name, one in (histories or {}).items()}
            for name, key in kept.items():
                write_record(self._place("history", name, key), (histories or {})[name])
            before = {"labels": dict(self._metadata["labels"]), "history": dict(self._metadata.get("history", {}))}
            with self._changing() as metadata:
                for name, key in keys.items():
                    metadata["labels"].pop(name, None)
                    if key is not None:
                        metadata["labels"][name] = key
                if kept:
                    metadata["history"] = metadata.get("history", {}) | kept
                if part_names is not None:
                    metadata["part_names"] = _record_of(part_names)
                if edits is not None:
                    metadata["part_edits"] = dict(edits)
            for kind, changed in (("labels", keys), ("history", kept)):
                for name, key in changed.items():
                    self._sweep(kind, name, {key, before[kind].get(name)})

    def _checked(self, name: str, faces: Any, n_parts: int) -> Int[np.ndarray, " F"] | None:
        n_faces = self.shape_record(name)["n_faces"]
        if faces is None:
            return None
        faces = np.asarray(faces, np.int32)
        if len(faces) != n_faces:
            raise ValueError(f"faces: wanted one label for each of the {n_faces} faces of {name}, got {len(faces)}")
        if len(faces) and (faces.min() < -1 or faces.max() >= n_parts):
            raise ValueError(f"faces: wanted -1 to {n_parts - 1}, got {faces.min()} to {faces.max()}; name parts first")
        return faces

    # -- files -----------------------------------------------------------------------------------------------------

    def _place(self, kind: str, name: str, key: str | None) -> Path:
        return self.path / kind / name / f"{key}.zarr.zip"

    def _kept_as(self, kind: str, name: str, key: str | None) -> Path:
        """Where something is kept: under its key, or as an earlier version wrote it."""
        place = self._place(kind, name, key)
        return place if place.is_file() else self.path / kind / f"{name}.zarr.zip"

    def _sweep(self, kind: str, name: str, keep: set[str | None]) -> None:
        """Delete what no longer counts; what counted until now stays, for whoever reads it at this moment."""
        for file in self._place(kind, name, None).parent.glob("*.zarr.zip"):
            if file.name.partition(".")[0] not in keep:
                file.unlink(missing_ok=True)


def _record_of(part_names: PartNames) -> dict[str, Any]:
    names = list(part_names.names)
    colours = {name: colour for name, colour in part_names.colours.items() if name in names}
    return {"ids": list(part_names.ids), "names": names, "colours": colours}


def _key_of_record(record: Any) -> str:
    """The key of a record of arrays, numbers, strings, lists and dicts of them."""
    if isinstance(record, Mapping):
        return key_of(*(_key_of_record([name, value]) for name, value in sorted(record.items())))
    if isinstance(record, list | tuple):
        return key_of(*(_key_of_record(value) for value in record))
    return key_of(record)
