"""The vote at the end of an import: the files read settle their orientation among themselves and with the others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shapeforge.collection.align import thinned
from shapeforge.stages import Progress, Task
from shapeforge.store import Problem

SETTLED_VOTERS = 100  # shapes that were imported before and are listened to, at most
TURNED = 0.1  # degrees: less is no turn
REMEDY = "If that is wrong, import it again with --up keep, x, y or z"


def settle_poses(task: Task) -> Iterator[Progress]:
    """Let shapes whose record says ``"pose": "open"`` agree on their orientation, and turn those that were wrong.

    Shapes of earlier imports vote, but are not turned: they may have been painted.  A warning for every file that is
    not taken as it is.
    """
    from shapeforge.deformation.pose import agree, chosen_rotations

    project = task.project
    still_open = [name for name in project.names if project.shape_record(name).get("pose") == "open"]
    if not still_open:
        return
    settled = [name for name in project.names if name not in set(still_open)]
    names = sorted([*still_open, *thinned(np.array(settled, object), SETTLED_VOTERS)])
    yield task.progress("orient", 0, len(names), "comparing orientations")
    shapes = project.shapes
    is_open = set(still_open)
    family = list(task.workers.map(lambda name: _turns(shapes.named(name), name in is_open), names))
    kept = [(name, turns) for name, turns in zip(names, family, strict=True) if turns is not None]
    rotations = {}
    if len(kept) > 1:
        turns = [one for _, one in kept]
        found = chosen_rotations(turns, agree(turns), standing=bool(settled))
        rotations = {name: rotation for (name, _), rotation in zip(kept, found, strict=True) if name in is_open}
    records, problems = {}, []
    for name in still_open:
        record = dict(project.shape_record(name))
        note = _turn(task, name, record, rotations.get(name))
        if note:
            problems.append(Problem(record["source"], "warning", note, REMEDY))
        records[name] = record | {"pose": "settled"}
    project.add_shapes(records)
    about = {project.shape_record(name)["source"] for name in still_open}
    others = [problem for problem in project.problems if problem.file in about]
    project.set_problems([*others, *problems], sorted(about))
    yield task.progress("orient", len(names), len(names), f"{len(problems)} turned")


def _turns(shape, is_open: bool):
    from shapeforge.collection.upright import surface_of_shape
    from shapeforge.deformation.pose import candidate_turns, settled_turn

    surface = surface_of_shape(shape)
    if surface is None:
        return None
    return candidate_turns(surface) if is_open else settled_turn(surface, shape.frame.rotation)


def _turn(task: Task, name: str, record: dict, rotation: np.ndarray | None) -> str:
    """Turn the shape called ``name`` if it should be, and say so in its record; what is to be said about it, or ""."""
    from shapeforge.collection.directions import turning_angle
    from shapeforge.collection.orient import describe_turn
    from shapeforge.collection.prepare import turned

    shape = task.project.shapes.named(name)
    if rotation is not None and turning_angle(rotation @ shape.frame.rotation.T) > TURNED:
        shape = turned(shape, rotation, describe_turn(rotation))
        task.project.save_shape(shape, record["key"])
        record["notes"] = list(shape.notes)
    return shape.notes[0] if turning_angle(shape.frame.rotation) > TURNED else ""
