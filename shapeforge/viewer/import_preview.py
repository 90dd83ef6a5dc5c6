"""What an import would read, before it is one: each file's faces, size, likely unit and which way seems to be up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from shapeforge.collection.meshes import MeshError, find_meshes, read_mesh, repair_notes
from shapeforge.collection.orient import orient
from shapeforge.collection.prepare import normal_frame
from shapeforge.collection.shape import Mesh

UNITS: tuple[tuple[str, float, float], ...] = (("m", 0.05, 12.0), ("cm", 12.0, 350.0), ("mm", 350.0, 12000.0))
"""Unit and the longest extents (from, to) at which it is the likely one for furniture, tools and vehicles."""
UNIT_WORDS = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
OTHER_UNIT = 8.0
"""So many times as large or small as the middle of its folder a file is in another unit: the next is 10 times."""


@dataclass(frozen=True, eq=False)
class FilePreview:
    """One file: what was read, or why it was not (``problem`` and ``remedy``).

    ``size`` (3,) is width, height, depth in the file's unit once turned; ``unit`` what is likely for the file by itself
    (see ``Usual`` for all of them); ``rotation`` what "auto" would turn it by, as
    it stands alone: at the end of the import the files agree among themselves.  ``of`` is how many files there are.
    """

    name: str
    path: Path
    of: int
    n_faces: int = 0
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: str = ""
    up: str = ""
    notes: tuple[str, ...] = ()
    problem: str = ""
    remedy: str = ""
    mesh: Mesh | None = None
    rotation: Float[np.ndarray, "3 3"] | None = None


def previews(paths: Sequence[Path]) -> Iterator[FilePreview]:
    """A preview of every mesh file in ``paths`` (files and folders).  Raises ``MeshError`` when there is none."""
    found = find_meshes(paths)
    for name, path in found:
        yield preview_file(name, path, len(found))


def preview_file(name: str, path: Path, of: int = 1) -> FilePreview:
    """Read one file; whatever is wrong with it becomes its ``problem``."""
    try:
        mesh = read_mesh(path)
        rotation, up = orient(mesh, "auto")
    except MeshError as error:
        return FilePreview(name, path, of, problem=error.problem, remedy=error.remedy)
    except (ValueError, ArithmeticError, MemoryError, IndexError) as error:
        return FilePreview(name, path, of, problem=f"cannot be prepared ({error})", remedy="Repair it in a mesh editor")
    extent = np.ptp(mesh.vertices[np.unique(mesh.triangles)] @ rotation.T, axis=0)
    size = (float(extent[0]), float(extent[1]), float(extent[2]))
    return FilePreview(name, path, of, int(mesh.n_faces), size, likely_unit(max(size)), up, repair_notes(mesh),
                       mesh=mesh, rotation=rotation)  # fmt: skip


def likely_unit(longest: float) -> str:
    """The unit that makes a longest extent that of a thing for people: "m", "cm" or "mm"; "" when none does.

    Extents of exactly one are no unit at all: such files were scaled.
    """
    if abs(longest - 1.0) < 1e-3:
        return ""
    return next((unit for unit, low, high in UNITS if low <= longest < high), "")


@dataclass(frozen=True)
class Usual:
    """What files that belong together have in common, each as more than half of them have it by themselves.

    ``unit`` and ``up`` are None where there is no such: then each file has its own.  ``middle`` is the median of the
    longest extents of the files that agree on the unit.
    """

    unit: str | None = None
    middle: float = 0.0
    up: str | None = None

    def times(self, preview: FilePreview) -> float:
        """How many times as large as the others a file is (below 1: smaller); 1 where it is of their kind.

        What is merely a little larger than the others is in their unit, even where by itself it had another one.
        """
        longest = max(preview.size)
        if self.unit is None or longest <= 0:
            return 1.0
        times = longest / self.middle
        return times if max(times, 1 / times) >= OTHER_UNIT else 1.0

    def of(self, preview: FilePreview) -> str:
        """The unit of a file among the others."""
        return preview.unit if self.unit is None or self.times(preview) != 1.0 else self.unit

    def is_other_way_up(self, preview: FilePreview) -> bool:
        """Whether another direction of the file seems to be up than of most; without a majority, than y."""
        return preview.up != self.up if self.up is not None else preview.up.startswith("turned")


def usual(seen: Sequence[FilePreview]) -> Usual:
    """What most files agree on.  "" (such files were scaled) is agreed on like a unit."""
    read = [one for one in seen if not one.problem]
    unit, up = _majority([one.unit for one in read]), _majority([one.up for one in read])
    if unit is None:
        return Usual(up=up)
    return Usual(unit, float(np.median([max(one.size) for one in read if one.unit == unit])), up)


def _majority(words: Sequence[str]) -> str | None:
    """What more than half of them say."""
    most, count = Counter(words).most_common(1)[0] if words else ("", 0)
    return most if 2 * count > len(words) else None


def doubts(preview: FilePreview, among: Usual, up: str = "auto") -> tuple[str, ...]:
    """Why a file that is read should be looked at, in words: an outlier by size or by what is up, or it was repaired.

    ``up`` is which way the import is to turn the files: what is guessed matters only where it guesses.
    """
    if preview.problem:
        return ()
    odd = up == "auto" and among.is_other_way_up(preview)
    turned = (f"{preview.up}, unlike the others" if among.up is not None else preview.up) if odd else ""
    return tuple(words for words in (other_size_words(preview, among), turned, *preview.notes) if words)


def size_words(preview: FilePreview, among: Usual | None = None) -> str:
    """Width × height × depth with the likely unit, "?" since it is a guess: "0.5 × 0.9 × 0.6 m?"."""
    words = " × ".join(f"{value:.3g}" for value in preview.size)
    unit = (among or Usual()).of(preview)
    return f"{words} {unit}?" if unit else words


def other_size_words(preview: FilePreview, among: Usual) -> str:
    """That a file is far from the others' size, as by another unit: "1 000 times as large as the others"; else ""."""
    times = among.times(preview)
    if times == 1.0:
        return ""
    number, what = (times, "large") if times > 1 else (1 / times, "small")
    return f"{float(f'{number:.2g}'):,.0f} times as {what} as the others".replace(",", "\u202f")


def summary(seen: Sequence[FilePreview], up: str = "auto") -> str:
    """One sentence on all files seen so far: how many can be read, their unit, what is up, how many need a look."""
    read = [one for one in seen if not one.problem]
    text = f"{len(read)} of {len(seen)} can be read"
    among = usual(seen)
    if among.unit:
        text += f" · sizes look like {UNIT_WORDS[among.unit]}"
    if among.up is not None and among.up.startswith("turned") and up == "auto":
        text += f" · most are {among.up}"
    odd = sum(bool(doubts(one, among, up)) for one in read)
    return text + (f" · {odd} need{'s' * (odd == 1)} a look" if odd else "")


def upright_mesh(preview: FilePreview, up: str = "auto") -> Mesh:
    """The mesh as the import would turn it by ``up``, in normal coordinates."""
    rotation = preview.rotation if up == "auto" else orient(preview.mesh, up)[0]
    return preview.mesh.moved(normal_frame(preview.mesh, rotation).to_normal(preview.mesh.vertices))
