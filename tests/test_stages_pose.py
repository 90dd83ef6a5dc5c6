"""Shapes turned by hand: arrays, keys and what is said about their files; and that it stays through the next import."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shapeforge import stages
from shapeforge.collection.directions import turning_angle
from shapeforge.collection.families import write_family
from shapeforge.collection.orient import TURNS
from shapeforge.collection.prepare import turned
from shapeforge.stages_pose import BY_HAND, put_back, turn_by_hand
from shapeforge.store import Project

LYING = TURNS["+z"]


def run(project: Project, stage: str, **options: object) -> None:
    for _ in stages.run(project, stage, jobs=1, **options):
        pass


@pytest.fixture
def project(tmp_path: Path) -> Project:
    write_family(tmp_path / "meshes", "chairs", 4, seed=3)
    made = Project.create(tmp_path / "chairs")
    run(made, "import", meshes=[tmp_path / "meshes"], points=300)
    run(made, "group")
    return made


def test_a_turn_moves_the_shape_and_leaves_labels_and_groups(project):
    name = project.names[1]
    before = project.shapes.named(name)
    faces = np.zeros(project.shape_record(name)["n_faces"], np.int32)
    from shapeforge.collection.labels import PartNames

    project.set_part_names(PartNames((1,), ("all",)))
    project.set_labels(name, faces)
    turn_by_hand(project, {name: LYING @ before.frame.rotation})
    after = Project.open(project.path).shapes.named(name)
    scale = after.frame.scale / before.frame.scale
    assert np.allclose(after.normals, before.normals @ LYING.T, atol=1e-6)
    back = after.frame.to_input(after.points)
    assert np.allclose(back, before.frame.to_input(before.points), atol=1e-5 / scale)
    assert after.notes[0] == BY_HAND
    assert np.array_equal(project.labels(name), faces)
    assert stages.status(project)["group"].state == "done"


def test_a_turn_makes_the_fit_stale_and_putting_it_back_makes_it_current(project):
    record = {"key": "x", "options": {}, "inputs": stages.inputs_of(project, "fit")}
    name = project.names[0]
    before = turn_by_hand(project, {name: LYING})
    assert stages.inputs_of(project, "fit")["shapes"] != record["inputs"]["shapes"]
    put_back(project, before)
    assert stages.inputs_of(project, "fit") == record["inputs"]
    assert np.array_equal(project.shapes.named(name).points, before[name].shape.points)
    assert "by_hand" not in project.shape_record(name)


def test_it_stays_when_the_files_are_imported_again_but_not_with_another_up(project, tmp_path):
    name = project.names[0]
    turn_by_hand(project, {name: LYING})
    record, shape = project.shape_record(name), project.shapes.named(name)
    run(project, "import", meshes=[tmp_path / "meshes"])
    assert project.shape_record(name) == record
    run(project, "import", meshes=[tmp_path / "meshes"], points=400)
    assert len(project.shapes.named(name).points) == 400
    assert turning_angle(project.shapes.named(name).frame.rotation @ shape.frame.rotation.T) < 1e-6
    run(project, "import", meshes=[tmp_path / "meshes"], up="keep")
    assert "by_hand" not in project.shape_record(name)
    assert turning_angle(project.shapes.named(name).frame.rotation) < 1e-6


def test_what_the_family_turns_is_turned_for_who_imported_it(project):
    """The vote at the end of an import writes a shape anew under the key that it had, after it was looked at."""
    name = project.names[0]
    before, key = project.shapes.named(name), project.shape_record(name)["key"]
    project.save_shape(turned(before, LYING @ before.frame.rotation, "turned"), key)
    stored = Project.open(project.path).shapes.named(name)
    assert not np.allclose(stored.points, before.points)
    assert np.array_equal(project.shapes.named(name).points, stored.points)


def test_what_is_no_rotation_is_refused(project):
    with pytest.raises(ValueError, match="proper rotation"):
        turn_by_hand(project, {project.names[0]: np.diag([1.0, 1.0, -1.0])})
    assert "by_hand" not in project.shape_record(project.names[0])
