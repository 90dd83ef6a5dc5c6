"""Turntables: a shape turned once around, as pictures and as a file that any browser plays."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from shapeforge.collection.mesh_files import write_atomically
from shapeforge.viewer.display import MeshLayer, View
from shapeforge.viewer.look import VIEW_DIRECTION, frame_of
from shapeforge.viewer.palette import Theme
from shapeforge.viewer.pictures import take_picture

FORMATS = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}
SECONDS = 6.0


def turntable(
    layer: MeshLayer, frames: int = 48, size: tuple[int, int] = (480, 480), theme: Theme = "dark"
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Pictures (``frames`` of them) of a mesh turned once about the upright axis through the middle of its box."""
    if frames < 2:
        raise ValueError(f"frames: wanted at least 2, got {frames}")
    vertices = np.asarray(layer.vertices, float)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    angles = 2 * np.pi * np.arange(frames) / frames
    turned = [(vertices - middle) @ _about_y(angle).T for angle in angles]
    # One camera for all: a shape that grew and shrank on its way round would be hard to look at.
    camera = frame_of(np.concatenate(turned[:: max(frames // 12, 1)]), size[0] / size[1], VIEW_DIRECTION, 1.12)
    return [take_picture(View((replace(layer, vertices=one),)), size, theme, camera=camera) for one in turned]


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def write_movie(path: Path, pictures: Sequence[UInt8[np.ndarray, "h w 3"]], *, seconds: float = SECONDS) -> Path:
    """Write pictures as an endless movie: .gif, .webp or .png (animated), all ``seconds`` long; the path."""
    kind = FORMATS.get(path.suffix.lower())
    if kind is None or not len(pictures):
        raise ValueError(f"{path.name}: wanted an ending of {', '.join(FORMATS)} and at least one picture")
    images = [Image.fromarray(picture) for picture in pictures]
    buffer = io.BytesIO()
    duration = max(round(1000 * seconds / len(images)), 20)
    images[0].save(buffer, kind, save_all=True, append_images=images[1:], duration=duration, loop=0)
    write_atomically(path, buffer.getvalue())
    return path
