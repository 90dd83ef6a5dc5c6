"""How good are parts that nobody painted?  Proposed parts, and the fit they start, beside the fit of painted exemplars.

    python -m benchmarks.automatic_start [--sets ikea_chairs ikea_tables chairs airplanes] [--count 20] [--points 2000]
        [--rounds 10] [--seed 0] [--draw 0] [--proposal-only] [--unpainted] [--json]

The ikea sets are read from $SHAPEFORGE_DATA (else ``../shared/data``) and skipped where they are absent; the generated
sets are always there, and those of ``benchmarks.organic`` if asked for.  ``--seed`` draws the points and the generated
family, ``--draw`` (if not given, the same) the random numbers of the proposal.  Proposed parts are matched with the
truth's one to one, for the whole set at once, so that the shared area is largest (Hungarian method); what is matched
with nothing is wrong.  ``area`` is the share of the area whose part is right, ``IoU`` the mean over the true parts of a
shape; means over the shapes that no start painted.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.organic import FAMILIES as ORGANIC
from benchmarks.organic import write_organic
from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups, group_shapes
from shapeforge.collection.iterate import last
from shapeforge.collection.labels import find_part_names, read_seg
from shapeforge.collection.meshes import read_mesh
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Shape
from shapeforge.deformation.boxes import propose_parts
from shapeforge.deformation.faces import explanations, label_faces
from shapeforge.deformation.fit import fit_templates
from shapeforge.validation.segmentation import SegmentationScore, mean_score, score_segmentation
from shapeforge.validation.statistics import format_table

DEFAULT = ("ikea_chairs", "ikea_tables", "chairs", "airplanes")
SETS = (*DEFAULT, *ORGANIC)
FOLDERS = {"ikea_chairs": "ikea/chairs", "ikea_tables": "ikea/tables"}


@dataclass(frozen=True, eq=False)
class LabelledFamily:
    """Shapes with the true part of every face record (-1: not told), and the class of each shape."""

    shapes: tuple[Shape, ...]
    truth: tuple[np.ndarray, ...]
    part_names: tuple[str, ...]
    classes: tuple[str, ...]


def labelled_family(name: str, count: int | None, *, n_points: int, seed: int) -> LabelledFamily | None:
    """One of ``SETS``, evenly thinned to ``count`` shapes; None where its files are absent."""
    if name in ORGANIC:
        with tempfile.TemporaryDirectory() as folder:
            write_organic(Path(folder), name, count or 20, seed=seed)
            meshes, part_names = _read(Path(folder), None)
    elif name not in FOLDERS:
        made = generate(name, count or 20, seed=seed)
        meshes = [(one.name, one.mesh, np.asarray(one.faces), one.fine_class) for one in made]
        part_names = made[0].part_names
    else:
        data = os.environ.get("SHAPEFORGE_DATA")
        folder = (Path(data) if data else Path(__file__).resolve().parent.parent.parent / "shared/data") / FOLDERS[name]
        if not folder.is_dir():
            return None
        meshes, part_names = _read(folder, count)
    shapes = [
        prepare_shape(stem, mesh, n_points=n_points, up="y", rng=np.random.default_rng([seed, i]))
        for i, (stem, mesh, _, _) in enumerate(meshes)
    ]
    columns = list(zip(*meshes, strict=True))
    return LabelledFamily(tuple(shapes), columns[2], tuple(part_names), columns[3])


def _read(folder: Path, count: int | None) -> tuple[list, tuple[str, ...]]:
    """Name, mesh, true part of every face and class of ``count`` shapes (None: all) of a folder; names of the parts."""
    files = sorted(folder.glob("*.obj"))
    if count is not None and count < len(files):
        files = [files[i] for i in np.linspace(0, len(files) - 1, count).round().astype(int)]
    parts = find_part_names(folder)
    table = folder / "classes.csv"
    rows = csv.DictReader(table.read_text().splitlines()) if table.is_file() else ()
    classes = {row["name"]: row["class"] for row in rows}
    meshes = []
    for file in files:
        mesh = read_mesh(file)
        truth = read_seg(file.with_suffix(".seg"), mesh.n_faces, parts)
        meshes.append((file.stem, mesh, np.asarray(truth), classes.get(file.stem, "")))
    return meshes, parts.names


def matched_parts(tables: Sequence[np.ndarray]) -> np.ndarray:
    """The true part of every proposed part (n_proposed,), one to one, or ``n_true`` for one that matches none.

    ``tables`` hold the shared area (n_proposed, n_true) of every shape; each shape counts the same.
    """
    total = sum(table / max(table.sum(), 1e-12) for table in tables)
    row, column = linear_sum_assignment(-total)
    names = np.full(total.shape[0], total.shape[1])
    names[row] = column
    return names


def score_points(family: LabelledFamily, segmentations: Sequence[np.ndarray], kept: Sequence[int]) -> dict:
    """Matched accuracy of label probabilities of points, each of which stands for the same area."""
    n_true = len(family.part_names)
    labels = [np.asarray(s).argmax(axis=1) for s in segmentations]
    truths = [truth[shape.face_of_point] for shape, truth in zip(family.shapes, family.truth, strict=True)]
    n_proposed = segmentations[0].shape[1]
    tables = []
    for label, truth in zip(labels, truths, strict=True):
        table = np.zeros((n_proposed, n_true))
        np.add.at(table, (label[truth >= 0], truth[truth >= 0]), 1.0)
        tables.append(table)
    names = matched_parts(tables)
    purity = np.mean([tables[t].max(axis=1).sum() / max(tables[t].sum(), 1) for t in kept])
    scores = []
    for t in kept:
        told = truths[t] >= 0
        said, true = names[labels[t]][told], truths[t][told]
        overlaps = [((said == l) & (true == l)).sum() / ((said == l) | (true == l)).sum() for l in np.unique(true)]
        scores.append(SegmentationScore(float("nan"), float((said == true).mean()), float(np.mean(overlaps))))
    found = mean_score(scores)
    return {"area": found.area, "part_iou": found.part_iou, "purity": float(purity), "parts": n_proposed}


def score_faces(family: LabelledFamily, faces: Sequence[np.ndarray], n_parts: int, kept: Sequence[int]) -> dict:
    """Matched accuracy of labels per face record."""
    n_true = len(family.part_names)
    tables = []
    for shape, label, truth in zip(family.shapes, faces, family.truth, strict=True):
        table = np.zeros((n_parts, n_true))
        told = truth >= 0
        np.add.at(table, (label[told], truth[told]), shape.mesh.face_areas[told])
        tables.append(table)
    names = matched_parts(tables).astype(np.int32)
    scores = [score_segmentation(family.shapes[t].mesh, names[faces[t]], family.truth[t]) for t in kept]
    found = mean_score([score for score in scores if score is not None])
    return {"faces": found.faces, "area": found.area, "part_iou": found.part_iou}


def fitted(family: LabelledFamily, groups: Groups, rounds: int, labels: dict, names, seeds, kept) -> dict:
    """Matched accuracy of points and of faces after a fit."""
    state = last(
        fit_templates(
            family.shapes, groups, labels, tuple(names), rounds=rounds, seeds=seeds, rng=np.random.default_rng(0)
        )
    )
    beliefs = state.beliefs
    faces = [
        label_faces(shape, beliefs[t], explained=explanations(state, t))[0] for t, shape in enumerate(family.shapes)
    ]
    by_points = score_points(family, [one.segmentation for one in beliefs], kept)
    return score_faces(family, faces, len(names), kept) | {
        "points": by_points["area"], "points_iou": by_points["part_iou"], "energy": float(state.energy)
    }  # fmt: skip


def run(name: str, options: argparse.Namespace) -> dict | None:
    """All figures of one set; None where it is absent."""
    seed, rounds, proposal_only = options.seed, options.rounds, options.proposal_only
    draw = seed if options.draw is None else options.draw
    family = labelled_family(name, options.count or None, n_points=options.points, seed=seed)
    if family is None:
        return None
    groups = last(group_shapes(family.shapes, rng=np.random.default_rng(seed))).groups
    kept = [t for t in range(len(family.shapes)) if t not in set(groups.exemplars.tolist())]
    result: dict = {"shapes": len(family.shapes), "exemplars": len(groups), "scored": len(kept)}
    n_true = int(len(np.unique(np.concatenate([truth[truth >= 0] for truth in family.truth]))))
    if not proposal_only and not options.unpainted:
        labels = {int(t): family.truth[int(t)] for t in groups.exemplars}
        result["painted"] = fitted(family, groups, rounds, labels, family.part_names, None, kept)
    for start, n_parts in (("given", n_true), ("chosen", None)):
        begin = time.process_time()
        proposal = propose_parts(family.shapes, groups, n_parts=n_parts, rng=np.random.default_rng(draw))
        seconds = time.process_time() - begin
        found = score_points(family, proposal.segmentation, kept)
        result[start] = {"proposal": found | {"energy": proposal.energy, "cpu_seconds": seconds}}
        if not proposal_only:
            names, seeds = proposal.part_names, proposal.segmentation
            forced = replace(groups, exemplars=proposal.exemplars)
            result[start]["fit"] = fitted(family, forced, rounds, {}, names, seeds, kept)
    return result


def print_table(results: dict) -> None:
    """One line for each set and start."""
    rows = []
    for name, result in results.items():
        for start in ("painted", "given", "chosen"):
            if start not in result:
                continue
            found = result[start]
            proposal, fit = found.get("proposal", {}), found.get("fit", found if start == "painted" else {})
            cells = [proposal.get(k) for k in ("parts", "purity", "area", "part_iou")]
            cells += [fit.get(k) for k in ("points", "faces", "area", "part_iou")]
            text = ["" if c is None else c if isinstance(c, int) else f"{c:.3f}" for c in cells]
            rows.append([name, start, *text])
    head = ["set", "parts", "number", "purity", "area", "IoU", "fit: points", "faces", "area", "IoU"]
    print(format_table(head, rows), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", nargs="+", default=list(DEFAULT), choices=SETS)
    parser.add_argument("--count", type=int, default=20, help="shapes of a set; 0: all (of a generated one 20)")
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draw", type=int)
    parser.add_argument("--proposal-only", action="store_true", help="no fits")
    parser.add_argument("--unpainted", action="store_true", help="without the fits of painted exemplars")
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    results = {}
    for name in options.sets:
        found = run(name, options)
        if found is None:
            print(f"{name}: its shapes are not here (set SHAPEFORGE_DATA)", file=sys.stderr)
        else:
            results[name] = found
    if not options.json:
        print_table(results)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
