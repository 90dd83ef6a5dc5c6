"""The header: where we are, the search for a shape, undo and redo, a picture, the menu."""

from __future__ import annotations

from PySide6.QtCore import QPoint, QStringListModel, Qt, QTimer
from PySide6.QtGui import QAction, QFont, QFontMetrics, QKeyEvent
from PySide6.QtWidgets import QCompleter, QFrame, QLineEdit, QMenu, QWidget

from shapeforge.viewer.actions import PLACE_NAMES, Actions, group_of, groups_of
from shapeforge.viewer.qt.bind import ENABLING, Binding, action_button, native
from shapeforge.viewer.qt.icons import refresh, set_icon
from shapeforge.viewer.qt.theme import HEADER, PADDING
from shapeforge.viewer.qt.widgets import ElidedLabel, button, clear, icon_label, label, row, separator, shortened
from shapeforge.viewer.runner import DOING, duration

SHOWN_MS = 6000
"""How long good news stay; warnings and errors stay until something else is said."""
_SIGNS = {"ok": "check", "warning": "warning", "error": "error"}


class Search(QLineEdit):
    """Finds a shape by a part of its name; Enter selects it, Escape leaves."""

    def __init__(self, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self._session = actions.session
        self.setPlaceholderText("Find a shape")
        self.setFixedWidth(232)
        self.setTextMargins(22, 0, 52, 0)
        self.setAccessibleName("Find a shape")
        self._about = f"Select a shape by a part of its name  ({native('Ctrl+K')})"
        self._names = QStringListModel(self)
        completer = QCompleter(self._names, self)
        completer.setCaseSensitivity(Qt.CaseSensitivity.CaseInsensitive)
        completer.setFilterMode(Qt.MatchFlag.MatchContains)
        completer.setMaxVisibleItems(12)
        completer.activated.connect(self._choose)
        self.setCompleter(completer)
        key = label(native("Ctrl+K"), "keycap")
        self.setLayout(row(icon_label("search"), None, key, margins=(8, 0, 6, 0)))
        self.returnPressed.connect(self._enter)
        binding.on(("project", "data"), self._show)

    def _show(self) -> None:
        project = self._session.project
        self._names.setStringList([] if project is None else list(project.names))
        self.setEnabled(project is not None)
        self.setToolTip(self._about if project is not None else f"{self._about}\nOpen or import some shapes first.")

    def _enter(self) -> None:
        wanted = self.text().strip().casefold()
        names = self._names.stringList()
        exact = [name for name in names if name.casefold() == wanted]
        found = exact or [name for name in names if wanted and wanted in name.casefold()]
        if found:
            self._choose(found[0])
        elif wanted:
            self._session.say(f"No shape has {self.text().strip()!r} in its name.", "warning")

    def _choose(self, name: str) -> None:
        self._session.shape = name
        self._session.say(f"Found {name}")
        self.clear()
        self.clearFocus()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_Escape:
            self.clear()
            self.clearFocus()
        else:
            super().keyPressEvent(event)


class Header(QFrame):
    """48 pixels high, over everything but the rail."""

    def __init__(self, actions: Actions, binding: Binding, items: dict[str, QAction]) -> None:
        super().__init__()
        self.setObjectName("header")
        self.setFixedHeight(HEADER)
        self._actions, self._items = actions, items
        self.crumbs = row(spacing=6)
        self.search = Search(actions, binding)
        self.undo = action_button(actions, "undo", binding, text="", kind="icon")
        self.redo = action_button(actions, "redo", binding, text="", kind="icon")
        self.picture = action_button(actions, "picture", binding, text="", kind="icon")
        self.more = button(icon="more", kind="icon", tooltip="Menu")
        self.more.clicked.connect(self._open_menu)
        holder = QWidget()
        holder.setLayout(self.crumbs)
        self.sign, self.status = icon_label("info"), ElidedLabel("", "text2")
        self._fade = QTimer(self, singleShot=True, interval=SHOWN_MS)
        self._fade.timeout.connect(self._hide_status)
        self.setLayout(
            row(
                holder, 16, self.sign, self.status, None, self.search, 4, separator(vertical=True), 4, self.undo,
                self.redo, 4,
                separator(vertical=True), 4, self.picture, self.more, spacing=4, margins=(PADDING, 0, 12, 0),
            )
        )  # fmt: skip
        binding.on(("project", "shape", "place", "data"), self._show)
        binding.on(ENABLING, self._show_undo)
        binding.on(("status", "running", "progress", "place", "theme"), self._show_status)

    def _show(self) -> None:
        session = self._actions.session
        clear(self.crumbs)
        if session.project is None:
            self.crumbs.addWidget(label("shapeforge", "heading"))
            return
        crumbs = [session.project.name]
        g = group_of(session, session.shape)
        if session.shape is None or session.place in ("collection", "synthesize"):
            crumbs.append(PLACE_NAMES[session.place])
        else:
            if g >= 0:
                crumbs.append(groups_of(session).names[g])
            crumbs.append(session.shape)
        for i, text in enumerate(crumbs):
            last = i == len(crumbs) - 1
            if i:
                self.crumbs.addWidget(icon_label("right", "text_off", 12))
            what = "You are here." if last else "Go to the collection."
            one = button(shortened(text, 30), kind="crumb", tooltip=f"{text}\n{what}")
            one.setEnabled(not last)
            bold = QFont(one.font())  # the last one is bold, which its hint of size does not know
            bold.setWeight(QFont.Weight.DemiBold)
            one.setMinimumWidth(QFontMetrics(bold).horizontalAdvance(one.text()) + 14 if last else 0)
            one.clicked.connect(self._to_collection)
            self.crumbs.addWidget(one)
        refresh(self, session.theme)

    def _show_status(self) -> None:
        """What was said last, and what runs elsewhere; Collection and Fit say both themselves, in their strips."""
        session = self._actions.session
        elsewhere = session.project is not None and session.place not in ("collection", "fit")
        if session.running and elsewhere:
            progress = session.progress
            text = f"{DOING.get(session.stage or '', 'Working')}…"
            if progress is not None:
                left = f" · {duration(progress.seconds_left)} left" if progress.seconds_left is not None else ""
                text = f"{DOING.get(progress.stage, progress.stage)} {progress.step} of {progress.of}{left}"
            kind = "clock"
        else:
            text, kind = session.status, _SIGNS.get(session.status_kind, "info")
        shown = elsewhere and bool(text)
        self.sign.setVisible(shown)
        self.status.setVisible(shown)
        self.status.setText(text)
        set_icon(self.sign, kind, {"check": "ok", "warning": "warning", "error": "error"}.get(kind, "text_2"))
        if shown and kind in ("check", "info"):
            self._fade.start()
        else:
            self._fade.stop()

    def _hide_status(self) -> None:
        self.sign.hide()
        self.status.hide()

    def _to_collection(self) -> None:
        self._actions.run("go_collection")

    def _show_undo(self) -> None:
        history = self._actions.session.history
        for one, verb, what in ((self.undo, "Undo", history.undo_label), (self.redo, "Redo", history.redo_label)):
            key = native("Ctrl+Z" if verb == "Undo" else "Ctrl+Shift+Z")
            one.setEnabled(what is not None)
            one.setToolTip(f"{verb} {what}  ({key})" if what else f"{verb}  ({key})\nNothing to {verb.lower()}.")

    def _open_menu(self) -> None:
        menu = build_menu(self._actions, self._items, self)
        corner = self.more.mapToGlobal(self.more.rect().bottomRight())
        menu.popup(corner - QPoint(menu.sizeHint().width(), -4))


def build_menu(actions: Actions, items: dict[str, QAction], parent: QWidget) -> QMenu:
    """The menu of what is not on show elsewhere; what cannot be done is off and its tooltip says why."""
    menu = QMenu(parent)
    menu.setToolTipsVisible(True)
    for name in _MENU:
        if name is None:
            menu.addSeparator()
            continue
        item = items[name]
        shown = menu.addAction(item.icon(), item.text(), item.trigger)
        shown.setShortcut(item.shortcut())
        shown.setEnabled(actions.verdict(name)[0])
        shown.setToolTip(item.toolTip())
    return menu


_MENU = (
    "open_project", "import_files", "import_folder", "try_demo", None, "group", "cosegment", "learn", "refine", "stop",
    None, "report", "picture", None, "theme", "help", "close_project",
)  # fmt: skip
