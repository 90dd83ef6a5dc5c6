"""The Paint place: parts of one shape by hand; every stroke is kept, saved with the project and can be undone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QApplication, QWidget

from shapeforge.viewer import brushes
from shapeforge.viewer.actions import Actions, next_to_paint
from shapeforge.viewer.completing import Completion
from shapeforge.viewer.display import Display
from shapeforge.viewer.painter import BRUSH_LIMITS, TOOL_NAMES, Painter
from shapeforge.viewer.palette import label_colours
from shapeforge.viewer.pictures import mesh_view, take_picture
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Segments
from shapeforge.viewer.qt.icons import refresh, set_icon
from shapeforge.viewer.qt.paint_hand import PaintHand
from shapeforge.viewer.qt.paint_keys import paint_actions
from shapeforge.viewer.qt.paint_parts import (
    HistoryStrip,
    ShareBar,
    ToolColumn,
)
from shapeforge.viewer.qt.paint_sections import BrushSection, NextSection, scribble_section
from shapeforge.viewer.qt.paint_words import blank_words, can_fit, how_to_use
from shapeforge.viewer.qt.parts_palette import PartsPalette
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import button, column, framed, icon_label, label, row, scrolled
from shapeforge.viewer.session import Session

SAVE_MS = 700
COUNT_MS = 120
LONGEST_WAIT = 5.0
"""Seconds that a closing window waits for a painting that is being completed."""


class Mail(QObject):
    """Carries "it is completed" from the thread to the window's."""

    arrived = Signal()


