"""A denser cloud of a draw: points between its points, and at each the way out and the thickness behind it.

The way out and the thickness are learnt: every training shape has them at its corresponding points, and those of the
shapes whose part is most like the draw's go with the affine map from there to here.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.descriptors import shape_diameter
from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.retrieve import part_distances
from shapeforge.synthesis.sources import Sources

ASKED = 6
"""Training shapes that say how a part of a draw is turned and how thick it is."""
REFINEMENTS = 2
"""Each doubles the density of points along a line."""
NEAR = 5
"""A point's spacing is its distance to the point that is so many-th nearest on its side of its part."""
REACH = 1.3
"""Neighbours are within so many spacings ..."""
REACH_WITHIN = 1.8
"""... and balls within so many: a plate with few points has no holes."""
ALIKE = 0.2
"""Cosine of the normals of two points from which they lie on the same side of a part."""
SLIM = 0.85
"""A ball's size, as a share of the thickness that rays tell, of which many cross at a slant."""
THINNEST = 0.008
"""Least thickness (diagonals): sheets are given it."""
LARGEST_BALL = 0.03
"""Radius (diagonals) of the largest ball; what is thicker needs none."""
VOTERS = 20
"""Points around each that have a say in which side of it is inside."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (n, 3) with unit ``normals`` (n, 3) outwards, their ``part`` (n,) and ``spacing`` (n,), the distance to
    the NEAR-th nearest point of the same side and part; and balls within, that touch the surface: ``middles`` (m, 3)
    and ``radii`` (m,).  In diagonals."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    part: Int[np.ndarray, " n"]
    spacing: Float[np.ndarray, " n"]
    middles: Float[np.ndarray, "m 3"]
    radii: Float[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class Orientations:
    """The ways out and thicknesses at the corresponding points of the training shapes, found when first asked for."""

    sources: Sources
    _known: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def of_shape(self, index: int) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, " K"]]:
        """Normals (K, 3) and thickness (K,) of training shape ``index``; NaN at points that it lacks."""
        with self._lock:
            if index in self._known:
                return self._known[index]
        mesh, points = self.sources.get_shape(index).mesh, np.asarray(self.sources.positions[index], float)
        there = np.isfinite(points).all(axis=1)
        normals, thickness = np.full(points.shape, np.nan), np.full(len(points), np.nan)
        if there.any():
            on, triangle, _ = closest_points(mesh, points[there])
            count = min(VOTERS, int(there.sum()))
            near = cKDTree(on).query(on, k=count)[1].reshape(len(on), count)
            depth, outward = shape_diameter(mesh, on, mesh.triangle_normals[triangle], triangle, near.astype(np.int32))
            normals[there], thickness[there] = outward, depth
        with self._lock:
            self._known[index] = normals.astype(np.float32), thickness.astype(np.float32)
        return self._known[index]

    def cloud(
        self, points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], refinements: int = REFINEMENTS
    ) -> Cloud:
        """The points of a draw (NaN where absent) and those between them, oriented."""
        normals, thickness = np.full(points.shape, np.nan), np.full(len(points), np.nan)
        for l in np.flatnonzero(exists):
            self._ask(points, int(l), normals, thickness)
        there = np.isfinite(points).all(axis=1) & np.isfinite(thickness) & np.isfinite(normals).all(axis=1)
        p, n, part = points[there], normals[there], self.sources.part[there]
        # Where the shapes asked do not agree on the side, as on thin plates, the ball stays at the point.
        agreed = np.linalg.norm(n, axis=1)
        radii = np.clip(SLIM * thickness[there] / 2, THINNEST / 2, LARGEST_BALL)
        middles, owner = p - radii[:, None] * n, part
        p, n, part = p[agreed > 0], n[agreed > 0] / agreed[agreed > 0, None], part[agreed > 0]
        for _ in range(refinements):
            pairs = _half_way(p, n, part)
            p, n = between(p, n, pairs)
            part = np.concatenate([part, part[pairs[:, 0]]])
            pairs = _half_way(middles, None, owner)
            middles = np.concatenate([middles, middles[pairs].mean(axis=1)])
            radii = np.concatenate([radii, radii[pairs].mean(axis=1)])
            owner = np.concatenate([owner, owner[pairs[:, 0]]])
        return Cloud(p, n, part, _spacing(p, n, part)[0] if len(p) > 1 else np.zeros(len(p)), middles, radii)

    def _ask(self, points: np.ndarray, part: int, normals: np.ndarray, thickness: np.ndarray) -> None:
        """Fill in thickness and mean normals, the shorter the less they agree, of one part of a draw."""
        away = part_distances(points, self.sources, part)
        asked = [int(t) for t in np.argsort(away, kind="stable")[:ASKED] if np.isfinite(away[t])]
        rows = np.flatnonzero((self.sources.part == part) & np.isfinite(points).all(axis=1))
        turned, thick, voices = np.zeros((len(rows), 3)), np.zeros(len(rows)), np.zeros(len(rows))
        for t in asked:
            own_normals, own_thickness = self.of_shape(t)
            theirs = np.asarray(self.sources.positions[t, rows], float)
            both = np.isfinite(theirs).all(axis=1) & np.isfinite(own_thickness[rows])
            if not both.any():
                continue
            voice = 1.0 / max(float(away[t]), 1e-3)
            matrix = _affine(theirs[both], points[rows[both]])
            went = np.linalg.solve(matrix, own_normals[rows[both]].T.astype(float)).T  # the inverse transposed
            length = np.maximum(np.linalg.norm(went, axis=1, keepdims=True), 1e-12)
            turned[both] += voice * went / length
            thick[both] += voice * own_thickness[rows[both]] / length[:, 0]
            voices[both] += voice
        known = voices > 0
        normals[rows[known]] = turned[known] / voices[known, None]
        thickness[rows[known]] = thick[known] / voices[known]


def _affine(source: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Linear part M of the affine map of row vectors, q = p M + c, towards the identity where points do not tell."""
    p, q = source - source.mean(axis=0), target - target.mean(axis=0)
    ridge = (1e-2 * np.trace(p.T @ p) / 3 + 1e-12) * np.eye(3)
    matrix = np.linalg.solve(p.T @ p + ridge, p.T @ q + ridge)
    return matrix if np.linalg.det(matrix) > 0.05 else np.eye(3)


