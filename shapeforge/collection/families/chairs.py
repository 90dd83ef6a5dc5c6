"""Chairs: side chairs, armchairs, benches, stools and swivel chairs, in metres, y up, front +z, floor at y = 0.

What differs continuously (heights, tapers, slants, curvatures) and what differs in kind (how the back is filled, how
the legs are made) is drawn once per chair into plain numbers; the rest is joinery.
"""

from __future__ import annotations

import numpy as np

from shapeforge.collection.families.chair_backs import make_arms, make_back
from shapeforge.collection.families.chair_frames import make_legs, make_seat
from shapeforge.collection.families.solids import Piece, curve, mirrored, revolve, sweep

PARTS = ("back", "seat", "leg", "arm", "column", "base")
CLASSES = ("side", "armchair", "bench", "stool", "swivel")

COMPONENTS = (
    "back",
    "seat",
    *(f"leg {end} {side}" for end in ("front", "rear") for side in ("left", "right")),
    *(f"{kind} {where}" for kind in ("stretcher", "apron") for where in ("left", "right", "front", "rear", "middle")),
    "foot ring",
    "arm left",
    "arm right",
    "column",
    "base hub",
    *(f"base spoke {k}" for k in range(1, 6)),
    *(f"castor {k}" for k in range(1, 6)),
)

# landmark: (component, address); left is +x, u of the back and the seat runs from right (0) to left (1)
LANDMARKS = {
    **{
        f"leg_tip_{end}_{side}": (f"leg {end} {side}", (1.0, 0.5, 0.5))
        for end in ("front", "rear")
        for side in ("left", "right")
    },
    "seat_front_left": ("seat", (1.0, 1.0, 1.0)),
    "seat_front_right": ("seat", (0.0, 1.0, 1.0)),
    "seat_rear_left": ("seat", (1.0, 0.0, 1.0)),
    "seat_rear_right": ("seat", (0.0, 0.0, 1.0)),
    "seat_centre": ("seat", (0.5, 0.5, 1.0)),
    "back_top_left": ("back", (1.0, 1.0, 0.5)),
    "back_top_right": ("back", (0.0, 1.0, 0.5)),
    "back_top_middle": ("back", (0.5, 1.0, 0.5)),
    **{
        f"arm_{end}_{side}": (f"arm {side}", (u, 0.5, 0.5))
        for end, u in (("rear", 0.0), ("front", 0.55))
        for side in ("left", "right")
    },
    "column_top": ("column", (0.0, 0.5, 0.5)),
    "base_centre": ("base hub", (0.5, 0.5, 0.5)),
    **{f"base_tip_{k}": (f"base spoke {k}", (1.0, 0.5, 0.5)) for k in range(1, 6)},
}


def build_chair(fine_class: str, rng: np.random.Generator) -> list[Piece]:
    """The pieces of one chair of the given fine class."""
    if fine_class == "swivel":
        return _swivel_chair(rng)
    if fine_class == "stool":
        return _stool(rng)
    wide = fine_class == "bench"
    seat, pieces = make_seat(
        rng,
        half_width=rng.uniform(0.48, 0.78) if wide else rng.uniform(0.2, 0.255),
        half_depth=rng.uniform(0.18, 0.23) if wide else rng.uniform(0.195, 0.235),
        top=rng.uniform(0.41, 0.49),
        kind=rng.choice(["board", "cushion", "planks"] if wide else ["board", "cushion", "saddle"]),
        exponent=rng.uniform(9, 14) if wide else rng.choice([rng.uniform(2.1, 3.2), rng.uniform(4, 12)], p=[0.3, 0.7]),
    )
    has_back = not wide or rng.random() < 0.75
    with_arms = fine_class == "armchair" or (wide and has_back and rng.random() < 0.5)
    leg_half = rng.uniform(0.014, 0.024) * (1.25 if wide else 1)
    pieces += make_legs(seat, rng, half=leg_half, spread=0.9 if wide else 0.82)
    if has_back:
        back, made = make_back(seat, rng, post=leg_half, wide=wide)
        pieces += made
        if with_arms:
            pieces += make_arms(seat, back, rng)
    return pieces


def _swivel_chair(rng: np.random.Generator) -> list[Piece]:
    seat, pieces = make_seat(
        rng,
        half_width=rng.uniform(0.225, 0.265),
        half_depth=rng.uniform(0.215, 0.25),
        top=rng.uniform(0.44, 0.54),
        kind="cushion",
        exponent=rng.uniform(2.6, 6),
    )
    back, made = make_back(seat, rng, post=0.02, kind=str(rng.choice(["pad", "shell"], p=[0.75, 0.25])), held="bracket")
    pieces += made
    if rng.random() < 0.6:
        pieces += make_arms(seat, back, rng, kind="pad")
    reach = rng.uniform(0.27, 0.34)
    wheel = rng.uniform(0.024, 0.031)
    hub = 2 * wheel + rng.uniform(0.025, 0.05)
    return pieces + _column(seat.bottom, hub, rng) + _star(hub, reach, wheel, rng)


