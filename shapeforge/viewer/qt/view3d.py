"""The 3-D view: one OpenGL widget with one or several linked cells, its own camera control, and picking.

Left drags turn the shape, or paint where ``left_paints`` is on (Alt, right or middle drags turn it then); Shift with a
turning drag moves it.  The wheel zooms at the pointer; where ``left_paints`` is on it is the brush's and Ctrl zooms.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QImage, QMouseEvent, QResizeEvent, QWheelEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget
from pyvistaqt import QtInteractor
from vtkmodules.vtkRenderingCore import vtkCamera

from shapeforge.viewer.display import Display, Mark
from shapeforge.viewer.framing import contents, framing
from shapeforge.viewer.look import angles_of, direction_from, place_camera
from shapeforge.viewer.palette import rgb, tokens
from shapeforge.viewer.picking import Number, Pick, Picker, Rectangle, around, camera_axes, project
from shapeforge.viewer.pictures import SHADOW
from shapeforge.viewer.qt.overlay import Overlay, cell_rectangles
from shapeforge.viewer.scene import Scene

FRAME_MS = 33
SETTLE_MS = 160
DEGREES_PER_PIXEL = 0.45
ZOOM_PER_STEP = 0.88
SCALE_LIMITS = (0.02, 3.0)
_RGB = QImage.Format.Format_RGB888
CLICK_SLACK = 4  # logical pixels a press may wander and still be a click


class View3D(QWidget):
    """Shows Displays.  Signals carry a :class:`Pick` or None (nothing under the pointer) and Qt's modifiers."""

    hovered = Signal(object)
    pressed = Signal(object, object)
    dragged = Signal(object, object)
    released = Signal()
    clicked = Signal(object, object)
    double_clicked = Signal(object)
    size_wheel = Signal(int)
    camera_moved = Signal()
    pulled = Signal(float, float)
    menu_wanted = Signal(float, float)

    def __init__(self, session: Any = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.session = session
        self.left_paints = False
        # Takes hold of something at (x, y)?  Then the drag is told by `pulled` instead of turning the view.
        self.hold: Callable[[float, float], bool] | None = None
        self.frames = 0
        self._closed = False
        self._painted = -math.inf
        self._software: bool | None = None
        self._drag: str | None = None
        self._button = Qt.MouseButton.NoButton
        self._last = self._press = QPointF()
        self._fitted: Display | None = None
        self._user_camera = False
        self.plotter = QtInteractor(parent=self, auto_update=False, multi_samples=0)
        self.plotter.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.plotter.setAcceptDrops(False)
        self.plotter.iren.interactor.SetInteractorStyle(None)
        self.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.plotter)
        self.overlay = Overlay(self)
        self.picker = Picker()
        self.scene = Scene(self.plotter, self.repaint_soon, scale=self.devicePixelRatioF())
        self._observer = self.scene.back.AddObserver("EndEvent", self._count)
        self._timer = QTimer(self, singleShot=True, interval=FRAME_MS)
        self._timer.timeout.connect(self._paint)
        self._settle = QTimer(self, singleShot=True, interval=SETTLE_MS)
        self._settle.timeout.connect(self._refine)
        self.plotter.installEventFilter(self)
        self.set_theme(getattr(session, "theme", "dark"))
        if session is not None and hasattr(session, "events"):
            session.events.theme.connect(self._theme_changed)

    @property
    def pointer(self) -> tuple[float, float]:
        """Logical place (x, y) of the pointer when it was last seen over the view."""
        return float(self._last.x()), float(self._last.y())

    @property
    def pressed_at(self) -> tuple[float, float]:
        """Logical place (x, y) where a button was last pressed over the view."""
        return float(self._press.x()), float(self._press.y())

    # ---- what is shown -------------------------------------------------------------------------------------------

    def display(self, display: Display, *, fit: bool = False) -> None:
        """Show a Display; ``fit`` (and the first one ever) also places the camera so that it fills the cells."""
        self.overlay.display = display
        changed = self.scene.show(display)
        self.overlay.cameras = [cell.renderer.GetActiveCamera() for cell in self.scene.cells]
        if fit or self._fitted is None:
            self._fitted = display
            self.fit()
        elif changed:
            self._fitted = display
        self.overlay.update()

    @property
    def shown(self) -> Display:
        """The Display that is shown now."""
        return self.scene.display

    def set_marks(self, marks: list[tuple[Mark, ...]]) -> None:
        """Other marks in each cell; the 3-D picture is not drawn again."""
        display = self.scene.display.with_marks(marks)
        self.scene.display = self.overlay.display = display
        self.overlay.update()

    def fit(self) -> None:
        """Look from the house's direction so that the largest shape fills its cell."""
        self._user_camera = False
        self._fit_now()

    def fit_again(self) -> None:
        """Fit what is shown now, unless the user has placed the camera."""
        if not self._user_camera:
            self._fit_now()

    def fit_if_cut(self) -> None:
        """Fit again when what is shown sticks out of its cell, unless the user has placed the camera."""
        if self._user_camera:
            return
        for i, (points, (x, y, width, height)) in enumerate(zip(contents(self.shown), self.rectangles(), strict=False)):
            if len(points):
                places = project(self._camera(i), points, (x, y, width, height))
                if (places < (x, y)).any() or (places > (x + width, y + height)).any():
                    self._fit_now()
                    return

    def _fit_now(self) -> None:
        cells = self.rectangles()
        found = framing(self.scene.display, cells[0][2:]) if cells else None
        if found is not None:
            focus, scale, up = found
            place_camera(self.scene.camera, focus, scale)
            self._shift(np.array([0.0, up]))
            self.camera_changed()

    def turn_to(self, azimuth: Number, elevation: Number) -> None:
        """Look from ``azimuth`` degrees (0 is the front, +z) and ``elevation`` degrees above the floor."""
        camera = self.scene.camera
        place_camera(camera, camera.GetFocalPoint(), camera.GetParallelScale(), direction_from(azimuth, elevation))
        self.camera_changed()

    def camera_changed(self) -> None:
        """Draw again after the camera moved; the marks move along."""
        self.overlay.update()
        self.repaint_soon()
        self.camera_moved.emit()

    def rectangles(self) -> list[Rectangle]:
        """x, y, width, height of every cell in logical pixels."""
        display = self.scene.display
        return cell_rectangles(self.plotter.width(), self.plotter.height(), display.rows, display.columns)

    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """What the view shows now, marks and words included, as (h, w, 3) device pixels."""
        image = self.grab().toImage().convertToFormat(_RGB)
        rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
        return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()

    # ---- drawing -------------------------------------------------------------------------------------------------

    def repaint_soon(self) -> None:
        """Draw now, or 33 ms after the last time if that is later; asked twice, drawn once, with the newest state."""
        if not self._timer.isActive() and not self._closed:
            since = 1e3 * (time.monotonic() - self._painted)
            self._timer.start(int(max(FRAME_MS - since, 0)))

    @property
    def at_rest(self) -> bool:
        """Nothing is waiting to be drawn."""
        return self.frames > 0 and not self._timer.isActive() and not self._settle.isActive()

    def _paint(self) -> None:
        if self._closed:
            return
        self._painted = time.monotonic()
        self.scene.smooth(self._software is False)
        self.plotter.update()
        self._settle.start()

    def _refine(self) -> None:
        """The pointer rests: draw once more with smooth edges, and with occlusion where a real GL does it."""
        if self._closed or not self.isVisible():
            return
        if self._software is None and self.frames:
            capabilities = str(self.plotter.ren_win.ReportCapabilities()).lower()
            self._software = any(name in capabilities for name in ("llvmpipe", "softpipe", "swiftshader", "swrast"))
            if not self._software:
                self.scene.occlude(True)
        self.scene.smooth(True)
        self.plotter.update()

    def _count(self, _caller: object, _event: str) -> None:
        self.frames += 1

    def _theme_changed(self, theme: str, *_old: object) -> None:
        self.set_theme(theme)

    def set_theme(self, theme: str) -> None:
        """Colours of "dark" or "light" for the ground, the lines between cells, the shadow and the words."""
        colours = tokens(theme)
        self.overlay.theme = theme
        self.scene.restyle(rgb(colours["view"]), rgb(colours["separator"]), SHADOW[theme])
        self.overlay.update()

    # ---- camera and picking --------------------------------------------------------------------------------------

    def cell_at(self, x: Number, y: Number) -> int | None:
        """Index of the cell at a logical place of the view; None outside all."""
        for i, (left, top, width, height) in enumerate(self.rectangles()):
            if left <= x < left + width and top <= y < top + height:
                return i
        return None

    def pick(self, x: Number, y: Number) -> Pick | None:
        """What lies at the logical place (x, y), y down."""
        cell = self.cell_at(x, y)
        if cell is None or cell >= len(self.scene.display.views):
            return None
        layers = self.scene.display.views[cell].meshes()
        return self.picker.pick(self._camera(cell), layers, (x, y), self.rectangles()[cell], cell)

    def pick_near(self, x: Number, y: Number) -> Pick | None:
        """What lies at (x, y) or, where that is the ground, within a few pixels of it: a slat or a leg is thin."""
        found, cell = self.pick(x, y), self.cell_at(x, y)
        about = (self.pick(*at) for at in around(x, y) if self.cell_at(*at) == cell)
        return next((one for one in about if one is not None), None) if found is None else found

    def place_of(self, position: Any, cell: int = 0) -> tuple[float, float]:
        """Logical place (x, y) of a position on the shape of a cell: the inverse of picking, for tests and handles."""
        place = project(self._camera(cell), np.asarray(position, float)[None], self.rectangles()[cell])[0]
        return float(place[0]), float(place[1])

    def _camera(self, cell: int) -> vtkCamera:
        return self.scene.cells[cell].renderer.GetActiveCamera()

    def zoom(self, steps: Number, at: tuple[Number, Number] | None = None) -> None:
        """Zoom in by wheel ``steps`` (negative: out), keeping the place ``at`` under the pointer."""
        camera = self.scene.camera
        old = camera.GetParallelScale()
        new = min(max(old * ZOOM_PER_STEP**steps, SCALE_LIMITS[0]), SCALE_LIMITS[1])
        cell = self.cell_at(*at) if at is not None else None
        if cell is not None:
            x, y, width, height = self.rectangles()[cell]
            away = np.array([at[0] - x - width / 2, y + height / 2 - at[1]]) * 2 / height
            self._shift(away * (old - new))
        camera.SetParallelScale(new)
        self._user_camera = True
        self.camera_changed()

    def turn(self, right: Number, down: Number) -> None:
        """Turn by a drag of ``right`` and ``down`` pixels: about the vertical, and up or down, not over the top."""
        azimuth, elevation = angles_of(self.scene.camera)
        self._user_camera = True
        elevation = min(max(elevation + DEGREES_PER_PIXEL * down, -85.0), 85.0)
        self.turn_to(azimuth - DEGREES_PER_PIXEL * right, elevation)

    def _shift(self, flat: np.ndarray) -> None:
        camera = self.scene.camera
        move = flat @ camera_axes(camera)[:2]
        camera.SetFocalPoint(*(np.array(camera.GetFocalPoint()) + move))
        camera.SetPosition(*(np.array(camera.GetPosition()) + move))

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        kind = event.type()
        if watched is not self.plotter or self._closed:
            return False
        if kind == QEvent.Type.MouseButtonPress:
            return self._on_press(event)
        if kind == QEvent.Type.MouseMove:
            return self._on_move(event)
        if kind == QEvent.Type.MouseButtonRelease:
            return self._on_release(event)
        if kind == QEvent.Type.MouseButtonDblClick:
            self.double_clicked.emit(self.pick(event.position().x(), event.position().y()))
            return self._on_press(event)
        if kind == QEvent.Type.Wheel:
            return self._on_wheel(event)
        if kind == QEvent.Type.Leave:
            self.hovered.emit(None)
            return True
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease):
            event.ignore()  # to the window, whose shortcuts they are
            return True
        return kind in (QEvent.Type.Enter, QEvent.Type.FocusIn, QEvent.Type.FocusOut)

    def _on_press(self, event: QMouseEvent) -> bool:
        if self._drag is not None and event.buttons() & self._button & ~event.button():
            return True  # what one button began goes on whatever another one does
        self._button = event.button()
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        self._last = self._press = event.position()
        alt = bool(event.modifiers() & Qt.KeyboardModifier.AltModifier)
        if event.button() == Qt.MouseButton.LeftButton and self.left_paints and not alt:
            self._drag = "paint"
            self.pressed.emit(self.pick(self._last.x(), self._last.y()), event.modifiers())
        elif event.button() == Qt.MouseButton.LeftButton and self.hold is not None and self.hold(*self.pointer):
            self._drag = "pull"
        else:
            self._drag = "move" if event.modifiers() & Qt.KeyboardModifier.ShiftModifier else "turn"
        return True

    def _on_move(self, event: QMouseEvent) -> bool:
        here = event.position()
        step, self._last = here - self._last, here
        if self._drag is None:
            self.hovered.emit(self._meant(here))
        elif self._drag == "paint":
            self.dragged.emit(self.pick(here.x(), here.y()), event.modifiers())
        elif self._drag == "pull":
            self.pulled.emit(here.x(), here.y())
        elif (here - self._press).manhattanLength() > CLICK_SLACK or self._user_camera:
            if self._drag == "turn":
                self.turn(step.x(), step.y())
            else:
                height = self.rectangles()[0][3]
                unit = 2 * self.scene.camera.GetParallelScale() / height
                self._shift(np.array([-step.x(), step.y()]) * unit)
                self._user_camera = True
                self.camera_changed()
        return True

    def _on_release(self, event: QMouseEvent) -> bool:
        if event.button() != self._button:
            return True
        drag, self._drag = self._drag, None
        here = event.position()
        if drag in ("paint", "pull"):
            self.released.emit()
        if (here - self._press).manhattanLength() <= CLICK_SLACK and event.button() == Qt.MouseButton.LeftButton:
            self.clicked.emit(self._meant(here), event.modifiers())
        elif (here - self._press).manhattanLength() <= CLICK_SLACK and event.button() == Qt.MouseButton.RightButton:
            self.menu_wanted.emit(here.x(), here.y())
        return True

    def _meant(self, here: QPointF) -> Pick | None:
        """A brush paints exactly what is under it; a finger that points may miss by a little."""
        return (self.pick if self.left_paints else self.pick_near)(here.x(), here.y())

    def _on_wheel(self, event: QWheelEvent) -> bool:
        delta = event.angleDelta().y() or event.angleDelta().x()  # Alt turns the wheel sideways on some systems
        ctrl = bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier)
        if self.left_paints and not ctrl:
            self.size_wheel.emit(1 if delta > 0 else -1)
        elif delta:
            self.zoom(delta / 120, (event.position().x(), event.position().y()))
        return True

    # ---- the widget ----------------------------------------------------------------------------------------------

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.overlay.setGeometry(self.rect())
        self.overlay.raise_()
        self.scene.scale = self.devicePixelRatioF()
        self.scene.lay_out((self.width(), self.height()))
        if not self._user_camera:
            self._fit_now()
        self.repaint_soon()

    def closeEvent(self, event: QCloseEvent) -> None:
        self.shut()
        super().closeEvent(event)

    def shut(self) -> None:
        """Let go of the window system's resources; the view cannot be shown again."""
        if self._closed:
            return
        self._closed = True
        self._timer.stop()
        self._settle.stop()
        if self.session is not None and hasattr(self.session, "events"):
            self.session.events.theme.disconnect(self._theme_changed)
        self.plotter.removeEventFilter(self)
        self.scene.back.RemoveObserver(self._observer)
        self.scene.clear()
        self.plotter.close()
