"""Do levels between the groups' templates and the top pay?  Links and fits with two levels and with more.

    python -m benchmarks.levels [--sets animals …] [--groups 6 10 16] [--seeds 3] [--first-seed 0] [--points 1000]
                               [--fits] [--json]

Links: so many shapes of a family, painted by the truth, are the exemplars of as many groups.  Their templates are
linked, and the landmarks of each are carried to every other over the top-level templates alone.  Columns: corr@.02 and
corr@.05 with two levels, and what more levels add, seed by seed; levels, and the share of links (of a part of a group)
that are over another group; CPU-seconds of the linking with two levels and with more.

With ``--fits`` there are 14 shapes more, which nobody painted, and the whole fit is made: as it is, and without
templates of the family, where points of a shape reach the top over the links.  Of the shapes not painted, corr@.02 and
corr@.05 over ordered pairs of different groups.  Mean ± standard deviation over seeds; the last line is one JSON
object.  Sets as of ``fit_accuracy`` and ``organic``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.fit_accuracy import DATA, GENERATED, ORGANIC, REAL, Family, carried, cell, fitted, read_family
from benchmarks.organic import write_organic
from shapeforge.collection.families import write_family
from shapeforge.deformation.hierarchy import Hierarchy, link_templates
from shapeforge.deformation.templates import PartTemplates, template_from_exemplar
from shapeforge.validation.correspondence import landmark_errors
from shapeforge.validation.statistics import format_table

SETS = (*REAL, *GENERATED, *ORGANIC)
DEFAULT = ("ikea-chairs", "ikea-tables", "generated-chairs", "generated-airplanes", "animals", "people", "vases")
OTHERS = 14
RADII = (0.02, 0.05)
NEVER = 1_000_000  # groups from which on there are more levels: two levels
ROUTES = {"the fit": "ours", "without templates of the family": "exemplars-alone"}


@contextmanager
def levels(more: bool) -> Iterator[None]:
    """With levels in between, as the program has them, or with two."""
    with ExitStack() as patched:
        if not more:
            patched.enter_context(patch("shapeforge.deformation.levels.FEWEST_GROUPS", NEVER))
        yield


def read(name: str, count: int, n_points: int, seed: int, groups: int) -> Family:
    """Shapes of a set, of which ``groups`` are exemplars; of a real set, others with every seed."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        if name in REAL:
            _some_of(DATA / REAL[name], folder, count, seed)
        elif name in GENERATED:
            write_family(folder, GENERATED[name], count, seed=seed)
        else:
            write_organic(folder, name, count, seed=seed)
        return read_family(folder, count, n_points, seed, groups)


def _some_of(source: Path, folder: Path, count: int, seed: int) -> None:
    """Links to the files of at most ``count`` shapes, drawn by the seed, and to what is said of all."""
    files = sorted(source.glob("*.obj"))
    drawn = np.random.default_rng(seed).permutation(len(files))[:count]
    for file in [files[i] for i in sorted(drawn)]:
        for part in source.glob(f"{file.stem}.*"):
            (folder / part.name).symlink_to(part)
    for part in source.glob("*.json"):
        (folder / part.name).symlink_to(part)


def of_links(family: Family, more: bool) -> tuple[list[float], Hierarchy, float]:
    """corr of landmarks carried over the top-level templates, the hierarchy, and CPU-seconds."""
    exemplars = family.exemplars
    templates = [template_from_exemplar(family.shapes[e], family.truth[e], family.part_names) for e in exemplars]
    begin = time.process_time()
    with levels(more):
        hierarchy = link_templates(templates)
    seconds = time.process_time() - begin
    marks = [family.marks[e] for e in exemplars]
    errors = [
        carried_errors(hierarchy, templates, marks, a, b)
        for a in range(len(exemplars)) for b in range(len(exemplars)) if a != b
    ]  # fmt: skip
    pooled = np.concatenate(errors)
    return [float((pooled <= radius).mean()) for radius in RADII], hierarchy, seconds