def between(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], pairs: Int[np.ndarray, "m 2"]
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3"]]:
    """The points and, after them, one for each pair: half-way, and as far out as the two tangent planes ask for.

    On a sphere the new points lie on it, up to the fourth power of the angle between the two.
    """
    (p, q), (n, m) = points[pairs].transpose(1, 0, 2), normals[pairs].transpose(1, 0, 2)
    middle = (p + q) / 2
    bulge = n * ((p - middle) * n).sum(axis=1, keepdims=True) + m * ((q - middle) * m).sum(axis=1, keepdims=True)
    normal = n + m
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.concatenate([points, middle + bulge / 4]), np.concatenate([normals, normal])


def _spacing(
    points: np.ndarray, normals: np.ndarray | None, part: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance (n,) to the NEAR-th nearest point of the same side and part; distances and rows (n, k) of all such.

    Without ``normals`` all sides are one.
    """
    count = min(5 * NEAR, len(points) - 1)
    distance, near = cKDTree(points).query(points, k=count + 1)
    distance, near = distance[:, 1:], near[:, 1:]
    same = part[near] == part[:, None]
    if normals is not None:
        same &= (normals[near] * normals[:, None]).sum(axis=2) >= ALIKE
    own = np.where(same, distance, np.inf)
    spacing = np.sort(own, axis=1)[:, min(NEAR, count) - 1]
    return np.where(np.isfinite(spacing), spacing, distance[:, min(NEAR, count) - 1]), own, near


def _half_way(points: np.ndarray, normals: np.ndarray | None, part: np.ndarray) -> Int[np.ndarray, "m 2"]:
    """Pairs of near points of one part and side, the nearest first, so chosen that their middles keep apart."""
    if len(points) < 2:
        return np.zeros((0, 2), np.int64)
    spacing, distance, near = _spacing(points, normals, part)
    row = np.broadcast_to(np.arange(len(points))[:, None], near.shape)
    reach = REACH if normals is not None else REACH_WITHIN
    chosen = (near > row) & (distance <= reach * np.minimum(spacing[:, None], spacing[near]))
    pairs = np.stack([row[chosen], near[chosen]], axis=1)
    pairs = pairs[np.argsort(distance[chosen], kind="stable")]
    if not len(pairs):
        return pairs
    middle, size = points[pairs].mean(axis=1), spacing[pairs].min(axis=1)
    clash = cKDTree(middle).query_pairs(0.35 * float(size.max()), output_type="ndarray")
    first, second = clash.T
    near_by = np.linalg.norm(middle[first] - middle[second], axis=1) < 0.35 * np.minimum(size[first], size[second])
    if normals is not None:
        side = normals[pairs].sum(axis=1)
        near_by &= (side[first] * side[second]).sum(axis=1) > 0
    clash = np.sort(clash[near_by], axis=1)
    kept = np.ones(len(pairs), bool)
    for first, second in clash[np.lexsort((clash[:, 1], clash[:, 0]))].tolist():
        if kept[first]:
            kept[second] = False
    return pairs[kept]
