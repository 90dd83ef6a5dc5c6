"""Puts a Display into a render window: only what changed is touched, and there is one render at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import UInt8
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import VTK_ID_TYPE, vtkDataArray, vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkCamera, vtkPolyDataMapper, vtkRenderer

from shapeforge.viewer.display import Colour, Display, LineLayer, MeshLayer, PointLayer, View, record_borders
from shapeforge.viewer.look import floor_actor, light, place_camera, shade, surface


def _colours_array(colours: np.ndarray) -> vtkDataArray:
    array = numpy_to_vtk(np.ascontiguousarray(colours, np.uint8), deep=True)
    array.SetName("colour")
    return array


class _MeshActor:
    """One mesh in one view; keeps the last layer to know what changed."""

    def __init__(self) -> None:
        self.layer: MeshLayer | None = None
        self.mapper = vtkPolyDataMapper()
        self.mapper.SetColorModeToDirectScalars()
        self.actor = vtkActor()
        self.actor.SetMapper(self.mapper)
        self.edges: vtkActor | None = None

    def show(self, layer: MeshLayer, scale: float) -> bool:
        old = self.layer
        if old is layer:
            return False
        same_shape = old is not None and old.triangles is layer.triangles
        geometry = not (same_shape and old.vertices is layer.vertices)
        if geometry:
            self.data, self.origin = surface(layer.vertices, layer.triangles)
            self.mapper.SetInputData(self.data)
        if geometry or old.colours is not layer.colours or old.smooth_colours != layer.smooth_colours:
            self._colour(layer)
        if geometry or old.opacity != layer.opacity:
            shade(self.actor, layer.opacity)
        if geometry or old.edges != layer.edges:
            self._edges(layer, scale)
        self.layer = layer
        return True

    def _colour(self, layer: MeshLayer) -> None:
        colours = layer.colours[self.origin] if layer.smooth_colours else layer.colours
        table = self.data.GetPointData() if layer.smooth_colours else self.data.GetCellData()
        other = self.data.GetCellData() if layer.smooth_colours else self.data.GetPointData()
        other.RemoveArray("colour")
        present = table.GetArray("colour")
        if present is not None and present.GetNumberOfTuples() == len(colours):
            vtk_to_numpy(present)[:] = colours  # in place: only this array is uploaded again
            present.Modified()
        else:
            table.AddArray(_colours_array(colours))
            table.SetActiveScalars("colour")
        if layer.smooth_colours:
            self.mapper.SetScalarModeToUsePointData()
        else:
            self.mapper.SetScalarModeToUseCellData()
        self.mapper.ScalarVisibilityOn()

    def _edges(self, layer: MeshLayer, scale: float) -> None:
        if self.edges is not None:
            self.edges.SetVisibility(False)
            self.edges = None
        if layer.edges:
            record = np.arange(len(layer.triangles)) if layer.record is None else layer.record
            segments = record_borders(layer.vertices, layer.triangles, record)
            drawn = _LineActor()
            drawn.show(LineLayer(layer.key + "/edges", segments, (18, 19, 22), 1.0, 0.55), scale)
            self.edges = drawn.actor

    def actors(self) -> list[vtkActor]:
        return [self.actor] + ([self.edges] if self.edges is not None else [])


class _PointActor:
    def __init__(self) -> None:
        self.layer: PointLayer | None = None
        self.data = vtkPolyData()
        self.mapper = vtkPolyDataMapper()
        self.mapper.SetColorModeToDirectScalars()
        self.mapper.SetInputData(self.data)
        self.mapper.SetRelativeCoincidentTopologyPointOffsetParameter(-400)
        self.actor = vtkActor()
        self.actor.SetMapper(self.mapper)
        look = self.actor.GetProperty()
        look.SetRenderPointsAsSpheres(True)
        look.LightingOff()

    def show(self, layer: PointLayer, scale: float) -> bool:
        old = self.layer
        if old is layer:
            return False
        if old is None or old.positions is not layer.positions:
            if old is not None and len(old.positions) == len(layer.positions):
                vtk_to_numpy(self.data.GetPoints().GetData())[:] = layer.positions
                self.data.GetPoints().Modified()
            else:
                points = vtkPoints()
                points.SetData(numpy_to_vtk(np.ascontiguousarray(layer.positions, np.float32), deep=True))
                self.data.SetPoints(points)
                cells = vtkCellArray()
                n = len(layer.positions)
                cells.SetData(1, numpy_to_vtk(np.arange(n, dtype=np.int64), deep=True, array_type=VTK_ID_TYPE))
                self.data.SetVerts(cells)
            self.data.Modified()
        if old is None or old.colours is not layer.colours:
            self.data.GetPointData().SetScalars(_colours_array(layer.colours))
        self.actor.GetProperty().SetPointSize(layer.size * scale)
        self.actor.GetProperty().SetOpacity(layer.opacity)
        self.layer = layer
        return True

    def actors(self) -> list[vtkActor]:
        return [self.actor]


class _LineActor:
    def __init__(self) -> None:
        self.layer: LineLayer | None = None
        self.mapper = vtkPolyDataMapper()
        self.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(-1, -4)
        self.actor = vtkActor()
        self.actor.SetMapper(self.mapper)
        self.actor.GetProperty().LightingOff()
        self.actor.PickableOff()

    def show(self, layer: LineLayer, scale: float) -> bool:
        if self.layer is layer:
            return False
        if self.layer is None or self.layer.segments is not layer.segments:
            n = len(layer.segments)
            data = vtkPolyData()
            points = vtkPoints()
            points.SetData(numpy_to_vtk(np.ascontiguousarray(layer.segments.reshape(-1, 3), np.float32), deep=True))
            data.SetPoints(points)
            cells = vtkCellArray()
            cells.SetData(2, numpy_to_vtk(np.arange(2 * n, dtype=np.int64), deep=True, array_type=VTK_ID_TYPE))
            data.SetLines(cells)
            self.mapper.SetInputData(data)
        look = self.actor.GetProperty()
        look.SetColor(*(c / 255 for c in layer.colour))
        look.SetLineWidth(max(layer.width * scale, 1.0))
        look.SetOpacity(layer.opacity)
        self.layer = layer
        return True

    def actors(self) -> list[vtkActor]:
        return [self.actor]


@dataclass(eq=False)
class Cell:
    """One view's renderer and what is in it."""

    renderer: vtkRenderer
    drawn: dict[str, _MeshActor | _PointActor | _LineActor] = field(default_factory=dict)
    floor: vtkActor | None = None
    floor_of: tuple[object, object] = (None, None)


