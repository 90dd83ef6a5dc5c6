"""Small pictures of shapes: rendered off screen once, kept in the project's ``thumbs`` folder, shown everywhere.

One hidden window serves all pictures.  OpenGL wants one thread: call these functions from the thread that called first
(the GUI thread in the window, the main thread elsewhere); from another thread they raise RuntimeError.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from shapeforge.viewer.display import Display, MeshLayer, PointLayer, View
from shapeforge.viewer.palette import Theme, label_colours, part_colours, rgb, tokens

if TYPE_CHECKING:
    from shapeforge.collection.shape import Mesh

OVERSAMPLING = 2
LOOK_VERSION = 1  # part of every cache key: raise it when pictures should look different
SHADOW: dict[str, float] = {"dark": 0.85, "light": 0.32}

Place3 = tuple[float, float, float]
Camera = tuple[Place3, float] | tuple[Place3, float, Place3]


class _Studio:
    """The hidden window, made when the first picture is asked for."""

    def __init__(self) -> None:
        # Without a screen VTK must be told to use EGL, else it complains about X first.
        if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        # The classes of VTK that draw are found by these imports, not by their names.
        from vtkmodules import vtkRenderingFreeType, vtkRenderingOpenGL2  # noqa: F401
        from vtkmodules.vtkRenderingCore import vtkRenderWindow

        from shapeforge.viewer.scene import Scene

        self.thread = threading.get_ident()
        self.ren_win = vtkRenderWindow()
        self.ren_win.SetOffScreenRendering(1)
        self.ren_win.SetSize(64, 64)
        self.ren_win.SetMultiSamples(0)
        self.ren_win.SetAlphaBitPlanes(1)
        self.scene = Scene(self, lambda: None)

    def take(
        self, view: View, width: int, height: int, theme: Theme, ground: tuple[int, int, int] | None,
        camera: Camera | None, shadow: float | None,
    ) -> np.ndarray:  # fmt: skip
        from shapeforge.viewer.look import VIEW_DIRECTION, frame_of, place_camera

        self.ren_win.SetSize(width * OVERSAMPLING, height * OVERSAMPLING)
        scene = self.scene
        scene.scale = float(OVERSAMPLING)
        scene.shadow = SHADOW[theme] if shadow is None else shadow
        scene.background = rgb(tokens(theme)["view"]) if ground is None else ground
        scene.show(Display((view,)), force=True)
        cell = scene.cells[0]
        cell.renderer.SetBackground(*(c / 255 for c in scene.background))
        cell.renderer.SetBackgroundAlpha(0.0 if ground is None else 1.0)
        scene.back.SetBackgroundAlpha(0.0)
        if camera is None:
            corners = [
                layer.vertices if isinstance(layer, MeshLayer) else layer.positions
                for layer in view.layers
                if isinstance(layer, MeshLayer | PointLayer)
            ]
            points = np.concatenate(corners) if corners else np.zeros((1, 3))
            points = points[np.isfinite(points).all(axis=1)] if len(points) else np.zeros((1, 3))
            camera = frame_of(points, width / height, VIEW_DIRECTION, 1.12)
        place_camera(scene.camera, *camera)
        picture = scene.pixels(alpha=True)
        return _shrink(picture, width, height)


def _shrink(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """Mean over OVERSAMPLING x OVERSAMPLING pixels; colours are premultiplied by their alpha meanwhile."""
    blocks = picture[: height * OVERSAMPLING, : width * OVERSAMPLING].astype(np.float32)
    blocks = blocks.reshape(height, OVERSAMPLING, width, OVERSAMPLING, 4)
    alpha = blocks[..., 3:] / 255
    colour = (blocks[..., :3] * alpha).sum(axis=(1, 3)) / np.maximum(alpha.sum(axis=(1, 3)), 1e-6)
    share = alpha.mean(axis=(1, 3)) * 255
    return np.round(np.concatenate([colour, share], axis=-1)).astype(np.uint8)


_studio: _Studio | None = None


def _shared_studio() -> _Studio:
    global _studio
    if _studio is None:
        _studio = _Studio()
    if _studio.thread != threading.get_ident():
        raise RuntimeError("pictures are taken from one thread only: the one that took the first picture")
    return _studio


def close_studio() -> None:
    """Close the hidden window (a test or the end of the programme); the next picture opens another."""
    global _studio
    if _studio is not None:
        _studio.scene.clear()
        _studio.ren_win.Finalize()
        _studio = None


def take_picture(
    view: View, size: int | tuple[int, int], theme: Theme = "dark", *, transparent: bool = False,
    ground: tuple[int, int, int] | None = None, camera: Camera | None = None, shadow: float | None = None,
) -> UInt8[np.ndarray, "h w c"]:  # fmt: skip
    """Picture of a View: (h, w, 3) on ``ground`` (the theme's view colour), or (h, w, 4) when ``transparent``.

    ``size`` is a side or (width, height) in pixels; ``camera`` = (focus, half height in diagonals) and, if not the
    house's, the direction to look from; without one the picture fits.
    """
    width, height = (size, size) if isinstance(size, int) else size
    if width < 1 or height < 1:
        raise ValueError(f"size must be at least 1 x 1 pixel, got {width} x {height}")
    solid = ground if ground is not None else rgb(tokens(theme)["view"])
    picture = _shared_studio().take(view, width, height, theme, None if transparent else solid, camera, shadow)
    return picture if transparent else np.ascontiguousarray(picture[..., :3])


def mesh_view(mesh: Mesh, colours: UInt8[np.ndarray, "... 3"] | None = None, theme: Theme = "dark") -> View:
    """A View of one mesh; ``colours`` is (3,) for all, (n_faces, 3) per face record, or None for plain grey."""
    if colours is None:
        colours = np.array(rgb(tokens(theme)["shape"]), np.uint8)
    if colours.ndim == 1:
        per_triangle = np.broadcast_to(colours, (len(mesh.triangles), 3))
    elif len(colours) == mesh.n_faces:
        per_triangle = colours[mesh.face_of_triangle]
    else:
        raise ValueError(f"colours must be (3,) or ({mesh.n_faces}, 3), one per face record; got {colours.shape}")
    vertices = np.asarray(mesh.vertices, float)
    return View((MeshLayer("mesh", vertices, mesh.triangles, np.ascontiguousarray(per_triangle, np.uint8)),))


def thumbnail(
    mesh: Mesh, colours: UInt8[np.ndarray, "... 3"] | None = None, size: int | tuple[int, int] = 96,
    theme: Theme = "dark", *, transparent: bool = False, ground: tuple[int, int, int] | None = None,
) -> UInt8[np.ndarray, "h w c"]:  # fmt: skip
    """Picture of a mesh: (h, w, 3) uint8, or (h, w, 4) with ``transparent``.  See :func:`mesh_view` for ``colours``."""
    return take_picture(mesh_view(mesh, colours, theme), size, theme, transparent=transparent, ground=ground)


def point_thumbnail(
    points: Float[np.ndarray, "n 3"], colours: UInt8[np.ndarray, "n 3"], size: int | tuple[int, int] = 96,
    theme: Theme = "dark", *, dot: float = 2.0, transparent: bool = False,
) -> UInt8[np.ndarray, "h w c"]:  # fmt: skip
    """Picture of coloured points; rows that are not finite are left out."""
    there = np.isfinite(points).all(axis=1)
    layer = PointLayer("points", np.asarray(points[there], float), colours[there], dot)
    return take_picture(View((layer,), ground=False), size, theme, transparent=transparent)


def shape_picture(
    project: Any, name: str, size: int | tuple[int, int] = 96, theme: Theme = "dark", *,
    labels: Int[np.ndarray, " F"] | None = None, inks: UInt8[np.ndarray, "L 3"] | None = None,
    colour: tuple[int, int, int] | None = None, transparent: bool = False,
) -> UInt8[np.ndarray, "h w c"]:  # fmt: skip
    """Picture of the shape ``name`` of a project, from ``PROJECT/thumbs`` when it was taken before.

    Coloured by ``labels`` (part index per face record, -1 unpainted) in the parts' ``inks`` (None: of their place),
    else all in ``colour``, else grey.
    """
    width, height = (size, size) if isinstance(size, int) else size
    digest = hashlib.sha256()
    digest.update(repr((LOOK_VERSION, name, width, height, theme, colour, transparent)).encode())
    digest.update(repr(_shape_key(project, name)).encode())
    if labels is not None:
        inks = part_colours(int(labels.max(initial=-1)) + 1) if inks is None else inks
        digest.update(np.ascontiguousarray(labels, np.int32).tobytes() + np.asarray(inks, np.uint8).tobytes())
    file = Path(project.path) / "thumbs" / f"{digest.hexdigest()[:24]}.png"
    picture = _read(file, (height, width, 4 if transparent else 3))
    if picture is not None:
        return picture
    mesh = project.shapes[list(project.names).index(name)].mesh
    colours = None if colour is None else np.array(colour, np.uint8)
    if labels is not None:
        colours = label_colours(labels, inks)
    picture = thumbnail(mesh, colours, (width, height), theme, transparent=transparent)
    _write(file, picture)
    return picture


def _shape_key(project: Any, name: str) -> Any:
    """What changes when the shape is imported anew or turned."""
    records = getattr(project, "stage_records", None)
    record = records.get("import") if isinstance(records, dict) else None
    own = project.shape_record(name) if hasattr(project, "shape_record") else {}
    return (record.get("key") if isinstance(record, dict) else None, own.get("key"))


def _read(file: Path, shape: tuple[int, int, int]) -> np.ndarray | None:
    try:
        with Image.open(file) as image:
            picture = np.asarray(image.convert("RGBA" if shape[2] == 4 else "RGB"))
    except (OSError, ValueError):  # absent, or cut short by a crash: take it again
        return None
    return picture.copy() if picture.shape == shape else None


def _write(file: Path, picture: np.ndarray) -> None:
    """Write a PNG atomically; a project on a full or read-only disk just has no cache."""
    try:
        file.parent.mkdir(exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=file.parent, suffix=".part")
        with os.fdopen(handle, "wb") as stream:
            Image.fromarray(picture).save(stream, "PNG")
        os.replace(temporary, file)
    except OSError:
        return


def contact_sheet(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]], captions: Sequence[str] = (), columns: int | None = None,
    theme: Theme = "dark", gap: int = 8,
) -> UInt8[np.ndarray, "H W 3"]:  # fmt: skip
    """Pictures of one size side by side in ``columns``, each with its caption below: (H, W, 3)."""
    if not len(pictures):
        raise ValueError("pictures must hold at least one picture, got none")
    height, width = pictures[0].shape[:2]
    columns = columns or math.ceil(math.sqrt(len(pictures) * 1.5))
    rows = math.ceil(len(pictures) / columns)
    line = 18 if captions else 0
    colours = tokens(theme)
    sheet = Image.new("RGB", (columns * (width + gap) + gap, rows * (height + line + gap) + gap), rgb(colours["view"]))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(12)
    for i, picture in enumerate(pictures):
        r, c = divmod(i, columns)
        x, y = gap + c * (width + gap), gap + r * (height + line + gap)
        sheet.paste(Image.fromarray(picture), (x, y))
        if i < len(captions):
            words = captions[i]
            while len(words) > 1 and draw.textlength(words, font=font) > width:
                words = words[:-2] + "…"
            draw.text((x + width / 2, y + height + 2), words, rgb(colours["text_2"]), font, anchor="ma")
    return np.asarray(sheet).copy()
