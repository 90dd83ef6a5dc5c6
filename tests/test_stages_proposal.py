"""Proposed parts and paint over them: what is redone when, what stays, and what a fit then starts from."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shapeforge.collection.families import write_family
from shapeforge.collection.iterate import last
from shapeforge.stages import StageError, next_step, run, status
from shapeforge.stages_collection import read_proposal
from shapeforge.stages_model import starting_groups, starting_parts
from shapeforge.stages_status import Corrections, corrections
from shapeforge.stages_validation import validate
from shapeforge.stages_warm import warm_start
from shapeforge.store import Project

POINTS, COUNT = 400, 6


@pytest.fixture(scope="module")
def family(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("family")
    write_family(folder, "chairs", COUNT, seed=3, broken=0.0, classes=["side", "armchair"])
    return folder


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory, family: Path) -> Project:
    """A family of three proposed parts, fitted; tests copy what they change."""
    project = Project.create(tmp_path_factory.mktemp("fitted") / "p")
    last(run(project, "import", meshes=[family], points=POINTS))
    last(run(project, "group", exemplars=["auto"]))
    last(run(project, "cosegment", parts=3))
    last(run(project, "fit", rounds=2, jobs=1))
    return project


@pytest.fixture
def project(fitted: Project, tmp_path: Path) -> Project:
    shutil.copytree(fitted.path, tmp_path / "p")
    return Project.open(tmp_path / "p")


def no_exemplar(project: Project) -> str:
    exemplars = {*starting_groups(project).exemplars.tolist(), *project.groups.exemplars.tolist()}
    return next(name for t, name in enumerate(project.names) if t not in exemplars)


def stroke(project: Project, name: str, *, turn: int = 0) -> np.ndarray:
    """Every fifth face painted as it was fitted, or with the part ``turn`` further."""
    faces = project.face_labels(name)
    painted = np.where(np.arange(len(faces)) % 5 == 0, (faces + turn) % 3, -1).astype(np.int32)
    project.set_labels(name, painted)
    return painted


def import_two_more(project: Project, folder: Path) -> None:
    write_family(folder, "chairs", 2, seed=91)
    for number, file in enumerate(sorted(folder.glob("*.obj"))):
        file.rename(file.with_name(f"a_new_{number}.obj"))  # they come first: every other shape gets another number
    last(run(project, "import", meshes=[folder]))


def test_new_shapes_have_parts_proposed_though_others_are_corrected(project: Project, tmp_path: Path) -> None:
    name = no_exemplar(project)
    painted = stroke(project, name)
    before = read_proposal(project).segmentation[project.index(name)].argmax(axis=1)
    import_two_more(project, tmp_path / "more")
    assert status(project)["fit"].state == "stale"
    last(run(project, "fit", rounds=2, jobs=1))
    assert [status(project)[stage].state for stage in ("cosegment", "fit")] == ["done", "done"]
    labels, _, seeds = starting_parts(project)
    assert [len(one) for one in seeds] == [project.shapes[t].n_points for t in range(COUNT + 2)]
    assert np.array_equal(labels[project.index(name)], painted), "the correction stays"
    after = read_proposal(project).segmentation[project.index(name)].argmax(axis=1)
    assert (before == after).mean() > 0.7, "and its names mean the same parts"
    assert "learn" in next_step(project)


def test_corrected_parts_keep_their_numbers_when_they_are_found_in_another_order(project, monkeypatch) -> None:
    from shapeforge.deformation import boxes

    stroke(project, no_exemplar(project))
    before, found = read_proposal(project), boxes.propose_parts

    def otherwise(*args, n_parts, **options):
        assert n_parts == 3
        turned = found(*args, n_parts=n_parts, **options)
        return replace(turned, segmentation=tuple(one[:, [1, 2, 0]] for one in turned.segmentation))

    monkeypatch.setattr(boxes, "propose_parts", otherwise)
    last(run(project, "cosegment", restart=True))
    after = read_proposal(project)
    for one, other in zip(before.segmentation, after.segmentation, strict=True):
        assert np.array_equal(one, other)


def test_paint_that_no_proposed_part_answers_to_stays_and_is_told(project: Project, monkeypatch) -> None:
    from shapeforge.deformation import boxes

    name = no_exemplar(project)
    painted, before = stroke(project, name), read_proposal(project)
    found = boxes.propose_parts

    def otherwise(*args, **options):
        turned = found(*args, **options)
        mixed = [np.roll(one, 1, axis=1)[np.arange(len(one)) * 7 % len(one)] for one in turned.segmentation]
        return replace(turned, segmentation=tuple(mixed))

    monkeypatch.setattr(boxes, "propose_parts", otherwise)
    with pytest.raises(StageError, match=f"{name} is painted with part ., and the parts proposed now have none"):
        last(run(project, "cosegment", restart=True))
    assert np.array_equal(project.labels(name), painted) and project.part_names.names == before.part_names
    after = read_proposal(project).segmentation
    assert all(np.array_equal(one, other) for one, other in zip(after, before.segmentation, strict=True))
    with pytest.raises(StageError, match="Ask for 3 parts"):
        last(run(project, "cosegment", parts=2))
    assert status(project)["fit"].state == "stale", "the paint"
    assert starting_parts(project)[2] is not None


def test_a_stopped_proposal_leaves_paint_its_parts(project: Project) -> None:
    stroke(project, no_exemplar(project))
    stopped = run(project, "cosegment", restart=True)
    while next(stopped).phase != "propose":
        pass
    stopped.close()
    assert status(project)["cosegment"].state == "partial" and starting_parts(project)[2] is not None
    last(run(project, "fit", rounds=2, jobs=1))
    assert status(project)["cosegment"].state == "done"


def test_a_corrected_family_is_compared_with_truth_by_the_parts_it_shares_most_with(project: Project, family: Path):
    name = no_exemplar(project)
    stroke(project, name)
    figures = last(validate(project, labels=family, jobs=1)).state
    found = figures["segmentation"]
    assert set(figures["proposed_parts_are"]) == {"part 1", "part 2", "part 3"} and figures["left_out"] == [name]
    assert found["area"] > 0.4 and found["affine_transfer"]["area"] > 0.3


def test_labels_from_files_do_not_take_the_names_of_proposed_parts(project: Project, family: Path, tmp_path: Path):
    for name in project.names:
        faces = np.loadtxt(family / f"{name}.seg", dtype=int)
        ids = [1 + part % 3 if face % 2 else -1 for face, part in enumerate(faces)]
        (tmp_path / f"{name}.seg").write_text("\n".join(map(str, ids)))
    stroke(project, no_exemplar(project))  # no paint by the proposed parts is left when files are there for all shapes
    last(run(project, "label", labels=tmp_path))
    names = project.part_names
    assert list(zip(names.ids, names.names, strict=True)) == [(part, f"part {part}") for part in (1, 2, 3)]
    assert starting_parts(project)[2] is None, "parts of the same names as those proposed, by chance"
    project.set_part_names(replace(names, names=("leg", *names.names[1:])))
    last(run(project, "label", labels=tmp_path))
    assert project.part_names.names[0] == "leg", "a name given to a painted part stays"


def test_strokes_on_an_exemplar_put_its_proposed_parts_right_and_leave_the_rest(project: Project, family: Path):
    t = int(starting_groups(project).exemplars[0])
    name = project.names[t]
    project.set_groups(replace(project.groups, exemplars=np.array([t])), by_hand=True)
    last(run(project, "fit", rounds=2, jobs=1))
    proposed = read_proposal(project).segmentation[t].argmax(axis=1)
    painted = stroke(project, name, turn=1)[project.shapes.named(name).face_of_point]
    wanted = np.bincount(np.where(painted >= 0, painted, proposed))
    assert starting_parts(project)[2] is not None and corrections(project) == Corrections((name,), (name,))
    for again in ({"warm": True}, {"warm": False, "restart": True}):
        last(run(project, "fit", rounds=2, jobs=1, **again))
        template = next(one for one in project.fit().templates if one.source == name)
        assert np.array_equal(np.bincount(template.label), wanted), again
    figures = last(validate(project, labels=family, jobs=1)).state
    assert figures["proposed_parts_are"] and figures["left_out"] == [name]
    project.set_labels(name, np.maximum(project.labels(name), 0))
    assert starting_parts(project)[2] is None, "painted all over"
    assert corrections(project).why == warm_start(project)[1] == ""


def test_exemplars_chosen_in_the_window_stay_when_parts_are_proposed(project: Project) -> None:
    first = last(run(project, "cosegment", parts=4)).state
    poorest = int(np.argmin([len(np.unique(one.argmax(axis=1))) for one in first.segmentation]))
    project.set_groups(replace(project.groups, exemplars=np.array([poorest])), by_hand=True)
    proposal = last(run(project, "cosegment")).state
    number = [len(np.unique(one.argmax(axis=1))) for one in proposal.segmentation]
    assert number[poorest] < max(number), "another has more parts"
    assert proposal.exemplars.tolist() == starting_groups(project).exemplars.tolist() == [poorest]
