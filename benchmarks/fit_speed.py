"""How many CPU-seconds does a shape take?  Preparation, and the whole fit with one exemplar and with three.

    python -m benchmarks.fit_speed [--data DIR] [--points 5000] [--shapes 24] [--repeat 1] [--json]

Preparation is split into reading, sampling, descriptors and patches.  The fit has 10 outer and 3 inner rounds, from the
affine start to the last state, with as many template points as points and the poses known.  Beside it, in the same
run: one pair by the deformable registration of ``pycpd`` at 1000 points, where that package is installed (extra
``bench``).  Shapes are generated chairs, or the meshes of ``--data`` with their ``.seg`` labels.  One thread
throughout, CPU time and no wall time; with ``--repeat`` the smallest of several.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from shapeforge.collection.descriptors import descriptors_from_diameter, shape_diameter
from shapeforge.collection.families.write import write_family
from shapeforge.collection.groups import Groups
from shapeforge.collection.iterate import last
from shapeforge.collection.labels import find_part_names, read_seg
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.orient import orient
from shapeforge.collection.patches import find_patches, patch_neighbours
from shapeforge.collection.points import nearest_neighbours, sample_points
from shapeforge.collection.prepare import normal_frame
from shapeforge.collection.shape import Shape
from shapeforge.deformation.fit import fit_templates
from shapeforge.validation.statistics import format_table

PEER_POINTS = 1000


def prepared(file: Path, n_points: int, up: str) -> tuple[Shape, dict[str, float]]:
    """A shape made by the steps of ``prepare_shape``, and the CPU-seconds of each."""
    seconds, clock = {}, time.process_time()

    def took(what: str) -> None:
        nonlocal clock
        now = time.process_time()
        seconds[what], clock = now - clock, now

    mesh = read_mesh(file)
    frame = normal_frame(mesh, orient(mesh, up)[0])
    here = mesh.moved(frame.to_normal(mesh.vertices))
    took("read and turn")
    points, normals, triangle = sample_points(here, n_points, rng=np.random.default_rng(0))
    took("sample")
    neighbours = nearest_neighbours(points, 20)
    diameter, normals = shape_diameter(here, points, normals, triangle, neighbours)
    descriptors = descriptors_from_diameter(points, diameter, neighbours)
    took("descriptors")
    patch = find_patches(points, normals, descriptors, neighbours)
    within = patch_neighbours(points, patch)
    took("patches")
    shape = Shape(
        file.stem, here, frame, points, normals, mesh.face_of_triangle[triangle], triangle, descriptors, patch, within
    )
    return shape, seconds


def fit_seconds(
    shapes: list[Shape], labels: dict[int, np.ndarray], names: tuple[str, ...], exemplars: int
) -> tuple[float, int]:
    """CPU-seconds a shape of a whole fit, and its rounds; the first shapes are the exemplars."""
    number = len(shapes)
    group = np.array([t if t < exemplars else 0 for t in range(number)])
    groups = Groups(
        tuple(f"Group {g + 1}" for g in range(exemplars)), group, np.arange(exemplars), np.zeros((number, 2))
    )
    painted = {t: labels[t] for t in range(exemplars)}
    begin = time.process_time()
    state = last(
        fit_templates(shapes, groups, painted, names, rng=np.random.default_rng(0), exemplars_per_shape=exemplars)
    )
    return (time.process_time() - begin) / number, state.round


def peer_seconds(source: Shape, target: Shape) -> float | None:
    """CPU-seconds of pycpd's deformable registration of one pair; None where it is not installed."""
    try:
        from pycpd import DeformableRegistration
    except ImportError:
        return None
    begin = time.process_time()
    DeformableRegistration(X=target.points[:PEER_POINTS], Y=source.points[:PEER_POINTS], alpha=2, beta=0.2).register()
    return time.process_time() - begin


def files_of(data: Path | None, count: int, folder: Path) -> Iterator[Path]:
    """The meshes that are measured: of ``data``, evenly picked, or generated into ``folder``."""
    if data is None:
        write_family(folder, "chairs", count, seed=0)
        data = folder
    found = sorted(file for file in data.rglob("*") if file.suffix.lower() in (".obj", ".off", ".ply", ".stl"))
    if not found:
        raise SystemExit(f"{data}: wanted a folder with meshes, found none")
    yield from (found[i] for i in np.unique(np.linspace(0, len(found) - 1, count).round().astype(int)))


def run(data: Path | None, count: int, n_points: int, up: str, repeat: int) -> dict:
    """All of it, one thread."""
    with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
        files = list(files_of(data, count, Path(folder)))
        prepared(files[0], 300, up)  # compile
        steps, shapes = [], []
        for file in files:
            tried = [prepared(file, n_points, up) for _ in range(repeat)]
            shapes.append(tried[0][0])
            steps.append({step: min(seconds[step] for _, seconds in tried) for step in tried[0][1]})
        totals = [sum(step.values()) for step in steps]
        result: dict = {
            "points": n_points, "shapes": len(shapes), "data": str(data.name) if data else "generated chairs",
            "prepare": {step: float(np.mean([one[step] for one in steps])) for step in steps[0]},
            "prepare_total": float(np.mean(totals)), "prepare_slowest": float(max(totals)),
            "prepare_slowest_shape": files[int(np.argmax(totals))].stem,
        }  # fmt: skip
        where = files[0].parent
        if all(file.with_suffix(".seg").is_file() for file in files):
            names = find_part_names(where)
            labels = {
                t: read_seg(file.with_suffix(".seg"), shape.mesh.n_faces, names)
                for t, (file, shape) in enumerate(zip(files, shapes, strict=True))
            }
            fit_seconds(shapes[:3], labels, names.names, 3)  # compile
            for exemplars in (1, 3):
                tried = [fit_seconds(shapes, labels, names.names, exemplars) for _ in range(repeat)]
                result[f"fit_exemplars_{exemplars}"], result[f"rounds_exemplars_{exemplars}"] = min(tried)
        result["pycpd_pair"] = peer_seconds(shapes[0], shapes[1])
        blas = [
            f"{lib.get('internal_api')} {lib.get('architecture', '')} x{lib.get('num_threads')}"
            for lib in threadpool_info()
            if lib.get("user_api") == "blas"
        ]
    return result | {"blas": blas}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, help="folder with meshes, and .seg labels for the fit")
    parser.add_argument("--points", type=int, default=5000)
    parser.add_argument("--shapes", type=int, default=24)
    parser.add_argument("--up", default="keep")
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    if options.shapes < 3:
        parser.error("--shapes: wanted at least 3 (as many as exemplars)")
    result = run(options.data, options.shapes, options.points, options.up, options.repeat)
    if not options.json:
        print(f"{result['shapes']} shapes ({result['data']}), P = K = {result['points']}, {result['blas']}")
        rows = [[f"prepare: {step}", seconds] for step, seconds in result["prepare"].items()]
        rows += [["prepare: all", result["prepare_total"]]]
        rows += [[f"prepare: slowest ({result['prepare_slowest_shape']})", result["prepare_slowest"]]]
        rows += [
            [
                f"fit, {n} exemplar{'s' * (n > 1)}, {result[f'rounds_exemplars_{n}']} rounds",
                result[f"fit_exemplars_{n}"],
            ]
            for n in (1, 3)
            if f"fit_exemplars_{n}" in result
        ]
        if result["pycpd_pair"] is None:
            print("pycpd is not installed (pip install '.[bench]'): no comparison")
        else:
            rows += [[f"pycpd, one pair at {PEER_POINTS} points", result["pycpd_pair"]]]
        print(format_table(["CPU-seconds a shape", "s"], rows))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
