"""Does ``refine`` help the correspondences?  Before, after, and after without its guard.

    python -m benchmarks.refinement [--families chairs airplanes] [--seeds 3] [--seed 0] [--shapes 24] [--points 1200]
                                    [--alternations 3] [--json]
    python -m benchmarks.refinement --families ikea --data DATA

A project is made of each family (its groups' exemplars painted by the truth), fitted, learned and refined.  For the
generated families corr@r is against the dense truth: every corresponding point of a shape is carried by the truth to
every other shape that has the component, and is right where that shape's own corresponding point is no further away
than r diagonals; ordered pairs pooled.  For the real chairs (all of them, whatever ``--shapes``; a seed seeds the
stages) it is that of their landmarks.  ``kept`` counts the alternations that were not refused.  The
last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from shapeforge.collection.families import Generated, address_at, nearest_on_mesh, position_of, write_family
from shapeforge.collection.iterate import last
from shapeforge.collection.shape import Mesh
from shapeforge.stages import run
from shapeforge.store import Project
from shapeforge.validation.correspondence import corr_curve, landmark_errors
from shapeforge.validation.statistics import format_table

RADII = (0.02, 0.05)
TOLERANCE = 0.15


Measure = Callable[[Project], list[float]]
"""corr@r of RADII."""


def made_project(folder: Path, family: str, seed: int, options: argparse.Namespace) -> tuple[Project, Measure]:
    """A fitted and learned project of a family, and what measures its correspondences."""
    if family == "ikea":
        meshes = options.data / "ikea" / "chairs"
        stages = seed  # a generated family is another one for every seed, this one can only be worked on otherwise
        measure = partial(landmark_corr, landmarks=json.loads((meshes / "landmarks.json").read_text()))
    else:
        meshes, stages = folder / "meshes", 0
        measure = partial(dense_corr, made=write_family(meshes, family, options.shapes, seed=seed, broken=0.0))
    project = Project.create(folder / "project")
    last(run(project, "import", meshes=[meshes], points=options.points, up="y", seed=stages, jobs=1))
    last(run(project, "group", seed=stages, jobs=1))
    last(run(project, "label", labels=meshes, only="exemplars"))
    last(run(project, "fit", seed=stages, jobs=1))
    last(run(project, "learn", seed=stages, jobs=1))
    return project, measure


def landmark_corr(project: Project, landmarks: dict[str, dict[str, list[float]]]) -> list[float]:
    """corr@r of RADII of the landmarks of all ordered pairs of shapes."""
    shapes = {name: project.shapes.named(name) for name in project.fit_names}
    places = {name: shape.frame.to_input(project.positions(name)) for name, shape in shapes.items()}
    known = {name: {mark: np.array(at) for mark, at in landmarks[name].items()} for name in shapes if name in landmarks}

    def mesh_of(name: str) -> Mesh:
        return shapes[name].mesh.moved(shapes[name].frame.to_input(shapes[name].mesh.vertices))

    errors = landmark_errors(known, places, mesh_of)
    return corr_curve(errors, RADII).tolist()


def dense_corr(project: Project, made: list[Generated]) -> list[float]:
    """corr@r of RADII over all ordered pairs of shapes."""
    by_name = {one.name: one for one in made}
    shapes = [by_name[name] for name in project.fit_names]
    places, component, address = [], [], []
    for shape in shapes:
        found = project.shapes.named(shape.name).frame.to_input(project.positions(shape.name))
        there = np.isfinite(found[:, 0])
        own, at = np.full(len(found), -1), np.zeros((len(found), 3))
        own[there], at[there] = address_at(shape, *nearest_on_mesh(shape.mesh, found[there]))
        places.append(found)
        component.append(own)
        address.append(at)
    errors = []
    for target, found in zip(shapes, places, strict=True):
        diagonal = float(np.linalg.norm(np.ptp(target.mesh.vertices, axis=0)))
        for source, own, at in zip(shapes, component, address, strict=True):
            if source is target:
                continue
            for one in np.unique(own[own >= 0]):
                rows = np.flatnonzero(own == one)
                truth, off = position_of(target, int(one), at[rows])
                rows, truth = rows[off <= TOLERANCE], truth[off <= TOLERANCE]
                away = np.linalg.norm(found[rows] - truth, axis=1) / diagonal
                errors.append(np.where(np.isfinite(away), away, np.inf))
    pooled = np.concatenate(errors)
    return [float((pooled <= radius).mean()) for radius in RADII]


def measured(family: str, seed: int, options: argparse.Namespace) -> dict:
    """corr before, after and after without the guard; what the guard said."""
    with tempfile.TemporaryDirectory() as made_in:
        folder = Path(made_in)
        project, measure = made_project(folder, family, seed, options)
        result: dict = {"family": family, "seed": seed, "before": measure(project)}
        shutil.copytree(project.path, folder / "unguarded")
        last(run(project, "refine", alternations=options.alternations, jobs=1))
        summary = project.stage_record("refine")["summary"]
        result |= {"refined": measure(project), "kept": summary["kept"], "said": summary["text"]}
        result["unguarded"] = result["refined"]
        if summary["kept"] < options.alternations:
            project = Project.open(folder / "unguarded")
            joint = "shapeforge.generative.joint"
            with (
                patch(f"{joint}.is_worse", lambda before, after: False),
                patch(f"{joint}.mostly_falls", lambda before, after: True),
            ):
                last(run(project, "refine", alternations=options.alternations, jobs=1))
            result["unguarded"] = measure(project)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--families", nargs="+", choices=("chairs", "airplanes", "ikea"), default=["chairs", "airplanes"]
    )
    parser.add_argument("--data", type=Path, help="folder of the real shapes")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--shapes", type=int, default=24)
    parser.add_argument("--points", type=int, default=1200)
    parser.add_argument("--alternations", type=int, default=3)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    if "ikea" in options.families and options.data is None:
        parser.error("--families ikea: wanted --data, the folder with ikea/chairs")
    results = []
    for family in options.families:
        for seed in range(options.seed, options.seed + options.seeds):
            begin = time.process_time()
            results.append(measured(family, seed, options))
            print(f"{family}, seed {seed}: {time.process_time() - begin:.0f} CPU-seconds", file=sys.stderr)
    if not options.json:
        names = ("before", "refined", "unguarded")
        head = ["", "seed", "kept", *(f"{name} @{r:.2f}" for name in names for r in RADII)]
        rows = [[r["family"], r["seed"], r["kept"], *(v for name in names for v in r[name])] for r in results]
        print(format_table(head, rows))
        for r in results:
            print(f"{r['family']} {r['seed']}: {r['said']}")
    print(json.dumps({"shapes": options.shapes, "points": options.points, "results": results}))


if __name__ == "__main__":
    main()
