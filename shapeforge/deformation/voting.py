"""Shapes vote on proposed parts: a point goes to the part that like points of the *other* shapes belong to.

That mends pieces that were cut badly.  Points are alike that lie in the same place, face as much upwards or sideways,
are as thick and as far from everything, see as much of what is above, below and around them, and are of pieces as long:
a table's top sees the sky, a shelf does not, and a rail is no shelf.  Which way sideways a point faces says nothing: a
leg has sides all around.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.spatial import cKDTree

from shapeforge.collection.align import Alignment, thinned
from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Shape
from shapeforge.deformation.pieces import placed

ROUNDS = 6  # of voting, at most; it ends where nothing changes
VOTES = 30
VOTERS = 12_000  # points of all shapes that vote
VOTED, ALL_VOTED = 1000, 300_000  # points of a shape, and about as many of all, that are voted on
FEWEST_VOTED = 200
REACH = 0.12  # diagonals that count as much as tipping the normal by a right angle
THICK, INNER = 1.4, 0.5  # how much the shape diameter counts, and the average geodesic distance
SEEN = 2.4, 1.6, 1.6  # how much it counts to see all rather than nothing of what is above, below and around
LONG = 0.5  # how much it counts to be of a piece that is a bar and not round or square (``piece_looks``)
# What a point hears: like points' votes on itself, on its neighbours, on its whole piece, and what it was before; on a
# patch, whose bounds are a guess, and on a component, whose bounds the modeller drew.
PATCH_HEARS, COMPONENT_HEARS = (0.2, 0.2, 0.6, 0.0), (0.1, 0.1, 0.8, 0.3)
HALF, TOGETHER = 0.5, 0.8  # of the shape: a smaller component that was cut speaks for its pieces, with this share
LIFT = 2e-3  # diagonals off its point where a ray starts, so that it doesn't meet the surface it leaves
TILT = 0.46  # radians by which the slanting rays of a side leave the vertical


def exposure(shape: Shape) -> Float32[np.ndarray, "P 3"]:
    """Share (P, 3) of the rays upwards, downwards and sideways that leave the shape from every point: 0 to 1."""
    turn = np.arange(4) * np.pi / 2 + 0.2
    slanting = np.stack([np.sin(TILT) * np.cos(turn), np.full(4, np.cos(TILT)), np.sin(TILT) * np.sin(turn)], axis=1)
    above = np.concatenate([[[0.0, 1.0, 0.0]], slanting])
    turn = np.arange(8) * np.pi / 4 + 0.2
    level = np.stack([np.cos(turn), np.zeros(8), np.sin(turn)], axis=1)
    seen = []
    for side in (above, above * [1, -1, 1], level):
        origins = (shape.points[:, None] + LIFT * side).reshape(-1, 3)
        far = first_hits(shape.mesh, origins, np.tile(side, (shape.n_points, 1)))
        seen.append(np.isinf(far).reshape(-1, len(side)).mean(axis=1))
    return np.stack(seen, axis=1).astype(np.float32)


def vote(
    shapes: Any, views: Sequence[Sequence[Alignment]], traits: Sequence[np.ndarray], normal: Float[np.ndarray, " 3"],
    offset: float, parts: Sequence[np.ndarray], n_parts: int, pieces: Sequence[np.ndarray], whole: Sequence[np.ndarray],
    components: Sequence[np.ndarray],
) -> list[Int[np.ndarray, " P"]]:  # fmt: skip
    """New part (P,) of every point of every shape, from the parts (P,) of like points of the other shapes.

    ``views`` hold the frames of all shapes, one voice each, whose mirror plane is ``normal · x = offset``;
    ``traits`` the ``exposure`` of every shape's points and how long their pieces are (P, 4); ``pieces`` and ``whole``
    are as ``find_pieces`` gives them, and ``components`` as ``point_components`` does.  A point's vote is averaged with
    those of its neighbours, of its piece and of its component, so borders stay short.  They vote again on what came of
    it, ``ROUNDS`` times at most.  Needs two shapes at least.
    """
    electorates = [_Electorate(shapes, frames, traits, normal, offset) for frames in views]
    for _ in range(ROUNDS):
        said = [np.concatenate([thinned(part, electorate.share) for part in parts]) for electorate in electorates]
        voted = []
        for t in range(len(shapes)):
            opinions = [one.votes(t, these, n_parts) for one, these in zip(electorates, said, strict=True)]
            own = np.mean(opinions, axis=0)
            voted.append(_decided(own, shapes[t], parts[t], pieces[t], whole[t], components[t]))
        settled = all(np.array_equal(new, old) for new, old in zip(voted, parts, strict=True))
        parts = voted
        if settled:
            break
    return list(parts)


def _decided(
    own: np.ndarray, shape: Shape, part: np.ndarray, piece: np.ndarray, whole: np.ndarray, component: np.ndarray
) -> Int[np.ndarray, " P"]:
    """The part (P,) of every point of a shape after all that it hears, from the votes (P, L) on itself."""
    present = shape.neighbours >= 0
    around = (own[shape.neighbours] * present[:, :, None]).sum(axis=1)
    around = around / np.maximum(present.sum(axis=1, keepdims=True), 1)
    of_piece = _mean_of(own, piece)
    small = (np.bincount(component)[component] < HALF * len(piece))[:, None]
    of_piece = np.where(small, (1 - TOGETHER) * of_piece + TOGETHER * _mean_of(own, component), of_piece)
    before = part[:, None] == np.arange(own.shape[1])
    hears = np.where(whole[piece][:, None], COMPONENT_HEARS, PATCH_HEARS)
    heard = zip(hears.T[:, :, None], (own, around, of_piece, before), strict=True)
    return sum(loud * voice for loud, voice in heard).argmax(axis=1)


def _mean_of(votes: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Votes (P, L), each the mean of its group (P,)."""
    sums = np.stack([np.bincount(group, column) for column in votes.T], axis=1)
    return (sums / np.maximum(np.bincount(group), 1)[:, None])[group]


