"""Everything the user can do, in one table: menus, tool rows, shortcuts and the notebook's buttons are built from it.

An action knows whether it can be done now and, when not, why not: a disabled button says so.  What an action needs of
the outside (a file dialog, a thread) it asks of a `Desk`; the window is one, the notebook another, a test a third.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

from shapeforge.viewer.session import PLACES, Session

Verdict = tuple[bool, str]
YES: Verdict = (True, "")

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
    """What actions ask of whoever shows them.  Every ``choose`` returns None (or nothing) when the user thinks again."""

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
        self._status: tuple[object, int, dict[str, Any]] | None = None
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

    def stage_status(self) -> Mapping[str, Any]:
        """``stages.status`` of the project, asked again only when its data changed; empty without a project."""
        session = self.session
        if session.project is None:
            return {}
        if self._status is None or self._status[:2] != (session.project, session.revision):
            from shapeforge import stages

            self._status = (session.project, session.revision, dict(stages.status(session.project)))
        return self._status[2]

    def open_project(self, path: Path) -> None:
        """Open the project in ``path`` (a folder); `store.ProjectError` says what is wrong with it."""
        from shapeforge.store import Project

        self.session.open(Project.open(path))

    def import_shapes(self, paths: tuple[Path, ...]) -> None:
        """Import mesh files and folders: into the open project, else into a new one beside the first of them."""
        from shapeforge import stages
        from shapeforge.store import Project

        project = self.session.project
        if project is None:
            first = paths[0].resolve()
            project = Project.open_or_create(free_folder(first.parent, f"{first.stem if first.is_file() else first.name}-project"))
            self.session.open(project)
        self.desk.start("import", lambda: _one_after_another(
            stages.run(project, "import", meshes=list(paths)), lambda: stages.run(project, "group")))

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

        meshes = folder / "meshes"
        write_family(meshes, "chairs", count, seed=seed)
        project = Project.open_or_create(folder / "project")
        self.session.open(project)
        self.desk.start("import", lambda: _one_after_another(
            stages.run(project, "import", meshes=[meshes]), lambda: stages.run(project, "group")))


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


# -- what has to be true ---------------------------------------------------------------------------------------------


def needs_project(session: Session) -> Verdict:
    """A project is open."""
    return YES if session.project is not None else (False, "Open a project first.")


def needs_rest(session: Session) -> Verdict:
    """A project is open and nothing runs."""
    if session.project is None:
        return needs_project(session)
    if session.running:
        return False, f"Wait until {session.stage or 'the present stage'} is done, or stop it."
    return YES


_groups_read: WeakKeyDictionary[Any, tuple[Any, Any]] = WeakKeyDictionary()


def groups_of(session: Session) -> Any:
    """The project's groups (None without), read from disk only when they changed."""
    project = session.project
    if project is None:
        return None
    stamp = (project.groups_key, project.names)
    kept = _groups_read.get(project)
    if kept is None or kept[0] != stamp:
        kept = _groups_read[project] = (stamp, project.groups)
    return kept[1]


def unpainted_exemplars(session: Session) -> tuple[str, ...]:
    """Names of the exemplars without any labels."""
    project = session.project
    groups = groups_of(session)
    if groups is None:
        return ()
    labelled = set(project.labelled)
    return tuple(project.names[i] for i in groups.exemplars if project.names[i] not in labelled)


def next_to_paint(session: Session) -> str | None:
    """The first exemplar without labels, None when all are painted."""
    names = unpainted_exemplars(session)
    return names[0] if names else None


def _stage_verdict(actions: Actions, stage: str) -> Verdict:
    can, why = needs_rest(actions.session)
    if not can:
        return can, why
    status = actions.stage_status().get(stage)
    if status is not None and status.state == "locked":
        return False, status.reason
    return YES


