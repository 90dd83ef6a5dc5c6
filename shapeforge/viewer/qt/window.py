"""The main window: one frame for all five places, so that nothing moves when the place changes."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
from typing import Any, Protocol, runtime_checkable

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QAction, QCloseEvent, QDragEnterEvent, QDropEvent, QKeySequence, QShowEvent
from PySide6.QtOpenGLWidgets import QOpenGLWidget
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QFileDialog,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QStackedWidget,
    QWidget,
)

from shapeforge.viewer.actions import PLACE_NAMES, Actions, place_verdict
from shapeforge.viewer.preload import preload
from shapeforge.viewer.qt import icons
from shapeforge.viewer.qt.bind import ENABLING, Binding, native, tooltip_of
from shapeforge.viewer.qt.collector import Collector
from shapeforge.viewer.qt.header import Header
from shapeforge.viewer.qt.rail import Rail
from shapeforge.viewer.qt.start_page import EmptyPlace, StartPage, dropped_paths, take_drop
from shapeforge.viewer.qt.theme import INSPECTOR, MINIMUM_SIZE, STRIP, TOOL_ROW, font, style_sheet
from shapeforge.viewer.qt.widgets import column, label
from shapeforge.viewer.recent import remember
from shapeforge.viewer.runner import Runner, deliver
from shapeforge.viewer.session import PLACES, Session

LONGEST_WAIT = 10.0
"""Seconds a closing window waits for the step that is running; all that is recorded is on disk before that."""

_CLASSES = {
    "collection": "collection_panel:CollectionPlace",
    "paint": "paint_panel:PaintPlace",
    "fit": "fit_panel:FitPlace",
    "correspondence": "correspondence_panel:CorrespondencePlace",
    "synthesize": "synthesize_panel:SynthesizePlace",
}


@runtime_checkable
class Place(Protocol):
    """One place: what it puts into the four pieces of the frame, and what it does when it is entered and left."""

    toolbar_widget: QWidget
    centre: QWidget
    inspector: QWidget
    strip: QWidget

    def enter(self) -> None: ...

    def leave(self) -> None: ...


class _Mail(QObject):
    """Carries "there is news" from the runner's thread to the window's."""

    arrived = Signal()


def _make_place(name: str, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> Place:
    module, _, kind = _CLASSES[name].partition(":")
    found = importlib.import_module(f"shapeforge.viewer.qt.{module}")
    return getattr(found, kind)(session, actions, view_factory)


def _make_view(session: Session) -> QWidget:
    from shapeforge.viewer.qt.view3d import View3D

    return View3D(session)


class Window(QWidget):
    """Rail 80, header 48, tool row 44, inspector 312, strip 104 pixels; the places fill it one at a time.

    A place is built when it is first entered.  The window is the desk of its actions: dialogs, the thread, pictures.
    """

    def __init__(self, session: Session | None = None) -> None:
        super().__init__()
        self.setObjectName("root")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setWindowTitle("shapeforge")
        self.setMinimumSize(*MINIMUM_SIZE)
        self.resize(1440, 900)
        self.setAcceptDrops(True)
        self.session = session if session is not None else Session()
        self.setProperty("theme", self.session.theme)
        # The style sheet changes sizes and weights only; the family and its tabular figures come from here.
        QApplication.setFont(font())
        self.setStyleSheet(style_sheet(self.session.theme))
        # A window that gets its first GL widget while it is shown is made anew by Qt: it flickers and loses the focus.
        self._surface = QOpenGLWidget(self)
        self._surface.setFixedSize(0, 0)
        self._surface.hide()
        self._collector = Collector(self)
        self._mail = _Mail(self)
        self._mail.arrived.connect(self._read_mail)
        self.runner = Runner(self._mail.arrived.emit)
        self.binding = Binding(self.session)
        self.actions_table = Actions(self.session, self)
        self.places: dict[str, Place] = {}
        self._items: dict[str, QAction] = {}
        self._entered: str | None = None
        self._preload: Thread | None = None
        self._remembered: Path | None = None
        self._build()
        self.binding.on(("theme",), self._show_theme)
        self.binding.on(("project", "place"), self._show_place)
        self.binding.on(("data",), self._show_place, now=False)
        self.binding.on((*ENABLING, "theme"), self._show_actions)

    # -- the frame -------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        self._install()
        self.rail = Rail(self.actions_table, self.binding)
        self.header = Header(self.actions_table, self.binding, self._items)
        self.stacks = {name: QStackedWidget() for name in ("toolrow", "centre", "strip", "inspector")}
        for name, stack in self.stacks.items():
            stack.setObjectName(name)
            stack.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.stacks["toolrow"].setFixedHeight(TOOL_ROW)
        self.stacks["strip"].setFixedHeight(STRIP)
        self.stacks["inspector"].setFixedWidth(INSPECTOR)
        frame = QFrame()
        grid = QGridLayout(frame)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(0)
        grid.addWidget(self.stacks["toolrow"], 0, 0)
        grid.addWidget(self.stacks["centre"], 1, 0)
        grid.addWidget(self.stacks["strip"], 2, 0)
        grid.addWidget(self.stacks["inspector"], 0, 1, 3, 1)
        grid.setRowStretch(1, 1)
        grid.setColumnStretch(0, 1)
        self.start_page = StartPage(self.actions_table, self.binding)
        self.pages = QStackedWidget()
        self.pages.addWidget(self.start_page)
        self.pages.addWidget(frame)
        outer = QHBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.setSpacing(0)
        outer.addWidget(self.rail)
        outer.addLayout(column(self.header, self.pages, spacing=0), 1)

    def _install(self, pieces: dict[str, tuple[QWidget, ...]] | None = None) -> None:
        """A QAction for every action that has none yet; a place's own keys work while one of its pieces has the focus.

        Enter, Space and the arrows belong to whatever button or slider has the focus, so outside of the centre (the
        first piece) they are no shortcuts.
        """
        for name, action in self.actions_table.items():
            owners = (self,) if action.place is None else (pieces or {}).get(action.place, ())
            if name in self._items or not owners:
                continue
            owner = owners[0]
            item = QAction(action.label, owner)
            if action.place is not None:
                item.setShortcutContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            item.setShortcut(QKeySequence(action.shortcut))
            # Always on: a key pressed in vain puts its reason into the status.
            item.triggered.connect(lambda _=False, name=name: self.actions_table.run(name))
            far = owners if action.shortcut == "Escape" or len(action.shortcut.split("+")[-1]) == 1 else owners[:1]
            for one in far:
                one.addAction(item)
            self._items[name] = item

    def place(self, name: str) -> Place:
        """A place, built now if it has not been."""
        if name not in self.places:
            try:
                made = _make_place(name, self.session, self.actions_table, lambda: _make_view(self.session))
            except ModuleNotFoundError as error:
                if not (error.name or "").startswith("shapeforge"):
                    raise
                made = EmptyPlace(PLACE_NAMES[name], "This place is not part of this installation.")
            pieces = (made.toolbar_widget, made.centre, made.strip, made.inspector)
            for stack, piece in zip(self.stacks.values(), pieces, strict=True):
                stack.addWidget(piece)
                icons.refresh(piece, self.session.theme)
            self.places[name] = made
            self._install({name: (made.centre, made.toolbar_widget, made.strip, made.inspector)})
        return self.places[name]

    def _show_place(self) -> None:
        session = self.session
        if session.project is None:
            self._leave()
            self.pages.setCurrentIndex(0)
            self.start_page.setFocus(Qt.FocusReason.OtherFocusReason)
            self.setWindowTitle("shapeforge")
            return
        can, why = place_verdict(session, session.place)
        if not can:
            session.say(why, "warning")
            session.place = "collection"
            return
        self.setWindowTitle(f"{session.project.name} – shapeforge")
        if self._remembered != session.project.path:
            self._remembered = session.project.path
            remember(session.project.path)
        self.pages.setCurrentIndex(1)
        if self._entered == session.place:
            return
        self._leave()
        made = self.place(session.place)
        pieces = (made.toolbar_widget, made.centre, made.strip, made.inspector)
        for stack, piece in zip(self.stacks.values(), pieces, strict=True):
            stack.setCurrentWidget(piece)
        self._entered = session.place
        made.enter()
        made.centre.setFocus(Qt.FocusReason.OtherFocusReason)

    def _leave(self) -> None:
        if self._entered is not None:
            self.places[self._entered].leave()
            self._entered = None

    def _show_theme(self) -> None:
        theme = self.session.theme
        self.setProperty("theme", theme)
        self.setStyleSheet(style_sheet(theme))
        icons.refresh(self, theme)
        self.update()

    def _show_actions(self) -> None:
        for name, item in self._items.items():
            item.setToolTip(tooltip_of(self.actions_table, name))
            if self.actions_table[name].icon:
                item.setIcon(icons.icon(self.actions_table[name].icon, self.session.theme))

    # -- the desk of the actions -----------------------------------------------------------------------------------

    def choose_folder(self, title: str) -> Path | None:
        """Ask for a folder."""
        # Files are shown, too: who looks for a folder of models knows it by what is in it.
        chosen = QFileDialog.getExistingDirectory(self, title, "", QFileDialog.Option(0))
        return Path(chosen) if chosen else None

    def choose_files(self, title: str, endings: tuple[str, ...]) -> tuple[Path, ...]:
        """Ask for files."""
        pattern = " ".join(f"*.{ending}" for ending in endings)
        chosen, _ = QFileDialog.getOpenFileNames(self, title, "", f"Files ({pattern});;All files (*)")
        return tuple(Path(one) for one in chosen)

    def preview_import(self, paths: tuple[Path, ...], go: Callable[[tuple[Path, ...], str], None]) -> None:
        """Show what is in the files; ``go(paths, up)`` when the user wants them."""
        from shapeforge.viewer.qt.import_dialog import ImportDialog

        self.import_dialog = ImportDialog(self.session, paths, go, self)
        self.import_dialog.open()

    def choose_save(self, title: str, name: str) -> Path | None:
        """Ask where to save."""
        chosen, _ = QFileDialog.getSaveFileName(self, title, name)
        return Path(chosen) if chosen else None

    def start(self, name: str, make: Callable[[], Iterator[Any]]) -> None:
        """Run something long in the background."""
        self.runner.start(name, make)
        self.session.stage, self.session.is_paused, self.session.progress = name, False, None
        self.session.running = True
        self.session.say("")

    def control(self, what: str) -> None:
        """Pause, resume, step or stop what runs."""
        if not self.runner.running:
            return
        getattr(self.runner, what)()
        self.session.is_paused = what == "pause"
        if what == "stop":
            self.session.say("Stopping after the present step…")

    def picture(self, path: Path) -> None:
        """Save a picture of the window."""
        shot = self.screen().grabWindow(self.winId())
        if not shot.save(str(path)):
            raise OSError(5, "The picture could not be written", str(path))

    def show(self, what: str = "") -> None:
        """Show the window or, named, the search or the help."""
        if what == "search":
            self.header.search.setFocus(Qt.FocusReason.ShortcutFocusReason)
            self.header.search.selectAll()
        elif what == "help":
            self.help_dialog().open()
        else:
            super().show()

    def help_dialog(self) -> QDialog:
        """All shortcuts, by place."""
        dialog = QDialog(self)
        dialog.setWindowTitle("Keyboard shortcuts")
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        grid = QGridLayout()
        grid.setHorizontalSpacing(16)
        grid.setVerticalSpacing(6)
        grid.setContentsMargins(24, 20, 24, 24)
        rows = 0
        for place in (None, *PLACES):
            of_place = [a for a in self.actions_table.values() if a.place == place and a.shortcut]
            if of_place:
                if rows:
                    grid.setRowMinimumHeight(rows, 8)
                grid.addWidget(label(PLACE_NAMES[place] if place else "Everywhere", "heading"), rows + 1, 0, 1, 2)
                rows += 2
            for action in of_place:
                grid.addWidget(label(native(action.shortcut), "keycap"), rows, 0, Qt.AlignmentFlag.AlignLeft)
                grid.addWidget(label(action.label.rstrip("…"), "text2"), rows, 1)
                rows += 1
        dialog.setLayout(grid)
        return dialog

    # -- the thread ------------------------------------------------------------------------------------------------

    def _read_mail(self) -> None:
        news = self.runner.take()
        if news is not None:
            deliver(news, self.session)
            if self.runner.paused:  # a single step is over
                self.session.is_paused = True

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        if self._preload is None:
            self._preload = preload()

    # -- the window itself -----------------------------------------------------------------------------------------

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        if dropped_paths(event):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        take_drop(self.actions_table, dropped_paths(event))

    def closeEvent(self, event: QCloseEvent) -> None:
        """Stop what runs (it goes on from its checkpoint next time), let go of the graphics."""
        self.binding.close()
        self._leave()
        if self.runner.running:
            self.hide()
            self.runner.stop()
            self.runner.join(LONGEST_WAIT)
        self.runner.on_news = lambda: None  # a step that takes longer than that finds nobody to tell
        self._read_mail()
        for made in self.places.values():
            close = getattr(made, "close", None)
            if close is not None:
                close()
        for view in self.findChildren(QWidget):
            shut = getattr(view, "shut", None)
            if shut is not None:
                shut()
        if self._preload is not None:
            self._preload.join(LONGEST_WAIT)
        self._collector.close()
        super().closeEvent(event)
