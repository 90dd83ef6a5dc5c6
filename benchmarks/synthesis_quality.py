"""How good are the meshes made from draws?  Generated families with true correspondences: only synthesis is judged.

    python -m benchmarks.synthesis_quality [--family chairs] [--count 40] [--draws 20] [--seed 0] [--json]
    python -m benchmarks.synthesis_quality --project demo/project [--draws 24] [--routes parts labels surface]

With ``--project`` meshes are made from draws of a learnt project, whose segmentations are those of its fit, and
measured beside the training shapes, their parts cut cleanly: by the ``--routes`` `parts` (and as one solid, with
manifold3d), `labels` (parts cut along the labels as they are) and `surface` (from scratch).  Of the route `parts` is
asked what a designer would: contact gap and symmetry error within 1.5 times those of the training shapes, no folds, all
parts on 95 % of the shapes, and a median distance to the nearest training shape above half of theirs to each other.
Draws whose parts do not go together are drawn anew, as ``shapeforge synthesize`` does (``redrawn``: their share).
``--out`` writes contact sheets of at most SHEET shapes each.

Otherwise two kinds of draws: ``between`` lies half-way between two training shapes with the same parts, ``held out`` is
a shape that the sources don't contain; both with Gaussian noise on every point, as a generative model would leave it.
Lengths are in bounding-box diagonals.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from benchmarks.true_family import TrueFamily, true_family
from shapeforge.collection.colours import part_colours
from shapeforge.collection.points import sample_points
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.collection.surface import closest_points
from shapeforge.generative.draw import draw
from shapeforge.generative.inference import Latents
from shapeforge.stages_recipes import points_of
from shapeforge.stages_synthesis import completed, made_whole, sources_of
from shapeforge.store import Project
from shapeforge.synthesis.assemble import SynthesizedShape, synthesize
from shapeforge.synthesis.cleaning import clean_labels, components, neighbours
from shapeforge.synthesis.contacts import training_gaps
from shapeforge.synthesis.measures import raggedness, symmetry_error
from shapeforge.synthesis.retrieve import retrieve
from shapeforge.synthesis.sources import FEWEST_POINTS, Sources
from shapeforge.synthesis.surface import synthesize_surface
from shapeforge.synthesis.surfaces import as_mesh, weld
from shapeforge.synthesis.union import solid_modeller, unite
from shapeforge.validation.plausibility import chamfer, contact_distance, novelty, open_share, plausibility
from shapeforge.validation.statistics import format_table

ROUTES = ("parts", "labels", "surface")
SHEET = 40
NOISE = 0.004


def draws_between(family: TrueFamily, chosen: np.ndarray, n: int, *, rng: np.random.Generator) -> list[tuple]:
    """(points, exists, None) half-way between random pairs of chosen shapes with the same parts."""
    patterns = {int(i): tuple(family.exists(i)) for i in chosen}
    pairs = [(i, j) for i in patterns for j in patterns if i < j and patterns[i] == patterns[j]]
    found = []
    for k in rng.permutation(len(pairs)):
        if len(found) == n:
            break
        i, j = pairs[k]
        middle = 0.5 * (family.positions[i] + family.positions[j])
        known = np.bincount(family.part, np.isfinite(middle[:, 0]), len(family.part_names))
        if (known[np.array(patterns[i])] < FEWEST_POINTS).any():
            continue  # an engine in the nose and engines under the wings have nothing half-way
        found.append((middle + rng.normal(0, NOISE, middle.shape), np.array(patterns[i]), None))
    return found


def draws_held_out(family: TrueFamily, left_out: np.ndarray, *, rng: np.random.Generator) -> list[tuple]:
    """(points, exists, index of the true shape)."""
    return [
        (family.positions[i] + rng.normal(0, NOISE, family.positions[i].shape), family.exists(i), int(i))
        for i in left_out
    ]


def measure(family: TrueFamily, draws: list[tuple], sources: Sources, real: list[np.ndarray], rng) -> dict:
    """Means over the draws: seconds, gaps, folds, symmetry, distance from draw and truth; plausibility of clouds."""
    seconds, preview, made, truth = [], [], [], []
    for points, exists, index in draws:
        retrieve(points, exists, sources)  # the sources are read once; the seconds are those of the mesh
        begin = time.perf_counter()
        shape = synthesize(points, exists, sources)
        seconds.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        synthesize(points, exists, sources, preview=True)
        preview.append(time.perf_counter() - begin)
        made.append(shape)
        if index is not None:
            truth.append(chamfer(cloud(family.shapes[index].mesh, rng), cloud(mesh_of(shape), rng)))
    clouds = [cloud(mesh_of(shape), rng) for shape in made]
    gaps = np.array([shape.measures["largest_gap"] for shape in made])
    on_surface = [
        closest_points(mesh_of(shape), points[np.isfinite(points).all(axis=1) & exists[family.part]])[2].mean()
        for shape, (points, exists, _) in zip(made, draws, strict=True)
    ]
    result, new = plausibility(real, clouds), novelty(real, clouds)
    return {
        "n": len(made),
        "seconds": float(np.median(seconds)),
        "preview_seconds": float(np.median(preview)),
        "gap_mean": float(gaps.mean()),
        "gap_over_.005": float((gaps > 0.005).mean()),
        "too_deep": float(np.mean([shape.measures["too_deep"] for shape in made])),
        "contact_distance": mean_of([contact_distance(mesh_of(s), s.part, sources.touching) for s in made]),
        "complete": float(np.mean([is_complete(s, exists) for s, (_, exists, _) in zip(made, draws, strict=True)])),
        "folds": float(np.mean([shape.measures["folded_triangles"] for shape in made])),
        "novelty": new.new,
        "novelty_over_real": new.ratio,
        "symmetry_error": float(np.mean([symmetry_error(c) for c in clouds])),
        "draw_to_surface": float(np.mean(on_surface)),
        "truth_chamfer": float(np.mean(truth)) if truth else None,
        "mmd": result.mmd,
        "coverage": result.coverage,
        "one_nn": result.one_nn,
    }


def mean_of(values: list[float | None]) -> float | None:
    """Mean of those that are known."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def is_complete(shape: SynthesizedShape, exists: np.ndarray) -> bool:
    """Whether the mesh has every part that the draw names."""
    return all(bool(source) for source, wanted in zip(shape.sources, exists, strict=True) if wanted)


