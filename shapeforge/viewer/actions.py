"""Everything the user can do, in one table: menus, tool rows, shortcuts and the notebook's buttons are built from it.

An action knows whether it can be done now and, when not, why not: a disabled button says so.  What an action needs of
the outside (a file dialog, a thread) it asks of a `Desk`; the window is one, the notebook another, a test a third.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from shapeforge.viewer.readiness import (
    YES,
    Verdict,
    corrected,
    fit_options,
    group_of,
    groups_of,
    needs_project,
    needs_rest,
    next_to_paint,
    place_mark,
    place_verdict,
    stage_status,
    stage_verdict,
    unpainted_exemplars,
)
from shapeforge.viewer.regroup import can_leave_out, can_make_exemplar, leave_out, make_exemplar
from shapeforge.viewer.session import PLACES, Session

__all__ = [
    "MESH_ENDINGS", "PLACE_NAMES", "YES", "Action", "Actions", "Desk", "Verdict", "free_folder", "group_of",
    "groups_of",
    "next_to_paint", "place_mark", "place_verdict", "unpainted_exemplars",
]  # fmt: skip

PLACE_NAMES: dict[str, str] = {
    "collection": "Collection",
    "paint": "Paint",
    "fit": "Fit",
    "correspondence": "Correspond",
    "synthesize": "Synthesize",
}
MESH_ENDINGS: tuple[str, ...] = ("obj", "off", "ply", "stl", "glb", "gltf")


@runtime_checkable
class Desk(Protocol):
    """What actions ask of whoever shows them.  Every ``choose`` gives None (or nothing) when the user thinks again."""

    def choose_folder(self, title: str) -> Path | None: ...

    def choose_files(self, title: str, endings: tuple[str, ...]) -> tuple[Path, ...]: ...

    def choose_save(self, title: str, name: str) -> Path | None: ...

    def start(self, name: str, make: Callable[[], Iterator[Any]]) -> None: ...

    def control(self, what: str) -> None: ...

    def picture(self, path: Path) -> None: ...

    def show(self, what: str) -> None: ...


@dataclasses.dataclass(frozen=True)
class Action:
    """One thing the user can do.  ``enabled(session)`` is (can it be done, why not); ``place`` None is everywhere."""

    name: str
    label: str
    run: Callable[[Session], None]
    enabled: Callable[[Session], Verdict] = lambda session: YES
    shortcut: str = ""
    tooltip: str = ""
    icon: str = ""
    place: str | None = None


class Actions(Mapping[str, Action]):
    """The table, by name.  Places add their own actions with `add`."""

    def __init__(self, session: Session, desk: Desk) -> None:
        self.session, self.desk = session, desk
        self._table: dict[str, Action] = {}
        for action in _project_actions(self) + _stage_actions(self) + _view_actions(self) + _collection_actions(self):
            self.add(action)

    def __getitem__(self, name: str) -> Action:
        return self._table[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def __len__(self) -> int:
        return len(self._table)

    def add(self, action: Action) -> Action:
        """Add an action (or replace the one of the same name)."""
        self._table[action.name] = action
        return action

    def verdict(self, name: str) -> Verdict:
        """Whether an action can be done now and, when not, why not."""
        return self[name].enabled(self.session)

    def run(self, name: str) -> bool:
        """Do it; when it cannot be done the reason becomes the status.  What goes wrong becomes a status, too."""
        from shapeforge.viewer.runner import sentence

        can, why = self.verdict(name)
        if not can:
            self.session.say(why, "warning")
            return False
        try:
            self[name].run(self.session)
        except (ValueError, RuntimeError, OSError) as error:
            # What a listener of the session raised comes wrapped: the sentence is the innermost one's.
            while type(error).__name__ == "EmitLoopError" and error.__cause__ is not None:
                error = error.__cause__
            self.session.say(sentence(error), "error")
            return False
        return True

    def open_project(self, path: Path) -> None:
        """Open the project in ``path`` (a folder); `store.ProjectError` says what is wrong with it."""
        from shapeforge.store import Project

        self.session.open(Project.open(path))

    def offer_import(self, paths: tuple[Path, ...]) -> None:
        """Show what would be imported, where the desk can; else import it at once."""
        can, why = self.verdict("import_files")
        if not can:
            self.session.say(why, "warning")
            return
        preview = getattr(self.desk, "preview_import", None)
        if preview is None:
            self.import_shapes(paths)
        else:
            preview(paths, lambda chosen, up: self.import_shapes(chosen, beside=paths[0], up=up))

    def import_shapes(self, paths: tuple[Path, ...], *, beside: Path | None = None, up: str | None = None) -> None:
        """Import mesh files and folders: into the open project, else into a new one ``beside`` the first of them.

        ``up`` as in the import stage; None: as the last import had it.
        """
        from shapeforge import stages
        from shapeforge.store import Project

        project = self.session.project
        if project is None:
            first = (beside or paths[0]).resolve()
            project = Project.open_or_create(
                free_folder(first.parent, f"{first.stem if first.is_file() else first.name}-project")
            )
            self.session.open(project)
        options = {} if up is None else {"up": up}
        self.desk.start(
            "import",
            lambda: _one_after_another(
                stages.run(project, "import", meshes=list(paths), **options), lambda: stages.run(project, "group")
            ),
        )

    def start_stage(self, stage: str, **options: Any) -> None:
        """Run one stage of the pipeline in the background."""
        from shapeforge import stages

        project = self.session.project
        self.desk.start(stage, lambda: stages.run(project, stage, **options))

    def try_demo(self, folder: Path, *, count: int = 24, seed: int = 1) -> None:
        """Make the bundled chair family in ``folder``, import it and group it."""
        from shapeforge import stages
        from shapeforge.collection.families import write_family
        from shapeforge.store import Project

        project = Project.open_or_create(folder / "project")
        self.session.open(project)

        def make() -> Iterator[Any]:
            write_family(folder / "meshes", "chairs", count, seed=seed)
            yield from stages.run(project, "import", meshes=[folder / "meshes"])
            yield from stages.run(project, "group")

        self.desk.start("import", make)


def _one_after_another(first: Iterator[Any], second: Callable[[], Iterator[Any]]) -> Iterator[Any]:
    yield from first
    yield from second()


def free_folder(parent: Path, name: str) -> Path:
    """``parent/name``, or ``name 2``, ``name 3``, … when something else is there."""
    number, path = 1, parent / name
    while path.exists() and any(path.iterdir() if path.is_dir() else [path]):
        number += 1
        path = parent / f"{name} {number}"
    return path


# -- the table -------------------------------------------------------------------------------------------------------


def _project_actions(actions: Actions) -> list[Action]:
    desk = actions.desk

    def open_project(session: Session) -> None:
        folder = desk.choose_folder("Open a project folder")
        if folder is not None:
            actions.open_project(folder)

    def import_files(session: Session) -> None:
        files = desk.choose_files("Import shapes", MESH_ENDINGS)
        if files:
            actions.offer_import(files)

    def import_folder(session: Session) -> None:
        folder = desk.choose_folder("Import a folder of models")
        if folder is not None:
            actions.offer_import((folder,))

    def demo(session: Session) -> None:
        actions.try_demo(free_folder(Path.home(), "shapeforge-demo"))

    def report(session: Session) -> None:
        path = desk.choose_save("Save the report", f"{session.project.name}.html")
        if path is not None:
            from shapeforge.viewer.report import write_report

            write_report(session.project, path)
            session.say(f"Report saved as {path.name}", "ok")

    def idle(session: Session) -> Verdict:
        return needs_rest(session) if session.project is not None else YES

    return [
        Action("open_project", "Open project…", open_project, idle, "Ctrl+O", "Open a project folder", "folder"),
        Action("import_files", "Import shapes…", import_files, idle, "Ctrl+I",
               "Mesh files: obj, off, ply, stl, glb or gltf. They are copied into the project.", "plus"),
        Action("import_folder", "Import a folder…", import_folder, idle, "Ctrl+Shift+I",
               "Every mesh file in a folder and its subfolders", "import"),
        Action("try_demo", "Try the demo family", demo, idle, "", "24 generated chairs, in a new folder at home",
               "cube"),
        Action("close_project", "Close project", lambda session: session.open(None), needs_rest, "Ctrl+W",
               "Back to the start page", "close"),
        Action("report", "Save report…", report, needs_rest, "", "One page of pictures, plots and figures", "export"),
    ]  # fmt: skip


def _stage_actions(actions: Actions) -> list[Action]:
    def starter(stage: str) -> Callable[[Session], None]:
        return lambda session: actions.start_stage(stage)

    def running(session: Session) -> Verdict:
        return YES if session.running else (False, "Nothing is running.")

    return [
        Action("group", "Group the shapes", starter("group"), lambda s: stage_verdict(s, "group"), "",
               "Find groups of similar shapes and an exemplar of each", "collection"),
        Action("cosegment", "First parts automatically", starter("cosegment"),
               lambda s: stage_verdict(s, "cosegment"), "", "Propose parts without painting", "piece"),
        *_fit_actions(actions),
        Action("stop", "Stop", lambda session: actions.desk.control("stop"), running, "Ctrl+.",
               "Stop after the present step; what is done is kept", "stop"),
        Action("learn", "Learn the family", starter("learn"), lambda s: stage_verdict(s, "learn"), "",
               "Learn the generative model from the fitted shapes", "synthesize"),
        Action("refine", "Refine", starter("refine"), lambda s: stage_verdict(s, "refine"), "",
               "Fit and learn in turns, three times", "swap"),
    ]  # fmt: skip


def _fit_actions(actions: Actions) -> list[Action]:
    def start(session: Session) -> None:
        found = stage_status(session).get("fit")
        state = None if found is None else found.state
        going_on = {} if state == "partial" else {"warm": False}
        actions.start_stage("fit", restart=state == "done", **fit_options(session) | going_on)

    def fit_enabled(session: Session) -> Verdict:
        return YES if session.running and session.stage == "fit" else stage_verdict(session, "fit")

    def run_or_pause(session: Session) -> None:
        if session.running:
            actions.desk.control("resume" if session.is_paused else "pause")
        else:
            start(session)

    def step(session: Session) -> None:
        if not session.running:
            start(session)
        actions.desk.control("step")

    def refit_enabled(session: Session) -> Verdict:
        can, why = needs_rest(session)
        why = corrected(session).why if can else why
        return not why, why

    return [
        Action("fit", "Run", run_or_pause, fit_enabled, "Space",
               "Fit the part templates to every shape; it can be paused and goes on where it was", "play", "fit"),
        Action("refit", "Refit from here", lambda session: actions.start_stage("fit", warm=True), refit_enabled,
               "Shift+R", "Find what is new or corrected, and go on with all others from where they are", "swap",
               "fit"),
        Action("step", "Step", step, fit_enabled, ".", "One round, then pause", "step", "fit"),
    ]  # fmt: skip


def _view_actions(actions: Actions) -> list[Action]:
    desk = actions.desk

    def undo_enabled(session: Session) -> Verdict:
        return YES if session.history.undo_label else (False, "Nothing to undo.")

    def redo_enabled(session: Session) -> Verdict:
        return YES if session.history.redo_label else (False, "Nothing to redo.")

    def picture(session: Session) -> None:
        path = desk.choose_save("Save a picture of the window", f"{session.shape or session.place}.png")
        if path is not None:
            desk.picture(path)
            session.say(f"Picture saved as {path.name}", "ok")

    def theme(session: Session) -> None:
        session.theme = "light" if session.theme == "dark" else "dark"

    def goer(place: str) -> Callable[[Session], None]:
        return lambda session: setattr(session, "place", place)

    places = [
        Action(f"go_{place}", PLACE_NAMES[place], goer(place), lambda s, place=place: place_verdict(s, place),
               f"Ctrl+{number}", "", place)
        for number, place in enumerate(PLACES, start=1)
    ]  # fmt: skip
    return places + [
        Action("find", "Find a shape", lambda s: desk.show("search"), needs_project, "Ctrl+K", "Find it by its name",
               "search"),
        Action("undo", "Undo", lambda session: session.undo(), undo_enabled, "Ctrl+Z", "", "undo"),
        Action("redo", "Redo", lambda session: session.redo(), redo_enabled, "Ctrl+Shift+Z", "", "redo"),
        Action("picture", "Save picture…", picture, shortcut="Ctrl+Shift+S", tooltip="A picture of the window",
               icon="camera"),
        Action("theme", "Dark or light", theme, tooltip="Change between the dark and the light theme", icon="sun"),
        Action("help", "Keyboard shortcuts", lambda s: desk.show("help"), shortcut="F1", icon="keyboard"),
    ]  # fmt: skip


def _collection_actions(actions: Actions) -> list[Action]:
    return [
        Action("paint_next", "Paint the next exemplar", _paint_next, _can_paint_next, "",
               "Paint the parts of the next exemplar", "right",
               "collection"),
        Action("look_at", "Paint it", _look_at, _has_shape, "Return", "Open the selected shape in Paint", "paint",
               "collection"),
        Action("make_exemplar", "Make it the exemplar", make_exemplar, can_make_exemplar, "E",
               "The exemplar is the shape you paint for its group", "star", "collection"),
        Action("leave_out", "Leave out", leave_out, can_leave_out, "X",
               "Take the selected shapes out of their groups, or put them back",
               "eye_off", "collection"),
    ]  # fmt: skip


def _has_shape(session: Session) -> Verdict:
    return YES if session.shape is not None else (False, "Select a shape first.")


def _look_at(session: Session) -> None:
    session.place = "paint"


def _can_paint_next(session: Session) -> Verdict:
    can, why = needs_project(session)
    if not can:
        return can, why
    if groups_of(session) is None:
        return False, "Group the shapes first."
    return YES if next_to_paint(session) else (False, "Every exemplar is painted.")


def _paint_next(session: Session) -> None:
    session.shape = next_to_paint(session)
    session.place = "paint"
