"""The Synthesize place: new shapes from sliders with the range of the data; points at once, then a mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QMenu, QWidget

from shapeforge.viewer.actions import YES, Action, Actions
from shapeforge.viewer.display import View
from shapeforge.viewer.mesh_worker import Made, MeshWorker
from shapeforge.viewer.pictures import take_picture
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.handles import Handles
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.paint_parts import HistoryStrip
from shapeforge.viewer.qt.synthesize_inspector import SynthesizeInspector
from shapeforge.viewer.qt.synthesize_parts import BetweenBar
from shapeforge.viewer.qt.synthesize_shows import Shows
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import (
    Segments,
    column,
    framed,
    row,
)
from shapeforge.viewer.sculptor import Recipe, Sculptor, export_mesh
from shapeforge.viewer.session import Session

PREVIEW_MS = 120  # a slider that rests this long gets a preview mesh; one that is let go the final one


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
        self._between: tuple[str, str] | None = None
        self._share = 0.5
        self._recipe: Recipe | None = None
        self._old_history = session.history
        self._add_actions()
        self._build()
        self._preview_timer = QTimer(self.centre, singleShot=True, interval=PREVIEW_MS)
        self._preview_timer.timeout.connect(lambda: self._ask(preview=True))
        for carrier in (self.thumbnails, self._mail):
            carrier.setParent(self.centre)
        self.thumbnails.arrived.connect(self._show_pictures)
        self.binding.on(("sliders", "parts_on"), self._wanted, now=False)
        self.binding.on(("edit_count",), self._follow_history, now=False)
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
        add("gallery", "Gallery", lambda: self.shows.show_gallery(True), "G", "A dozen draws to choose from", "grid")
        add("spin", "Turn around", lambda: self.shows.toggle_spin(), "T", "Turns by itself; again to stop", "rotate")
        add("export_movie", "Export movie…", lambda: self.shows.export_movie(), "", "One turn: gif, webp or png",
            "play", self._can_export)  # fmt: skip
        add("home_synthesize", "Look from the front", lambda: self.view.fit(), "Home", "The usual view", "home")

    def _build(self) -> None:
        self.view = self._view_factory()
        self.handles = Handles(
            self.session, self.view, self.sculptor, lambda: self.inspector.locked, self._let_handle_go
        )
        self.between = BetweenBar()
        self.between.setVisible(False)
        self.between.moved.connect(self._between_moved)
        self.between.released.connect(self._between_released)
        self.between.ends_chosen.connect(self._ends_chosen)
        self.shows = Shows(self)
        whole = column(self.view, self.shows.gallery, self.between, spacing=0)
        whole.setStretch(0, 1)
        whole.setStretch(1, 1)
        self.centre = framed(whole, "centre")
        self.centre.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.between_button = action_button(self.actions, "between", self.binding)
        self.between_button.setCheckable(True)
        self.from_button = action_button(self.actions, "from_shape", self.binding)
        self.shown_as = Segments((("mesh", "Mesh", ""), ("points", "Points", "")), "mesh")
        self.shown_as.chosen.connect(lambda _value: self._show())
        self.toolbar_widget = framed(
            row(
                action_button(self.actions, "mean_shape", self.binding),
                action_button(self.actions, "random_shape", self.binding),
                self.from_button,
                self.between_button,
                action_button(self.actions, "gallery", self.binding),
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
        self.inspector.switched.connect(self._switch)
        self.inspector.hovered.connect(self.shows.heat)
        self.inspector.taken.connect(self._take_part)
        self.strip = HistoryStrip("History")
        self.strip.chosen.connect(self._go_to)

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Take over: the learnt family, and its mean to begin with."""
        self._entered = True
        self._old_history = self.session.history
        if self.worker is None:
            self.worker = MeshWorker(self.session, self.sculptor.nearest, self._mail.arrived.emit)
        self._reload()
        if self.sculptor.has_machine:
            self.session.history = self.sculptor
            self.inspector.show_colours()
            self._wanted()
            self._ask()

    def leave(self) -> None:
        """Let go of the history."""
        self._entered = False
        self._preview_timer.stop()
        self.shows.spin.set_on(False)
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
            self.inspector.fill()
            self._points = self.sculptor.points()
            self._show(fit=True)
            self._ask()
            self._show_history()

    # ---- wishes --------------------------------------------------------------------------------------------------

    def _wanted(self) -> None:
        """Sliders or parts are others: new points at once, a preview when they rest, the mesh when let go."""
        if not self._entered or not self.sculptor.has_machine:
            return
        if self._between is not None and self.sculptor.recipe.origin != " – ".join(self._between):
            self._end_between()  # undo or the history led to a shape that is not between A and B
        self._wish += 1
        self._recipe = self.sculptor.recipe
        self._points = self.sculptor.points()
        self.inspector.show_values(self._points, self._between)
        self.made = None
        self._show()
        if self._dragging:
            self._preview_timer.start()
        else:
            self._ask()

    def _follow_history(self) -> None:
        """Undo and Redo lead to another base, or other parts taken, while sliders and switches may stay the same."""
        if self._entered and self.sculptor.has_machine and self.sculptor.recipe is not self._recipe:
            self._wanted()
            self._show_history()

    @property
    def _dragging(self) -> bool:
        held = self.handles.held is not None
        return held or self.inspector.is_dragging or self.between.slider.isSliderDown()

    def _ask(self, *, preview: bool = False) -> None:
        if self.worker is not None and self._entered and self.sculptor.has_machine:
            self.worker.taken = self.sculptor.recipe.taken
            self.worker.ask(self._wish, self._points, self.sculptor.exists(), preview)
            self._show_words()

    def _read_mail(self) -> None:
        result = None if self.worker is None else self.worker.take()
        self.shows.show_pictures()
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
            if not result.preview:
                self.view.fit_if_cut()

    def _slid(self, index: int, value: float) -> None:
        self.session.sliders = {**self.session.sliders, index: value}

    def _let_go(self, index: int) -> None:
        self._preview_timer.stop()
        value = self.session.sliders.get(index, 0.0)
        self._remember(f"{self.sculptor.names[index]} {value:+.1f}".replace("-", "−"))

    def _let_handle_go(self, words: str) -> None:
        self._preview_timer.stop()
        self._remember(words)

    def _remember(self, label_: str) -> None:
        self.sculptor.keep(label_)
        self._after_step()

    def _after_step(self) -> None:
        self.session.edit_count += 1
        self.view.fit_if_cut()
        self._ask()
        self._show_history()

    def _switch(self, part: int, on: bool) -> None:
        self.session.parts_on = {**self.session.parts_on, part: on}
        self._remember(f"{self.sculptor.part_names[part]} {'on' if on else 'off'}")

    def _take_part(self, part: int, name: str) -> None:
        self.sculptor.take_part(part, name)
        self._wanted()
        self._after_step()

    def _start(self, recipe: Recipe) -> None:
        kept = {i: v for i, v in self.session.sliders.items() if i in self.inspector.locked}
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
        self.session.sliders = {i: v for i, v in self.session.sliders.items() if i in self.inspector.locked}
        self._remember("reset")

    def _go_to(self, index: int) -> None:
        self.sculptor.go_to(index)
        self._wanted()
        self.view.fit_if_cut()
        self.session.edit_count += 1
        self._show_history()

    # ---- between two shapes --------------------------------------------------------------------------------------

    def _toggle_between(self) -> None:
        if self._between is not None:
            self._end_between()
            self._wanted()
            return
        names = self.sculptor.shape_names
        chosen = [name for name in self.session.selected if name in names][:2]
        first = chosen[0] if chosen else self.sculptor.nearest(self._points)[0]
        ends = chosen if len(chosen) == 2 else [first, self.sculptor.other_end(first)]
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
        layers = self._plain_layers()
        hot = self.shows.heated
        return layers if hot is None else tuple(self.sculptor.heated(one, self._points, hot) for one in layers)

    def _plain_layers(self) -> tuple[Any, ...]:
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
        self.handles.follow(self._points)
        display = self.sculptor.display(self._drawn, self.made, self._label(), busy, self.handles.marks())
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
        self.shows.show_pictures()
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

        return self.thumbnails.pixmap(("draw", id(recipe), id(made), theme, sculptor.inks.tobytes()), take)

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
