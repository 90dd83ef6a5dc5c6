"""What an import would read, before it is one: each file's faces, size, possible units and which way seems to be up."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from shapeforge.collection.counts import grouped
from shapeforge.collection.meshes import MeshError, find_meshes, read_mesh, repair_notes
from shapeforge.collection.orient import orient
from shapeforge.collection.prepare import normal_frame
from shapeforge.collection.shape import Mesh

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""The units that are told apart, in metres."""
SMALLEST, LARGEST = 0.1, 80.0
"""Longest extents (metres) of things, from cups to airliners; where several units make it such, size does not tell."""
STATED = {".glb": "m", ".gltf": "m"}
"""Formats that are in one unit by their specification."""
UNIT_WORDS = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
OTHER_UNIT = 8.0
"""So many times as large or small as the middle of its folder a file is in another unit: the next is 10 times."""


@dataclass(frozen=True, eq=False)
class FilePreview:
    """One file: what was read, or why it was not (``problem`` and ``remedy``).

    ``size`` (3,) is width, height, depth in the file's unit once turned; ``units`` those that are possible for the
    file by itself, the likeliest first (see ``Usual`` for all of them); ``rotation`` what "auto" would turn it by, as
    it stands alone: at the end of the import the files agree among themselves.  ``of`` is how many files there are.
    """

    name: str
    path: Path
    of: int
    n_faces: int = 0
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    units: tuple[str, ...] = ()
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
    units = possible_units(max(size), _stated_unit([path]))
    return FilePreview(name, path, of, int(mesh.n_faces), size, units, up, repair_notes(mesh),
                       mesh=mesh, rotation=rotation)  # fmt: skip


def possible_units(longest: float, stated: str | None = None) -> tuple[str, ...]:
    """The units in which a longest extent is that of a thing, the one that makes it nearest to a metre first.

    None of them for extents of exactly one: such files were scaled.  ``stated`` is the unit of the file's format.
    """
    if abs(longest - 1.0) < 1e-3:
        return ()
    if stated is not None:
        return (stated,)
    fits = [unit for unit, metres in METRES.items() if SMALLEST <= longest * metres < LARGEST]
    return tuple(sorted(fits, key=lambda unit: abs(math.log(longest * METRES[unit]))))


def _stated_unit(paths: Sequence[Path]) -> str | None:
    """The unit that the formats of all these files are in."""
    stated = {STATED.get(path.suffix.lower()) for path in paths}
    return stated.pop() if len(stated) == 1 else None


@dataclass(frozen=True)
class Usual:
    """What files that belong together have in common.

    Where more than half are of about one size, ``middle`` is the median of their longest extents and ``units`` are
    those that are possible for it, the likeliest first; ``up`` is what more than half have by themselves.  ``units``
    and ``up`` are None where there is no such: then each file has its own.
    """

    units: tuple[str, ...] | None = None
    middle: float = 0.0
    up: str | None = None

    def times(self, preview: FilePreview) -> float:
        """How many times as large as the others a file is (below 1: smaller); 1 where it is of their kind.

        What is merely a little larger than the others is in their unit, even where by itself it had another one.
        """
        longest = max(preview.size)
        if self.units is None or longest <= 0:
            return 1.0
        times = longest / self.middle
        return times if max(times, 1 / times) >= OTHER_UNIT else 1.0

    def of(self, preview: FilePreview) -> tuple[str, ...]:
        """The possible units of a file among the others."""
        return preview.units if self.units is None or self.times(preview) != 1.0 else self.units

    def is_other_way_up(self, preview: FilePreview) -> bool:
        """Whether another direction of the file seems to be up than of most; without a majority, than y."""
        return preview.up != self.up if self.up is not None else preview.up.startswith("turned")


def usual(seen: Sequence[FilePreview]) -> Usual:
    """What most files agree on."""
    read = [one for one in seen if not one.problem]
    up = _majority([one.up for one in read])
    kin = _alike([max(one.size) for one in read])
    if 2 * len(kin) <= len(read):
        return Usual(up=up)
    middle = float(np.median([max(read[i].size) for i in kin]))
    return Usual(possible_units(middle, _stated_unit([read[i].path for i in kin])), middle, up)


def _alike(longest: Sequence[float]) -> list[int]:
    """The largest set of files that are less than OTHER_UNIT times as large or small as one of them."""
    if not len(longest):
        return []
    sizes = np.sort(longest)
    first, end = np.searchsorted(sizes, sizes / OTHER_UNIT, "right"), np.searchsorted(sizes, sizes * OTHER_UNIT)
    most = int((end - first).argmax())
    low, high = sizes[first[most]], sizes[end[most] - 1]
    return [i for i, one in enumerate(longest) if low <= one <= high]


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
    """Width × height × depth in the possible units, none being sure: "0.5 × 0.9 × 0.6 m?", "9 × 35 × 9 cm or m?"."""
    words = " × ".join(f"{value:.3g}" for value in preview.size)
    units = (among or Usual()).of(preview)
    return f"{words} {_either(units)}?" if units else words


def _either(words: Sequence[str]) -> str:
    """One of some words: "cm, mm or m"."""
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def other_size_words(preview: FilePreview, among: Usual) -> str:
    """That a file is far from the others' size, as by another unit: "1 000 times as large as the others"; else ""."""
    times = among.times(preview)
    if times == 1.0:
        return ""
    number, what = (times, "large") if times > 1 else (1 / times, "small")
    return f"{grouped(round(float(f'{number:.2g}')))} times as {what} as the others"


def summary(seen: Sequence[FilePreview], up: str = "auto") -> str:
    """One sentence on all files seen so far: how many can be read, their unit, what is up, how many need a look."""
    read = [one for one in seen if not one.problem]
    text = f"{grouped(len(read))} of {grouped(len(seen))} can be read"
    among = usual(seen)
    if among.units:
        words = _either([UNIT_WORDS[unit] for unit in among.units])
        text += f" · sizes look like {words}" if len(among.units) == 1 else f" · sizes may be {words}"
    if among.up is not None and among.up.startswith("turned") and up == "auto":
        text += f" · most are {among.up}"
    odd = sum(bool(doubts(one, among, up)) for one in read)
    return text + (f" · {grouped(odd)} need{'s' * (odd == 1)} a look" if odd else "")


def upright_mesh(preview: FilePreview, up: str = "auto") -> Mesh:
    """The mesh as the import would turn it by ``up``, in normal coordinates."""
    rotation = preview.rotation if up == "auto" else orient(preview.mesh, up)[0]
    return preview.mesh.moved(normal_frame(preview.mesh, rotation).to_normal(preview.mesh.vertices))
