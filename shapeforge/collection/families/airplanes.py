"""Airplanes: airliners, fighters, propeller craft and gliders, in metres, y up, nose +z, left wing +x.

Each class draws its proportions into plain numbers; four makers (body, lifting surface, pod, propeller) do the rest.
"""

from __future__ import annotations

import numpy as np

from shapeforge.collection.families.airplane_parts import (
    body,
    fin,
    lifting_surface,
    nozzle,
    pod,
    propeller,
    pylon,
)
from shapeforge.collection.families.solids import Piece, mirrored

PARTS = ("fuselage", "wing", "tailplane", "fin", "engine")
CLASSES = ("airliner", "fighter", "propeller", "glider")
COMPONENTS = (
    "fuselage",
    "canopy",
    "wing left",
    "wing right",
    "strut left",
    "strut right",
    "tailplane left",
    "tailplane right",
    "fin",
    "fin left",
    "fin right",
    *(f"{kind} {where}" for kind in ("engine", "outer engine", "pylon", "outer pylon") for where in ("left", "right")),
    *(f"{kind} {where}" for kind in ("intake", "nozzle", "propeller") for where in ("left", "right")),
    "nozzle",
    "cowling",
    "propeller",
)

LANDMARKS = {
    "nose": ("fuselage", (0.0, 0.5, 0.5)),
    "tail": ("fuselage", (1.0, 0.5, 0.5)),
    **{
        f"{kind}_{mark}_{side}": (f"{kind} {side}", address)
        for side in ("left", "right")
        for kind, mark, address in (
            ("wing", "tip", (1.0, 0.3, 0.5)),
            ("wing", "tip_rear", (1.0, 1.0, 0.5)),
            ("wing", "root_front", (0.12, 0.0, 0.5)),
            ("wing", "root_rear", (0.12, 1.0, 0.5)),
            ("tailplane", "tip", (1.0, 0.3, 0.5)),
            ("engine", "front", (0.3, 0.5, 1.0)),
            ("outer engine", "front", (0.3, 0.5, 1.0)),
        )
    },
    "fin_tip": ("fin", (1.0, 0.3, 0.5)),
    "fin_tip_left": ("fin left", (1.0, 0.3, 0.5)),
    "fin_tip_right": ("fin right", (1.0, 0.3, 0.5)),
    "spinner": ("propeller", (0.0, 0.5, 0.5)),
}
LANDMARKS = {name.replace(" ", "_"): place for name, place in LANDMARKS.items()}


def build_airplane(fine_class: str, rng: np.random.Generator) -> list[Piece]:
    """The pieces of one airplane of the given fine class."""
    makers = {"airliner": _airliner, "fighter": _fighter, "propeller": _propeller_craft, "glider": _glider}
    return makers[fine_class](rng)


def _both(piece: Piece) -> list[Piece]:
    return [piece, mirrored(piece, piece.component.replace("left", "right"))]


def _tail(
    rng, *, kind, z, y, fuselage_half, chord, span, fin_height, sweep, thickness=0.09, dihedral=0.1
) -> list[Piece]:
    """Tailplane and fin(s) around station z, where the body is 2 ``fuselage_half`` wide and its middle is at y."""
    taper = rng.uniform(0.4, 0.65)
    if kind == "V":
        lean = np.radians(rng.uniform(38, 50))
        half = lifting_surface(
            (0.2 * fuselage_half, y, z), 0.75 * span, chord, chord * taper, sweep, lean, "tailplane", "tailplane left",
            thickness=thickness,
        )  # fmt: skip
        return _both(half)
    pieces = []
    fin_chord = chord * rng.uniform(1.15, 1.45)
    fin_sweep = np.radians(rng.uniform(8, 25)) + 0.8 * sweep
    fin_taper = 0.75 if kind == "T" else rng.uniform(0.35, 0.6)
    if kind == "twin":
        lean = np.radians(rng.uniform(0, 20))
        upright = fin(
            (0.85 * fuselage_half, y + 0.1 * fuselage_half, z + 0.25 * fin_chord), 0.8 * fin_height, 0.9 * fin_chord,
            0.9 * fin_chord * fin_taper, fin_sweep, "fin left", lean=lean,
        )  # fmt: skip
        pieces += _both(upright)
    else:
        pieces.append(
            fin((0, y, z + 0.3 * chord), fin_height, fin_chord, fin_chord * fin_taper, fin_sweep, "fin", fillet=True)
        )
    root = np.array([0.0, y, z])
    if kind == "T":
        root = np.array([0.0, y + 0.97 * fin_height, z + 0.3 * chord - np.tan(fin_sweep) * 0.97 * fin_height])
        dihedral *= 0.2
    pieces += _both(
        lifting_surface(root, span, chord, chord * taper, sweep, dihedral, "tailplane", "tailplane left",
                        thickness=thickness)
    )  # fmt: skip
    return pieces


