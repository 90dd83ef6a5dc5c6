"""What a chair stands and sits on: seats, legs, stretchers, and the sheet its back is bent into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapeforge.collection.families.solids import (
    Number,
    Piece,
    curve,
    cushion,
    mirrored,
    monotone,
    moved,
    readdressed,
    squircle,
    sweep,
    torus,
)


@dataclass(frozen=True)
class Seat:
    """Where things can be joined to a seat: half sizes, height of its top, thickness, roundness and rear taper."""

    half_width: Number
    half_depth: Number
    top: Number
    thickness: Number
    exponent: Number
    taper: Number

    def at(self, p: Number, q: Number) -> tuple[float, float]:
        """(x, z) of the plan point p across (-1..1), q along (-1 rear .. 1 front), inside a square plan."""
        return self.half_width * p * (1 + self.taper * q), self.half_depth * q

    def inset(self, p: Number, q: Number) -> tuple[float, float]:
        """As ``at``, for the square's point moved into the seat's own roundness."""
        p, q = squircle(np.array([p, q], dtype=float), self.exponent)
        return self.at(float(p), float(q))

    @property
    def bottom(self) -> float:
        """Height of the underside."""
        return self.top - self.thickness


@dataclass(frozen=True)
class Back:
    """The curved sheet a back is built in: flat coordinates (x, height, depth) bend into space here."""

    half_width: Number
    height: Number
    foot: tuple[Number, Number]  # (y, z) of the middle of its lower edge
    slant: Number  # radians from upright
    bend: Number  # how far the top bends further back, as a share of the height
    wrap: Number  # how far the sides come forward, metres
    crown: Number  # how much higher the middle of its top is than the sides, as a share of the height
    flare: Number  # how much wider the top is than the foot, as a share

    def place(self, flat: np.ndarray) -> np.ndarray:
        """Points (n, 3) of flat coordinates x across, h up, d forward, in space."""
        x, h, d = np.asarray(flat, dtype=float).T
        share = h / self.height
        angle = self.slant + 2 * self.bend * np.clip(share, 0, None)
        crown = self.crown * (1 - (x / self.half_width) ** 2) * np.clip(share, 0, None)
        x = x * (1 + self.flare * np.clip(share, 0, None))
        h = h * (1 + crown)
        y = self.foot[0] + h * np.cos(self.slant + self.bend * np.clip(share, 0, None))
        z = self.foot[1] - h * np.sin(self.slant + self.bend * np.clip(share, 0, None))
        across = x / self.half_width
        z = z + self.wrap * across**2
        turn = np.arctan(2 * self.wrap * across / self.half_width)
        return np.stack(
            [x - d * np.sin(turn), y + d * np.sin(angle) * np.cos(turn), z + d * np.cos(angle) * np.cos(turn)], axis=1
        )


# ---------------------------------------------------------------------------------------------------------- seats


def make_seat(
    rng: np.random.Generator, *, half_width: Number, half_depth: Number, top: Number, kind: str, exponent: Number
) -> tuple[Seat, list[Piece]]:
    """A seat and its pieces: a board, a hollowed board ("saddle"), a board with a cushion, or planks; metres."""
    taper = rng.uniform(0.0, 0.1) if half_width < 0.3 else 0.0
    board = rng.uniform(0.022, 0.038)
    if kind == "planks":
        seat = Seat(half_width, half_depth, top, board, 40.0, 0.0)
        return seat, _planks(seat, int(rng.integers(3, 7)))
    padding = rng.uniform(0.035, 0.06) if kind == "cushion" else 0.0
    seat = Seat(half_width, half_depth, top, board + padding, exponent, taper)
    hollow = rng.uniform(0.005, 0.016) if kind == "saddle" else 0.0
    total = board + padding

    def shaped(vertices):
        x, y, z = vertices.T
        across, along = x / half_width, z / half_depth
        inner = np.clip(1 - across**2, 0, 1) * np.clip(1 - along**2, 0, 1)
        y = y - hollow * np.sqrt(inner) * (y > -0.4 * board)
        # the front edge rolls down a little
        y = y - 0.012 * np.clip(along - 0.55, 0, None) ** 2 / 0.2 * (half_width < 0.3)
        return np.stack([x * (1 + taper * along), y + top, z], axis=1)

    section = {"exponent": exponent, "n_around": 36}
    edge = 0.35 * board
    if not padding:
        profile = [
            (0.45, -board, 0.0),
            (0.85, -board, 0.0),
            (0.955, -board, 0.05),
            (0.985, -board + edge, 0.3),
            (1.0, -edge * 1.1, 0.7),
            (0.99, -edge * 0.4, 0.9),
            (0.97, 0.0, 1.0),
            (0.9, 0.0, 1.0),
            (0.72, 0.0, 1.0),
            (0.5, 0.0, 1.0),
            (0.25, 0.0, 1.0),
        ]
        return seat, [moved(cushion(profile, (half_width, half_depth), "seat", "seat", **section), shaped)]
    dome = rng.uniform(0.1, 0.3) * padding
    profile = [
        (0.45, -total, 0.0),
        (0.9, -total, 0.0),
        (0.95, -total + 0.1 * board, 0.1),
        (0.965, -padding - 0.2 * board, 0.3),
        (0.955, -padding, 0.36),
        (0.985, -0.85 * padding - dome * 0.5, 0.45),
        (1.0, -0.55 * padding - dome * 0.5, 0.65),
        (0.985, -0.28 * padding - dome * 0.5, 0.85),
        (0.94, -0.1 * padding - dome * 0.5, 0.95),
        (0.86, -0.42 * dome, 1.0),
        (0.68, -0.22 * dome, 1.0),
        (0.42, -0.06 * dome, 1.0),
        (0.2, 0.0, 1.0),
    ]
    return seat, [moved(cushion(profile, (half_width, half_depth), "seat", "seat", **section), shaped)]


def _planks(seat: Seat, count: int) -> list[Piece]:
    pitch = 2 * seat.half_depth / count
    pieces = []

    def address(vertices):
        x, y, z = vertices.T
        return np.stack(
            [
                0.5 + 0.5 * x / seat.half_width,
                0.5 + 0.5 * z / seat.half_depth,
                np.clip((y - seat.bottom) / seat.thickness, 0, 1),
            ],
            axis=1,
        )

    for k in range(count):
        z = -seat.half_depth + pitch * (k + 0.5)
        y = seat.top - 0.35 * seat.thickness
        path = curve([(-seat.half_width, y, z), (seat.half_width, y, z)], 3)
        half = np.tile([0.35 * seat.thickness, 0.5 * pitch - 0.006], (3, 1))
        pieces.append(sweep(path, half, (0, 1, 0), "seat", "seat", exponent=9, n_around=12, bevel=0.006))
    for x in (-0.78, 0.0, 0.78):
        under = y - 0.5 * seat.thickness
        path = curve([(x * seat.half_width, under, end * seat.half_depth) for end in (-0.97, 0.97)], 3)
        half = np.tile([0.32 * seat.thickness, 0.02], (3, 1))
        pieces.append(sweep(path, half, (0, 1, 0), "seat", "seat", exponent=9, n_around=12, bevel=0.004))
    return [readdressed(piece, address) for piece in pieces]


# ----------------------------------------------------------------------------------------------------------- legs


def _leg_profile(kind: str, half: Number, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float, int]:
    """(u, half sizes (m, 2), exponent, points around) of a leg from its top to its foot."""
    if kind == "turned":
        foot = rng.uniform(0.55, 0.8)
        vase = rng.uniform(1.25, 1.5)
        knots = [
            (0.0, 1.0),
            (0.1, 1.0),
            (0.14, 0.8),
            (0.17, 1.15),
            (0.2, 0.75),
            (0.34, vase),
            (0.56, 0.95),
            (0.62, 0.72),
            (0.66, 1.2),
            (0.7, 0.75),
            (0.8, 1.05),
            (1.0, foot),
        ]
        u = np.unique(np.concatenate([np.linspace(0, 1, 8), [k[0] for k in knots]]))
        radius = half * monotone(knots, u)[:, 0]
        return u, np.stack([radius, radius], axis=1), 2.0, 12
    u = np.linspace(0, 1, 8)
    tip = rng.uniform(0.5, 0.75) if kind != "straight" else rng.uniform(0.9, 1.0)
    size = half * (1 + (tip - 1) * u ** rng.uniform(1.0, 1.6))
    flat = rng.uniform(0.85, 1.15)
    round_one = kind == "round"
    return u, np.stack([size, size * (1.0 if round_one else flat)], axis=1), 2.0 if round_one else 8.0, 12


def make_legs(
    seat: Seat, rng: np.random.Generator, *, half: Number, spread: Number, stool: bool = False
) -> list[Piece]:
    """Four legs under a seat and what ties them together; ``half`` is their half thickness at the top (metres)."""
    kind = str(rng.choice(["straight", "square", "round", "turned", "sabre"], p=[0.18, 0.22, 0.28, 0.17, 0.15]))
    splay = {
        "straight": rng.uniform(0.0, 0.02),
        "square": rng.uniform(0.0, 0.05),
        "round": rng.uniform(0.03, 0.13),
        "turned": rng.uniform(0.02, 0.1),
        "sabre": rng.uniform(0.05, 0.1),
    }[kind]
    u, sizes, exponent, around = _leg_profile("square" if kind == "sabre" else kind, half, rng)
    pieces, feet, tops = [], {}, {}
    for end, q in (("front", 1.0), ("rear", -1.0)):
        margin = spread if seat.exponent < 4 else min(spread + 0.1, 1 - half / seat.half_width)
        deep = spread if seat.exponent < 4 else min(spread + 0.1, 1 - half / seat.half_depth)
        x, z = seat.inset(margin, q * deep)
        top = np.array([x, seat.bottom + 0.4 * min(seat.thickness, 0.03), z])
        foot = np.array([x + splay * (0.8 if kind != "straight" else 0.2), 0.0, z + q * splay])
        if end == "rear" and not stool:
            foot[2] -= rng.uniform(0.0, 0.05)
        bulge = splay * (0.5 if kind == "sabre" else 0.0)
        path = top + u[:, None] * (foot - top)
        path[:, 0] -= 0.4 * bulge * np.sin(np.pi * u)
        path[:, 2] -= q * bulge * np.sin(np.pi * u)
        tops[end], feet[end] = top, path
        leg = sweep(
            path, sizes, (1, 0, 0), "leg", f"leg {end} left", exponent=exponent, n_around=around, level=(0, -1, 0)
        )
        pieces += [leg, mirrored(leg, f"leg {end} right")]
    if stool and rng.random() < 0.4 and kind != "sabre":
        return pieces + [_foot_ring(feet, rng, half=half)]
    return pieces + _stretchers(seat, feet, rng, half=half, kind=kind)


def _foot_ring(paths, rng, *, half) -> Piece:
    """A ring tied to the four legs, a good hand's breadth above the floor."""
    height = rng.uniform(0.15, 0.24)
    x = np.mean([np.interp(-height, -path[:, 1], path[:, 0]) for path in paths.values()])
    z = np.mean([np.interp(-height, -path[:, 1], np.abs(path[:, 2])) for path in paths.values()])
    return torus((0, height, 0), (x * 1.414, z * 1.414), 0.45 * half, "leg", "foot ring")


