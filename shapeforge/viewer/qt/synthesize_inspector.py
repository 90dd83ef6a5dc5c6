"""The inspector of the Synthesize place: map of the family, sliders, parts, random draws, the mesh, export."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFrame, QWidget

from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.union import solid_modeller
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.palette import as_hex
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Choice, Switch
from shapeforge.viewer.qt.icons import refresh, set_icon
from shapeforge.viewer.qt.stale_note import stale_note
from shapeforge.viewer.qt.synthesize_parts import DirectionRow, FamilyMap
from shapeforge.viewer.qt.synthesize_pins import PinSection
from shapeforge.viewer.qt.synthesize_sections import DrawSection, MeshSection
from shapeforge.viewer.qt.widgets import (
    Swatch,
    button,
    clear,
    column,
    framed,
    label,
    row,
    scrolled,
    section,
    separator,
    shortened,
)
from shapeforge.viewer.sculptor import Sculptor
from shapeforge.viewer.session import Session

KINDS = {
    "bundle": ("Bundles", "A unit of the second layer with the units below that go with it"),
    "unit": ("Single units", "Units of the first layer, each by itself; a locked one is held in random draws"),
}
"""Headings of the finer sliders."""


class SynthesizeInspector(QFrame):
    """Shows the Session's sliders, pins and parts and emits what the user asks for."""

    shape_chosen = Signal(str)
    slid = Signal(int, float)
    let_go = Signal(int)
    locking = Signal(int, bool)
    switched = Signal(int, bool)
    hovered = Signal(object)
    taken = Signal(int, str)

    def __init__(self, session: Session, sculptor: Sculptor, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.session, self.sculptor = session, sculptor
        self.rows: list[DirectionRow] = []
        self.switches: dict[int, Switch] = {}
        self.swatches: dict[int, Swatch] = {}
        self._part = 0
        family, self.pins = self._make_family(), PinSection(sculptor, actions, binding)
        directions, parts = self._blocks = self._make_directions(actions, binding), self._make_parts(actions, binding)
        self.draws, self.mesh = DrawSection(session), MeshSection()
        stale = stale_note(actions, binding, "learn", "learn", "Learn again")
        self._sections = scrolled(stale, family, self.pins, directions, parts, self.draws, self.mesh)
        self._empty, self._foot = QWidget(), self._make_foot(actions, binding)
        inside = column(self._sections, self._empty, self._foot, spacing=0)
        inside.setStretch(0, 1)
        inside.setStretch(1, 1)
        self.setLayout(inside)

    def _make_family(self) -> QWidget:
        self.map = FamilyMap()
        self.map.chosen.connect(lambda i: self.shape_chosen.emit(self.sculptor.shape_names[i]))
        return section(row(label("Family", "heading"), None, label("click to go there", "caption")), self.map)

    def _make_directions(self, actions: Actions, binding: Binding) -> QWidget:
        self.direction_count = label("", "off")
        reset = action_button(actions, "reset_sliders", binding, kind="link", icon=False)
        head = row(label("Directions", "heading"), self.direction_count, None, reset, margins=(16, 12, 16, 4))
        self.direction_rows = column(spacing=0)
        self.finer = button("", icon="down", kind="link")
        self.finer.clicked.connect(self._toggle_finer)
        self.finer_rows = QWidget()
        self.finer_rows.setLayout(column(spacing=0))
        self.finer_rows.setVisible(False)
        more = row(self.finer, None, margins=(16, 4, 16, 12))
        directions = QWidget()
        directions.setLayout(column(head, self.direction_rows, more, self.finer_rows, separator(), spacing=0))
        return directions

    def _make_parts(self, actions: Actions, binding: Binding) -> QWidget:
        self.part_rows = column(spacing=8)
        self.part_note = label("", "caption", wrap=True)
        self.part_to_take = Choice("", (), "", tooltip="A part to take from a shape of your choice")
        self.part_to_take.chosen.connect(lambda part: self._show_taken(int(part)))
        self.take_from = Choice("", (), "", tooltip="The shape whose part is bent to this place")
        self.take_from.chosen.connect(lambda name: self.taken.emit(self._part, name))
        mixing = column(
            row(label("Take the part"), None, self.part_to_take), row(label("from"), None, self.take_from), spacing=4
        )
        reset = action_button(actions, "reset_parts", binding, kind="link", icon=False)
        return section(row(label("Parts", "heading"), None, reset), self.part_rows, self.part_note, mixing)

    def _make_foot(self, actions: Actions, binding: Binding) -> QFrame:
        self.export = action_button(actions, "export_mesh", binding, kind="primary")
        names = "export_picture", "export_movie"
        others = [action_button(actions, name, binding, text="", kind="tool") for name in names]
        words = label("glb, part names and a recipe to remake it", "caption")
        return framed(column(row(self.export, *others, spacing=6), words, spacing=8, margins=(16, 12, 16, 14)), "bar")

    def fill(self) -> None:
        """Rows for the sliders and parts of the family there is now."""
        self._show_family()
        self._fill_directions()
        self._fill_parts()
        # What is painted before the next event would lie upon each other.
        for block in (*self._blocks, self._sections.widget()):
            block.layout().activate()
        self._sections.widget().adjustSize()

    def show_nothing(self, on: bool) -> None:
        """Nothing has been learnt: there is nothing to steer."""
        self._sections.setVisible(not on)
        self._empty.setVisible(on)
        self._foot.setVisible(not on)

    def show_colours(self) -> None:
        """The parts' colours as they are now (they may have been changed in Paint)."""
        for part, swatch in self.swatches.items():
            swatch.set_colour(as_hex(self.sculptor.inks[part]))

    @property
    def is_dragging(self) -> bool:
        """A slider is in hand."""
        return any(one.slider.is_dragged for one in self.rows)

    def show_values(self, points: Float[np.ndarray, "K 3"], between: tuple[str, str] | None) -> None:
        """Show the Session's sliders and parts, and the place on the map of a shape with these points."""
        exists, home, values = self.sculptor.exists(), self.sculptor.home(), self.sculptor.values()
        for index, one in enumerate(self.rows):
            one.set_value(float(values[index]), float(home[index]))
            one.show_lock(index in self.session.locked)
            if one.isVisible():  # on a shape of another origin it moves something else
                one.caption.setText(self.sculptor.caption(index))
        for part, switch in self.switches.items():
            switch.setChecked(bool(exists[part]))
        self._show_taken(self._part)
        self.show_wishes()
        self.pins.show_pins(points)
        if len(self.map.places) == len(self.sculptor.shape_names):
            names = self.sculptor.shape_names
            ends = None if between is None else (names.index(between[0]), names.index(between[1]))
            self.map.set_here(self.sculptor.place_on_map(self.map.places, points), ends)

    def show_wishes(self) -> None:
        """Show what random draws keep to."""
        names, asked = self.sculptor.part_names, self.session.parts_on
        parts = tuple(f"{names[part]} {'on' if asked[part] else 'off'}" for part in sorted(asked))
        self.draws.show_wishes(parts, len(self.session.locked), len(self.sculptor.pinned()))

    def show_mesh(self, shape: SynthesizedShape | None) -> None:
        """Show how the mesh is made; ``shape`` is the newest one, if any."""
        recipe = self.sculptor.recipe
        new = recipe.route == "surface"
        no_union = "A new surface is always one closed solid." if new else missing_modeller()
        no_colours = ""
        if shape is not None and shape.colours is None:
            no_colours = "None of the files that the parts come from has colours or materials."
        problem = "" if shape is None else str(shape.measures.get("not_united", "")).removeprefix("union: ")
        self.mesh.show_choice(
            recipe.route, recipe.union, self.session.mesh_colours, no_union=no_union, no_colours=no_colours,
            problem=problem[:1].upper() + problem[1:] + "." * bool(problem),
        )  # fmt: skip
        for choice in (self.part_to_take, self.take_from):
            choice.setEnabled(not new)
        self.take_from.setToolTip(
            "A new surface is made of no shape's parts" if new else "The shape whose part is bent to this place"
        )

    def _show_family(self) -> None:
        project, names = self.session.project, self.sculptor.shape_names
        groups, order = project.groups, [list(project.names).index(name) for name in names]
        if groups is not None and len(groups.group) == len(project.names):
            self.map.set_family(groups.embedding[order], groups.group[order], names)

    def _fill_directions(self) -> None:
        sculptor = self.sculptor
        clear(self.direction_rows)
        clear(self.finer_rows.layout())
        self.rows = []
        for index, direction in enumerate(sculptor.directions):
            unit = sculptor.unit(index)
            one = DirectionRow(
                sculptor.names[index], sculptor.caption(index), direction.low / unit, direction.high / unit,
                direction.histogram, direction.edges / unit,
            )  # fmt: skip
            one.moved.connect(lambda value, index=index: self.slid.emit(index, value))
            one.released.connect(lambda index=index: self.let_go.emit(index))
            one.entered.connect(lambda index=index: self.hovered.emit(index))
            one.left.connect(lambda: self.hovered.emit(None))
            one.locked.connect(lambda on, index=index: self.locking.emit(index, on))
            box = self.direction_rows if index < sculptor.coarse else self.finer_rows.layout()
            if index >= sculptor.coarse and direction.kind != sculptor.directions[index - 1].kind:
                words, explained = KINDS[direction.kind]
                box.addLayout(row(label(words, "strong", tooltip=explained), None, margins=(16, 8, 16, 2)))
            box.addWidget(one)
            one.show()  # now, not with the next event: what is hidden has no place in the layout
            self.rows.append(one)
        finer = len(self.rows) - sculptor.coarse
        self.finer.setVisible(finer > 0)
        self._words_of_finer = f"{finer} bundles and single units"
        self.finer.setText(self._words_of_finer)
        self.direction_count.setText(f"{sculptor.coarse} of {len(self.rows)}")
        refresh(self, self.session.theme)

    def _fill_parts(self) -> None:
        sculptor = self.sculptor
        clear(self.part_rows)
        self.switches, self.swatches = {}, {}
        always, seen = sculptor.always(), sculptor.seen()
        shown = [part for part in range(len(sculptor.part_names)) if seen[part]]
        holders: list[QWidget] = []
        for part in shown:
            colour = as_hex(sculptor.inks[part])
            switch = Switch(True, "Every shape of the family has it" if always[part] else "Switch this part on or off")
            switch.setEnabled(not always[part])
            switch.setAccessibleName(sculptor.part_names[part])
            switch.clicked.connect(lambda on, part=part: self.switched.emit(part, on))
            self.switches[part] = switch
            holder = QWidget()
            self.swatches[part] = Swatch(colour)
            holder.setLayout(row(self.swatches[part], 2, label(sculptor.part_names[part]), None, switch, spacing=6))
            holders.append(holder)
        for pair in zip(holders[::2], [*holders[1::2], QWidget()], strict=False):
            line = row(*pair, spacing=16)
            line.setStretch(0, 1)
            line.setStretch(1, 1)
            self.part_rows.addLayout(line)
            for holder in pair:
                holder.show()
        fixed = [sculptor.part_names[part] for part in shown if always[part]]
        words = " and ".join(([", ".join(fixed[:-1])] if fixed[:-1] else []) + fixed[-1:])
        self.part_note.setText(f"{words.capitalize()}: on every shape of the family." if fixed else "")

    def _show_taken(self, part: int) -> None:
        """Offer the shapes that have the part, and show which it is wanted from."""
        sculptor = self.sculptor
        self._part = part if part in self.switches else next(iter(self.switches), 0)
        self.part_to_take.set_options(
            tuple((str(l), shortened(sculptor.part_names[l], 18)) for l in self.switches), str(self._part)
        )  # fmt: skip
        having = sculptor.observations.exists[:, self._part]
        names = tuple(n for n, has in zip(sculptor.shape_names, having, strict=True) if has)
        self.take_from.set_options(
            (("", "the nearest"), *((n, shortened(n, 24)) for n in names)), sculptor.recipe.taken.get(self._part, "")
        )

    def _toggle_finer(self) -> None:
        shown = not self.finer_rows.isVisible()
        self.finer_rows.setVisible(shown)
        set_icon(self.finer, "up" if shown else "down", "accent_text")
        if shown:
            for index in range(self.sculptor.coarse, len(self.rows)):
                self.rows[index].caption.setText(self.sculptor.caption(index))


def missing_modeller() -> str:
    """Why parts cannot be united here; "" if they can."""
    try:
        solid_modeller()
    except ValueError as error:
        return str(error).removeprefix("union: ")
    return ""
