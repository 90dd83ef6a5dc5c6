"""The prepared shapes of a project as a sequence that reads each when it is wanted."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from shapeforge.collection.shape import Shape
from shapeforge.store_arrays import ProjectError, read_record

SHAPES_IN_MEMORY = 256 << 20
"""Bytes of prepared shapes kept in memory; the shape used longest ago goes first."""


@runtime_checkable
class Holder(Protocol):
    """What :class:`StoredShapes` asks of the project: which shapes there are and where they lie."""

    path: Path
    names: tuple[str, ...]

    def shape_record(self, name: str) -> dict[str, Any]: ...

    def shape_path(self, name: str) -> Path: ...


class StoredShapes(Sequence):
    """The prepared shapes of a project, read one at a time; the most recently used stay in memory."""

    def __init__(self, project: Holder, capacity: int = SHAPES_IN_MEMORY) -> None:
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
