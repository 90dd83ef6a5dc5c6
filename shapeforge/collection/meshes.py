"""Meshes as their files have them: face ``k`` is the k-th face record (DESIGN "Files").

OBJ, OFF and PLY are read by our own record readers (``records``); STL, GLB and GLTF, which know triangles only, by
trimesh.  Writing meshes with coloured parts is in ``mesh_files``.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from shapeforge.collection import _kernels_polygons as kernels
from shapeforge.collection.counts import counted
from shapeforge.collection.materials import PLAIN, gltf_colours, obj_colours, obj_vertex_colours, of_corners
from shapeforge.collection.mesh_files import write_mesh
from shapeforge.collection.records import CUT_SHORT, EXPORT_AGAIN, MeshError, Records, read_obj, read_off, read_ply
from shapeforge.collection.shape import Mesh

__all__ = ["MeshError", "find_meshes", "read_mesh", "repair_notes", "too_little", "triangulate_records", "write_mesh"]

RECORD_READERS = {".obj": read_obj, ".off": read_off, ".ply": read_ply}
TRIANGLE_FORMATS = (".stl", ".glb", ".gltf")
MESH_ENDINGS = (*RECORD_READERS, *TRIANGLE_FORMATS)
# areas and their squares must stay inside binary64; a mesh this far from its own size has lost its detail to rounding
LARGEST, SMALLEST, FARTHEST = 1e50, 1e-50, 1e9
FEWEST = 4
"""Triangles of the least solid, a tetrahedron."""


def read_mesh(path: str | Path) -> Mesh:
    """The mesh of a file, in the file's own coordinates, units and axes.

    Raises ``MeshError`` (file, problem, remedy) where the file cannot be read or has no surface.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in MESH_ENDINGS:
        known = ", ".join(e[1:] for e in MESH_ENDINGS)
        raise MeshError(path, f"files ending in {ending or 'nothing'!r} are not read", f"Save it as one of {known}")
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(path, "there is no such file", "Check the path") from None
    except OSError as error:
        raise MeshError(path, f"it cannot be opened ({error.strerror})", "Check the path and its permissions") from None
    if not data.strip():
        raise MeshError(path, "the file is empty", CUT_SHORT)
    if ending in RECORD_READERS:
        records = RECORD_READERS[ending](path, data)
    else:
        records = _read_triangles(path, ending[1:], data)
    mesh = _checked(path, records)
    return replace(mesh, colours=_colours(path, data if ending == ".obj" else None, records))


def _colours(path: Path, text: bytes | None, records: Records) -> UInt8[np.ndarray, "F 3"] | None:
    """Colours of the face records: their own, else those of materials (of the ``text`` of an OBJ file), else the mean
    of their corners'; None where the file has none."""
    found, corners = records.face_colours, records.vertex_colours
    if text is not None:
        found, corners = obj_colours(path, text, len(records.counts)), obj_vertex_colours(text, len(records.vertices))
    if found is None and corners is not None:
        found = of_corners(corners, records.corners, records.counts)
    return found


def _checked(path: Path, records: Records) -> Mesh:
    """The triangulated mesh, or the reason why it is none."""
    vertices, corners, counts = records.vertices, records.corners, records.counts
    if len(counts) == 0:
        raise MeshError(path, "it has no faces (a point cloud?)", "Export it with its faces")
    if len(vertices) == 0:
        raise MeshError(path, "it has no vertices", EXPORT_AGAIN)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        bad = int(np.flatnonzero((corners < 0) | (corners >= len(vertices)))[0])
        face = int(np.searchsorted(np.cumsum(counts), bad, side="right")) + 1
        raise MeshError(path, f"face {face} uses a vertex that does not exist ({len(vertices)} are there)", CUT_SHORT)
    if not np.isfinite(vertices).all():
        row = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0]) + 1
        raise MeshError(path, f"vertex {row} has a coordinate that is not a finite number", EXPORT_AGAIN)
    triangles, face_of_triangle = triangulate_records(vertices, corners, counts)
    used = vertices[np.unique(triangles)] if len(triangles) else vertices[:0]
    extent = np.ptp(used, axis=0) if len(used) else np.zeros(3)
    longest = float(extent.max())
    diagonal = longest * float(np.linalg.norm(extent / longest)) if 0 < longest < LARGEST else longest
    if diagonal == 0:
        raise MeshError(path, "all of its faces shrink to a point or a line", EXPORT_AGAIN)
    if not SMALLEST < diagonal < LARGEST:
        raise MeshError(path, f"its size {diagonal:.3g} is beyond what can be computed with", "Rescale it")
    if np.abs(used).max() > FARTHEST * diagonal:
        remedy = "Move it to the origin before exporting"
        raise MeshError(path, "it lies so far from the origin that its coordinates are rounded away", remedy)
    mesh = Mesh(vertices, triangles, face_of_triangle, len(counts), str(path))
    # relative to the diagonal: rounding alone leaves about 1e-16
    if mesh.triangle_areas.sum() < 1e-13 * diagonal**2:
        raise MeshError(path, "all of its faces together have no area", EXPORT_AGAIN)
    return mesh


def triangulate_records(
    vertices: Float[np.ndarray, "V 3"], corners: Int[np.ndarray, " C"], counts: Int[np.ndarray, " F"]
) -> tuple[Int[np.ndarray, "N 3"], Int[np.ndarray, " N"]]:
    """Cut face records into triangles (N, 3); also the record of each triangle (N,), ascending.

    Record k has the next ``counts[k]`` of ``corners``.  Convex polygons become fans, others lose their ears in the
    plane of their Newell normal.  A triangle that names a vertex twice is left out, so a record may own none.
    """
    triangles, record = kernels.cut_polygons(
        np.ascontiguousarray(vertices, np.float64), corners.astype(np.int64), counts.astype(np.int64)
    )
    return triangles.astype(np.int32), record.astype(np.int32)