def _airliner(rng: np.random.Generator) -> list[Piece]:
    radius = 1.0
    length = rng.uniform(15, 25)
    tail_engines = rng.random() < 0.35
    nose_z = 0.5 * length
    pieces = [
        body(
            nose_z,
            length,
            [
                # share of the length, half width, half height, height of the middle
                (0.0, 0.02, 0.02, -0.28),
                (0.004, 0.17, 0.16, -0.27),
                (0.016, 0.37, 0.33, -0.24),
                (0.04, 0.64, 0.58, -0.17),
                (0.07, 0.83, 0.8, -0.09),
                (0.11, 0.96, 0.95, -0.02),
                (0.15, 1.0, 1.0, 0.0),
                (0.62, 1.0, 1.0, 0.0),
                (0.72, 0.93, 0.92, 0.07),
                (0.82, 0.7, 0.72, 0.25),
                (0.91, 0.42, 0.47, 0.44),
                (0.975, 0.17, 0.22, 0.6),
                (1.0, 0.06, 0.07, 0.66),
            ],
            radius,
        )
    ]
    span = length * rng.uniform(0.42, 0.52)
    sweep = np.radians(rng.uniform(20, 36))
    chord = span * rng.uniform(0.3, 0.38)
    dihedral = np.radians(rng.uniform(4, 7))
    root = np.array([0.0, -0.5 * radius, nose_z - length * (rng.uniform(0.36, 0.4) + 0.06 * tail_engines)])
    winglet = rng.uniform(0.04, 0.09) if rng.random() < 0.6 else 0.0
    pieces += _both(
        lifting_surface(root, span, chord, chord * rng.uniform(0.2, 0.3), sweep, dihedral, "wing", "wing left",
                        kink=rng.uniform(0.28, 0.38), winglet=winglet, thickness=0.12)
    )  # fmt: skip
    tail_kind = "T" if tail_engines or rng.random() < 0.15 else "conventional"
    pieces += _tail(
        rng, kind=tail_kind, z=nose_z - 0.87 * length, y=0.4 * radius, fuselage_half=0.4 * radius,
        chord=chord * rng.uniform(0.4, 0.5), span=span * rng.uniform(0.3, 0.38),
        fin_height=(rng.uniform(0.14, 0.18) if tail_kind == "conventional" else rng.uniform(0.13, 0.16)) * length + 0.4,
        sweep=np.radians(rng.uniform(25, 38)),
    )  # fmt: skip
    if tail_engines:
        size = radius * rng.uniform(0.34, 0.46)
        z = nose_z - length * rng.uniform(0.68, 0.72)
        place = np.array([0.88 * radius + 1.3 * size, 0.42 * radius, z])
        pieces += _both(pod(place, 0.9 * size, 4.6 * size, "engine left"))
        inside = np.array([0.5 * radius, place[1], place[2] - size])
        pieces += _both(pylon(inside, place + [0, 0, -size], 2.2 * size, "pylon left"))
        return pieces
    four = length > 20 and rng.random() < 0.4
    size = radius * (rng.uniform(0.42, 0.55) if four else rng.uniform(0.52, 0.7))
    for prefix, share, smaller in (("", 0.33, 1.0), ("outer ", 0.62, 0.92))[: 2 if four else 1]:
        share += rng.uniform(-0.03, 0.03)
        r = size * smaller
        leading = root + [share * span, share * span * np.tan(dihedral), -share * span * np.tan(sweep)]
        place = leading + [0, -1.35 * r, 1.55 * r]
        pieces += _both(pod(place, r, 3.6 * r, f"{prefix}engine left"))
        above = leading + [0, 0.0, -0.08 * chord]
        pieces += _both(pylon(place + [0, 0.7 * r, -1.2 * r], above + [0, 0.02, 0], 2.6 * r, f"{prefix}pylon left"))
    return pieces