def place_verdict(actions: Actions, place: str) -> Verdict:
    """Whether a place can be entered and, when not, why not."""
    session = actions.session
    if session.project is None:
        return needs_project(session)
    status = actions.stage_status()
    if place == "collection":
        return YES
    if place == "paint":
        return YES if session.project.names else (False, "Import shapes first.")
    if place == "fit":
        found = status.get("fit")
        return (False, found.reason) if found is not None and found.state == "locked" else YES
    needed = {"correspondence": ("fit", "Fit the family first."), "synthesize": ("learn", "Learn the family first.")}
    stage, why = needed[place]
    found = status.get(stage)
    if place == "synthesize" and session.project.machine() is None and (found is None or found.state == "locked"):
        return False, (found.reason if found else why)
    if place == "correspondence" and not session.project.fit_names:
        return False, why
    return YES


def place_mark(actions: Actions, place: str) -> tuple[str, str]:
    """Mark of a place in the rail ("done", "running", "stale", "locked" or ""), and the sentence that explains it."""
    session = actions.session
    own = {"collection": ("import", "group"), "paint": ("label", "cosegment"), "fit": ("fit",),
           "correspondence": (), "synthesize": ("learn", "refine", "synthesize")}[place]  # fmt: skip
    if session.running and session.stage in own:
        return "running", f"{session.stage} is running"
    can, why = place_verdict(actions, place)
    if not can:
        return "locked", why
    status = actions.stage_status()
    if place == "paint":
        groups = groups_of(session)
        left = unpainted_exemplars(session)
        if groups is None:
            return "", ""
        return ("done", "Every exemplar is painted") if not left else ("", f"{len(left)} exemplars to paint")
    stage = {"collection": "group", "fit": "fit", "correspondence": "fit", "synthesize": "learn"}[place]
    found = status.get(stage)
    if found is None:
        return "", ""
    if found.state == "done":
        return "done", "Done"
    if found.state == "stale":
        return "stale", found.reason
    return "", found.reason


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
            actions.import_shapes(files)

    def import_folder(session: Session) -> None:
        folder = desk.choose_folder("Import a folder of models")
        if folder is not None:
            actions.import_shapes((folder,))

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
        Action("try_demo", "Try the demo family", demo, idle, "", "24 generated chairs, in a new folder at home", "cube"),
        Action("close_project", "Close project", lambda session: session.open(None), needs_rest, "Ctrl+W",
               "Back to the start page", "close"),
        Action("report", "Save report…", report, needs_rest, "", "One page of pictures, plots and figures", "export"),
    ]  # fmt: skip


def _stage_actions(actions: Actions) -> list[Action]:
    def starter(stage: str) -> Callable[[Session], None]:
        return lambda session: actions.start_stage(stage)

    def running(session: Session) -> Verdict:
        return YES if session.running else (False, "Nothing is running.")

    def fit_enabled(session: Session) -> Verdict:
        if session.running and session.stage == "fit":
            return YES
        return _stage_verdict(actions, "fit")

    def run_or_pause(session: Session) -> None:
        if session.running:
            actions.desk.control("resume" if session.is_paused else "pause")
        else:
            actions.start_stage("fit", restart=is_done("fit"))

    def is_done(stage: str) -> bool:
        found = actions.stage_status().get(stage)
        return found is not None and found.state == "done"

    def step(session: Session) -> None:
        if session.running:
            actions.desk.control("step")
        else:
            actions.start_stage("fit", restart=is_done("fit"))
            actions.desk.control("step")

    return [
        Action("group", "Group the shapes", starter("group"), lambda s: _stage_verdict(actions, "group"), "",
               "Find groups of similar shapes and an exemplar of each", "collection"),
        Action("cosegment", "First parts automatically", starter("cosegment"),
               lambda s: _stage_verdict(actions, "cosegment"), "", "Propose parts without painting", "piece"),
        Action("fit", "Run", run_or_pause, fit_enabled, "Space",
               "Fit the part templates to every shape; it can be paused and goes on where it was", "play", "fit"),
        Action("step", "Step", step, fit_enabled, ".", "One round, then pause", "step", "fit"),
        Action("stop", "Stop", lambda session: actions.desk.control("stop"), running, "Ctrl+.",
               "Stop after the present step; what is done is kept", "stop"),
        Action("learn", "Learn the family", starter("learn"), lambda s: _stage_verdict(actions, "learn"), "",
               "Learn the generative model from the fitted shapes", "synthesize"),
        Action("refine", "Refine", starter("refine"), lambda s: _stage_verdict(actions, "refine"), "",
               "Fit and learn in turns, three times", "swap"),
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
        Action(f"go_{place}", PLACE_NAMES[place], goer(place), lambda s, place=place: place_verdict(actions, place),
               f"Ctrl+{number}", "", place)
        for number, place in enumerate(PLACES, start=1)
    ]  # fmt: skip
    return places + [
        Action("find", "Find a shape", lambda s: desk.show("search"), needs_project, "Ctrl+K", "Find a shape", "search"),
        Action("undo", "Undo", lambda session: session.undo(), undo_enabled, "Ctrl+Z", "", "undo"),
        Action("redo", "Redo", lambda session: session.redo(), redo_enabled, "Ctrl+Shift+Z", "", "redo"),
        Action("picture", "Save picture…", picture, shortcut="Ctrl+Shift+S", tooltip="A picture of the window",
               icon="camera"),
        Action("theme", "Dark or light", theme, tooltip="Change between the dark and the light theme", icon="sun"),
        Action("help", "Keyboard shortcuts", lambda s: desk.show("help"), shortcut="F1", icon="keyboard"),
    ]  # fmt: skip


