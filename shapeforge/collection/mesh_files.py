"""Writing meshes whose triangles belong to named, coloured parts: GLB, PLY, OBJ, STL.  Every write is atomic."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

GREY = (160, 160, 160)
MOST_LOOKS, MOST_MATERIALS = 8, 64


def write_mesh(
    path: str | Path,
    vertices: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "N 3"],
    part: Int[np.ndarray, " N"],
    part_names: Sequence[str],
    colours: UInt8[np.ndarray, "L 3"],
    triangle_colours: UInt8[np.ndarray, "M 3"] | None = None,
) -> None:
    """Write a mesh; the ending of ``path`` (glb, ply, obj, stl) chooses the format.

    ``part`` (N,) is an index into ``part_names`` and ``colours``, or -1 (grey, "unlabelled").  GLB has one node per
    part; PLY colours on vertices and faces and an int face property ``part``; OBJ groups ``g part`` in the order of
    the triangles, with a .mtl beside it; STL the surface alone.  Vertices and the order of triangles are kept, except
    in GLB, where each node has the vertices of its part.  ``triangle_colours`` replace those of the parts; a part of
    several colours then has that many nodes in GLB, or (of more than MOST_LOOKS) one with colours at its vertices; OBJ
    keeps the MOST_MATERIALS colours of a part that tell most.
    """
    path = Path(path)
    writers = {".glb": _glb, ".ply": _ply, ".obj": _obj, ".stl": _stl}
    if path.suffix.lower() not in writers:
        raise ValueError(f"path: wanted an ending of {', '.join(writers)}, got {path.name!r}")
    if len(part) != len(triangles):
        raise ValueError(f"part: wanted one number per triangle ({len(triangles)}), got {len(part)}")
    if len(part_names) != len(colours):
        raise ValueError(f"colours: wanted one per part name ({len(part_names)}), got {len(colours)}")
    if len(part) and not -1 <= part.min() <= part.max() < len(part_names):
        raise ValueError(f"part: wanted -1..{len(part_names) - 1}, got {part.min()}..{part.max()}")
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
        raise ValueError(f"triangles: wanted vertices 0..{len(vertices) - 1}, got {triangles.min()}..{triangles.max()}")
    if triangle_colours is not None and len(triangle_colours) != len(triangles):
        raise ValueError(
            f"triangle_colours: wanted one per triangle ({len(triangles)}), got {len(triangle_colours)}"
        )  # fmt: skip
    names = [*part_names, "unlabelled"]  # index -1
    palette = np.vstack([np.asarray(colours, np.uint8).reshape(-1, 3), np.array([GREY], np.uint8)])
    painted = palette[part] if triangle_colours is None else triangle_colours
    writers[path.suffix.lower()](path, np.asarray(vertices, np.float64), triangles, part, names, painted)


def _looks(part: np.ndarray, colours: np.ndarray, words: Sequence[str]) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Which look each triangle (N,) has, and of each look the name and the colour (n, 3).

    Looks are the colours of a part, the first named as the part is, further ones with a number.
    """
    rows, look = np.unique(np.column_stack([part, colours]), axis=0, return_inverse=True)
    order = [int(index) - int(np.searchsorted(rows[:, 0], rows[index, 0])) for index in range(len(rows))]
    names = [words[row[0]] + (f" {n + 1}" if n else "") for row, n in zip(rows, order, strict=True)]
    return look.reshape(-1), names, rows[:, 1:].astype(np.uint8)