def mesh_of(shape: SynthesizedShape) -> Mesh:
    return as_mesh(shape.vertices, shape.triangles)


def cloud(mesh: Mesh, rng: np.random.Generator, n: int = 700) -> np.ndarray:
    return sample_points(mesh, n, rng=rng)[0]


def run(family_name: str, count: int, n_draws: int, seed: int) -> dict:
    """All figures of one family."""
    rng = np.random.default_rng(seed)
    family = true_family(family_name, count, seed=seed)
    n_out = min(n_draws, count // 3)
    left_out, chosen = np.arange(count - n_out, count), np.arange(count - n_out)
    sources = family.sources(chosen)
    real = [cloud(family.shapes[i].mesh, rng) for i in range(count)]
    touch = [
        contact_distance(family.shapes[i].mesh, family.faces[i][family.shapes[i].mesh.face_of_triangle],
                         sources.touching)
        for i in range(count)
    ]  # fmt: skip
    return {
        "between": measure(family, draws_between(family, chosen, n_draws, rng=rng), sources, real, rng),
        "held out": measure(family, draws_held_out(family, left_out, rng=rng), sources, real, rng),
        "real": {
            "n": count,
            "contact_distance": mean_of(touch),
            "symmetry_error": float(np.mean([symmetry_error(c) for c in real])),
        },
    }


def from_project(
    path: str, n_draws: int, seed: int, routes: tuple[str, ...] = ROUTES, sheets: str | None = None
) -> dict:
    """Figures of a project's draws by every route, and of its training shapes."""
    project = Project.open(path)
    machine, mixture = project.machine(), project.mixture()
    if machine is None or mixture is None:
        raise SystemExit(f"{path}: wanted a project with a learnt machine. Run `shapeforge learn` first.")
    clean = replace(sources_of(project), keep=len(project.fit_names))
    draws = completed(machine, draw(machine, mixture, n_draws, rng=np.random.default_rng(seed)), clean)
    rng = np.random.default_rng(seed)
    shapes = [clean.get_shape(i) for i in range(len(clean.names))]
    real = [cloud(shape.mesh, rng) for shape in shapes]
    as_labelled = replace(clean, painted=frozenset(clean.names), smooth=False, _cache=OrderedDict())
    makers = {
        "labels": partial(synthesize, sources=as_labelled),
        "parts": partial(synthesize, sources=clean),
        "surface": partial(synthesize_surface, sources=clean),
    }
    result = {"training": training_figures(shapes, clean, real)}

    def again(i: int, turn: int) -> Latents:
        return completed(machine, draw(machine, mixture, 1, rng=np.random.default_rng([seed, i, turn])), clean).latents

    for name in routes:

        def made_of(latents: Latents, make: Callable = makers[name]) -> SynthesizedShape:
            return make(points_of(machine, latents), latents.exists[0])

        begin = time.process_time()
        found = [made_whole(made_of, draws.latents[i], partial(again, i)) for i in range(n_draws)]
        seconds = (time.process_time() - begin) / n_draws
        made, exists = [shape for shape, _ in found], np.concatenate([latents.exists for _, latents in found])
        result[name] = {"cpu_seconds": seconds, **figures_of(made, exists, clean, real, rng)}
        if sheets:
            for start in range(0, len(made), SHEET):
                name_of = f"{project.name} {name} {start // SHEET + 1}.png"
                write_sheet(Path(sheets) / name_of, made[start : start + SHEET])
        if name == "parts":
            result[name]["raggedness"] = float(np.mean([
                clean.part_of(clean.names.index(source), l).quality.raggedness
                for shape in made for l, source in enumerate(shape.sources) if source
            ]))  # fmt: skip
            result[name] |= figures_of_solids(made)
            result["asked of parts"] = what_is_asked(result[name], result["training"])
    return result


def training_figures(shapes: list[Shape], sources: Sources, real: list[np.ndarray]) -> dict:
    """The same figures of the training shapes, whose parts are those that meshes are made from."""
    labels = [np.asarray(l)[s.mesh.face_of_triangle] for s, l in zip(shapes, sources.face_labels, strict=True)]
    points = [p[np.isfinite(p).all(axis=1)] for p in np.asarray(sources.positions, float)]
    islands = [n_islands(s.mesh.vertices, s.mesh.triangles, l, sources.n_parts)
               for s, l in zip(shapes, labels, strict=True)]  # fmt: skip
    ragged = [raggedness(s.mesh, l, int(part)) for s, l in zip(shapes, labels, strict=True) for part in np.unique(l)]
    on_mesh = [closest_points(s.mesh, p)[2].mean() for s, p in zip(shapes, points, strict=True)]
    gaps = [list(training_gaps(sources.parts_of(t)).values()) for t in range(len(shapes))]
    return {
        "n": len(shapes),
        "contact_distance": mean_of(
            [contact_distance(s.mesh, l, sources.touching) for s, l in zip(shapes, labels, strict=True)]
        ),
        "contact_gap": float(np.mean([np.mean(found) for found in gaps if found])),
        "symmetry_error": float(np.mean([mirror_error(c, sources) for c in real])),
        "islands": float(np.mean(islands)),
        "raggedness": float(np.mean(ragged)),
        "draw_to_surface": float(np.mean(on_mesh)),
        "open_share": float(np.mean([open_share(s.mesh) for s in shapes])),
    }


def what_is_asked(made: dict, training: dict) -> dict:
    """The ratios and shares that are asked for, and whether all are as they should be."""
    figures = {
        "gap_over_training": made["contact_gap"] / max(training["contact_gap"], 1e-9),
        "symmetry_over_training": made["symmetry_error"] / max(training["symmetry_error"], 1e-9),
        "folds": made["folds"],
        "complete": made["complete"],
        "novelty_over_real": made["novelty_over_real"],
    }
    reached = (
        figures["gap_over_training"] <= 1.5 and figures["symmetry_over_training"] <= 1.5 and figures["folds"] == 0
        and figures["complete"] >= 0.95 and figures["novelty_over_real"] > 0.5
    )  # fmt: skip
    return figures | {"reached": float(reached)}


def figures_of(made: list[SynthesizedShape], exists: np.ndarray, sources: Sources, real: list, rng) -> dict:
    """The figures that all routes have, and those of parts where there are any."""
    clouds = [cloud(mesh_of(shape), rng) for shape in made]
    like, new = plausibility(real, clouds), novelty(real, clouds)
    found = {
        "n": len(made),
        "contact_distance": mean_of([contact_distance(mesh_of(s), s.part, sources.touching) for s in made]),
        "complete": float(np.mean([has_parts(s, e) for s, e in zip(made, exists, strict=True)])),
        "symmetry_error": float(np.mean([mirror_error(c, sources) for c in clouds])),
        "open_share": float(np.mean([open_share(mesh_of(s)) for s in made])),
        "mmd": like.mmd, "coverage": like.coverage, "one_nn": like.one_nn, "novelty_over_real": new.ratio,
        "distance_from_draw": float(np.mean([shape.measures["distance_from_draw"] for shape in made])),
        "redrawn": float(np.mean(["redrawn" in shape.measures for shape in made])),
    }  # fmt: skip
    if "largest_gap" in made[0].measures:
        gaps = np.array([shape.measures["largest_gap"] for shape in made])
        found |= {
            "contact_gap": mean_of([shape.measures["contact_gap"] for shape in made]),
            "gap_mean": float(gaps.mean()), "gap_over_.005": float((gaps > 0.005).mean()),
            "too_deep": float(np.mean([shape.measures["too_deep"] for shape in made])),
            "folds": float(np.mean([shape.measures["folded_triangles"] for shape in made])),
            "islands": float(np.mean([n_islands(s.vertices, s.triangles, s.part, sources.n_parts) for s in made])),
        }  # fmt: skip
    return found


def mirror_error(points: np.ndarray, sources: Sources) -> float:
    """Symmetry error about the family's mirror, through the middle of the points' box."""
    along = points @ sources.mirror.normal
    return symmetry_error(points, (sources.mirror.normal, float(along.min() + along.max()) / 2))


def has_parts(shape: SynthesizedShape, exists: np.ndarray) -> bool:
    """Whether the mesh has surface of every part that the draw names."""
    return bool(np.isin(np.flatnonzero(exists), shape.part).all())


def figures_of_solids(made: list[SynthesizedShape]) -> dict:
    """Share of the shapes that become one closed solid, and of those whose parts were closed by themselves."""
    try:
        solid_modeller()
    except ValueError:
        return {}
    done = []
    for shape in made:
        with suppress(ValueError):
            done.append(unite(shape).measures)
    closed = [one for one in done if one["open_edges"] == 0]
    return {"united": len(closed) / len(made), "united_as_is": sum("closed" not in one for one in closed) / len(made)}


def write_sheet(path: Path, made: list[SynthesizedShape]) -> None:
    """A picture of all shapes, to be looked at."""
    from PIL import Image

    from shapeforge.viewer.pictures import contact_sheet, thumbnail

    pictures = [thumbnail(mesh_of(s), part_colours(len(s.part_names))[s.part], 220, "light") for s in made]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(contact_sheet(pictures, [], None, "light")).save(path)


def n_islands(vertices: np.ndarray, triangles: np.ndarray, label: np.ndarray, n_parts: int) -> int:
    """Specks and lone pieces: connected regions whose label :func:`clean_labels` would change."""
    vertices, triangles = weld(vertices, triangles)
    changed = clean_labels(vertices, triangles, label, n_parts) != label
    first, second, _ = neighbours(vertices, triangles)
    same = label[first] == label[second]
    return len(np.unique(components(len(label), first[same], second[same])[changed]))


def main() -> None:
    """Print a table and one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--family", choices=("chairs", "airplanes", "both"), default="both")
    parser.add_argument("--project", help="a project with a learnt machine, instead of generated families")
    parser.add_argument("--routes", nargs="+", choices=ROUTES, default=ROUTES, help="with --project")
    parser.add_argument("--out", help="with --project: folder for contact sheets")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="the JSON line only")
    options = parser.parse_args()
    families = ("chairs", "airplanes") if options.family == "both" else (options.family,)
    if options.project:
        figures = {
            options.project: from_project(
                options.project, options.draws, options.seed, tuple(options.routes), options.out
            )
        }
        families = ()
    else:
        figures = {}
    figures |= {name: run(name, options.count, options.draws, options.seed) for name in families}
    if not options.json:
        for name, found in figures.items():
            columns = list(dict.fromkeys(figure for figures in found.values() for figure in figures))
            rows = [
                [figure, *(("–" if found[kind].get(figure) is None else found[kind][figure]) for kind in found)]
                for figure in columns
            ]
            print(format_table([name, *found], rows), end="\n\n")
        for library in threadpool_info():
            print(f"{library['internal_api']} {library.get('architecture', '')}: {library['num_threads']} threads")
    print(json.dumps({"benchmark": "synthesis_quality", "families": figures}))


if __name__ == "__main__":
    main()