def _column(top: Number, hub: float, rng: np.random.Generator) -> list[Piece]:
    """A plate under the seat and a two-stage gas lift down into the hub."""
    wide, thin = rng.uniform(0.026, 0.034), rng.uniform(0.014, 0.02)
    step = (top - hub) * rng.uniform(0.35, 0.6)
    length = top - hub
    plate = rng.uniform(0.07, 0.11)
    profile = [
        (0.0, plate * 0.6),
        (0.0, plate),
        (0.012, plate),
        (0.016, plate * 0.96),
        (0.03, 1.6 * thin),
        (0.034, thin),
        (step * 0.6, thin),
        (step - 0.003, thin),
        (step, wide * 0.9),
        (step + 0.004, wide),
        (0.5 * (step + length), wide),
        (length - 0.01, wide),
        (length + 0.01, wide * 1.05),
    ]
    profile = [(min(a, length + 0.01), r) for a, r in profile]
    return [revolve(profile, (0, top + 0.004, 0), (0, -1, 0), "column", "column")]


def _star(hub: Number, reach: float, wheel: float, rng: np.random.Generator) -> list[Piece]:
    """Hub, five spokes (the first points to the front, 2 and 5, 3 and 4 are mirror images) and their castors."""
    r = rng.uniform(0.038, 0.05)
    body = [(0.0, 0.6 * r), (0.0, 0.85 * r), (0.006, 0.95 * r), (0.03, r), (0.045, 0.97 * r), (0.05, 0.7 * r)]
    pieces = [revolve(body, (0, hub + 0.012, 0), (0, -1, 0), "base", "base hub")]
    drop = hub - 2 * wheel - 0.006
    broad, slim = rng.uniform(0.021, 0.03), rng.uniform(0.012, 0.018)
    arch = rng.uniform(0.0, 0.012)
    castors = rng.random() < 0.8
    for k in range(3):
        angle = np.pi / 2 - 2 * np.pi * k / 5
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        if k == 0:
            out[0] = 0.0
        path = curve(
            [
                out * 0.02 + [0, hub - 0.012, 0],
                out * 0.5 * reach + [0, hub - 0.012 - 0.5 * drop + arch, 0],
                out * reach + [0, hub - 0.012 - drop, 0],
            ],
            7,
        )
        u = np.linspace(0, 1, 7)
        half = np.stack([broad + (slim - broad) * u, 0.017 + (0.009 - 0.017) * u], axis=1)
        side = np.cross([0, 1, 0], out)
        spoke = sweep(path, half, side, "base", f"base spoke {k + 1}", exponent=4.5, n_around=12, bevel=0.008)
        made = [spoke]
        place = path[-1] - out * 0.012
        if castors:
            barrel = [(a * 0.024, wheel * s) for a, s in _BARREL]
            middle = np.array([place[0], wheel, place[2]])
            for half_wheel in (-1, 1):
                origin = middle + half_wheel * 0.004 * side
                made.append(revolve(barrel, origin, half_wheel * side, "base", f"castor {k + 1}", n_around=12))
            stem = [(0.0, 0.008), (place[1] - wheel, 0.008)]
            made.append(revolve(stem, middle, (0, 1, 0), "base", f"castor {k + 1}", n_around=8))
        else:
            glide = [(0.0, 0.014), (0.004, 0.017), (0.012, 0.014), (place[1], 0.011)]
            origin = (place[0], 0.0, place[2])
            made.append(revolve(glide, origin, (0, 1, 0), "base", f"castor {k + 1}", n_around=12))
        pieces += made
        if k:
            pieces += [mirrored(p, p.component[:-1] + str(6 - k)) for p in made]
    return pieces


_BARREL = ((0.0, 0.95), (0.12, 1.0), (0.6, 1.0), (0.9, 0.88), (1.0, 0.55))


def _stool(rng: np.random.Generator) -> list[Piece]:
    round_one = rng.random() < 0.5
    half = rng.uniform(0.15, 0.2)
    seat, pieces = make_seat(
        rng,
        half_width=half,
        half_depth=half * (1.0 if round_one else rng.uniform(0.8, 1.0)),
        top=rng.uniform(0.43, 0.75),
        kind=str(rng.choice(["board", "cushion", "saddle"], p=[0.4, 0.4, 0.2])),
        exponent=2.0 if round_one else rng.uniform(4, 12),
    )
    if rng.random() < 0.15:
        return pieces + _column(seat.bottom, 0.03, rng) + _disc(rng.uniform(0.17, 0.22), rng)
    return pieces + make_legs(seat, rng, half=rng.uniform(0.014, 0.02), spread=0.75, stool=True)


def _disc(radius: Number, rng: np.random.Generator) -> list[Piece]:
    high = rng.uniform(0.03, 0.05)
    rim = 0.012
    profile = [
        (0.0, 0.045),
        (0.25 * high, 0.05),
        (high - rim, 0.55 * radius),
        (high - rim + 0.002, 0.93 * radius),
        (high - 0.6 * rim, 0.985 * radius),
        (high - 0.2 * rim, radius),
        (high, 0.99 * radius),
        (high, 0.6 * radius),
    ]
    return [revolve(profile, (0, high, 0), (0, -1, 0), "base", "base hub", n_around=32)]
