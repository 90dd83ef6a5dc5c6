"""Shapes vote on proposed parts: a point goes to the part that like points of the *other* shapes belong to.

That mends pieces that were cut badly.  Points are alike that lie in the same place, face the same way, are as thick and
as far from everything, and see as much of what is above, below and around them: a table's top sees the sky, a shelf
does not.
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

VOTES = 30
VOTERS, VOTED = 12_000, 1000  # points of all shapes that vote; points of a shape that are voted on
REACH = 0.12  # diagonals that count as much as turning the normal by a right angle
SEEN = 2.0  # how much seeing all of a side rather than nothing counts beside turning the normal
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
    shapes: Any, views: Sequence[Sequence[Alignment]], exposures: Sequence[np.ndarray], normal: Float[np.ndarray, " 3"],
    offset: float, parts: Sequence[np.ndarray], n_parts: int, pieces: Sequence[np.ndarray], whole: Sequence[np.ndarray],
    components: Sequence[np.ndarray],
) -> list[Int[np.ndarray, " P"]]:  # fmt: skip
    """New part (P,) of every point of every shape, from the parts (P,) of like points of the other shapes.

    ``views`` hold the frames of all shapes, one voice each, whose mirror plane is ``normal · x = offset``;
    ``exposures`` the ``exposure`` of every shape; ``pieces`` and ``whole`` are as ``find_pieces`` gives them, and
    ``components`` as ``point_components`` does.  A point's vote is averaged with those of its neighbours, of its piece
    and of its component, so borders stay short.  Needs two shapes at least.
    """
    electorates = [_Electorate(shapes, frames, exposures, normal, offset, parts) for frames in views]
    voted = []
    for t in range(len(shapes)):
        shape, piece = shapes[t], pieces[t]
        own = np.mean([electorate.votes(shape, t, n_parts) for electorate in electorates], axis=0)
        present = shape.neighbours >= 0
        around = (own[shape.neighbours] * present[:, :, None]).sum(axis=1)
        around = around / np.maximum(present.sum(axis=1, keepdims=True), 1)
        of_piece = _mean_of(own, piece)
        small = (np.bincount(components[t])[components[t]] < HALF * len(piece))[:, None]
        of_piece = np.where(small, (1 - TOGETHER) * of_piece + TOGETHER * _mean_of(own, components[t]), of_piece)
        before = parts[t][:, None] == np.arange(n_parts)
        hears = np.where(whole[t][piece][:, None], COMPONENT_HEARS, PATCH_HEARS)
        heard = zip(hears.T[:, :, None], (own, around, of_piece, before), strict=True)
        voted.append(sum(loud * voice for loud, voice in heard).argmax(axis=1))
    return voted


def _mean_of(votes: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Votes (P, L), each the mean of its group (P,)."""
    sums = np.stack([np.bincount(group, column) for column in votes.T], axis=1)
    return (sums / np.maximum(np.bincount(group), 1)[:, None])[group]


class _Electorate:
    """Points of all shapes in one view, and the parts they say they belong to."""

    def __init__(self, shapes, frames, exposures, normal, offset, parts) -> None:
        self.frames, self.exposures, self.plane = frames, exposures, (normal, offset)
        self.number = len(shapes)
        share = max(2, VOTERS // self.number)
        voters = [thinned(self._likeness(shapes[t], t), share) for t in range(self.number)]
        self.tree = cKDTree(np.concatenate(voters))
        self.said = np.concatenate([thinned(part, share) for part in parts])
        self.of_shape = np.repeat(np.arange(self.number), [len(rows) for rows in voters])

    def votes(self, shape: Shape, t: int, n_parts: int) -> Float[np.ndarray, "P L"]:
        """Probability of every part at every point of shape ``t``, by the nearest points of the others."""
        rows = self._likeness(shape, t)
        asked = thinned(rows, VOTED)
        # The own points are found, too, but have no vote: enough others must be among the nearest.
        k = min(VOTES + VOTES // (self.number - 1), len(self.said))
        distance, near = self.tree.query(asked, k=k)
        width = np.maximum(distance[:, : k // 2 + 1].mean(axis=1, keepdims=True), 1e-9)
        weight = np.exp(-0.5 * (distance / width) ** 2) * (self.of_shape[near] != t)
        votes = np.stack([(weight * (self.said[near] == part)).sum(axis=1) for part in range(n_parts)], axis=1) + 1e-9
        votes /= votes.sum(axis=1, keepdims=True)
        return votes[cKDTree(asked).query(rows)[1]]

    def _likeness(self, shape: Shape, t: int) -> Float[np.ndarray, "P 11"]:
        """Rows, near for like points: place folded at the mirror plane, squared normal, thickness, geodesics, and what
        is seen."""
        places, normals = placed(shape, self.frames[t], *self.plane)
        places = np.concatenate([np.abs(places[:, :1]), places[:, 1:]], axis=1)
        described = [shape.descriptors[:, [0, 3]] * [2, 1], SEEN * self.exposures[t]]
        return np.concatenate([places / REACH, normals**2, *described], axis=1)
