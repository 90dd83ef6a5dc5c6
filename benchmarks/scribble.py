"""How much of a shape is right after a few strokes of the scribble tool, and how long does completing take?

    python -m benchmarks.scribble [--sets NAME ...] [--strokes 1 2 4] [--shapes 24] [--seed 0] [--json]

Strokes are drawn as a hand would draw them: on places that are seen from outside, straight over one part, a tenth of a
diagonal long at most, with the tool's own brush; the first where the part is most seen, the next as far as can be from
those before (so a chair's legs come one after the other).  "faces" and "area" are the shares of labelled faces, and of
their area, that are right (means over the shapes); "worst tenth" is the area's tenth percentile; milliseconds of
completing once the surface is prepared.  Real sets come from $SHAPEFORGE_DATA or ../shared/data and are left out where
absent.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from shapeforge.collection.families import generate
from shapeforge.collection.labels import find_part_names, read_seg
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.shape import Mesh
from shapeforge.validation.statistics import format_table
from shapeforge.viewer import brushes, spreading

DATA = Path(os.environ.get("SHAPEFORGE_DATA", Path(__file__).parents[2] / "shared" / "data"))
REAL = {"ikea chairs": "ikea/chairs", "ikea tables": "ikea/tables"}
SAMPLES, LONGEST, DAB = 12000, 0.10, 0.4 * 0.034  # the length and the tool's radius in diagonals
GRID, NEARER = 220, 0.012  # of the pictures that say what is seen; what lies deeper (diagonals) is hidden


@dataclass(frozen=True, eq=False)
class Canvas:
    """A shape to scribble on: its truth (F,), -1 where there is none, and the samples that are seen from outside."""

    name: str
    mesh: Mesh
    truth: np.ndarray
    points: np.ndarray
    face: np.ndarray


def canvases(name: str, count: int, seed: int) -> Iterator[Canvas]:
    """Shapes of a set with their truth, in diagonals; nothing where it is absent."""
    rng = np.random.default_rng(seed)
    if name.startswith("generated"):
        for one in generate(name.split()[1], count, seed=seed + 3):
            yield _canvas(one.name, one.mesh, np.asarray(one.faces), rng)
        return
    files = sorted((DATA / REAL[name]).glob("*.obj"))
    for file in [files[i] for i in sorted(rng.permutation(len(files))[:count])]:
        mesh = read_mesh(file)
        names = find_part_names(file.parent)
        yield _canvas(file.stem, mesh, read_seg(file.with_suffix(".seg"), mesh.n_faces, names), rng)


def _canvas(name: str, mesh: Mesh, truth: np.ndarray, rng: np.random.Generator) -> Canvas:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    mesh = mesh.moved((mesh.vertices - (low + high) / 2) / np.linalg.norm(high - low))
    area = mesh.triangle_areas
    triangle = rng.choice(len(area), SAMPLES, p=area / area.sum())
    weight = rng.dirichlet(np.ones(3), SAMPLES)
    points = (mesh.vertices[mesh.triangles[triangle]] * weight[:, :, None]).sum(axis=1)
    seen = seen_from_outside(points)
    return Canvas(name, mesh, truth, points[seen], mesh.face_of_triangle[triangle[seen]])


def seen_from_outside(points: np.ndarray) -> np.ndarray:
    """Which points (n,) nothing hides in at least one of twenty-six pictures around the shape."""
    seen = np.zeros(len(points), bool)
    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3), axis=-1).reshape(-1, 3)
    for towards in steps[np.any(steps != 0, axis=1)]:
        forward = towards / np.linalg.norm(towards)
        side = np.cross(forward, [0.3, 1.0, 0.1] if abs(forward[1]) < 0.9 else [1.0, 0.0, 0.1])
        side /= np.linalg.norm(side)
        flat = np.stack([points @ side, points @ np.cross(forward, side)], axis=1)
        cell = ((flat + 0.6) * GRID / 1.2).astype(int).clip(0, GRID - 1)
        depth, nearest = points @ forward, np.full((GRID, GRID), -np.inf)
        np.maximum.at(nearest, (cell[:, 0], cell[:, 1]), depth)
        seen |= depth >= nearest[cell[:, 0], cell[:, 1]] - NEARER
    return seen


def strokes(canvas: Canvas, surface: brushes.FaceSurface, count: int, rng: np.random.Generator) -> np.ndarray:
    """Labels (F,) after ``count`` strokes on every part."""
    labels = np.full(canvas.mesh.n_faces, -1, np.int32)
    for part in np.unique(canvas.truth[canvas.truth >= 0]):
        own = np.flatnonzero(canvas.truth[canvas.face] == part)
        if not len(own):
            continue
        places, first = canvas.points[own], int(rng.integers(len(own)))
        far = np.full(len(own), np.inf)
        for _ in range(count):
            for face, position in dabs(canvas, own, first, rng):
                touched = brushes.along(surface, face, position, DAB)
                # Nobody paints over a border on purpose: what the hand slips onto is taken back.
                labels[touched[canvas.truth[touched] == part]] = part
            far = np.minimum(far, np.linalg.norm(places - places[first], axis=1))
            first = int(far.argmax())
    return labels


def dabs(canvas: Canvas, own: np.ndarray, first: int, rng: np.random.Generator) -> Iterator[tuple[int, np.ndarray]]:
    """Faces and places under one straight stroke over a part from its ``first`` place."""
    places = canvas.points[own]
    near = np.flatnonzero(np.linalg.norm(places - places[first], axis=1) <= LONGEST)
    last = near[np.linalg.norm(places[near] - places[first], axis=1).argsort()[int(0.8 * len(near)) :]]
    stop = int(rng.choice(last)) if len(last) else first
    tree = cKDTree(places[near])
    for share in np.linspace(0, 1, 9):
        _, at = tree.query((1 - share) * places[first] + share * places[stop])
        yield int(canvas.face[own[near[at]]]), places[near[at]]


def rightness(name: str, count: int, shapes: int, seed: int) -> dict[str, float]:
    """What a set gives with ``count`` strokes a part."""
    rng = np.random.default_rng(seed + 1)
    faces, areas, spent, sizes = [], [], [], []
    for canvas in canvases(name, shapes, seed):
        surface = brushes.face_surface(canvas.mesh)
        labels = strokes(canvas, surface, count, rng)
        if len(np.unique(labels[labels >= 0])) < 2:
            continue
        plane = brushes.mirror_plane(canvas.points[:3000])
        ground = spreading.Ground(canvas.mesh, surface, None if plane is None else plane[:2])
        spreading.complete(ground, labels)
        begun = time.perf_counter()
        found = spreading.complete(ground, labels)
        spent.append(1e3 * (time.perf_counter() - begun))
        asked = canvas.truth >= 0
        right, weight = found[asked] == canvas.truth[asked], canvas.mesh.face_areas[asked]
        faces.append(right.mean())
        areas.append(float((right * weight).sum() / weight.sum()))
        sizes.append(canvas.mesh.n_faces)
    return {
        "shapes": len(faces), "faces": float(np.mean(faces)), "area": float(np.mean(areas)),
        "worst tenth": float(np.quantile(areas, 0.1)), "milliseconds": float(np.median(spent)),
        "slowest": float(np.max(spent)), "most faces": int(np.max(sizes)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", nargs="+", default=[*REAL, "generated chairs", "generated airplanes"])
    parser.add_argument("--strokes", nargs="+", type=int, default=[1, 2, 4])
    parser.add_argument("--shapes", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    chosen = parser.parse_args()
    results: dict[str, dict[str, float]] = {}
    with threadpool_limits(1):
        for name in chosen.sets:
            if name in REAL and not (DATA / REAL[name]).is_dir():
                continue
            for count in chosen.strokes:
                results[f"{name}, {count} a part"] = rightness(name, count, chosen.shapes, chosen.seed)
    if not chosen.json:
        heads = ["strokes", *next(iter(results.values()))]
        print(format_table(heads, [[name, *(_words(v) for v in row.values())] for name, row in results.items()]))
    print(json.dumps({"seed": chosen.seed, "results": results}))


def _words(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.3f}" if value <= 1 else f"{value:.0f}"


if __name__ == "__main__":
    main()
