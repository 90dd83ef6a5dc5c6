"""Copies of a part that the exemplar does not have: a fifth leg, a second pair of engines, engines at another place.

φ1 explains surface by what is near, so an engine where the exemplar has none is taken for the wing it hangs under.
But it looks like an engine.  Every connected piece of the surface that its own part explains badly is compared with
the components of templates, each moved onto it, stretched to its box and mirrored; where a component of another part
fits far better than the piece is explained now, the piece is taken for a copy of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from shapeforge.collection.align import thinned
from shapeforge.collection.points import nearest_points
from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.pieces import face_components
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import mapped_normals

FEWEST, LARGEST = 8, 0.25
"""Points of a piece at least, and share of the surface at most."""

REACH, TURNED = 0.02, 2.0
"""A gap of as much (diagonals) costs as much as half a right angle between normals does: 1; gaps cost at most 2."""

EXPLAINED, FAR = 0.6, 1.2
"""Cost of a piece as it is explained now, and how many times as wide as the shape's mean one the gap to its own part
is, from which on it is looked at."""

LIKENESS, LIKENESS_NEAR = 1.2, 0.8
"""Cost of the component that a copy is of, at most; the second for a piece that does not stand off from its part."""

BETTER, RIVAL = 0.15, 0.5
"""By how much a copy must cost less than the present explanation, and than a copy of any component of the part that
the piece belongs to now."""

STRETCH = (0.6, 1.67)
"""Stretches of a component along the axes; the piece may be a little larger or smaller still."""

TALLEST = 2.5
"""Ratio of the extents at most, both lengthened by ``REACH``: by so little templates may be bent or thickened by what
they learn from all shapes, and a thin component is a multiple of itself then."""

LEVEL = 0.12
"""How much higher or lower than the template's component a copy may lie, in diagonals or in heights of the shape: a
slat of the back looks like a leg, but legs stand on the floor."""

ALIKE = 0.01
"""Extents and height (diagonals) within which two components of a part are looked at as one."""

COMPARED = 64
"""Points of a piece and of a component that are compared."""


MIRRORED = np.array([[[across, 1.0, along]] for across in (1.0, -1.0) for along in (1.0, -1.0)])
"""A left leg is a right leg's mirror image, a rear one a front one's."""


@dataclass(frozen=True, eq=False)
class Copy:
    """Surface points ``rows`` (n,) that are a copy of a component of ``part``."""

    part: int
    rows: Int[np.ndarray, " n"]


def find_copies(
    shape: Shape,
    templates: Sequence[PartTemplates],
    beliefs: Beliefs,
    label: Int[np.ndarray, " P"],
    in_turn: Sequence[Sequence[int]] = (),
) -> tuple[Copy, ...]:
    """Pieces of the surface that are copies of components of other parts than ``label`` (P,) now has them as.

    ``beliefs`` are those that say where the templates lie on the shape.  A piece is compared with the components of
    some templates (indices; none: those of ``beliefs``), and of others with those of parts that these lack; and where
    it is no copy of any, with the next ``in_turn``.  Pieces with painted points stay as they are.
    """
    template = templates[beliefs.template]
    alive = np.flatnonzero(beliefs.alive(template.label))
    if not len(alive):  # others explain the shape, by parts that these templates lack
        return ()
    nearest, gap = (one[:, 0] for one in nearest_points(beliefs.deformed[alive], shape.points))
    normals = mapped_normals(template, beliefs)[alive]
    now = _cost(gap, shape.normals, normals[nearest])
    component = face_components(shape.mesh)[shape.face_of_point]
    component = np.unique(component, return_inverse=True)[1].reshape(-1)
    size = np.bincount(component)
    cost, wide = (np.bincount(component, value) / size for value in (now, gap))
    painted = np.bincount(component, beliefs.evidence >= 0) > 0
    small = (size >= FEWEST) & (size <= LARGEST * len(component))
    asked = np.flatnonzero(small & ~painted & ((cost > EXPLAINED) | (wide > FAR * gap.mean())))
    if not len(asked):
        return ()
    tries = [_components(templates, beliefs.template, one) for one in in_turn or ((beliefs.template,),)]
    whole = beliefs.to_family(shape.points)
    found: list[Copy] = []
    for one in asked.tolist():
        rows = np.flatnonzero(component == one)
        points, facing = (thinned(beliefs.to_family(of[rows]), COMPARED) for of in (shape.points, shape.normals))
        points, extent, middle = _centred(points)
        present = int(np.bincount(label[rows], minlength=template.n_parts).argmax())
        piece = _Component(present, _level(middle, whole), extent, points, facing)
        most = min(LIKENESS if wide[one] > FAR * gap.mean() else LIKENESS_NEAR, cost[one] - BETTER)
        parts = (_copied(piece, known, most) for known in tries)
        part = next((part for part in parts if part is not None), None)
        if part is not None:
            found.append(Copy(part, rows))
    return tuple(found)


def _copied(piece: _Component, known: list[_Component], most: float) -> int | None:
    """The part of which a piece is a copy, at a cost below ``most``, by the components that are ``known``."""
    others = [one for one in known if one.part != piece.part and _may_be(one, piece)]
    costs = [_likeness(piece, one) for one in others]
    if min(costs, default=np.inf) >= most:
        return None
    # of the part that it is now components of any size and level count
    own = min((_likeness(piece, one) for one in known if one.part == piece.part), default=np.inf)
    return others[int(np.argmin(costs))].part if min(costs) < own - RIVAL else None


@dataclass(frozen=True, eq=False)
class _Component:
    """A connected piece of surface (n points, centred) with its part, height in diagonals and of the shape, extent."""

    part: int
    level: tuple[float, float]
    extent: np.ndarray
    points: np.ndarray
    normals: np.ndarray


def _components(templates: Sequence[PartTemplates], leading: int, compared: Sequence[int]) -> list[_Component]:
    """The components that have points enough, centred: those of the ``compared`` templates, others' of parts that these
    lack.  The others are the ``leading`` ones, unless these are compared themselves: then all."""
    found: list[_Component] = []
    has = np.any([templates[g].has_part() for g in compared], axis=0)
    others = [g for g in range(len(templates)) if g not in compared] if leading in compared else [leading]
    for g in (*compared, *others):
        template = templates[g]
        for part, number in np.unique(np.stack([template.label, template.component], axis=1), axis=0).tolist():
            rows = np.flatnonzero((template.label == part) & (template.component == number))
            if len(rows) < FEWEST or (has[part] and g not in compared):
                continue
            points, extent, middle = _centred(template.points[rows])
            level = _level(middle, template.points)
            # left or right, front or rear: mirror images are tried in any case
            if any(
                part == one.part and np.abs([*(extent - one.extent), level[0] - one.level[0]]).max() < ALIKE
                for one in found
            ):
                continue
            normals = thinned(template.normals[rows], COMPARED)
            found.append(_Component(part, level, extent, thinned(points, COMPARED), normals))
    return found


def _centred(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3) about the middle of their box, its extents (3,) and middle (3,)."""
    low, high = points.min(axis=0), points.max(axis=0)
    return points - (low + high) / 2, high - low, (low + high) / 2


