"""Backs (panels, pads, slats, spindles, ladders, hoops) and arms of chairs."""

from __future__ import annotations

import numpy as np

from shapeforge.collection.families.chair_frames import Back, Seat
from shapeforge.collection.families.solids import (
    Number,
    Piece,
    curve,
    cushion,
    mirrored,
    mirrored_across,
    moved,
    readdressed,
    sweep,
    unsquircle,
)

DEPTH = 0.06  # metres before and behind the sheet of a back that its address covers


def make_back(
    seat: Seat,
    rng: np.random.Generator,
    *,
    post: Number,
    wide: bool = False,
    kind: str = "",
    held: str = "",
) -> tuple[Back, list[Piece]]:
    """A back behind a seat.

    ``post`` is the half thickness of its posts (metres); ``kind`` shell, pad, slats, spindles, ladder, splat or hoop
    (drawn when empty); ``held`` posts, bracket or nothing (chosen to suit when empty).
    """
    if not kind:
        kinds = (
            ["slats", "spindles", "ladder", "panel"]
            if wide
            else ["shell", "pad", "panel", "slats", "spindles", "ladder", "splat", "hoop"]
        )
        kind = str(rng.choice(kinds))
    slender = kind in ("slats", "spindles", "ladder", "splat", "hoop", "panel")
    height = rng.uniform(0.38, 0.5) if wide or kind == "hoop" else rng.uniform(0.38, 0.58)
    rear = seat.half_width * (1 - seat.taper)
    half_width = rear - 1.2 * post if slender else rear * rng.uniform(0.86, 1.0)
    if seat.exponent < 4 and slender:
        half_width = 0.86 * rear
    wrap = 0.0 if wide else rng.uniform(0.0, 0.045) * (1.0 if slender else 1.3)
    foot_z = -seat.half_depth + max(post, 0.014)
    if seat.exponent < 4 and slender:
        # the posts stand inside the rounded plan, the middle of the back just inside its rear edge
        half_width = 0.8 * rear
        posts_z = -0.92 * seat.half_depth * _side_of(seat, 0.8 * seat.half_depth)
        foot_z = max(posts_z - wrap, foot_z)
        wrap = posts_z - foot_z
    if held == "bracket":
        foot_z = -seat.half_depth - 0.005
        height = rng.uniform(0.42, 0.62)
    back = Back(
        half_width=half_width,
        height=height,
        foot=(seat.top, foot_z),
        slant=np.radians(rng.uniform(4, 13)),
        bend=rng.uniform(0.0, 0.14),
        wrap=wrap,
        crown=0.0 if wide else float(rng.choice([0.0, rng.uniform(0.01, 0.08)])),
        flare=rng.uniform(-0.06, 0.1) if not wide else 0.0,
    )
    under = 0.5 * seat.thickness / height  # posts and shells reach down beside the seat by this share of the height
    if kind in ("shell", "pad", "panel"):
        low = {"bracket": rng.uniform(0.16, 0.3), "": 0.0}[held] if kind != "panel" else rng.uniform(0.2, 0.55)
        pieces = [_panel(back, kind, low, under, rng)]
        if kind == "panel":
            pieces += [_placed(back, p) for p in _posts(back, post, under, top=0.5 * (1 + low))]
        elif held == "bracket":
            pieces.append(_bracket(back, seat, low, rng))
        return back, pieces
    if kind == "hoop":
        return back, _hoop(back, under, rng)
    pieces = _posts(back, post, under, top=1.0)
    thin = 0.55 * post
    if kind == "ladder":
        count = int(rng.integers(2, 5))
        tall = rng.uniform(0.018, 0.032)
        for share in np.linspace(0.32 if count > 2 else 0.5, 1.0, count) - 1.1 * tall / height:
            pieces.append(_rail(back, share, tall, thin, rng))
        return back, [_placed(back, p) for p in pieces]
    crest, lower = rng.uniform(0.022, 0.045), rng.uniform(0.1, 0.24)
    top = 1 - 0.9 * crest / height
    pieces.append(_rail(back, top, crest, thin, rng))
    if kind != "spindles" or rng.random() < 0.5:
        pieces.append(_rail(back, lower, 0.016, thin, rng))
    else:
        lower = -0.2 * under
    if kind == "splat":
        pieces += _uprights(back, 1, lower, top, rng.uniform(0.05, 0.085), 0.006, 6.0, vase=rng.uniform(0.15, 0.45))
    elif kind == "slats":
        count = int(rng.integers(3, 6)) * (2 if wide else 1)
        width = back.half_width / count * rng.uniform(0.45, 0.62)
        pieces += _uprights(back, count, lower, top, width, 0.006, 7.0)
    else:
        count = int(rng.integers(5, 8)) * (2 if wide else 1)
        width = rng.uniform(0.0055, 0.008)
        pieces += _uprights(back, count, lower, top, width, width, 2.0, swell=rng.uniform(0.2, 0.7))
    return back, [_placed(back, p) for p in pieces]


