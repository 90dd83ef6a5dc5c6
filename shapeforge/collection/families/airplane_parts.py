"""What airplanes are made of: bodies lofted along z, lifting surfaces, engine pods, nozzles and propellers."""

from __future__ import annotations

import numpy as np

from shapeforge.collection.families.solids import (
    Number,
    Pair,
    Piece,
    Table,
    Vector,
    loft,
    monotone,
    revolve,
    square_ring,
    squircle,
    sweep,
)


def body(
    nose_z: Number,
    length: Number,
    stations: Table,
    scale: Number,
    *,
    part: str = "fuselage",
    component: str = "fuselage",
    exponents: Table = ((0.0, 2.0), (1.0, 2.0)),
    n_around: int = 24,
    n_along: int = 18,
    shift: Pair = (0.0, 0.0),
    inlet: Number = 0.0,
) -> Piece:
    """A body from its nose at ``nose_z`` backwards (-z).

    ``stations`` are (share of the length, half width, half height, height of the middle), the last three times
    ``scale``; ``exponents`` the roundness of the sections at shares of the length; ``inlet`` > 0 hollows the nose out
    to that share of the length.  Address: u from nose to tail, v across (1 is left), w up.
    """
    t = np.linspace(0, 1, n_along)
    # closer rings where the sections change quickly: a quarter of them go to the first seventh
    at = np.unique(np.concatenate([np.interp(t, [0, 0.3, 0.65, 1], [0, 0.15, 0.62, 1]), [s[0] for s in stations]]))
    at = at[np.concatenate([[True], np.diff(at) > 1e-3])]
    at[-1] = 1.0
    sizes = monotone(stations, at) * scale
    roundness = np.interp(at, *np.asarray(exponents, dtype=float).T)
    square = square_ring(n_around)
    section = np.stack([squircle(square, e) for e in roundness])
    rings = np.empty((len(at), n_around, 3))
    rings[..., 0] = shift[0] + sizes[:, :1] * section[..., 0]
    rings[..., 1] = shift[1] + sizes[:, 2:] + sizes[:, 1:2] * section[..., 1]
    rings[..., 2] = (nose_z - length * at)[:, None]
    address = np.empty(rings.shape)
    address[..., 0] = at[:, None]
    address[..., 1:] = 0.5 + 0.5 * square
    if inlet:
        rings, address = _hollowed(rings, address, inlet * length)
    return loft(rings, address, part, component)


def _hollowed(rings, address, depth):
    """The first ring continued inwards: a lip, then a duct of the given depth."""
    middle = rings[0].mean(axis=0)
    inner, places = [], []
    for shrink, back in ((0.35, 1.0), (0.82, 1.0), (0.86, 0.3), (0.93, 0.01)):
        inner.append(middle + shrink * (rings[0] - middle) + [0, 0, -back * depth])
        place = address[0].copy()
        place[:, 1:] = 0.5 + shrink * (place[:, 1:] - 0.5)
        places.append(place)
    return np.concatenate([inner, rings]), np.concatenate([places, address])


