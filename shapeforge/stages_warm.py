"""Where a fit is taken up again: the finished one, its shapes as they are now, and its recorded rounds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.stages import StageError
from shapeforge.stages_status import first_parts, unchanged_shapes
from shapeforge.store import Project
from shapeforge.store_arrays import read_arrays, read_record, write_arrays


def warm_start(project: Project) -> tuple[Any | None, str]:
    """The state of the present fit for the shapes of now, to be taken up again; else None and why it cannot be.

    Shapes that came since, or were read or turned anew, have no candidates in it.
    """
    from shapeforge.deformation.warm import gathered, why_not_warm
    from shapeforge.stages_model import starting_groups, starting_parts

    folder = project.current_folder("fit")
    if folder is None or not (folder / "fit.zarr.zip").is_file():
        return None, "There is no finished fit."
    known, about = unchanged_shapes(project), read_record(folder / "names.zarr.zip")[0]
    parts = first_parts(project)
    if parts and about.get("first_parts", parts) != parts:
        return None, "The proposed parts are others than in the fit."
    fitted = [name if name in known else "" for name in about["names"]]
    state = gathered(read_record(folder / "fit.zarr.zip")[0], fitted, project.names)
    try:
        labels, part_names, seeds = starting_parts(project)
    except StageError as error:
        return None, str(error)
    reason = why_not_warm(state, project.shapes, starting_groups(project), labels, part_names, seeds)
    return (None, reason) if reason else (state, "")


def keep_rounds(project: Project, folder: Path, start: Any) -> None:
    """The rounds recorded so far are the first of those of the fit that takes the present one up again from ``start``.

    Points of shapes that are found anew, and of templates that are made anew, are left out: they were others.
    """
    before = project.current_folder("fit")
    if before is None:
        return
    fitted, known = tuple(read_record(before / "names.zarr.zip")[0]["names"]), unchanged_shapes(project)
    where = np.array([fitted.index(name) if name in known else -1 for name in project.names], int)
    pairs = zip(read_record(before / "fit.zarr.zip")[0].templates, start.templates, strict=False)
    kept = np.flatnonzero([np.array_equal(old.normals, new.normals) for old, new in pairs])
    for file in sorted((before / "rounds").glob("*.zarr.zip")):
        write_arrays(folder / "rounds" / file.name, _round_of(read_arrays(file)[0], where, kept))


def _round_of(arrays: dict[str, np.ndarray], where: np.ndarray, kept: np.ndarray) -> dict[str, np.ndarray]:
    """A recorded round for the shapes of now: shape i was number ``where[i]`` (-1: none, and has no points).

    So are points of a template set that is not among those ``kept``.
    """
    first = np.concatenate([[0], np.cumsum(arrays["lengths"])])
    lost = (where < 0) | ~np.isin(arrays["template"][where], kept)
    lengths, template = np.where(lost, 0, arrays["lengths"][where]), np.where(lost, -1, arrays["template"][where])
    rows = np.concatenate([np.arange(first[t], first[t] + n) for t, n in zip(where, lengths, strict=True)])
    return arrays | {"deformed": arrays["deformed"][rows], "lengths": lengths, "template": template}
