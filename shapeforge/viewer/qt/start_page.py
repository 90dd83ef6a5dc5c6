"""What the window shows while no project is open: three ways to begin, and a place to drop models on."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QDragEnterEvent, QDragLeaveEvent, QDropEvent
from PySide6.QtWidgets import QFrame, QPushButton, QWidget

from shapeforge.viewer.actions import MESH_ENDINGS, Actions
from shapeforge.viewer.qt.bind import Binding, native
from shapeforge.viewer.qt.controls import Clickable
from shapeforge.viewer.qt.widgets import button, clear, column, icon_label, label, row, set_style, shortened
from shapeforge.viewer.recent import recent_projects

_WAYS = (
    ("import_folder", "Import a folder of models", "obj, off, ply, stl, glb or gltf; they are copied, never changed"),
    ("open_project", "Open a project", "Go on where you were"),
    ("try_demo", "Try the demo family", "24 generated chairs, ready to group and paint"),
)


def dropped_paths(event: QDropEvent) -> tuple[Path, ...]:
    """Folders and mesh files of a drop; nothing when it holds neither."""
    paths = [Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()]
    return tuple(path for path in paths if path.is_dir() or path.suffix.lower().lstrip(".") in MESH_ENDINGS)


def take_drop(actions: Actions, paths: tuple[Path, ...]) -> None:
    """Open a dropped project folder, import anything else."""
    if len(paths) == 1 and (paths[0] / "project.json").is_file():
        actions.session.say("")
        actions.open_project(paths[0])
    elif paths:
        actions.offer_import(paths)


class StartPage(QWidget):
    """Open, import or try; or drop."""

    def __init__(self, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.setObjectName("start")
        self._actions = actions
        self.setAcceptDrops(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.ways: dict[str, Clickable] = {}
        cards = []
        for name, title, about in _WAYS:
            cards.append(self._way(name, title, about))
        self.drop = QFrame()
        self.drop.setObjectName("drop")
        self.drop.setFixedHeight(96)
        hint = label("or drop models, a folder or a project here", "text2")
        hint.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.drop.setLayout(column(hint, margins=(16, 16, 16, 16)))
        self._status = label("", "caption_error", wrap=True)
        self.recent = row(None, spacing=12)
        self.recent_links: dict[Path, QPushButton] = {}
        title = label("Understand a family of shapes", "large")
        about = label(
            "Group them, paint the parts of a few, and let the rest follow: parts and corresponding points of every "
            "shape, and new shapes of the family.",
            "text2",
            wrap=True,
        )
        inside = QWidget()
        inside.setFixedWidth(520)
        inside.setLayout(column(title, 2, about, 20, *cards, 8, self.drop, self.recent, self._status, spacing=8))
        self.setLayout(row(None, column(None, inside, None, spacing=0), None))

        def show_status() -> None:
            session = actions.session
            self._status.setText(session.status if session.status_kind in ("error", "warning") else "")

        binding.on(("status",), show_status)
        binding.on(("project",), self._show_recent)

    def _show_recent(self) -> None:
        """Links to the projects opened last; their tooltips say where they are."""
        if self._actions.session.project is not None:
            return
        clear(self.recent)
        self.recent_links = {}
        paths = recent_projects()[:4]
        self.recent.addWidget(label("Opened before:" if paths else "Projects you open are listed here.", "caption"))
        for path in paths:
            alike = sum(other.name == path.name for other in paths) > 1
            name = f"{path.parent.name}/{path.name}" if alike else path.name
            link = button(shortened(name, 24), kind="link", tooltip=str(path))
            link.clicked.connect(lambda _=False, path=path: self._open(path))
            self.recent.addWidget(link)
            self.recent_links[path] = link
        self.recent.addStretch(1)

    def _open(self, path: Path) -> None:
        try:
            self._actions.open_project(path)
        except (ValueError, OSError) as error:
            self._actions.session.say(str(error), "error")

    def _way(self, name: str, title: str, about: str) -> Clickable:
        words = column(label(title, "heading"), label(about, "caption"), spacing=1)
        key = self._actions[name].shortcut
        box = row(icon_label(self._actions[name].icon, "accent_text", 20), 4, words, None, margins=(16, 12, 16, 12))
        if key:
            box.addWidget(label(native(key), "keycap"))
        card = Clickable(box, "card")
        card.clicked.connect(lambda: self._actions.run(name))
        self.ways[name] = card
        return card

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        if dropped_paths(event):
            event.acceptProposedAction()
            set_style(self.drop, "over", "true")

    def dragLeaveEvent(self, event: QDragLeaveEvent) -> None:
        set_style(self.drop, "over", "false")

    def dropEvent(self, event: QDropEvent) -> None:
        set_style(self.drop, "over", "false")
        take_drop(self._actions, dropped_paths(event))


class EmptyPlace:
    """A place that cannot be shown: all four pieces of the frame, and the reason in the middle."""

    def __init__(self, title: str, reason: str) -> None:
        heading, words = label(title, "title"), label(reason, "text2")
        for one in (heading, words):
            one.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.toolbar_widget, self.inspector, self.strip = QWidget(), QWidget(), QWidget()
        self.centre = QWidget()
        self.centre.setLayout(column(None, heading, words, None, spacing=4))

    def enter(self) -> None:
        """Nothing to do."""

    def leave(self) -> None:
        """Nothing to do."""
