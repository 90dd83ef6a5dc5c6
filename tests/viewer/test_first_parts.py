"""Proposed parts are put right in the window as painted ones are, on all shapes at once."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.iterate import last
from shapeforge.stages_collection import read_proposal
from shapeforge.store import Project
from shapeforge.viewer.first_parts import can_edit_proposed, edit_proposed, take_back_edit
from shapeforge.viewer.painter import Painter
from shapeforge.viewer.session import Session
from tests.viewer.conftest import run_stage


@pytest.fixture
def proposed(grouped: Project) -> Session:
    run_stage(grouped, "cosegment", parts=4)
    session = Session()
    session.open(grouped)
    return session


def names(session: Session) -> tuple[str, ...]:
    shown, proposed = session.project.part_names.names, tuple(read_proposal(session.project).part_names)
    assert shown == proposed
    return proposed


def test_the_palette_renames_and_merges_what_the_fit_will_start_from(proposed: Session):
    painter = Painter(proposed)
    painter.rename_part(1, "seat")
    assert names(proposed) == ("part 1", "seat", "part 3", "part 4")
    before = [one.argmax(axis=1) for one in read_proposal(proposed.project).segmentation]
    painter.merge_parts(3, 0)
    assert names(proposed) == ("seat", "part 3", "part 4") and proposed.part == 2
    after = [one.argmax(axis=1) for one in read_proposal(proposed.project).segmentation]
    assert all(np.array_equal(np.array([2, 0, 1, 2])[b], a) for b, a in zip(before, after, strict=True))
    with pytest.raises(ValueError, match="taken"):
        painter.rename_part(0, "part 4")


def test_an_edit_is_taken_back_and_a_split_adds_a_part(proposed: Session):
    assert can_edit_proposed(proposed) == (True, "")
    first = read_proposal(proposed.project).segmentation
    last(edit_proposed(proposed, "split", "part 1"))
    assert names(proposed) == ("part 1", "part 2", "part 3", "part 4", "part 5")
    assert any((one.argmax(axis=1) == 4).any() for one in read_proposal(proposed.project).segmentation)
    last(take_back_edit(proposed))
    assert names(proposed) == ("part 1", "part 2", "part 3", "part 4")
    again = read_proposal(proposed.project).segmentation
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_painted_parts_are_no_longer_proposed_ones(proposed: Session):
    project = proposed.project
    name = project.names[0]
    project.set_labels(name, np.zeros(project.shape_record(name)["n_faces"], np.int32))
    can, why = can_edit_proposed(proposed)
    assert not can and "painted" in why


def test_a_shape_is_opened_without_reading_the_chances_of_all(proposed: Session, monkeypatch):
    from shapeforge import stages_collection

    project = proposed.project
    wanted = [one.argmax(axis=1) for one in read_proposal(project).segmentation]
    monkeypatch.setattr(stages_collection, "read_proposal", lambda _: pytest.fail("the chances of all are read"))
    found = stages_collection.proposed_points(project)
    assert all(np.array_equal(one, other) for one, other in zip(found, wanted, strict=True))
    painter = Painter(proposed)
    painter.open(project.names[2])
    assert painter.proposed_faces is not None and set(painter.proposed_faces) <= set(wanted[2])
    (project.current_folder("cosegment") / "parts_of_points.zarr.zip").unlink()
    monkeypatch.undo()
    found = stages_collection.proposed_points(project)
    assert all(np.array_equal(one, other) for one, other in zip(found, wanted, strict=True)), "of an earlier version"


def test_proposed_parts_stay_in_sight_around_strokes(proposed: Session):
    """A fit takes the proposed parts where an exemplar is not painted; so that is what is seen."""
    painter = Painter(proposed)
    painter.open(proposed.project.names[2])
    before = painter.view().layers[0].colours
    faces = np.arange(10)
    painter.state.stroke("brush", "brush", faces, np.full(len(faces), 1))
    now, on = painter.view().layers[0].colours, painter.mesh.face_of_triangle
    assert np.array_equal(now[on >= 10], before[on >= 10])
    assert (now[on < 10] == proposed.project.part_inks()[1]).all()
    painter.save()
    painter.open(proposed.project.names[2])
    assert np.array_equal(painter.view().layers[0].colours, now)
    painter.remove_part(0)  # what is painted now is of other parts, and the proposed ones are none any more
    assert not np.array_equal(painter.view().layers[0].colours[on >= 10], before[on >= 10])
