"""The driver of the stages: keys and staleness, resuming after a kill, the same bytes for any number of workers."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shapeforge import stages, stages_synthesis
from shapeforge.collection.families import write_family
from shapeforge.collection.groups import join_groups
from shapeforge.collection.iterate import last
from shapeforge.collection.labels import PartNames, read_seg
from shapeforge.deformation.exemplars import blend
from shapeforge.deformation.hierarchy import Link
from shapeforge.deformation.warm import WARM_ROUNDS
from shapeforge.generative.draw import draw
from shapeforge.generative.inference import decode
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.stages import Progress, StageError, next_step, run, status
from shapeforge.stages_collection import edits_of, merged_part_names, parts_without_exemplar
from shapeforge.stages_draws import drawn_as_asked, latents_of
from shapeforge.stages_model import curve, named_split, starting_groups, starting_parts
from shapeforge.stages_pose import turn_by_hand
from shapeforge.stages_recipes import read_recipe, remake
from shapeforge.stages_refine import judging_shapes, machine_prior, on_template
from shapeforge.stages_status import Corrections, corrections, options_of
from shapeforge.stages_synthesis import made_whole
from shapeforge.stages_warm import warm_start
from shapeforge.store import Project
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.workers import Workers

POINTS, COUNT = 400, 6
CLASSES = ["side", "armchair"]


@pytest.fixture(scope="session")
def family(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six generated chairs with labels, landmarks and classes."""
    folder = tmp_path_factory.mktemp("family")
    write_family(folder, "chairs", COUNT, seed=3, broken=0.0, classes=CLASSES)
    return folder


def import_and_group(path: Path, family: Path) -> Project:
    project = Project.create(path)
    last(run(project, "import", meshes=[family], points=POINTS))
    last(run(project, "group", exemplars=["chair_0000", "chair_0001"]))
    return project


@pytest.fixture(scope="session")
def grouped(tmp_path_factory: pytest.TempPathFactory, family: Path) -> Project:
    return import_and_group(tmp_path_factory.mktemp("grouped") / "p", family)


@pytest.fixture(scope="session")
def done(tmp_path_factory: pytest.TempPathFactory, grouped: Project, family: Path) -> Project:
    """A small project with every stage done; tests copy what they change."""
    path = tmp_path_factory.mktemp("done") / "p"
    shutil.copytree(grouped.path, path)
    project = Project.open(path)
    last(run(project, "label", labels=family, only="exemplars"))
    last(run(project, "fit", rounds=2, jobs=1))
    last(run(project, "learn", epochs=3))
    last(run(project, "synthesize", count=2, out=str(path.parent / "new")))
    return project


def copy_of(project: Project, path: Path) -> Project:
    shutil.copytree(project.path, path)
    return Project.open(path)


def states(project: Project) -> dict[str, str]:
    return {stage: found.state for stage, found in status(project).items()}


def contents(project: Project) -> dict[str, bytes]:
    """All that the fit found, as bytes."""
    found = {}
    for name in project.fit_names:
        beliefs = project.beliefs(name)
        assert beliefs is not None
        found[name] = b"".join(
            np.ascontiguousarray(array).tobytes()
            for array in (beliefs.deformed, beliefs.segmentation, project.positions(name), project.face_labels(name))
        )
    return found


# -- what is done, missing, stale ------------------------------------------------------------------------------------


def test_everything_is_done_once_and_then_left_alone(done: Project) -> None:
    expected = dict.fromkeys(stages.STAGES, "done") | {"cosegment": "missing", "refine": "missing"}
    assert states(done) == expected
    assert "export" in next_step(done)
    for stage in ("group", "fit", "learn", "synthesize"):
        steps = list(run(done, stage))
        assert [step.phase for step in steps] == ["done"] and "nothing to do" in steps[0].message
    assert states(done) == expected


def test_status_follows_the_pipeline(tmp_path: Path, grouped: Project) -> None:
    empty = Project.create(tmp_path / "empty")
    assert states(empty) == {stage: "missing" if stage == "import" else "locked" for stage in stages.STAGES}
    assert "shapeforge import" in next_step(empty)
    found = status(grouped)
    assert found["label"].state == "missing" and found["fit"].state == "locked" and found["learn"].state == "locked"
    assert "label" in found["fit"].reason and "chair_0000" in next_step(grouped)


