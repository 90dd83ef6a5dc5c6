"""Orientation as something to be inferred (§7): probabilities over a few rotations of every shape of a family.

Each shape alone says which way may be up (``collection/orient``).  The family says more: shapes of one family, rightly
turned, have their surface in like places.  That is told by some thirty numbers for each rotation, so that no two shapes
need be aligned (a nose and a tail, at the ends of fuselages of different proportions, confuse every distance between
surfaces), and the time grows with the number of shapes only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from shapeforge.collection.align import Alignment, affine_align, thinned
from shapeforge.collection.directions import AXIS_ROTATIONS
from shapeforge.collection.orient import poses
from shapeforge.collection.upright import Surface

QUARTERS = np.array([[[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))])
"""The four quarter turns (4, 3, 3) about the vertical."""

UPS = 7  # directions that may be up that are carried on, of those
WORTH_TRYING = 9.0  # nats below the best
MIRROR_ACROSS = 64.0  # nats a radius by which the mirror plane across x must be the better one
HIGH_AT_THE_BACK = 0.5  # nats: backs of chairs, tails of airplanes
WIDE = 0.5  # nats: wider across than deep
FILES_AGREE = 4.0  # nats: files of one collection face the same way; and are y up if most are
VOTE = 1.5  # nats that a likeness of one nat more counts, since the numbers are not independent
NARROW = 0.6  # of the typical distance to the most alike: the width within which shapes are alike
LONELY = 1e-4  # likeness, of one, with nobody at all
VOTERS = 150  # shapes that settle it among themselves; the others listen to them
ROUNDS = 15

TRIED = 4  # turned starts whose alignment is refined
BETTER = 0.85  # of the residual as the shape lies that a turned start must leave
_N_POINTS, _N_SCREENED, _N_ALIGNED = 500, 160, 400
_N_ODD = 9
_TURNED = AXIS_ROTATIONS[1:]  # all but the identity


@dataclass(frozen=True, eq=False)
class Turns:
    """Rotations (c, 3, 3) that may put one shape right, from its file's axes, with their ``score`` (c,) in nats.

    ``features`` (c, f) describe the shape so turned; ``quarter`` (c,) is the quarter turn about y that the rotation is,
    -1 where it is something else.
    """

    rotations: Float[np.ndarray, "c 3 3"]
    score: Float[np.ndarray, " c"]
    features: Float[np.ndarray, "c f"]
    quarter: Int[np.ndarray, " c"]


def candidate_turns(surface: Surface) -> Turns:
    """The rotations worth trying on a shape: four for each direction that may be up, scored by the shape alone.

    Of the four, those score higher that mirror the shape across x, make it wide rather
    than deep and lift its back (-z): a convention that is mostly right, and that the family may overrule.
    """
    found = poses(surface)
    found = [pose for pose in found[:UPS] if pose.score > found[0].score - WORTH_TRYING]
    rotations = np.array([turn @ pose.rotation for pose in found for turn in QUARTERS])
    features = _described(surface, rotations)
    score = np.repeat([pose.score for pose in found], 4) + np.array([_faces_front(row) for row in features])
    quarter = np.concatenate([np.arange(4) if pose.name == "+y" else np.full(4, -1) for pose in found])
    return Turns(rotations, score, features, quarter)


def settled_turn(surface: Surface, rotation: Float[np.ndarray, "3 3"]) -> Turns:
    """A shape whose rotation stands: it votes, and is not turned."""
    same = np.abs(QUARTERS - rotation).max(axis=(1, 2)) < 1e-6
    quarter = np.array([int(same.argmax()) if same.any() else -1])
    return Turns(rotation[None], np.zeros(1), _described(surface, rotation[None]), quarter)


def agree(family: Sequence[Turns]) -> list[Float[np.ndarray, " _"]]:
    """Probabilities (c,) of the rotations of every shape, after each has listened to the others.

    Mean field: a rotation is the more probable the more the shape, so turned, is like other shapes as they probably are
    turned.  Files of one collection mostly follow one convention, so that also counts what they agree on.  At most 150
    shapes, evenly picked, are listened to.
    """
    if not family:
        return []
    chosen = thinned(np.arange(len(family)), VOTERS)
    spread = np.concatenate([turns.features for turns in family]).std(axis=0) + 0.05
    voters = [family[t] for t in chosen]
    sizes = np.array([len(turns.score) for turns in voters])
    owner, ends = np.repeat(np.arange(len(voters)), sizes), np.cumsum(sizes)
    features = np.concatenate([turns.features for turns in voters]) / spread
    score, quarter = (np.concatenate([getattr(turns, name) for turns in voters]) for name in ("score", "quarter"))
    squared = cdist(features, features, "sqeuclidean").astype(np.float32)
    squared[owner[:, None] == owner] = np.inf

    def probabilities(value: np.ndarray) -> np.ndarray:
        return np.concatenate([_softmax(part) for part in np.split(value, ends[:-1])])

    now = probabilities(score)
    best = [end - size + int(now[end - size : end].argmax()) for end, size in zip(ends, sizes, strict=True)]
    nearest = squared[np.ix_(best, best)].min(axis=1)
    width = NARROW * float(np.median(nearest)) + 1e-6 if len(voters) > 1 else 1.0
    kernel = np.exp(-0.5 * squared / width)
    for _ in range(ROUNDS):
        habit = _habit(now, quarter, len(voters))
        value = score + VOTE * np.log(kernel @ now / len(voters) + LONELY) + habit[quarter]
        now = 0.5 * now + 0.5 * probabilities(value)
    habit, by_shape = _habit(now, quarter, len(voters)), dict(zip(chosen, np.split(now, ends[:-1]), strict=True))
    for t, turns in enumerate(family):
        if t not in by_shape:
            likeness = np.exp(-0.5 * cdist(turns.features / spread, features, "sqeuclidean") / width) @ now
            value = turns.score + VOTE * np.log(likeness / len(voters) + LONELY) + habit[turns.quarter]
            by_shape[t] = _softmax(value)
    return [by_shape[t] for t in range(len(family))]


def chosen_rotations(
    family: Sequence[Turns], probabilities: Sequence[Float[np.ndarray, " _"]], *, standing: bool = False
) -> list[Float[np.ndarray, "3 3"]]:
    """The most probable rotation (3, 3) of every shape.

    Which way a whole family faces is a convention, so all are turned about the vertical together such that most of the
    files that are y up stay as they are; not where some shapes are ``standing``, whose convention it then is.
    """
    habit = np.zeros(4)
    for turns, probability in zip(family, probabilities, strict=True):
        known = turns.quarter >= 0
        np.add.at(habit, turns.quarter[known], probability[known])
    back = np.eye(3) if standing else QUARTERS[int(habit.argmax())].T
    best = [turns.rotations[int(p.argmax())] for turns, p in zip(family, probabilities, strict=True)]
    return [back @ rotation for rotation in best]


@dataclass(frozen=True, eq=False)
class PosedStart:
    """A template's affine map onto a shape that ``pose`` puts right; ``alignment`` leads to the shape as it lies."""

    template: int
    pose: Float[np.ndarray, "3 3"]
    alignment: Alignment


