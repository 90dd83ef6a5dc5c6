"""What can be done to groups and to the selected shapes: actions with their keys, and the menus that offer them."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPoint
from PySide6.QtWidgets import QMenu, QWidget

from shapeforge.viewer import regroup, turning
from shapeforge.viewer.actions import YES, Action, Actions, groups_of
from shapeforge.viewer.qt.bind import native, tooltip_of
from shapeforge.viewer.readiness import Verdict, needs_rest
from shapeforge.viewer.session import Session

_SHAPE_MENU = (
    "look_at", "turn_shape", None, "make_exemplar", "move_shapes", "make_group", "leave_out",
)  # fmt: skip
_GROUP_MENU = ("rename_group", "merge_group", "split_group", "leave_group")


class GroupMenus:
    """Adds the actions to the table; asks for a group with a menu at the pointer (or, by keyboard, in the middle)."""

    def __init__(self, session: Session, actions: Actions, rename: Callable[[], None], leave: Callable[[], None]):
        self.session, self.actions = session, actions
        self.owner: QWidget | None = None
        self.open_menu: QMenu | None = None

        def add(name: str, text: str, run: Callable, enabled: Callable, key: str, tooltip: str, icon: str = "") -> None:
            actions.add(Action(name, text, run, enabled, key, tooltip, icon, "collection"))

        add("rename_group", "Rename the group", lambda _s: rename(), self._can_rename, "F2",
            "Give the selected group a name of your own")  # fmt: skip
        add("move_shapes", "Move to…", lambda _s: self._ask("Move to", regroup.targets, regroup.move_to),
            regroup.can_move, "G", "Let the selected shapes belong to another group", "right")  # fmt: skip
        add("make_group", "New group", regroup.make_group, regroup.can_make_group, "N",
            "Make a group of the selected shapes", "plus")  # fmt: skip
        add("merge_group", "Merge into…", lambda _s: self._ask("Merge into", self._others, regroup.merge_into),
            regroup.can_merge, "M", "Let all of this group belong to another one", "overlay")  # fmt: skip
        add("split_group", "Split in two", regroup.split, regroup.can_split, "S",
            "Cut this group in two: what is like its exemplar, and the rest", "swap")  # fmt: skip
        add("leave_group", "Leave the group out", regroup.leave_group_out, regroup.can_leave_group, "Shift+L",
            "Leave out all of this group: it is neither painted nor fitted", "eye_off")  # fmt: skip
        add("turn_shape", "Turn…", turning.begin, turning.can_turn, "O",
            "Put the selected shapes upright, facing as the others do", "rotate")  # fmt: skip
        for axis, words in enumerate(("forward", "about the vertical", "sideways")):
            letter = turning.AXES[axis]
            add(f"turn_{letter}", f"Quarter turn {words}", lambda s, axis=axis: turning.turn_quarter(s, axis),
                turning.is_turning, f"Shift+{letter.upper()}", f"A quarter turn {words}")  # fmt: skip
        add("turn_as_file", "As in the file", turning.as_in_file, turning.is_turning, "Shift+F",
            "The orientation that the file has", "undo")  # fmt: skip
        add("turn_keep", "Keep", turning.keep, turning.is_turning, "Ctrl+Return",
            "Keep this orientation (also: Enter). Labels stay; what was fitted goes stale.", "check")  # fmt: skip
        add("leave", "Cancel", lambda _s: leave(), lambda _s: YES, "Escape",
            "Leave it as it was; or select nothing", "close")  # fmt: skip
        for number, (value, text) in enumerate((("map", "Map"), ("grid", "Grid"), ("large", "Large")), 1):
            add(f"show_{value}", f"Show as {text.lower()}", lambda s, value=value: _arrange(s, value),
                self._can_map if value == "map" else lambda s: YES, str(number), _ARRANGED[value])  # fmt: skip

    def _can_rename(self, session: Session) -> Verdict:
        can, why = needs_rest(session)
        if not can:
            return can, why
        return YES if groups_of(session) is not None else (False, "Group the shapes first.")

    def _can_map(self, session: Session) -> Verdict:
        return YES if groups_of(session) is not None else (False, "Group the shapes first.")

    def _others(self, session: Session) -> list[int]:
        return [g for g in range(len(groups_of(session))) if g != session.group]

    def _ask(self, title: str, targets: Callable[[Session], list[int]], run: Callable[[Session, int], None]) -> None:
        """A menu of groups; the one chosen is given to ``run``."""
        menu = QMenu(self.owner)
        menu.addSection(title)
        groups = groups_of(self.session)
        for number, g in enumerate(targets(self.session), 1):
            key = f"&{number}  " if number < 10 else ""
            menu.addAction(f"{key}{groups.names[g].replace('&', '&&')}", lambda g=g: run(self.session, g))
        self._popup(menu)

    def _popup(self, menu: QMenu, at: QPoint | None = None) -> None:
        self.open_menu = menu
        menu.aboutToHide.connect(menu.deleteLater)
        if at is None:
            here = self.owner.mapFromGlobal(self.owner.cursor().pos())
            at = here if self.owner.rect().contains(here) else self.owner.rect().center()
            at = self.owner.mapToGlobal(at)
        menu.popup(at)
        if menu.actions():
            menu.setActiveAction(next(a for a in menu.actions() if not a.isSeparator()))

    def shape_menu(self, at: QPoint | None = None) -> None:
        """What can be done to the selected shapes."""
        self._show(_SHAPE_MENU, at)

    def group_menu(self, at: QPoint | None = None) -> None:
        """What can be done to the current group."""
        self._show(_GROUP_MENU, at)

    def _show(self, names: tuple[str | None, ...], at: QPoint | None) -> None:
        menu = QMenu(self.owner)
        menu.setToolTipsVisible(True)
        for name in names:
            if name is None:
                menu.addSeparator()
                continue
            text = self.actions[name].label
            if name == "leave_out" and regroup.is_left_out(self.session):
                text = "Put it back"
            # Shown, not bound: the window's own shortcut stays the only one.
            item = menu.addAction(f"{text}\t{native(self.actions[name].shortcut)}", lambda n=name: self.actions.run(n))
            item.setEnabled(self.actions.verdict(name)[0])
            item.setToolTip(tooltip_of(self.actions, name))
        self._popup(menu, at)


_ARRANGED = {
    "map": "By likeness: near means similar",
    "grid": "Group by group, in rows",
    "large": "The selected shapes, large, to be turned and looked at",
}


def _arrange(session: Session, value: str) -> None:
    session.turn = None
    session.arrangement = value
