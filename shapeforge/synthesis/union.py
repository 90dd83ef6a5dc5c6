"""All parts of a new mesh as one watertight solid, by the optional package manifold3d."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np

from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.closing import closed_solids
from shapeforge.synthesis.measures import open_edges
from shapeforge.synthesis.surfaces import as_mesh

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

    Parts that are not closed are made so first (see ``closing``): ``measures["closed"]`` tells the share of each such
    part's area on surfaces that had holes or no thickness.  Raises ValueError where manifold3d is not installed, and,
    naming the part, where a part cannot be made a solid.
    """
    modeller = solid_modeller()
    part_of, solids, mended = {}, [], {}
    for l in np.unique(shape.part):
        name = shape.part_names[l]
        found = closed_solids(shape.vertices, shape.triangles[shape.part == l])
        area = sum(one.area for one in found if one.mended)
        if area:
            mended[name] = area / sum(one.area for one in found)
        for one in found:
            solid = modeller.Manifold(
                modeller.Mesh(one.vertices.astype(np.float32), one.triangles.astype(np.uint32))
            ).as_original()  # fmt: skip
            if solid.status() != modeller.Error.NoError:
                raise ValueError(f"union: the part {name} cannot be closed (from {shape.sources[l]}); {REMEDY}")
            if not solid.is_empty():
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
    if mended:
        measures["closed"] = mended
    return replace(shape, vertices=vertices, triangles=triangles, part=part, measures=measures, colours=colours)
