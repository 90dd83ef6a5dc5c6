"""All parts of a new mesh as one watertight solid, by the optional package manifold3d, where the parts are closed."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np

from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.cleaning import components, neighbours
from shapeforge.synthesis.measures import open_edges
from shapeforge.synthesis.surfaces import as_mesh, weld

REMEDY = "the route `surface` makes closed meshes of any draw"


def solid_modeller() -> ModuleType:
    """The package manifold3d; ValueError that names the remedy where it is not installed."""
    try:
        import manifold3d
    except ImportError:
        raise ValueError(
            "union: wanted the package manifold3d, which is not installed. "
            f"Install it with `pip install 'shapeforge[union]'`, or do without: {REMEDY}"
        ) from None
    return manifold3d


def unite(shape: SynthesizedShape) -> SynthesizedShape:
    """The shape as one closed surface without anything inside; each triangle keeps the part that it comes from.

    Raises ValueError, naming the part, where a part is not closed, and where manifold3d is not installed.
    """
    modeller = solid_modeller()
    part_of, solids = {}, []
    for l in np.unique(shape.part):
        vertices, triangles = weld(shape.vertices, shape.triangles[shape.part == l])
        first, second, _ = neighbours(vertices, triangles)
        component = components(len(triangles), first, second)
        for one in range(int(component.max()) + 1):
            used, corners = np.unique(triangles[component == one], return_inverse=True)
            corners = _wound_outwards(vertices[used], corners.reshape(-1, 3))
            solid = modeller.Manifold(
                modeller.Mesh(vertices[used].astype(np.float32), corners.astype(np.uint32))
            ).as_original()  # fmt: skip
            if open_edges(corners) or solid.status() != modeller.Error.NoError or solid.is_empty():
                name = shape.part_names[l]
                raise ValueError(f"union: the part {name} is not a closed solid (from {shape.sources[l]}); {REMEDY}")
            part_of[solid.original_id()] = int(l)
            solids.append(solid)
    if not solids:
        return shape
    mesh = modeller.Manifold.batch_boolean(solids, modeller.OpType.Add).to_mesh()
    triangles = np.asarray(mesh.tri_verts, np.int32)
    run = np.searchsorted(np.asarray(mesh.run_index), 3 * np.arange(len(triangles)), side="right") - 1
    part = np.array([part_of[i] for i in np.asarray(mesh.run_original_id).tolist()], np.int32)[run]
    vertices = np.asarray(mesh.vert_properties, float)[:, :3]
    # Vertices are single precision, and repeated where parts meet: welded, the surface is closed.
    merged = np.arange(len(vertices))
    merged[np.asarray(mesh.merge_from_vert, np.int64)] = np.asarray(mesh.merge_to_vert, np.int64)
    used, corners = np.unique(merged[triangles], return_inverse=True)
    triangles = corners.reshape(-1, 3).astype(np.int32)
    vertices, colours = vertices[used], shape.colours
    if colours is not None:
        centres = vertices[triangles].mean(axis=1)
        colours = colours[closest_points(as_mesh(shape.vertices, shape.triangles), centres)[1]]
    measures = {**shape.measures, "n_triangles": len(triangles), "open_edges": open_edges(triangles)}
    return replace(shape, vertices=vertices, triangles=triangles, part=part, measures=measures, colours=colours)


def _wound_outwards(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles (N, 3) of one closed component, turned so that neighbours agree and the volume is positive.

    Files wind faces at random; what cannot be wound alike comes back as it can be.
    """
    triangles = triangles.copy()
    first, second, _ = neighbours(vertices, triangles)
    adjacent: list[list[int]] = [[] for _ in range(len(triangles))]
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        adjacent[a].append(b)
        adjacent[b].append(a)
    seen, waiting = np.zeros(len(triangles), bool), [0]
    seen[0] = True
    while waiting:
        here = waiting.pop()
        sides = {(int(triangles[here, i]), int(triangles[here, i - 2])) for i in range(3)}
        for other in adjacent[here]:
            if not seen[other]:
                seen[other] = True
                if any((int(triangles[other, i]), int(triangles[other, i - 2])) in sides for i in range(3)):
                    triangles[other] = triangles[other, ::-1]
                waiting.append(other)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return triangles if np.einsum("ij,ij->", a, np.cross(b, c)) >= 0 else triangles[:, ::-1]
