"""The groups of a collection as a list: colour, name, number of shapes and exemplar; names are changed in place."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPoint, QTimer, Signal
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QWidget

from shapeforge.viewer.actions import Actions
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Clickable, EditableName
from shapeforge.viewer.qt.icons import set_icon
from shapeforge.viewer.qt.map_drawing import group_colour
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.widgets import Picture, Swatch, button, clear, column, label, row
from shapeforge.viewer.readiness import groups_of, needs_rest
from shapeforge.viewer.regroup import rename_group
from shapeforge.viewer.session import Session


class GroupList(QWidget):
    """One row a group, the current one marked; ``picture(name, group, of)`` gives an exemplar's (None: to come)."""

    chosen = Signal(int)
    menu_wanted = Signal(int, QPoint)

    def __init__(
        self, session: Session, actions: Actions, binding: Binding, picture: Callable[[str, int, int], QPixmap | None]
    ) -> None:
        super().__init__()
        self.session, self._picture = session, picture
        self.count = label("", "off")
        self.again = action_button(actions, "group", binding, text="", kind="icon")
        set_icon(self.again, "rotate")
        self.more = button(icon="more", kind="icon", tooltip="Rename, merge or split the selected group")
        self.more.setAccessibleName("Change the selected group")
        self.rows: list[Clickable] = []
        self._names: list[EditableName] = []
        self._pictures: list[Picture] = []
        self._list = column(spacing=2)
        head = row(
            label("Groups", "heading"), self.count, None, self.again, self.more, spacing=4, margins=(PADDING, 0, 10, 4)
        )
        self.setLayout(column(head, column(self._list, margins=(8, 0, 8, 0)), spacing=0, margins=(0, 8, 0, 12)))

    def show_groups(self) -> None:
        """Show the groups as they are now."""
        clear(self._list)
        groups = groups_of(self.session)
        self.count.setText("" if groups is None else str(len(groups)))
        self.rows, self._names, self._pictures = [], [], []
        if groups is None:
            told = label("Groups of similar shapes appear here once the shapes are grouped.", "caption", wrap=True)
            self._list.addWidget(told)
            self._list.setContentsMargins(8, 0, 8, 0)
            return
        self._list.setContentsMargins(0, 0, 0, 0)
        for g, name in enumerate(groups.names):
            picture, called = Picture((34, 30)), EditableName(name)
            disc = Swatch(group_colour(g, len(groups)), size=14, disc=True)
            called.renamed.connect(lambda text, g=g: self._rename(g, text))
            line = row(
                disc, 2, called, None, label(str(len(groups.members(g))), "text2"), 6, picture,
                spacing=6, margins=(8, 2, 6, 2),
            )  # fmt: skip
            exemplar = self.session.project.names[groups.exemplars[g]]
            one = Clickable(line, "row", tooltip=f"Exemplar: {exemplar}. Double-click (or F2) renames the group.")
            one.setFixedHeight(36)
            one.clicked.connect(lambda g=g: self.chosen.emit(g))
            one.menu_wanted.connect(lambda at, g=g: self.menu_wanted.emit(g, at))
            one.double_clicked.connect(lambda g=g: self._start_rename(g))
            self._list.addWidget(one)
            self.rows.append(one)
            self._names.append(called)
            self._pictures.append(picture)

    def mark(self, current: int) -> None:
        """Mark the row of group ``current`` (-1: none)."""
        for g, one in enumerate(self.rows):
            one.set_current(g == current)

    def show_pictures(self) -> None:
        """Put the exemplars' pictures that have arrived where they belong."""
        groups, names = groups_of(self.session), self.session.project.names
        if groups is None or len(groups) != len(self._pictures):
            return  # the groups are just being changed: all is shown anew in a moment
        for g, picture in enumerate(self._pictures):
            picture.set_pixmap(self._picture(names[groups.exemplars[g]], g, len(groups)))

    def rename_current(self) -> None:
        """Let the name of the group that is looked at be written."""
        self._start_rename(self.session.group)

    def _start_rename(self, g: int) -> None:
        can, why = needs_rest(self.session)
        if can:
            self._names[g].start()
        else:
            self.session.say(why, "warning")

    def _rename(self, g: int, text: str) -> None:
        # The list is made anew by it: not before the editor has finished with its event.
        QTimer.singleShot(0, self, lambda: rename_group(self.session, g, text))
