"""Turning a mesh so that y is up: candidates for its orientation, scored, and what import does with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from shapeforge.collection.directions import angle_between, supports, turning_angle
from shapeforge.collection.shape import Mesh
from shapeforge.collection.upright import (
    GOOD_MIRROR,
    Surface,
    log_likelihoods,
    surface_of_mesh,
    up_candidates,
    up_features,
)

# The rotation that takes each signed axis to +y.  Among the four that do, the one that turns least (and, for z up,
# keeps x to the right), because only the vertical is decided here, never which way a shape faces.
TURNS: dict[str, np.ndarray] = {
    "+y": np.eye(3),
    "+z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "+x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "-y": np.diag([1.0, -1, -1]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-x": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
}
CHOICES = ("auto", "x", "y", "z", "keep")

# Files are y up mostly, z up quite often, anything else hardly ever; a wrong turn is worse than none.
PRIOR = {"+y": 4.5, "+z": 3.0, "+x": 0.0, "-y": 0.0, "-z": 0.0, "-x": 0.0}
"""Log-odds of each axis of the file for being up, against a direction that is no axis of the file."""
ODD_PRIOR = 2.5
"""Log-odds of y where nothing of the shape is square with it, so that it seems to mean nothing."""

NEARLY = 2.0  # degrees: a direction this near an axis of the file is that axis
SIDEWAYS = 10.0  # degrees from vertical up to which a mirror plane tells which way a shape faces
_SIGNS = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True, eq=False)
class Pose:
    """A rotation (3, 3) that may put a shape upright, and the log-probability of the direction that it turns up.

    ``name`` is "+y" and so on where that direction is an axis of the file, else empty.  Which way the shape faces then
    is a guess: the best mirror plane lies across x, or across z where that turns the shape less.
    """

    rotation: Float[np.ndarray, "3 3"]
    score: float
    name: str = ""

    @property
    def up(self) -> Float[np.ndarray, " 3"]:
        """The direction (3,) of the file that is turned up."""
        return self.rotation[1]


def orient(mesh: Mesh, up: str) -> tuple[Float[np.ndarray, "3 3"], str]:
    """The proper rotation (3, 3) that makes y the vertical of ``mesh``, and a sentence saying what was done.

    ``up``: "x", "y" or "z" name the axis that is up in the file; "keep" leaves the file as it is; "auto" takes the best
    of ``poses``: mostly the file's own y, another axis or a tilted direction where that is clear.  A turn about the
    vertical is left alone unless a tilt is taken away.

    Raises ValueError when ``up`` is none of these.
    """
    if up not in CHOICES:
        raise ValueError(f"up: wanted one of {', '.join(CHOICES)}, got {up!r}; name the axis that is up in the file")
    if up == "keep":
        return np.eye(3), "orientation kept as in the file"
    if up != "auto":
        return TURNS["+" + up].copy(), "y is up in the file" if up == "y" else f"turned: {up} was up in the file"
    surface = surface_of_mesh(mesh)
    if surface is None:
        return np.eye(3), "y is up"
    best = poses(surface)[0]
    return best.rotation.copy(), describe_turn(best.rotation)


def describe_turn(rotation: Float[np.ndarray, "3 3"]) -> str:
    """What a reader should know of a file turned by ``rotation`` (3, 3)."""
    up = rotation[1]
    name = _axis_name(up)
    if not name:
        nearest = min(TURNS, key=lambda axis: angle_between(up, TURNS[axis][1]))
        angle = angle_between(up, TURNS[nearest][1])
        return f"turned: {nearest} of the file seems to be up, tilted by {angle:.0f} degrees"
    if name != "+y":
        return f"turned: {name} seems to be up in the file"
    if turning_angle(rotation) < NEARLY:
        return "y is up"
    return f"turned about the vertical by {turning_angle(rotation):.0f} degrees, to face as the others do"


def poses(surface: Surface) -> list[Pose]:
    """Candidates for the orientation of a shape, most likely first: one for every direction that may be up.

    The axes of the coordinates are taken for those of the file, which mean something (``PRIOR``).
    """
    natural = _natural_axes(surface)
    ups = up_candidates(surface, _SIGNS[[axis == 1 or axis % 3 in natural for axis in range(6)]])
    score = log_likelihoods(up_features(surface, ups))
    names = [_axis_name(up.direction) for up in ups]
    known = [name != "" and "xyz".index(name[1]) in natural for name in names]
    odd = [ODD_PRIOR if name == "+y" else 0.0 for name in names]
    score = score + [PRIOR[name] if yes else other for name, yes, other in zip(names, known, odd, strict=True)]
    score -= np.logaddexp.reduce(score)
    found = [
        Pose(TURNS[name] if name else upright(up.direction, surface), float(value), name)
        for up, name, value in zip(ups, names, score, strict=True)
    ]
    return sorted(found, key=lambda pose: -pose.score)


def upright(up: Float[np.ndarray, " 3"], surface: Surface) -> Float[np.ndarray, "3 3"]:
    """The rotation that turns ``up`` (3,) to y and squares the shape with x and z, turning it as little as it can.

    Squared is the best mirror plane that is about vertical, or else the axes along which the surface faces.
    """
    for normal in _sideways(up, surface):
        across = normal - (normal @ up) * up
        across /= np.linalg.norm(across)
        deep = np.cross(across, up)
        turns = [np.stack([x, up, np.cross(x, up)]) for x in (across, -across, deep, -deep)]
        return min(turns, key=turning_angle)
    return _least_turn(up)


def _natural_axes(surface: Surface) -> set[int]:
    """The axes of the file (0, 1, 2) that the shape is square with: it faces along, is mirrored across or stands on it.

    Two of them make the third; one alone does not: a shape may be tilted about it.
    """
    natural = [axis for frame, _ in surface.frames for axis in frame]
    natural += [plane.normal for plane in surface.mirrors if plane.error < GOOD_MIRROR]
    natural += [up for up, _ in supports(surface.hull)]
    found = {"xyz".index(name[1]) for name in map(_axis_name, natural) if name}
    return {0, 1, 2} if len(found) > 1 else found


def _sideways(up: np.ndarray, surface: Surface) -> list[np.ndarray]:
    """Directions (3,) about at right angles to ``up`` that tell which way a shape faces, surest first."""
    level = np.sin(np.radians(SIDEWAYS))
    found = [plane.normal for plane in surface.mirrors if abs(plane.normal @ up) < level]
    return found + [axis for frame, _ in surface.frames for axis in frame if abs(axis @ up) < level]


def _least_turn(up: np.ndarray) -> np.ndarray:
    """The rotation that turns the direction ``up`` (3,) to y by the shortest way."""
    axis, cosine = np.cross(up, [0.0, 1.0, 0.0]), float(up[1])
    if cosine < -1 + 1e-9:
        return TURNS["-y"]
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def _axis_name(direction: np.ndarray) -> str:
    for name in TURNS:
        if angle_between(direction, TURNS[name][1]) < NEARLY:
            return name
    return ""
