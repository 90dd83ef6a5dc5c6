"""Puts a Display into a render window: only what changed is touched, and there is one render at the end.

The look of every picture is set here once: camera, lights, shading, the shadow on the floor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pyvista as pv
from jaxtyping import Float, Int, UInt8
from scipy.ndimage import gaussian_filter
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import VTK_ID_TYPE, vtkDataArray, vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkPolyDataNormals
from vtkmodules.vtkFiltersSources import vtkPlaneSource
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkCamera,
    vtkLight,
    vtkPolyDataMapper,
    vtkRenderer,
    vtkTexture,
)

from shapeforge.viewer.display import Colour, Display, LineLayer, MeshLayer, PointLayer, View, record_borders

VIEW_DIRECTION = (1.0, 0.6, 1.5)
FEATURE_ANGLE = 32.0
AMBIENT, DIFFUSE, SPECULAR = 0.36, 0.84, 0.1
FLOOR_PIXELS = 128


def surface(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], angle: float = FEATURE_ANGLE
) -> tuple[pv.PolyData, Int[np.ndarray, " W"]]:
    """A polydata with normals split at creases of ``angle`` degrees, and the vertex (W,) each of its points came from.

    Coincident vertices are welded for the normals only, so soups shade smoothly; triangle k stays cell k.
    """
    welded, first, index = _weld(vertices)
    mesh = pv.PolyData.from_regular_faces(welded.astype(np.float32), index[triangles])
    mesh.point_data["origin"] = first
    normals = vtkPolyDataNormals()
    normals.SetInputData(mesh)
    normals.SetFeatureAngle(angle)
    normals.SplittingOn()
    normals.ConsistencyOff()
    normals.NonManifoldTraversalOff()
    normals.Update()
    split = pv.wrap(normals.GetOutput())
    origin = np.asarray(split.point_data["origin"])
    split.point_data.remove("origin")
    return split, origin


def _weld(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distinct positions (to 1e-6 of the size), one vertex of each, and the position of every vertex."""
    if not len(vertices):
        return vertices, np.zeros(0, int), np.zeros(0, int)
    step = max(float(np.ptp(vertices, axis=0).max()), 1e-12) * 1e-6
    cell = np.round((vertices - vertices.min(axis=0)) / step).astype(np.int64)
    key = (cell[:, 0] << 42) ^ (cell[:, 1] << 21) ^ cell[:, 2]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    return vertices[first], first, index


def floor_shadow(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], strength: float = 0.75
) -> tuple[Float[np.ndarray, "h w 4"], tuple[float, float, float, float], float]:
    """A soft contact shadow: an RGBA picture (h, w, 4) in 0..1, the floor rectangle x0, x1, z0, z1, and the floor's y.

    What is near the floor darkens it sharply, what is higher softly and faintly.
    """
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = max(float(np.linalg.norm(high - low)), 1e-9)
    margin = 0.18 * size
    x0, x1, z0, z1 = low[0] - margin, high[0] + margin, low[2] - margin, high[2] + margin
    alpha = np.zeros((FLOOR_PIXELS, FLOOR_PIXELS))
    if area.sum() > 0:
        rng = np.random.default_rng(0)  # a picture's noise, not a result: the same picture every time
        which = rng.choice(len(area), 24000, p=area / area.sum())
        u = np.sqrt(rng.random(24000))[:, None]
        v = rng.random(24000)[:, None]
        point = (1 - u) * a[which] + u * (1 - v) * b[which] + u * v * c[which]
        height = (point[:, 1] - low[1]) / size
        pixel = size / 24000 * FLOOR_PIXELS**2 / ((x1 - x0) * (z1 - z0)) * area.sum() / size
        for reach, blur, weight in ((0.035, 0.018, 0.9), (0.12, 0.045, 0.5), (0.6, 0.09, 0.25)):
            picture, _, _ = np.histogram2d(
                point[:, 2], point[:, 0], bins=FLOOR_PIXELS, range=[[z0, z1], [x0, x1]],
                weights=np.exp(-height / reach),
            )  # fmt: skip
            picture *= 0.5 * pixel
            alpha += weight * gaussian_filter(
                np.minimum(picture, 4.0),
                (blur * size * FLOOR_PIXELS / (z1 - z0), blur * size * FLOOR_PIXELS / (x1 - x0)),
            )
    alpha = strength * (1 - np.exp(-1.2 * alpha))
    ramp = np.minimum(np.arange(FLOOR_PIXELS), np.arange(FLOOR_PIXELS)[::-1]) / (0.1 * FLOOR_PIXELS)
    fade = np.clip(ramp, 0, 1) ** 2
    picture = np.zeros((FLOOR_PIXELS, FLOOR_PIXELS, 4))
    picture[..., 3] = alpha * fade[:, None] * fade[None, :]
    return picture, (float(x0), float(x1), float(z0), float(z1)), float(low[1])


