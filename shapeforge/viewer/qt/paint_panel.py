"""The Paint place: parts of one shape by hand; every stroke is kept, saved with the project and can be undone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QPointF, Qt, QTimer
from PySide6.QtWidgets import QApplication, QFrame, QMessageBox, QSlider, QWidget

from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Mesh
from shapeforge.viewer import brushes
from shapeforge.viewer.actions import YES, Action, Actions, next_to_paint, unpainted_exemplars
from shapeforge.viewer.display import Display, Mark
from shapeforge.viewer.painter import BRUSH_LIMITS, TOOL_NAMES, Painter
from shapeforge.viewer.palette import part_colours
from shapeforge.viewer.picking import Pick, camera_axes, project
from shapeforge.viewer.pictures import mesh_view, take_picture
from shapeforge.viewer.qt.bind import Binding, action_button, keep_enabled
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.paint_parts import (
    TOOL_HINTS,
    TOOL_KEYS,
    HistoryStrip,
    PartRow,
    ShareBar,
    ToolColumn,
    inside_polygon,
    percent,
)
from shapeforge.viewer.qt.thumbnails import Thumbnails
from shapeforge.viewer.qt.widgets import (
    Segments,
    Switch,
    button,
    clear,
    column,
    framed,
    heading,
    icon_label,
    label,
    row,
    scrolled,
    section,
)
from shapeforge.viewer.session import Session

SAVE_MS = 700
COUNT_MS = 120
DABS_PER_MOVE = 24
SEEN = 2e-3  # diagonals: a face hit this near to its centre is the one that is seen
SIZE_STEPS = 200


class PaintPlace:
    """Palette, tools, view and history of the painted shape (``session.shape``)."""

    def __init__(self, session: Session, actions: Actions, view_factory: Callable[[], QWidget]) -> None:
        self.session, self.actions = session, actions
        self.painter = Painter(session)
        self.binding = Binding(session)
        self.thumbnails = Thumbnails(session)
        self._view_factory = view_factory
        self._entered = False
        self._last: Pick | None = None
        self._last_place = (0.0, 0.0)
        self._lasso: list[tuple[float, float]] | None = None
        self._note: np.ndarray | None = None
        self._next = 0
        self._second: int | None = None
        self._pieces: list[np.ndarray] = []
        self._old_history = session.history
        self._add_actions()
        self._build()
        self._save_timer = QTimer(self.centre, singleShot=True, interval=SAVE_MS)
        self._save_timer.timeout.connect(self._save_between_strokes)
        self._count_timer = QTimer(self.centre, singleShot=True, interval=COUNT_MS)
        self._count_timer.timeout.connect(self._show_counts)
        self.thumbnails.arrived.connect(self._show_pictures)
        self.binding.on(("shape",), self._open, now=False)
        self.binding.on(("tool", "mirror", "part", "theme"), self._show_tool, now=False)
        self.binding.on(
            ("part", "part_revision") if hasattr(session, "part_revision") else ("part",), self._parts_chosen, now=False
        )
        self.binding.on(("brush_size", "reach"), self._show_brush, now=False)
        self.binding.on(("data", "running"), self._show_next, now=False)

    # ---- building ------------------------------------------------------------------------------------------------

    def _add_actions(self) -> None:
        def add(
            name: str, text: str, run: Callable[[], None], key: str, tooltip: str = "", icon: str = "", enabled=None
        ) -> None:
            self.actions.add(
                Action(
                    name, text, lambda _session: run(), enabled or (lambda _session: YES), key, tooltip, icon, "paint"
                )
            )

        for tool, key in TOOL_KEYS.items():
            add(f"tool_{tool}", TOOL_NAMES[tool], lambda tool=tool: self._take(tool), key, TOOL_HINTS[tool], tool)
        for number in range(1, 10):
            add(f"part_{number}", f"Part {number}", lambda n=number: self._take_part(n - 1), str(number))
        add("mirror", "Mirror", self._toggle_mirror, "M", "Paint the opposite side too", "mirror", self._can_mirror)
        add("isolate", "Isolate", self._toggle_isolate, "H", "Show only the current part and what is unpainted", "eye")
        add("smaller", "Smaller brush", lambda: self._resize(-1), "[")
        add("larger", "Larger brush", lambda: self._resize(1), "]")
        add("next_piece", "Next piece", self._go_next, "N", "Turn to the next unpainted piece", "", self._can_go_next)
        add("complete", "Complete the rest", self._complete, "Shift+S",
            "Fill in what is unpainted from what is painted", "scribble", self._can_complete)  # fmt: skip
        add("home_view", "Look from the front", lambda: self.view.fit(), "Home", "The usual view", "home")
        self.actions.add(
            Action(
                "fit_family",
                "Fit the family",
                self._fit,
                self._can_fit,
                "",
                "Explain every shape with these parts",
                "fit",
            )
        )

    def _build(self) -> None:
        self.tools = ToolColumn()
        self.tools.chosen.connect(lambda tool: self.actions.run(f"tool_{tool}"))
        self.tools.mirror_toggled.connect(lambda: self.actions.run("mirror"))
        self.view = self._view_factory()
        self.view.left_paints = True
        self.view.pressed.connect(self._press)
        self.view.dragged.connect(self._drag)
        self.view.released.connect(self._release)
        self.view.hovered.connect(self._hover)
        self.view.size_wheel.connect(self._resize)
        self.view.setCursor(Qt.CursorShape.CrossCursor)
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
        self.part_count = label("", "off")
        self.part_rows = column(spacing=2)
        self.rows: list[PartRow] = []
        holder = QWidget()
        holder.setLayout(self.part_rows)
        new = button("New part", icon="plus", tooltip="Add a part to the family")
        new.clicked.connect(self._new_part)
        self.merge = button("Merge…", tooltip="")
        self.merge.clicked.connect(self._merge)
        self.merge_hint = label("", "caption_off", wrap=True)
        buttons = row(new, self.merge, spacing=8)
        buttons.setStretch(0, 1)
        buttons.setStretch(1, 1)
        parts = section(
            row(label("Parts", "heading"), self.part_count, None, label("share of the area", "caption")),
            holder, 4, buttons, self.merge_hint, spacing=6,
        )  # fmt: skip
        holder.layout().setContentsMargins(-8, 0, -8, 0) if False else None
        self.size = QSlider(Qt.Orientation.Horizontal)
        self.size.setRange(0, SIZE_STEPS)
        self.size.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.size.setToolTip("Radius of the brush, in percent of the shape's size  ([ and ], or the wheel)")
        self.size.valueChanged.connect(self._size_slid)
        self.size_value = label("", "strong")
        self.size_value.setFixedWidth(44)
        self.size_value.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.reach = Segments((("surface", "Surface", ""), ("through", "Through", "")), self.session.reach)
        for value in ("surface", "through"):
            self.reach.button(value).setMinimumWidth(96)
        self.reach.button("through").setToolTip("Paint what lies behind, too, within the brush's size")
        self.reach.chosen.connect(lambda value: setattr(self.session, "reach", value))
        self.mirror = Switch(self.session.mirror)
        self.mirror.clicked.connect(lambda: self.actions.run("mirror"))
        self.mirror_error = label("", "caption")
        brush = section(
            label("Brush", "heading"),
            self._named("Size", self.size, self.size_value),
            self._named("Reach", self.reach, None),
            self._named("Mirror", self.mirror, label("left ↔ right"), None, self.mirror_error),
        )
        complete = action_button(self.actions, "complete", self.binding)
        scribble = section(
            heading("Scribble", "", label("S", "keycap")),
            label("One stroke on each part with the Scribble tool, the rest is filled in.", "caption", wrap=True),
            complete,
            line=False,
        )
        self.fit = button("Fit the family", kind="primary")
        self.fit.clicked.connect(lambda: self.actions.run("fit_family"))
        keep_enabled(self.fit, self.actions, "fit_family", self.binding)
        self.fit_icon = icon_label("info", "warning", 14)
        self.fit_why = label("", "caption", wrap=True)
        self.go_exemplar = button("", kind="link")
        self.go_exemplar.clicked.connect(lambda: self.actions.run("paint_next"))
        why = row(self.fit_icon, self.fit_why, spacing=8)
        why.setAlignment(self.fit_icon, Qt.AlignmentFlag.AlignTop)
        why.setStretch(1, 1)
        foot = QFrame()
        foot.setObjectName("bar")
        foot.setLayout(
            column(label("Next", "heading"), self.fit, why, self.go_exemplar, spacing=8, margins=(16, 12, 16, 16))
        )
        inside = column(scrolled(parts, brush, scribble), foot, spacing=0)
        inside.setStretch(0, 1)
        self.inspector = framed(inside)

    def _named(self, name: str, *widgets: QWidget | None) -> object:
        title = label(name, "text2")
        title.setFixedWidth(64)
        return row(title, *widgets, spacing=8)

    # ---- coming and going ----------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Take over: paint ``session.shape``, or the next exemplar when none is chosen."""
        self._entered = True
        self._old_history = self.session.history
        if self.session.shape is None:
            groups = self.session.project.groups
            first = self.session.project.names[0 if groups is None else int(groups.exemplars[0])]
            self.session.shape = next_to_paint(self.session) or first  # opens it
        if self.painter.name != self.session.shape or self.session.history is not self.painter.state:
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
        self.painter.open(name)
        self.painter.state.changed = self._changed
        self.session.history = self.painter.state
        self._second, self._note, self._next = None, None, 0
        if self.session.part >= max(len(self.painter.part_names), 1):
            self.session.part = 0
        self._show_parts()
        self._show_mirror()
        self.view.display(Display((self.painter.view(),)), fit=True)
        self._show_counts()
        self._show_history()
        self._show_brush()

    # ---- the pointer ---------------------------------------------------------------------------------------------

    def _press(self, pick: Pick | None, modifiers: Qt.KeyboardModifier) -> None:
        session = self.session
        self._note = None
        if session.tool == "eyedropper":
            if pick is not None:
                part = int(self.painter.state.labels[self.painter.face_of(pick.triangle)])
                if part >= 0:
                    session.part = part
                    session.say(f"Painting with {self.painter.part_names[part]}")
                session.tool = "brush"
            return
        had_parts = len(self.painter.part_names)
        self.painter.begin(erase=bool(modifiers & Qt.KeyboardModifier.ControlModifier))
        if len(self.painter.part_names) != had_parts:
            self._show_parts()
        if session.tool == "lasso":
            self._lasso = [self._pointer()]
        elif pick is not None:
            self.painter.dab(self.painter.face_of(pick.triangle), pick.position)
        self._last, self._last_place = pick, self._pointer()
        self._mark(pick)

    def _drag(self, pick: Pick | None, modifiers: Qt.KeyboardModifier) -> None:
        here = self._pointer()
        if self._lasso is not None:
            self._lasso.append(here)
            self.view.overlay.path = [QPointF(*place) for place in self._lasso]
            self.view.overlay.update()
            return
        if self.session.tool in ("brush", "eraser", "scribble"):
            # Dabs along the way, so that a fast drag leaves no gaps; the steps are half a brush on the screen.
            way = np.subtract(here, self._last_place)
            pixels = self.view.height() / (2 * self.view.scene.camera.GetParallelScale())
            steps = int(min(np.ceil(np.hypot(*way) / max(0.5 * self.session.brush_size * pixels, 2.0)), DABS_PER_MOVE))
            for i in range(1, steps + 1):
                place = np.add(self._last_place, way * i / steps)
                between = pick if i == steps else self.view.pick(float(place[0]), float(place[1]))
                if between is not None:
                    self.painter.dab(self.painter.face_of(between.triangle), between.position)
        elif pick is not None and self.session.tool in ("fill", "piece"):
            self.painter.dab(self.painter.face_of(pick.triangle), pick.position)
        self._last, self._last_place = pick, here
        self._mark(pick)

    def _release(self) -> None:
        if self._lasso is not None:
            lasso, self._lasso = np.array(self._lasso), None
            self.view.overlay.path = []
            self.painter.paint(self._encircled(lasso))
        if not self.painter.end():
            self.view.overlay.update()
            return
        if self.session.tool == "scribble" and len(np.unique(self.painter.state.labels)) > 2:
            self.actions.run("complete_scribble") if "complete_scribble" in self.actions else self._complete(
                by_hand_only=True
            )
        self._ended()

    def _encircled(self, lasso: np.ndarray) -> np.ndarray:
        """Faces whose centre lies inside the line and, unless the reach is through, is seen."""
        painter = self.painter
        faces = np.unique(self.view.shown.views[0].layers[0].record)
        rectangle = self.view.rectangles()[0]
        places = project(self.view.scene.camera, painter.surface.centres[faces], rectangle)
        inside = np.flatnonzero(inside_polygon(places, lasso)) if len(lasso) > 2 else np.zeros(0, int)
        if self.session.reach == "through":
            return faces[inside]
        away = camera_axes(self.view.scene.camera)[2]
        layer = self.view.shown.views[0].layers[0]
        shown = Mesh(layer.vertices, layer.triangles, layer.record, painter.mesh.n_faces)
        start = painter.surface.centres[faces[inside]] + 4 * away
        hits = first_hits(shown, start, np.broadcast_to(-away, start.shape).copy())
        return faces[inside[np.abs(hits - 4) < SEEN]]

    def _hover(self, pick: Pick | None) -> None:
        if self._entered and self.painter.name is not None:
            self._mark(pick)

    def _pointer(self) -> tuple[float, float]:
        return self.view.pointer

    def _mark(self, pick: Pick | None) -> None:
        """The ring at the pointer and its dashed twin; moving them redraws no 3-D."""
        marks: list[Mark] = []
        if self._note is not None:
            marks.append(Mark("note", tuple(float(x) for x in self._note), text="next piece"))
        if pick is not None and self.session.tool in ("brush", "eraser", "scribble"):
            radius = self.session.brush_size * (0.4 if self.session.tool == "scribble" else 1.0)
            at, normal = _tuple(pick.position), pick.normal
            marks.append(Mark("brush", at, to=_tuple(normal), radius=radius))
            twin = self.painter.twin(pick.position)
            if twin is not None and self.painter.mirror_plane is not None:
                across = self.painter.mirror_plane[0]
                turned = normal - 2 * (normal @ across) * across
                marks.append(Mark("twin", _tuple(twin[1]), to=_tuple(turned), radius=radius))
        self.view.set_marks([tuple(marks)])

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
        self.history.saved.setText("✓ saved" if self.painter.state.strokes else "")
        if wrote:
            self.session.touch("labels")

    def _go_to(self, count: int) -> None:
        self.painter.state.go_to(count)
        self.session.edit_count += 1
        self._show_history()

    def _take(self, tool: str) -> None:
        self.session.tool = tool

    def _take_part(self, part: int) -> None:
        if part < len(self.painter.part_names):
            self.session.part = part

    def _resize(self, steps: int) -> None:
        low, high = BRUSH_LIMITS
        self.session.brush_size = float(min(max(self.session.brush_size * 1.15**steps, low), high))
        self._mark(self.view.pick(*self._pointer()))

    def _size_slid(self, value: int) -> None:
        low, high = BRUSH_LIMITS
        size = low * (high / low) ** (value / SIZE_STEPS)
        if abs(np.log(size / self.session.brush_size)) > 0.5 * np.log(high / low) / SIZE_STEPS:
            self.session.brush_size = float(size)

    def _can_mirror(self, session: Session) -> tuple[bool, str]:
        if self.painter.name is None:
            return False, "Choose a shape first."
        return (
            YES if self.painter.mirror_plane is not None else (False, f"{self.painter.name} is not symmetric enough.")
        )

    def _toggle_mirror(self) -> None:
        self.session.mirror = not self.session.mirror

    def _toggle_isolate(self) -> None:
        self.painter.isolated = not self.painter.isolated
        self.isolate.setChecked(self.painter.isolated)
        self._changed_view()

    def _show_edges(self, value: str) -> None:
        self.painter.edges = value == "edges"
        self._changed_view()

    def _changed_view(self) -> None:
        if self.painter.name is not None:
            self.view.display(Display((self.painter.view(),)))

    def _can_go_next(self, _session: Session) -> tuple[bool, str]:
        return YES if self._pieces else (False, "Everything is painted.")

    def _go_next(self) -> None:
        """Turn the view so that the next unpainted piece is seen, and point at it."""
        piece = self._pieces[self._next % len(self._pieces)]
        self._next += 1
        surface, mesh = self.painter.surface, self.painter.mesh
        facing = (mesh.face_normals[piece] * surface.areas[piece][:, None]).sum(axis=0)
        largest = piece[surface.areas[piece].argmax()]
        direction = mesh.face_normals[largest] if np.linalg.norm(facing) < 1e-6 else facing / np.linalg.norm(facing)
        centre = surface.centres[piece].mean(axis=0)
        self._note = surface.centres[piece[np.linalg.norm(surface.centres[piece] - centre, axis=1).argmin()]]
        if not self._sees(piece):
            azimuth = float(np.degrees(np.arctan2(direction[0], direction[2])))
            elevation = float(np.degrees(np.arcsin(np.clip(direction[1], -1, 1))))
            self.view.turn_to(azimuth + 20, min(max(elevation + 15, -50), 60))
        self._mark(None)

    def _sees(self, piece: np.ndarray) -> bool:
        places = project(self.view.scene.camera, self.painter.surface.centres[piece[:12]], self.view.rectangles()[0])
        picks = [self.view.pick(float(x), float(y)) for x, y in places]
        members = set(piece.tolist())
        return any(p is not None and self.painter.face_of(p.triangle) in members for p in picks)

    def _can_complete(self, _session: Session) -> tuple[bool, str]:
        labels = self.painter.state.labels
        if not (labels >= 0).any():
            return False, "Paint a stroke on each part first."
        return YES if (labels < 0).any() else (False, "Everything is painted.")

    def _complete(self, *, by_hand_only: bool = False) -> None:
        if self.painter.complete(by_hand_only=by_hand_only):
            self._ended()

    # ---- parts ---------------------------------------------------------------------------------------------------

    def _show_parts(self) -> None:
        names = self.painter.part_names
        clear(self.part_rows)
        self.rows = []
        for part, (name, colour) in enumerate(zip(names, part_colours(len(names)), strict=True)):
            one = PartRow(name, "#{:02X}{:02X}{:02X}".format(*colour), str(part + 1) if part < 9 else "")
            one.clicked.connect(lambda part=part: self._take_part(part))
            one.ctrl_clicked.connect(lambda part=part: self._select_second(part))
            one.eye_clicked.connect(lambda part=part: self._hide(part))
            one.renamed.connect(lambda text, part=part: self._rename(part, text))
            one.set_hidden(part in self.painter.hidden)
            self.part_rows.addWidget(one)
            self.rows.append(one)
        if not names:
            self.part_rows.addWidget(label("No parts yet. Add the first, or just paint.", "caption", wrap=True))
        refresh(self.inspector, self.session.theme)
        self.part_count.setText(str(len(names)) if names else "")
        self._parts_chosen()
        self._show_counts()

    def _parts_chosen(self) -> None:
        for part, one in enumerate(self.rows):
            one.set_current(part in (self.session.part, self._second))
        ready = self._second is not None and self._second != self.session.part
        self.merge.setEnabled(ready)
        self.merge_hint.setText(
            f"Merge {self.rows[self._second].name.text()} into {self.rows[self.session.part].name.text()}."
            if ready and max(self._second, self.session.part) < len(self.rows)
            else "Merge: select two parts first (Ctrl-click)."
        )
        if self.painter.isolated:
            self._changed_view()

    def _select_second(self, part: int) -> None:
        self._second = None if self._second == part else part
        self._parts_chosen()

    def _hide(self, part: int) -> None:
        self.painter.hidden = self.painter.hidden ^ {part}
        self.rows[part].set_hidden(part in self.painter.hidden)
        self._changed_view()

    def _new_part(self) -> None:
        names = self.painter.part_names
        name = next(f"part {i}" for i in range(1, len(names) + 2) if f"part {i}" not in names)
        self.session.part = self._try(lambda: self.painter.add_part(name), self.session.part)
        self._show_parts()
        if self.rows:
            self.rows[-1].rename()

    def _rename(self, part: int, text: str) -> None:
        self._try(lambda: self.painter.rename_part(part, text), None)
        QTimer.singleShot(0, self._show_parts)
        self.session.touch("labels")

    def _merge(self) -> None:
        kept, gone, names = self.session.part, self._second, self.painter.part_names
        if gone is None:
            return
        count = len(self.session.project.labelled)
        ask = QMessageBox(self.inspector.window())
        ask.setWindowTitle("Merge parts")
        ask.setText(f"Merge {names[gone]} into {names[kept]}?")
        ask.setInformativeText(f"It is done on {count} labelled shape{'s' * (count != 1)} and cannot be undone.")
        ask.setStandardButtons(QMessageBox.StandardButton.Ok | QMessageBox.StandardButton.Cancel)
        ask.accepted.connect(lambda: self._merged(kept, gone))
        ask.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        ask.open()

    def _merged(self, kept: int, gone: int) -> None:
        self._second = None
        self._try(lambda: self.painter.merge_parts(kept, gone), None)
        self._show_parts()
        self.session.touch("labels")
        self._changed()

    def _try(self, do: Callable[[], object], otherwise: object) -> object:
        try:
            return do()
        except (ValueError, OSError) as error:
            self.session.say(str(error), "error")
            return otherwise

    # ---- showing -------------------------------------------------------------------------------------------------

    def _show_tool(self) -> None:
        session, names = self.session, self.painter.part_names if session_open(self.session) else ()
        from shapeforge.viewer.qt.icons import set_icon

        self.tools.show_state(session.tool, session.mirror)
        set_icon(self.tool_icon, session.tool, "accent_text", 18)
        self.tool_name.setText(TOOL_NAMES[session.tool])
        part = names[session.part] if session.part < len(names) else "the first part"
        how = {
            "brush": f"drag paints {part} · Ctrl erases · wheel changes the size · Alt turns the view",
            "eraser": "drag takes paint away · wheel changes the size · Alt turns the view",
            "fill": f"click paints {part} up to the creases · Ctrl erases · Alt turns the view",
            "piece": f"click paints the whole loose piece {part} · Ctrl erases · Alt turns the view",
            "lasso": f"drag around what is {part} · Ctrl erases · Alt turns the view",
            "scribble": f"one stroke on each part, now {part}; the rest is filled in",
            "eyedropper": "click takes the part under the pointer",
        }[session.tool]
        self.tool_hint.setText(how)
        self.mirror.setChecked(session.mirror)
        self._show_history()

    def _show_brush(self) -> None:
        low, high = BRUSH_LIMITS
        self.size_value.setText(f"{100 * self.session.brush_size:.1f}%")
        place = round(SIZE_STEPS * np.log(self.session.brush_size / low) / np.log(high / low))
        self.size.blockSignals(True)
        self.size.setValue(int(place))
        self.size.blockSignals(False)
        self.reach.set_value(self.session.reach)

    def _show_mirror(self) -> None:
        plane = self.painter.mirror_plane
        self.mirror.setEnabled(plane is not None)
        self.mirror_error.setText(f"±{100 * plane[2]:.1f}%" if plane is not None else "not symmetric")
        self.mirror_error.setToolTip("Mean distance between the shape and its mirror image, of its size")

    def _show_counts(self) -> None:
        if self.painter.name is None:
            return
        labels, surface = self.painter.state.labels, self.painter.surface
        share = brushes.shares(surface, labels, len(self.rows))
        for one, fraction in zip(self.rows, share, strict=True):
            one.set_share(float(fraction))
        self.shares.set_shares([(one.colour, float(f)) for one, f in zip(self.rows, share, strict=True)])
        self._pieces = brushes.unpainted_pieces(surface, labels)
        left = max(1.0 - float(share.sum()), 0.0)
        count = len(self._pieces)
        self.blank.setText(percent(left) if count else "All painted")
        self.blank_words.setText(f"unpainted, {count} piece{'s' * (count != 1)}" if count else "")
        self.session.edit_count += 0 if count == getattr(self, "_count", None) else 1  # buttons look again
        self._count = count

    def _show_history(self) -> None:
        state = self.painter.state
        if self.painter.name is None:
            return
        states = [("Start", "")] + [
            (s.label, s.tool if s.tool in TOOL_KEYS else "scribble") for s in state.strokes
        ]  # fmt: skip
        self.history.caption.setText(f"{len(state.strokes)} step{'s' * (len(state.strokes) != 1)}")
        self.history.show_states(states, state.done, self._picture)
        refresh(self.history, self.session.theme)

    def _show_pictures(self) -> None:
        self.history.refresh_pictures(self._picture, self.painter.state.done)

    def _picture(self, count: int):
        labels = self.painter.state.labels_after(count)
        n_parts, mesh, theme = len(self.painter.part_names), self.painter.mesh, self.session.theme

        def take() -> np.ndarray:
            from shapeforge.viewer.palette import label_colours

            return take_picture(
                mesh_view(mesh, label_colours(labels, n_parts), theme), (128, 104), theme, transparent=True
            )

        return self.thumbnails.pixmap(("history", self.painter.name, labels.tobytes(), theme), take)

    # ---- next ----------------------------------------------------------------------------------------------------

    def _can_fit(self, session: Session) -> tuple[bool, str]:
        left = [name for name in unpainted_exemplars(session) if name != self.painter.name or not self._has_paint()]
        if left:
            few = len(left) == 1
            return False, (
                f"{left[0] if few else f'{len(left)} exemplars'} {'is' if few else 'are'} still unpainted. "
                f"Paint {'it' if few else 'them'}, or leave {'its group' if few else 'their groups'} out in Collection."
            )
        if not session.project.labelled and not self._has_paint():
            return False, "Paint at least one shape first."
        return YES if not session.running else (False, f"Wait until {session.stage or 'the present stage'} is done.")

    def _has_paint(self) -> bool:
        return self.painter.name is not None and bool((self.painter.state.labels >= 0).any())

    def _fit(self, session: Session) -> None:
        self._save()
        session.place = "fit"
        if "fit" in self.actions and self.actions.verdict("fit")[0]:
            self.actions.start_stage("fit")

    def _show_next(self) -> None:
        if self.session.project is None:
            return
        can, why = self._can_fit(self.session)
        self.fit_why.setText("Every exemplar is painted." if can else why)
        self.fit_icon.setVisible(not can)
        following = next_to_paint(self.session)
        self.go_exemplar.setVisible(following is not None and following != self.painter.name)
        self.go_exemplar.setText(f"Paint {following}")


def session_open(session: Session) -> bool:
    """A project is open."""
    return session.project is not None


def _tuple(position: np.ndarray) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