def _fighter(rng: np.random.Generator) -> list[Piece]:
    length = rng.uniform(13, 17)
    nose_z = 0.5 * length
    wide = rng.uniform(0.85, 1.15)
    twin_engine = rng.random() < 0.5
    broad = (1.35 if twin_engine else 1.0) * wide
    rear = 0.8 * broad if twin_engine else 0.68
    pieces = [
        body(
            nose_z,
            length,
            [
                (0.0, 0.012, 0.012, -0.12),
                (0.03, 0.1, 0.1, -0.11),
                (0.1, 0.28, 0.29, -0.08),
                (0.2, 0.46, 0.5, -0.03),
                (0.32, 0.62, 0.64, 0.0),
                (0.46, 0.9 * broad, 0.68, 0.0),
                (0.7, broad, 0.66, 0.0),
                (0.88, 0.92 * broad, 0.58, 0.02),
                (0.965, rear, 0.5, 0.03),
                (1.0, 0.96 * rear, 0.46, 0.03),
            ],
            1.0,
            exponents=[(0.0, 2.0), (0.3, 2.1), (0.5, 2.9), (0.9, 2.9), (1.0, 2.4)],
        )
    ]
    pieces.append(
        body(
            nose_z - 0.17 * length,
            0.22 * length,
            [(0, 0.01, 0.01, 0.28), (0.06, 0.12, 0.14, 0.33), (0.25, 0.3, 0.38, 0.42), (0.45, 0.35, 0.46, 0.45),
             (0.7, 0.3, 0.38, 0.42), (0.92, 0.14, 0.18, 0.36), (1.0, 0.02, 0.03, 0.33)],
            1.0, component="canopy", n_around=16, n_along=14,
        )
    )  # fmt: skip
    delta = rng.random() < 0.4
    span = length * (rng.uniform(0.28, 0.34) if delta else rng.uniform(0.3, 0.38))
    sweep = np.radians(rng.uniform(46, 58) if delta else rng.uniform(26, 44))
    chord = length * rng.uniform(0.4, 0.46) if delta else length * rng.uniform(0.27, 0.32)
    taper = rng.uniform(0.06, 0.14) if delta else rng.uniform(0.22, 0.38)
    z_wing = nose_z - length * (rng.uniform(0.4, 0.45) if delta else rng.uniform(0.42, 0.48))
    y_wing = rng.uniform(-0.1, 0.25)
    pieces += _both(
        lifting_surface((0.0, y_wing, z_wing), span, chord, chord * taper, sweep, np.radians(rng.uniform(-4, 2)),
                        "wing", "wing left", thickness=0.055)
    )  # fmt: skip
    twin_fin = twin_engine and rng.random() < 0.75
    fin_chord = length * rng.uniform(0.15, 0.19)
    if delta and rng.random() < 0.65:
        height = length * rng.uniform(0.15, 0.19)
        pieces.append(fin((0, 0.3, nose_z - 0.74 * length), height, 1.35 * fin_chord, 0.45 * fin_chord,
                          np.radians(rng.uniform(42, 52)), "fin"))  # fmt: skip
    else:
        pieces += _tail(
            rng, kind="twin" if twin_fin else "conventional", z=nose_z - 0.86 * length, y=0.1, fuselage_half=0.8 * rear,
            chord=fin_chord, span=length * rng.uniform(0.19, 0.23), fin_height=length * rng.uniform(0.15, 0.2),
            sweep=np.radians(rng.uniform(35, 48)), thickness=0.05, dihedral=rng.uniform(-0.08, 0.02),
        )  # fmt: skip
    r = rng.uniform(0.4, 0.46)
    if twin_engine:
        place = (0.5 * rear, 0.03, nose_z - 0.965 * length)
        pieces += _both(nozzle(place, r * 0.98, rng.uniform(0.9, 1.2), "nozzle left"))
    else:
        pieces.append(nozzle((0, 0.03, nose_z - 0.96 * length), r * 1.12, rng.uniform(0.9, 1.3), "nozzle"))
    intake = body(
        nose_z - rng.uniform(0.29, 0.35) * length,
        0.26 * length,
        [(0, 0.2, 0.36, 0.0), (0.015, 0.23, 0.4, 0.0), (0.3, 0.26, 0.43, 0.0), (0.75, 0.22, 0.4, 0.0),
         (1.0, 0.08, 0.25, 0.0)],
        1.0, component="intake left", part="engine", n_around=16, n_along=10, exponents=[(0, 5.0), (1, 4.0)],
        shift=(0.62 * min(1.0, wide) + 0.1, rng.uniform(-0.2, 0.02)), inlet=0.3,
    )  # fmt: skip
    return pieces + _both(intake)