def _few_colours(part: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Colours (N, 3) with at most MOST_MATERIALS of them in each part, by median cut."""
    from PIL import Image

    colours = np.array(colours, np.uint8)
    for label in np.unique(part):
        own = part == label
        if len(np.unique(colours[own], axis=0)) > MOST_MATERIALS:
            cut = Image.fromarray(colours[own][None]).quantize(MOST_MATERIALS, Image.Quantize.MEDIANCUT)
            colours[own] = np.asarray(cut.convert("RGB"))[0]
    return colours


def write_atomically(path: Path, data: bytes) -> None:
    """Write ``data`` so that ``path`` is at any moment the old file or the new one, whole."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        # mkstemp makes files private; give it the permissions an ordinary file would have had
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _glb(path, vertices, triangles, part, names, colours) -> None:
    import trimesh

    scene, rows = trimesh.Scene(), np.unique(np.column_stack([part, colours]), axis=0)[:, 0]
    many = np.isin(part, [label for label in np.unique(rows) if np.count_nonzero(rows == label) > MOST_LOOKS])
    for label in np.unique(part[many]):
        own = part == label
        corners = np.column_stack([triangles[own].reshape(-1), np.repeat(colours[own], 3, axis=0)])
        used, local = np.unique(corners, axis=0, return_inverse=True)  # a vertex where colours meet has one for each
        shades = np.column_stack([used[:, 1:], np.full(len(used), 255)]).astype(np.uint8)
        mesh = trimesh.Trimesh(
            vertices[used[:, 0]], local.reshape(-1, 3), vertex_colors=shades, process=False
        )  # fmt: skip
        scene.add_geometry(mesh, node_name=names[label], geom_name=names[label])
    triangles, part, colours = triangles[~many], part[~many], colours[~many]
    look, words, shades = _looks(part, colours, names)
    for index, (name, shade) in enumerate(zip(words, shades, strict=True)):
        used, local = np.unique(triangles[look == index], return_inverse=True)
        material = trimesh.visual.material.PBRMaterial(
            name=name,
            baseColorFactor=[*shade.tolist(), 255],
            metallicFactor=0.0,
            roughnessFactor=0.8,
            doubleSided=True,
        )
        mesh = trimesh.Trimesh(vertices[used], local.reshape(-1, 3), process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    write_atomically(path, trimesh.exchange.gltf.export_glb(scene))


def _ply(path, vertices, triangles, part, names, colours) -> None:
    corner_colour = np.full((len(vertices), 3), GREY, np.uint8)
    corner_colour[triangles.reshape(-1)] = np.repeat(colours, 3, axis=0)  # a shared vertex: the last one wins
    vertex = np.empty(len(vertices), [("xyz", "<f8", 3), ("rgb", "u1", 3)])
    vertex["xyz"], vertex["rgb"] = vertices, corner_colour
    face = np.empty(len(triangles), [("n", "u1"), ("corners", "<i4", 3), ("rgb", "u1", 3), ("part", "<i4")])
    face["n"], face["corners"], face["rgb"], face["part"] = 3, triangles, colours, part
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment part {i} {name}" for i, name in enumerate(names[:-1])]
    header += [f"element vertex {len(vertex)}", *(f"property double {axis}" for axis in "xyz")]
    header += [f"property uchar {c}" for c in ("red", "green", "blue")]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices"]
    header += [f"property uchar {c}" for c in ("red", "green", "blue")] + ["property int part", "end_header", ""]
    write_atomically(path, "\n".join(header).encode() + vertex.tobytes() + face.tobytes())


def _obj(path, vertices, triangles, part, names, colours) -> None:
    words = ["_".join(name.split()) or f"part_{i}" for i, name in enumerate(names)]  # a group name has no blanks
    material = path.with_suffix(".mtl")
    look, looks, shades = _looks(part, _few_colours(part, colours), words)
    looks = ["_".join(name.split()) for name in looks]
    library = [
        f"newmtl {name}\nKd {' '.join(f'{c / 255:.4f}' for c in shade)}\n"
        for name, shade in zip(looks, shades, strict=True)
    ]  # fmt: skip
    lines = [f"mtllib {material.name}"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    starts = np.flatnonzero(np.diff(look, prepend=look[:1] + 1)) if len(look) else []
    for start, end in zip(starts, [*starts[1:], len(look)], strict=True):
        lines += [f"g {words[part[start]]}", f"usemtl {looks[look[start]]}"]
        lines += [f"f {a} {b} {c}" for a, b, c in (triangles[start:end] + 1).tolist()]
    write_atomically(material, "\n".join(library).encode())  # first: the .obj refers to it
    write_atomically(path, ("\n".join(lines) + "\n").encode())


def _stl(path, vertices, triangles, part, names, colours) -> None:
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facet = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    facet["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    facet["corners"] = corners
    write_atomically(path, b"shapeforge".ljust(80) + np.uint32(len(facet)).tobytes() + facet.tobytes())
