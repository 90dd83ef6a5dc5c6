"""Do groups keep classes apart, and how do time and memory grow with the collection?

    python -m benchmarks.grouping [--sets ikea_chairs chairs airplanes] [--count 100] [--large 1000] [--json]

For every set with known classes: the share of shapes whose nearest neighbour has their class, the share of members
whose class is their exemplar's, and the same for one group for all (the most frequent class).  ``--large`` groups that
many generated chairs and airplanes by the route for large collections (0: none).  Seconds are the processor's.  The
last line is one JSON object.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import sys
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from shapeforge.collection.families import generate_one
from shapeforge.collection.groups import group_shapes
from shapeforge.collection.iterate import last
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.points import sample_points
from shapeforge.collection.prepare import normal_frame
from shapeforge.collection.shape import Mesh
from shapeforge.validation.statistics import format_table

SETS = ("ikea_chairs", "chairs", "airplanes")
N_POINTS = 512


def bare(mesh: Mesh, index: int) -> SimpleNamespace:
    """What grouping asks of a shape: points in normal coordinates, the mesh standing upright already."""
    here = mesh.moved(normal_frame(mesh, np.eye(3)).to_normal(mesh.vertices))
    return SimpleNamespace(points=sample_points(here, N_POINTS, rng=np.random.default_rng(index))[0])


def classified(name: str, count: int, seed: int) -> tuple[list[SimpleNamespace], list[str]] | None:
    """Shapes and their classes; None where the files are absent."""
    if name != "ikea_chairs":
        made = (generate_one(name, i, seed=seed) for i in range(count))
        pairs = [(bare(one.mesh, i), one.fine_class) for i, one in enumerate(made)]
        return [shape for shape, _ in pairs], [kind for _, kind in pairs]
    data = os.environ.get("SHAPEFORGE_DATA")
    folder = (Path(data) if data else Path(__file__).resolve().parent.parent.parent / "shared/data") / "ikea/chairs"
    if not folder.is_dir():
        return None
    rows = list(csv.DictReader((folder / "classes.csv").read_text().splitlines()))[:count]
    shapes = [bare(read_mesh(folder / f"{row['name']}.obj"), i) for i, row in enumerate(rows)]
    return shapes, [row["class"] for row in rows]


def run(name: str, count: int, seed: int) -> dict | None:
    """Figures of one set."""
    found = classified(name, count, seed)
    if found is None:
        return None
    shapes, classes = found
    begin = time.process_time()
    state = last(group_shapes(shapes, rng=np.random.default_rng(seed)))
    seconds = time.process_time() - begin
    groups = state.groups
    members = [classes[t] == classes[int(groups.exemplars[groups.group[t]])] for t in range(len(shapes))]
    neighbours = None
    if groups.dissimilarity is not None:
        nearest = (groups.dissimilarity + np.diag(np.full(len(shapes), np.inf))).argmin(axis=1)
        neighbours = float(np.mean([classes[t] == classes[int(nearest[t])] for t in range(len(shapes))]))
    return {
        "shapes": len(shapes), "groups": len(groups), "neighbours": neighbours, "members": float(np.mean(members)),
        "one_group": Counter(classes).most_common(1)[0][1] / len(classes), "cpu_seconds": seconds,
        "peak_megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "how": state.stop_reason,
        "exemplars": [classes[int(e)] for e in groups.exemplars],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=SETS)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--large", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    results = {}
    plans = [(name, options.count) for name in options.sets]
    plans += [(name, options.large) for name in options.sets if name != "ikea_chairs" and options.large]
    for name, count in plans:
        found = run(name, count, options.seed)
        if found is None:
            print(f"{name}: its shapes are not here (set SHAPEFORGE_DATA)", file=sys.stderr)
        else:
            results[f"{name} {found['shapes']}"] = found
    if not options.json:
        keys = ("groups", "neighbours", "members", "one_group", "cpu_seconds", "peak_megabytes")
        rows = [[name, *(found[key] for key in keys)] for name, found in results.items()]
        rows = [[cell if isinstance(cell, (int, str)) else "" if cell is None else f"{cell:.3f}" for cell in r]
                for r in rows]  # fmt: skip
        print(format_table(["set", *keys], rows))
    print(json.dumps(results))


if __name__ == "__main__":
    main()