def _stretchers(seat, paths, rng, *, half, kind) -> list[Piece]:
    """Rails between the legs; they count as leg.  An apron under the seat is a flat kind of stretcher."""
    pieces = []
    round_one = kind in ("round", "turned")
    layout = str(rng.choice(["none", "box", "H"], p=[0.4, 0.3, 0.3]))
    thin = half * rng.uniform(0.5, 0.7)

    def on_leg(end, height):
        path = paths[end]
        at = np.interp(-height, -path[:, 1], np.arange(len(path)))
        return np.array([np.interp(at, np.arange(len(path)), path[:, i]) for i in range(3)])

    def rail(start, stop, component, size, exponent=None, swell=0.0):
        path = curve([start, stop], 9)
        grow = 1 + swell * np.sin(np.pi * np.linspace(0, 1, 9))[:, None]
        exponent = exponent or (2.0 if round_one else 8.0)
        return sweep(path, np.array([size]) * grow, (0, 1, 0), "leg", component, exponent=exponent, n_around=12)

    flip = np.array([-1.0, 1, 1])
    low = rng.uniform(0.12, 0.24)
    swell = rng.uniform(0.1, 0.5) if round_one else 0.0
    if layout != "none":
        front, rear = on_leg("front", low), on_leg("rear", low)
        side = rail(rear, front, "stretcher left", (thin, thin), swell=swell)
        pieces += [side, mirrored(side, "stretcher right")]
        if layout == "H":
            middle = 0.5 * (front + rear)
            pieces.append(rail(middle, middle * flip, "stretcher middle", (thin, thin), swell=swell))
        else:
            raise_by = rng.uniform(0.02, 0.07)
            for end in ("front", "rear"):
                place = on_leg(end, low + raise_by)
                pieces.append(rail(place, place * flip, f"stretcher {end}", (thin, thin), swell=swell))
    if not round_one and seat.exponent > 4 and rng.random() < 0.75:
        deep = rng.uniform(0.018, 0.03)
        height = seat.bottom - 0.9 * deep
        front, rear = on_leg("front", height), on_leg("rear", height)
        side = rail(rear, front, "apron left", (deep, 0.5 * half), 10.0)
        pieces += [side, mirrored(side, "apron right")]
        for end, place in (("front", front), ("rear", rear)):
            pieces.append(rail(place, place * flip, f"apron {end}", (deep, 0.5 * half), 10.0))
    return pieces