def _propeller_craft(rng: np.random.Generator) -> list[Piece]:
    length = rng.uniform(6.5, 9.5)
    nose_z = 0.5 * length
    wing_engines = rng.random() < 0.4
    half = length * rng.uniform(0.07, 0.085)
    tall = half * rng.uniform(1.05, 1.25)
    high_wing = rng.random() < 0.5
    front = (0.02, 0.02) if wing_engines else (0.62, 0.6)
    second = (0.4, 0.4) if wing_engines else (0.72, 0.68)
    stations = [
        (0.0, front[0] * half, front[1] * half, -0.1 * tall),
        (0.03 if wing_engines else 0.015, second[0] * half, second[1] * half, -0.1 * tall),
        (0.14, 0.85 * half, 0.8 * half, -0.08 * tall),
        (0.24, 0.98 * half, 0.92 * tall, 0.0),
        (0.42, half, tall, 0.04 * tall),
        (0.56, 0.86 * half, 0.86 * tall, 0.06 * tall),
        (0.75, 0.46 * half, 0.5 * tall, 0.12 * tall),
        (0.93, 0.18 * half, 0.28 * tall, 0.2 * tall),
        (1.0, 0.05 * half, 0.16 * tall, 0.24 * tall),
    ]
    pieces = [body(nose_z, length, stations, 1.0, exponents=[(0, 2.3), (0.3, 3.0), (0.6, 2.6), (1, 2.0)])]
    pieces.append(
        body(
            nose_z - rng.uniform(0.2, 0.24) * length,
            rng.uniform(0.27, 0.34) * length,
            [(0, 0.02, 0.02, 0.55), (0.1, 0.45, 0.34, 0.62), (0.3, 0.72, 0.66, 0.68), (0.5, 0.76, 0.74, 0.7),
             (0.72, 0.64, 0.56, 0.64), (0.92, 0.3, 0.26, 0.52), (1.0, 0.04, 0.06, 0.46)],
            tall, component="canopy", n_around=16, n_along=14, exponents=[(0, 2.4), (0.5, 3.2), (1, 2.4)],
        )
    )  # fmt: skip
    span = length * rng.uniform(0.58, 0.72)
    chord = span * rng.uniform(0.26, 0.34)
    taper = rng.uniform(0.45, 1.0)
    dihedral = np.radians(rng.uniform(0.5, 3) if high_wing else rng.uniform(3, 7))
    y_wing = 1.4 * tall if high_wing else -0.62 * tall
    root = np.array([0.0, y_wing, nose_z - rng.uniform(0.25, 0.29) * length])
    sweep = np.radians(rng.uniform(-1, 4)) + 0.25 * (1 - taper) * chord / span
    pieces += _both(
        lifting_surface(root, span, chord, chord * taper, sweep, dihedral, "wing", "wing left", thickness=0.14)
    )
    if high_wing and not wing_engines and rng.random() < 0.8:
        share = rng.uniform(0.42, 0.52)
        top = root + [share * span, share * span * np.tan(dihedral) - 0.02, -0.35 * chord]
        foot = np.array([0.7 * half, -0.7 * tall, root[2] - 0.35 * chord])
        pieces += _both(pylon(foot, top, 0.11 * chord, "strut left", part="wing", slim=0.35))
    kind = str(rng.choice(["conventional", "T", "V"], p=[0.65, 0.25, 0.1]))
    pieces += _tail(
        rng, kind=kind, z=nose_z - 0.87 * length, y=0.2 * tall, fuselage_half=0.2 * half,
        chord=chord * rng.uniform(0.58, 0.72), span=span * rng.uniform(0.32, 0.4),
        fin_height=length * rng.uniform(0.16, 0.2), sweep=np.radians(rng.uniform(4, 12)), dihedral=0.02,
    )  # fmt: skip
    blades = int(rng.integers(2, 5))
    if wing_engines:
        r = half * rng.uniform(0.46, 0.58)
        share = rng.uniform(0.3, 0.36)
        leading = root + [share * span, share * span * np.tan(dihedral), -share * span * np.tan(sweep)]
        nacelle_front = leading[2] + rng.uniform(0.55, 0.8) * chord
        stations = [(0, 0.5, 0.5, 0.0), (0.03, 0.72, 0.72, 0.0), (0.15, 0.95, 0.98, 0.0), (0.45, 1.0, 1.05, 0.0),
                    (0.8, 0.6, 0.6, 0.05), (1.0, 0.1, 0.14, 0.1)]  # fmt: skip
        nacelle = body(
            nacelle_front, 1.75 * chord, stations, r, component="engine left", part="engine", n_around=16, n_along=14,
            shift=(leading[0], leading[1]),
        )  # fmt: skip
        pieces += _both(nacelle)
        disc = rng.uniform(1.7, 2.2) * r
        hub = (leading[0], leading[1], nacelle_front)
        return pieces + [b for p in propeller(hub, disc, 0.42 * r, blades, "propeller left") for b in _both(p)]
    r = 0.68 * half
    cowling = body(
        nose_z + 0.012 * length, 0.15 * length,
        [(0, 0.86, 0.84, -0.1), (0.02, 1.02, 0.98, -0.1), (0.12, 1.14, 1.08, -0.1), (0.6, 1.28, 1.19, -0.12),
         (1.0, 1.28, 1.18, -0.12)],
        r, component="cowling", part="engine", n_along=12, exponents=[(0, 2.2), (1, 2.4)], inlet=0.06,
    )  # fmt: skip
    pieces.append(cowling)
    hub = (0.0, -0.1 * r, nose_z + 0.01 * length)
    return pieces + propeller(hub, length * rng.uniform(0.115, 0.14), 0.32 * half, blades, "propeller")