def _placed(back: Back, piece: Piece) -> Piece:
    """A piece built in flat coordinates, addressed by them and bent into space."""

    def address(flat):
        x, h, d = flat.T
        return np.stack([0.5 + 0.5 * x / back.half_width, h / back.height, 0.5 + 0.5 * d / DEPTH], axis=1)

    return moved(readdressed(piece, address), back.place)


def _panel(back: Back, kind: str, low: Number, under: float, rng: np.random.Generator) -> Piece:
    """One sheet from ``low`` (share of the height) to the top: a shell goes down beside the seat."""
    exponent = rng.uniform(2.4, 4.5) if kind == "shell" else rng.uniform(3.5, 8)
    thick = rng.uniform(0.022, 0.04) if kind == "pad" else rng.uniform(0.006, 0.01)
    if kind == "pad" and low == 0.0:
        under *= 0.8
    bottom = (low if low else -under) * back.height
    middle, half = 0.5 * (bottom + back.height), 0.5 * (back.height - bottom)
    rim = 0.6 if kind == "pad" else 0.9
    profile = [
        (0.3, -thick, 0.0),
        (0.6, -thick, 0.0),
        (0.85, -0.96 * thick, 0.0),
        (0.95, -0.8 * thick * (rim + 0.25), 0.1),
        (0.985, -0.75 * rim * thick, 0.25),
        (1.0, -0.3 * rim * thick, 0.4),
        (1.0, 0.3 * rim * thick, 0.6),
        (0.985, 0.75 * rim * thick, 0.75),
        (0.95, 0.8 * thick * (rim + 0.25), 0.9),
        (0.85, 0.96 * thick, 1.0),
        (0.6, thick, 1.0),
        (0.3, thick, 1.0),
    ]
    flat = cushion(profile, (back.half_width, half), "back", "back", exponent=exponent, n_around=32)

    def address(vertices):
        x, d, h = vertices.T
        square = unsquircle(np.stack([x / back.half_width, h / half], axis=1), exponent)
        up = (middle + half * square[:, 1]) / back.height
        return np.stack([0.5 + 0.5 * square[:, 0], up, 0.5 + 0.5 * d / DEPTH], axis=1)

    def stand(vertices):
        x, d, h = vertices.T
        return back.place(np.stack([x, middle + h, d], axis=1))

    return moved(readdressed(flat, address), stand)


def _posts(back: Back, post: Number, under: Number, *, top: float) -> list[Piece]:
    """Two uprights at the sides, in flat coordinates."""
    h = np.linspace(-under * back.height, top * back.height, 8)
    path = np.stack([np.full(8, back.half_width), h, np.zeros(8)], axis=1)
    half = np.stack([np.linspace(0.95, 0.75, 8), np.linspace(0.95, 0.7, 8)], axis=1) * post
    one = sweep(path, half, (1, 0, 0), "back", "back", exponent=6.0, n_around=12, bevel=0.5 * post)
    return [one, mirrored_across(one, 0)]


def _rail(back: Back, share: Number, tall: float, thin: float, rng: np.random.Generator) -> Piece:
    path = curve([(-back.half_width, share * back.height, 0), (back.half_width, share * back.height, 0)], 9)
    grow = 1 + 0.25 * np.sin(np.pi * np.linspace(0, 1, 9))
    half = np.stack([tall * grow, np.full(9, thin)], axis=1)
    return sweep(path, half, (0, 1, 0), "back", "back", exponent=6.0, n_around=12)


