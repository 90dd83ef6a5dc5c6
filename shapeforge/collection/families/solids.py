"""Smooth closed surfaces (lofts, sweeps, revolutions, cushions) whose every vertex knows its canonical address.

An *address* (u, v, w) in [0, 1]^3 is a place inside a component's own cube: along, across and through a leg, span,
chord and thickness of a wing.  Sections of any roundness share it by the map of :func:`squircle`, so that the front
edge of a square leg and the front of a round one have the same address.  Addresses have no seam: they may be
interpolated over any triangle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline, PchipInterpolator

Number = float | int | np.floating  # plain literals and drawn numbers alike
Pair = tuple[Number, Number]
Vector = Sequence[Number] | np.ndarray  # three numbers
Table = Sequence[Sequence[Number] | np.ndarray] | np.ndarray  # rows of as many numbers


@dataclass(frozen=True, eq=False)
class Piece:
    """One closed surface of one component: ``faces`` are quads, or triangles with -1 in the last place."""

    vertices: Float[np.ndarray, "V 3"]
    address: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 4"]
    part: str
    component: str


def square_ring(n_around: int, exponent: Number = 2.0) -> Float[np.ndarray, "n 2"]:
    """``n_around`` (a multiple of 4) points around the square [-1, 1]^2, anticlockwise from the corner (1, -1).

    They are spread for the section they are meant for: even angles for a round one (exponent 2), nearer to the
    corners for a boxy one, whose sides are flat.
    """
    if n_around % 4 or n_around < 4:
        raise ValueError(f"n_around: wanted a positive multiple of 4, got {n_around}")
    t = np.linspace(-1.0, 1.0, n_around // 4, endpoint=False)
    even = np.tan(t * np.pi / 4)
    crowded = np.sign(t) * (1 - (1 - np.abs(t)) ** 1.8)
    boxy = np.clip((exponent - 2) / 4, 0, 1)
    t = (1 - boxy) * even + boxy * crowded
    one = np.ones_like(t)
    return np.concatenate([np.c_[one, t], np.c_[-t, one], np.c_[-one, -t], np.c_[t, -one]])


def squircle(square: Float[np.ndarray, "... 2"], exponent: Number) -> Float[np.ndarray, "... 2"]:
    """Points of the square [-1, 1]^2 moved along their rays into |x|^e + |y|^e <= 1 (e = 2: a disc)."""
    largest = np.abs(square).max(axis=-1, keepdims=True)
    norm = (np.abs(square) ** exponent).sum(axis=-1, keepdims=True) ** (1 / exponent)
    return square * np.divide(largest, norm, out=np.ones_like(norm), where=norm > 0)


def unsquircle(inside: Float[np.ndarray, "... 2"], exponent: Number) -> Float[np.ndarray, "... 2"]:
    """The inverse of :func:`squircle`."""
    largest = np.abs(inside).max(axis=-1, keepdims=True)
    norm = (np.abs(inside) ** exponent).sum(axis=-1, keepdims=True) ** (1 / exponent)
    return inside * np.divide(norm, largest, out=np.ones_like(norm), where=largest > 0)


def curve(points: Table, n: int) -> Float[np.ndarray, "n 3"]:
    """A smooth curve through the given points, at ``n`` parameters evenly spread over its chord lengths."""
    points = np.asarray(points, dtype=float)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if len(points) == 2:
        return points[0] + np.linspace(0, 1, n)[:, None] * (points[1] - points[0])
    return CubicSpline(at, points, bc_type="natural")(np.linspace(0, at[-1], n))


def monotone(knots: Table, at: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n d"]:
    """Values (n, d) at ``at`` of the curve through ``knots`` (place, value...): no overshoot between the knots."""
    table = np.asarray(knots, dtype=float)
    return PchipInterpolator(table[:, 0], table[:, 1:])(at)


def loft(rings: Float[np.ndarray, "m n 3"], address: Float[np.ndarray, "m n 3"], part: str, component: str) -> Piece:
    """The closed surface through ``m`` rings of ``n`` points, ends closed by fans around the rings' centres.

    The winding is turned outward whatever the order of the rings.
    """
    m, n, _ = rings.shape
    index = np.arange(m * n).reshape(m, n)
    following = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], following[:-1], following[1:], index[1:]], axis=-1).reshape(-1, 4)
    none = np.full(n, -1)
    start = np.stack([following[0], index[0], np.full(n, m * n), none], axis=1)
    end = np.stack([index[-1], following[-1], np.full(n, m * n + 1), none], axis=1)
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    places = np.clip(np.concatenate([address.reshape(-1, 3), address[[0, -1]].mean(axis=1)]), 0, 1)
    piece = Piece(vertices, places, np.concatenate([quads, start, end]), part, component)
    return piece if signed_volume(piece) > 0 else replace(piece, faces=_reversed(piece.faces))


def signed_volume(piece: Piece) -> float:
    """Volume enclosed by a piece; negative when its faces wind inward."""
    triangles = triangulate(piece.faces)[0]
    a, b, c = (piece.vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def triangulate(faces: Int[np.ndarray, "F 4"]) -> tuple[Int[np.ndarray, "N 3"], Int[np.ndarray, " N"]]:
    """Triangles (N, 3) of quads and triangles, in the order of the faces, and the face each comes from."""
    both = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    keep = both[:, 2] >= 0
    return both[keep], np.repeat(np.arange(len(faces)), 2)[keep]


def _reversed(faces: np.ndarray) -> np.ndarray:
    is_triangle = faces[:, 3] < 0
    turned = faces[:, ::-1].copy()
    turned[is_triangle] = np.c_[faces[is_triangle][:, [2, 1, 0]], np.full(is_triangle.sum(), -1)]
    return turned


def sweep(
    path: Float[np.ndarray, "m 3"],
    half: Float[np.ndarray, "m 2"],
    side: Vector,
    part: str,
    component: str,
    *,
    exponent: Number = 2.0,
    n_around: int = 12,
    bevel: Number = 0.0,
    level: Vector | None = None,
    along: Pair = (0.0, 1.0),
) -> Piece:
    """A section carried along a path.

    ``half`` (m, 2) are the section's half sizes along ``side`` and across it; ``bevel`` rounds both ends off (same
    unit as the path); ``level``, a normal, keeps all sections parallel (feet stay flat on the floor);
    ``along`` is the range of u this piece covers in its component.
    """
    u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    if bevel > 0:
        path, half, u = _bevelled(path, half, u, min(bevel, 0.3 * u[-1], 0.9 * float(half[[0, -1]].min())))
    tangent = np.gradient(path, u, axis=0)
    if level is not None:
        tangent = np.broadcast_to(np.asarray(level, dtype=float), tangent.shape)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    first = np.asarray(side, dtype=float) - (tangent @ np.asarray(side, dtype=float))[:, None] * tangent
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(tangent, first)
    square = square_ring(n_around, exponent)
    section = squircle(square, exponent)
    rings = (
        path[:, None]
        + half[:, None, :1] * section[None, :, :1] * first[:, None]
        + half[:, None, 1:] * section[None, :, 1:] * second[:, None]
    )
    place = along[0] + (along[1] - along[0]) * u / u[-1]
    address = np.empty(rings.shape)
    address[..., 0] = place[:, None]
    address[..., 1:] = 0.5 + 0.5 * square
    return loft(rings, address, part, component)


def _bevelled(path, half, u, bevel):
    """Extra sections near both ends, shrinking along a quarter circle."""
    sizes = [np.array([bevel * (1 - np.sin(a)), bevel * (1 - np.cos(a))]) for a in np.radians([0, 30, 60, 90])]
    # (distance from the end, shrink): at the very end the section is smaller by the bevel
    near = np.array([[s[1], s[0]] for s in sizes])
    inner = u[(u > 1.5 * bevel) & (u < u[-1] - 1.5 * bevel)]
    at = np.concatenate([near[:, 0], inner, (u[-1] - near[:, 0])[::-1]])
    shrink = np.concatenate([near[:, 1], np.zeros(len(inner)), near[::-1, 1]])
    moved = np.stack([np.interp(at, u, path[:, i]) for i in range(3)], axis=1)
    sized = np.stack([np.interp(at, u, half[:, i]) for i in range(2)], axis=1) - shrink[:, None]
    return moved, np.maximum(sized, 1e-4), at


def revolve(
    profile: Table,
    origin: Vector,
    axis: Vector,
    part: str,
    component: str,
    *,
    n_around: int = 16,
    along: Pair = (0.0, 1.0),
) -> Piece:
    """A turned solid: ``profile`` lists (distance along the axis, radius); u follows the profile's own length."""
    table = np.asarray(profile, dtype=float)
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    first = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.9 else np.array([0, 1.0, 0])
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    square = square_ring(n_around)
    section = squircle(square, 2.0)
    rings = np.asarray(origin, dtype=float) + table[:, None, :1] * axis
    rings = rings + table[:, None, 1:] * (section[:, :1] * first + section[:, 1:] * second)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(table, axis=0), axis=1))])
    address = np.empty(rings.shape)
    address[..., 0] = (along[0] + (along[1] - along[0]) * length / length[-1])[:, None]
    address[..., 1:] = 0.5 + 0.5 * square
    return loft(rings, address, part, component)


