"""Collection: the family at a glance, its groups and their exemplars, what was not read, and which to paint next."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QStackedWidget, QWidget

from shapeforge.collection.counts import counted, grouped
from shapeforge.viewer.actions import Actions, group_of, groups_of
from shapeforge.viewer.palette import rgb
from shapeforge.viewer.qt.bind import Binding, action_button, keep_enabled
from shapeforge.viewer.qt.collection_parts import MAP_PICTURE, CollectionStrip, ProblemList, SelectionSection
from shapeforge.viewer.qt.collection_words import hover_card, typical_text
from shapeforge.viewer.qt.controls import Choice, Segments
from shapeforge.viewer.qt.group_list import GroupList
from shapeforge.viewer.qt.group_map import GroupMap
from shapeforge.viewer.qt.group_menus import GroupMenus
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.large_view import LargeView
from shapeforge.viewer.qt.map_drawing import MapContent, group_colour
from shapeforge.viewer.qt.reading_note import ReadingNote
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import (
    ElidedLabel,
    Picture,
    button,
    column,
    framed,
    label,
    row,
    scrolled,
    section,
    separator,
    shortened,
)
from shapeforge.viewer.regroup import can_make_exemplar, chosen_shapes
from shapeforge.viewer.session import Session

PREVIEW = (280, 184)
PREVIEW_WORDS = 30
HINTS = {
    "map": "Near means similar. Wheel zooms, drag pans, Shift-drag selects, right click changes, Home shows all.",
    "grid": "Group by group. Wheel scrolls, Shift-drag selects.",
    "choose": "Click the shape that should stand for {group}; Esc leaves it as it is.",
}


class CollectionPlace:
    """Map or grid in the centre, groups and import in the inspector, exemplars to paint in the strip."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.binding = Binding(session)
        self.pictures = Thumbnails(session)
        self.menus = GroupMenus(session, actions, lambda: self.groups.rename_current(), self._leave_it)
        self.choosing = False
        self._view_factory = view_factory
        self.large: LargeView | None = None
        self.map = GroupMap(self._map_picture, lambda name: hover_card(session, name))
        self.toolbar_widget = self._make_tools()
        self.centre = self._make_centre()
        self.inspector = self._make_inspector()
        self.strip = CollectionStrip(session, actions, self.binding)
        self.strip.chosen.connect(lambda name: self._click(name, False))
        self.strip.opened.connect(self._open)
        self.map.clicked.connect(self._click)
        self.map.lassoed.connect(self._select)
        self.map.opened.connect(self._open)
        self.map.group_clicked.connect(self._show_group)
        self.map.menu_wanted.connect(self._open_menu)
        self.menus.owner = self.map
        self.pictures.setParent(self.centre)
        self.pictures.arrived.connect(self._pictures_changed)
        self.binding.on(("project", "data", "colour_by"), self._show_all, now=False)
        self.binding.on(("theme",), self._show_all, now=False)
        self.binding.on(("shape", "selected", "group"), self._show_selection, now=False)
        self.binding.on(("arrangement", "turn"), self._show_map, now=False)
        self.binding.on(("running",), self._show_problems, now=False)
        self.binding.on(("running", "progress", "status", "turn"), self._show_progress, now=False)

    def enter(self) -> None:
        """Show the project as it is now."""
        self._show_all()
        self.map.setFocus()

    def leave(self) -> None:
        """Pictures that are still to be taken can wait."""
        self._choose(False)
        self.session.turn = None
        self.pictures.forget()

    def close(self) -> None:
        """The window closes: hear no more of the session."""
        self.binding.close()
        self.pictures.forget()

    # -- making ----------------------------------------------------------------------------------------------------

    def _make_tools(self) -> QWidget:
        self.mode = Segments([("map", "Map", "map"), ("grid", "Grid", "grid"), ("large", "Large", "cube")], "map")
        self.mode.chosen.connect(lambda value: self.actions.run(f"show_{value}"))
        for value in ("map", "grid", "large"):
            keep_enabled(self.mode.button(value), self.actions, f"show_{value}", self.binding)
        self.colour_choice = Choice("Colour by", [], "group", tooltip="What the colours of the shapes mean")
        self.colour_choice.chosen.connect(lambda value: setattr(self.session, "colour_by", value))
        self.lasso = button(icon="lasso", kind="tool", checkable=True, tooltip="Drag selects (also: Shift and drag)")
        self.lasso.toggled.connect(lambda on: setattr(self.map, "lasso_always", on))
        self.import_button = action_button(self.actions, "import_files", self.binding)
        bar = row(self.mode, self.colour_choice, None, self.lasso, self.import_button, margins=(PADDING, 0, PADDING, 0))
        return framed(bar)

    def _make_centre(self) -> QWidget:
        self.hint, self.count = label(HINTS["map"], "caption"), label("", "caption")
        self.reading = ReadingNote(self.session)
        self.map.setLayout(column(self.reading))
        foot = framed(row(self.hint, None, self.count, margins=(PADDING, 0, PADDING, 6)), "view_foot", height=28)
        box = column(self.map, foot, spacing=0)
        box.setStretch(0, 1)
        self.pages = QStackedWidget()
        self.pages.addWidget(framed(box))
        result = framed(row(self.pages, spacing=0), "centre")
        result.setFocusProxy(self.map)
        return result

    def _make_inspector(self) -> QWidget:
        self.groups = GroupList(self.session, self.actions, self.binding, self._map_picture_of_group)
        self.groups.chosen.connect(self._show_group)
        self.groups.menu_wanted.connect(lambda g, at: self._open_menu("", g, at))
        self.groups.more.clicked.connect(
            lambda: self.menus.group_menu(self.groups.more.mapToGlobal(self.groups.more.rect().bottomLeft()))
        )
        holder = QWidget()
        holder.setLayout(column(self.groups, separator(), spacing=0))
        self.exemplar_title, self.typical = ElidedLabel("", "heading"), label("", "caption")
        self.preview = Picture(PREVIEW, top=PREVIEW_WORDS)
        self.preview.setMinimumWidth(0)  # beside a scroll bar there is less room
        self.preview_name = ElidedLabel("", "strong", Qt.TextElideMode.ElideMiddle)
        self.preview_about = label("", "caption")
        words = column(self.preview_name, self.preview_about, None, spacing=0, margins=(12, 10, 12, 8))
        self.look = action_button(self.actions, "look_at", self.binding, text="", kind="icon")
        words.addLayout(row(None, self.look))
        self.preview.setLayout(words)
        self.choose_button = button("Choose another exemplar…", icon="swap")
        self.choose_button.clicked.connect(self._press_choose)
        self.exemplar_section = section(
            row(self.exemplar_title, None, self.typical), framed(row(self.preview), "preview"), self.choose_button
        )
        self.selection = SelectionSection(self.session, self.actions, self.binding)
        self.problems = ProblemList(self.session)
        self.problems.fix_wanted.connect(self._fix)
        return scrolled(holder, self.exemplar_section, self.selection, self.problems)

    # -- showing ---------------------------------------------------------------------------------------------------

    def _here(self) -> bool:
        return self.session.project is not None and self.session.place == "collection"

    def _show_all(self) -> None:
        if not self._here():
            return
        self._show_colours()
        self._show_map()
        self.groups.show_groups()
        self._show_problems()
        self.strip.show_exemplars()
        self._show_selection()
        self._show_progress()

    def _show_problems(self) -> None:
        if self._here():
            self.problems.show_problems(self.session)

    def _show_colours(self) -> None:
        options = [("group", "group"), ("plain", "nothing")]
        if self.session.project.part_names is not None:
            options.insert(1, ("painted", "painted part"))
        if self.session.project.fit_names:
            options.insert(1, ("fitted", "fitted part"))
        value = self.session.colour_by if self.session.colour_by in dict(options) else "group"
        self.colour_choice.set_options(options, value)

    def _show_map(self) -> None:
        if not self._here():
            return
        project, groups = self.session.project, groups_of(self.session)
        names = project.names
        # Without groups there is no map; it comes by itself when they are there.
        arranged = "grid" if groups is None and self.session.arrangement == "map" else self.session.arrangement
        self.mode.set_value(arranged)
        rows = arranged == "grid"
        if groups is None:
            content = MapContent(names, np.zeros(len(names), int))
        else:
            content = MapContent(names, groups.group, groups.exemplars, groups.embedding, groups.names, grouped=True)
        if self.session.arrangement == "large":
            self.map.set_content(content)
            self._show_large()
            return
        self.map.set_content(content, rows=rows)
        if self.pages.currentIndex() != 0:
            self.pages.setCurrentIndex(0)
            self.centre.setFocusProxy(self.map)
            self.map.setFocus()
        self._show_hint()

    def _show_large(self) -> None:
        if self.large is None:  # its 3-D view is made when it is first wanted
            self.large = LargeView(self.session, self.actions, self.binding, self._view_factory)
            refresh(self.large, self.session.theme)
            self.pages.addWidget(self.large)
        if self.pages.currentIndex() != 1:
            self.pages.setCurrentIndex(1)
            self.centre.setFocusProxy(self.large)
            self.large.view.setFocus()
        self.large.show_now()

    def _show_hint(self) -> None:
        groups = groups_of(self.session)
        if self.choosing:
            self.hint.setText(HINTS["choose"].format(group=groups.names[self.session.group]))
        elif not self.map.content.names:
            self.hint.setText("")
        else:
            self.hint.setText(HINTS["grid" if groups is None or self.map.rows else "map"])

    def _map_picture(self, name: str, g: int) -> QPixmap | None:
        groups, by = groups_of(self.session), self.session.colour_by
        if by == "painted" and self.session.project.label_key(name):
            return self.pictures.shape(name, MAP_PICTURE, parts="painted")
        if by == "fitted" and name in self.session.project.fit_names:
            return self.pictures.shape(name, MAP_PICTURE, parts="fitted")
        colour = None
        if groups is not None and by == "group":
            colour = rgb(group_colour(g, len(groups)))
        return self.pictures.shape(name, MAP_PICTURE, colour=colour)

    def _show_selection(self) -> None:
        if not self._here():
            return
        session, groups = self.session, groups_of(self.session)
        if len(self.groups.rows) != (0 if groups is None else len(groups)):
            return  # the groups are just being changed: all is shown anew in a moment
        g = group_of(session, session.shape)
        if g >= 0:
            session.group = g
        current = self.session.group if groups is not None else -1
        self.map.set_selection(session.shape, session.selected, current)
        self.groups.mark(current)
        chosen = len(session.selected) or (1 if session.shape else 0)
        self.count.setText(f"{grouped(chosen)} of {grouped(len(session.project.names))} selected" if chosen else "")
        self._show_exemplar()
        self.selection.show_selection()
        self.strip.show_current()
        if self.large is not None and session.arrangement == "large":
            self.large.show_now()

    def _show_exemplar(self) -> None:
        groups, project = groups_of(self.session), self.session.project
        self.exemplar_section.setVisible(groups is not None and len(groups) > 0)
        if groups is None or not len(groups):
            return
        g = self.session.group
        exemplar = project.names[groups.exemplars[g]]
        self.exemplar_title.setText(f"Exemplar of {groups.names[g]}")
        self.typical.setText(typical_text(groups, g))
        self.preview_name.setText(exemplar)
        self.preview_about.setText(counted(project.shape_record(exemplar)["n_faces"], "face"))
        can, why = can_make_exemplar(self.session)
        if self.choosing:
            text, about = "Keep the present one", "Leave the exemplar as it is  (Esc)"
        elif can:
            text = f"Make {shortened(self.session.shape, 12)} the exemplar"
            about = f"{self.session.shape} is painted for its group, and its template is made of it"
        else:
            text, about = "Choose another exemplar…", "The next click on the map chooses what stands for the group"
        alone = len(groups.members(g)) < 2
        off = "It is alone in its group." if alone else why if self.session.running else ""
        self.choose_button.setText(text)
        self.choose_button.setEnabled(not off)
        self.choose_button.setToolTip(f"{about}\n{off}" if off else about)
        self._pictures_changed()

    def _pictures_changed(self) -> None:
        """Another picture has arrived: put all that are there where they belong."""
        groups = groups_of(self.session)
        self.map.update()
        if groups is None or not self._here():
            return
        names = self.session.project.names
        self.groups.show_pictures()
        self.strip.show_pictures(self.pictures)
        exemplar = names[groups.exemplars[min(self.session.group, len(groups) - 1)]]
        parts = "painted" if self.session.project.label_key(exemplar) else ""
        self.preview.set_pixmap(self.pictures.shape(exemplar, PREVIEW_PIXELS, parts=parts))

    def _map_picture_of_group(self, name: str, g: int, count: int) -> QPixmap | None:
        return self.pictures.shape(name, MAP_PICTURE, colour=rgb(group_colour(g, count)))

    def _show_progress(self) -> None:
        if self._here():
            self.strip.show_progress()
            self.reading.show_now(bool(self.map.content.names))
            self._show_hint()

    # -- what the user does ----------------------------------------------------------------------------------------

    def _click(self, name: str, add: bool) -> None:
        session = self.session
        if self.choosing:
            self._choose(False)
            session.shape, session.selected = name, (name,)
            self.actions.run("make_exemplar")
            return
        if add:
            before = session.selected or ((session.shape,) if session.shape else ())
            session.selected = tuple(n for n in before if n != name) if name in before else (*before, name)
        else:
            session.selected = (name,)
        session.shape = name

    def _select(self, names: tuple[str, ...]) -> None:
        self.session.selected = names
        if names and self.session.shape not in names:
            self.session.shape = names[0]

    def _open(self, name: str) -> None:
        self.session.shape = name
        self.actions.run("look_at")

    def _leave_it(self) -> None:
        """Escape: what was begun is given up; nothing begun, nothing stays selected."""
        session = self.session
        if session.turn is not None:
            session.turn = None
        elif self.choosing:
            self._choose(False)
        else:
            session.selected, session.shape = (), None

    def _open_menu(self, name: str, g: int, at: QPoint) -> None:
        if name and name not in chosen_shapes(self.session):
            self._click(name, False)
        elif not name and g >= 0:
            self.session.group = g
        if name:
            self.menus.shape_menu(at)
        elif g >= 0:
            self.menus.group_menu(at)

    def _fix(self, name: str) -> None:
        """Turn the shape whose orientation was a guess."""
        self._click(name, False)
        self.actions.run("turn_shape")

    def _show_group(self, g: int) -> None:
        if g < 0:
            self.session.selected = ()
            self.session.shape = None
            return
        self.session.group = g
        if group_of(self.session, self.session.shape) != g:
            self.session.selected = ()
            self.session.shape = None
        self._show_selection()

    def _press_choose(self) -> None:
        if not self.choosing and can_make_exemplar(self.session)[0]:
            self.actions.run("make_exemplar")
        else:
            self._choose(not self.choosing)

    def _choose(self, on: bool) -> None:
        """Let the next click on the map choose the exemplar of the group."""
        self.choosing = on
        self.map.setCursor(Qt.CursorShape.CrossCursor if on else Qt.CursorShape.ArrowCursor)
        if self._here():
            self._show_hint()
            self._show_exemplar()


PREVIEW_PIXELS = (PREVIEW[0] * 2, (PREVIEW[1] - PREVIEW_WORDS) * 2)