def posed_starts(
    points: Float[np.ndarray, "P 3"],
    templates: Sequence[Float[np.ndarray, "_ 3"]],
    alignments: Sequence[Alignment],
) -> list[PosedStart]:
    """Turned starts that explain a shape better than any start does as it lies, best first; mostly none.

    ``templates`` are the exemplars' points (K, 3), ``alignments`` their maps onto the shape's ``points`` (P, 3) as it
    lies.  All other rotations that take axes to axes are screened on few points without refining; the most promising
    are aligned properly, if they look better than the shape as it lies does at so quick a glance.
    """
    least = min(alignment.residual for alignment in alignments)
    few = thinned(points, _N_SCREENED)

    def glance(rotation: np.ndarray) -> list[float]:
        turned = few @ rotation.T
        return [
            affine_align(template, turned, starts=("spread",), n_points=_N_SCREENED, max_iterations=0).residual
            for template in templates
        ]

    lying = min(glance(np.eye(3)))
    screened = sorted(
        (residual, r, g)
        for r, rotation in enumerate(_TURNED)
        for g, residual in enumerate(glance(rotation))
        if residual < lying
    )
    found = []
    for _, r, g in screened[:TRIED]:
        rotation = _TURNED[r]
        there = affine_align(templates[g], points @ rotation.T, n_points=_N_ALIGNED)
        if there.residual < BETTER * least:
            back = Alignment(rotation.T @ there.matrix, rotation.T @ there.offset, there.residual, there.start)
            found.append(PosedStart(g, rotation, back))
    return sorted(found, key=lambda start: start.alignment.residual)


