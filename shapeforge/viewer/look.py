"""The look of every picture of a shape, in the window and off screen: shading, lights, camera, shadow on the floor."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_filter
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkIdTypeArray, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkPolyDataNormals
from vtkmodules.vtkFiltersSources import vtkPlaneSource
from vtkmodules.vtkRenderingCore import vtkActor, vtkCamera, vtkLight, vtkPolyDataMapper, vtkRenderer, vtkTexture

VIEW_DIRECTION = (1.0, 0.6, 1.5)
FEATURE_ANGLE = 32.0
AMBIENT, DIFFUSE, SPECULAR = 0.36, 0.84, 0.1
FLOOR_PIXELS = 128


def polydata(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"]) -> vtkPolyData:
    """Triangles as VTK has them.  (PyVista would bring matplotlib along, two seconds before the first picture.)"""
    points, cells, data = vtkPoints(), vtkCellArray(), vtkPolyData()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
    index = np.ascontiguousarray(triangles, np.int64)
    offsets = np.arange(0, 3 * len(index) + 1, 3, dtype=np.int64)
    id_type = vtkIdTypeArray().GetDataType()
    cells.SetData(
        numpy_to_vtk(offsets, deep=True, array_type=id_type), numpy_to_vtk(index.ravel(), deep=True, array_type=id_type)
    )
    data.SetPoints(points)
    data.SetPolys(cells)
    return data


def surface(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], angle: float = FEATURE_ANGLE
) -> tuple[vtkPolyData, Int[np.ndarray, " W"]]:
    """A polydata with normals split at creases of ``angle`` degrees, and the vertex (W,) each of its points came from.

    Coincident vertices are welded for the normals only, so soups shade smoothly; triangle k stays cell k.
    """
    welded, first, index = _weld(vertices)
    mesh = polydata(welded.astype(np.float32), index[triangles])
    origins = numpy_to_vtk(np.asarray(first, np.int64), deep=True)
    origins.SetName("origin")
    mesh.GetPointData().AddArray(origins)
    normals = vtkPolyDataNormals()
    normals.SetInputData(mesh)
    normals.SetFeatureAngle(angle)
    normals.SplittingOn()
    normals.ConsistencyOff()
    normals.NonManifoldTraversalOff()
    normals.Update()
    split = normals.GetOutput()
    origin = vtk_to_numpy(split.GetPointData().GetArray("origin")).copy()
    split.GetPointData().RemoveArray("origin")
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


def direction_from(azimuth: float | int, elevation: float | int) -> tuple[float, float, float]:
    """Towards a viewer at ``azimuth`` degrees (0 is the front, +z) and ``elevation`` degrees above the floor."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)


def angles_of(camera: vtkCamera) -> tuple[float, float]:
    """From which azimuth and elevation (degrees) a camera looks: the inverse of ``direction_from``."""
    away = np.array(camera.GetPosition()) - np.array(camera.GetFocalPoint())
    elevation = math.asin(np.clip(away[1] / np.linalg.norm(away), -1, 1))
    return math.degrees(math.atan2(away[0], away[2])), math.degrees(elevation)


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


def floor_actor(vertices: np.ndarray, triangles: np.ndarray, strength: float) -> vtkActor:
    """The blurred contact shadow under a mesh, vertices (V, 3) and triangles (N, 3), a textured plane."""
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


def shade(actor: vtkActor, opacity: float) -> None:
    """The material of every surface: soft, hardly shiny."""
    look = actor.GetProperty()
    look.SetInterpolationToPhong()
    look.SetAmbient(AMBIENT)
    look.SetDiffuse(DIFFUSE)
    look.SetSpecular(SPECULAR)
    look.SetSpecularPower(24)
    look.SetOpacity(opacity)