def aerofoil(n_chord: int, thickness: Number, camber: Number = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Section (n, 2) around a unit chord (0 leading edge), and its address (n, 2): v along the chord, w 1 on top.

    The four-digit series' thickness law, with a blunt trailing edge.
    """
    x = 0.5 * (1 - np.cos(np.linspace(0, np.pi, n_chord)))
    law = 0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4
    half = 5 * thickness * law
    line = 4 * camber * x * (1 - x)
    top, below = np.stack([x, line + half], axis=1), np.stack([x, line - half], axis=1)
    share = law / law.max()
    place_top, place_below = np.stack([x, 0.5 + 0.5 * share], axis=1), np.stack([x, 0.5 - 0.5 * share], axis=1)
    return np.concatenate([top, below[:0:-1]]), np.concatenate([place_top, place_below[:0:-1]])


def lifting_surface(
    root: Vector,
    span: Number,
    root_chord: Number,
    tip_chord: Number,
    sweep_angle: Number,
    dihedral: Number,
    part: str,
    component: str,
    *,
    thickness: Number = 0.1,
    kink: Number = 0.0,
    winglet: Number = 0.0,
    bow: Number = 0.0,
    n_span: int = 10,
    n_chord: int = 10,
) -> Piece:
    """A wing half or a tail surface going left (+x) from ``root``, the leading edge of its root section.

    Angles in radians; ``kink`` is the share of the span up to which the trailing edge runs straight out; ``winglet``
    a bent-up tip of that share of the span; ``bow`` lifts the tip by that share.  u runs along the span, v along the
    chord (0 leading edge), w through (1 on top).
    """
    s = np.concatenate([np.linspace(0, 0.985, n_span), [0.996, 1.0]])
    if kink:
        s = np.sort(np.concatenate([s, [kink]]))
    chord = root_chord + (tip_chord - root_chord) * s
    back = np.tan(sweep_angle) * span * s
    if kink:
        # inboard the trailing edge is nearly straight: more chord there, the taper starts at the kink
        outer = root_chord * 0.72 + (tip_chord - root_chord * 0.72) * np.clip((s - kink) / (1 - kink), 0, 1)
        chord = np.where(s < kink, root_chord + (0.72 - 1) * root_chord * s / kink, outer)
    # rounded tip
    tip = np.interp(s, [0.985, 0.996, 1.0], [1.0, 0.9, 0.72])
    thin = np.interp(s, [0.0, 0.985, 0.996, 1.0], [1.0, 0.85, 0.6, 0.25]) * thickness
    lean = np.full(len(s), float(dihedral))
    places = np.zeros((len(s), 3))
    step = np.diff(s, prepend=0.0) * span
    if winglet:
        start = 1 - 1.3 * winglet
        extra = np.linspace(start, 1.0, 7)
        s = np.sort(np.concatenate([s[s < start - 0.01], extra, [0.996]]))
        return _winglet_surface(root, span, root_chord, tip_chord, sweep_angle, dihedral, part, component,
                                s, thickness, kink, winglet, bow, n_chord)  # fmt: skip
    places[:, 0] = np.cumsum(step * np.cos(lean))
    places[:, 1] = np.cumsum(step * np.sin(lean)) + bow * span * s**2
    places[:, 2] = -back - 0.5 * chord * (1 - tip)
    return _surface(np.asarray(root, dtype=float) + places, chord * tip, thin, lean, s, part, component, n_chord)


def _winglet_surface(root, span, root_chord, tip_chord, sweep_angle, dihedral, part, component, s, thickness, kink,
                     winglet, bow, n_chord):  # fmt: skip
    start = 1 - 1.3 * winglet
    chord = root_chord + (tip_chord - root_chord) * s
    if kink:
        outer = root_chord * 0.72 + (tip_chord - root_chord * 0.72) * np.clip((s - kink) / (1 - kink), 0, 1)
        chord = np.where(s < kink, root_chord + (0.72 - 1) * root_chord * s / kink, outer)
    bent = np.clip((s - start) / (1 - start), 0, 1)
    chord = chord * (1 - 0.45 * bent)
    lean = dihedral + bent**0.6 * np.radians(72)
    step = np.diff(s, prepend=0.0) * span
    stretch = 1 + 0.5 * (bent > 0)
    places = np.zeros((len(s), 3))
    middle = 0.5 * (lean + np.concatenate([lean[:1], lean[:-1]]))
    places[:, 0] = np.cumsum(step * stretch * np.cos(middle))
    places[:, 1] = np.cumsum(step * stretch * np.sin(middle)) + bow * span * np.minimum(s, start) ** 2
    places[:, 2] = -np.tan(sweep_angle) * span * s - 0.35 * bent * tip_chord
    thin = np.interp(s, [0.0, start, 0.996, 1.0], [1.0, 0.8, 0.65, 0.3]) * thickness
    return _surface(np.asarray(root, dtype=float) + places, chord, thin, lean, s, part, component, n_chord)


def _surface(leading, chord, thickness, lean, s, part, component, n_chord) -> Piece:
    """Sections standing across a leading edge that leans by ``lean`` (radians from level)."""
    rings, address = [], []
    for k in range(len(s)):
        section, place = aerofoil(n_chord, float(thickness[k]), 0.012 if part == "wing" else 0.0)
        up = np.array([-np.sin(lean[k]), np.cos(lean[k]), 0.0])
        rings.append(leading[k] + chord[k] * (section[:, :1] * [0, 0, -1.0] + section[:, 1:] * up))
        address.append(np.concatenate([np.full((len(place), 1), s[k]), place], axis=1))
    return loft(np.array(rings), np.array(address), part, component)


def fin(
    root: Vector,
    height: Number,
    root_chord: Number,
    tip_chord: Number,
    sweep_angle: Number,
    component: str,
    *,
    lean: Number = 0.0,
    fillet: bool = False,
) -> Piece:
    """An upright surface from ``root`` (its leading edge at the body); ``lean`` radians outwards (left).

    ``fillet`` runs the leading edge out forward over the body.
    """
    s = np.concatenate([np.linspace(0, 0.98, 11), [0.993, 1.0]])
    chord = root_chord + (tip_chord - root_chord) * s
    tip = np.interp(s, [0.98, 0.993, 1.0], [1.0, 0.9, 0.75])
    thin = np.interp(s, [0.0, 0.98, 0.993, 1.0], [1.0, 0.9, 0.6, 0.25]) * 0.09
    places = np.stack([np.sin(lean) * height * s, np.cos(lean) * height * s, -np.tan(sweep_angle) * height * s], axis=1)
    places[:, 2] -= 0.5 * chord * (1 - tip)
    if fillet:
        forward = 0.35 * root_chord * np.clip(1 - s / 0.28, 0, 1) ** 2
        places[:, 2] += forward
        chord = chord + forward
    leading = np.asarray(root, dtype=float) + places
    return _surface(leading, chord * tip, thin, np.full(len(s), 0.5 * np.pi - lean), s, "fin", component, 10)


def pod(place: Vector, radius: Number, length: Number, component: str) -> Piece:
    """A jet engine: duct, lip, cowl, nozzle and its cone; ``place`` is the middle of the intake."""
    r = radius
    profile = [
        (0.16 * length, 0.12 * r),
        (0.2 * length, 0.8 * r),
        (0.04 * length, 0.83 * r),
        (0.005 * length, 0.88 * r),
        (0.0, 0.92 * r),
        (0.008 * length, 0.97 * r),
        (0.06 * length, 1.03 * r),
        (0.2 * length, 1.08 * r),
        (0.45 * length, 1.03 * r),
        (0.7 * length, 0.84 * r),
        (0.76 * length, 0.78 * r),
        (0.765 * length, 0.6 * r),
        (0.88 * length, 0.5 * r),
        (0.9 * length, 0.46 * r),
        (0.89 * length, 0.34 * r),
        (length, 0.05 * r),
    ]
    return revolve(profile, place, (0, 0, -1), "engine", component, n_around=20)


def nozzle(place: Vector, radius: Number, length: Number, component: str) -> Piece:
    """A fighter's exhaust: a petalled ring, open at the back."""
    r = radius
    profile = [(0.0, 0.8 * r), (0.02 * length, 1.08 * r), (0.35 * length, 1.1 * r), (0.75 * length, 0.95 * r),
               (length, 0.82 * r), (length, 0.76 * r), (0.6 * length, 0.7 * r), (0.4 * length, 0.3 * r)]  # fmt: skip
    return revolve(profile, place, (0, 0, -1), "engine", component, n_around=20)


def pylon(
    foot: Vector,
    top: Vector,
    chord: Number,
    component: str,
    *,
    part: str = "engine",
    slim: Number = 0.16,
) -> Piece:
    """A streamlined strut between two places, ``chord`` long in the direction of flight."""
    path = np.linspace(foot, top, 5)
    half = np.tile([0.5 * chord, 0.5 * chord * slim], (5, 1))
    return sweep(path, half, (0, 0, 1), part, component, exponent=2.4, n_around=12)


def propeller(place: Vector, radius: Number, spinner: Number, blades: int, component: str) -> list[Piece]:
    """A pointed spinner and flat blades, mirror images of each other left and right."""
    cone = [(0.0, 0.02), (0.08, 0.3), (0.3, 0.6), (0.65, 0.88), (1.0, 1.0), (1.25, 1.0), (1.3, 0.8)]
    tip = np.asarray(place, dtype=float) + [0, 0, 1.15 * spinner]
    profile = [(a * spinner, r * spinner) for a, r in cone]
    pieces = [revolve(profile, tip, (0, 0, -1), "engine", component, n_around=16, along=(0, 0.4))]
    middle = np.asarray(place, dtype=float) + [0, 0, 0.3 * spinner]
    u = np.linspace(0, 1, 9)
    width = monotone([(0, 0.05), (0.3, 0.085), (0.7, 0.08), (0.93, 0.055), (1, 0.028)], u)[:, 0] * radius
    half = np.stack([width, width * np.interp(u, [0, 1], [0.3, 0.12])], axis=1)
    for k in range(blades):
        angle = 0.5 * np.pi + 2 * np.pi * k / blades
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        path = middle + np.outer(0.5 * spinner + (radius - 0.5 * spinner) * u, out)
        side = np.cross(out, [0, 0, 1.0])
        pieces.append(sweep(path, half, side, "engine", component, n_around=8, along=(0.4, 1.0)))
    return pieces