def _habit(now: np.ndarray, quarter: np.ndarray, n_shapes: int) -> np.ndarray:
    """What the files' own axes are worth (5,): in nats for each quarter, and 0 for what is no quarter (index -1)."""
    shares = np.array([now[quarter == one].sum() for one in range(4)]) / n_shapes
    worth = np.full(5, FILES_AGREE * max(0.0, 2 * shares.sum() - 1))
    worth[:4] -= np.where(np.arange(4) == shares.argmax(), 0.0, FILES_AGREE)
    worth[4] = 0.0
    return worth


def _softmax(score: np.ndarray) -> np.ndarray:
    weight = np.exp(score - score.max())
    return weight / weight.sum()


def _described(surface: Surface, rotations: np.ndarray) -> Float[np.ndarray, "c f"]:
    points, normals = thinned(surface.points, _N_POINTS), thinned(surface.normals, _N_POINTS)
    return np.array([_features(surface, points @ turn.T, normals @ turn.T, turn) for turn in rotations])


def _features(surface: Surface, points: np.ndarray, normals: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Numbers (f,) that tell how a turned shape lies; the last nine change sign when it faces the other way.

    Spread along the axes; gaps left by mirroring across x and z; area that faces along the axes; heights; how far the
    surface reaches sideways and in depth at three heights.  Then, front against back: where the top is, the mass, its
    tail; width, height and spread; sweep of what is far out; slope; where the bottom is.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    x, y, z = ((points - (low + high) / 2) / np.maximum((high - low) / 2, 1e-9)).T
    out, front, back = np.abs(x), z > 1 / 3, z < -1 / 3
    off = np.abs(y - y.mean())
    mirrors = [_mirror_gap(surface, rotation[axis]) for axis in (0, 2)]
    thirds = [(y >= bottom) & (y < bottom + 0.67) for bottom in (-1, -0.33, 0.34)]
    slope = ((y - y.mean()) * (z - z.mean())).mean() / (y.std() * z.std() + 1e-9)
    return np.array([
        *np.log(np.maximum(points.std(axis=0), 0.05)),
        *(8 * gap for gap in mirrors),
        *(np.abs(normals) > 0.95).mean(axis=0),
        *(2 * np.histogram(y, 6, (-1, 1))[0] / len(y)),
        *(_mean(np.abs(axis), third) for axis in (x, z) for third in thirds),
        _mean(z, y > 0.7) - z.mean(),
        2 * z.mean(),
        ((z - z.mean()) ** 3).mean() / (z.std() ** 3 + 1e-9),
        2 * (_mean(out, front) - _mean(out, back)),
        _mean(y, front) - _mean(y, back),
        2 * (_mean(off, front) - _mean(off, back)),
        2 * (_mean(z, out > 0.6) - _mean(z, out < 0.3)),
        2 * slope,
        _mean(z, y < -0.7) - z.mean(),
    ])  # fmt: skip


def _mean(values: np.ndarray, where: np.ndarray) -> float:
    return float(values[where].mean()) if where.sum() > 2 else 0.0


def _mirror_gap(surface: Surface, normal: np.ndarray) -> float:
    along = surface.corners @ normal
    places = (0.0, float(along.min() + along.max()) / 2)
    return float(np.clip(min(surface.reflections.error(normal, at) for at in places), 0.0, 0.15))


def _faces_front(features: np.ndarray) -> float:
    """How well the convention is kept, in nats."""
    spread, (across, deep) = features[:3], features[3:5] / 8
    top, slope = features[-_N_ODD], features[-2]
    high = HIGH_AT_THE_BACK * -(top + slope)
    return high + WIDE * float(spread[0] - spread[2]) - MIRROR_ACROSS * max(across - deep, 0.0)