def _level(middle: np.ndarray, whole: np.ndarray) -> tuple[float, float]:
    """Height of a place, in diagonals and as a share of the height of the whole (n, 3)."""
    low, high = float(whole[:, 1].min()), float(whole[:, 1].max())
    return float(middle[1]), (float(middle[1]) - low) / max(high - low, 1e-9)


def _may_be(one: _Component, piece: _Component) -> bool:
    """Whether a piece is of about the size of a component, and lies about as high."""
    ratio = (piece.extent + REACH) / (one.extent + REACH)
    apart = min(abs(here - there) for here, there in zip(piece.level, one.level, strict=True))
    return bool(ratio.max() < TALLEST and ratio.min() > 1 / TALLEST and apart < LEVEL)


def _likeness(piece: _Component, one: _Component) -> float:
    """Least cost of a piece as a copy of a component, both ways."""
    ratio = np.clip((piece.extent + REACH) / (one.extent + REACH), *STRETCH)
    return _apart(piece.points, piece.normals, one.points * ratio * MIRRORED, one.normals * MIRRORED)


def _apart(points: np.ndarray, normals: np.ndarray, placed: np.ndarray, facing: np.ndarray) -> float:
    """Least mean cost, both ways, of points (n, 3) and a component in several poses (4, m, 3); by brute force."""
    squared = (points**2).sum(axis=1)[:, None] + (placed**2).sum(axis=2)[:, None]
    squared -= 2.0 * np.einsum("ni,qmi->qnm", points, placed)
    turned = TURNED * (1.0 - np.abs(np.einsum("ni,qmi->qnm", normals, facing)))
    total = np.zeros(len(placed))
    for axis in (1, 2):
        nearest = np.expand_dims(squared.argmin(axis=axis), axis)
        gap, turn = (np.take_along_axis(of, nearest, axis).squeeze(axis) for of in (squared, turned))
        total += 0.5 * (np.minimum(np.sqrt(np.maximum(gap, 0.0)) / REACH, 2.0) + turn).mean(axis=1)
    return float(total.min())


def _cost(gap: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """What a gap (n,) and the angle between unit normals (n, 3) cost."""
    return np.minimum(gap / REACH, 2.0) + TURNED * (1.0 - np.abs((one * other).sum(axis=1)))
