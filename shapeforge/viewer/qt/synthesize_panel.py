"""The Synthesize place: new shapes from sliders with the range of the data; points at once, then a mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QWidget

from shapeforge.collection.counts import counted
from shapeforge.viewer.actions import Actions
from shapeforge.viewer.mesh_worker import Made, MeshWorker, Wish
from shapeforge.viewer.pictures import take_picture
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Segments
from shapeforge.viewer.qt.handles import Handles
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.paint_parts import HistoryStrip
from shapeforge.viewer.qt.synthesize_actions import add_actions
from shapeforge.viewer.qt.synthesize_between import Between
from shapeforge.viewer.qt.synthesize_draws import Draws
from shapeforge.viewer.qt.synthesize_inspector import SynthesizeInspector
from shapeforge.viewer.qt.synthesize_sections import not_learnt, shapes_menu
from shapeforge.viewer.qt.synthesize_shows import Shows
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import column, framed, row
from shapeforge.viewer.sculptor import Recipe, Sculptor
from shapeforge.viewer.sculpture import display, heated, small_view
from shapeforge.viewer.session import Session


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
        self.worker: MeshWorker | None = None
        self.made: Made | None = None
        self._live: Made | None = None
        self._made_of: dict[Recipe, Made] = {}
        self._wish = 0
        self._entered = False
        self.points = np.zeros((0, 3))
        self._recipe: Recipe | None = None
        self.problem = ""
        self._old_history = session.history
        self._mail = _Mail()
        self._mail.arrived.connect(self._read_mail)
        self._build(view_factory)
        for carrier in (self.thumbnails, self._mail):
            carrier.setParent(self.centre)
        self.thumbnails.arrived.connect(self._show_pictures)
        self.binding.on(("sliders", "parts_on", "pins"), self.wanted, now=False)
        self.binding.on(("edit_count",), self._follow_history, now=False)
        self.binding.on(("theme", "mesh_colours"), self._show_colours, now=False)
        self.binding.on(("temperature", "near"), self._show_wishes, now=False)
        self.binding.on(("data",), self._reload, now=False)

    # ---- building ------------------------------------------------------------------------------------------------

    def _build(self, view_factory: Callable[[], QWidget]) -> None:
        self.view = view_factory()
        self.handles = Handles(self.session, self.view, self.sculptor, self._remember)
        self.between, self.shows, self.draws = Between(self), Shows(self), Draws(self)
        add_actions(self)
        self.nothing = not_learnt(self.actions, self.binding)
        whole = column(self.view, self.shows.gallery, self.nothing, self.between.bar, spacing=0)
        for place in range(3):
            whole.setStretch(place, 1)
        self.centre = framed(whole, "centre")
        self.centre.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.between_button = action_button(self.actions, "between", self.binding)
        self.between_button.setCheckable(True)
        self.gallery_button = action_button(self.actions, "gallery", self.binding)
        self.gallery_button.setCheckable(True)
        self.from_button = action_button(self.actions, "from_shape", self.binding)
        self.shown_as = Segments((("mesh", "Mesh", ""), ("points", "Points", "")), "mesh")
        self.shown_as.chosen.connect(lambda _value: self._show())
        self.toolbar_widget = framed(
            row(
                action_button(self.actions, "mean_shape", self.binding),
                action_button(self.actions, "random_shape", self.binding),
                self.from_button,
                self.between_button,
                self.gallery_button,
                None,
                self.shown_as,
                action_button(self.actions, "spin", self.binding, text="", kind="tool"),
                action_button(self.actions, "home_synthesize", self.binding, text="", kind="tool"),
                margins=(16, 0, 16, 0),
            )  # fmt: skip
        )
        self.inspector = SynthesizeInspector(self.session, self.sculptor, self.actions, self.binding)
        self.inspector.shape_chosen.connect(self._from_shape)
        self.inspector.slid.connect(self._slid)
        self.inspector.let_go.connect(self._let_go)
        self.inspector.locking.connect(self._lock)
        self.inspector.pins.pointed.connect(self.handles.point_at)
        self.inspector.pins.unpinned.connect(self.handles.unpin)
        self.inspector.pins.focus_lost.connect(self.centre.setFocus)
        self.inspector.switched.connect(self._switch)
        self.inspector.hovered.connect(self.shows.heat)
        self.inspector.taken.connect(self._take_part)
        self.inspector.mesh.route_chosen.connect(lambda route: self._make_by(route, self.sculptor.recipe.union))
        self.inspector.mesh.union_switched.connect(lambda on: self._make_by(self.sculptor.recipe.route, on))
        self.inspector.mesh.colours_chosen.connect(lambda colours: setattr(self.session, "mesh_colours", colours))
        self.strip = HistoryStrip("History")
        self.strip.chosen.connect(self._go_to)

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Take over: the learnt family, and its mean to begin with."""
        self._entered = True
        self._old_history = self.session.history
        if self.worker is None:
            arrived = self._mail.arrived.emit
            self.worker = MeshWorker(self.session, self.sculptor.nearest, arrived, self.sculptor.prepare)
        self._reload()
        if self.sculptor.has_machine:
            self.session.history = self.sculptor
            self.inspector.show_colours()
            self.wanted()
            self._ask()

    def leave(self) -> None:
        """Let go of the history."""
        self._entered = False
        self.shows.spin.set_on(False)
        self.session.history = self._old_history

    def close(self) -> None:
        """The window closes: the worker ends."""
        self.thumbnails.forget()
        self.binding.close()
        if self.worker is not None:
            self.worker.close()
            self.worker = None

    def _reload(self) -> None:
        if not self._entered or self.session.project is None:
            return
        other, learnt = self.sculptor.reload(), self.sculptor.has_machine
        self.nothing.setVisible(not learnt)
        self.inspector.show_nothing(not learnt)
        if other or not learnt:
            self.shows.gallery.setVisible(False)
            self.view.setVisible(learnt)
        if other and learnt:
            self._made_of, self.made, self._live = {}, None, None
            self.between.end()
            self.inspector.fill()
            self.points = self.sculptor.points()
            self._show(fit=True)
            self._ask()
            self._show_history()

    # ---- wishes --------------------------------------------------------------------------------------------------

    def wanted(self) -> None:
        """The shape in hand is another: its points at once; previews while something is dragged, else its mesh."""
        if not self._entered or not self.sculptor.has_machine:
            return
        self.between.end_if_left()
        self.shows.leave_gallery()
        self._wish, self.problem = self._wish + 1, ""
        self._recipe = self.sculptor.recipe
        self.points = self.sculptor.points()
        if not self.is_dragging:
            self._live = None
        known = self._made_of.get(self._recipe) if self.sculptor.as_kept else None
        self.made = None if known is None else replace(known, wish=self._wish)
        self.inspector.show_values(self.points, self.between.ends)
        self._show()
        self._ask(preview=self.is_dragging)

    def _follow_history(self) -> None:
        """Undo and Redo lead to another base, or other parts taken, while sliders and switches may stay the same."""
        if self._entered and self.sculptor.has_machine and self.sculptor.recipe is not self._recipe:
            self.wanted()
            self._show_history()

    @property
    def is_dragging(self) -> bool:
        """A slider, a handle or the way from A to B is in hand."""
        return self.handles.held is not None or self.inspector.is_dragging or self.between.is_dragged

    def _ask(self, *, preview: bool = False) -> None:
        if self.worker is None or not self._entered or not self.sculptor.has_machine or self.made is not None:
            return
        sculptor, recipe = self.sculptor, self.sculptor.recipe
        how = recipe.taken, recipe.route, recipe.union, sculptor.symmetric()
        self.worker.ask(Wish(self._wish, self.points, sculptor.exists(), preview, *how))
        self._show_words()

    def _read_mail(self) -> None:
        result = None if self.worker is None else self.worker.take()
        self.shows.show_pictures()
        if isinstance(result, Exception):
            self.problem = f"The mesh could not be made: {result}"
            self.session.say(self.problem, "error")
            self.session.edit_count += 1  # why it cannot be exported
            self._show_words()
        elif result is not None and result.preview:
            if self.is_dragging:  # it may be a step or two behind the points: the next one is under way
                self._live = result
                self._show()
        elif result is not None and result.wish == self._wish:  # an answer to an older wish is dropped
            self._take_mesh(result)

    def _take_mesh(self, result: Made) -> None:
        made = self.draws.settled(result)
        if made is None:
            self._show_words()
            return
        self.made, self._live = replace(made, wish=self._wish), None
        if self.sculptor.as_kept:
            self.remember_mesh(self.sculptor.recipe, self.made)
        self._show_pictures()
        self.session.edit_count += 1  # the mesh can be exported now
        self._show()
        self.view.fit_if_cut()

    def remember_mesh(self, recipe: Recipe, made: Made) -> None:
        """The mesh of a shape of the history: it need not be made again."""
        self._made_of[recipe] = made

    def _slid(self, index: int, value: float) -> None:
        self.sculptor.slide(index, value)

    def _lock(self, index: int, on: bool) -> None:
        self.sculptor.lock(index, on)
        self.inspector.show_wishes()
        if self.sculptor.pinned():  # another shape may follow the pins
            self.wanted()
            self._remember(f"{self.sculptor.names[index]} {'locked' if on else 'unlocked'}")

    def _let_go(self, index: int) -> None:
        value = float(self.sculptor.values()[index])
        self._remember(f"{self.sculptor.names[index]} {value:+.1f}".replace("-", "−"))

    def _remember(self, label_: str) -> None:
        self.sculptor.keep(label_)
        self.after_step()

    def after_step(self) -> None:
        """The history has a new item: show it, and make its mesh."""
        self._recipe = self.sculptor.recipe
        self.session.edit_count += 1
        self.view.fit_if_cut()
        self._ask()
        self._show_history()

    def _switch(self, part: int, on: bool) -> None:
        self.session.parts_on = {**self.session.parts_on, part: on}
        self._remember(f"{self.sculptor.part_names[part]} {'on' if on else 'off'}")

    def _take_part(self, part: int, name: str) -> None:
        self.sculptor.take_part(part, name)
        self.wanted()
        self.after_step()

    def _make_by(self, route: str, union: bool) -> None:
        self.sculptor.make_by(route, union)
        self.wanted()
        self.after_step()

    def take_up(self, recipe: Recipe, *, instead: bool = False) -> None:
        """Go on with another shape, or ``instead`` of the one in hand; locked sliders keep their place, but one with
        pins brings its own locks along."""
        self.between.end()
        kept = {} if recipe.pins else self.sculptor.kept(recipe.base)
        go = self.sculptor.exchange if instead else self.sculptor.start
        go(replace(recipe, sliders={**recipe.sliders, **kept}))
        self.wanted()
        self.view.fit_again()
        self.after_step()

    def begin(self, recipe: Recipe, *, instead: bool = False) -> None:
        """Take up another shape, its mesh made as those before."""
        now = self.sculptor.recipe
        self.take_up(replace(recipe, route=now.route, union=now.union), instead=instead)

    def take_mean(self) -> None:
        """The middle of the family."""
        self.begin(Recipe("mean", self.sculptor.mean_base(), origin="mean"))

    def choose_shape(self) -> None:
        """A menu of the family's shapes, and of recipes."""
        menu = shapes_menu(self.from_button, self.actions, self.sculptor.shape_names, self._from_shape)
        menu.popup(self.from_button.mapToGlobal(self.from_button.rect().bottomLeft()))

    def _from_shape(self, name: str) -> None:
        self.begin(Recipe(name, self.sculptor.base_of(name), origin=name))

    def reset(self) -> None:
        """All sliders that are not locked to where the shape stands by itself, and all pins away."""
        self.session.sliders = {i: v for i, v in self.session.sliders.items() if i in self.session.locked}
        self.session.pins = {}
        self._remember("reset")

    def reset_parts(self) -> None:
        """The parts that the shape has by itself; draws are free again."""
        self.session.parts_on = {}
        self._remember("parts reset")

    def _go_to(self, index: int) -> None:
        self.sculptor.go_to(index)
        self.wanted()
        self.view.fit_if_cut()
        self.session.edit_count += 1
        self._show_history()

    # ---- showing -------------------------------------------------------------------------------------------------

    def _layers(self) -> tuple[Any, ...]:
        layers, hot = self._plain_layers(), self.shows.heated
        if hot is None or self.is_dragging:
            return layers
        return tuple(heated(self.sculptor, one, self.points, hot) for one in layers)

    def _plain_layers(self) -> tuple[Any, ...]:
        if self.shown_as.button("points").isChecked():
            return (self.sculptor.points_layer(self.points),)
        if self.made is not None:
            return (self.sculptor.mesh_layer(self.made.shape),)
        if self._live is not None:  # the points are ahead of it
            return (self.sculptor.mesh_layer(self._live.shape), self.sculptor.points_layer(self.points, 3.0))
        return (self.sculptor.points_layer(self.points),)

    def _show(self, *, fit: bool = False) -> None:
        if not self._entered or not self.sculptor.has_machine:
            return
        self._drawn = self._layers()
        self.inspector.show_mesh(None if self.made is None else self.made.shape)
        self._show_words(fit=fit)

    def _show_words(self, *, fit: bool = False) -> None:
        busy = self.worker is not None and self.worker.busy
        made = self._live if self.made is None else self.made
        as_points = made is None or self.shown_as.button("points").isChecked()
        self.handles.follow(self.points, None if as_points else made.shape.vertices)
        marks = self.handles.marks()
        shown = display(
            self._drawn, made, self._label(), busy, marks, self.is_dragging, failed=bool(self.problem),
            n_pins=len(self.sculptor.pinned()), turn=self.draws.turn,
        )  # fmt: skip
        self.view.display(shown, fit=fit)

    def _show_colours(self) -> None:
        self._show()
        if self._entered and self.sculptor.has_machine:
            self._show_pictures()

    def _show_wishes(self) -> None:
        if self.sculptor.has_machine:
            self.inspector.show_wishes()

    def _label(self) -> str:
        label_ = self.sculptor.recipe.label
        return label_[:1].upper() + label_[1:] + ("" if self.sculptor.as_kept else ", changed")

    def _show_history(self) -> None:
        recipes = self.sculptor.recipes
        self.strip.caption.setText(counted(len(recipes), "shape"))
        self._made_of = {recipe: self._made_of[recipe] for recipe in recipes if recipe in self._made_of}
        self.strip.show_states([(recipe.label, "") for recipe in recipes], self.sculptor.done, self._picture)
        refresh(self.strip, self.session.theme)

    def _show_pictures(self) -> None:
        self.shows.show_pictures()
        self.strip.refresh_pictures(self._picture, self.sculptor.done)
        self.between.show_ends()

    def _picture(self, index: int) -> QPixmap | None:
        sculptor, theme = self.sculptor, self.session.theme
        recipe = sculptor.recipes[index]
        made = self._made_of.get(recipe)

        def take() -> np.ndarray:
            return take_picture(small_view(sculptor, recipe, made), (128, 104), theme, transparent=True)

        key = "draw", id(recipe), id(made), theme, self.session.mesh_colours, sculptor.inks.tobytes()
        return self.thumbnails.pixmap(key, take)
