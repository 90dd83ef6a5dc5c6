"""Colours of the faces of OBJ files: the diffuse colours (Kd) of their material library."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

PLAIN = (160, 160, 160)
"""Of faces without a material, or whose material has no colour."""
_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
_STATEMENT = re.compile(rb"^[ \t]*(f|usemtl)[ \t]+([^\r\n]*)", re.MULTILINE)
_MATERIAL = re.compile(r"^\s*(newmtl|Kd)\s+(.*?)\s*$", re.MULTILINE)


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
    current = ""
    for word, rest in _MATERIAL.findall(file.read_text("utf-8", "replace")):
        if word == "newmtl":
            current = rest
            continue
        try:
            shares = [float(number) for number in rest.split()[:3]]
        except ValueError:
            continue  # "Kd spectral …" and the like
        if len(shares) == 3 and np.isfinite(shares).all():
            red, green, blue = (round(255 * min(max(share, 0.0), 1.0)) for share in shares)
            colours[current] = red, green, blue
    return colours
