"""Colours of faces: of OBJ materials (Kd, and what a texture is like on the whole), of vertices, of glTF materials."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int, Real, UInt8

PLAIN = (160, 160, 160)
"""Of faces without a material, or whose material has no colour."""
_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
_STATEMENT = re.compile(rb"^[ \t]*(f|usemtl)[ \t]+([^\r\n]*)", re.MULTILINE)
_MATERIAL = re.compile(r"^[ \t]*(newmtl|Kd|map_Kd)(?:[ \t]+(.*?))?[ \t\r]*$", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+([^\r\n#]*)", re.MULTILINE)
_WITHIN = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
"""Where in a triangle a texture is looked at (barycentric coordinates)."""


def obj_colours(path: Path, data: bytes, n_faces: int) -> UInt8[np.ndarray, "F 3"] | None:
    """Red, green, blue (0..255) of every face record of an OBJ text; None where its materials tell nothing.

    The library is looked for beside ``path`` only, under the name that the file gives it or else the file's own.
    """
    known = {}
    if b"usemtl" in data:
        known = _library(path, [name.strip().decode("utf-8", "replace") for name in _LIBRARY.findall(data)])
    if not known:
        return None
    names, material, of_face = {b"": 0}, 0, []
    for statement in _STATEMENT.finditer(data):
        word, rest = statement.groups()
        if word == b"f":
            of_face.append(material)
        else:
            material = names.setdefault(rest.strip(), len(names))
    found = [known.get(name.decode("utf-8", "replace")) for name in names]
    if len(of_face) != n_faces or not any(found[i] for i in set(of_face)):
        return None
    return np.array([colour or PLAIN for colour in found], np.uint8)[of_face]


def _library(path: Path, names: list[str]) -> dict[str, tuple[int, int, int]]:
    """Colours by name of material."""
    candidates = [path.with_name(Path(name).name) for name in names if Path(name).name]
    file = next((f for f in [*candidates, path.with_suffix(".mtl")] if f.is_file()), None)
    colours: dict[str, tuple[int, int, int]] = {}
    if file is None:
        return colours
    current, textures = "", {}
    for word, rest in _MATERIAL.findall(file.read_text("utf-8", "replace")):
        if word == "newmtl":
            current = rest
            continue
        if word == "map_Kd":
            textures[current] = mean_colour(file, rest)
            continue
        try:
            shares = [float(number) for number in rest.split()[:3]]
        except ValueError:
            continue  # "Kd spectral …" and the like
        if len(shares) == 3 and np.isfinite(shares).all():
            red, green, blue = (round(255 * min(max(share, 0.0), 1.0)) for share in shares)
            colours[current] = red, green, blue
    for name, shade in textures.items():
        if shade is not None:  # Kd darkens it, but for those who write none, or black, beside a texture
            own = colours.get(name, (255, 255, 255))
            share = [c / 255 for c in own] if any(own) else [1.0] * 3
            colours[name] = tuple(round(c * s) for c, s in zip(shade, share, strict=True))
    return colours


def mean_colour(library: Path, words: str) -> tuple[int, int, int] | None:
    """The mean colour of a texture that lies beside its material library; None where there is no such picture.

    ``words`` are those of the statement, options first.
    """
    from PIL import Image

    names = [Path(name.replace("\\", "/")).name for name in (words, *words.split()[-1:])]
    try:
        file = next((f for f in (library.with_name(name) for name in names if name) if f.is_file()), None)
        if file is None:
            return None
        with warnings.catch_warnings(action="error"), Image.open(file) as picture:
            red, green, blue = picture.convert("RGB").resize((1, 1), Image.Resampling.BOX).getpixel((0, 0))
    except Exception:  # a picture that cannot be found or read is no reason to refuse the mesh
        return None
    return red, green, blue


def obj_vertex_colours(data: bytes, n_vertices: int) -> UInt8[np.ndarray, "V 3"] | None:
    """Colours that follow the coordinates of the vertices of an OBJ text (v x y z r g b); None where there are none."""
    first = _VERTEX.search(data)
    if first is None or len(first.group(1).split()) != 6:
        return None
    rows = [row.split() for row in _VERTEX.findall(data)]
    if len(rows) != n_vertices or any(len(row) != 6 for row in rows):
        return None
    try:
        return as_colours(np.array([row[3:] for row in rows]).astype(float), "f8")
    except ValueError:
        return None


def as_colours(values: Real[np.ndarray, "n 3"], kind: str = "") -> UInt8[np.ndarray, "n 3"]:
    """Numbers of a file as red, green, blue: from 0 to 1 where they are real numbers, else to 255 (16 bits: 65535).

    ``kind`` is numpy's code; without one (text) they are real if none is above 1: nobody counts to 1 of 255.
    """
    values = np.nan_to_num(np.asarray(values, float), posinf=0.0, neginf=0.0)
    real = kind.startswith("f") or not kind
    if real and values.max(initial=0.0) <= 1.0:
        values = 255 * values
    elif kind in ("u2", "i2"):
        values = values / 257
    return np.round(np.clip(values, 0, 255)).astype(np.uint8)


def of_corners(
    colours: UInt8[np.ndarray, "V 3"], corners: Int[np.ndarray, " C"], counts: Int[np.ndarray, " F"]
) -> UInt8[np.ndarray, "F 3"]:
    """The mean colour of the corners of every face record (F, 3); PLAIN for one without corners."""
    record = np.repeat(np.arange(len(counts)), counts)
    sums = [np.bincount(record, colours[corners, k].astype(float), len(counts)) for k in range(3)]
    mean = np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None]
    return np.where((counts > 0)[:, None], np.round(mean), PLAIN).astype(np.uint8)


def gltf_colours(geometry: Any) -> UInt8[np.ndarray, "F 3"] | None:
    """Colours of the triangles of a geometry that trimesh read: of its vertices, its material's base colour and its
    texture, looked at in four places of each triangle.  None where it has nothing of these; transparency is dropped."""
    from trimesh.visual.color import uv_to_color

    visual, faces = geometry.visual, np.asarray(geometry.faces)
    if visual.kind == "vertex":
        return of_corners(np.asarray(visual.vertex_colors)[:, :3], faces.reshape(-1), np.full(len(faces), 3))
    if visual.kind != "texture" or visual.material is None:
        return None
    material = visual.material
    image, uv = _decoded(getattr(material, "baseColorTexture", None)), visual.uv
    shade = np.ones((len(faces), 3))
    if getattr(material, "baseColorFactor", None) is not None:
        shade *= np.asarray(material.main_color)[:3] / 255
    elif image is None:
        return None
    if image is not None and uv is not None and len(uv) == len(geometry.vertices):
        looked = [uv_to_color(np.einsum("c,ncd->nd", at, np.asarray(uv)[faces]), image)[:, :3]
                  for at in _WITHIN]  # fmt: skip
        shade *= np.mean(looked, axis=0) / 255
    return as_colours(shade, "f8")


def _decoded(image: Any) -> Any:
    """A picture as RGB; None without one, or where it is damaged, which shows only now: pictures are read on demand."""
    try:
        return None if image is None else image.convert("RGB")
    except (OSError, SyntaxError, ValueError):
        return None
