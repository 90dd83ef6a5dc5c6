"""Families that are neither furniture nor airplanes, for benchmarks: soft bodies with known parts and landmarks.

    python -m benchmarks.organic FOLDER [--family animals] [--count 16] [--seed 0]

Animals and people in poses of their own, vases with handles and spouts or without, guitars, goblets: closed surfaces
without a seam between the parts, which no rule of this project was tuned on.  Every shape is the zero level of a smooth
union of simple solids; a face belongs to the part of the solid that it is nearest to.  Files as ``write_family`` makes
them: ``<name>.obj``, ``<name>.seg``, labels.json and landmarks.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyvista as pv
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

Distance = Callable[[np.ndarray], np.ndarray]
"""Signed distances (...), negative inside, of places (..., 3); near the surface at least about right."""

COARSE, MARGIN = 0.07, 0.1  # of the grid that finds where a body is, and what is left around it


@dataclass(eq=False)
class Body:
    """A smooth union of solids, each of a part; ``softness`` rounds where they meet; ``cells`` along the longest side.

    ``marks`` are landmarks, which go to the nearest vertex.
    """

    softness: float
    cells: int
    solids: list[tuple[str, Distance]] = field(default_factory=list)
    marks: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, part: str, *solids: Distance) -> None:
        """Solids of one part more."""
        self.solids += [(part, solid) for solid in solids]

    def mesh(self) -> tuple[np.ndarray, np.ndarray, list[str]]:
        """Vertices (V, 3), triangles (F, 3) and the part of each triangle."""
        rough = _grid(np.full(3, -2.0), np.full(3, 2.0), COARSE)
        inside = rough[np.min([solid(rough) for _, solid in self.solids], axis=0) < COARSE]
        low, high = inside.min(axis=0) - MARGIN, inside.max(axis=0) + MARGIN
        step = float((high - low).max() / self.cells)
        places = _grid(low, high, step)
        united = np.logaddexp.reduce([-solid(places) / self.softness for _, solid in self.solids], axis=0)
        image = pv.ImageData(dimensions=united.shape, spacing=(step,) * 3, origin=tuple(low))
        image["distance"] = (-self.softness * united).ravel(order="F")
        surface = image.contour([0.0], scalars="distance", method="flying_edges").triangulate()
        vertices, triangles = np.asarray(surface.points, float), surface.regular_faces
        centres = vertices[triangles].mean(axis=1)
        nearest = np.argmin([solid(centres) for _, solid in self.solids], axis=0)
        return vertices, triangles, [self.solids[i][0] for i in nearest]


def _grid(low: np.ndarray, high: np.ndarray, step: float) -> np.ndarray:
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


# -- solids ----------------------------------------------------------------------------------------------------------


def bone(start, end, at_start: float, at_end: float) -> Distance:
    """A capsule whose radius goes from ``at_start`` to ``at_end``."""
    start, along = np.asarray(start, float), np.subtract(end, start).astype(float)

    def distance(places: np.ndarray) -> np.ndarray:
        t = np.clip((places - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
        return np.linalg.norm(places - start - t[..., None] * along, axis=-1) - (at_start + (at_end - at_start) * t)

    return distance


def turned(heights, radii, low: float, high: float, wall: float | None = None) -> Distance:
    """What a lathe makes of a profile between two heights; a ``wall`` of that thickness where it is hollow."""

    def distance(places: np.ndarray) -> np.ndarray:
        side = 0.8 * (np.hypot(places[..., 0], places[..., 2]) - np.interp(places[..., 1], heights, radii))
        if wall is not None:
            side = np.abs(side + wall / 2) - wall / 2
        return np.maximum(side, np.maximum(low - places[..., 1], places[..., 1] - high))

    return distance


def ring(centre, radius: float, thickness: float, stretch: float) -> Distance:
    """A ring in the plane of x and y, stretched upwards."""

    def distance(places: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(places - np.asarray(centre), -1, 0)
        return np.hypot(np.hypot(x, y / stretch) - radius, z) - thickness

    return distance


def plate(outline: Distance, thickness: float, at: float = 0.0) -> Distance:
    """An outline in x and y, ``thickness`` to either side of the depth ``at``."""
    return lambda places: np.maximum(outline(places), np.abs(places[..., 2] - at) - thickness)


def bar(width: float, low: float, high: float, taper: float = 0.0) -> Distance:
    """The outline of an upright bar of half a ``width``, wider by ``taper`` of it at the top."""

    def distance(places: np.ndarray) -> np.ndarray:
        y = places[..., 1]
        side = np.abs(places[..., 0]) - width * (1 + taper * (y - low) / (high - low))
        return np.maximum(side, np.maximum(low - y, y - high))

    return distance


def swung(vector, *turns: tuple[str, float]) -> np.ndarray:
    """A vector (3,) turned about axes, in degrees, one after the other."""
    for axis, angle in turns:
        vector = Rotation.from_euler(axis, angle, degrees=True).apply(vector)
    return np.asarray(vector, float)


# -- families --------------------------------------------------------------------------------------------------------


def animal(rng: np.random.Generator) -> Body:
    """A quadruped that walks: torso, legs, neck, head, and mostly a tail, sometimes horns."""
    body = Body(0.015, 96)
    long, thick, leg, thin = (rng.uniform(*span) for span in ((0.8, 1.3), (0.15, 0.26), (0.45, 0.9), (0.05, 0.085)))
    chest = thick * rng.uniform(0.8, 1.05)
    body.add("torso", bone([0, 0, -long / 2], [0, rng.uniform(-0.05, 0.08), long / 2], chest, thick))
    for side, left in ((1, "left"), (-1, "right")):
        for depth, front in ((long / 2, "front"), (-long / 2, "back")):
            swing, bend = rng.uniform(-28, 28), rng.uniform(-5, 30) * (1 if front == "front" else -1)
            hip = np.array([side * thick * 0.6, -thick * 0.3, depth])
            knee = hip + swung([0, -leg / 2, 0], ("x", swing))
            foot = knee + swung([0, -leg / 2, 0], ("x", swing + bend))
            toe = foot + [0, 0, 0.08]
            body.add("leg", bone(hip, knee, 1.4 * thin, thin), bone(knee, foot, thin, 0.75 * thin))
            body.add("leg", bone(foot, toe, 0.8 * thin, 0.7 * thin))
            body.marks |= {f"toe {front} {left}": toe + [0, 0, 0.7 * thin], f"knee {front} {left}": knee + [0, 0, thin]}
    root, slender = np.array([0, thick * 0.3, long / 2 + thick * 0.3]), rng.uniform(0.08, 0.13)
    top = root + swung([0, 0, rng.uniform(0.2, 0.75)], ("x", -rng.uniform(10, 80)), ("y", rng.uniform(-25, 25)))
    body.add("neck", bone(root, top, 1.3 * slender, slender))
    facing = swung([0, 0, 1], ("x", rng.uniform(0, 40)), ("y", rng.uniform(-20, 20)))
    snout, wide = rng.uniform(0.2, 0.4), rng.uniform(0.1, 0.15)
    body.add("head", bone(top, top + snout * facing, wide, wide * rng.uniform(0.5, 0.9)))
    eared, horned, tailed = rng.random(3) < [0.6, 0.3, 0.85]
    for side in (1, -1):
        if eared:
            ear = top + [side * wide * 1.4, wide * 1.9, -0.02]
            body.add("head", bone(top + [side * wide * 0.7, wide * 0.6, 0], ear, 0.045, 0.02))
        if horned:
            tip = top + [side * wide * 1.2, wide * 0.8 + 0.27, -0.1]
            body.add("horn", bone(top + [side * wide * 0.4, wide * 0.8, 0], tip, 0.04, 0.018))
    if tailed:
        root = np.array([0, thick * 0.4, -long / 2 - thick * 0.6])
        turns = ("x", rng.uniform(-60, 50)), ("y", rng.uniform(-30, 30))
        tip = root + swung([0, 0, -rng.uniform(0.2, 0.8)], *turns)
        body.add("tail", bone(root, tip, 0.05, 0.035))
        body.marks["tip of the tail"] = tip
    body.marks |= {
        "nose": top + (snout + 0.6 * wide) * facing, "crown": top + [0, wide, 0], "belly": np.array([0, -thick, 0]),
        "back": np.array([0, thick, 0]), "rump": np.array([0, thick / 2, -long / 2 - 0.7 * thick]),
    }  # fmt: skip
    return body


def person(rng: np.random.Generator) -> Body:
    """Someone standing or striding, arms anywhere: torso, head, arms, legs."""
    body = Body(0.012, 96)
    spans = (0.2, 0.3), (0.12, 0.18), (0.5, 0.65), (0.75, 1.0), (0.55, 0.75), (0.8, 1.5)
    shoulder, hip, torso, leg, arm, stout = (rng.uniform(*span) for span in spans)
    body.add("torso", bone([-hip * 0.6, 0, 0], [hip * 0.6, 0, 0], 0.12 * stout, 0.12 * stout))
    body.add("torso", bone([0, 0, 0], [0, torso * 0.8, 0], 0.13 * stout, 0.15 * stout))
    body.add("torso", bone([-shoulder * 0.8, torso, 0], [shoulder * 0.8, torso, 0], 0.08, 0.08))
    head = np.array([0, torso + 0.32, rng.uniform(-0.03, 0.08)])
    body.add("head", bone([0, torso, 0], head, 0.06, 0.06), bone(head - [0, 0.05, 0], head + [0, 0.06, 0], 0.12, 0.12))
    for side, left in ((1, "left"), (-1, "right")):
        spread, forwards = np.radians(rng.uniform(5, 95)), ("x", rng.uniform(-40, 40))
        upper = swung([side * np.sin(spread), -np.cos(spread), 0], forwards)
        lower = swung(upper, ("x", rng.uniform(-60, 10)))
        root = np.array([side * shoulder, torso, 0])
        elbow, hand = root + upper * arm / 2, root + (upper + lower) * arm / 2
        body.add("arm", bone(root, elbow, 0.06 * stout**0.5, 0.05), bone(elbow, hand, 0.05, 0.035))
        body.add("arm", bone(hand, hand + 0.1 * lower, 0.045, 0.03))
        spread, forwards = np.radians(rng.uniform(0, 22)), ("x", rng.uniform(-35, 25))
        thigh = swung([side * np.sin(spread), -np.cos(spread), 0], forwards)
        shin = swung(thigh, ("x", rng.uniform(0, 40)))
        root = np.array([side * hip * 0.7, -0.05, 0])
        knee, ankle = root + thigh * leg / 2, root + (thigh + shin) * leg / 2
        body.add("leg", bone(root, knee, 0.1 * stout**0.7, 0.07), bone(knee, ankle, 0.07, 0.045))
        body.add("leg", bone(ankle, ankle + [0, -0.02, 0.16], 0.045, 0.035))
        body.marks |= {
            f"hand {left}": hand + 0.13 * lower, f"elbow {left}": elbow,
            f"toe {left}": ankle + [0, -0.02, 0.2], f"knee {left}": knee + [0, 0, 0.07],
        }  # fmt: skip
    front, back = np.array([0, 0.15, 0.13 * stout]), np.array([0, 0.3, -0.14 * stout])
    body.marks |= {"crown": head + [0, 0.18, 0], "navel": front, "back": back}
    return body


def vase(rng: np.random.Generator) -> Body:
    """Body, foot and neck, up to two handles, sometimes a spout."""
    body = Body(0.008, 90)
    spans = (0.8, 1.6), (0.3, 0.6), (0.1, 0.25), (0.12, 0.3), (0.25, 0.45), (0.62, 0.75), (0.06, 0.14)
    high, wide, narrow, foot, middle, shoulder, base = (rng.uniform(*span) for span in spans)
    lip, middle, shoulder, base = narrow * rng.uniform(1.05, 1.9), middle * high, shoulder * high, base * high
    corners = [0, base, middle, shoulder, 0.9 * high, high], [1.2 * foot, foot, wide, narrow, 1.05 * narrow, lip]
    heights, radii = _profile(high, *corners, 2.5)
    body.add("foot", turned(heights, radii, 0, base))
    body.add("body", turned(heights, radii, base, shoulder))
    body.add("neck", turned(heights, radii, shoulder, high, 0.05))
    radius, stretch, at = rng.uniform(0.14, 0.2), rng.uniform(1.0, 1.4), (middle + shoulder) / 2 + 0.05 * high
    for side in (1, -1)[: rng.integers(0, 3)]:
        body.add("handle", ring([side * (np.interp(at, heights, radii) + 0.02), at, 0], radius, 0.04, stretch))
    if rng.random() < 0.3:
        tip = [0, 0.8 * high, wide + rng.uniform(0.2, 0.4)]
        body.add("spout", bone([0, middle, 0.8 * wide], tip, 0.09, 0.05))
    _rim_marks(body, {"foot": (foot, 0.0), "belly": (wide, middle), "lip": (lip, high)})
    return body


def guitar(rng: np.random.Generator) -> Body:
    """Flat body, neck and head."""
    body = Body(0.004, 110)
    spans = (0.3, 0.4), (0.2, 0.32), (0.16, 0.24), (0.7, 0.95), (0.6, 0.9), (0.03, 0.1), (0.15, 0.28), (0.06, 0.1)
    low, up, waist, long, neck, thick, head, wide = (rng.uniform(*span) for span in spans)
    corners = np.array([0, 0.12, 0.3, 0.55, 0.8, 0.95, 1.0]) * long, [0.02, 0.8 * low, low, waist, up, 0.7 * up, 0.03]
    heights, widths = _profile(long, *corners, 3.0)
    cut = rng.random() < 0.5

    def outline(places: np.ndarray) -> np.ndarray:
        x, y = places[..., 0], places[..., 1]
        flat = np.maximum(0.7 * (np.abs(x) - np.interp(y, heights, widths)), np.maximum(-y, y - long))
        return np.maximum(flat, 0.13 - np.hypot(x - up, y - long)) if cut else flat

    nut, end = long + neck, long + neck + head
    body.add("body", plate(outline, thick))
    body.add("neck", plate(bar(0.04, 0.75 * long, nut), 0.03, 0.8 * thick))
    body.add("head", plate(bar(wide, nut, end, 0.5), 0.03, 0.8 * thick))
    places = {"bottom": (0, 0, 0), "top": (0, end, thick)}
    for side, left in ((-1, "left"), (1, "right")):
        places |= {f"nut {left}": (0.04 * side, nut, thick), f"hip {left}": (low * side, 0.3 * long, 0)}
        places |= {f"waist {left}": (waist * side, 0.55 * long, 0), f"shoulder {left}": (up * side, 0.8 * long, 0)}
    body.marks |= {name: np.array(place, float) for name, place in places.items()}
    return body


def goblet(rng: np.random.Generator) -> Body:
    """Base, stem and a hollow cup."""
    body = Body(0.006, 96)
    spans = (0.9, 1.6), (0.2, 0.4), (0.04, 0.08), (0.2, 0.45), (0.03, 0.1), (0.35, 0.65)
    high, base, stem, cup, low, middle = (rng.uniform(*span) for span in spans)
    low, middle, lip, knob = low * high, middle * high, cup * rng.uniform(0.7, 1.2), rng.random() < 0.4
    widest = middle + 0.35 * (high - middle)
    corners = (
        [0, low / 2, low, middle / 2, middle, widest, high],
        [base, 0.9 * base, 1.6 * stem, stem * (2.2 if knob else 1.0), 1.3 * stem, cup, lip],
    )
    heights, radii = _profile(high, *corners, 1.5)
    body.add("base", turned(heights, radii, 0, low))
    body.add("stem", turned(heights, radii, low, middle))
    body.add("cup", turned(heights, radii, middle, high, 0.05), turned(heights, radii, middle, middle + 0.08))
    _rim_marks(body, {"base": (base, 0.0), "cup": (cup, widest), "lip": (lip, high)})
    return body


def _profile(high: float, at, value, blur: float) -> tuple[np.ndarray, np.ndarray]:
    """A polyline, rounded: places and values."""
    places = np.linspace(0, high, 70)
    return places, gaussian_filter1d(np.interp(places, at, value), blur, mode="nearest")


def _rim_marks(body: Body, rims: dict[str, tuple[float, float]]) -> None:
    """Four landmarks around each rim, of these radii and heights."""
    for name, (radius, height) in rims.items():
        for x, z in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            body.marks[f"{name} {x:+d} {z:+d}"] = np.array([radius * x, height, radius * z])


FAMILIES: dict[str, Callable[[np.random.Generator], Body]] = {
    "animals": animal, "people": person, "vases": vase, "guitars": guitar, "goblets": goblet,
}  # fmt: skip


def write_organic(folder: Path, family: str, count: int, *, seed: int) -> None:
    """``count`` shapes of one of ``FAMILIES`` as files; the same (family, seed, index) gives the same shape."""
    folder.mkdir(parents=True, exist_ok=True)
    marks: dict[str, dict[str, list[float]]] = {}
    ids: dict[str, int] = {}
    for index in range(count):
        body = FAMILIES[family](np.random.default_rng([list(FAMILIES).index(family), seed, index]))
        vertices, triangles, parts = body.mesh()
        name, tree = f"{FAMILIES[family].__name__}_{index:04d}", cKDTree(vertices)
        lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in triangles + 1]
        (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
        numbers = [ids.setdefault(part, len(ids) + 1) for part in parts]
        (folder / f"{name}.seg").write_text("\n".join(map(str, numbers)) + "\n")
        marks[name] = {mark: vertices[tree.query(place)[1]].tolist() for mark, place in body.marks.items()}
    (folder / "labels.json").write_text(json.dumps({str(number): part for part, number in ids.items()}, indent=1))
    (folder / "landmarks.json").write_text(json.dumps(marks, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--family", choices=list(FAMILIES), default="animals")
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    write_organic(options.folder, options.family, options.count, seed=options.seed)


if __name__ == "__main__":
    main()