def _uprights(back, count, low, top, width, thin, exponent, *, vase=0.0, swell=0.0) -> list[Piece]:
    """Slats or spindles between two heights (shares), evenly spread and mirror images of each other."""
    places = (np.arange(count) - 0.5 * (count - 1)) * 2 / (count + 0.15) * back.half_width
    n = 11 if vase else 7
    u = np.linspace(0, 1, n)
    pieces = []
    for x in places:
        shape = 1 + vase * np.sin(2 * np.pi * u) + swell * np.sin(np.pi * u)
        half = np.stack([width * shape, np.full(n, thin) * (shape if swell else 1)], axis=1)
        path = np.stack([np.full(n, x), (low + (top - low) * u) * back.height, np.zeros(n)], axis=1)
        around = 8 if exponent == 2.0 else 12
        pieces.append(sweep(path, half, (1, 0, 0), "back", "back", exponent=exponent, n_around=around))
    return pieces


def _hoop(back: Back, under: Number, rng: np.random.Generator) -> list[Piece]:
    """A bent hoop with spindles, as Windsor chairs have."""
    spring = rng.uniform(0.3, 0.5)
    angle = np.linspace(0, np.pi, 25)
    arch = np.stack([np.cos(angle), spring + (1 - spring) * np.sin(angle)], axis=1)
    straight = np.linspace(-under, spring, 5)[:-1]
    right = np.stack([np.ones(4), straight], axis=1)
    outline = np.concatenate([right, arch, (right * [-1, 1])[::-1]])
    path = np.stack([outline[:, 0] * back.half_width, outline[:, 1] * back.height, 0 * outline[:, 0]], axis=1)
    half = np.full((len(path), 2), rng.uniform(0.0095, 0.013))
    pieces = [sweep(path, half, (0, 0, 1), "back", "back", n_around=12, bevel=0.004)]
    count = int(rng.integers(5, 8))
    width = rng.uniform(0.005, 0.007)
    swell = rng.uniform(0.2, 0.7)
    for one in _uprights(back, count, 0.0, 1.0, width, width, 2.0, swell=swell):
        x = one.vertices[:, 0].mean()
        top = spring + (1 - spring) * np.sqrt(1 - (x / back.half_width) ** 2)
        scale = np.array([1.0, top + under * 0.3, 1.0])
        lift = np.array([0.0, -0.3 * under * back.height, 0.0])
        pieces.append(moved(one, lambda v, scale=scale, lift=lift: v * scale + lift))
    return [_placed(back, p) for p in pieces]


def _bracket(back: Back, seat: Seat, low: Number, rng: np.random.Generator) -> Piece:
    """The bent bar that carries the back of a swivel chair from under its seat."""
    behind = back.place(np.array([[0, (low + 0.16) * back.height, -0.02], [0, 0.4 * low * back.height, -0.045]]))
    path = curve(
        [(0, seat.bottom - 0.008, -0.3 * seat.half_depth), (0, seat.bottom - 0.01, -0.8 * seat.half_depth),
         (0, seat.bottom + 0.035, -seat.half_depth - 0.05), behind[1], behind[0]],
        21,
    )  # fmt: skip
    half = np.tile([rng.uniform(0.025, 0.04), 0.007], (21, 1))
    bar = sweep(path, half, (1, 0, 0), "back", "back", exponent=5.0, n_around=12, bevel=0.004)
    # it hangs below the back's own sheet, so it keeps its place in the frame only: v = 0 .. low
    return readdressed(
        bar,
        lambda v: np.stack(
            [0.5 + 0.5 * v[:, 0] / back.half_width, (v[:, 1] - seat.top) / back.height, np.full(len(v), 0.1)], axis=1
        ),
    )


# ----------------------------------------------------------------------------------------------------------- arms


