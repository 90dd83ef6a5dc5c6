"""Directions that a surface itself prefers, whatever axes its file has: those it faces, and those it can stand in."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

SAME_FRAME = 8.0  # degrees: frames nearer than this are one
COPLANAR = 2.0  # degrees between faces of the hull that are one support
SMALLEST_SUPPORT = 0.002  # of the hull's area: what is smaller carries nothing
MOST_FRAMES, MOST_SUPPORTS = 2, 10  # that are told of a shape
_ROUNDS = 25


def _axis_rotations() -> np.ndarray:
    signs = list(product((1.0, -1.0), repeat=3))
    turns = [np.diag(sign)[:, list(order)] for order in permutations(range(3)) for sign in signs]
    return np.array([turn for turn in turns if np.linalg.det(turn) > 0])


AXIS_ROTATIONS = _axis_rotations()
"""The 24 rotations (24, 3, 3) that take axes to axes; the first is the identity."""


def spread_rotations(count: int) -> Float[np.ndarray, "n 3 3"]:
    """``count`` rotations spread over all that there are, always the same (super-Fibonacci spirals, Alexa 2022)."""
    s = np.arange(count) + 0.5
    a, b = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    x, y, z, w = inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def half_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """``count`` unit vectors spread evenly over half of the sphere (a golden spiral)."""
    height = (np.arange(count) + 0.5) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1)


_STARTS = spread_rotations(14)


def angle_between(a: Float[np.ndarray, " 3"], b: Float[np.ndarray, " 3"]) -> float:
    """Degrees between two unit vectors."""
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(a - b) / 2))))


def turning_angle(rotation: Float[np.ndarray, "3 3"]) -> float:
    """Degrees by which a rotation (3, 3) turns."""
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(rotation - np.eye(3)) / np.sqrt(8)))))


def frame_angle(a: Float[np.ndarray, "3 3"], b: Float[np.ndarray, "3 3"]) -> float:
    """Degrees between two frames (rows are axes), whatever the order and the signs of their axes."""
    trace = np.einsum("ij,gij->g", a @ b.T, AXIS_ROTATIONS).max()
    return float(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))))


def facing_frames(
    normals: Float[np.ndarray, "n 3"], starts: Float[np.ndarray, "s 3 3"] | None = None
) -> list[tuple[Float[np.ndarray, "3 3"], float]]:
    """The two best frames (rows are axes) along which the surface faces, each with the share of it that does.

    From unit normals (n, 3) of points spread evenly over the area, of either sign.  Maximises the mean over the points
    of the sum over the axes of cos^8: what is nearly flat and square counts, what is round hardly does.  The maximum is
    found by repeated polar decomposition from rotations spread over all, and ``starts``.  Empty without normals.
    """
    if len(normals) == 0:
        return []
    frames = _STARTS if starts is None else np.concatenate([starts, _STARTS])
    for _ in range(_ROUNDS):
        cosine = normals @ frames.transpose(0, 2, 1)
        cubed = cosine * cosine * cosine
        left, _, right = np.linalg.svd((cubed * cubed * cosine).transpose(0, 2, 1) @ normals)
        left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
        before, frames = frames, left @ right
        if np.abs(frames - before).max() < 1e-4:
            break
    share = ((normals @ frames.transpose(0, 2, 1)) ** 8).sum(axis=2).mean(axis=1)
    found: list[tuple[np.ndarray, float]] = []
    for i in np.argsort(-share, kind="stable"):
        if all(frame_angle(frames[i], other) > SAME_FRAME for other, _ in found):
            found.append((frames[i], float(share[i])))
        if len(found) == MOST_FRAMES:
            break
    return found


def supports(hull: ConvexHull | None) -> list[tuple[Float[np.ndarray, " 3"], float]]:
    """Ways to lie on level ground: unit vectors (3,) that point up then, with the share of the hull's area below.

    Faces of the convex hull that are nearly coplanar count as one; largest first, at most ``MOST_SUPPORTS``.
    """
    if hull is None:
        return []
    a, b, c = (hull.points[hull.simplices[:, i]] for i in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    normals, total = hull.equations[:, :3], float(areas.sum())
    free = np.ones(len(areas), bool)
    found = []
    for i in np.argsort(-areas, kind="stable"):
        if areas[i] < SMALLEST_SUPPORT * total:
            break
        if free[i]:
            near = free & (normals @ normals[i] > np.cos(np.radians(COPLANAR)))
            free &= ~near
            outward = normals[near].T @ areas[near]
            found.append((-outward / np.linalg.norm(outward), float(areas[near].sum()) / total))
    return sorted(found, key=lambda support: -support[1])[:MOST_SUPPORTS]


def convex_hull(points: Float[np.ndarray, "n d"]) -> ConvexHull | None:
    """The convex hull, or None where the points (n, d) span nothing that has one."""
    if len(points) <= points.shape[1]:
        return None
    try:
        return ConvexHull(points)
    except QhullError:
        return None
