"""From scratch (§7): a new closed surface around a draw's points; no training mesh is used.

The denser, oriented cloud of a draw is smeared over a lattice, and one Poisson equation gives the field that is 1
inside and 0 outside (Kazhdan 2006): shells that meet or overlap become one.  What is too thin for the lattice, or for
the points that are there, is held open by balls that touch the surface from within.  The half-way surface of both is
the mesh.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import fft
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.ndimage import label as connected
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.isosurface import isosurface
from shapeforge.synthesis.measures import open_edges, symmetry_error
from shapeforge.synthesis.oriented import NEAR, THINNEST, Cloud, Orientations

LATTICE = 2_500_000
"""Points of the lattice, as near as may be ..."""
FINEST, COARSEST = 0.0035, 0.008
"""... with a step (diagonals) between these."""
MARGIN = 10
"""Steps of the lattice around the points: the far side of a periodic field must not be felt."""
SMEARED = 0.35
"""Points are smeared over so many spacings of the refined cloud, but no less than a step of the lattice."""
OPEN = 0.2
"""Field at a point from which on it has an inside: it is 1/2 on a closed shell and 0 on a lone sheet."""
HELD_OPEN = 0.6
"""A ball is put where the field has less than this at its middle."""
LEAST = 1.25
"""Radius of the smallest balls, in steps of the lattice: smaller ones would be blurred away."""
BLUR = 0.7
"""The field is blurred over so many steps of the lattice."""
FAIRINGS = 12
SMALLEST = 5e-3
"""Pieces with a smaller share of the volume are left out: crumbs."""


def synthesize_surface(
    points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], orientations: Orientations, *,
    cell: float | None = None, symmetric: bool = True,
) -> SynthesizedShape:  # fmt: skip
    """A new closed mesh for a draw, labelled by the nearest points; ``points`` in normal coordinates, NaN where absent.

    Details finer than the lattice's step ``cell`` (diagonals; by default as its size asks for) are lost.
    ``symmetric`` as in ``assemble.synthesize``.  Raises ValueError for points of another fit than the sources, and for
    a draw without points.
    """
    sources = orientations.sources
    if points.shape != (len(sources.part), 3) or exists.shape != (sources.n_parts,):
        raise ValueError(
            f"points, exists: wanted ({len(sources.part)}, 3) and ({sources.n_parts},), got {points.shape} and "
            f"{exists.shape}. Do the draw and the sources come from the same fit?"
        )
    points = np.where(exists[sources.part][:, None], np.asarray(points, float), np.nan)
    if symmetric:
        points = sources.mirror.made_symmetric(points, sources.part)
    cloud = orientations.cloud(points, exists)
    if len(cloud.points) < 4:
        raise ValueError("points: wanted a draw with points, got none. Does it have any part?")
    if cell is None:
        volume = float(np.prod(np.ptp(cloud.points, axis=0) + 2 * MARGIN * 0.004))
        cell = float(np.clip((volume / LATTICE) ** (1 / 3), FINEST, COARSEST))
    origin = cloud.points.min(axis=0) - MARGIN * cell
    shape = tuple((np.ceil((cloud.points.max(axis=0) - origin) / cell).astype(int) + MARGIN + 1).tolist())
    field = winding_field(cloud, origin, cell, shape)
    field = gaussian_filter(np.maximum(np.clip(field, 0, 1), _ball_field(cloud, field, origin, cell)), BLUR)
    steps, triangles = isosurface(_without_crumbs(field), 0.5)
    vertices = origin + cell * _fair(steps, triangles)
    nearest = cKDTree(cloud.points).query(vertices[triangles].mean(axis=1))[1]
    known = points[np.isfinite(points).all(axis=1)]
    plane = sources.mirror.normal, sources.mirror.place(points, sources.part)
    measures = {
        "symmetry_error": symmetry_error(vertices, plane),
        "distance_from_draw": float(cKDTree(vertices).query(known)[0].mean()),
        "open_edges": open_edges(triangles),
        "n_triangles": len(triangles),
    }
    return SynthesizedShape(
        vertices, triangles, cloud.part[nearest].astype(np.int32), sources.part_names, ("",) * sources.n_parts, measures
    )


def winding_field(
    cloud: Cloud, origin: Float[np.ndarray, " 3"], cell: float, shape: tuple[int, int, int]
) -> Float[np.ndarray, "X Y Z"]:
    """Smoothed winding number of the cloud on the lattice; what has no inside gets a back, THINNEST behind it."""
    area = np.pi * cloud.spacing**2 / NEAR
    smear = max(SMEARED * float(np.median(cloud.spacing)), cell)
    field = _winding(cloud.points, cloud.normals, area, origin, cell, shape, smear)
    sheet = map_coordinates(field, ((cloud.points - origin) / cell).T, order=1) < OPEN
    if sheet.any():
        back = cloud.points[sheet] - THINNEST * cloud.normals[sheet]
        field += _winding(back, -cloud.normals[sheet], area[sheet], origin, cell, shape, smear)
    return field


def _winding(
    points: np.ndarray, normals: np.ndarray, area: np.ndarray, origin: np.ndarray, cell: float,
    shape: tuple[int, int, int], smear: float,
) -> Float[np.ndarray, "X Y Z"]:  # fmt: skip
    """Solve the Poisson equation whose field's gradient is that of the normals, by Fourier transforms."""
    padded = tuple(fft.next_fast_len(n, real=True) for n in shape)
    low = np.floor((points - origin) / cell).astype(int)
    share = (points - origin) / cell - low
    strength = -normals * area[:, None] / cell**3
    waves = np.meshgrid(
        *(2 * np.pi * fft.fftfreq(n, cell) for n in padded[:2]), 2 * np.pi * fft.rfftfreq(padded[2], cell),
        indexing="ij", sparse=True,
    )  # fmt: skip
    total = np.zeros((*padded[:2], padded[2] // 2 + 1), complex)
    for axis in range(3):
        splat = np.zeros(padded[0] * padded[1] * padded[2])
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(np.array(corner), share, 1 - share), axis=1) * strength[:, axis]
            splat += np.bincount(np.ravel_multi_index(tuple((low + corner).T), padded), weight, len(splat))
        total += 1j * waves[axis] * fft.rfftn(splat.reshape(padded))
    square = waves[0] ** 2 + waves[1] ** 2 + waves[2] ** 2
    total *= np.exp(-0.5 * smear**2 * square)
    square[0, 0, 0] = np.inf  # the mean is free: far outside is 0
    field = fft.irfftn(-total / square, padded)[: shape[0], : shape[1], : shape[2]]
    faces = [np.take(field, i, axis=axis).ravel() for axis in range(3) for i in (0, -1)]
    return field - float(np.median(np.concatenate(faces)))


def _ball_field(
    cloud: Cloud, winding: Float[np.ndarray, "X Y Z"], origin: np.ndarray, cell: float
) -> Float[np.ndarray, "X Y Z"]:
    """1/2 on the surface of the balls, rising by 1/2 over two steps inwards; 0 at the same distance outside.

    Only of those balls whose middle ``winding`` does not have inside already.
    """
    missing = map_coordinates(winding, ((cloud.middles - origin) / cell).T, order=1) < HELD_OPEN
    radius, centres = np.maximum(cloud.radii[missing], LEAST * cell), cloud.middles[missing]
    field, steps = np.zeros(winding.shape), np.ceil(radius / cell).astype(int)
    for step in np.unique(steps):  # balls of about one size together
        rows = steps == step
        box = np.stack(np.meshgrid(*[np.arange(-step - 2, step + 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        box = box[np.linalg.norm(box, axis=1) <= step + 2.9]
        place = np.round((centres[rows] - origin) / cell).astype(int)[:, None] + box[None]
        away = np.linalg.norm(place * cell + origin - centres[rows][:, None], axis=2)
        value = 0.5 + (radius[rows][:, None] - away) / (4 * cell)
        inside = ((place >= 0) & (place < np.array(field.shape))).all(axis=2) & (value > 0)
        np.maximum.at(field, tuple(place[inside].T), np.minimum(value[inside], 1.0))
    return field


def _fair(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"]) -> Float[np.ndarray, "V 3"]:
    """The vertices without the lattice's steps and small bumps: smoothing that does not shrink (Taubin 1995)."""
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    joined = csr_array((np.ones(len(ends)), ends.T), shape=(len(vertices),) * 2)  # closed: every edge both ways
    degree = np.maximum(joined.sum(axis=1), 1)[:, None]
    for _ in range(FAIRINGS):
        for step in (0.5, -0.53):
            vertices = vertices + step * (joined @ vertices / degree - vertices)
    return vertices


def _without_crumbs(field: np.ndarray) -> Float[np.ndarray, "X Y Z"]:
    """The field without connected insides that hold less than SMALLEST of the whole inside."""
    piece, count = connected(field > 0.5)
    size = np.bincount(piece.ravel(), minlength=count + 1)
    size[0] = 0
    return np.where(((size < SMALLEST * size.sum()) & (size > 0))[piece], 0.0, field)