def light(renderer: vtkRenderer) -> None:
    """Key from the upper left, fill from the right (4/5 of it), weak rim; they turn with the camera."""
    renderer.RemoveAllLights()
    renderer.AutomaticLightCreationOff()
    for position, intensity in (((-0.55, 1.1, 0.75), 0.62), ((1.25, 0.25, 0.7), 0.48), ((0.2, 0.6, -1.0), 0.22)):
        lamp = vtkLight()
        lamp.SetLightTypeToCameraLight()
        lamp.SetPosition(*position)
        lamp.SetFocalPoint(0, 0, 0)
        lamp.SetIntensity(intensity)
        renderer.AddLight(lamp)


def place_camera(
    camera: vtkCamera, focus: tuple[float, float, float] = (0, 0, 0), scale: float = 0.56,
    direction: tuple[float, float, float] = VIEW_DIRECTION,
) -> None:  # fmt: skip
    """Orthographic, from ``direction``, y up; ``scale`` is half the height of the view in diagonals."""
    away = np.asarray(direction, float) / np.linalg.norm(direction) * 3
    camera.SetParallelProjection(True)
    camera.SetFocalPoint(*focus)
    camera.SetPosition(*(np.asarray(focus) + away))
    camera.SetViewUp(0, 1, 0)
    camera.SetParallelScale(scale)
    camera.SetClippingRange(0.5, 6.0)


def frame_of(
    vertices: Float[np.ndarray, "V 3"], aspect: float, direction: tuple[float, float, float] = VIEW_DIRECTION,
    margin: float = 1.16,
) -> tuple[tuple[float, float, float], float]:  # fmt: skip
    """Focus and parallel scale with which ``vertices`` fill a view ``aspect`` times as wide as high."""
    away = np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross((0, 1, 0), away)
    right /= np.linalg.norm(right)
    up = np.cross(away, right)
    axes = np.stack([right, up, away])
    flat = vertices @ axes.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    focus = ((low + high) / 2) @ axes
    half = (high - low) / 2
    return tuple(float(x) for x in focus), float(margin * max(half[1], half[0] / max(aspect, 1e-3), 1e-3))


def _colours_array(colours: np.ndarray) -> vtkDataArray:
    array = numpy_to_vtk(np.ascontiguousarray(colours, np.uint8), deep=True)
    array.SetName("colour")
    return array


def _shade(actor: vtkActor, opacity: float) -> None:
    look = actor.GetProperty()
    look.SetInterpolationToPhong()
    look.SetAmbient(AMBIENT)
    look.SetDiffuse(DIFFUSE)
    look.SetSpecular(SPECULAR)
    look.SetSpecularPower(24)
    look.SetOpacity(opacity)


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
            _shade(self.actor, layer.opacity)
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


def _floor_actor(vertices: np.ndarray, triangles: np.ndarray, strength: float) -> vtkActor:
    picture, (x0, x1, z0, z1), y = floor_shadow(vertices, triangles, strength)
    y -= 0.002
    plane = vtkPlaneSource()
    plane.SetOrigin(x0, y, z0)
    plane.SetPoint1(x1, y, z0)
    plane.SetPoint2(x0, y, z1)
    image = vtkImageData()
    image.SetDimensions(FLOOR_PIXELS, FLOOR_PIXELS, 1)
    pixels = np.ascontiguousarray(np.round(picture * 255).astype(np.uint8).reshape(-1, 4))
    image.GetPointData().SetScalars(numpy_to_vtk(pixels, deep=True))
    texture = vtkTexture()
    texture.SetInputData(image)
    texture.InterpolateOn()
    texture.SetColorModeToDirectScalars()
    mapper = vtkPolyDataMapper()
    mapper.SetInputConnection(plane.GetOutputPort())
    actor = vtkActor()
    actor.SetMapper(mapper)
    actor.SetTexture(texture)
    actor.GetProperty().LightingOff()
    actor.ForceTranslucentOn()
    actor.PickableOff()
    return actor


@dataclass(eq=False)
class Cell:
    """One view's renderer and what is in it."""

    renderer: vtkRenderer
    drawn: dict[str, _MeshActor | _PointActor | _LineActor] = field(default_factory=dict)
    floor: vtkActor | None = None
    floor_of: tuple[object, object] = (None, None)


class Scene:
    """Shows Displays in a render window.  ``render`` is called once when anything changed.

    Use from the thread that owns the window only.  ``scale`` is device pixels per logical pixel.
    """

    def __init__(
        self, plotter: pv.BasePlotter, render: Callable[[], None], *, background: Colour = (23, 24, 27),
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

    def lay_out(self) -> None:
        """Viewports of the cells for the window's present size, one pixel apart."""
        rows, columns = self.shape
        width, height = (max(n, 1) for n in self.window.GetSize())
        for i, cell in enumerate(self.cells):
            r, c = divmod(i, columns)
            x0, x1 = round(c * width / columns), round((c + 1) * width / columns)
            y0, y1 = round((rows - 1 - r) * height / rows), round((rows - r) * height / rows)
            x0, y0 = x0 + (c > 0), y0 + (r < rows - 1)
            cell.renderer.SetViewport(x0 / width, y0 / height, x1 / width, y1 / height)

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
        if cell.floor is not None:
            cell.renderer.RemoveActor(cell.floor)
            cell.floor = None
        if source[0] is not None and len(source[1]):
            cell.floor = _floor_actor(source[0], source[1], self.shadow)
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