def _glider(rng: np.random.Generator) -> list[Piece]:
    length = rng.uniform(6.2, 8.0)
    nose_z = 0.5 * length
    half = length * rng.uniform(0.038, 0.05)
    tall = half * rng.uniform(1.25, 1.5)
    boom = rng.uniform(0.2, 0.3)
    pod_end = rng.uniform(0.38, 0.45)
    pieces = [
        body(
            nose_z,
            length,
            [
                (0.0, 0.01 * half, 0.01 * half, -0.3 * tall),
                (0.012, 0.24 * half, 0.2 * tall, -0.29 * tall),
                (0.06, 0.6 * half, 0.52 * tall, -0.22 * tall),
                (0.15, 0.93 * half, 0.88 * tall, -0.08 * tall),
                (0.24, half, tall, 0.0),
                (0.33, 0.9 * half, 0.9 * tall, 0.06 * tall),
                (pod_end + 0.08, 0.45 * half, 0.45 * tall, 0.2 * tall),
                (0.7, boom * half * 1.2, boom * tall * 1.1, 0.25 * tall),
                (0.97, boom * half * 0.7, boom * tall * 0.8, 0.28 * tall),
                (1.0, 0.4 * boom * half, 0.5 * boom * tall, 0.28 * tall),
            ],
            1.0,
        )
    ]
    pieces.append(
        body(
            nose_z - 0.05 * length,
            0.26 * length,
            [(0, 0.02, 0.02, 0.1), (0.1, 0.3, 0.26, 0.22), (0.4, 0.6, 0.5, 0.45), (0.65, 0.6, 0.46, 0.5),
             (0.9, 0.3, 0.2, 0.52), (1.0, 0.03, 0.03, 0.5)],
            tall, component="canopy", n_around=16, n_along=14,
        )
    )  # fmt: skip
    span = length * rng.uniform(0.95, 1.35)
    chord = span * rng.uniform(0.095, 0.125)
    root = np.array([0.0, tall * rng.uniform(0.35, 0.7), nose_z - rng.uniform(0.27, 0.31) * length])
    dihedral = np.radians(rng.uniform(2, 4.5))
    winglet = rng.uniform(0.02, 0.035) if rng.random() < 0.5 else 0.0
    pieces += _both(
        lifting_surface(root, span, chord, chord * rng.uniform(0.35, 0.55), np.radians(rng.uniform(0, 2)), dihedral,
                        "wing", "wing left", thickness=0.14, winglet=winglet, bow=rng.uniform(0, 0.02))
    )  # fmt: skip
    kind = str(rng.choice(["T", "V", "conventional"], p=[0.6, 0.2, 0.2]))
    pieces += _tail(
        rng, kind=kind, z=nose_z - 0.91 * length, y=0.28 * tall, fuselage_half=0.3 * half,
        chord=chord * rng.uniform(0.6, 0.75), span=length * rng.uniform(0.17, 0.22),
        fin_height=length * rng.uniform(0.15, 0.19), sweep=np.radians(rng.uniform(4, 10)), dihedral=0.0,
    )  # fmt: skip
    return pieces
