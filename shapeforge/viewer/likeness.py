"""Pictures of a project's shapes for pages and notebooks: as given, by part, by correspondence, new ones, sliders.

All come back as transparent pictures (h, w, 4), so that one picture stands on light and on dark ground.
"""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh
from shapeforge.viewer.display import MeshLayer, PointLayer, View, coordinate_colours
from shapeforge.viewer.palette import label_colours, rgb, tokens
from shapeforge.viewer.pictures import shape_picture, take_picture

GREY = "#B9BDC6"
"""Shapes as they came: between the two themes' greys, to be seen on both."""


def plain_picture(project: Any, name: str, size: int | tuple[int, int]) -> UInt8[np.ndarray, "h w 4"]:
    """The shape as it came, grey."""
    return shape_picture(project, name, size, "light", colour=rgb(GREY), transparent=True)


def part_picture(project: Any, name: str, size: int | tuple[int, int]) -> UInt8[np.ndarray, "h w 4"] | None:
    """The shape by fitted part, else by given labels; None without either."""
    labels = project.face_labels(name)
    if labels is None:
        labels = project.labels(name)
    if labels is None:
        return None
    fitted = project.hierarchy()
    inks = project.part_inks(fitted.top.part_names if fitted is not None else None)
    return shape_picture(project, name, size, "light", labels=labels, inks=inks, transparent=True)


def place_colours(project: Any) -> UInt8[np.ndarray, "K 3"]:
    """A colour for every top-level template point (K, 3): the same place has the same colour on every shape."""
    return coordinate_colours(np.asarray(project.hierarchy().top.points, dtype=float))


def correspondence_view(project: Any, name: str) -> View | None:
    """The shape with every vertex in the colours of the template places nearest to it; None before a fit."""
    positions = project.positions(name)
    if positions is None:
        return None
    mesh = project.shapes.named(name).mesh
    there = np.isfinite(positions).all(axis=1)
    if not there.any():
        return None
    colours = blended(np.asarray(positions[there], dtype=float), place_colours(project)[there], mesh.vertices)
    layer = MeshLayer("mesh", np.asarray(mesh.vertices, dtype=float), mesh.triangles, colours, smooth_colours=True)
    return View((layer,))


def blended(
    places: Float[np.ndarray, "n 3"], colours: UInt8[np.ndarray, "n 3"], at: Float[np.ndarray, "V 3"]
) -> UInt8[np.ndarray, "V 3"]:
    """Colours (V, 3) at positions ``at``: those of the four nearest places, weighted by 1 / distance squared."""
    near = min(4, len(places))
    distance, index = cKDTree(places).query(at, k=near)
    distance, index = distance.reshape(len(at), near), index.reshape(len(at), near)
    weight = 1 / np.maximum(distance, 1e-6) ** 2
    mixed = (weight[..., None] * colours[index].astype(float)).sum(axis=1) / weight.sum(axis=1, keepdims=True)
    return np.round(mixed).astype(np.uint8)


def correspondence_picture(project: Any, name: str, size: int | tuple[int, int]) -> UInt8[np.ndarray, "h w 4"] | None:
    """The shape by correspondence; None before a fit."""
    view = correspondence_view(project, name)
    return None if view is None else take_picture(view, size, "light", transparent=True)


def mesh_picture(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], part: Int[np.ndarray, " N"],
    inks: UInt8[np.ndarray, "L 3"], size: int | tuple[int, int],
) -> UInt8[np.ndarray, "h w 4"]:  # fmt: skip
    """A synthesized mesh by part."""
    colours = np.ascontiguousarray(label_colours(np.asarray(part), inks))
    layer = MeshLayer("mesh", np.asarray(vertices, dtype=float), triangles, colours)
    return take_picture(View((layer,)), size, "light", transparent=True)


def points_picture(
    points: Float[np.ndarray, "K 3"], colours: UInt8[np.ndarray, "K 3"], size: int | tuple[int, int], *,
    dot: float = 3.0, camera: tuple[tuple[float, float, float], float] | None = None,
) -> UInt8[np.ndarray, "h w 4"]:  # fmt: skip
    """Coloured points; rows that are not finite are left out."""
    there = np.isfinite(points).all(axis=1)
    layer = PointLayer("points", np.asarray(points[there], dtype=float), np.ascontiguousarray(colours[there]), dot)
    return take_picture(View((layer,), ground=False), size, "light", transparent=True, camera=camera)


def data_address(picture: UInt8[np.ndarray, "h w 4"]) -> str:
    """A transparent picture as a ``data:`` address: a PNG with 256 colours, a quarter of the size of all colours."""
    index, palette = _palette(picture)
    image = Image.fromarray(index, "P")
    image.putpalette(palette[:, :3].tobytes(), "RGB")
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True, transparency=palette[:, 3].tobytes())
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _palette(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (h, w) of every pixel in a palette (n, 4), n <= 256.

    What is solid, the soft edges and the shadow each have their own colours: quantized together, shadows turn into
    pale stains on dark ground.
    """
    alpha = picture[..., 3]
    solid = alpha >= 250
    # A shadow is black, but comes blended with the ground that the picture was taken on.
    ground = np.array(rgb(tokens("light")["view"])) * (1 - alpha[..., None] / 255)
    colour = picture[..., :3]
    shadow = ~solid & ((colour.max(axis=-1) < 48) | (np.abs(colour - ground).max(axis=-1) < 12))
    edge = ~solid & ~shadow
    index = np.zeros(alpha.shape, np.uint8)
    index[shadow] = alpha[shadow] // 8
    palette = [np.stack([np.zeros(32), np.zeros(32), np.zeros(32), np.arange(32) * 8], axis=1).astype(np.uint8)]
    for where, mode, most in ((solid, "RGB", 168), (edge, "RGBA", 56)):
        if not where.any():
            continue
        channels = len(mode)
        method = Image.Quantize.MEDIANCUT if mode == "RGB" else Image.Quantize.FASTOCTREE
        strip = Image.fromarray(np.ascontiguousarray(picture[where][None, :, :channels]), mode)
        reduced = strip.quantize(most, method=method, dither=Image.Dither.NONE)
        colours = np.array(reduced.getpalette(mode), np.uint8).reshape(-1, channels)[:most]
        if mode == "RGB":
            colours = np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], axis=1)
        index[where] = np.asarray(reduced)[0] + sum(len(one) for one in palette)
        palette.append(colours)
    return index, np.concatenate(palette)


def part_areas(mesh: Mesh, labels: Int[np.ndarray, " F"], n_parts: int) -> Float[np.ndarray, " L"]:
    """Share of the surface that each part has (L,); what has no label counts for none."""
    known = labels >= 0
    area = np.bincount(labels[known], mesh.face_areas[known], n_parts)
    return area / max(float(mesh.face_areas.sum()), 1e-300)
