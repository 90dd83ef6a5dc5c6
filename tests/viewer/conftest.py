"""A small generated family as a project, imported and grouped or fitted, and the real window on it."""

from __future__ import annotations

import gc
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shapeforge import stages
from shapeforge.collection.families import write_family
from shapeforge.collection.labels import PartNames, find_part_names, read_seg
from shapeforge.store import Project
from shapeforge.viewer.sculptor import Sculptor
from shapeforge.viewer.session import Session
from tests.viewer.paint_hands import Painting, hands_of

COUNT, POINTS, ROUNDS = 8, 300, 2


@pytest.fixture(autouse=True)
def _own_settings(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the program remembers between starts is not the user's in a test."""
    monkeypatch.setenv("SHAPEFORGE_CONFIG", str(tmp_path_factory.mktemp("settings")))


def run_stage(project: Project, stage: str, **options: object) -> None:
    for _ in stages.run(project, stage, jobs=1, **options):
        pass


@pytest.fixture(scope="session")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight generated chairs with their labels, and one file that cannot be read."""
    folder = tmp_path_factory.mktemp("meshes")
    write_family(folder, "chairs", COUNT, seed=3)
    (folder / "empty.obj").write_text("v 0 0 0\n")
    return folder


@pytest.fixture(scope="session")
def _grouped(tmp_path_factory: pytest.TempPathFactory, meshes: Path) -> Path:
    folder = tmp_path_factory.mktemp("grouped") / "chairs"
    project = Project.create(folder)
    run_stage(project, "import", meshes=[meshes], points=POINTS)
    run_stage(project, "group")
    return folder


@pytest.fixture(scope="session")
def _fitted(tmp_path_factory: pytest.TempPathFactory, meshes: Path, _grouped: Path) -> Path:
    folder = tmp_path_factory.mktemp("fitted") / "chairs"
    shutil.copytree(_grouped, folder)
    project = Project.open(folder)
    paint_exemplars(project, meshes)
    run_stage(project, "fit", rounds=ROUNDS)
    return folder


def paint_exemplars(project: Project, meshes: Path) -> None:
    """Label every exemplar with the truth."""
    names = find_part_names(meshes)
    project.set_part_names(names)
    for t in project.groups.exemplars:
        name = project.names[t]
        project.set_labels(name, read_seg(meshes / f"{name}.seg", project.shape_record(name)["n_faces"], names))


@pytest.fixture
def grouped(_grouped: Path, tmp_path: Path) -> Project:
    """A project of its own: eight chairs imported and grouped, nothing painted."""
    shutil.copytree(_grouped, tmp_path / "chairs")
    return Project.open(tmp_path / "chairs")


@pytest.fixture
def fitted(_fitted: Path, tmp_path: Path) -> Project:
    """A project of its own: exemplars labelled with the truth, fitted for two rounds."""
    shutil.copytree(_fitted, tmp_path / "chairs")
    return Project.open(tmp_path / "chairs")


@pytest.fixture
def painting(open_window: Callable, grouped: Project, qtbot) -> Painting:
    """The Paint place on the first exemplar, with three parts and nothing painted."""
    grouped.set_part_names(PartNames((1, 2, 3), ("back", "seat", "leg")))
    return hands_of(open_window(grouped, "paint"), qtbot)


@pytest.fixture
def open_window(qtbot) -> Iterator[Callable]:
    """``open_window(project)`` shows the real window, 1440 x 900; it is closed, and its thread ended, afterwards."""
    from PySide6.QtCore import QCoreApplication, QEvent

    from shapeforge.viewer.qt.window import Window

    opened = []

    def make(project: Project | None = None, place: str = "collection") -> Window:
        window = Window()
        window.move(0, 0)
        opened.append(window)
        if project is not None:
            window.session.open(project)
            window.session.place = place
        window.show()
        qtbot.waitExposed(window)
        window.activateWindow()
        qtbot.waitUntil(window.isActiveWindow)
        return window

    yield make
    for window in opened:
        window.close()
        assert not window.runner.running, "a closed window leaves no thread"
        window.deleteLater()
    opened.clear()
    # what a test's windows leave dies with the test, on this thread, and not in the event loop of the next one
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
    gc.collect()


@pytest.fixture(scope="session")
def _learnt(tmp_path_factory, meshes, _grouped):
    """Fitted from six painted exemplars, which have all parts between them, and learnt briefly."""
    folder = tmp_path_factory.mktemp("learnt") / "chairs"
    shutil.copytree(_grouped, folder)
    project = Project.open(folder)
    run_stage(project, "group", exemplars=list(project.names[:6]))
    paint_exemplars(project, meshes)
    run_stage(project, "fit", rounds=1, inner=1)
    run_stage(project, "learn", epochs=2)
    return folder


@pytest.fixture
def learnt(_learnt, tmp_path):
    shutil.copytree(_learnt, tmp_path / "chairs")
    return Project.open(tmp_path / "chairs")


@pytest.fixture
def sculptor(learnt):
    session = Session()
    session.open(learnt)
    made = Sculptor(session)
    assert made.reload()
    return made


@pytest.fixture(scope="session")
def sources(_learnt):
    """The parts of the family, read once for all tests."""
    from shapeforge.stages_synthesis import sources_of

    return sources_of(Project.open(_learnt))


@pytest.fixture
def place(open_window, learnt, sources, qtbot, monkeypatch):
    monkeypatch.setattr("shapeforge.stages_synthesis.sources_of", lambda project: sources)
    window = open_window(learnt, "synthesize")
    made = window.places["synthesize"]
    qtbot.waitUntil(lambda: made.view.frames > 0, timeout=20000)
    return made
