"""Mirror planes of a shape: the best near-vertical one, and all good ones of a shape whose up is not known yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from shapeforge.collection._kernels_align import nearest_both_ways
from shapeforge.collection.align import thinned
from shapeforge.collection.directions import half_sphere

FAN = 36  # directions in plan, 5 degrees apart
REFINED = 4  # best candidates that are refined
STEEPEST = 0.25  # largest vertical component of the normal: about 14 degrees from vertical
KEPT_SHARE = 0.8  # of the pairs, while refining: a fifth of the surface may have no counterpart
ADVANTAGE = 0.8  # another plane must have an error this much smaller than the one across x: most families face z
MOST_PLANES = 5  # that are told of a shape whose up is not known
_N_REFLECTED, _N_AGAINST = 300, 2500
_SPHERE = half_sphere(150)  # directions in space, about 12 degrees apart
_FEW_REFLECTED, _FEW_AGAINST = 160, 320
_APART = np.cos(np.radians(14.0))  # candidates nearer than this lead to one plane
_SAME = np.cos(np.radians(6.0))


def symmetry_plane(points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " 3"], float, float]:
    """The mirror plane ``normal · x = offset`` of surface points (n, 3), near-vertical (y is up), and its error.

    ``normal`` (3,) has unit length, its largest component positive.  ``error`` is the mean distance, in the units of
    the points, from a mirrored point to the nearest point: for a perfect mirror the spacing of the points remains.
    Among planes that are about as good, the one across x wins (a square table has four).

    Candidates: x = 0, z = 0, the principal axes in plan and a fan of angles; the best are refined by iterated closest
    points.  Raises ValueError for fewer than 4 points or non-finite ones.
    """
    if len(points) < 4 or not np.isfinite(points).all():
        raise ValueError(f"points: wanted at least 4 finite points (n, 3), got {points.shape}; was the shape sampled?")
    against = thinned(points, _N_AGAINST).astype(np.float64)
    reflected = thinned(against, _N_REFLECTED)
    tree = cKDTree(against)
    middle = (against.min(axis=0) + against.max(axis=0)) / 2
    candidates = []
    for normal in _directions(against):
        # A lamp arm moves the mean, a screw the box: try both.
        for offset in (float(normal @ middle), float(normal @ against.mean(axis=0))):
            candidates.append((_error(tree, reflected, normal, offset), normal, offset))
    order = np.argsort([error for error, _, _ in candidates], kind="stable")
    # The plane across x (the first two candidates) always gets its chance.
    found = [_refined(tree, reflected, *candidates[i]) for i in dict.fromkeys([0, 1, *order[:REFINED]])]
    across = min(found[:2], key=lambda plane: plane[0])
    best = min(found, key=lambda plane: plane[0])
    error, normal, offset = best if best[0] < ADVANTAGE * across[0] else across
    if normal[np.abs(normal).argmax()] < 0:
        normal, offset = -normal, -offset
    return normal, float(offset), float(error)


def mirrored(
    points: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, " 3"], offset: float
) -> Float[np.ndarray, "n 3"]:
    """Points (n, 3) on the other side of the plane ``normal · x = offset`` (unit normal)."""
    return points - 2 * ((points @ normal) - offset)[:, None] * normal


def _directions(points: np.ndarray) -> list[np.ndarray]:
    """Horizontal unit normals to try; the first is x."""
    plan = points[:, [0, 2]] - points[:, [0, 2]].mean(axis=0)
    _, axes = np.linalg.eigh(plan.T @ plan)
    angles = np.arange(FAN) * np.pi / FAN
    fan = [np.array([np.cos(angle), 0.0, np.sin(angle)]) for angle in angles]
    return fan + [np.array([axis[0], 0.0, axis[1]]) for axis in axes.T]


def _error(tree: cKDTree, points: np.ndarray, normal: np.ndarray, offset: float) -> float:
    return float(tree.query(mirrored(points, normal, offset))[0].mean())


def _refined(
    tree: cKDTree, points: np.ndarray, error: float, normal: np.ndarray, offset: float
) -> tuple[float, np.ndarray, float]:
    """The plane after some rounds of closest points; each round is kept only if the error falls."""
    for _ in range(12):
        distance, near = tree.query(mirrored(points, normal, offset))
        kept = distance <= np.quantile(distance, KEPT_SHARE)
        better, through = _reflection(points[kept], tree.data[near[kept]], normal)
        if abs(better[1]) > STEEPEST:
            break
        lower = _error(tree, points, better, through)
        if lower >= error - 1e-7:
            break
        error, normal, offset = lower, better, through
    return error, normal, offset


def _reflection(x: np.ndarray, y: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, float]:
    """The mirror plane (normal (3,), offset) that takes points x (n, 3) nearest to y (n, 3).

    The normal is the eigenvector of least eigenvalue of the symmetric part of their cross-covariance, on the side of
    ``normal``; the plane passes half-way between the means.
    """
    middle_x, middle_y = x.mean(axis=0), y.mean(axis=0)
    cross = (x - middle_x).T @ (y - middle_y)
    _, vectors = np.linalg.eigh((cross + cross.T) / 2)
    better = vectors[:, 0] * np.sign(vectors[:, 0] @ normal or 1.0)
    return better, float(better @ (middle_x + middle_y) / 2)


@dataclass(frozen=True, eq=False)
class Mirror:
    """A mirror plane ``normal · x = offset``; ``error`` is the mean gap it leaves, above the spacing of the points."""

    normal: Float[np.ndarray, " 3"]
    offset: float
    error: float


class Reflections:
    """Some points of a shape against others of it: how well a mirror image falls onto the shape.

    Brute force in float32: a few hundred points need no tree.  Takes every other point (n, 3) for either side, so that
    the shape itself does not count as its own mirror image.
    """

    def __init__(self, points: Float[np.ndarray, "n 3"]) -> None:
        self.points = thinned(points[1::2], _FEW_REFLECTED)
        self.against = thinned(points[::2], _FEW_AGAINST)
        self._fixed = np.ascontiguousarray(self.against.T, np.float32)
        sizes = len(self.points), len(self.against)
        self._pairs = [np.empty(size, kind) for size in sizes for kind in (np.int32, np.float32)]
        self.spacing = float(np.sqrt(self.nearest(self.points)[1]).mean(dtype=np.float64))

    def nearest(self, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest of ``against`` for moved points (n, 3): index (n,) and squared distance (n,); valid until called."""
        nearest_both_ways(np.ascontiguousarray(moved.T, np.float32), self._fixed, *self._pairs)
        return self._pairs[0], self._pairs[1]

    def error(self, normal: np.ndarray, offset: float) -> float:
        """Mean gap between the mirror image and the shape, above the spacing of the points."""
        squared = self.nearest(mirrored(self.points, normal, offset))[1]
        return float(np.sqrt(squared).mean(dtype=np.float64)) - self.spacing

    def refined(self, normal: np.ndarray, offset: float) -> Mirror:
        """The plane after some rounds of closest points; each is kept only if the error falls."""
        error = self.error(normal, offset)
        for _ in range(10):
            near, squared = self.nearest(mirrored(self.points, normal, offset))
            kept = squared <= np.quantile(squared, KEPT_SHARE)
            better, through = _reflection(self.points[kept], self.against[near[kept]], normal)
            lower = self.error(better, through)
            if lower >= error - 1e-6:
                break
            normal, offset, error = better, through, lower
        return Mirror(normal, offset, error)


def mirror_planes(reflections: Reflections, hints: Float[np.ndarray, "h 3"]) -> list[Mirror]:
    """The ``MOST_PLANES`` best mirror planes in any direction, best first, from directions all round and the ``hints``.

    Planes start through the mean of the points; refining moves them.
    """
    middle = reflections.points.mean(axis=0)
    directions = np.concatenate([hints, _SPHERE])
    errors = np.array([reflections.error(normal, float(normal @ middle)) for normal in directions])
    picked = list(range(len(hints)))
    for i in np.argsort(errors, kind="stable"):
        if len(picked) == len(hints) + 8:
            break
        if all(abs(directions[i] @ directions[j]) < _APART for j in picked[len(hints) :]):
            picked.append(int(i))
    found = [reflections.refined(directions[i], float(directions[i] @ middle)) for i in dict.fromkeys(picked)]
    distinct: list[Mirror] = []
    for plane in sorted(found, key=lambda plane: plane.error):
        if all(abs(plane.normal @ other.normal) < _SAME for other in distinct):
            distinct.append(plane)
    return distinct[:MOST_PLANES]