def test_new_labels_make_the_fit_stale_and_all_after_it(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    faces = project.labels("chair_0000")
    assert faces is not None
    faces[:5] = -1
    project.set_labels("chair_0000", faces)
    assert states(project)["fit"] == "stale" and states(project)["learn"] == "stale"
    assert "labels" in status(project)["fit"].reason
    project.set_labels("chair_0000", done.labels("chair_0000"))
    assert states(project)["fit"] == "done" and states(project)["learn"] == "done"  # content counts, not time


def test_other_options_make_a_stage_stale_and_say_so(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    old = project.fit()
    steps = list(run(project, "fit", rounds=1))
    assert steps[0].phase == "stale" and "rounds 1 instead of 2" in steps[0].message
    # as many rounds of the family's templates follow those of the exemplars'
    assert project.fit().family_from == old.family_from == 1
    assert project.fit().round == 2 and old.round == 3
    assert status(project)["learn"].state == "stale" and "fit" in status(project)["learn"].reason
    assert [step.phase for step in run(project, "fit")] == ["done"]  # options stay as they were given last
    assert len(list((project.path / "fit").iterdir())) == 1  # the old results are gone


def test_a_stale_stage_before_is_redone_first(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    project.set_labels("chair_0002", np.zeros(project.shape_record("chair_0002")["n_faces"], np.int32))
    stages_run = {step.stage for step in run(project, "learn")}
    assert stages_run == {"fit", "learn"}
    assert states(project)["fit"] == "done" and states(project)["learn"] == "done"


def test_old_results_stay_until_the_new_ones_are_complete(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    before = contents(project)
    steps = run(project, "fit", restart=True)
    while next(steps).phase != "fit":
        pass
    assert contents(project) == before
    steps.close()
    assert contents(project) == before and states(project)["fit"] == "partial"
    last(run(project, "fit"))
    assert contents(project) == before and states(project)["fit"] == "done"


def test_importing_more_adds_and_changed_files_are_read_again(grouped: Project, family: Path, tmp_path: Path) -> None:
    project = copy_of(grouped, tmp_path / "p")
    more = tmp_path / "more"
    write_family(more, "chairs", 1, seed=9, broken=0.0, classes=["stool"])
    (more / "chair_0000.obj").rename(more / "stool.obj")
    steps = list(run(project, "import", meshes=[more / "stool.obj"]))
    assert steps[-1].of == COUNT + 1 and len(project.names) == COUNT + 1
    assert status(project)["group"].state == "stale"
    assert project.groups is not None and project.groups.group[project.index("stool")] == -1
    before = project.shape_record("stool")
    text = (more / "stool.obj").read_text()
    (more / "stool.obj").write_text(text + "f 1 2 3\n")
    assert status(project)["import"].state == "stale" and "stool" in status(project)["import"].reason
    last(run(project, "import", meshes=[more / "stool.obj"]))
    after = project.shape_record("stool")
    assert after["n_faces"] == before["n_faces"] + 1 and after["key"] != before["key"]


def test_other_points_prepare_all_shapes_again(grouped: Project, tmp_path: Path) -> None:
    project = copy_of(grouped, tmp_path / "p")
    last(run(project, "import", points=300))
    assert {shape.n_points for shape in project.shapes} == {300}
    assert project.stage_record("import")["summary"]["read"] == COUNT
    last(run(project, "import"))
    summary = project.stage_record("import")["summary"]
    assert (summary["kept"], summary["read"]) == (COUNT, 0)


# -- what cannot be done ---------------------------------------------------------------------------------------------


def test_unknown_names_are_refused_at_once(grouped: Project) -> None:
    with pytest.raises(StageError, match="wanted one of import, group"):
        run(grouped, "paint")
    with pytest.raises(StageError, match="'speed': fit has rounds, inner, seed, warm"):
        run(grouped, "fit", speed=9)


def test_labels_say_which_parts_no_exemplar_shows(grouped: Project, family: Path, tmp_path: Path) -> None:
    project = copy_of(grouped, tmp_path / "p")
    assert parts_without_exemplar(project) == []
    last(run(project, "group", exemplars=["chair_0000", "chair_0002"]))  # side chairs
    assert last(run(project, "label", labels=family)).message == (
        "6 shapes labelled with 4 parts; no exemplar has arm, so no shape gets it: "
        "name one that has (group --exemplars)"
    )
    project.set_labels("chair_0000", None)
    assert parts_without_exemplar(project) == [], "an exemplar that is not labelled yet may have arms"
    last(run(project, "group", exemplars=["chair_0002", "chair_0003"]))
    assert last(run(project, "label", labels=family)).message == "6 shapes labelled with 4 parts"


def test_a_fit_without_labels_says_which_shapes_to_label(grouped: Project, tmp_path: Path) -> None:
    project = copy_of(grouped, tmp_path / "p")
    with pytest.raises(StageError, match="needs parts. Label the exemplars .*chair_0000"):
        last(run(project, "fit"))
    project.set_part_names(PartNames((1,), ("leg",)))
    project.set_labels("chair_0005", np.zeros(project.shape_record("chair_0005")["n_faces"], np.int32))
    with pytest.raises(StageError, match="no exemplar has labels: label at least one of"):
        last(run(project, "fit"))


def test_part_names_keep_their_index() -> None:
    first, second = PartNames((1, 2), ("back", "seat")), PartNames((2, 5), ("Seat", "arm"))
    assert merged_part_names(None, second) == second
    assert merged_part_names(first, second) == PartNames((1, 2, 5), ("back", "Seat", "arm"))
    with pytest.raises(StageError, match="'arm' would be the name of the ids 2 and 5"):
        merged_part_names(None, PartNames((2, 5), ("arm", "arm")))


# -- resuming --------------------------------------------------------------------------------------------------------

RUN = """
import sys
from shapeforge.store import Project
from shapeforge.stages import run
project = Project.open_or_create(sys.argv[1])
options = {"meshes": [sys.argv[3]], "points": int(sys.argv[4])} if sys.argv[2] == "import" else {"rounds": 4}
for progress in run(project, sys.argv[2], jobs=1, **options):
    print(progress.phase, progress.step, flush=True)
"""


def killed_after(path: Path, stage: str, line: str, *more: object) -> None:
    """Run a stage in another process and kill it (-9) once it has printed a line."""
    command = [sys.executable, "-c", RUN, str(path), stage, *map(str, more)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}) as p:
        assert p.stdout is not None
        for printed in p.stdout:
            if printed.strip() == line:
                p.send_signal(signal.SIGKILL)
                break
        else:
            pytest.fail(f"{stage} never printed {line!r}")


@pytest.fixture(scope="session")
def labelled_and_fitted(tmp_path_factory: pytest.TempPathFactory, grouped: Project, family: Path) -> tuple:
    """A project before and after a fit of four rounds that nothing stopped."""
    folder = tmp_path_factory.mktemp("unbroken")
    labelled = copy_of(grouped, folder / "labelled")
    last(run(labelled, "label", labels=family, only="exemplars"))
    unbroken = copy_of(labelled, folder / "fitted")
    last(run(unbroken, "fit", rounds=4))
    return labelled, unbroken


@pytest.mark.parametrize("line", ["fit 2", "fit 5"], ids=["the exemplars' rounds", "the family's"])
def test_a_killed_fit_goes_on_and_ends_with_the_same_bytes(
    labelled_and_fitted: tuple, tmp_path: Path, line: str
) -> None:
    labelled, unbroken = labelled_and_fitted
    broken = copy_of(labelled, tmp_path / "broken")
    killed_after(broken.path, "fit", line)
    broken = Project.open(broken.path)
    assert status(broken)["fit"].state == "partial" and broken.fit() is None
    steps = list(run(broken, "fit", rounds=4))
    assert "goes on after round" in steps[0].message and steps[0].step >= 2
    assert contents(broken) == contents(unbroken)
    assert len(broken.rounds("chair_0000")) == broken.fit().round + 1 == 8


def test_a_killed_import_goes_on(family: Path, grouped: Project, tmp_path: Path, monkeypatch) -> None:
    killed_after(tmp_path / "p", "import", "read 3", family, POINTS)
    project = Project.open(tmp_path / "p")
    assert status(project)["import"].state in ("partial", "missing")
    last(run(project, "import"))  # it remembers what it was given
    assert project.names == grouped.names
    for mine, other in zip(project.shapes, grouped.shapes, strict=True):
        assert np.array_equal(mine.points, other.points) and np.array_equal(mine.descriptors, other.descriptors)


def test_a_stopped_learning_goes_on(done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from shapeforge import stages_model

    monkeypatch.setattr(stages_model, "SECONDS_BETWEEN_CHECKPOINTS", 0.0)
    project = copy_of(done, tmp_path / "p")
    before = project.machine()
    steps = run(project, "learn", epochs=60)
    for step in steps:
        if step.phase == "fine-tune":
            break
    steps.send(None)  # the checkpoint of the first step is written, the second step is reported
    steps.close()
    assert states(project)["learn"] == "partial" and np.array_equal(project.machine().biases[-1], before.biases[-1])
    again = list(run(project, "learn"))
    assert again[0].message.startswith("goes on") and all(not step.phase.startswith("layer") for step in again)
    assert states(project)["learn"] == "done" and not np.array_equal(project.machine().biases[-1], before.biases[-1])


def test_a_watched_fit_equals_an_unwatched_one_whatever_the_workers(done: Project, tmp_path: Path) -> None:
    """The finished one had one worker and nobody looked."""
    project = copy_of(done, tmp_path / "p")
    for progress in run(project, "fit", restart=True, jobs=3):
        assert isinstance(progress, Progress)
        if progress.state is not None:
            np.linalg.norm(progress.state.templates[0].points)
    assert contents(project) == contents(done)


def test_workers_take_their_input_as_they_go() -> None:
    """Results in order, no more than twice as many shapes in flight as workers, errors come through."""
    taken: list[int] = []
    lock = threading.Lock()
    given = 0

    def shapes() -> object:
        nonlocal given
        for i in range(40):
            with lock:
                taken.append(i)
                assert len(taken) - given <= 2 * 3 + 1
            yield i

    workers = Workers(3)

    def work(i: int) -> int:
        time.sleep(0.001 * (i % 3))
        return i * i

    for i, result in enumerate(workers.map(work, shapes())):
        with lock:
            given += 1
        assert result == i * i
    with pytest.raises(ZeroDivisionError):
        list(workers.map(lambda i: 1 // i, [1, 0]))
    workers.close()
    with pytest.raises(ValueError, match="jobs: wanted at least 1, got 0"):
        Workers(0)


# -- refine ----------------------------------------------------------------------------------------------------------


def test_the_prior_reaches_the_template_points_it_is_about() -> None:
    """Against the definition in loops: the precision-weighted mean over the top-level points a template point is in."""
    rng = np.random.default_rng(0)
    k, n = 7, 5
    index, weight = rng.integers(0, n - 1, (k, 3)).astype(np.int32), rng.random((k, 3))
    exists = np.array([True] * (k - 1) + [False])
    mean, precision = rng.random((k, 3)), rng.random((k, 3))
    mean[2] = np.nan
    got_mean, got_precision = on_template(mean, precision, Link(index, weight, exists), n)
    for i in range(n):
        for axis in range(3):
            total = moment = 0.0
            for a in range(k):
                for j in range(3):
                    if index[a, j] == i and exists[a] and a != 2:
                        total += weight[a, j] * precision[a, axis]
                        moment += weight[a, j] * precision[a, axis] * mean[a, axis]
            assert got_precision[i, axis] == pytest.approx(total)
            assert got_mean[i, axis] == pytest.approx(moment / total if total else 0.0)
    assert (got_precision[n - 1] == 0).all()


def errors_one_by_one(monkeypatch: pytest.MonkeyPatch, errors: list[float]) -> None:
    """What the shapes set aside say: as it was, refined, as it was, refined, …; the templates always lie better."""
    said = iter(errors)
    monkeypatch.setattr("shapeforge.generative.joint.mostly_falls", lambda before, after: True)
    monkeypatch.setattr(
        "shapeforge.generative.joint.held_out_errors", lambda machine, positions, _: np.full(len(positions), next(said))
    )


@pytest.mark.slow
def test_refine_replaces_fit_and_machine(done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = copy_of(done, tmp_path / "p")
    before, machine = contents(project), project.machine()
    errors_one_by_one(monkeypatch, [0.02, 0.01])
    last(run(project, "refine", alternations=1))
    assert states(project)["refine"] == "done" and states(project)["synthesize"] == "stale"
    assert project.fit_stage == project.machine_stage == "refine"
    assert contents(project) != before and project.fit().round == 4
    assert not np.array_equal(project.machine().couplings[0], machine.couplings[0])
    last(run(project, "fit", rounds=1))
    assert project.fit_stage == "fit" and states(project)["refine"] == "stale"


@pytest.mark.slow
def test_refine_starts_from_the_fit_however_often_and_adds_to_its_rounds(
    done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(done, tmp_path / "p")
    rounds = len(project.round_figures())
    found = []
    for restart in (False, True):
        errors_one_by_one(monkeypatch, [0.02, 0.01])
        last(run(project, "refine", alternations=1, restart=restart))
        found.append(contents(project))
        assert len(project.round_figures()) == len(project.rounds("chair_0003")) == rounds + 1
    assert found[0] == found[1]
    (project.current_folder("refine") / "fit.zarr.zip").unlink()
    errors_one_by_one(monkeypatch, [0.02, 0.01])
    last(run(project, "refine"))
    assert contents(project) == found[0], "what was lost is made again"


@pytest.mark.slow
def test_refine_keeps_what_was_when_shapes_set_aside_get_worse(
    done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(done, tmp_path / "p")
    before, machine = contents(project), project.machine()
    errors_one_by_one(monkeypatch, [0.02, 0.021])
    final = last(run(project, "refine", alternations=3))
    assert "stay as they were" in final.message and "2.000% to 2.100%" in final.message
    summary = project.stage_record("refine")["summary"]
    assert summary["kept"] == 0 and len(summary["held_out_errors"]) == 1, "it was the last"
    assert states(project)["refine"] == "done" and project.fit_stage == project.machine_stage == "refine"
    assert contents(project) == before
    for mine, other in zip(project.machine().weights, machine.weights, strict=True):
        np.testing.assert_array_equal(mine, other)


@pytest.mark.slow
def test_an_alternation_that_was_refused_is_undone_and_the_one_before_it_stays(
    done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    once, twice = copy_of(done, tmp_path / "once"), copy_of(done, tmp_path / "twice")
    errors_one_by_one(monkeypatch, [0.02, 0.01])
    last(run(once, "refine", alternations=1))
    errors_one_by_one(monkeypatch, [0.02, 0.01, 0.01, 0.03])
    last(run(twice, "refine", alternations=3))
    assert twice.stage_record("refine")["summary"]["kept"] == 1 and contents(twice) == contents(once)


@pytest.mark.slow
def test_refine_keeps_what_was_when_templates_come_to_lie_worse(
    done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(done, tmp_path / "p")
    before = contents(project)
    errors_one_by_one(monkeypatch, [])
    monkeypatch.setattr("shapeforge.generative.joint.mostly_falls", lambda before, after: False)
    final = last(run(project, "refine", alternations=3))
    assert "templates lie worse" in final.message and "alternation 1 made it worse" in final.message
    assert project.stage_record("refine")["summary"]["kept"] == 0 and contents(project) == before


@pytest.mark.slow
def test_how_far_the_machine_is_trusted_is_not_measured_on_points_that_it_moved(
    done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, spreads = copy_of(done, tmp_path / "p"), []

    def noted(machine: BetaShapeMachine, *others: object) -> object:
        spreads.append(machine.spread)
        return machine_prior(machine, *others)

    monkeypatch.setattr("shapeforge.stages_refine.machine_prior", noted)
    errors_one_by_one(monkeypatch, [0.02, 0.01, 0.01, 0.005])
    last(run(project, "refine", alternations=2))
    assert len(spreads) == 2
    np.testing.assert_array_equal(spreads[1], spreads[0])


def test_the_shapes_that_judge_are_no_exemplars_unless_named(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    for seed in range(5):
        judges = judging_shapes(project, project.names, rng=np.random.default_rng(seed))
        assert len(judges) == 2 and not set(judges.tolist()) & {0, 1}
    last(run(project, "learn", epochs=2, test=[project.names[0]]))
    assert judging_shapes(project, project.names, rng=np.random.default_rng(0)).tolist() == [0]


# -- train and test shapes, learning curve ----------------------------------------------------------------------------


def test_shapes_to_learn_from_and_to_judge_may_be_named(done: Project, tmp_path: Path) -> None:
    names = done.names
    train, test = named_split(names, None, [names[4], names[1]])
    assert train.tolist() == [0, 2, 3, 5] and test.tolist() == [1, 4]
    train, test = named_split(names, names[:3], [names[5]])
    assert train.tolist() == [0, 1, 2] and test.tolist() == [5]
    assert named_split(names, None, None) is None
    for wrong in ((["nobody"], None), (names[:2], names[1:3]), (names[:1], None)):
        with pytest.raises(StageError, match="--train"):
            named_split(names, *wrong)
    project = copy_of(done, tmp_path / "p")
    last(run(project, "learn", epochs=2, test=[names[4], names[1]]))
    summary = project.stage_record("learn")["summary"]
    assert summary["shapes"] == 4 and "held-out" in summary["text"] and np.isfinite(summary["held_out_error"])
    assert len(project.mixture().codes) == 4 and len(project.descriptors()[0]) == len(names)
    assert states(project)["learn"] == "done"


def test_the_learning_curve_says_whether_more_shapes_would_help(done: Project, tmp_path: Path, monkeypatch) -> None:
    with pytest.raises(ValueError, match="fewer than 10"):
        list(curve(done))
    project = copy_of(done, tmp_path / "p")
    last(run(project, "learn", epochs=2, test=[project.names[5]]))
    monkeypatch.setattr("shapeforge.generative.learning.STEPS", 30)
    with pytest.raises(ValueError, match="at least 2"):
        list(curve(project))  # a quarter of five shapes is one
    last(run(project, "learn", epochs=2, train=list(project.names[:4])))
    monkeypatch.setattr("shapeforge.generative.curve.SHARES", (0.5, 1.0))
    steps = list(curve(project))
    assert [point.shapes for point in steps[-1].state] == [2, 4] and "more shapes would" in steps[-1].message


def test_first_parts_bring_exemplars_unless_they_were_chosen_by_hand(tmp_path: Path, grouped: Project):
    by_hand = copy_of(grouped, tmp_path / "hand")
    proposal = last(run(by_hand, "cosegment", parts=3)).state
    assert proposal.exemplars.tolist() == by_hand.groups.exemplars.tolist()
    automatic = copy_of(grouped, tmp_path / "auto")
    last(run(automatic, "group", exemplars=["auto"]))
    proposal = last(run(automatic, "cosegment", parts=4)).state
    groups = automatic.groups
    count = [len(np.unique(s.argmax(axis=1))) for s in proposal.segmentation]
    for g, exemplar in enumerate(proposal.exemplars):
        assert groups.group[exemplar] == g
    assert starting_groups(automatic).exemplars.tolist() == proposal.exemplars.tolist()
    assert max(count) == 4
    name = automatic.names[groups.exemplars[0]]
    automatic.set_labels(name, np.zeros(automatic.shape_record(name)["n_faces"], np.int32))
    assert starting_groups(automatic).exemplars.tolist() == groups.exemplars.tolist()


def test_proposed_parts_are_put_right_without_being_sought_again(tmp_path: Path, grouped: Project, monkeypatch):
    project = copy_of(grouped, tmp_path / "p")
    first = last(run(project, "cosegment", parts=4)).state
    with monkeypatch.context() as patch:
        patch.setattr("shapeforge.deformation.boxes.propose_parts", None)
        last(run(project, "cosegment", edits=edits_of(project, ["merge", "part 1", "part 3"])))
        project = Project.open(project.path)
        named = last(run(project, "cosegment", edits=edits_of(project, ["rename", "part 4", "arm"]))).state
    assert named.part_names == project.part_names.names == ("part 1", "part 2", "arm")
    before, after = (np.concatenate([s.argmax(axis=1) for s in one.segmentation]) for one in (first, named))
    assert np.array_equal(after, np.array([0, 1, 0, 2])[before])
    assert starting_parts(project)[1] == named.part_names
    with pytest.raises(ValueError, match="got 'part 3'"):
        last(run(project, "cosegment", edits=edits_of(project, ["split", "part 3"])))
    assert edits_of(project) == [["merge", "part 1", "part 3"], ["rename", "part 4", "arm"]]
    assert states(project)["cosegment"] == "done"
    last(run(project, "cosegment", parts=3))  # other parts: the edits were about those before
    assert edits_of(project) == [] and project.part_names.names == ("part 1", "part 2", "part 3")


# -- a fit taken up again --------------------------------------------------------------------------------------------


def paint_some(project: Project, family: Path, name: str) -> None:
    """A few faces of a shape, as the truth has them."""
    faces = read_seg(family / f"{name}.seg", project.shape_record(name)["n_faces"], project.part_names)
    project.set_labels(name, np.where(np.arange(len(faces)) % 7 == 0, faces, -1).astype(np.int32))


def test_a_corrected_shape_is_found_anew_and_the_fit_goes_on(done: Project, family: Path, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    before, rounds = project.fit(), len(project.round_figures())
    assert corrections(project).names == () and corrections(project).why == "Nothing was painted since the fit."
    paint_some(project, family, "chair_0003")
    assert corrections(project) == Corrections(painted=("chair_0003",))
    told = list(run(project, "fit", warm=True, jobs=1))
    after = project.fit()
    assert after.round == before.round + WARM_ROUNDS and any("anew" in progress.message for progress in told)
    assert states(project)["fit"] == "done" and states(project)["learn"] == "stale"
    painted = project.labels("chair_0003")
    assert (project.face_labels("chair_0003")[painted >= 0] == painted[painted >= 0]).mean() > 0.95
    assert len(project.round_figures()) == rounds + WARM_ROUNDS, "the rounds before are kept"
    assert list(run(project, "fit", jobs=1))[-1].message == "fit is up to date: nothing to do"
    paint_some(project, family, "chair_0004")
    last(run(project, "fit", jobs=1))
    assert project.fit().round == before.round, "unless it is said again, a fit begins at the start"


def test_a_killed_refit_goes_on_and_ends_with_the_same_bytes(done: Project, family: Path, tmp_path: Path) -> None:
    unbroken = copy_of(done, tmp_path / "unbroken")
    paint_some(unbroken, family, "chair_0003")
    broken = copy_of(unbroken, tmp_path / "broken")
    last(run(unbroken, "fit", warm=True, jobs=1))
    stopped = run(broken, "fit", warm=True, jobs=1)
    first = unbroken.fit().round - WARM_ROUNDS
    while next(stopped).step != first + 1:
        pass
    stopped.close()
    assert states(broken)["fit"] == "partial"
    last(run(broken, "fit", jobs=1))
    assert contents(broken) == contents(unbroken)


def test_a_lost_file_of_a_refit_is_written_again_and_the_others_stay(
    done: Project, family: Path, tmp_path: Path
) -> None:
    project = copy_of(done, tmp_path / "p")
    paint_some(project, family, "chair_0003")
    last(run(project, "fit", warm=True, jobs=1))
    found, state = contents(project), project.fit()
    for lost in ("shapes/chair_0002", "hierarchy"):
        (project.current_folder("fit") / f"{lost}.zarr.zip").unlink()
        assert states(project)["fit"] == "stale"
        last(run(project, "fit", jobs=1))
        assert contents(project) == found and project.fit().round == state.round
    (project.current_folder("fit") / "fit.zarr.zip").unlink()
    told = [progress.message for progress in run(project, "fit", jobs=1)]
    assert any("starts anew: There is no finished fit." in message for message in told)
    after = project.fit()
    for t, name in enumerate(project.names):  # nothing is left of the fit that is gone
        assert np.array_equal(project.beliefs(name).deformed, blend(after.candidates[t]).deformed)


def test_a_refit_that_cannot_be_says_why_and_starts_anew(done: Project, family: Path, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    exemplar = project.names[project.groups.exemplars[0]]
    before = project.fit().round
    project.set_part_names(replace(project.part_names, names=("other", *project.part_names.names[1:])))
    paint_some(project, family, exemplar)
    assert corrections(project).why == "The parts are others than in the fit."
    told = [progress.message for progress in run(project, "fit", warm=True, jobs=1)]
    assert any("starts anew: The parts are others" in message for message in told)
    assert project.fit().round == before


def test_much_paint_on_what_was_bare_in_the_fit_is_known_before_a_refit(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    exemplar = project.names[project.groups.exemplars[0]]
    whole = project.labels(exemplar)
    bare = np.where(whole == np.bincount(whole).argmax(), -1, whole).astype(np.int32)
    project.set_labels(exemplar, bare)
    told = corrections(project).why
    assert told.startswith(f"Much of {exemplar} was painted in the fit and no longer is")
    assert warm_start(project) == (None, told), "the fit itself says the same"
    last(run(project, "fit", jobs=1))
    project.set_labels(exemplar, whole)
    told = corrections(project).why
    assert told.startswith(f"Much of {exemplar} was unpainted in the fit")
    assert warm_start(project) == (None, told), "the fit itself says the same"
    little = bare.copy()
    little[np.flatnonzero(bare < 0)[: len(bare) // 50]] = whole.max()
    project.set_labels(exemplar, little)
    assert corrections(project).why == "" and warm_start(project)[1] == ""


def test_a_repainted_exemplar_makes_its_templates_again_and_old_rounds_keep_their_figures(
    done: Project, family: Path, tmp_path: Path
) -> None:
    project = copy_of(done, tmp_path / "p")
    exemplar = project.names[project.groups.exemplars[0]]
    faces = project.labels(exemplar)
    largest, second = np.argsort(-np.bincount(faces))[:2]
    project.set_labels(exemplar, np.where(faces == largest, second, faces).astype(np.int32))
    assert corrections(project) == Corrections((exemplar,), (exemplar,))
    before, rounds = project.fit(), len(project.round_figures())
    last(run(project, "fit", warm=True, jobs=1))
    after = project.fit()
    assert after.round > before.round and len(project.round_figures()) == rounds + after.round - before.round
    template = next(one for one in after.templates if one.source == exemplar)
    assert largest not in template.label and second in template.label
    figures = project.round_figures()
    of_it = [g for g, one in enumerate(after.templates) if one.source == exemplar]
    assert all(not np.isin(one["template"], of_it).any() for one in figures[: rounds - 1]), "others"
    assert np.isfinite([one["energy"] for one in figures[1:]]).all()
    assert states(project)["fit"] == "done"


def test_new_shapes_are_taken_into_a_fit_whose_exemplars_stay(done: Project, family: Path, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    exemplars = [project.names[t] for t in project.groups.exemplars]
    before, rounds = project.fit(), len(project.round_figures())
    points = {name: project.beliefs(name).deformed for name in project.names}
    write_family(tmp_path / "more", "chairs", 2, seed=91)
    for number, file in enumerate(sorted((tmp_path / "more").glob("*.obj"))):
        file.rename(file.with_name(f"a_new_{number}.obj"))  # they come first: every other shape gets another number
    last(run(project, "import", meshes=[tmp_path / "more"]))
    assert corrections(project).new == ("a_new_0", "a_new_1") and not corrections(project).why
    told = list(run(project, "fit", warm=True, jobs=1))
    assert [project.names[t] for t in project.groups.exemplars] == exemplars, "painted exemplars stay"
    assert any("found anew" in progress.message for progress in told)
    assert project.fit().round == before.round + WARM_ROUNDS and project.fit_names == project.names
    assert len(project.round_figures()) == rounds + WARM_ROUNDS
    recorded = [len(one) for one in project.rounds("a_new_0")]
    assert recorded[: rounds - 1] == [0] * (rounds - 1) and min(recorded[rounds - 1 :]) > 0
    moved = [np.linalg.norm(project.beliefs(name).deformed - old, axis=1).mean() for name, old in points.items()
             if len(project.beliefs(name).deformed) == len(old)]  # fmt: skip
    assert len(moved) == len(points) and np.median(moved) < 0.03
    assert states(project)["fit"] == "done" and corrections(project).names == ()


def test_a_shape_turned_since_the_fit_is_found_anew(done: Project, tmp_path: Path) -> None:
    project = copy_of(done, tmp_path / "p")
    exemplars = {int(t) for t in project.groups.exemplars}
    name = next(name for t, name in enumerate(project.names) if t not in exemplars)
    turn_by_hand(project, {name: np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])})
    assert corrections(project).new == (name,)
    last(run(project, "fit", warm=True, jobs=1))
    beliefs, shape = project.beliefs(name), project.shapes.named(name)
    gap = np.linalg.norm(beliefs.deformed[:, None] - shape.points[None], axis=2).min(axis=1)
    assert np.median(gap) < 0.02, "the templates lie on the surface as it is now"


def test_a_shape_corrected_after_an_automatic_start_is_evidence(grouped: Project, family: Path, tmp_path: Path) -> None:
    project = copy_of(grouped, tmp_path / "p")
    last(run(project, "cosegment", parts=3, jobs=1))
    last(run(project, "fit", rounds=2, jobs=1))
    exemplars = set(starting_groups(project).exemplars.tolist()) | set(project.groups.exemplars.tolist())
    name = next(name for t, name in enumerate(project.names) if t not in exemplars)
    faces = project.face_labels(name)
    project.set_labels(name, np.where(np.arange(len(faces)) % 5 == 0, (faces + 1) % 3, -1).astype(np.int32))
    assert starting_parts(project)[2] is not None and corrections(project) == Corrections((name,))
    last(run(project, "fit", warm=True, jobs=1))
    painted = project.labels(name)
    assert (project.face_labels(name)[painted >= 0] == painted[painted >= 0]).mean() > 0.9
    last(run(project, "fit", rounds=2, jobs=1, restart=True, warm=False))
    assert states(project)["fit"] == "done"


# -- groups made by hand ---------------------------------------------------------------------------------------------


def test_new_shapes_join_groups_made_by_hand_which_stay(grouped: Project, tmp_path: Path) -> None:
    project = copy_of(grouped, tmp_path / "p")
    write_family(tmp_path / "more", "chairs", 2, seed=9, broken=0.0, classes=CLASSES)
    found = project.groups
    moved = found.group.copy()
    moved[5], moved[3] = -1, 1 - moved[3]  # left out, and moved to the other group
    by_hand = replace(found, group=moved, names=("mine", "yours"))
    project.set_groups(by_hand, by_hand=True)
    before = dict(zip(project.names, moved.tolist(), strict=True))
    last(run(project, "import", meshes=[tmp_path / "more"], points=POINTS))
    told = list(run(project, "group"))
    groups = project.groups
    after = dict(zip(project.names, groups.group.tolist(), strict=True))
    assert {name: after[name] for name in before} == before and groups.names == ("mine", "yours")
    assert sorted(project.names[t] for t in groups.exemplars) == ["chair_0000", "chair_0001"]
    new = [name for name in project.names if name not in before]
    assert len(new) == 2 and all(after[name] >= 0 for name in new) and "2 new shapes joined" in told[-1].message
    assert np.isfinite(groups.embedding).all()
    last(run(project, "group", restart=True))
    assert project.groups.names == ("Group 1", "Group 2") and not project.grouped_by_hand


def test_a_new_shape_joins_the_exemplar_it_is_like(grouped: Project) -> None:
    shapes, groups = grouped.shapes, grouped.groups
    without = groups.group.copy()
    members = [t for t in range(len(shapes)) if t not in groups.exemplars]
    without[members] = -1
    joined = join_groups(replace(groups, group=without), shapes, members)
    assert np.array_equal(joined.group, groups.group), "found among the same exemplars, it is the same group"


# -- which options stay ------------------------------------------------------------------------------------------------


def test_what_new_shapes_are_to_be_like_is_asked_for_anew_each_time() -> None:
    """How they are made and written stays as it was."""
    wishes = {
        "having": ["arm"], "lacking": ["leg"], "hold": ["1:2=0.9"], "like": "chair_0001", "take": ["seat=chair_0001"],
        "between": ["chair_0001", "chair_0002"],
    }  # fmt: skip
    ways = {"count": 3, "temperature": 0.5, "route": "surface", "union": True, "colours": "sources", "format": "ply"}
    assert set(wishes) | set(ways) | {"seed", "out"} == set(stages.DEFAULTS["synthesize"])
    record = {"options": options_of("synthesize", None, wishes | ways)}
    assert record["options"].items() >= (wishes | ways).items()
    later = options_of("synthesize", record, {"out": "elsewhere"})
    assert later.items() >= ways.items() and later["out"] == "elsewhere"
    assert {name: later[name] for name in wishes} == {name: stages.DEFAULTS["synthesize"][name] for name in wishes}
    assert options_of("synthesize", record, {"like": "chair_0002"})["like"] == "chair_0002"
    assert options_of("synthesize", record, {}) == record["options"], "nothing given: the last run again"


# -- what is drawn ----------------------------------------------------------------------------------------------------


def drawn(project: Project, count: int, **options: object) -> object:
    settings = {**stages.DEFAULTS["synthesize"], **options}
    return drawn_as_asked(project, settings, count, rng=np.random.default_rng(0))


def test_draws_as_asked_for(done: Project) -> None:
    machine, mixture = done.machine(), done.mixture()
    plain = drawn(done, 5)
    same = draw(machine, mixture, 5, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(plain.points, same.points)
    arm, leg = machine.part_names.index("arm"), machine.part_names.index("leg")
    found = drawn(done, 6, having=["arm"], lacking=["leg"])
    assert found.exists[:, arm].all() and not found.exists[:, leg].any()
    found = drawn(done, 3, hold=["1:2=0.9", "2:1=0"])
    assert (found.latents.layers[0][:, 1] == np.float32(0.9)).all() and (found.latents.layers[1][:, 0] == 0).all()
    first, other = done.fit_names[0], done.fit_names[3]
    way = drawn(done, 5, between=[first, other])
    near = drawn(done, 5, like=first, temperature=0.01)
    ends = [done.machine().to_positions(decode(machine, latents_of(done, machine, name)), e[None])[0]
            for name, e in ((first, way.exists[0]), (other, way.exists[4]))]  # fmt: skip
    for got, end in ((way.points[0], ends[0]), (way.points[4], ends[1]), (near.points[2], ends[0])):
        there = np.isfinite(end[:, 0]) & np.isfinite(got[:, 0])
        assert there.any() and np.linalg.norm(got - end, axis=1)[there].mean() < 2e-3


@pytest.mark.parametrize(
    "options",
    [
        {"having": ["wheel"]}, {"having": ["arm"], "lacking": ["arm"]}, {"hold": ["1:2"]}, {"hold": ["9:1=0.5"]},
        {"hold": ["1:1=2"]}, {"like": "nobody"}, {"between": ["chair_0000"]},
        {"between": ["chair_0000", "chair_0001"], "like": "chair_0000"},
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_said(done: Project, options: dict) -> None:
    with pytest.raises(StageError, match=r"wanted|called|asked for"):
        drawn(done, 2, **options)


# -- draws that nothing can be made of --------------------------------------------------------------------------------


def shape_with(**measures: float) -> SynthesizedShape:
    return SynthesizedShape(
        np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32), (), (), measures
    )  # fmt: skip


def test_a_draw_whose_parts_do_not_go_together_is_drawn_anew_and_the_best_is_kept() -> None:
    def made(gap: float) -> SynthesizedShape:
        return shape_with(largest_gap=gap, distance_from_draw=0.01)

    whole, kept = made_whole(made, 0.001, lambda turn: pytest.fail("drawn anew"))
    assert kept == 0.001 and "redrawn" not in whole.measures
    later, kept = made_whole(made, 0.1, {1: 0.2, 2: 0.002, 3: 0.0}.__getitem__)
    assert kept == 0.002 and later.measures == {"largest_gap": 0.002, "distance_from_draw": 0.01, "redrawn": 2}
    never, kept = made_whole(made, 0.1, {1: 0.2, 2: 0.05, 3: 0.3}.__getitem__)
    assert kept == 0.05 and never.measures["redrawn"] == 3 and never.measures["largest_gap"] == 0.05
    unlike = {0: shape_with(largest_gap=0.0, distance_from_draw=0.2), 1: made(0.0)}
    assert made_whole(unlike.__getitem__, 0, lambda turn: turn)[1] == 1
    assert made_whole(unlike.__getitem__, 0, lambda turn: turn, turns=0)[1] == 0
    assert made_whole(lambda _: shape_with(distance_from_draw=0.2), 7, lambda turn: turn)[1] == 7  # a new surface


def test_a_shape_in_place_of_another_says_so_and_its_recipe_makes_it_again(
    done: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, out = copy_of(done, tmp_path / "p"), tmp_path / "new"
    first = json.loads((done.path.parent / "new" / "measures.json").read_text())
    monkeypatch.setattr(stages_synthesis, "UNLIKE", 1e-6)  # nothing is ever so near
    monkeypatch.setattr(stages_synthesis, "REDRAWS", 1)
    last(run(project, "synthesize", count=2, out=str(out)))
    for name, found in json.loads((out / "measures.json").read_text()).items():
        assert found["redrawn"] == 1
        assert found["distance_from_draw"] <= first[name]["distance_from_draw"]
        recipe = read_recipe(out / f"{name}.glb.recipe.json")
        again = remake(project, recipe)
        assert again.measures["distance_from_draw"] == found["distance_from_draw"]
    assert "in place of draws" in project.stage_record("synthesize")["summary"]["text"]