def make_arms(seat: Seat, back: Back, rng: np.random.Generator, *, kind: str = "") -> list[Piece]:
    """Left and right arms.  Address u: 0 at the back, .6 at the front of the armrest, 1 at the foot of its support."""
    kind = kind or str(rng.choice(["rail", "loop", "paddle"], p=[0.4, 0.3, 0.3]))
    high = rng.uniform(0.18, 0.24)
    out = rng.uniform(0.015, 0.05)
    share = high / back.height
    start = back.place(np.array([[0.97 * back.half_width, share * back.height, 0.0]]))[0]
    reach = seat.half_depth * rng.uniform(0.45, 0.85)
    x_front = max(seat.half_width * (1 + seat.taper), start[0]) + out
    front = np.array([x_front, start[1] + rng.uniform(-0.015, 0.01), reach])
    foot = np.array([seat.inset(0.93, 0.4)[0], seat.bottom + 0.5 * seat.thickness, 0.75 * reach])
    foot[0] = seat.half_width * (1 + seat.taper * foot[2] / seat.half_depth) * _side_of(seat, foot[2])
    component, pieces = "arm left", []
    if kind == "loop":
        bow = front + [0.0, -0.004, -0.05]
        path = curve([start, 0.5 * (start + front) + [0.3 * out, 0.004, 0], bow, front + [0, -0.045, 0.012],
                      0.5 * (front + foot) + [0, -0.01, 0.0], foot + [-0.01, -0.005, 0]], 25)  # fmt: skip
        radius = rng.uniform(0.011, 0.016)
        half = np.stack([np.full(25, radius * rng.uniform(1.0, 1.5)), np.full(25, radius)], axis=1)
        pieces.append(sweep(path, half, (1, 0, 0), "arm", component, exponent=3.0, n_around=12, bevel=0.006))
    else:
        middle = 0.5 * (start + front) + [0.4 * out, -0.012, 0]
        path = curve([start - [0, 0, 0.008], middle, front], 13)
        if kind == "pad":
            path = curve([front * [1, 1, 0] + [0.0, 0, -0.55 * reach], front + [0, 0, -0.1 * reach]], 7)
        u = np.linspace(0, 1, len(path))
        broad = rng.uniform(0.02, 0.03)
        widen = {"rail": 0.7 + 0.35 * u**2, "paddle": 0.75 + 0.75 * u**3, "pad": np.full(len(u), 1.25)}[kind]
        half = np.stack([broad * widen, np.full(len(u), 0.011 if kind != "pad" else 0.014)], axis=1)
        pieces.append(
            sweep(path, half, (1, 0, 0), "arm", component, exponent=4.0, bevel=0.011, n_around=12, along=(0, 0.6))
        )
        support_top = path[9] if kind != "pad" else path[len(path) // 2 + 1]
        if kind == "pad":
            under = np.array([0.4 * seat.half_width, seat.bottom - 0.004, support_top[2]])
            corner = np.array([support_top[0] + 0.005, seat.bottom + 0.01, support_top[2]])
            path = curve([support_top, corner + [0.004, 0.09, 0], corner + [-0.03, -0.014, 0], under], 15)
            half = np.tile([0.022, 0.008], (15, 1))
            pieces.append(sweep(path, half, (0, 0, 1), "arm", component, exponent=4.0, along=(0.6, 1.0)))
        else:
            lean = foot + [-0.012, -0.4 * seat.thickness, rng.uniform(-0.01, 0.03)]
            path = curve([support_top, 0.5 * (support_top + lean) + [0.006, 0, 0.008], lean], 13)
            thick = rng.uniform(0.01, 0.014)
            half = thick * (1 + 0.25 * np.sin(np.pi * np.linspace(0, 1, 13)))[:, None] * np.ones((1, 2))
            round_one = 2.0 if rng.random() < 0.6 else 6.0
            pieces.append(sweep(path, half, (1, 0, 0), "arm", component, exponent=round_one, along=(0.6, 1.0)))
    return pieces + [mirrored(p, "arm right") for p in pieces]


def _side_of(seat: Seat, z: Number) -> float:
    """Share of the half width at which a rounded seat ends at depth z."""
    return float((1 - min(abs(z) / seat.half_depth, 0.999) ** seat.exponent) ** (1 / seat.exponent))
