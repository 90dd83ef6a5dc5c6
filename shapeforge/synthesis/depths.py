"""How deep parts that touch go into each other: a frame under a table top must not come out above it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Mesh

REACH = 0.1
"""A part is looked for up to so far (diagonals) behind the surface of the other one."""
ROUND = 0.06
"""What lies within this distance (diagonals) of a contact tells on which side of it each part is."""
ONE_WAY = 0.6
"""Share of the contact's normals along one axis, below which the contact has no direction (a peg in a hole)."""
INWARDS = 0.1
"""Share of the way to the middle of its piece's contact by which a ray is moved."""
DEEPEST = 0.05
"""What came farther (diagonals) through the other part than this is not pushed back: it may be meant to be there."""
SITS_ON = 0.01
"""A part that on its shape was deeper in the other than this (diagonals, median) is let in, and may go anywhere."""
APART = 0.003
"""Middles of the two sides of a contact lie at least so far (diagonals) apart, along its axis."""


def directions_into(
    vertices: Float[np.ndarray, "V 3"], piece: Int[np.ndarray, " V"], at: Int[np.ndarray, " A"],
    surface: Mesh, triangle: Int[np.ndarray, " A"],
) -> Float[np.ndarray, "A 3"]:  # fmt: skip
    """Unit directions (A, 3) from a part into the one it touches, at the contact vertices ``at``; zero where none is.

    The axis is that of most normals of the other part's ``surface`` at the nearest ``triangle`` of each vertex; the
    side is told by the middles of the two parts about the contact.  Each ``piece`` of the part has its own where
    that is clear, else that of all.
    """
    normals = surface.triangle_normals[triangle]
    found = np.tile(_direction(vertices, vertices[at], surface.vertices, normals), (len(at), 1))
    for one in np.unique(piece[at]):
        rows = piece[at] == one
        own = _direction(vertices[piece == one], vertices[at[rows]], surface.vertices, normals[rows])
        if own.any():
            found[rows] = own
    return found


def _direction(own: np.ndarray, anchors: np.ndarray, other: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The direction (3,) of one piece, or of a whole part, from the other's normals at its anchors; zero if unclear."""
    own, other = _about(own, anchors), _about(other, anchors)
    share, axes = np.linalg.eigh(normals.T @ normals / max(len(normals), 1))
    if share[-1] < ONE_WAY or not len(own) or not len(other):
        return np.zeros(3)
    offset = float(axes[:, -1] @ (other.mean(axis=0) - own.mean(axis=0)))
    return np.sign(offset) * axes[:, -1] if abs(offset) > APART else np.zeros(3)


def _about(points: np.ndarray, anchors: np.ndarray) -> np.ndarray:
    """The points within ROUND of any anchor."""
    away = ((points[:, None] - anchors[None]) ** 2).sum(axis=2).min(axis=1) if len(points) else np.zeros(0)
    return points[away < ROUND**2]


def depths(
    points: Float[np.ndarray, "A 3"], into: Float[np.ndarray, "A 3"], piece: Int[np.ndarray, " A"], surface: Mesh
) -> Float[np.ndarray, " A"]:
    """How far (diagonals, at most REACH) each point would have to go back to be outside of the surface; 0: it is.

    Measured against ``into``; 0 as well where that has no direction.  Works on open surfaces: it is the way back to
    the last surface behind the point, not a matter of inside and outside.  Rays start a little nearer to the middle of
    the point's ``piece``: legs flush with the edges of a top would miss it.
    """
    found, start = np.zeros(len(points)), np.array(points, float)
    directed = (into != 0).any(axis=1)
    for one in np.unique(piece[directed]):
        rows = np.flatnonzero((piece == one) & directed)
        start[rows] += INWARDS * (points[rows].mean(axis=0) - points[rows])
    if directed.any():
        to = into[directed]
        start = start[directed] + ((points[directed] - start[directed]) * to).sum(axis=1, keepdims=True) * to
        found[directed] = np.maximum(REACH - first_hits(surface, start - REACH * to, to), 0.0)
    return found


def pushed_back(
    excess: Float[np.ndarray, " A"],
    before: Float[np.ndarray, " A"],
    into: Float[np.ndarray, "A 3"],
    piece: Int[np.ndarray, " A"],
    slack: float,
) -> Float[np.ndarray, " A"]:
    """How far each contact vertex has to go back, where half of its piece's or more are too deep by ``slack``."""
    back = np.zeros(len(excess))
    for one in np.unique(piece):
        rows = (piece == one) & (into != 0).any(axis=1)
        deep = rows & (excess > slack)
        if deep.any() and (np.median(before[rows]) > SITS_ON or np.median(excess[deep]) > DEEPEST):
            continue
        if deep.any() and 2 * deep.sum() >= rows.sum():
            # The ray of one at the rim of the other part may miss it: it goes back with the rest.
            back[rows] = np.where(deep, excess, np.median(excess[deep]))[rows]
    return back
