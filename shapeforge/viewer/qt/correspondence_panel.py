"""The Correspondence place: many shapes side by side; a point picked on one lights up on all, two measure all."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QWidget

from shapeforge.collection.counts import counted, grouped
from shapeforge.viewer.actions import YES, Action, Actions
from shapeforge.viewer.lightbox import Lightbox
from shapeforge.viewer.picking import Pick
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.controls import Choice
from shapeforge.viewer.qt.correspondence_keys import PointKeys
from shapeforge.viewer.qt.landmark_strip import LandmarkStrip
from shapeforge.viewer.qt.point_inspector import PointInspector
from shapeforge.viewer.qt.widgets import ElidedLabel, column, framed, row
from shapeforge.viewer.session import Session

COUNTS = ("4", "6", "9", "12", "16", "20")
SORTS = (
    ("high", "most sure first"),
    ("low", "least sure first"),
    ("name", "name"),
    ("group", "group"),
)  # fmt: skip
COLOURS = (
    ("spread", "where it lies"), ("part", "part"), ("coordinate", "template coordinate"),
    ("entropy", "unsure which point"), ("part_entropy", "unsure which part"),
)  # fmt: skip
HOVER_MS = 30
IDLE_MS = 10
AT_ONCE = 60
"""A family of more shapes is read little by little, so that the place is there at once."""
SLICE = 0.03
"""Seconds of work between two looks at what the user does."""
HINTS = {
    False: "Click one point, or two",
    True: "Coloured by distance, lines join the same points. O: back, Shift+O: the other way round.",
}


class CorrespondencePlace:
    """The lightbox.  ``session.picked`` is the first template point, ``second`` the one it is measured to."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.binding = Binding(session)
        self.box = Lightbox(session)
        self.second: int | None = None
        self.hovered: int | None = None
        self.sort, self.count, self.colour_by = "high", 12, "spread"
        self._sorted_by: int | None = None  # the point picked when the order was chosen: a pick moves no shape
        self.names: tuple[str, ...] = ()
        self.order: tuple[str, ...] = ()
        self.page = 0
        self.strip: LandmarkStrip | None = None
        self.overlaid = False
        self._entered = False
        self._view_factory = view_factory
        self.keys = PointKeys(self)
        self._add_actions()
        self._build()
        self._hover_timer = QTimer(self.centre, singleShot=True, interval=HOVER_MS)
        self._hover_timer.timeout.connect(self._show_hover)
        self._idle = QTimer(self.centre, interval=IDLE_MS)
        self._idle.timeout.connect(self._work_ahead)
        self.binding.on(("picked", "selected", "theme"), self.show, now=False)
        self.binding.on(("compare",), self._compare, now=False)
        self.binding.on(("shape",), self._bring, now=False)
        self.binding.on(("data",), self._reload, now=False)
        self.binding.on(("project", "data", "running", "place"), self.strip.show_next)

    # ---- building ------------------------------------------------------------------------------------------------

    def _add_actions(self) -> None:
        table = (
            ("clear_points", "Clear", self._clear, "Escape", "Forget the picked points", "close", self._has_point),
            ("keep_landmark", "Keep as landmark", self._keep, "K", "Keep the picked point under a name", "pin",
             self._has_point),
            ("show_worst", "Show the worst", self._show_worst, "W", "Sorts by confidence, low first", "sort", None),
            ("correct_here", "Correct…", self._correct, "C",
             "Paint a correction on the selected shape; the next fit takes it as evidence", "brush", self._one_shape),
            ("overlay", "Overlay two shapes", self._toggle_overlay, "O",
             "Two shapes in one view, the first coloured by its distance to the second", "overlay", self._two),
            ("swap_overlay", "Overlay the other way round", self._swap_overlay, "Shift+O",
             "Colour the second shape by its distance to the first", "swap", self._two),
            ("export_points", "Export CSV…", self._export, "", "Landmarks on every shape, in its file's coordinates",
             "export", self._has_landmarks),
            ("home_lightbox", "Look from the front", lambda: self.view.fit(), "Home", "The usual view", "home", None),
            ("previous_page", "Page before", lambda: self._turn_page(-1), "PgUp", "The shapes before these", "left",
             lambda _s: YES if self.page > 0 else (False, "These are the first shapes.")),
            ("next_page", "Next page", lambda: self._turn_page(1), "PgDown", "The shapes after these", "right",
             lambda _s: YES if self.page + 1 < self._pages() else (False, "These are the last shapes.")),
        )  # fmt: skip
        for name, text, run, key, tooltip, icon, enabled in table:
            verdict = enabled or (lambda _s: YES)
            self.actions.add(
                Action(name, text, lambda _s, run=run: run(), verdict, key, tooltip, icon, "correspondence")
            )
        for action in self.keys.actions():
            self.actions.add(action)

    def _build(self) -> None:
        self.view = self._view_factory()
        self.view.clicked.connect(self._click)
        self.view.hovered.connect(self._hover)
        self.view.double_clicked.connect(self._choose)
        whole = column(self.view, spacing=0)
        self.centre = framed(whole, "centre")
        self.centre.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.colour = Choice("Colour by", COLOURS, self.colour_by, tooltip="What the colours of the shapes mean")
        self.colour.chosen.connect(self._colour_chosen)
        self.sorting = Choice("Sort by", SORTS, self.sort, tooltip="Which shapes come first")
        self.sorting.chosen.connect(self._sort_chosen)
        self.showing = Choice("Show", tuple((n, n) for n in COUNTS), str(self.count), tooltip="How many shapes at once")
        self.showing.chosen.connect(self._count_chosen)
        self.before = action_button(self.actions, "previous_page", self.binding, text="", kind="tool")
        self.after = action_button(self.actions, "next_page", self.binding, text="", kind="tool")
        home = action_button(self.actions, "home_lightbox", self.binding, text="", kind="tool")
        self.hint = ElidedLabel(HINTS[False], "text2")
        self.toolbar_widget = framed(
            row(
                self.colour, self.sorting, self.showing, self.before, self.after, 4, self.hint, home,
                margins=(16, 0, 16, 0),
            )
        )  # fmt: skip
        self.toolbar_widget.layout().setStretchFactor(self.hint, 1)
        self.inspector = PointInspector(self.session, self.actions, self.binding)
        self.strip = LandmarkStrip(self.session, self.actions, self.binding, self.box)
        self.strip.chosen.connect(self._recall)

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Show the fitted family."""
        self._entered = True
        self._reload()
        self._idle.start()
        self.show(fit=True)

    def leave(self) -> None:
        """Nothing has to be saved here."""
        self._entered = False
        self._idle.stop()

    def close(self) -> None:
        """The window closes."""
        self._hover_timer.stop()
        self._idle.stop()
        self.binding.close()

    def _reload(self) -> None:
        if not self._entered or self.session.project is None or not self.session.project.fit_names:
            return
        if self.box.reload():
            self.box.in_slices = len(self.session.project.fit_names) > AT_ONCE
            self._idle.start()
            self.second = None
            if self.session.picked is not None and self.session.picked >= self.box.n_points:
                self.session.picked = None
            self.strip.reload()
            self.page, self._sorted_by = 0, None
            self._arrange()
            self._bring()
            self.show(fit=True)

    # ---- what is shown -------------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        """Which shapes are shown, in which order."""
        box = self.box
        names = [name for name in self.session.compare if name in box.names] or list(box.names)
        if self.sort in ("high", "low") and not box.unread:
            names.sort(key=lambda name: box.confidence(name, self._sorted_by), reverse=self.sort == "high")
        elif self.sort in ("name", "high", "low"):
            names.sort()
        elif self.session.project.groups is not None:
            groups = self.session.project.groups
            group = dict(zip(self.session.project.names, groups.group.tolist(), strict=False))
            names.sort(key=lambda name: (group.get(name, len(groups)), name))
        self.order = tuple(names)
        self.page = min(self.page, self._pages() - 1)
        first = self.page * self.count
        self.names = self.order[first : first + self.count]
        many, number = len(names), len(self.names)
        where = f"{first + 1}–{first + number}" if many > self.count else f"{number}"
        some = [(n, f"{n} at once") for n in COUNTS if int(n) < many]
        enough = [(n, f"all {many}") for n in COUNTS if int(n) >= many]
        self.showing.set_options([*some, *enough[:1]], f"{where} of {many}")

    def _pages(self) -> int:
        return max(-(-len(self.order) // self.count), 1)

    def _turn_page(self, by: int) -> None:
        self.page = min(max(self.page + by, 0), self._pages() - 1)
        self._arrange()
        self.show()

    def _bring(self) -> None:
        """Turn to the page that shows the session's shape: it was looked for, or chosen elsewhere."""
        name = self.session.shape
        if self._entered and name in self.order:
            if name not in self.names:
                self.page = self.order.index(name) // self.count
                self._arrange()
            self.show()

    def _compare(self) -> None:
        if self._entered and self.session.project is not None:
            self.page = 0
            self._arrange()
            self.show(fit=True)

    def show(self, *, fit: bool = False) -> None:
        """Show what the session says."""
        if self._entered and not self._idle.isActive():
            self._idle.start()
        if not self._entered or self.session.project is None or not self.box.names:
            return
        session, view = self.session, self.view
        if self.overlaid and len(session.selected) == 2:
            view.display(self.box.overlay(*session.selected), fit=fit)
        else:
            self.overlaid = False
            aspect = view.width() / max(view.height(), 1)
            display = self.box.display(
                self.names, colour_by=self._shown_by(), picked=session.picked, second=self.second, hover=self.hovered,
                selected=(*session.selected, *([session.shape] if session.shape else [])), aspect=aspect,
            )  # fmt: skip
            changed = (display.rows, display.columns) != (view.shown.rows, view.shown.columns)
            view.display(display, fit=fit or changed)
        self._show_hint()
        for one in (self.colour, self.sorting, self.showing, self.before, self.after):
            one.setVisible(not self.overlaid)
        self.inspector.show_points(self.box, self.second)
        shown_by = "distance" if self.overlaid else self._shown_by()
        self.inspector.show_legend(shown_by, waiting=shown_by == "part" and self.colour_by == "spread")
        self.inspector.overlay.setText("Back to all shapes" if self.overlaid else "Overlay two shapes")
        self.strip.show_marks()
        self.session.edit_count += 1  # what can be done depends on what is picked

    def _shown_by(self) -> str:
        """What the colours mean now: where a point lies cannot be shown before one is picked, the parts can."""
        return "part" if self.colour_by == "spread" and self.session.picked is None else self.colour_by

    def _show_hint(self) -> None:
        unread, of = len(self.box.unread), len(self.box.names)
        self.hint.setText(f"Reading {grouped(of - unread)} of {grouped(of)}…" if unread else HINTS[self.overlaid])

    def _work_ahead(self) -> None:
        """While nothing else is to do: read the rest of the family, then what the next click needs of those shown."""
        if self.box.unread:
            done = self.box.read_some(SLICE)
            self._show_hint()
            if done:  # now they can be put in order
                self._arrange()
                self.show()
            return
        waiting = [name for name in self.names if not self.box.is_ready(name)]
        if not waiting:
            self._idle.stop()
        else:
            self.binding.safely(lambda: self.box.fuzzy(waiting[0]) and None)

    # ---- the pointer ---------------------------------------------------------------------------------------------

    def _point(self, pick: Pick | None) -> int | None:
        if pick is None or self.overlaid or pick.view >= len(self.names):
            return None
        return self.box.point_at(self.names[pick.view], pick.position)

    def _click(self, pick: Pick | None, modifiers: Qt.KeyboardModifier) -> None:
        if self.overlaid or pick is None:
            return
        name = self.names[pick.view]
        if modifiers & Qt.KeyboardModifier.ControlModifier:
            self.select(name)
            return
        point = self._point(pick)
        if point is None:
            return
        self.session.shape = name
        self.pick(point, second=self.session.picked is not None and self.second is None)

    def pick(self, point: int, *, second: bool) -> None:
        """Pick a point, as the first one (a second one is forgotten) or to measure to."""
        if second:
            self.second = point
            self.show()
            return
        self.second = None
        if self.session.picked == point:
            self.show()
        self.session.picked = point

    def _hover(self, pick: Pick | None) -> None:
        point = self._point(pick)
        if point != self.hovered:
            self.hovered = point
            if not self._hover_timer.isActive():
                self._hover_timer.start()

    def _show_hover(self) -> None:
        if self.overlaid or not self._entered or len(self.view.shown.views) != len(self.names):
            return
        shapes = (self.box.shape(name) for name in self.names)
        self.view.set_marks([self.box.marks(s, self.session.picked, self.second, self.hovered) for s in shapes])

    def _choose(self, pick: Pick | None) -> None:
        if pick is not None and pick.view < len(self.names):
            self.session.shape = self.names[pick.view]

    # ---- doing ---------------------------------------------------------------------------------------------------

    def _colour_chosen(self, value: str) -> None:
        self.colour_by = value
        self.show()

    def _sort_chosen(self, value: str) -> None:
        self.sort, self.page, self._sorted_by = value, 0, self.session.picked
        self.sorting.set_value(value)
        self._arrange()
        self.show()

    def _count_chosen(self, value: str) -> None:
        self.count, self.page = int(value), 0
        self._arrange()
        self.show()

    def _show_worst(self) -> None:
        self._sort_chosen("low")

    def _clear(self) -> None:
        self.second = None
        if self.session.picked is None:
            self.show()
        self.session.picked = None

    def _correct(self) -> None:
        if len(self.session.selected) == 1:
            self.session.shape = self.session.selected[0]
        self.session.place = "paint"

    def select(self, name: str) -> None:
        """Select a shape for the overlay, or no longer."""
        chosen = self.session.selected
        self.session.selected = tuple(n for n in chosen if n != name) if name in chosen else (*chosen, name)

    def _toggle_overlay(self) -> None:
        self.overlaid = not self.overlaid
        self.show(fit=True)

    def _swap_overlay(self) -> None:
        self.overlaid = True
        self.session.selected = tuple(reversed(self.session.selected))

    def _has_point(self, session: Session) -> tuple[bool, str]:
        return YES if session.picked is not None else (False, "Click a point on a shape first.")

    def _one_shape(self, session: Session) -> tuple[bool, str]:
        if session.running:
            return False, f"Wait until {session.stage or 'the present stage'} is done."
        return YES if session.shape is not None or len(session.selected) == 1 else (False, "Select a shape first.")

    def _two(self, session: Session) -> tuple[bool, str]:
        return YES if len(session.selected) == 2 else (False, "Select exactly two shapes first (Ctrl-click).")

    # ---- landmarks -----------------------------------------------------------------------------------------------

    def _has_landmarks(self, _session: Session) -> tuple[bool, str]:
        return YES if self.strip is not None and self.strip.marks else (False, "Keep a landmark first.")

    def _keep(self) -> None:
        self.strip.keep(int(self.session.picked))
        self.session.edit_count += 1

    def _recall(self, point: int) -> None:
        self.second = None
        self.session.picked = point

    def _export(self) -> None:
        path = self.actions.desk.choose_save("Save the landmarks", "landmarks.csv")
        if path is not None:
            count = self.strip.export(path)
            self.session.say(f"{counted(count, 'point')} saved as {path.name}", "ok")
