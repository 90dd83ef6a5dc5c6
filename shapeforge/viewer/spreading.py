"""From a few strokes to a whole painting: how paint spreads over a shape, and a cut with short borders.

Paint spreads along the surface, over small gaps between pieces at a price, to the mirror image of where it was put, and
from piece to piece: a piece without paint is taken for what the pieces of its size and direction are that have some
(one slat for the others, one leg for three).  All lengths are in diagonals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.facecut import FaceGraph, cut_faces, face_graph
from shapeforge.collection.shape import Mesh
from shapeforge.viewer._kernels import spread
from shapeforge.viewer.brushes import FaceSurface, opposite_faces

NAT = 0.1  # diagonals: paint that far away is e times less probable
FARTHEST = 15.0  # nats: what is farther is as good as out of reach
GAP = 1.0  # what going over from one piece to another costs, besides the way
OTHER_PIECE = 0.5  # what being like a painted piece costs, besides the way and the difference
TWIN = 0.1  # what the mirror image of a stroke is worth less than the stroke
SHORT_BORDERS = 60.0  # thousandths of the root of the area, see `facecut`
SURE = 3.0  # nats between the best part and the second: such faces are not asked by the cut
ASKED = 4000  # faces the cut asks at most, the least sure ones, so that a stroke is answered at once

Plane = tuple[Float[np.ndarray, " 3"], float]


@dataclass(frozen=True, eq=False)
class Ground:
    """What completing needs to know of a shape, found when it is first asked for.

    ``mirror`` is normal and offset of the mirror plane (normal . x = offset), None without one.
    """

    mesh: Mesh
    surface: FaceSurface
    mirror: Plane | None = None

    @cached_property
    def faces(self) -> FaceGraph:
        """Which faces are adjacent, or nearly touch, and what a border between them costs."""
        return face_graph(self.mesh)

    @cached_property
    def ways(self) -> tuple[Int[np.ndarray, " G"], Int[np.ndarray, " E"], Float[np.ndarray, " E"]]:
        """The neighbours of face f, ``neighbour[start[f]:start[f + 1]]``, and how long the way to each is."""
        surface = self.surface
        row = np.repeat(np.arange(surface.n_faces), np.diff(surface.start))
        length = np.linalg.norm(surface.centres[row] - surface.middle, axis=1)
        length += np.linalg.norm(surface.centres[surface.neighbour] - surface.middle, axis=1)
        pairs = self.faces.pairs
        gaps = pairs[surface.piece[pairs[:, 0]] != surface.piece[pairs[:, 1]]]
        across = GAP + np.linalg.norm(surface.centres[gaps[:, 0]] - surface.centres[gaps[:, 1]], axis=1)
        row = np.concatenate([row, gaps[:, 0], gaps[:, 1]])
        column = np.concatenate([surface.neighbour, gaps[:, 1], gaps[:, 0]])
        order = np.argsort(row, kind="stable")
        start = np.searchsorted(row[order], np.arange(surface.n_faces + 1))
        return start, column[order], np.concatenate([length, across, across])[order]

    @cached_property
    def looks(self) -> Float[np.ndarray, "C 9"]:
        """Size and direction of every connected piece: equal for copies and mirror images of one another.

        The root of the second moments (its diagonal, and its other entries without sign), and the three sizes it has
        whichever way it is turned.
        """
        piece, count = self.surface.piece[self.mesh.face_of_triangle], int(self.surface.piece.max(initial=-1)) + 1
        corners, weight = np.asarray(self.mesh.vertices, float)[self.mesh.triangles], self.mesh.triangle_areas
        total = np.maximum(np.bincount(piece, weight, count), 1e-300)
        centres = corners.mean(axis=1)
        middle = np.stack([np.bincount(piece, weight * centres[:, i], count) for i in range(3)], axis=1)
        corners = corners - (middle / total[:, None])[piece][:, None]
        moments = np.zeros((count, 3, 3))
        for i, j in zip(*np.triu_indices(3), strict=True):
            one = np.bincount(piece, weight * (corners[:, :, i] * corners[:, :, j]).mean(axis=1), count) / total
            moments[:, i, j] = moments[:, j, i] = one
        sizes, axes = np.linalg.eigh(moments)
        sizes = np.sqrt(np.maximum(sizes, 0))
        root = (axes * sizes[:, None, :]) @ axes.transpose(0, 2, 1)
        aslant = np.sqrt(2) * np.abs(root[:, *np.triu_indices(3, 1)])
        return np.concatenate([root[:, [0, 1, 2], [0, 1, 2]], aslant, sizes], axis=1)

    @cached_property
    def opposite(self) -> Int[np.ndarray, " F"]:
        """The face across the mirror plane (F,); -1 where there is none."""
        if self.mirror is None:
            return np.full(self.surface.n_faces, -1)
        return opposite_faces(self.surface, *self.mirror)

    def away(self, painted: Int[np.ndarray, " n"], paint: Int[np.ndarray, " F"]) -> Float[np.ndarray, " F"]:
        """How far (F,) every face is from the faces ``painted`` with one part, of the whole ``paint`` (F,)."""
        surface = self.surface
        twins = np.flatnonzero(np.isin(self.opposite, painted))
        sources = np.concatenate([painted, twins])
        ahead = np.concatenate([np.zeros(len(painted)), np.full(len(twins), TWIN)])
        far = spread(*self.ways, sources, ahead, NAT * FARTHEST)
        bare = np.ones(len(self.looks), bool)
        bare[surface.piece[paint >= 0]] = False
        lost = np.flatnonzero(bare[surface.piece])
        if len(lost):
            like = cKDTree(self.looks[np.unique(surface.piece[painted])]).query(self.looks[bare])[0]
            unlike = np.zeros(len(bare))
            unlike[bare] = like
            way = cKDTree(surface.centres[sources]).query(surface.centres[lost])[0]
            far[lost] = np.minimum(far[lost], OTHER_PIECE + way + unlike[surface.piece[lost]])
        return far


def complete(ground: Ground, paint: Int[np.ndarray, " F"]) -> Int[np.ndarray, " F"]:
    """Parts (F,) of all faces from ``paint`` (F,), -1 where there is none.

    Painted faces keep their part; parts without a stroke are not given.  Raises ValueError when nothing is painted.
    """
    used = np.unique(paint[paint >= 0])
    if not len(used):
        raise ValueError("paint must hold at least one painted face, got none: paint a stroke on each part first")
    cost = np.stack([ground.away(np.flatnonzero(paint == part), paint) for part in used], axis=1) / NAT
    cost = np.minimum(cost, FARTHEST)
    painted = np.flatnonzero(paint >= 0)
    cost[painted] = 2 * FARTHEST
    cost[painted, np.searchsorted(used, paint[painted])] = 0.0
    labels = cut_faces(ground.mesh, cost, weight=SHORT_BORDERS, graph=ground.faces, sure=_sure(cost))
    result = used[labels].astype(np.int32)
    result[painted] = paint[painted]
    return result


def _sure(cost: Float[np.ndarray, "F L"]) -> float:
    """Nats from which on a face is not asked."""
    if cost.shape[1] == 1 or len(cost) <= ASKED:
        return SURE
    best = np.partition(cost, 1, axis=1)
    return min(SURE, float(np.partition(best[:, 1] - best[:, 0], ASKED)[ASKED]))