class _Electorate:
    """Points of all shapes in one view, and who votes on whom: that does not change from round to round."""

    def __init__(self, shapes: Any, frames, traits, normal: np.ndarray, offset: float) -> None:
        self.frames, self.traits, self.plane = frames, traits, (normal, offset)
        number = len(shapes)
        self.share = max(2, VOTERS // number)
        voters = [thinned(self._likeness(shapes[t], t), self.share) for t in range(number)]
        tree = cKDTree(np.concatenate(voters))
        of_shape = np.repeat(np.arange(number), [len(rows) for rows in voters])
        # The own points are found, too, but have no vote: enough others must be among the nearest.
        k = min(VOTES + VOTES // (number - 1), len(of_shape))
        n_voted = int(np.clip(ALL_VOTED // number, FEWEST_VOTED, VOTED))
        self.ballots = []
        for t in range(number):
            rows = self._likeness(shapes[t], t)
            asked = thinned(rows, n_voted)
            distance, near = tree.query(asked, k=k)
            width = np.maximum(distance[:, : k // 2 + 1].mean(axis=1, keepdims=True), 1e-9)
            weight = np.exp(-0.5 * (distance / width) ** 2) * (of_shape[near] != t)
            follows = cKDTree(asked).query(rows)[1]
            # small, as there may be a thousand shapes
            self.ballots.append((near.astype(np.int32), weight.astype(np.float32), follows.astype(np.int32)))

    def votes(self, t: int, said: Int[np.ndarray, " V"], n_parts: int) -> Float[np.ndarray, "P L"]:
        """Probability of every part at every point of shape ``t``, by what like points of the others ``said``."""
        near, weight, follows = self.ballots[t]
        votes = np.stack([(weight * (said[near] == part)).sum(axis=1) for part in range(n_parts)], axis=1) + 1e-9
        votes /= votes.sum(axis=1, keepdims=True)
        return votes[follows].astype(np.float64)

    def _likeness(self, shape: Shape, t: int) -> Float[np.ndarray, "P 10"]:
        """Rows, near for like points: place folded at the mirror plane, how level it is, thickness, geodesics, what is
        seen, and how long its piece is."""
        places, normals = placed(shape, self.frames[t], *self.plane)
        places = np.concatenate([np.abs(places[:, :1]), places[:, 1:]], axis=1) / REACH
        described = [shape.descriptors[:, [0, 3]] * [THICK, INNER], self.traits[t] * [*SEEN, LONG]]
        return np.concatenate([places, normals[:, 1:2] ** 2, *described], axis=1)
