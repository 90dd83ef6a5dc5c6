"""A fitted shape as if its file lay another way: the mesh, the points and the beliefs turned back by a rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shapeforge.store import Project
from shapeforge.store_arrays import read_record, write_record


def turn_shape(project: Project, name: str, turn: np.ndarray) -> None:
    """Let the file of a shape lie so that ``turn`` (3, 3) puts it as the family lies; its beliefs say so."""
    path = project.shape_path(name)
    shape, attributes = read_record(path)
    mesh = replace(shape.mesh, vertices=shape.mesh.vertices @ turn)
    turned = replace(shape, mesh=mesh, points=shape.points @ turn, normals=shape.normals @ turn)
    write_record(path, turned, attributes)
    fitted = project.current_folder("fit") / "shapes" / f"{name}.zarr.zip"
    found, attributes = read_record(fitted)
    beliefs = found["beliefs"]
    moved = replace(
        beliefs, deformed=beliefs.deformed @ turn, maps=np.einsum("ij,ljk->lik", turn.T, beliefs.maps),
        offsets=beliefs.offsets @ turn, pose=turn,
    )  # fmt: skip
    write_record(fitted, {**found, "beliefs": moved, "positions": found["positions"] @ turn}, attributes)
