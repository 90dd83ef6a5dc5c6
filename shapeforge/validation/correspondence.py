"""corr@r: how often a landmark is found on another shape through the template points (§6, the curve over distances)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import closest_points

RADII = (0.01, 0.025, 0.05, 0.075, 0.1, 0.15, 0.2, 0.25)


def landmark_errors(
    landmarks: Mapping[str, Mapping[str, np.ndarray]],
    points: Mapping[str, np.ndarray],
    mesh_of: Callable[[str], Mesh],
) -> Float[np.ndarray, " n"]:
    """Distance over the diagonal of the target for every landmark of every ordered pair of shapes; inf for a miss.

    A landmark on shape A goes to the nearest existing template point of A, to the same template point of B, onto B's
    surface.  ``landmarks[shape][landmark]`` (3,), ``points[shape]`` (K, 3) with NaN rows where absent, and the meshes
    share one coordinate system per shape, any unit.  Shapes without points or landmarks take no part.
    """
    names = [name for name in landmarks if name in points and len(landmarks[name])]
    nearest: dict[str, dict[str, int]] = {}
    for name in names:
        known = np.flatnonzero(np.isfinite(points[name]).all(axis=1))
        marks = list(landmarks[name])
        if len(known) == 0:
            nearest[name] = dict.fromkeys(marks, -1)
            continue
        places = np.array([np.asarray(landmarks[name][mark], float) for mark in marks])
        found = known[cKDTree(points[name][known]).query(places)[1]]
        nearest[name] = dict(zip(marks, found.tolist(), strict=True))
    errors = []
    for target in names:
        wanted = [
            (nearest[source][mark], np.asarray(landmarks[target][mark], float))
            for source in names
            if source != target
            for mark in landmarks[source]
            if mark in landmarks[target]
        ]
        if wanted:
            errors.append(_errors_on(mesh_of(target), np.asarray(points[target], float), wanted))
    return np.concatenate(errors) if errors else np.zeros(0)


def _errors_on(mesh: Mesh, points: np.ndarray, wanted: Sequence[tuple[int, np.ndarray]]) -> np.ndarray:
    """Distances over the mesh's diagonal from template points (put onto the surface) to true places; inf if absent."""
    index = np.array([k for k, _ in wanted])
    truth = np.array([place for _, place in wanted])
    errors = np.full(len(index), np.inf)
    there = (index >= 0) & np.isfinite(points[index]).all(axis=1)
    if there.any():
        unique, back = np.unique(index[there], return_inverse=True)
        surface = closest_points(mesh, points[unique])[0]
        errors[there] = np.linalg.norm(surface[back] - truth[there], axis=1) / diagonal(mesh)
    return errors


def diagonal(mesh: Mesh) -> float:
    """Diagonal of the bounding box of the surface (vertices that no triangle uses don't count)."""
    used = mesh.vertices[np.unique(mesh.triangles)]
    return float(np.linalg.norm(np.ptp(used, axis=0)))


def corr_curve(errors: Float[np.ndarray, " n"], radii: Sequence[float] = RADII) -> Float[np.ndarray, " r"]:
    """corr@r for every radius: the share of errors at most r, all landmarks of all pairs pooled; NaN without any."""
    if len(errors) == 0:
        return np.full(len(radii), np.nan)
    return (errors[None] <= np.asarray(radii)[:, None]).mean(axis=1)
