"""The Synthesize place: new shapes of the family from sliders with the range of the data; points at once, then a mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QFrame, QMenu, QWidget

from shapeforge.viewer.actions import YES, Action, Actions
from shapeforge.viewer.display import Mark, View
from shapeforge.viewer.palette import part_colours
from shapeforge.viewer.picking import camera_axes
from shapeforge.viewer.pictures import take_picture
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.paint_parts import HistoryStrip
from shapeforge.viewer.qt.synthesize_parts import BetweenBar, DirectionRow, FamilyMap
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import (
    Segments,
    Swatch,
    Switch,
    button,
    clear,
    column,
    framed,
    label,
    row,
    scrolled,
    section,
    separator,
)
from shapeforge.viewer.sculptor import Made, MeshWorker, Recipe, Sculptor, export_mesh
from shapeforge.viewer.session import Session

PREVIEW_MS = 120  # a slider that rests this long gets a preview mesh; one that is let go the final one
GRAB_PIXELS = 11


class _Mail(QObject):
    """Carries "a mesh is there" from the worker's thread to the window's."""

    arrived = Signal()


class SynthesizePlace:
    """Sliders, parts, Mean / Random / From shape / Between, the history of shapes, and the export."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.binding = Binding(session)
        self.sculptor = Sculptor(session)
        self.thumbnails = Thumbnails(session)
        self._view_factory = view_factory
        self._mail = _Mail()
        self._mail.arrived.connect(self._read_mail)
        self.worker: MeshWorker | None = None
        self.made: Made | None = None
        self._made_of: dict[int, Made] = {}
        self._wish = 0
        self._entered = False
        self._points = np.zeros((0, 3))
        self._locked: set[int] = set()
        self._between: tuple[str, str] | None = None
        self._share = 0.5
        self._held: tuple[int, np.ndarray, Callable[[np.ndarray], dict[int, float]]] | None = None
        self._handles = np.zeros(0, int)
        self._old_history = session.history
        self.rows: list[DirectionRow] = []
        self._add_actions()
        self._build()
        self._preview_timer = QTimer(self.centre, singleShot=True, interval=PREVIEW_MS)
        self._preview_timer.timeout.connect(lambda: self._ask(preview=True))
        self.thumbnails.arrived.connect(self._show_pictures)
        self.binding.on(("sliders", "parts_on"), self._wanted, now=False)
        self.binding.on(("theme",), self._show, now=False)
        self.binding.on(("data",), self._reload, now=False)

    # ---- building ------------------------------------------------------------------------------------------------

    def _add_actions(self) -> None:
        def add(
            name: str, text: str, run: Callable[[], None], key: str, tooltip: str, icon: str, enabled: Any = None
        ) -> None:
            verdict = enabled or self._ready
            self.actions.add(Action(name, text, lambda _s: run(), verdict, key, tooltip, icon, "synthesize"))

        add("mean_shape", "Mean", self._mean, "", "The middle of the family", "fit")
        add("random_shape", "Random", self._random, "R", "A shape drawn from what was learned", "dice")
        add("from_shape", "From shape…", self._choose_shape, "", "Start from a shape of the family", "cube")
        add(
            "between", "Between A and B", self._toggle_between, "B", "A shape on the way from one to another", "between"
        )
        add("reset_sliders", "Reset", self._reset, "", "All directions that are not locked back to the middle", "")
        add("export_mesh", "Export mesh…", self._export, "Ctrl+E", "glb, ply, obj or stl, with part names and a recipe",
            "export", self._can_export)  # fmt: skip
        add("home_synthesize", "Look from the front", lambda: self.view.fit(), "Home", "The usual view", "home")

    def _build(self) -> None:
        self.view = self._view_factory()
        self.view.hold = self._grab
        self.view.pulled.connect(self._pull)
        self.view.released.connect(self._let_handle_go)
        self.between = BetweenBar()
        self.between.setVisible(False)
        self.between.moved.connect(self._between_moved)
        self.between.released.connect(self._between_released)
        self.between.ends_chosen.connect(self._ends_chosen)
        whole = column(self.view, self.between, spacing=0)
        whole.setStretch(0, 1)
        self.centre = framed(whole, "centre")
        self.centre.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.between_button = action_button(self.actions, "between", self.binding)
        self.between_button.setCheckable(True)
        self.from_button = action_button(self.actions, "from_shape", self.binding)
        self.shown_as = Segments((("mesh", "Mesh", ""), ("points", "Points", "")), "mesh")
        self.shown_as.chosen.connect(lambda _value: self._show())
        self.as_points = False
        self.toolbar_widget = framed(
            row(
                action_button(self.actions, "mean_shape", self.binding),
                action_button(self.actions, "random_shape", self.binding),
                self.from_button,
                self.between_button,
                None,
                self.shown_as,
                action_button(self.actions, "home_synthesize", self.binding, text="", kind="tool"),
                margins=(16, 0, 16, 0),
            )  # fmt: skip
        )
        self._build_inspector()
        self.strip = HistoryStrip("History")
        self.strip.chosen.connect(self._go_to)

    def _build_inspector(self) -> None:
        self.map = FamilyMap()
        self.map.chosen.connect(lambda i: self._from_shape(self.sculptor.shape_names[i]))
        family = section(row(label("Family", "heading"), None, label("click to go there", "caption")), self.map)
        self.direction_count = label("", "off")
        reset = action_button(self.actions, "reset_sliders", self.binding, kind="link", icon=False)
        head = row(label("Directions", "heading"), self.direction_count, None, reset, margins=(16, 12, 16, 4))
        self.direction_rows = column(spacing=0)
        self.finer = button("", icon="down", kind="link")
        self.finer.clicked.connect(self._toggle_finer)
        self.finer_rows = QWidget()
        self.finer_rows.setLayout(column(spacing=0))
        self.finer_rows.setVisible(False)
        directions = QWidget()
        directions.setLayout(
            column(
                head,
                self.direction_rows,
                row(self.finer, None, margins=(16, 4, 16, 12)),
                self.finer_rows,
                separator(),
                spacing=0,
            )
        )
        self.part_rows = column(spacing=8)
        self.part_note = label("", "caption_off", wrap=True)
        parts = section(label("Parts", "heading"), self.part_rows, self.part_note, line=False)
        self.export = action_button(self.actions, "export_mesh", self.binding, kind="primary")
        foot = QFrame()
        foot.setObjectName("bar")
        foot.setLayout(
            column(
                self.export,
                label("glb, part names and a recipe to remake it", "caption"),
                spacing=8,
                margins=(16, 12, 16, 14),
            )
        )
        inside = column(scrolled(family, directions, parts), foot, spacing=0)
        inside.setStretch(0, 1)
        self.inspector = framed(inside)

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Take over: the learnt family, and its mean to begin with."""
        self._entered = True
        self._old_history = self.session.history
        if self.worker is None:
            self.worker = MeshWorker(self.sculptor, self._mail.arrived.emit)
        self._reload()
        if self.sculptor.has_machine:
            self.session.history = self.sculptor
            self._wanted()
            self._ask()

    def leave(self) -> None:
        """Let go of the history."""
        self._entered = False
        self._preview_timer.stop()
        self.session.history = self._old_history

    def close(self) -> None:
        """The window closes: the worker ends."""
        self._preview_timer.stop()
        self.thumbnails.forget()
        self.binding.close()
        if self.worker is not None:
            self.worker.close()
            self.worker = None

    def _reload(self) -> None:
        if not self._entered or self.session.project is None:
            return
        if self.sculptor.reload() and self.sculptor.has_machine:
            self._made_of, self.made, self._between = {}, None, None
            self._locked = set()
            self._show_family()
            self._fill_directions()
            self._fill_parts()
            self._points = self.sculptor.points()
            self._show(fit=True)
            self._ask()
            self._show_history()

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
            one.moved.connect(lambda value, index=index: self._slid(index, value))
            one.released.connect(lambda index=index: self._let_go(index))
            one.locked.connect(lambda on, index=index: self._lock(index, on))
            (self.direction_rows if index < sculptor.coarse else self.finer_rows.layout()).addWidget(one)
            self.rows.append(one)
        finer = len(self.rows) - sculptor.coarse
        self.finer.setVisible(finer > 0)
        self.finer.setText(f"{finer} finer directions")
        self.direction_count.setText(f"{sculptor.coarse} of {len(self.rows)}")
        refresh(self.inspector, self.session.theme)

    def _fill_parts(self) -> None:
        sculptor = self.sculptor
        clear(self.part_rows)
        self.switches: dict[int, Switch] = {}
        always, seen = sculptor.always(), sculptor.seen()
        shown = [part for part in range(len(sculptor.part_names)) if seen[part]]
        holders: list[QWidget] = []
        for part in shown:
            colour = "#{:02X}{:02X}{:02X}".format(*part_colours(len(sculptor.part_names))[part])
            switch = Switch(True, "Every shape of the family has it" if always[part] else "Switch this part on or off")
            switch.setEnabled(not always[part])
            switch.setAccessibleName(sculptor.part_names[part])
            switch.clicked.connect(lambda on, part=part: self._switch(part, on))
            self.switches[part] = switch
            holder = QWidget()
            holder.setLayout(row(Swatch(colour), 2, label(sculptor.part_names[part]), None, switch, spacing=6))
            holders.append(holder)
        for pair in zip(holders[::2], [*holders[1::2], QWidget()], strict=False):
            line = row(*pair, spacing=16)
            line.setStretch(0, 1)
            line.setStretch(1, 1)
            self.part_rows.addLayout(line)
        fixed = [sculptor.part_names[part] for part in shown if always[part]]
        words = " and ".join(([", ".join(fixed[:-1])] if fixed[:-1] else []) + fixed[-1:])
        self.part_note.setText(f"{words.capitalize()}: on every shape of the family." if fixed else "")

    # ---- wishes --------------------------------------------------------------------------------------------------

    def _wanted(self) -> None:
        """Sliders or parts are others: new points at once, a preview when they rest, the mesh when let go."""
        if not self._entered or not self.sculptor.has_machine:
            return
        self._wish += 1
        self._points = self.sculptor.points()
        exists = self.sculptor.exists()
        for index, one in enumerate(self.rows):
            one.set_value(self.session.sliders.get(index, 0.0))
            one.caption.setText(self.sculptor.caption(index))
        for part, switch in self.switches.items():
            switch.setChecked(bool(exists[part]))
        groups = self.session.project.groups
        if groups is not None and len(self.map._places) == len(self.sculptor.shape_names):
            ends = None
            if self._between is not None:
                ends = tuple(self.sculptor.shape_names.index(name) for name in self._between)
            self.map.set_here(self.sculptor.place_on_map(self.map._places, self._points), ends)
        self.made = None
        self._show()
        if self._dragging:
            self._preview_timer.start()
        else:
            self._ask()

    @property
    def _dragging(self) -> bool:
        if self._held is not None:
            return True
        return any(one.slider._drags for one in self.rows) or self.between.slider.isSliderDown()

    def _ask(self, *, preview: bool = False) -> None:
        if self.worker is not None and self._entered and self.sculptor.has_machine:
            self.worker.ask(self._wish, self._points, self.sculptor.exists(), preview)
            self._show_words()

    def _read_mail(self) -> None:
        result = None if self.worker is None else self.worker.take()
        if isinstance(result, Exception):
            self.session.say(f"The mesh could not be made: {result}", "error")
            self._show_words()
        elif result is not None and result.wish == self._wish:  # an answer to an older wish is dropped
            self.made = result
            if not result.preview:
                self._made_of[self.sculptor.done] = result
                self._show_pictures()
                self.session.edit_count += 1  # the mesh can be exported now
            self._show()

    def _slid(self, index: int, value: float) -> None:
        self.session.sliders = {**self.session.sliders, index: value}

    def _let_go(self, index: int) -> None:
        self._preview_timer.stop()
        value = self.session.sliders.get(index, 0.0)
        self._remember(f"{self.sculptor.names[index]} {value:+.1f}".replace("-", "−"))

    def _remember(self, label_: str) -> None:
        self.sculptor.keep(label_)
        self._after_step()

    def _after_step(self) -> None:
        self.session.edit_count += 1
        self._ask()
        self._show_history()

    def _lock(self, index: int, on: bool) -> None:
        self._locked = self._locked | {index} if on else self._locked - {index}

    def _switch(self, part: int, on: bool) -> None:
        self.session.parts_on = {**self.session.parts_on, part: on}
        self._remember(f"{self.sculptor.part_names[part]} {'on' if on else 'off'}")

    def _start(self, recipe: Recipe) -> None:
        kept = {i: v for i, v in self.session.sliders.items() if i in self._locked}
        self.sculptor.start(
            Recipe(recipe.label, recipe.base, {**recipe.sliders, **kept}, recipe.parts_on, recipe.origin)
        )
        self._wanted()
        self.view.fit_again()
        self._after_step()

    def _mean(self) -> None:
        self._end_between()
        self._start(Recipe("mean", self.sculptor.mean_base(), origin="mean"))

    def _random(self) -> None:
        self._end_between()
        base = self.sculptor.random_base()
        self._start(Recipe("random", base, origin=f"draw {self.sculptor._draws}"))

    def _choose_shape(self) -> None:
        menu = QMenu(self.from_button)
        menu.setStyleSheet("QMenu { menu-scrollable: 1; max-height: 480px; }")
        for name in self.sculptor.shape_names:
            menu.addAction(name, lambda name=name: self._from_shape(name))
        menu.popup(self.from_button.mapToGlobal(self.from_button.rect().bottomLeft()))

    def _from_shape(self, name: str) -> None:
        self._end_between()
        self._start(Recipe(name, self.sculptor.base_of(name), origin=name))

    def _reset(self) -> None:
        self.session.sliders = {i: v for i, v in self.session.sliders.items() if i in self._locked}
        self._remember("reset")

    def _go_to(self, index: int) -> None:
        self.sculptor.go_to(index)
        self._wanted()
        self.session.edit_count += 1
        self._show_history()

    # ---- pulling at a handle -------------------------------------------------------------------------------------

    def _grab(self, x: float, y: float) -> bool:
        """Take hold of the handle under the pointer, if there is one."""
        for k in self._handles:
            place = self.view.place_of(self._points[k])
            if np.hypot(place[0] - x, place[1] - y) < GRAB_PIXELS:
                self._held = (int(k), self._points[k].copy(), self.sculptor.pull(int(k), frozenset(self._locked)))
                return True
        return False

    def _pull(self, x: float, y: float) -> None:
        if self._held is None:
            return
        _, start, wanted = self._held
        place = self.view.place_of(start)
        camera, height = self.view.scene.camera, self.view.rectangles()[0][3]
        unit = 2 * camera.GetParallelScale() / height
        displacement = np.array([x - place[0], place[1] - y]) * unit @ camera_axes(camera)[:2]
        self.session.sliders = wanted(displacement)

    def _let_handle_go(self) -> None:
        if self._held is not None:
            part = self.sculptor.part_names[self.sculptor.part[self._held[0]]]
            self._held = None
            self._preview_timer.stop()
            self._remember(f"{part} pulled")

    def _marks(self) -> tuple[Mark, ...]:
        """The handles, the one in hand filled and with an arrow from where it was."""
        marks = []
        for k in self._handles:
            at = tuple(float(x) for x in self._points[k])
            held = self._held is not None and self._held[0] == k
            if held:
                marks.append(Mark("arrow", tuple(float(x) for x in self._held[1]), to=at))
            marks.append(Mark("dot" if held else "ring", at))
        return tuple(marks)

    # ---- between two shapes --------------------------------------------------------------------------------------

    def _toggle_between(self) -> None:
        if self._between is not None:
            self._end_between()
            self._wanted()
            return
        names = self.sculptor.shape_names
        chosen = [name for name in self.session.selected if name in names][:2]
        nearest, _ = self.sculptor.nearest(self._points)
        others = [name for name in dict.fromkeys((nearest, *names[::-1])) if name not in chosen]
        ends = (chosen + others)[:2] if len(names) > 1 else [names[0], names[0]]
        self._ends_chosen(ends[0], ends[1])
        self._between_released()

    def _end_between(self) -> None:
        self._between = None
        self.between.setVisible(False)
        self.between_button.setChecked(False)

    def _ends_chosen(self, first: str, second: str) -> None:
        self._between = (first, second)
        self.between.set_ends(self.sculptor.shape_names, self._between)
        self.between.setVisible(True)
        self.between_button.setChecked(True)
        self._between_moved(self._share)
        self._show_ends()
        if not self.between.slider.isSliderDown():
            self._after_step()

    def _between_moved(self, share: float) -> None:
        """Every move replaces the item of the history that this drag makes; letting go keeps it."""
        if self._between is None:
            return
        self._share = share
        self.between.set_share(share)
        first, second = (self.sculptor.base_of(name) for name in self._between)
        recipe = Recipe(
            f"A–B {share:.0%}", self.sculptor.between(first, second, share), origin=" – ".join(self._between)
        )
        if self.sculptor.recipe.origin == recipe.origin and self.between.slider.isSliderDown() and self._in_drag:
            self.sculptor.recipes[self.sculptor.done] = recipe
            self.session.sliders = {}
        else:
            self.sculptor.start(recipe)
        self._in_drag = self.between.slider.isSliderDown()
        self._wanted()

    _in_drag = False

    def _between_released(self) -> None:
        self._in_drag = False
        self._preview_timer.stop()
        self._after_step()

    def _show_ends(self) -> None:
        if self._between is not None:
            for picture, name in zip(self.between.pictures, self._between, strict=True):
                picture.set_pixmap(self.thumbnails.shape(name, (88, 88), parts="fitted"))

    # ---- showing -------------------------------------------------------------------------------------------------

    def _layers(self) -> tuple[Any, ...]:
        points_wanted = self.shown_as.button("points").isChecked()
        if self.made is not None and not points_wanted:
            return (self.sculptor.mesh_layer(self.made.shape),)
        return (self.sculptor.points_layer(self._points, 5.0 if points_wanted or self.made is None else 3.0),)

    def _show(self, *, fit: bool = False) -> None:
        if not self._entered or not self.sculptor.has_machine:
            return
        self._drawn = self._layers()
        self._show_words(fit=fit)

    def _show_words(self, *, fit: bool = False) -> None:
        busy = self.worker is not None and self.worker.busy
        if self._held is None:
            self._handles = self.sculptor.handles(self._points)
        display = self.sculptor.display(self._drawn, self.made, self._label(), busy, self._marks())
        self.view.display(display, fit=fit)

    def _label(self) -> str:
        label_ = self.sculptor.recipe.label
        changed = dict(self.session.sliders) != dict(self.sculptor.recipe.sliders)
        return label_[:1].upper() + label_[1:] + (", changed" if changed else "")

    def _show_history(self) -> None:
        recipes = self.sculptor.recipes
        self.strip.caption.setText(f"{len(recipes)} shape{'s' * (len(recipes) != 1)}")
        for i in [i for i in self._made_of if i > self.sculptor.done and i >= len(recipes)]:
            del self._made_of[i]
        self.strip.show_states([(recipe.label, "") for recipe in recipes], self.sculptor.done, self._picture)
        refresh(self.strip, self.session.theme)

    def _show_pictures(self) -> None:
        self.strip.refresh_pictures(self._picture, self.sculptor.done)
        self._show_ends()

    def _picture(self, index: int) -> QPixmap | None:
        sculptor, theme = self.sculptor, self.session.theme
        recipe = sculptor.recipes[index]
        made = self._made_of.get(index)
        if made is not None and made.wish < 0:
            made = None

        def take() -> np.ndarray:
            if made is not None:
                layer: Any = sculptor.mesh_layer(made.shape)
            else:
                layer = sculptor.points_layer(sculptor.points(recipe), 2.0)
            return take_picture(View((layer,)), (128, 104), theme, transparent=True)

        return self.thumbnails.pixmap(("draw", id(recipe), id(made), theme), take)

    def _toggle_finer(self) -> None:
        self.finer_rows.setVisible(not self.finer_rows.isVisible())

    # ---- verdicts and export -------------------------------------------------------------------------------------

    def _ready(self, _session: Session) -> tuple[bool, str]:
        return YES if self.sculptor.has_machine else (False, "Learn the family first.")

    def _can_export(self, session: Session) -> tuple[bool, str]:
        if not self.sculptor.has_machine:
            return self._ready(session)
        return YES if self.made is not None and not self.made.preview else (False, "The mesh is being made.")

    def _export(self) -> None:
        path = self.actions.desk.choose_save(
            "Export the mesh (glb, ply, obj or stl)", f"{self.sculptor.recipe.label}.glb"
        )
        if path is None or self.made is None:
            return
        if not path.suffix:
            path = path.with_suffix(".glb")
        export_mesh(path, self.sculptor, self.made.shape, self.sculptor.recipe)
        self.session.say(f"Saved {path.name} and its recipe", "ok")