class PaintPlace:
    """Palette, tools, view and history of the painted shape (``session.shape``)."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.painter = Painter(session)
        self.painter.parts_changed = self._parts_changed
        self.painter.run = lambda make: actions.desk.start("cosegment", make)
        self.binding = Binding(session)
        self.thumbnails = Thumbnails(session)
        self._view_factory = view_factory
        self._entered = False
        self._pieces: list[np.ndarray] = []
        self._strokes_at = [0]
        self._next = 0
        self._count: int | None = None
        self._old_history = session.history
        for action in paint_actions(self):
            actions.add(action)
        self._build()
        self._mail = Mail(self.centre)
        self._mail.arrived.connect(self._completed)
        self.completion = Completion(self.painter, self._mail.arrived.emit)
        self._save_timer = QTimer(self.centre, singleShot=True, interval=SAVE_MS)
        self._save_timer.timeout.connect(self._save_between_strokes)
        self._count_timer = QTimer(self.centre, singleShot=True, interval=COUNT_MS)
        self._count_timer.timeout.connect(self._show_counts)
        self.thumbnails.setParent(self.centre)
        self.thumbnails.arrived.connect(self._show_pictures)
        self.binding.on(("shape",), self._open, now=False)
        self.binding.on(("tool", "mirror", "part", "theme"), self._show_tool, now=False)
        self.binding.on(("part",), self.parts.show_chosen, now=False)
        self.binding.on(("brush_size", "reach", "fill_to"), self.brush.show_brush, now=False)
        self.binding.on(("fill_to", "reach"), self._show_tool, now=False)
        self.binding.on(("data",), self._follow, now=False)
        self.binding.on(("data", "running"), self._show_next, now=False)

    # ---- building ------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        self.tools = ToolColumn()
        self.tools.chosen.connect(lambda tool: self.actions.run(f"tool_{tool}"))
        self.tools.mirror_toggled.connect(lambda: self.actions.run("mirror"))
        self.view = self._view_factory()
        self.hand = PaintHand(self.session, self.view, self.painter, self._stroke_ended)
        self.view.size_wheel.connect(self.resize)
        self.shares = ShareBar(6)
        self.blank = label("", "strong")
        self.blank_words = label("", "text2")
        self.next_piece = action_button(self.actions, "next_piece", self.binding)
        bar = framed(
            row(self.shares, self.blank, self.blank_words, self.next_piece, spacing=8, margins=(16, 6, 12, 6)),
            "bar",
            height=44,
        )
        bar.layout().setSpacing(6)
        bar.layout().setStretch(0, 1)
        canvas = column(self.view, bar, spacing=0)
        canvas.setStretch(0, 1)
        whole = row(self.tools, canvas, spacing=0)
        whole.setStretch(1, 1)
        self.centre = framed(whole, "centre")
        self.centre.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._build_toolbar()
        self._build_inspector()
        self.history = HistoryStrip("History")
        self.history.chosen.connect(self._go_to)
        self.strip = self.history

    def _build_toolbar(self) -> None:
        self.tool_icon = icon_label("brush", "accent_text", 18)
        self.tool_name = label("Brush", "heading")
        self.tool_hint = label("", "text2")
        self.isolate = button(
            "Isolate", icon="eye", checkable=True, tooltip="Show only the current part and what is unpainted  (H)"
        )
        self.isolate.clicked.connect(lambda: self.actions.run("isolate"))
        self.solid = Segments((("solid", "Solid", ""), ("edges", "Edges", "")), "solid")
        self.solid.button("solid").setToolTip("Show the surface alone")
        self.solid.button("edges").setToolTip("Show the edges of the faces, too")
        self.solid.chosen.connect(self._show_edges)
        home = action_button(self.actions, "home_view", self.binding, text="", kind="tool")
        self.toolbar_widget = framed(
            row(
                self.tool_icon,
                4,
                self.tool_name,
                self.tool_hint,
                None,
                self.isolate,
                self.solid,
                home,
                spacing=8,
                margins=(22, 0, 16, 0),
            )
        )

    def _build_inspector(self) -> None:
        self.parts = PartsPalette(
            self.session, self.painter, self.actions, self.binding, self._changed_view, self._show_counts
        )
        self.brush = BrushSection(self.session, self.actions)
        self.next = NextSection(self.session, self.actions, self.binding)
        scribble = scribble_section(self.actions, self.binding)
        inside = column(scrolled(self.parts, self.brush, scribble), self.next, spacing=0)
        inside.setStretch(0, 1)
        self.inspector = framed(inside)

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Take over: paint ``session.shape``, or the next exemplar when none is chosen."""
        self._entered = True
        self._old_history = self.session.history
        if self.session.shape is None:
            groups = self.session.project.groups
            first = self.session.project.names[0 if groups is None else int(groups.exemplars[0])]
            self.session.shape = next_to_paint(self.session) or first  # opens it
        if self.painter.name != self.session.shape or self.session.history is not self.painter.history:
            self._open()
        self._show_tool()
        self._show_next()

    def leave(self) -> None:
        """Let go: what is painted is saved."""
        self._save()
        self._entered = False
        self.session.history = self._old_history

    def close(self) -> None:
        """The window closes."""
        self.completion.on_result = lambda: None  # whoever closes hears nothing more of it
        self.completion.join(LONGEST_WAIT)
        self._save()
        self._save_timer.stop()
        self._count_timer.stop()
        self.thumbnails.forget()
        self.binding.close()

    def _open(self) -> None:
        name = self.session.shape
        if not self._entered or name is None or self.session.project is None:
            return
        self._save()
        self.completion.forget()
        self.painter.open(name)
        self._show_shape()
        self.brush.show_mirror(self.painter)
        self._show_next()
        self.view.display(Display((self.painter.view(),)), fit=True)
        self.brush.show_brush()

    def _show_shape(self) -> None:
        """The painter has another painting: its parts, shares and history."""
        self.painter.state.changed = self._changed
        self.session.history = self.painter.history
        self.parts.second, self.hand.note, self._next = None, None, 0
        if self.session.part >= max(len(self.painter.part_names), 1):
            self.session.part = 0
        self.parts.show_parts()
        self._show_counts()
        self._show_history()

    def _follow(self) -> None:
        """Somebody else changed the parts, or the labels of this shape: take them as they are now."""
        if self._entered and self.painter.name == self.session.shape and self.painter.is_outdated:
            self.completion.forget()
            self.painter.read(self.painter.name)
            self._show_shape()
            self._show_tool()
            self._changed_view()
        elif self._entered and self.painter.name is not None:
            self.parts.show_chosen()  # proposed parts are painted ones as soon as there is paint

    def _parts_changed(self) -> None:
        """New, renamed, recoloured, merged, removed, or any of it undone."""
        if not self._entered:
            return
        self.parts.second = None
        self.parts.show_parts()
        self._changed_view()
        self._show_tool()
        self.session.touch("labels")

    # ---- doing ---------------------------------------------------------------------------------------------------

    def _changed(self) -> None:
        """Labels changed: show them, count and save a little later."""
        self.view.display(
            Display((self.painter.view(self.view.shown.views[0].marks if self.view.shown.views else ()),))
        )
        self._count_timer.start()
        if not QApplication.mouseButtons() & Qt.MouseButton.LeftButton:
            self._show_history()
        self._save_timer.start()
        self.history.saved.setText("")

    def _stroke_ended(self) -> None:
        if self.session.tool == "scribble" and len(np.unique(self.painter.state.labels)) > 2:
            self.completion.ask()
            self._show_tool()
        self._ended()

    def _completed(self) -> None:
        if self.completion.take():
            self._ended()
        self._show_tool()

    def _ended(self) -> None:
        self.session.edit_count += 1
        self._show_counts()
        self._show_history()

    def _save_between_strokes(self) -> None:
        if self.painter.state.is_drawing:
            self._save_timer.start()  # saving would end the stroke under the user's hand
        else:
            self._save()

    def _save(self) -> None:
        self._save_timer.stop()
        if self.session.project is None or self.painter.name is None:
            return
        try:
            wrote = self.painter.save()
        except (ValueError, RuntimeError, OSError) as error:
            self.session.say(f"Not saved yet: {error}", "error")
            self._save_timer.start(5 * SAVE_MS)
            return
        self.history.saved.setText("✓ saved" if self.painter.history.steps() else "")
        if wrote:
            self.session.touch("labels")

    def _go_to(self, count: int) -> None:
        self.painter.history.go_to(count)
        self.session.edit_count += 1
        self._show_history()

    def resize(self, steps: int) -> None:
        """A brush larger or smaller by so many steps."""
        low, high = BRUSH_LIMITS
        self.session.brush_size = float(min(max(self.session.brush_size * 1.15**steps, low), high))
        self.hand.mark(self.view.pick(*self.view.pointer))

    def toggle_isolate(self) -> None:
        """Show the current part and what is unpainted only, or all again."""
        self.painter.isolated = not self.painter.isolated
        self._changed_view()

    def _show_edges(self, value: str) -> None:
        self.painter.edges = value == "edges"
        self._changed_view()

    def _changed_view(self) -> None:
        self.isolate.setChecked(self.painter.isolated)
        if self.painter.name is not None:
            self.view.display(Display((self.painter.view(),)))

    @property
    def has_unpainted(self) -> bool:
        """Some piece is still unpainted."""
        return bool(self._pieces)

    def go_next(self) -> None:
        """Turn to the next unpainted piece."""
        self.hand.point_at(self._pieces[self._next % len(self._pieces)])
        self._next += 1

    def complete(self) -> None:
        """Fill in what is unpainted."""
        if self.painter.complete():
            self._ended()

    # ---- showing -------------------------------------------------------------------------------------------------

    def _show_tool(self) -> None:
        session = self.session
        names = () if session.project is None else self.painter.part_names
        self.tools.show_state(session.tool, session.mirror)
        set_icon(self.tool_icon, session.tool, "accent_text", 18)
        self.tool_name.setText(TOOL_NAMES[session.tool])
        self.tool_hint.setText(how_to_use(session, names, self.completion.busy))
        self.brush.mirror.setChecked(session.mirror)
        self._show_history()

    def _show_counts(self) -> None:
        if self.painter.name is None:
            return
        labels, surface = self.painter.state.labels, self.painter.surface
        proposed = self.painter.proposed_faces
        share = brushes.shares(surface, labels if proposed is None else proposed, len(self.parts.rows))
        for one, fraction in zip(self.parts.rows, share, strict=True):
            one.set_share(float(fraction))
        self.shares.set_shares([(one.colour, float(f)) for one, f in zip(self.parts.rows, share, strict=True)])
        self._pieces = brushes.unpainted_pieces(surface, labels)
        count = len(self._pieces)
        strong, rest = blank_words(proposed is not None, max(1.0 - float(share.sum()), 0.0), count)
        self.blank.setText(strong)
        self.blank_words.setText(rest)
        if count != self._count:
            self._count = count
            self.session.edit_count += 1  # what can be done depends on it

    def _show_history(self) -> None:
        if self.painter.name is None:
            return
        steps = self.painter.history.steps()
        states = [("Start", "")] + [(text, "scribble" if icon == "complete" else icon) for text, icon, _ in steps]
        self._strokes_at = [0, *(strokes for *_, strokes in steps)]
        self.history.caption.setText(f"{len(steps)} step{'s' * (len(steps) != 1)}")
        self.history.show_states(states, self.painter.history.done, self._picture)
        refresh(self.history, self.session.theme)

    def _show_pictures(self) -> None:
        self.history.refresh_pictures(self._picture, self.painter.history.done)

    def _picture(self, step: int) -> QPixmap | None:
        labels = self.painter.state.labels_after(self._strokes_at[step])
        inks, mesh, theme = self.session.project.part_inks(), self.painter.mesh, self.session.theme

        def take() -> np.ndarray:
            return take_picture(
                mesh_view(mesh, label_colours(labels, inks), theme), (128, 104), theme, transparent=True
            )

        return self.thumbnails.pixmap(("history", self.painter.name, labels.tobytes(), inks.tobytes(), theme), take)

    # ---- next ----------------------------------------------------------------------------------------------------

    def can_fit(self, session: Session) -> tuple[bool, str]:
        """Whether the family can be fitted with what is painted and, when not, why not."""
        return can_fit(session, self.painter)

    def fit_family(self, session: Session) -> None:
        """Go to Fit, and begin; a fit that can be taken up again with the paint of now goes on from where it is."""
        self._save()
        session.place = "fit"
        if self.actions.verdict("refit")[0]:
            self.actions.run("refit")
        elif "fit" in self.actions and self.actions.verdict("fit")[0]:
            self.actions.start_stage("fit")

    def _show_next(self) -> None:
        if self.session.project is not None:
            self.next.show_next(self.can_fit(self.session), self.painter.name)
