"""Every action says whether it can be done and why not, and does what it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shapeforge.store import Project
from shapeforge.viewer.actions import Actions, free_folder, groups_of, next_to_paint, place_mark, place_verdict
from shapeforge.viewer.readiness import next_step
from shapeforge.viewer.session import PLACES, Session
from tests.viewer.conftest import paint_exemplars


class PaperDesk:
    """A desk whose dialogs answer what the test wrote down."""

    def __init__(self) -> None:
        self.folder: Path | None = None
        self.files: tuple[Path, ...] = ()
        self.started: list[tuple[str, object]] = []
        self.controlled: list[str] = []
        self.shown: list[str] = []

    def choose_folder(self, title: str) -> Path | None:
        return self.folder

    def choose_files(self, title: str, endings: tuple[str, ...]) -> tuple[Path, ...]:
        return self.files

    def choose_save(self, title: str, name: str) -> Path | None:
        return None

    def start(self, name, make) -> None:
        self.started.append((name, make))

    def control(self, what: str) -> None:
        self.controlled.append(what)

    def picture(self, path: Path) -> None:
        raise AssertionError("no picture was asked for")

    def show(self, what: str) -> None:
        self.shown.append(what)


@pytest.fixture
def desk() -> PaperDesk:
    return PaperDesk()


@pytest.fixture
def actions(desk) -> Actions:
    return Actions(Session(), desk)


def test_what_cannot_be_done_says_why(actions):
    for name in actions:
        can, why = actions.verdict(name)
        assert can or why.endswith("."), f"{name} is off without a sentence that says why"


def test_labels_and_shortcuts_are_unique(actions):
    keys = [a.shortcut for a in actions.values() if a.shortcut]
    assert len(keys) == len(set(keys))
    labels = [a.label for a in actions.values()]
    assert len(labels) == len(set(labels))


def test_an_action_in_vain_becomes_a_warning(actions):
    assert not actions.run("undo")
    assert (actions.session.status, actions.session.status_kind) == ("Nothing to undo.", "warning")


def test_what_goes_wrong_becomes_a_sentence(actions, desk, tmp_path):
    desk.folder = tmp_path
    assert not actions.run("open_project")
    assert actions.session.status_kind == "error"
    assert "project" in actions.session.status
    assert actions.session.project is None


def test_thinking_again_changes_nothing(actions):
    assert actions.run("open_project")
    assert actions.run("import_files")
    assert actions.session.project is None and actions.session.status == ""


def test_a_project_opens(actions, desk, grouped):
    desk.folder = grouped.path
    assert actions.run("open_project")
    assert actions.session.project.names == grouped.names


def test_importing_without_a_project_makes_one_beside_the_models(actions, desk, meshes, tmp_path):
    models = tmp_path / "models"
    models.mkdir()
    (models / "a.obj").write_bytes((meshes / "chair_0000.obj").read_bytes())
    desk.folder = models
    assert actions.run("import_folder")
    assert Path(actions.session.project.path) == tmp_path / "models-project"
    [(name, make)] = desk.started
    assert name == "import"
    assert next(iter(make())).stage == "import"
    assert actions.session.project is not None


def test_a_folder_that_is_taken_gets_a_number(tmp_path):
    assert free_folder(tmp_path, "demo") == tmp_path / "demo"
    (tmp_path / "demo").mkdir()
    assert free_folder(tmp_path, "demo") == tmp_path / "demo", "an empty folder will do"
    (tmp_path / "demo" / "x").touch()
    assert free_folder(tmp_path, "demo") == tmp_path / "demo 2"


def test_places_open_one_after_the_other(actions, grouped, meshes):
    session = actions.session
    assert {place_mark(actions.session, place)[0] for place in PLACES} == {"locked"}
    session.open(grouped)
    assert place_mark(actions.session, "collection") == ("done", "Done")
    assert place_verdict(actions.session, "paint")[0]
    can, why = place_verdict(actions.session, "fit")
    assert not can and "labels" in why
    for place in ("correspondence", "synthesize"):
        assert place_mark(actions.session, place)[0] == "locked"
    paint_exemplars(grouped, meshes)
    session.touch("labels")
    assert place_verdict(actions.session, "fit")[0]
    assert place_mark(actions.session, "paint")[0] == "done"


def test_a_changed_exemplar_makes_the_fit_stale(actions, fitted):
    session = actions.session
    session.open(fitted)
    assert place_mark(actions.session, "fit")[0] == "done"
    groups = fitted.groups
    g = int(np.argmax([len(groups.members(g)) for g in range(len(groups))]))
    session.shape = next(fitted.names[t] for t in groups.members(g) if t != groups.exemplars[g])
    assert actions.run("make_exemplar")
    mark, why = place_mark(actions.session, "fit")
    assert mark == "stale" and "group" in why


def test_making_an_exemplar_is_written_and_can_be_taken_back(actions, grouped):
    session = actions.session
    session.open(grouped)
    before = grouped.groups
    session.shape = grouped.names[before.exemplars[0]]
    assert not actions.verdict("make_exemplar")[0]
    session.shape = next(grouped.names[t] for t in before.members(0) if t != before.exemplars[0])
    assert actions.run("make_exemplar")
    assert grouped.names[Project.open(grouped.path).groups.exemplars[0]] == session.shape
    assert actions.run("undo")
    assert (Project.open(grouped.path).groups.exemplars == before.exemplars).all()
    assert actions.run("redo")
    assert grouped.names[grouped.groups.exemplars[0]] == session.shape


def test_leaving_out_and_putting_back(actions, grouped):
    session = actions.session
    session.open(grouped)
    groups = grouped.groups
    g = int(np.argmax([len(groups.members(g)) for g in range(len(groups))]))
    t = next(int(t) for t in groups.members(g) if t != groups.exemplars[g])
    session.shape = grouped.names[t]
    assert actions.run("leave_out")
    assert grouped.groups.group[t] == -1
    assert actions.run("leave_out"), "once more puts it back"
    assert grouped.groups.group[t] >= 0
    session.shape = grouped.names[int(groups.exemplars[g])]
    can, why = actions.verdict("leave_out")
    assert not can and "exemplar" in why


def test_the_next_to_paint_is_the_first_unpainted_exemplar(actions, grouped, meshes):
    session = actions.session
    session.open(grouped)
    assert next_to_paint(session) == grouped.names[grouped.groups.exemplars[0]]
    assert actions.run("paint_next")
    assert (session.place, session.shape) == ("paint", next_to_paint(session))
    paint_exemplars(grouped, meshes)
    session.touch("labels")
    assert next_to_paint(session) is None
    assert actions.verdict("paint_next") == (False, "Every exemplar is painted.")


def test_groups_are_read_once_until_they_change(actions, grouped, monkeypatch):
    session = actions.session
    session.open(grouped)
    first = groups_of(session)
    monkeypatch.setattr(type(grouped), "groups", property(lambda self: pytest.fail("read again")))
    assert groups_of(session) is first


def test_nothing_starts_while_something_runs(actions, desk, fitted):
    session = actions.session
    session.open(fitted)
    session.running, session.stage = True, "import"
    for name in ("group", "learn", "import_files", "close_project", "fit"):
        can, why = actions.verdict(name)
        assert not can and "import" in why, name
    session.stage = "fit"
    assert actions.run("fit")
    session.is_paused = True
    assert actions.run("fit")
    assert actions.run("step")
    assert actions.run("stop")
    assert desk.controlled == ["pause", "resume", "step", "stop"]
    assert desk.started == []


def test_the_demo_family_is_made_imported_and_grouped(actions, desk, tmp_path):
    actions.try_demo(tmp_path / "demo", count=4)
    [(name, make)] = desk.started
    assert name == "import" and actions.session.project.names == ()
    stages_seen = {progress.stage for progress in make()}
    assert stages_seen == {"import", "group"}
    project = Project.open(tmp_path / "demo" / "project")
    assert len(project.names) == 4 and project.groups is not None


def test_the_next_step_leads_through_the_whole_story(fitted):
    session = Session()
    session.open(fitted)
    assert next_step(session) == ("go_correspondence", "Compare points")
    session.place = "correspondence"
    assert next_step(session) == ("learn", "Learn the family")
    first = fitted.names[int(fitted.groups.exemplars[0])]
    fitted.set_labels(first, np.full(fitted.shape_record(first)["n_faces"], -1, np.int32))
    session.touch("labels")
    assert next_step(session)[0] in ("paint_next", "go_fit"), "what was undone comes next again"
