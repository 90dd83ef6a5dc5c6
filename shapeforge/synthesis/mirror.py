"""The family's mirror plane, found on its corresponding points, and draws made as symmetric as the family is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.collection.symmetry import mirrored, symmetry_plane

MOST_SHAPES = 24
"""Shapes that are asked, evenly chosen."""
SYMMETRIC = 0.02
"""A part is symmetric if on the median shape its points lie so near (diagonals) to their partners' mirror images."""
ALIKE = 0.9
"""Cosine of the normals of two planes that speak for one direction."""
ON_PLANE = 0.02
"""A point so near (diagonals) to the plane is on it."""
USUALLY, FEWEST_SHAPES = 0.75, 3
"""A point is always on one side if it is OFF the plane there on at least this share, and number, of the shapes."""
OPPOSITE, UNLIKE = 0.1, 0.01
"""A held point so near (diagonals) to another's twin speaks for it; so far apart two such are not held alike."""
BEND, STEEP = 0.1, 0.5
"""Width (diagonals) of a bend, wider where it moves a point farther: by at most this share of its width."""
BOX, OFF = 0.06, 0.05
"""Boxes of opposite parts agree so far once mirrored, and their middles are so far off the plane (diagonals)."""


@dataclass(frozen=True, eq=False)
class Bend:
    """Moves points near ``centres`` (n, 3): by a sum of bells of one ``width`` there, as high as ``heights`` (n, 3)."""

    centres: Float[np.ndarray, "n 3"]
    heights: Float[np.ndarray, "n 3"]
    width: float

    @classmethod
    def through(cls, centres: Float[np.ndarray, "n 3"], ways: Float[np.ndarray, "n 3"]) -> Bend:
        """The one that moves the centres by these ``ways`` (n, 3), wide enough to fold nothing."""
        width = max(BEND, float(np.linalg.norm(ways, axis=1).max()) / STEEP)
        bells = _bells(centres, centres, width) + 1e-3 * np.eye(len(centres))  # two in one place may disagree
        return cls(centres, np.linalg.solve(bells, ways), width)

    def moved(self, points: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
        """The points (K, 3; NaN where absent) after it."""
        return points + _bells(points, self.centres, self.width) @ self.heights


def _bells(points: np.ndarray, centres: np.ndarray, width: float) -> np.ndarray:
    return np.exp(-(((points[:, None] - centres) / width) ** 2).sum(axis=2) / 2)


@dataclass(frozen=True, eq=False)
class FamilyMirror:
    """The plane's unit ``normal`` (one direction for the family, a place for each shape), and what is opposite to what.

    ``parts`` are pairs of parts that are each other's mirror image (left and right wing as two parts).  ``partner``
    (K,) is the point whose mirror image is nearest over the family, ``shift`` (K, 3) the way from that image to the
    point, which is there because points are not sampled symmetrically (diagonals); ``symmetric`` (L,) tells the parts
    that the family has symmetric; ``error`` (L,) how far they are from it on the median shape.  ``side`` (K,) is the
    sign of a point's place along the normal, from the plane, where the family has it on one side; else 0.
    """

    normal: Float[np.ndarray, " 3"]
    parts: tuple[tuple[int, int], ...]
    partner: Int[np.ndarray, " K"]
    shift: Float[np.ndarray, "K 3"]
    symmetric: Bool[np.ndarray, " L"]
    error: Float[np.ndarray, " L"]
    side: Int[np.ndarray, " K"]

    def place(self, points: Float[np.ndarray, "K 3"], part: Int[np.ndarray, " K"]) -> float:
        """Where the plane of a shape or draw lies along the normal (diagonals): half-way between opposite points."""
        there = np.isfinite(points).all(axis=1)
        along = points @ self.normal
        paired = there & there[self.partner] & self.symmetric[part]
        if not paired.any():
            return float(along[there].min() + along[there].max()) / 2 if there.any() else 0.0
        return float(np.median((along + along[self.partner] - self.shift @ self.normal)[paired])) / 2

    def made_symmetric(
        self,
        points: Float[np.ndarray, "K 3"],
        part: Int[np.ndarray, " K"],
        wanted: Bool[np.ndarray, " L"] | None = None,
    ) -> np.ndarray:
        """The draw (K, 3) half-way to its mirror image, in the parts that the family has symmetric.

        A part that would have to move more than SYMMETRIC for it is not as on most shapes, and stays: twin fins in a
        family of single ones.  So does one that is not ``wanted`` symmetric (L,).
        """
        points = self.on_both_sides(points, part)
        there = np.isfinite(points).all(axis=1)
        paired = there & there[self.partner] & self.symmetric[part]
        image = mirrored(points, self.normal, self.place(points, part))[self.partner] + self.shift
        way = np.where(paired[:, None], (image - points) / 2, 0.0)
        n_parts = len(self.symmetric)
        length = np.bincount(part, np.linalg.norm(way, axis=1), n_parts) / np.maximum(
            np.bincount(part, paired, n_parts), 1
        )
        moved = length <= SYMMETRIC if wanted is None else (length <= SYMMETRIC) & wanted
        return points + np.where(moved[part][:, None], way, 0.0)

    def with_twins(
        self, held: Float[np.ndarray, "K 3"], points: Float[np.ndarray, "K 3"], part: Int[np.ndarray, " K"]
    ) -> Float[np.ndarray, "K 3"]:
        """Where points are held (K, 3; NaN where free), and their partners in the mirror image of that.

        Of a shape whose ``points`` are these.  What is pulled on one side only, the symmetry would halve.  A point on
        the plane has no partner: it is held where its mirror image is, too.  Where the partner, or a point of its part
        next to it, is held as well, both stay as they are, and so do points of parts that are not symmetric.
        """
        found, place = np.array(held, float), self.place(points, part)
        for k in np.flatnonzero(np.isfinite(held).all(axis=1) & self.symmetric[part]).tolist():
            twin = self.partner[k]
            if twin == k or abs(points[k] @ self.normal - place) < ON_PLANE:
                found[k] -= (found[k] @ self.normal - place) * self.normal
            elif np.isfinite(points[twin]).all() and not len(self._opposite(k, held, points, part)):
                found[twin] = mirrored((held[k] - self.shift[k])[None], self.normal, place)[0]
        return found

    def bend_apart(
        self, held: Float[np.ndarray, "K 3"], points: Float[np.ndarray, "K 3"], reached: Float[np.ndarray, "K 3"],
        part: Int[np.ndarray, " K"],
    ) -> Bend | None:  # fmt: skip
        """What brings points that are held (NaN where free) another way on one side than on the other to their places.

        Of a shape that had these ``points`` and has ``reached`` others following them: what the family has symmetric
        meets both half-way, so they are bent to where they are held.  None where nothing is held so.
        """
        way, apart = held - points, set()
        for k in np.flatnonzero(np.isfinite(way).all(axis=1) & self.symmetric[part]).tolist():
            for other in self._opposite(k, held, points, part)[:1].tolist():
                if np.linalg.norm(way[k] - self._image(way[other])) > UNLIKE:
                    apart |= {k, other}
        at = sorted(apart)
        return Bend.through(reached[at], (held - reached)[at]) if at else None

    def _image(self, way: np.ndarray) -> np.ndarray:
        return way - 2 * (way @ self.normal) * self.normal

    def _opposite(self, k: int, held: np.ndarray, points: np.ndarray, part: np.ndarray) -> Int[np.ndarray, " n"]:
        """Points held at or about the partner of point k, the nearest first: of its part, on its side of the plane."""
        twin = self.partner[k]
        along = (points - points[twin]) @ self.normal
        beyond = along * along[k] < along[k] ** 2 / 2  # nearer to the partner's side than to that of k
        away = np.linalg.norm(points - points[twin], axis=1)
        found = np.flatnonzero(np.isfinite(held).all(axis=1) & (part == part[twin]) & (away < OPPOSITE) & beyond)
        return found[np.argsort(away[found], kind="stable")]

    def on_both_sides(self, points: Float[np.ndarray, "K 3"], part: Int[np.ndarray, " K"]) -> np.ndarray:
        """The draw (K, 3), where a part that the family has on both sides is not left on one of them.

        Fits find one armrest where two are hard to tell from the rest, and draws take that over: what should be on the
        other side is put there, as the mirror image of where it is.
        """
        points, there = np.array(points), np.isfinite(points).all(axis=1)
        for l in range(len(self.symmetric)):
            here = [there & (part == l) & (self.side == sign) for sign in (-1, 1)]
            if not all(side.any() for side in here):
                continue
            others = np.where((part == l)[:, None], np.nan, points)
            place = self.place(others if np.isfinite(others).any() else points, part)
            wrong = (points @ self.normal - place) * self.side < 0
            for side, other in (here, here[::-1]):
                if wrong[side].mean() >= USUALLY and wrong[other].mean() <= 1 - USUALLY:
                    points[side] = mirrored(points[side], self.normal, place)
        return points


def find_mirror(
    positions: Float[np.ndarray, "T K 3"], exists: Bool[np.ndarray, "T L"], part: Int[np.ndarray, " K"]
) -> FamilyMirror:
    """The mirror of a family from corresponding points (NaN where absent).

    Its direction is the one that most shapes' own planes agree on; a point's partner is of the same part, or of that
    part's mirror image.
    """
    rows = np.unique(np.linspace(0, len(positions) - 1, min(MOST_SHAPES, len(positions))).astype(int))
    some, n_parts = np.asarray(positions[rows], float), exists.shape[1]
    there = np.isfinite(some).all(axis=2) & exists[rows][:, part]
    rows = there.sum(axis=1) >= 4
    some, there = some[rows], there[rows]
    if not len(some):
        nobody = np.arange(len(part)), np.zeros((len(part), 3)), np.zeros(n_parts, bool), np.full(n_parts, np.inf)
        return FamilyMirror(np.array([1.0, 0.0, 0.0]), (), *nobody, np.zeros(len(part), int))
    normal = _common_normal(np.array([symmetry_plane(p[t])[0] for p, t in zip(some, there, strict=True)]))
    pairs = _opposite_parts(some, there, part, n_parts, normal)
    along = np.where(there, some @ normal, np.nan)
    middle = (np.nanmin(along, axis=1) + np.nanmax(along, axis=1)) / 2
    for _ in range(2):  # the middle of the box first, then that of the pairs
        images = some - 2 * (along - middle[:, None])[..., None] * normal
        partner = _nearest_images(some, images, there, part, pairs, n_parts)
        both = there & there[:, partner]
        half = np.where(both, (along + along[:, partner]) / 2, np.nan)
        middle = np.array([np.nanmedian(h) if b.any() else m for h, b, m in zip(half, both, middle, strict=True)])
    images = some - 2 * (along - middle[:, None])[..., None] * normal
    away = np.where(both[..., None], some - images[:, partner], 0.0)
    shift = away.sum(axis=0) / np.maximum(both.sum(axis=0), 1)[:, None]
    miss = np.where(both, np.linalg.norm(away - shift, axis=2), np.nan)
    error = np.full(n_parts, np.inf)
    for l in range(n_parts):
        means = [float(m[b].mean()) for m, b in zip(miss[:, part == l], both[:, part == l], strict=True) if b.any()]
        error[l] = np.median(means) if means else np.inf
    side = _sides(np.where(there, along - middle[:, None], np.nan))
    return FamilyMirror(normal, tuple(pairs), partner, shift, error <= SYMMETRIC, error, side)


def _sides(along: Float[np.ndarray, "T K"]) -> Int[np.ndarray, " K"]:
    """The side (-1, 1) that points are on, by their distances from the plane (NaN where absent); 0 where it varies."""
    known = np.isfinite(along).sum(axis=0)
    left, right = ((sign * along > OFF).sum(axis=0) >= USUALLY * np.maximum(known, 1) for sign in (-1, 1))
    return np.where(known >= FEWEST_SHAPES, right.astype(int) - left.astype(int), 0)


def _common_normal(normals: np.ndarray) -> Float[np.ndarray, " 3"]:
    """The mean of those of the unit normals (T, 3) that agree with the one with which most do."""
    agree = np.abs(normals @ normals.T) >= ALIKE
    leader = int(agree.sum(axis=1).argmax())
    group = normals[agree[leader]] * np.sign(normals[agree[leader]] @ normals[leader])[:, None]
    return group.mean(axis=0) / np.linalg.norm(group.mean(axis=0))


def _opposite_parts(
    points: np.ndarray, there: np.ndarray, part: np.ndarray, n_parts: int, normal: np.ndarray
) -> list[tuple[int, int]]:
    """Pairs of parts whose boxes are mirror images of each other: within BOX on the median shape, and off the plane."""
    across = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    turned = np.where(there[..., None], points @ np.stack([normal, across, np.cross(normal, across)], axis=1), np.nan)
    low, high = np.full((2, len(points), n_parts, 3), np.nan)
    for l in range(n_parts):
        rows = there[:, part == l].any(axis=1)
        if not rows.any():
            continue
        own = turned[rows][:, part == l]
        low[rows, l], high[rows, l] = np.nanmin(own, axis=1), np.nanmax(own, axis=1)
    middle = (np.nanmin(low[..., 0], axis=1) + np.nanmax(high[..., 0], axis=1)) / 2
    low[..., 0] -= middle[:, None]
    high[..., 0] -= middle[:, None]
    pairs = []
    for l in range(n_parts):
        for other in range(l + 1, n_parts):
            both = np.isfinite(low[:, l, 0]) & np.isfinite(low[:, other, 0])
            if both.sum() < max(1, 0.25 * len(points)):
                continue
            image = low[both, l].copy(), high[both, l].copy()
            image[0][:, 0], image[1][:, 0] = -high[both, l, 0], -low[both, l, 0]
            error = np.abs(image[0] - low[both, other]) + np.abs(image[1] - high[both, other])
            off = np.abs(low[both, l, 0] + high[both, l, 0]) / 2
            if np.median(error.max(axis=1)) < BOX and np.median(off) > OFF:
                pairs.append((l, other))
    return pairs


def _nearest_images(
    points: np.ndarray, images: np.ndarray, there: np.ndarray, part: np.ndarray, pairs: list[tuple[int, int]],
    n_parts: int,
) -> Int[np.ndarray, " K"]:  # fmt: skip
    """For each point the one, of its part or that part's mirror image, whose image is nearest on average."""
    found = np.arange(points.shape[1])
    for l in range(n_parts):
        allowed = [l, *(b for a, b in pairs if a == l), *(a for a, b in pairs if b == l)]
        own, other = np.flatnonzero(part == l), np.flatnonzero(np.isin(part, allowed))
        if not len(own):
            continue
        # The sums over the shapes of |p - q|², where both are there, are products of matrices.
        here, yonder = there[:, own].astype(float), there[:, other].astype(float)
        p, q = (np.where(there[:, at, None], x[:, at], 0.0) for at, x in ((own, points), (other, images)))
        total = (p**2).sum(axis=2).T @ yonder + here.T @ (q**2).sum(axis=2)
        total -= 2 * np.tensordot(p, q, axes=([0, 2], [0, 2]))
        seen = here.T @ yonder
        often = seen >= 0.5 * np.maximum(seen.max(axis=1, keepdims=True), 1)  # few shapes say little
        found[own] = other[np.where(often, total / np.maximum(seen, 1), np.inf).argmin(axis=1)]
    return found