def _read_triangles(path: Path, kind: str, data: bytes) -> Records:
    """STL, GLB, GLTF: triangles in trimesh's order, the nodes of a scene one after the other, each in its place."""
    import trimesh

    try:
        # buffers and textures are looked for beside the file only: nothing is ever fetched over a network
        beside = trimesh.resolvers.FilePathResolver(str(path))
        try:
            scene = trimesh.load_scene(BytesIO(data), kind, beside, process=False)
        except Exception:  # a texture that is missing or damaged is no reason to refuse the mesh
            scene = trimesh.load_scene(BytesIO(data), kind, beside, process=False, skip_materials=True)
        vertices, triangles, total = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
        shades: list[np.ndarray | None] = []
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            geometry = scene.geometry[name]
            if isinstance(geometry, trimesh.Trimesh):
                vertices.append(geometry.vertices @ transform[:3, :3].T + transform[:3, 3])
                # a mirroring node would turn its faces inside out
                order = slice(None, None, -1 if np.linalg.det(transform[:3, :3]) < 0 else 1)
                triangles.append(np.asarray(geometry.faces, np.int64)[:, order] + total)
                total += len(geometry.vertices)
                shades.append(None if kind == "stl" else gltf_colours(geometry))
    except Exception as error:  # trimesh lets whatever its parsers meet escape
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise MeshError(path, f"it cannot be read as {kind} ({reason})", EXPORT_AGAIN) from error
    corners = np.concatenate(triangles)
    points = np.concatenate(vertices).astype(np.float64)
    if kind == "stl" and len(points) and np.isfinite(points).all():
        # STL repeats every corner; equal corners are one vertex
        points, back = np.unique(points, axis=0, return_inverse=True)
        corners = back.reshape(-1)[corners]
    colours = None
    if any(shade is not None for shade in shades):
        plain = [np.tile(np.uint8(PLAIN), (len(own), 1)) for own in triangles[1:]]
        colours = np.concatenate([own if own is not None else grey for own, grey in zip(shades, plain, strict=True)])
    return Records(points, corners.reshape(-1).astype(np.int64), np.full(len(corners), 3, np.int64), colours)


def repair_notes(mesh: Mesh) -> tuple[str, ...]:
    """What is odd about a mesh and what is done about it, a sentence each; nothing when all is well."""
    notes = []
    areas = mesh.face_areas
    flat = int(np.count_nonzero(areas <= 1e-14 * areas.sum()))
    if flat:
        notes.append(f"{counted(flat, 'face')} without area, ignored")
    corners = np.sort(mesh.triangles, axis=1)
    repeated = len(corners) - len(np.unique(corners, axis=0))
    if repeated:
        notes.append(f"{counted(repeated, 'triangle')} drawn twice, counted twice")
    return tuple(notes)


def too_little(mesh: Mesh) -> str:
    """Why a mesh is hardly a whole shape (fewer than FEWEST triangles, or all in one plane), in words; else ""."""
    used = mesh.triangles[mesh.triangle_areas > 0]
    if len(used) < FEWEST:
        return f"it has only {counted(len(used), 'triangle')}, too few for a shape"
    points = mesh.vertices[np.unique(used)]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return "all of its faces lie in one plane" if spread[2] < 1e-6 * spread[0] else ""


def find_meshes(paths: Iterable[str | Path]) -> list[tuple[str, Path]]:
    """(name, file) of every mesh file named or, recursively, in the folders named, sorted by name.

    A shape's name is its file's stem.  Where stems collide, those shapes are named by their path without its ending,
    relative to what all of ``paths`` have in common, ``/`` written ``__``; where even these collide (``a.obj`` beside
    ``a.ply``), with the ending.  Files named outright are kept whatever their ending, so that reading them reports it.
    Hidden files and the copies that projects keep (``meshes`` beside a ``project.json``) are passed over.
    Raises ``MeshError`` where a path does not exist or nothing is found.
    """
    asked = [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]
    for path in asked:
        if not path.exists():
            raise MeshError(path, "there is no such file or folder", "Check the path")
    files: dict[Path, Path] = {}  # by what they are, links followed: nothing twice
    for path in asked:
        inside = sorted(path.rglob("*")) if path.is_dir() else [path]
        copies = {file.parent / "meshes" for file in inside if file.name == "project.json"}
        for file in inside:
            hidden = any(part.startswith((".", "__MACOSX")) for part in file.relative_to(path).parts)
            hidden = hidden or not copies.isdisjoint(file.parents)
            if file == path or (file.suffix.lower() in MESH_ENDINGS and file.is_file() and not hidden):
                files.setdefault(file.resolve(), file)
    if not files:
        where = ", ".join(str(p) for p in asked) or "nothing"
        known = ", ".join(e[1:] for e in MESH_ENDINGS)
        first = asked[0] if asked else Path(".")
        raise MeshError(first, f"no mesh files in {where}", f"Endings that are read: {known}")
    shared = os.path.commonpath([os.path.abspath(p if p.is_dir() else p.parent) for p in asked])
    names = _distinct_names([Path(os.path.relpath(os.path.abspath(file), shared)) for file in files.values()])
    return sorted(zip(names, files.values(), strict=True), key=lambda pair: pair[0])


def _distinct_names(paths: list[Path]) -> list[str]:
    """A name for each of the different relative paths, as short as distinctness allows."""
    names = [path.stem for path in paths]
    for longer in (["__".join(path.with_suffix("").parts) for path in paths], ["__".join(p.parts) for p in paths]):
        uses = Counter(names)
        names = [long if uses[name] > 1 else name for name, long in zip(names, longer, strict=True)]
    return names