def _collection_actions(actions: Actions) -> list[Action]:
    return [
        Action("paint_next", "Paint the next exemplar", _paint_next, _can_paint_next, "", "Paint the parts of the next exemplar", "right",
               "collection"),
        Action("look_at", "Look at it", _look_at, _has_shape, "Return", "Open the selected shape in Paint", "eye",
               "collection"),
        Action("make_exemplar", "Make it the exemplar", make_exemplar, can_make_exemplar, "E",
               "The exemplar is the shape you paint for its group", "star", "collection"),
        Action("leave_out", "Leave it out", leave_out, can_leave_out, "X", "Take the shape out of its group, or put it back",
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


def group_of(session: Session, name: str | None) -> int:
    """Number of the group of a shape; -1 when it has none (left out, or nothing is grouped)."""
    groups = groups_of(session)
    if groups is None or name not in session.project.names:
        return -1
    return int(groups.group[session.project.names.index(name)])


def can_make_exemplar(session: Session) -> Verdict:
    """The selected shape belongs to a group that another stands for."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    if session.shape is None:
        return False, "Select a shape first."
    g = group_of(session, session.shape)
    if g < 0:
        return False, f"{session.shape} belongs to no group."
    if session.project.names[groups_of(session).exemplars[g]] == session.shape:
        return False, f"{session.shape} is the exemplar already."
    return YES


def make_exemplar(session: Session) -> None:
    """Let the selected shape stand for its group; can be undone."""
    project, name = session.project, session.shape
    g = group_of(session, name)
    before = groups_of(session)
    exemplars = before.exemplars.copy()
    exemplars[g] = project.names.index(name)
    _change_groups(session, f"exemplar {name}", before, dataclasses.replace(before, exemplars=exemplars))
    session.say(f"{name} is the exemplar of {before.names[g]}", "ok")


def can_leave_out(session: Session) -> Verdict:
    """The selected shape is grouped and no exemplar (or was left out: then it can be put back)."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    if session.shape is None or groups_of(session) is None:
        return False, "Select a grouped shape first."
    if session.project.names.index(session.shape) in groups_of(session).exemplars:
        return False, f"{session.shape} is an exemplar: choose another one for its group first."
    return YES


def leave_out(session: Session) -> None:
    """Take the selected shape out of its group; a shape left out joins the group of its nearest neighbour again."""
    import numpy as np

    project, name = session.project, session.shape
    t, before = project.names.index(name), groups_of(session)
    group = before.group.copy()
    if group[t] >= 0:
        group[t] = -1
        text = f"leave out {name}"
    else:
        distance = np.linalg.norm(before.embedding[before.exemplars] - before.embedding[t], axis=1)
        group[t] = int(distance.argmin())
        text = f"put back {name}"
    _change_groups(session, text, before, dataclasses.replace(before, group=group))


def _change_groups(session: Session, label: str, before: Any, after: Any) -> None:
    def put(groups: Any) -> None:
        session.project.set_groups(groups)
        session.touch("groups")

    session.do(label, lambda: put(after), lambda: put(before))