def carried_errors(
    hierarchy: Hierarchy, templates: list[PartTemplates], marks: list[dict[str, np.ndarray]], a: int, b: int
) -> np.ndarray:
    """Distances of the landmarks of one exemplar, carried to another over the top, from its own."""
    shared = sorted(marks[a].keys() & marks[b].keys())
    both = hierarchy.links[a].exists & hierarchy.links[b].exists
    if not shared or both.sum() < 3:
        return np.zeros(0)
    on_a, on_b = (
        np.einsum("kj,kji->ki", hierarchy.links[g].weight, templates[g].points[hierarchy.links[g].index])[both]
        for g in (a, b)
    )
    places = carried(np.stack([marks[a][mark] for mark in shared]), on_a, on_b)
    return np.linalg.norm(places - np.stack([marks[b][mark] for mark in shared]), axis=1)


def of_fit(family: Family, method: str, more: bool) -> list[float]:
    """corr of ordered pairs of unpainted shapes of different groups."""
    with levels(more):
        positions = fitted(family, method).positions
    errors = []
    for a in positions:
        for b in positions:
            if family.groups.group[a] < family.groups.group[b]:
                errors.append(_both_ways(family, positions, a, b))
    pooled = np.concatenate(errors)
    return [float((pooled <= radius).mean()) for radius in RADII]


def _both_ways(family: Family, positions: dict[int, np.ndarray], a: int, b: int) -> np.ndarray:
    one, other = family.shapes[a], family.shapes[b]
    meshes = {one.name: one.mesh, other.name: other.mesh}
    marks = {one.name: family.marks[a], other.name: family.marks[b]}
    return landmark_errors(marks, {one.name: positions[a], other.name: positions[b]}, meshes.__getitem__)


def run(sets: list[str], groups: list[int], seeds: range, n_points: int, fits: bool) -> dict[str, dict[str, list]]:
    """Figures of every seed by row of the tables, one thread."""
    results: dict[str, dict[str, list]] = {}
    with threadpool_limits(1):
        for name in sets:
            for number in groups:
                for seed in seeds:
                    family = read(name, number + (OTHERS if fits else 0), n_points, seed, number)
                    for way in ROUTES if fits else ("links",):
                        row = results.setdefault(f"{name}, {number} groups, {way}", {})
                        for key, value in figures(family, way).items():
                            row.setdefault(key, []).append(value)
                    print(f"{name}, {number} groups, seed {seed}", file=sys.stderr)
    return results


def figures(family: Family, way: str) -> dict[str, float]:
    """What one family gives for one row."""
    found: dict[str, float] = {}
    for more in (False, True):
        if way == "links":
            corr, hierarchy, seconds = of_links(family, more)
            found |= {f"seconds {more}": seconds}
            if more:
                assert hierarchy.over is not None
                found |= {"levels": hierarchy.levels, "over others": float((hierarchy.over >= 0).mean())}
        else:
            corr = of_fit(family, ROUTES[way], more)
        found |= {f"corr@{radius} {more}": value for radius, value in zip(RADII, corr, strict=True)}
    return {key: round(value, 4) for key, value in found.items()}


def table(results: dict[str, dict[str, list]], fits: bool) -> str:
    """The rows for people."""
    head = ["", "two: corr@.02", "corr@.05", "more: corr@.02", "corr@.05"]
    rows = []
    for name, row in results.items():
        two = [np.array(row[f"corr@{radius} False"]) for radius in RADII]
        more = [np.array(row[f"corr@{radius} True"]) for radius in RADII]
        cells = [name, *map(cell, two), *(cell(m - t, "+.3f") for m, t in zip(more, two, strict=True))]
        if not fits:
            cells += [cell(row["levels"], ".1f"), cell(row["over others"], ".2f")]
            cells += [f"{np.mean(row['seconds False']):.1f} → {np.mean(row['seconds True']):.1f}"]
        rows.append(cells)
    return format_table(head if fits else [*head, "levels", "over others", "CPU s"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", nargs="+", choices=SETS, default=DEFAULT)
    parser.add_argument("--groups", nargs="+", type=int, default=[6, 10, 16])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--fits", action="store_true", help="whole fits instead of links alone")
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    absent = [name for name in options.sets if name in REAL and not (DATA / REAL[name]).is_dir()]
    sets = [name for name in options.sets if name not in absent]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    results = run(sets, options.groups, seeds, options.points, options.fits)
    if not options.json:
        for name in absent:
            print(f"left out: {name}: {DATA / REAL[name]} is not here (set SHAPEFORGE_DATA)")
        print(table(results, options.fits))
    print(json.dumps({"points": options.points, "seeds": list(seeds), "left_out": absent, "sets": results}))


if __name__ == "__main__":
    main()
