"""The palette of parts: their colours, keys and shares; new, rename, recolour, hide, merge, split and remove."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPoint
from PySide6.QtWidgets import QMenu, QWidget

from shapeforge.viewer.actions import YES, Action, Actions
from shapeforge.viewer.first_parts import are_proposed, can_edit_proposed
from shapeforge.viewer.painter import Painter
from shapeforge.viewer.palette import as_hex
from shapeforge.viewer.qt.bind import Binding, action_button, native
from shapeforge.viewer.qt.colour_choice import ColourChoice
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.paint_parts import PartRow
from shapeforge.viewer.qt.widgets import clear, column, label, row, section
from shapeforge.viewer.readiness import Verdict
from shapeforge.viewer.session import Session

PROPOSED = "Proposed, as nobody has painted yet. Rename, merge or split them; the fit starts from these."
_MENU = ("rename_part", "recolour_part", "hide_part", None, "merge_parts", "split_part", "remove_part")


class PartsPalette(QWidget):
    """Shows the parts of the project; the chosen one is ``session.part``, ``second`` the one to merge into it.

    ``view_changed`` is called when the shape has to be drawn again, ``counts_wanted`` when the shares have.
    """

    def __init__(
        self, session: Session, painter: Painter, actions: Actions, binding: Binding,
        view_changed: Callable[[], None], counts_wanted: Callable[[], None],
    ) -> None:  # fmt: skip
        super().__init__()
        self.session, self.painter, self.actions = session, painter, actions
        self.view_changed, self.counts_wanted = view_changed, counts_wanted
        self.second: int | None = None
        self.rows: list[PartRow] = []
        self.sheet: ColourChoice | None = None
        self.menu: QMenu | None = None
        self._add_actions()
        self.part_count = label("", "off")
        self.part_rows = column(spacing=2)
        self.new = action_button(actions, "new_part", binding, icon=False)
        self.merge = action_button(actions, "merge_parts", binding, icon=False)
        self.split = action_button(actions, "split_part", binding, icon=False)
        self.remove = action_button(actions, "remove_part", binding, icon=False)
        self.propose = action_button(actions, "cosegment", binding)
        self.hint = label("", "caption", wrap=True)
        buttons = row(self.new, self.merge, self.split, self.remove, spacing=6)
        for place in range(4):
            buttons.setStretch(place, 1)
        head = row(label("Parts", "heading"), self.part_count, None, label("share of the area", "caption"))
        self.setLayout(column(section(head, self.part_rows, 4, buttons, self.propose, self.hint, spacing=6), spacing=0))

    def _add_actions(self) -> None:
        def add(
            name: str, text: str, run: Callable[[], None], key: str, tooltip: str, enabled: Callable[[], Verdict],
            icon: str = "",
        ) -> None:  # fmt: skip
            self.actions.add(
                Action(name, text, lambda _session: run(), lambda _session: enabled(), key, tooltip, icon, "paint")
            )

        add("new_part", "New", self.new_part, "Shift+N", "Add a part to the family", lambda: YES, "plus")
        add("rename_part", "Rename", lambda: self.rows[self.session.part].rename(), "F2",
            "Give the current part another name", self._has_part)  # fmt: skip
        add("recolour_part", "Colour…", self.choose_colour, "Shift+C",
            "Give the current part another colour, the same wherever the family is shown", self._has_part)  # fmt: skip
        add("merge_parts", "Merge", self._merge, "Shift+M",
            "Give all paint of the second part to the current one, on every shape", self._can_merge)  # fmt: skip
        add("split_part", "Split", self._split, "Shift+X",
            "Cut the current part in two on every shape: pieces that are alike stay together",
            self._can_split)  # fmt: skip
        add("remove_part", "Remove", self._remove, "Shift+Del",
            "Take the current part off the list; what was painted with it is unpainted again",
            self._can_remove)  # fmt: skip
        add("hide_part", "Hide", lambda: self.hide_part(self.session.part), "Shift+H",
            "Hide the current part, or show it again", self._has_part, "eye_off")  # fmt: skip
        add("show_all_parts", "Show all parts", self._show_all, "Ctrl+Shift+H", "Open every part's eye",
            self._can_show_all)  # fmt: skip

    # ---- showing -------------------------------------------------------------------------------------------------

    def show_parts(self) -> None:
        """Rows for the parts there are now."""
        names = self.painter.part_names
        clear(self.part_rows)
        self.rows = []
        for part, (name, ink) in enumerate(zip(names, self.session.project.part_inks(), strict=True)):
            one = PartRow(name, as_hex(ink), str(part + 1) if part < 9 else "")
            one.clicked.connect(lambda part=part: setattr(self.session, "part", part))
            one.ctrl_clicked.connect(lambda part=part: self.select_second(part))
            one.eye_clicked.connect(lambda part=part: self.hide_part(part))
            one.colour_clicked.connect(lambda part=part: self._colour_of(part))
            one.menu_wanted.connect(lambda place, part=part: self._open_menu(part, place))
            one.renamed.connect(lambda text, part=part: self._rename(part, text))
            one.set_hidden(part in self.painter.hidden)
            self.part_rows.addWidget(one)
            self.rows.append(one)
        if not names:
            told = "No parts yet. Just paint, add the first, or let parts be proposed from what all shapes share."
            self.part_rows.addWidget(label(told, "caption", wrap=True))
        self.propose.setVisible(not names)
        refresh(self, self.session.theme)
        self.part_count.setText(str(len(names)) if names else "")
        self.show_chosen()
        self.counts_wanted()

    def show_chosen(self) -> None:
        """Mark the current part, and the one to merge it with."""
        if self.second is not None and self.second >= len(self.rows):
            self.second = None
        for part, one in enumerate(self.rows):
            one.set_current(part in (self.session.part, self.second))
        proposed = are_proposed(self.session)
        self.split.setVisible(proposed)
        self.remove.setVisible(not proposed)
        ready = self._can_merge()[0]
        names = self.painter.part_names
        self.hint.setText(
            f"Merge gives {names[self.second]} to {names[self.session.part]}, on every shape." if ready
            else PROPOSED if proposed
            else "To merge two parts, Ctrl-click the second." if len(names) > 1 else ""
        )  # fmt: skip
        self.hint.setVisible(bool(self.hint.text()))
        self.session.edit_count += 1  # what can be done depends on it
        if self.painter.isolated:
            self.view_changed()

    # ---- doing ---------------------------------------------------------------------------------------------------

    def select_second(self, part: int) -> None:
        """Choose (or no more) the part to merge into the current one."""
        self.second = None if self.second == part else part
        self.show_chosen()

    def hide_part(self, part: int) -> None:
        """Shut or open the eye of a part."""
        self.painter.hidden = self.painter.hidden ^ {part}
        self.rows[part].set_hidden(part in self.painter.hidden)
        self.view_changed()
        self.session.edit_count += 1  # what can be done depends on it

    def new_part(self) -> None:
        """Add a part, take it, and let its name be written."""
        names = self.painter.part_names
        name = next(f"part {i}" for i in range(1, len(names) + 2) if f"part {i}" not in names)
        self.session.part = self.painter.add_part(name)
        self.rows[-1].rename()

    def choose_colour(self) -> None:
        """Open the sheet of colours for the current part."""
        part, names = self.session.part, self.painter.part_names
        used = {one.colour: name for i, (one, name) in enumerate(zip(self.rows, names, strict=True)) if i != part}
        self.sheet = ColourChoice(self, names[part], self.rows[part].colour, used)
        self.sheet.chosen.connect(lambda colour: self._try(lambda: self.painter.recolour_part(part, colour or None)))
        self.sheet.destroyed.connect(lambda: setattr(self, "sheet", None))
        refresh(self.sheet, self.session.theme)
        swatch = self.rows[part].swatch
        self.sheet.open_below(swatch.mapToGlobal(QPoint(-6, swatch.height() + 6)))

    def _colour_of(self, part: int) -> None:
        self.session.part = part
        self.actions.run("recolour_part")

    def _open_menu(self, part: int, place: QPoint) -> None:
        """What can be done to a part; merging takes the current one in."""
        if part != self.session.part:
            self.second = part
            self.show_chosen()
        self.menu = QMenu(self)
        self.menu.setToolTipsVisible(True)
        for name in _MENU:
            if name is None:
                self.menu.addSeparator()
            elif name not in ("split_part", "remove_part") or (name == "split_part") == are_proposed(self.session):
                self._add_to_menu(name, part)
        self.menu.popup(place)

    def _add_to_menu(self, name: str, part: int) -> None:
        names = self.painter.part_names
        if name == "merge_parts":
            text = f"Merge into {names[self.session.part]}" if part != self.session.part else "Merge"
        else:
            text = self.actions[name].label

        def run() -> None:
            if name != "merge_parts":
                self.second, self.session.part = None, part
            self.actions.run(name)

        action = self.menu.addAction(text, run)
        can, why = self.actions.verdict(name)
        action.setEnabled(can)
        action.setToolTip(self.actions[name].tooltip if can else why)
        action.setShortcut(native(self.actions[name].shortcut))

    def _rename(self, part: int, text: str) -> None:
        self._try(lambda: self.painter.rename_part(part, text))

    def _merge(self) -> None:
        kept, gone = self.session.part, self.second
        names = self.painter.part_names
        self.second = None
        self.painter.merge_parts(kept, gone)
        self.session.say(f"{names[gone]} now belongs to {names[kept]}, on every shape", "ok")

    def _split(self) -> None:
        self.painter.proposed.do("split", self.painter.part_names[self.session.part])

    def _remove(self) -> None:
        name = self.painter.part_names[self.session.part]
        self.painter.remove_part(self.session.part)
        self.session.say(f"{name} is removed from every shape; Undo brings it back with its paint", "ok")

    def _show_all(self) -> None:
        self.painter.hidden, self.painter.isolated = frozenset(), False
        self.show_parts()
        self.view_changed()

    def _try(self, do: Callable[[], object]) -> None:
        try:
            do()
        except (ValueError, RuntimeError, OSError) as error:
            self.session.say(str(error), "error")
            self.show_parts()

    # ---- whether it can be done ----------------------------------------------------------------------------------

    def _has_part(self) -> Verdict:
        names = () if self.session.project is None else self.painter.part_names
        return YES if self.session.part < len(names) else (False, "There is no part yet: add one first.")

    def _can_merge(self) -> Verdict:
        if self.session.project is None or self.second is None or self.second == self.session.part:
            return False, "Select two parts first: Ctrl-click the second."
        return YES if max(self.second, self.session.part) < len(self.painter.part_names) else self._has_part()

    def _can_split(self) -> Verdict:
        can, why = self._has_part()
        return can_edit_proposed(self.session) if can else (can, why)

    def _can_remove(self) -> Verdict:
        if self.session.project is not None and are_proposed(self.session):
            return False, "Proposed parts are merged into another one instead."
        return self._has_part()

    def _can_show_all(self) -> Verdict:
        return YES if self.painter.hidden or self.painter.isolated else (False, "All parts are shown.")
