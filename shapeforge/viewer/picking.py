"""From a place in the window to a place on the shape and back.  The camera is orthographic, so rays are parallel."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from vtkmodules.vtkCommonCore import mutable
from vtkmodules.vtkCommonDataModel import vtkStaticCellLocator
from vtkmodules.vtkRenderingCore import vtkCamera

from shapeforge.viewer.display import MeshLayer
from shapeforge.viewer.look import polydata

Number = float | int
Rectangle = tuple[Number, Number, Number, Number]
KEPT_LOCATORS = 40
NEAR = (3.0, 6.0)  # logical pixels beside a thin leg that still mean the leg


@dataclass(frozen=True, eq=False)
class Pick:
    """What lies under the pointer: the cell of the window, the layer, the triangle and the place on it.

    ``normal`` is the triangle's unit normal turned towards the viewer; ``position`` is in diagonals.
    """

    view: int
    layer: str
    triangle: int
    position: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]


def camera_axes(camera: vtkCamera) -> Float[np.ndarray, "3 3"]:
    """Unit rows right, up, towards the viewer of an orthographic camera."""
    away = np.array(camera.GetPosition()) - np.array(camera.GetFocalPoint())
    away /= np.linalg.norm(away)
    right = np.cross(camera.GetViewUp(), away)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(away, right), away])


def project(camera: vtkCamera, positions: Float[np.ndarray, "n 3"], rectangle: Rectangle) -> Float[np.ndarray, "n 2"]:
    """Window places (n, 2), y down, of positions in a cell ``rectangle`` = x, y, width, height (logical pixels)."""
    x, y, width, height = rectangle
    flat = (np.asarray(positions, float) - np.array(camera.GetFocalPoint())) @ camera_axes(camera)[:2].T
    pixels = height / (2 * camera.GetParallelScale())
    return np.stack([x + width / 2 + flat[:, 0] * pixels, y + height / 2 - flat[:, 1] * pixels], axis=1)


def around(x: Number, y: Number) -> Iterator[tuple[float, float]]:
    """Places a few pixels about (x, y), the nearer ones first: where a thin leg may be that was meant."""
    for distance in NEAR:
        for turn in range(8):
            yield x + distance * math.cos(turn * math.pi / 4), y + distance * math.sin(turn * math.pi / 4)


class Picker:
    """First triangles hit by the ray under a pixel; one locator per geometry, kept while the geometry is in use.

    The locators see a geometry-only copy: colouring the shown mesh never rebuilds them.
    """

    def __init__(self) -> None:
        self._locators: OrderedDict[tuple[int, int], tuple[MeshLayer, vtkStaticCellLocator]] = OrderedDict()

    def _locator(self, layer: MeshLayer) -> vtkStaticCellLocator:
        key = (id(layer.vertices), id(layer.triangles))
        if key in self._locators:
            self._locators.move_to_end(key)
            return self._locators[key][1]
        locator = vtkStaticCellLocator()
        locator.SetDataSet(polydata(np.asarray(layer.vertices, np.float64), np.asarray(layer.triangles)))
        locator.BuildLocator()
        self._locators[key] = (layer, locator)  # the layer keeps the arrays alive, so their ids stay theirs
        while len(self._locators) > KEPT_LOCATORS:
            self._locators.popitem(last=False)
        return locator

    def pick(
        self, camera: vtkCamera, layers: tuple[MeshLayer, ...], place: tuple[Number, Number],
        rectangle: Rectangle, view: int = 0,
    ) -> Pick | None:  # fmt: skip
        """The nearest hit of ``layers`` at window place (x, y), y down, in the cell ``rectangle``; None on nothing."""
        x, y, width, height = rectangle
        axes = camera_axes(camera)
        unit = 2 * camera.GetParallelScale() / height
        offset = np.array([place[0] - x - width / 2, y + height / 2 - place[1]]) * unit
        through = np.array(camera.GetFocalPoint()) + offset @ axes[:2]
        start, end = through + 4 * axes[2], through - 4 * axes[2]
        best: Pick | None = None
        nearest = np.inf
        for layer in layers:
            if not len(layer.triangles):
                continue
            t, position, coordinates, sub, cell = mutable(0.0), [0.0] * 3, [0.0] * 3, mutable(0), mutable(-1)
            hit = self._locator(layer).IntersectWithLine(start, end, 1e-7, t, position, coordinates, sub, cell)
            if hit and float(t) < nearest:
                nearest = float(t)
                corners = layer.vertices[layer.triangles[int(cell)]]
                best = Pick(view, layer.key, int(cell), np.array(position), _facing(corners, axes[2]))
        return best


def _facing(corners: np.ndarray, viewer: np.ndarray) -> np.ndarray:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    length = np.linalg.norm(normal)
    normal = normal / length if length > 0 else viewer
    return normal if normal @ viewer >= 0 else -normal
