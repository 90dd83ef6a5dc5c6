"""Orientation of imported shapes: the vote at the end of an import, and shapes turned by hand afterwards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from shapeforge.collection.align import thinned
from shapeforge.collection.shape import Shape
from shapeforge.stages import Progress, Task
from shapeforge.stages_status import DEFAULTS, REVISION, inputs_of, options_of
from shapeforge.store import Problem, Project, key_of

SETTLED_VOTERS = 100  # shapes that were imported before and are listened to, at most
TURNED = 0.1  # degrees: less is no turn
REMEDY = "If that is wrong, turn it in the window, or import it again with --up keep, x, y or z"
BY_HAND = "turned by hand"


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
    for problem in problems:
        yield task.progress("orient", len(names), len(names), problem.reason, problem=problem)
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


@dataclass(frozen=True, eq=False)
class Before:
    """A shape as it was before it was turned by hand: arrays, record, and what was said about its file."""

    shape: Shape
    record: dict[str, Any]
    problems: tuple[Problem, ...]


def turned_key(key: str, by_hand: Mapping[str, Any]) -> str:
    """The key of a shape that was turned by hand, from the key of its file and options."""
    return key_of(key, by_hand["rotation"])


def turn_by_hand(project: Project, rotations: Mapping[str, Float[np.ndarray, "3 3"]]) -> dict[str, Before]:
    """Turn shapes so that the proper rotations (3, 3) by name take their file's axes to x, y (up), z; what was before.

    The turn stays when the same files are imported again, unless with another ``up``.  Labels stay as they are; what
    was fitted goes stale.  Groups do not: that a shape lay on its side says little about which it belongs with, and
    groups made by hand would be lost.  Raises ValueError for what is no rotation.
    """
    from shapeforge.collection.prepare import turned

    for name, rotation in rotations.items():
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise ValueError(f"rotations: wanted a proper rotation for {name}, got {np.asarray(rotation).tolist()}")
    options = options_of("import", project.stage_record("import"), {})
    before, fresh = {}, {}
    for name, rotation in rotations.items():
        record = project.shape_record(name)
        about = tuple(problem for problem in project.problems if problem.file == record["source"])
        before[name] = Before(project.shapes.named(name), dict(record), about)
        by_hand = {"rotation": np.asarray(rotation, float).tolist(), "up": options["up"]}
        own = key_of(record["sha256"], {option: options[option] for option in ("points", "up", "seed")})
        shape = turned(before[name].shape, np.asarray(rotation, float), BY_HAND)
        record = dict(record) | {"key": turned_key(own, by_hand), "by_hand": by_hand, "pose": "settled"}
        said = before[name].shape.notes[0]
        kept = tuple(problem for problem in about if problem.reason != said)
        fresh[name] = Before(shape, record | {"notes": list(shape.notes)}, kept)
    put_back(project, fresh)
    return before


def put_back(project: Project, shapes: Mapping[str, Before]) -> None:
    """Write shapes as they were before they were turned; the groups stay as current as they were."""
    with project.writing():
        was_current = _group_is_current(project)
        for one in shapes.values():
            project.save_shape(one.shape, one.record["key"])
        project.add_shapes({name: one.record for name, one in shapes.items()})
        said = [problem for one in shapes.values() for problem in one.problems]
        project.set_problems(said, [one.record["source"] for one in shapes.values()])
        record = project.stage_record("group")
        if record is not None and was_current:
            inputs = inputs_of(project, "group")
            key = key_of("group", REVISION, record["options"], inputs)
            project.set_stage_record("group", record | {"key": key, "inputs": inputs})


def _group_is_current(project: Project) -> bool:
    record = project.stage_record("group")
    if record is None or set(record["options"]) != set(DEFAULTS["group"]):
        return False
    return record["key"] == key_of("group", REVISION, record["options"], inputs_of(project, "group"))
