"""The large view of a collection: the selected shapes side by side, linked; and the rings that turn them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication, QStackedWidget, QWidget

from shapeforge.collection.counts import counted, grouped
from shapeforge.viewer.actions import Actions, group_of, groups_of
from shapeforge.viewer.display import Caption, Display, View, grid_of
from shapeforge.viewer.palette import label_colours, rgb
from shapeforge.viewer.picking import Pick, camera_axes, project
from shapeforge.viewer.pictures import mesh_view
from shapeforge.viewer.qt.bind import Binding, action_button
from shapeforge.viewer.qt.map_drawing import group_colour
from shapeforge.viewer.qt.theme import PADDING
from shapeforge.viewer.qt.widgets import ElidedLabel, column, framed, label, row
from shapeforge.viewer.regroup import chosen_shapes
from shapeforge.viewer.session import Session
from shapeforge.viewer.turning import (
    RING_RADIUS,
    about,
    front_arrow,
    nearest_on_ring,
    reference_of,
    ring,
    ring_marks,
    room_for_rings,
    rotation_of,
    set_rotation,
    turned_view,
)

MOST = 12
GRAB_PIXELS = 10.0
STEP = 5.0  # degrees that a ring moves by; Shift: one


class LargeView(QWidget):
    """Up to a dozen shapes; while ``session.turn`` is set, the current one with its rings and one of its group."""

    def __init__(
        self, session: Session, actions: Actions, binding: Binding, view_factory: Callable[[], QWidget]
    ) -> None:
        super().__init__()
        self.session, self.actions = session, actions
        self.names: tuple[str, ...] = ()
        self.view = view_factory()
        self.view.hold = self._grab
        self.view.pulled.connect(self._pull)
        self.view.released.connect(self._let_go)
        self.view.clicked.connect(self._click)
        self.view.double_clicked.connect(self._open)
        self.view.hovered.connect(lambda _pick: self._hover())
        self._kept: dict[str, tuple[tuple, View]] = {}
        self._held: tuple[int, float, np.ndarray] | None = None
        self._under: int | None = None
        self._shown: tuple | None = None
        self._front, self._room = front_arrow(), room_for_rings()
        self.about = ElidedLabel("", "text2")
        looking = row(self.about, None, action_button(actions, "turn_shape", binding), margins=(PADDING, 0, 12, 0))
        looking.setStretch(0, 1)
        self.turning = label("", "strong")
        quarters = [action_button(actions, f"turn_{axis}", binding, kind="tool", text=axis.upper()) for axis in "xyz"]
        turning = row(
            self.turning, label("Quarter turn", "text2"), *quarters,
            action_button(actions, "turn_as_file", binding), None, action_button(actions, "leave", binding),
            action_button(actions, "turn_keep", binding, kind="primary"), margins=(PADDING, 0, 12, 0),
        )  # fmt: skip
        self.bars = QStackedWidget()
        for bar in (looking, turning):
            self.bars.addWidget(framed(bar))
        foot = framed(row(self.bars), "bar", height=44)
        box = column(self.view, foot, spacing=0)
        box.setStretch(0, 1)
        self.setLayout(box)
        self.setFocusProxy(self.view)

    # -- showing ---------------------------------------------------------------------------------------------------

    def show_now(self) -> None:
        """Show what the Session says: the selected shapes, else the current group's."""
        session = self.session
        turning = session.turn is not None
        self.bars.setCurrentIndex(int(turning))
        names = chosen_shapes(session)
        if turning:
            first = session.shape if session.shape in names else names[0]
            other = reference_of(session, first)
            views = [self._turned(first, names)]
            views += [self._view(other, ("for comparison", "faint"))] if other else []
            self.names = (first,) + ((other,) if other else ())
            self.turning.setText(f"Turn {first}" if len(names) == 1 else f"Turn {counted(len(names), 'shape')}")
            rows, columns = 1, len(views)
        else:
            names = names or self._of_the_group()
            self.names = names[:MOST]
            views = [self._view(name) for name in self.names]
            rows, columns = grid_of(max(len(views), 1))
            more = f" · the first {MOST} of {grouped(len(names))}" if len(names) > MOST else ""
            self.about.setText(f"Drag turns all, wheel zooms, double-click paints{more}")
        shown = (self.names, turning, session.turn if turning and self._held is None else None)
        again = self._shown is None or shown[:2] != self._shown[:2]
        self._shown = shown
        self.view.display(Display(tuple(views), rows, columns), fit=again)

    def _of_the_group(self) -> tuple[str, ...]:
        groups, names = groups_of(self.session), self.session.project.names
        if groups is None or not len(groups):
            return names
        return tuple(names[t] for t in groups.members(self.session.group))

    def _view(self, name: str, second: tuple[str, str] | None = None) -> View:
        session = self.session
        project, groups = session.project, groups_of(session)
        g, by = group_of(session, name), session.colour_by
        key = (project.shape_record(name)["key"], by, session.revision, session.theme)
        kept = self._kept.get(name)
        if kept is None or kept[0] != key:
            mesh = project.shapes.named(name).mesh
            labels = None
            if by == "painted":
                labels = project.labels(name)
            elif by == "fitted" and name in project.fit_names:
                labels = project.face_labels(name)
            colours = None
            if labels is not None:
                colours = label_colours(labels, project.part_inks())
            elif by == "group" and groups is not None:
                colours = np.array(rgb(group_colour(g, len(groups))), np.uint8)
            while len(self._kept) > 2 * MOST:
                del self._kept[next(iter(self._kept))]
            kept = self._kept[name] = (key, mesh_view(mesh, colours, session.theme))
        record = project.shape_record(name)
        called = groups.names[g] if g >= 0 else "left out" if groups is not None else "not grouped"
        lines = second or (f"{called} · {counted(record['n_faces'], 'face')}", "plain")
        current = name == session.shape and len(self.names) > 1 and session.turn is None
        return View(kept[1].layers, captions=(Caption("top left", ((name, "strong"), lines)),), selected=current,
                    name=name)  # fmt: skip

    def _turned(self, name: str, names: tuple[str, ...]) -> View:
        how = (
            "drag a ring (Shift: finely); the arrow points to the front"
            if len(names) == 1
            else f"{len(names) - 1} more turn along"
        )
        shown = turned_view(self._view(name, (how, "plain")), rotation_of(self.session))
        held = self._held[0] if self._held is not None else self._under
        return View((*shown.layers, self._front, self._room), ring_marks(held), shown.captions, name=name)

    # -- the rings -------------------------------------------------------------------------------------------------

    def ring_at(self, x: float | int, y: float | int) -> tuple[int, float] | None:
        """The ring at a place of the view, and where on it (degrees)."""
        if self.session.turn is None or self.view.cell_at(x, y) != 0:
            return None
        found = [self._nearest(axis, x, y) for axis in range(3)]
        axis = int(np.argmin([away for away, _ in found]))
        return (axis, found[axis][1]) if found[axis][0] < GRAB_PIXELS else None

    def _nearest(self, axis: int, x: float | int, y: float | int) -> tuple[float, float]:
        camera = self.view.scene.camera
        places = project(camera, ring(axis), self.view.rectangles()[0])
        return nearest_on_ring(places, ring(axis) @ camera_axes(camera)[2] / RING_RADIUS, (x, y))

    def _grab(self, x: float, y: float) -> bool:
        found = self.ring_at(x, y)
        if found is None:
            return False
        self._held = (*found, rotation_of(self.session))
        self.show_now()
        return True

    def _pull(self, x: float, y: float) -> None:
        if self._held is None:
            return
        axis, start, before = self._held
        step = 1.0 if QApplication.keyboardModifiers() & Qt.KeyboardModifier.ShiftModifier else STEP
        degrees = round((self._nearest(axis, x, y)[1] - start) / step) * step
        set_rotation(self.session, about(axis, degrees) @ before)

    def _let_go(self) -> None:
        if self._held is not None:
            self._held = None
            self.show_now()

    def _hover(self) -> None:
        if self.session.turn is None:
            return
        found = self.ring_at(*self.view.pointer)
        under = None if found is None else found[0]
        if under != self._under:
            self._under = under
            self.view.setCursor(Qt.CursorShape.ArrowCursor if under is None else Qt.CursorShape.PointingHandCursor)
            marks = [ring_marks(under), *(view.marks for view in self.view.shown.views[1:])]
            self.view.set_marks(marks)

    # -- the mouse and the keys ------------------------------------------------------------------------------------

    def _click(self, pick: Pick | None, _modifiers: Qt.KeyboardModifier) -> None:
        if pick is not None and self.session.turn is None:
            self.session.shape = self.names[pick.view]

    def _open(self, pick: Pick | None) -> None:
        if pick is not None and self.session.turn is None:
            self.session.shape = self.names[pick.view]
            self.actions.run("look_at")

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and self.session.turn is not None:
            if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
                event.accept()  # Enter keeps the turn; otherwise it would open the shape
                return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and self.session.turn is not None:
            self.actions.run("turn_keep")
        else:
            super().keyPressEvent(event)
