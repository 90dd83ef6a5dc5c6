"""A labelled mesh cut into parts, cleanly: labels tidied, borders smoothed, cuts closed, the unexplained left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import closest_points
from shapeforge.collection.symmetry import mirrored
from shapeforge.synthesis.capping import cap
from shapeforge.synthesis.cleaning import areas, clean_labels, components, neighbours
from shapeforge.synthesis.cutting import smooth_borders
from shapeforge.synthesis.measures import PartQuality, far_from, raggedness
from shapeforge.synthesis.mirror import FamilyMirror
from shapeforge.synthesis.surfaces import as_mesh, drop_bad, good_triangles, refine, weld

EDGE_LENGTH = 0.05
"""Longest edge (diagonals) left in a mesh before its parts are bent."""
TRIANGLE_LIMIT = 12_000
"""Edges are split only while they add at most so many triangles."""
UNEXPLAINED_PIECE = 0.6
"""A component of a part with more than this share of its vertices far from all points of the part is left out ..."""
MOST_LEFT_OUT = 0.4
"""... unless that takes more than this share of the part's area."""
MIRRORED = 0.02
"""A mirror image so near (diagonals) to the shape's surface lies on it ..."""
ELSEWHERE = 0.04
"""... and on other parts, if it is farther than this from its own part."""


@dataclass(frozen=True, eq=False)
class CutMesh:
    """A welded mesh whose triangles belong to parts; ``mended[l]`` as in ``PartQuality``.  In diagonals."""

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    label: Int[np.ndarray, " N"]
    mended: Float[np.ndarray, " L"]


def cut_mesh(
    mesh: Mesh, label: Int[np.ndarray, " M"], positions: Float[np.ndarray, "K 3"], part: Int[np.ndarray, " K"],
    n_parts: int, *, painted: bool = False, smooth: bool = True,
) -> CutMesh:  # fmt: skip
    """The mesh with a label per triangle, welded, refined, and cut along clean borders.

    ``positions`` (NaN where absent) are the corresponding points and ``part`` theirs; labels that were ``painted`` by
    hand are taken at their word; without ``smooth`` borders follow the edges of the faces.
    """
    vertices, triangles = weld(np.asarray(mesh.vertices, float), mesh.triangles)
    keep = good_triangles(vertices, triangles)
    triangles, label = triangles[keep], np.asarray(label)[keep]
    limit = len(triangles) + TRIANGLE_LIMIT
    vertices, triangles, parent = refine(vertices, triangles, length=EDGE_LENGTH, limit=limit)
    raw = label[parent]
    present = np.isfinite(positions).all(axis=1)
    clean = raw
    if not painted and len(triangles) and present.any():
        under = closest_points(as_mesh(vertices, triangles), positions[present])[1]
        points = np.zeros((len(triangles), n_parts), np.int64)
        np.add.at(points, (under, part[present]), 1)
        clean = clean_labels(vertices, triangles, raw, n_parts, points)
    area = areas(vertices, triangles)
    mended = np.zeros(n_parts)
    for l in range(n_parts):
        either = (raw == l) | (clean == l)
        mended[l] = area[either & (raw != clean)].sum() / max(float(area[either].sum()), 1e-300)
    if smooth:
        vertices, triangles, clean = smooth_borders(vertices, triangles, clean)
    return CutMesh(vertices, triangles, clean, mended)


def cut_part(cut: CutMesh, part: int, handles: Float[np.ndarray, "C 3"]) -> tuple[np.ndarray, np.ndarray, PartQuality]:
    """Vertices and triangles of one part with lids on its cuts, and its quality; ``handles`` are its points."""
    own = cut.label == part
    at = np.unique(cut.triangles[own])
    far = np.zeros(len(cut.vertices), bool)
    far[at] = far_from(handles, cut.vertices[at])
    kept = _explained(cut, own, far)
    lids, holes = cap(cut.vertices, cut.triangles, kept)
    vertices, triangles = drop_bad(cut.vertices, np.concatenate([cut.triangles[kept], lids]))
    misplaced = float(closest_points(as_mesh(vertices, triangles), handles)[2].mean())
    ragged = raggedness(as_mesh(cut.vertices, cut.triangles), cut.label, part)
    quality = PartQuality(
        int(own.sum()), ragged, float(far[at].mean()), misplaced, float(cut.mended[part]), holes
    )  # fmt: skip
    return vertices, triangles, quality


def one_sided_shares(
    cut: CutMesh, positions: Float[np.ndarray, "K 3"], part: Int[np.ndarray, " K"], mirror: FamilyMirror
) -> Float[np.ndarray, " L"]:
    """Share of every part's area whose mirror image lies on the shape, but on no part that it may lie on; (L,).

    A symmetric shape on which one armrest of two was labelled; a shape that is not symmetric there has none of it.
    ``positions`` (NaN where absent) are the corresponding points, which tell where the shape's mirror is.
    """
    found = np.zeros(len(cut.mended))
    if not len(cut.triangles):
        return found
    whole, area = as_mesh(cut.vertices, cut.triangles), areas(cut.vertices, cut.triangles)
    centres = cut.vertices[cut.triangles].mean(axis=1)
    images = mirrored(centres, mirror.normal, mirror.place(positions, part))
    _, under, away = closest_points(whole, images)
    for l in np.unique(cut.label[cut.label >= 0]):
        allowed = [l, *(other for pair in mirror.parts if l in pair for other in pair)]
        rows = np.flatnonzero((cut.label == l) & (away < MIRRORED) & ~np.isin(cut.label[under], allowed))
        own = as_mesh(cut.vertices, cut.triangles[np.isin(cut.label, allowed)])
        rows = rows[closest_points(own, images[rows])[2] > ELSEWHERE] if len(rows) else rows
        found[l] = area[rows].sum() / max(float(area[cut.label == l].sum()), 1e-300)
    return found


def _explained(cut: CutMesh, own: np.ndarray, far: np.ndarray) -> np.ndarray:
    """The part's triangles without components that none of its points is near: arms, say, of a shape without arms."""
    rows = np.flatnonzero(own)
    first, second, _ = neighbours(cut.vertices, cut.triangles[rows])
    component = components(len(rows), first, second)
    area = areas(cut.vertices, cut.triangles[rows])
    share = np.bincount(component, far[cut.triangles[rows]].mean(axis=1) * area) / np.maximum(
        np.bincount(component, area), 1e-300
    )
    out = share[component] > UNEXPLAINED_PIECE
    if area[out].sum() > MOST_LEFT_OUT * area.sum():
        return own
    kept = own.copy()
    kept[rows[out]] = False
    return kept
