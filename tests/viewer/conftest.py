"""A small generated family as a project, imported and grouped or fitted, and the real window on it."""

from __future__ import annotations

import gc
import shutil
import time
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
    from shapeforge.viewer.qt.window import Window

    opened: list = []

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
    close_windows(opened)


def close_windows(opened: list) -> None:
    """Close windows; what they leave dies now, on this thread, and not in the event loop of the next test."""
    from PySide6.QtCore import QCoreApplication, QEvent

    for window in opened:
        window.close()
        assert not window.runner.running, "a closed window leaves no thread"
        window.deleteLater()
    opened.clear()
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


@pytest.fixture(scope="module")
def _synthesize(qapp, _learnt, sources, tmp_path_factory) -> Iterator:
    """The Synthesize place of a real window, opened once for all tests of a module: a window costs seconds."""
    from shapeforge.viewer.qt.window import Window

    folder = tmp_path_factory.mktemp("synthesize") / "chairs"
    shutil.copytree(_learnt, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SHAPEFORGE_CONFIG", str(tmp_path_factory.mktemp("settings")))
        patch.setattr("shapeforge.stages_synthesis.sources_of", lambda project: sources)
        window = Window()
        window.move(0, 0)
        window.session.open(Project.open(folder))
        window.session.place = "synthesize"
        window.show()
        wait_until(qapp, window.isVisible)
        window.activateWindow()
        wait_until(qapp, window.isActiveWindow)
        made = window.places["synthesize"]
        wait_until(qapp, lambda: made.view.frames > 0)
        yield made
        close_windows([window])


@pytest.fixture(scope="module")
def _correspondence(qapp, tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    """A real window for all tests of the Correspondence place in a module: a window costs a second."""
    from shapeforge.viewer.qt.window import Window

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SHAPEFORGE_CONFIG", str(tmp_path_factory.mktemp("settings")))
        window = Window()
        window.move(0, 0)
        yield window
        close_windows([window])


@pytest.fixture
def lightbox(_correspondence, fitted: Project, qapp) -> Iterator:
    """The Correspondence place as it is first entered, on a project of its own."""
    window = _correspondence
    place, session = window.place("correspondence"), window.session
    place.sort, place.count, place.overlaid = "high", 12, False
    place.sorting.set_value("high")
    place._colour_chosen("spread")
    session.theme, session.linked = "dark", True
    window.resize(1440, 900)
    session.open(fitted)
    session.place = "correspondence"
    window.show()
    window.activateWindow()
    wait_until(qapp, window.isActiveWindow)
    drawn = place.view.frames
    place.show(fit=True)
    wait_until(qapp, lambda: place.view.frames > drawn and not place.box.unread)
    place.centre.setFocus()
    yield place
    session.open(None)
    assert not window.runner.running


def wait_until(application, there: Callable[[], bool], seconds: float = 20.0) -> None:
    """Let the window work until something is so."""
    end = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < end, f"{there} did not come about"
        application.processEvents()
        time.sleep(0.005)


@pytest.fixture
def place(_synthesize, qapp):
    """The place as it is when it is first entered: the mean of the family, nothing moved, pinned or switched."""
    made, session = _synthesize, _synthesize.session
    made.shows.spin.set_on(False)
    made.shows.heat(None)
    made.between.end()
    made.handles.held = made.handles.pointed = None
    if made.inspector.finer_rows.isVisible():
        made.inspector._toggle_finer()
    made.shown_as.set_value("mesh")
    session.temperature, session.near, session.mesh_colours, session.selected = 1.0, False, "parts", ()
    session.theme, session.status, session.status_kind = "dark", "", "info"
    session.locked = frozenset()
    sculptor = made.sculptor
    sculptor.draws, sculptor.done, sculptor.recipes = 0, 0, sculptor.recipes[:1]
    sculptor._take_over(sculptor.recipe)
    made.wanted()
    made._show_history()
    made.view.fit()
    made.inspector._sections.verticalScrollBar().setValue(0)
    made.centre.setFocus()
    session.edit_count += 1
    return made