class Scene:
    """Shows Displays in a render window.  ``render`` is called once when anything changed.

    Use from the thread that owns the window only.  ``plotter.ren_win`` is the render window, ``scale`` device pixels
    per logical pixel.
    """

    def __init__(
        self, plotter: Any, render: Callable[[], None], *, background: Colour = (23, 24, 27),
        line: Colour = (52, 54, 60), scale: float = 1.0,
    ) -> None:  # fmt: skip
        self.window = plotter.ren_win
        self.render = render
        self.scale = scale
        self.background, self.line = background, line
        for renderer in list(self.window.GetRenderers()):
            self.window.RemoveRenderer(renderer)
        self.back = vtkRenderer()  # behind all cells: its colour is the line between them
        self.back.InteractiveOff()
        self.window.AddRenderer(self.back)
        self.camera = vtkCamera()
        place_camera(self.camera)
        self.cells: list[Cell] = []
        self.display = Display()
        self.shape = (0, 0)
        self.size: tuple[int, int] | None = None
        self.shadow = 0.75
        self.ambient_occlusion = False
        self._restyle()

    def restyle(self, background: Colour, line: Colour, shadow: float) -> None:
        """Other colours (a change of theme): ``shadow`` is the darkness of the floor shadow, 0..1."""
        self.background, self.line = background, line
        if shadow != self.shadow:
            self.shadow = shadow
            for cell in self.cells:
                cell.floor_of = (None, None)
        self._restyle()
        display, self.display = self.display, Display()
        self.show(display, force=True)

    def _restyle(self) -> None:
        self.back.SetBackground(*(c / 255 for c in self.line))
        for cell in self.cells:
            cell.renderer.SetBackground(*(c / 255 for c in self.background))

    def show(self, display: Display, *, force: bool = False) -> bool:
        """Make the window show ``display``; True when something had to be drawn again."""
        changed = self._arrange(display.rows, display.columns) or force
        for cell, view in zip(self.cells, display.views, strict=False):
            changed |= self._show_view(cell, view)
        for cell in self.cells[len(display.views) :]:
            changed |= self._show_view(cell, View(ground=False))
        self.display = display
        if changed:
            self.render()
        return bool(changed)

    def _arrange(self, rows: int, columns: int) -> bool:
        if (rows, columns) == self.shape:
            return False
        for cell in self.cells[rows * columns :]:
            self.window.RemoveRenderer(cell.renderer)
        del self.cells[rows * columns :]
        while len(self.cells) < rows * columns:
            renderer = vtkRenderer()
            renderer.SetActiveCamera(self.camera)
            light(renderer)
            self.window.AddRenderer(renderer)
            self.cells.append(Cell(renderer))
        self.shape = (rows, columns)
        self._restyle()
        self.lay_out()
        return True

    def lay_out(self, size: tuple[int, int] | None = None) -> None:
        """Viewports of the cells one pixel apart, for a window of ``size`` pixels (its present size)."""
        rows, columns = self.shape
        self.size = size or self.size or tuple(self.window.GetSize())
        width, height = (max(n, 1) for n in self.size)
        for i, cell in enumerate(self.cells):
            r, c = divmod(i, columns)
            x0, x1 = round(c * width / columns) + (c > 0), round((c + 1) * width / columns)
            top, bottom = round(r * height / rows), round((r + 1) * height / rows) - (r < rows - 1)
            cell.renderer.SetViewport(x0 / width, 1 - bottom / height, x1 / width, 1 - top / height)

    def _show_view(self, cell: Cell, view: View) -> bool:
        changed = False
        wanted = {layer.key: layer for layer in view.layers}
        for key in [k for k in cell.drawn if k not in wanted]:
            for actor in cell.drawn.pop(key).actors():
                cell.renderer.RemoveActor(actor)
            changed = True
        for key, layer in wanted.items():
            drawn = cell.drawn.get(key)
            if drawn is None:
                drawn = {MeshLayer: _MeshActor, PointLayer: _PointActor, LineLayer: _LineActor}[type(layer)]()
                cell.drawn[key] = drawn
            before = drawn.actors()
            if drawn.show(layer, self.scale):
                changed = True
            after = drawn.actors()
            for actor in before:
                if actor not in after:
                    cell.renderer.RemoveActor(actor)
            for actor in after:
                if not cell.renderer.HasViewProp(actor):
                    cell.renderer.AddActor(actor)
                    changed = True
        return self._show_floor(cell, view) or changed

    def _show_floor(self, cell: Cell, view: View) -> bool:
        meshes = [layer for layer in view.layers if isinstance(layer, MeshLayer)]
        source = (meshes[0].vertices, meshes[0].triangles) if view.ground and meshes else (None, None)
        if source[0] is cell.floor_of[0] and source[1] is cell.floor_of[1]:
            return False
        if view.moves and cell.floor is not None and source[0] is not None:
            return False
        if cell.floor is not None:
            cell.renderer.RemoveActor(cell.floor)
            cell.floor = None
        if source[0] is not None and len(source[1]):
            cell.floor = floor_actor(source[0], source[1], self.shadow)
            cell.renderer.AddActor(cell.floor)
        cell.floor_of = source
        return True

    def occlude(self, on: bool) -> None:
        """Ambient occlusion in every cell: beautiful and slow in software GL."""
        self.ambient_occlusion = on
        for cell in self.cells:
            cell.renderer.SetUseSSAO(on)
            cell.renderer.SetSSAORadius(0.09)
            cell.renderer.SetSSAOBias(0.004)
            cell.renderer.SetSSAOKernelSize(64)
            cell.renderer.SetSSAOBlur(True)

    def smooth(self, on: bool) -> None:
        """Smooth the stair-steps of edges (FXAA, one pass over the picture)."""
        for cell in self.cells:
            cell.renderer.SetUseFXAA(on)

    def pixels(self, *, alpha: bool = False) -> UInt8[np.ndarray, "h w c"]:
        """Render now and return the picture (h, w, 3), or (h, w, 4) with ``alpha``; device pixels."""
        self.window.Render()
        width, height = self.window.GetSize()
        flat = vtkUnsignedCharArray()
        read = self.window.GetRGBACharPixelData if alpha else self.window.GetPixelData
        read(0, 0, width - 1, height - 1, 0, flat, 0)
        return vtk_to_numpy(flat).reshape(height, width, -1)[::-1].copy()

    def clear(self) -> None:
        """Forget every actor (before the window closes)."""
        for cell in self.cells:
            cell.renderer.RemoveAllViewProps()
            self.window.RemoveRenderer(cell.renderer)
        self.cells = []
        self.shape = (0, 0)
