"""Fit: watch the templates find their way to every shape; run, pause, step, stop, and look back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QWidget

from shapeforge.collection.counts import counted
from shapeforge.viewer.actions import Action, Actions, group_of, groups_of
from shapeforge.viewer.display import Caption, Display, grid_of
from shapeforge.viewer.fit_display import (
    UNTURNED,
    MeshLayer,
    template_view,
    three_views,
)
from shapeforge.viewer.fit_record import WATCHED_AT_MOST, FitRecord, look_at, moved_text
from shapeforge.viewer.picking import Pick
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Choice, Segments
from shapeforge.viewer.qt.fit_keys import fit_actions
from shapeforge.viewer.qt.fit_pictures import FitPictures
from shapeforge.viewer.qt.fit_report import FitReport
from shapeforge.viewer.qt.fit_run import CorrectionFoot, RunStrip, rounds_planned
from shapeforge.viewer.qt.fit_widgets import AlsoWatching, show_legend
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.stale_note import stale_note
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.widgets import ElidedLabel, button, column, framed, label, row, separator, shortened
from shapeforge.viewer.readiness import QUALITIES, chosen_quality, planned_rounds, rounds_text
from shapeforge.viewer.session import Session

_QUALITY = {
    "draft": "a first look", "normal": "good enough for most families", "fine": "until hardly anything moves any more"
}  # fmt: skip


class FitPlace:
    """Three linked views, other shapes below, curves and parts at the right, rounds in the strip."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.binding = Binding(session)
        self.record: FitRecord | None = None
        self.pictures = FitPictures(session)
        self._fitted_shape: object = None
        actions.add(
            Action("correct", "Correct by painting", self._correct, self._can_correct, "C",
                   "Paint the shape; the next fit takes it as evidence", "paint", "fit")
        )  # fmt: skip
        for action in fit_actions(self):
            actions.add(action)
        self.view = view_factory()
        self.toolbar_widget = self._make_tools()
        self.centre = self._make_centre()
        self.inspector = self._make_inspector()
        self.strip = self._make_strip()
        # Several changes at once are shown once.
        self._soon = QTimer(self.centre, singleShot=True, interval=0)
        self._soon.timeout.connect(lambda: self.binding.safely(self._show_all))
        self.view.camera_moved.connect(self._camera_moved)
        self.view.clicked.connect(self._click)
        self.binding.on(("project",), self._project_changed)
        self.binding.on(("progress",), self._take_progress)
        self.binding.on(("shape", "round", "data", "theme", "watched"), self._show_soon, now=False)
        self.binding.on(
            ("running", "is_paused", "progress", "status", "shape", "data", "theme", "quality"),
            self._show_run,
            now=False,
        )

    def enter(self) -> None:
        """Look at the selected shape, else at one that has to be explained (an exemplar is so from the start)."""
        session = self.session
        if not session.watched:
            session.watched = self._default_watched()
        if session.shape is None and session.watched:
            session.shape = session.watched[0]
        self.binding.safely(self._show_all)
        self._show_run()

    def leave(self) -> None:
        """Nothing runs in this place itself."""
        self._soon.stop()

    def close(self) -> None:
        """The window closes."""
        self.binding.close()
        self._soon.stop()
        self.view.shut()

    # -- making ----------------------------------------------------------------------------------------------------

    def _make_tools(self) -> QWidget:
        self.watch = Choice("Watch", [], "", tooltip="Which shape to look at")
        self.watch.chosen.connect(self._watch)
        self.mode = Segments([("one", "One shape", ""), ("grid", "Grid", "")], "one")
        for mode, says in (("one", "Input, template and parts of one shape"), ("grid", "The watched shapes at once")):
            self.mode.button(mode).setToolTip(says)
        self.mode.chosen.connect(lambda _: self._show_soon())
        self.by = Choice(
            "Colour by",
            [("part", "part"), ("movement", "movement")],
            "part",
            tooltip="The part of each template point, or how far it moved in this round",
        )
        self.by.chosen.connect(lambda _: self._show_soon())
        self.quality_text = label("Quality", "text2")
        self.quality = Segments([(name, name.capitalize(), "") for name in QUALITIES], "")
        self.quality.chosen.connect(lambda value: setattr(self.session, "quality", value))
        self.home = button(icon="home", kind="tool", tooltip="Show all of the shape")
        self.home.clicked.connect(lambda: self.view.fit())
        self.linked = button(icon="link", kind="tool", checkable=True, tooltip="Turn the small pictures along")
        self.linked.setChecked(self.session.linked)
        self.linked.toggled.connect(lambda on: setattr(self.session, "linked", on))
        self.linked.toggled.connect(lambda _: self._camera_moved())
        return framed(
            row(
                self.watch,
                self.mode,
                self.by,
                None,
                self.quality_text,
                self.quality,
                4,
                self.home,
                self.linked,
                margins=(PADDING, 0, PADDING, 0),
            )
        )

    def _make_centre(self) -> QWidget:
        self.heads: list[tuple[ElidedLabel, ElidedLabel]] = []
        cells = []
        for i, title in enumerate(("Input", "Template", "Probable parts")):
            name, about = label(title, "heading"), ElidedLabel("", "text2")
            self.heads.append((name, about))
            cell = framed(row(name, about, None, margins=(12, 0, 8, 0)), "view_row", height=32)
            if i:
                cells.append(separator(vertical=True, height=32))
            cells.append(cell)
        self.head_row = row(spacing=0)
        for cell in cells:
            self.head_row.addWidget(cell, 0 if cell.width() == 1 else 1)
        self.heads_widget = QWidget()
        self.heads_widget.setLayout(self.head_row)
        self.legend = row(spacing=6, margins=(12, 0, 12, 0))
        legend_bar = framed(self.legend, "view_foot", height=30)
        self.watch_it = action_button(self.actions, "watch_it", self.binding, kind="tool", text="")
        self.also_watching = AlsoWatching(self.watch_it)
        self.also_watching.sort.chosen.connect(lambda _: self._show_soon())
        self.also_watching.clicked.connect(self._watch)
        result = QWidget()
        result.setObjectName("centre")
        box = column(self.heads_widget, spacing=0)
        box.addWidget(self.view, 1)
        box.addWidget(legend_bar)
        box.addWidget(self.also_watching)
        result.setLayout(box)
        result.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        return result

    def _make_inspector(self) -> QWidget:
        stale = stale_note(self.actions, self.binding, "fit", "fit", "Run it again", rather="refit")
        self.report = FitReport(stale)
        self.report.watch.connect(self._watch_all)
        self.report.override.connect(self._override)
        self.correction = CorrectionFoot(self.session, self.actions, self.binding)
        self.next = action_button(
            self.actions, "go_correspondence", self.binding, text="Compare points", kind="primary"
        )
        foot = column(self.correction, self.next, spacing=6, margins=(PADDING, 12, PADDING, 12))
        result = QWidget()
        result.setLayout(column(self.report, separator(), foot, spacing=0))
        return result

    def _make_strip(self) -> QWidget:
        strip = RunStrip(self.actions, self.binding)
        self.run, self.step, self.stop, self.scrubber = strip.run, strip.step, strip.stop, strip.scrubber
        self.scrubber.moved.connect(self.look_back)
        return strip

    # -- what is watched -------------------------------------------------------------------------------------------

    def _here(self) -> bool:
        return self.session.project is not None and self.session.place == "fit"

    def _default_watched(self) -> tuple[str, ...]:
        """Shapes of every group in turn, the exemplars last: they are explained from the start."""
        groups, names = groups_of(self.session), self.session.project.names
        if groups is None:
            return names[:WATCHED_AT_MOST]
        exemplars = set(groups.exemplars.tolist())
        queues = [[t for t in groups.members(g) if t not in exemplars] for g in range(len(groups))]
        order = [queue[i] for i in range(max(map(len, queues), default=0)) for queue in queues if i < len(queue)]
        order += sorted(exemplars)
        return tuple(names[t] for t in order[:WATCHED_AT_MOST])

    def _watch(self, name: str) -> None:
        if name == "":
            self.actions.run("find")
        else:
            self.session.shape = name

    def _click(self, pick: Pick | None, _modifiers: object) -> None:
        """A click on a shape of the grid looks at it."""
        shown = self.view.shown.views
        if pick is not None and pick.view < len(shown) and shown[pick.view].name:
            self.session.shape = shown[pick.view].name

    def _project_changed(self) -> None:
        project = self.session.project
        self.record = None if project is None else FitRecord(project)
        self.pictures.forget()
        self._fitted_shape = None

    def _take_progress(self) -> None:
        progress = self.session.progress
        if progress is None or self.record is None or getattr(progress, "stage", "") not in ("fit", "refine"):
            return
        watched = tuple({*self.session.watched, *((self.session.shape,) if self.session.shape else ())})
        if progress.state is not None and self.record.add(progress.state, watched):
            self.session.round = None
            self.pictures.forget_rounds()
            self._show_soon()

    def look_back(self, number: int) -> None:
        """Look at a recorded round."""
        self.session.round = None if self.record is None or number == self.record.newest else number

    def number(self) -> int:
        """The round looked at."""
        newest = self.record.newest if self.record is not None else -1
        return newest if self.session.round is None else min(self.session.round, newest)

    # -- showing ---------------------------------------------------------------------------------------------------

    def _show_soon(self) -> None:
        if self._here():
            self._soon.start()

    def _show_all(self) -> None:
        if not self._here() or self.record is None:
            return
        if not self.session.running:
            self.record.load()
        if self.record.recolour():
            self.pictures.forget_rounds()
        self._show_tools()
        self._show_views()
        show_legend(self.legend, self.record.looks, self.by.value_text(), self.number())
        self.also_watching.show_shapes(self.record, self.session, self.number(), self._direction())
        self.report.show_fit(self.record, self.session, self.number())
        self._show_scrubber()
        refresh(self.inspector, self.session.theme)

    def _show_tools(self) -> None:
        session = self.session
        groups, g = groups_of(session), group_of(session, session.shape)
        names = session.project.names
        near = [names[t] for t in groups.members(g)] if g >= 0 else list(names)
        options = [(name, shortened(name, 18)) for name in near[:24]]
        self.watch.set_options([*options, ("", "Find another…")], session.shape or "")

    def _layer(self, name: str, kind: str) -> MeshLayer:
        return self.pictures.layer(self.record, name, kind, self.number())

    def _show_views(self) -> None:
        session, number = self.session, self.number()
        if session.shape is None:
            return
        one = self.mode.button("one").isChecked()
        self.heads_widget.setVisible(one)
        fitted = (session.shape if one else session.watched, one, session.project.path)
        first, self._fitted_shape = self._fitted_shape != fitted, fitted
        if not one:
            self.view.display(self._grid(number), fit=first)
            return
        name = session.shape
        now, before = self.record.points(name, number), self.record.points(name, number - 1)
        look, layer = look_at(self.record, now), self._layer
        known = now is not None and self.record.beliefs(name) is not None
        display = three_views(
            layer(name, "plain"), layer(name, "ghost"), look, now, before,
            layer(name, "parts") if known else None, self.by.value_text(),
        )  # fmt: skip
        self.view.display(display, fit=first)
        self.view.fit_if_cut()
        shape = session.project.shapes.named(name)
        turned = ", turned as the family lies" if now is not None and not np.array_equal(now.turn, UNTURNED) else ""
        self.heads[0][1].setText(f"{shortened(name, 22)}, {counted(shape.n_points, 'point')}{turned}")
        if now is None:
            self.heads[1][1].setText("not fitted yet")
            self.heads[2][1].setText("after the fit")
        else:
            source = f" from {look.source}" if look is not None else ""
            self.heads[1][1].setText(f"{now.template + 1} of {len(self.record.looks)}{source}")
            old = number < self.record.newest
            self.heads[2][1].setText(f"of round {self.record.newest}, pale = unsure" if old else "pale = unsure")

    def _grid(self, number: int) -> Display:
        watched, shape = self.session.watched, self.session.shape
        names = watched if shape in watched else (shape, *watched)  # a click on one moves none
        rows, columns = grid_of(len(names), 1.5)
        views = []
        for name in names:
            now, before = self.record.points(name, number), self.record.points(name, number - 1)
            look = look_at(self.record, now)
            lines = [(name, "strong"), (moved_text(self.record, name, number)[0], "plain")]
            caption = (Caption("top left", tuple(lines)),)
            view = template_view(self._layer(name, "ghost"), look, now, before, self.by.value_text(), caption, 2.6)
            views.append(replace(view, name=name, selected=name == self.session.shape))
        return Display(tuple(views), rows, columns)

    def _direction(self) -> tuple[float, ...]:
        if not self.session.linked:
            return (1.0, 0.6, 1.5)
        camera = self.view.scene.camera
        away = np.array(camera.GetPosition()) - np.array(camera.GetFocalPoint())
        return tuple(float(v) for v in away / np.linalg.norm(away))

    def _camera_moved(self) -> None:
        for one in self.also_watching.pictures:
            one.look_from(self._direction())

    def _show_scrubber(self) -> None:
        pictures = self.pictures.of_rounds(self.record, self.session.shape)
        planned = rounds_planned(self.session, self.record)
        self.scrubber.set_phase(self.record.family_after)
        self.scrubber.set_state(planned, self.record.newest, self.number(), pictures)

    def _show_run(self) -> None:
        if not self._here() or self.record is None:
            return
        session = self.session
        finished = self.strip.show_run(session, self.record)
        self.next.setVisible(finished)
        self._show_quality()
        self.correction.show_state(finished)

    def _show_quality(self) -> None:
        session = self.session
        chosen = chosen_quality(session)
        self.quality.set_value(chosen)
        self.quality_text.setText("Quality" if chosen else f"{planned_rounds(session)} rounds, or")
        for name, options in QUALITIES.items():
            one = self.quality.button(name)
            one.setEnabled(not session.running)
            what = f"{rounds_text(session, options['rounds'])}: {_QUALITY[name]}"
            one.setToolTip(f"{what}\nStop the fit first." if session.running else what)

    # -- what the user does ----------------------------------------------------------------------------------------

    def _can_correct(self, session: Session) -> tuple[bool, str]:
        if session.shape is None:
            return False, "Select a shape first."
        if session.running:
            return False, "Stop the fit first. It goes on from your correction."
        return True, ""

    def _correct(self, session: Session) -> None:
        session.place = "paint"

    def _override(self, part_name: str) -> None:
        """A part was switched off on a shape that has it: painted, it counts as seen and is never switched off."""
        session = self.session
        names = session.project.part_names.names if session.project.part_names is not None else ()
        session.place = "paint"
        if part_name in names:
            session.part = names.index(part_name)
        session.say(f"Paint some of the {part_name} of {session.shape}: the next fit keeps it.")

    def _watch_all(self, names: tuple[str, ...]) -> None:
        self.session.watched = names
