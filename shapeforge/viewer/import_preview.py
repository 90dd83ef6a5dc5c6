"""What an import would read, before it is one: each file's faces, size, likely unit and which way seems to be up."""

from __future__ import annotations

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


@dataclass(frozen=True, eq=False)
class FilePreview:
    """One file: what was read, or why it was not (``problem`` and ``remedy``).

    ``size`` (3,) is width, height, depth in the file's unit once turned; ``rotation`` what "auto" would turn it by, as
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

    @property
    def is_doubtful(self) -> bool:
        """It is read, but something about it should be looked at."""
        return not self.problem and (bool(self.notes) or self.up.startswith("turned"))


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


def size_words(preview: FilePreview) -> str:
    """Width × height × depth with the likely unit, "?" since it is a guess: "0.5 × 0.9 × 0.6 m?"."""
    words = " × ".join(f"{value:.3g}" for value in preview.size)
    return f"{words} {preview.unit}?" if preview.unit else words


def summary(seen: Sequence[FilePreview]) -> str:
    """One sentence on all files seen so far: how many can be read, their unit, how many seem to lie."""
    read = [one for one in seen if not one.problem]
    text = f"{len(read)} of {len(seen)} can be read"
    units = [one.unit for one in read if one.unit]
    if units:
        words = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
        text += f" · sizes look like {words[max(sorted(set(units)), key=units.count)]}"
    lying = sum(one.up.startswith("turned") for one in read)
    return text + (f" · {lying} seem{'s' * (lying == 1)} not to stand upright" if lying else "")


def upright_mesh(preview: FilePreview, up: str = "auto") -> Mesh:
    """The mesh as the import would turn it by ``up``, in normal coordinates."""
    rotation = preview.rotation if up == "auto" else orient(preview.mesh, up)[0]
    return preview.mesh.moved(normal_frame(preview.mesh, rotation).to_normal(preview.mesh.vertices))