def cushion(
    profile: Table,
    half: Pair,
    part: str,
    component: str,
    *,
    exponent: Number,
    n_around: int = 32,
) -> Piece:
    """A flat rounded body lying in the xz-plane: ``profile`` lists (share of the plan, height, w) from below to above.

    Address: u across (x), v along (z), w through.
    """
    table = np.asarray(profile, dtype=float)
    square = square_ring(n_around, exponent)
    section = squircle(square, exponent)
    rings = np.empty((len(table), n_around, 3))
    rings[..., 0] = half[0] * table[:, None, 0] * section[:, 0]
    rings[..., 2] = half[1] * table[:, None, 0] * section[:, 1]
    rings[..., 1] = table[:, None, 1]
    address = np.empty(rings.shape)
    address[..., 0] = 0.5 + 0.5 * table[:, None, 0] * square[:, 0]
    address[..., 1] = 0.5 + 0.5 * table[:, None, 0] * square[:, 1]
    address[..., 2] = table[:, None, 2]
    return loft(rings, address, part, component)


def torus(centre: Vector, half: Pair, radius: Number, part: str, component: str, *, n_around: int = 40) -> Piece:
    """A closed horizontal ring, elliptical with half axes ``half`` along x and z.  Address: u, v plan, w height."""
    square = square_ring(n_around)
    plan = squircle(square, 2.0)
    section = squircle(square_ring(8), 2.0)
    rings = np.empty((n_around, 8, 3))
    rings[..., 0] = plan[:, :1] * (half[0] + radius * section[:, 0])
    rings[..., 1] = radius * section[:, 1]
    rings[..., 2] = plan[:, 1:] * (half[1] + radius * section[:, 0])
    address = np.empty(rings.shape)
    address[..., :2] = 0.5 + 0.5 * square[:, None] * (1 + 0.1 * (section[:, 0] - 1))[None, :, None]
    address[..., 2] = 0.5 + 0.5 * section[:, 1]
    index = np.arange(n_around * 8).reshape(n_around, 8)
    around = np.roll(index, -1, axis=0)
    corners = [index, np.roll(index, -1, axis=1), np.roll(around, -1, axis=1), around]
    faces = np.stack(corners, axis=-1).reshape(-1, 4)
    piece = Piece((rings + np.asarray(centre)).reshape(-1, 3), address.reshape(-1, 3), faces, part, component)
    return piece if signed_volume(piece) > 0 else replace(piece, faces=_reversed(piece.faces))


def moved(piece: Piece, place: Callable[[np.ndarray], np.ndarray]) -> Piece:
    """The piece with its vertices (V, 3) sent through ``place``; turned outward again if that mirrored it."""
    piece = replace(piece, vertices=place(piece.vertices))
    return piece if signed_volume(piece) > 0 else replace(piece, faces=_reversed(piece.faces))


def mirrored(piece: Piece, component: str) -> Piece:
    """The piece reflected in x = 0, as another component with the same addresses."""
    vertices = piece.vertices * np.array([-1.0, 1.0, 1.0])
    return replace(piece, vertices=vertices, faces=_reversed(piece.faces), component=component)


def mirrored_across(piece: Piece, axis: int) -> Piece:
    """The piece reflected in x = 0 inside the same component: address coordinate ``axis`` is reflected too."""
    address = piece.address.copy()
    address[:, axis] = 1 - address[:, axis]
    return replace(mirrored(piece, piece.component), address=address)


def readdressed(piece: Piece, address: Callable[[np.ndarray], np.ndarray]) -> Piece:
    """The piece with addresses (V, 3) computed from its vertices (V, 3)."""
    return replace(piece, address=np.clip(address(piece.vertices), 0, 1))
