"""How good is the Beta Shape Machine, beside PCA per combination of parts, kernels on its scores, and a Gaussian DBM?

    python -m benchmarks.machine_quality [--families chairs airplanes] [--count 200] [--held-out 60] [--points 1500]
                                         [--sources NAME ...] [--seeds 3] [--seed 0] [--json]
    python -m benchmarks.machine_quality --families real --data DATA --project FOLDER --count 80 --held-out 34

A generated family has its true correspondences, so that only the machine is judged; ``real`` are the chairs of two
catalogues as a fit in the project FOLDER finds them (see ``machine_families``).  A seed draws the family and the split;
the tables hold means over seeds, the last line is one JSON object with the figures of each.

``--sources``: "training shapes"; "PCA", "KDE" and "Gaussian DBM", the baselines; "machine" as it is by default; and its
variants: another number of layers, with the print's spatial prior, without fine-tuning.  Of each: mean |D - D'| per
coordinate on held-out shapes, in % of the diagonal (from H1 or the components, and from a sampled top); MMD, coverage
and 1-NNA of as many draws as held-out shapes, by Chamfer distance of all points and, at most 30 shapes, by earth
mover's of 256; ``novelty``, the mean distance of draws to the nearest training shape relative to that of held-out
shapes (0 is a copy); how far the shares of combinations of parts are off at most, and the share of draws with one that
no shape has; the largest share of dead units in a layer.  Then fine classes by the machine's descriptors, 1-NN with 10
examples a class.

The Gaussian DBM's sizes and rate are chosen from ``GAUSSIAN_GRID`` by the error on held-out shapes of seed
``TUNING_SEED``, at a fifth of the points.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_info

from benchmarks.machine_families import Family, generated, real_chairs
from shapeforge.collection.iterate import last
from shapeforge.generative.baselines import draw_from_components, fit_principal_components, reconstruct_by_components
from shapeforge.generative.descriptors import describe_shapes
from shapeforge.generative.draw import draw, fit_mixture
from shapeforge.generative.gaussian import (
    draw_from_gaussian_machine,
    fit_gaussian_machine,
    reconstruct_by_gaussian_machine,
)
from shapeforge.generative.inference import decode, infer
from shapeforge.generative.learning import LearnState, dead_units, learn_machine, sampled_reconstruction
from shapeforge.generative.machine import BetaShapeMachine, layer_sizes
from shapeforge.generative.observations import Observations, to_positions
from shapeforge.generative.priors import Strengths
from shapeforge.generative.units import directions
from shapeforge.validation.classification import nearest_neighbour_accuracy
from shapeforge.validation.plausibility import chamfer_table, plausibility_of_table, thin_cloud
from shapeforge.validation.statistics import format_table

FINE_CLOUD, MOST_FINE, MANY = 256, 30, 1000
TUNING_SEED, TUNING_SHAPES, THINNED = 1000, 150, 5
GAUSSIAN_GRID = [(units, rate) for units in ((100, 50), (300, 100)) for rate in (0.3, 1.0, 3.0)]
VARIANTS: dict[str, dict] = {
    "machine": {},
    "1 layer": {"layers": 1},
    "2 layers": {"layers": 2},
    "3 layers": {"layers": 3},
    "spatial prior": {"smooth": 1e-2},
    "no fine-tuning": {"pretrained": True},
}
BASELINES = ("training shapes", "PCA", "KDE", "Gaussian DBM")
COLUMNS = {
    "error": "error %", "error_top": "from the top", "mmd": "MMD", "coverage": "coverage", "one_nn": "1-NNA",
    "emd_mmd": "EMD: MMD", "emd_coverage": "coverage", "emd_one_nn": "1-NNA", "novelty": "novelty",
    "pattern_gap": "shares off", "impossible": "impossible", "dead": "dead",
}  # fmt: skip

Drawer = Callable[[int], tuple[np.ndarray, np.ndarray]]
"""Positions (n, K, 3) and parts (n, L) of n new shapes."""


@dataclass(frozen=True, eq=False)
class Split:
    """Shapes to learn from, others to judge by, and the seed of both."""

    train: Family
    test: Family
    seed: int


def parted(options: argparse.Namespace, family: str, seed: int, *, points: int, count: int) -> Split:
    """``count`` shapes to learn from and ``--held-out`` others."""
    if family == "real":
        whole = real_chairs(options.data, options.project, n_points=options.points)
        every = max(1, round(options.points / points))
        seen = whole.observations
        whole = replace(whole, observations=replace(seen, values=seen.values[:, ::every], part=seen.part[::every]))
    else:
        whole = generated(family, count + options.held_out, seed=seed, n_points=points)
    order = np.random.default_rng(seed).permutation(len(whole.classes))
    count = min(count, len(order) - options.held_out)
    return Split(whole.subset(order[:count]), whole.subset(order[count : count + options.held_out]), seed)


def reconstruction_error(observations: Observations, values: np.ndarray) -> float:
    """Mean |D - D'| per coordinate over the points that exist, in % of the diagonal."""
    there = observations.exists[:, observations.part]
    return float(
        100 * np.abs(values - observations.values).mean(axis=2)[there].mean() * observations.diagonals_per_unit
    )


def tuned_gaussian(options: argparse.Namespace, family: str) -> dict:
    """Sizes and rate of the Gaussian DBM with the least error on held-out shapes of another seed."""
    most = min(options.count, TUNING_SHAPES)
    split = parted(options, family, TUNING_SEED, points=options.points // THINNED, count=most)
    train, test = split.train.observations, split.test.observations
    errors = []
    with np.errstate(all="ignore"):  # too high a rate runs away
        for units, rate in GAUSSIAN_GRID:
            model = fit_gaussian_machine(train, rng=np.random.default_rng(TUNING_SEED), units=units, rate=rate)
            error = reconstruction_error(test, reconstruct_by_gaussian_machine(model, test))
            errors.append(error if np.isfinite(error) else np.inf)
    units, rate = GAUSSIAN_GRID[int(np.argmin(errors))]
    return {"units": units, "rate": rate}


def learnt(train: Observations, seed: int, layers: int | None = None, smooth: float = 0.0, pretrained: bool = False):
    """The last state of learning, or of pre-training."""
    counts = np.bincount(train.part, minlength=len(train.part_names)).tolist()
    sizes = layer_sizes(counts, train.n_shapes, layers)
    states = learn_machine(train, rng=np.random.default_rng([seed, 1]), sizes=sizes, strengths=Strengths(smooth=smooth))
    if not pretrained:
        return last(states)
    state = last(takewhile(lambda state: state.phase != "fine-tune", states))
    return replace(state, dead_units=dead_units(state.machine, infer(state.machine, train.values, train.exists)))


def of_machine(split: Split, state: LearnState, rng: np.random.Generator) -> tuple[dict, Drawer]:
    """Figures of a machine, and what draws from it."""
    machine, test = state.machine, split.test.observations
    sampled, latents = sampled_reconstruction(machine, test, rng=rng)
    mixture = fit_mixture(machine, split.train.observations)

    def drawer(n: int) -> tuple[np.ndarray, np.ndarray]:
        drawn = draw(machine, mixture, n, rng=rng)
        return drawn.points, drawn.exists

    return {
        "error": reconstruction_error(test, decode(machine, latents)), "error_top": reconstruction_error(test, sampled),
        "dead": max(state.dead_units), "sizes": list(machine.sizes),
    }, drawer  # fmt: skip


def of_baseline(name: str, split: Split, gaussian: dict | None, rng: np.random.Generator) -> tuple[dict, Drawer]:
    """Figures of a baseline, and what draws from it."""
    train, test = split.train.observations, split.test.observations
    if name == "training shapes":
        order = rng.permutation(train.n_shapes)
        return {}, lambda n: (train.positions()[order[:n]], train.exists[order[:n]])
    if name == "Gaussian DBM":
        machine = fit_gaussian_machine(train, rng=rng, **gaussian)
        again = reconstruct_by_gaussian_machine(machine, test)
        draws = partial(draw_from_gaussian_machine, machine, rng=rng)
    else:
        model = fit_principal_components(train)
        again = reconstruct_by_components(model, test)
        draws = partial(draw_from_components, model, rng=rng, kernel=name == "KDE")

    def drawer(n: int) -> tuple[np.ndarray, np.ndarray]:
        values, exists = draws(n)
        return to_positions(values, exists, train.part, train.low, train.high), exists

    return {"error": reconstruction_error(test, again)}, drawer


class Judge:
    """Held-out shapes, and how far they are from each other."""

    def __init__(self, split: Split) -> None:
        rng = np.random.default_rng([split.seed, 2])
        self.real, self.training = split.test.observations.positions(), split.train.observations.positions()
        self.parts = split.train.observations.exists, split.test.observations.exists
        self.clouds = [thin_cloud(points, points.size, rng=rng) for points in self.real]
        self.fine = [thin_cloud(points, FINE_CLOUD, rng=rng) for points in self.real[:MOST_FINE]]
        self.table, self.fine_table = chamfer_table(self.clouds), earth_mover_table(self.fine)
        self.away = nearest_distance(self.real, self.training)

    def of_draws(self, drawer: Drawer, rng: np.random.Generator) -> dict[str, float]:
        """Figures of as many draws as there are held-out shapes; of parts, of many more."""
        new = drawer(len(self.real))[0]
        clouds = [thin_cloud(points, points.size, rng=rng) for points in new]
        fine = [thin_cloud(points, FINE_CLOUD, rng=rng) for points in new[:MOST_FINE]]
        rough = plausibility_of_table(joined(self.table, self.clouds, clouds, chamfer_table), len(clouds))
        moved = plausibility_of_table(joined(self.fine_table, self.fine, fine, earth_mover_table), len(fine))
        return {
            "mmd": rough.mmd, "coverage": rough.coverage, "one_nn": rough.one_nn,
            "emd_mmd": moved.mmd, "emd_coverage": moved.coverage, "emd_one_nn": moved.one_nn,
            "novelty": nearest_distance(new, self.training) / self.away, **self.of_parts(drawer(MANY)[1]),
        }  # fmt: skip

    def of_parts(self, drawn: np.ndarray) -> dict[str, float]:
        """How far the shares of combinations are off, and how many have one that no shape of the family has."""
        seen, held_out = self.parts
        possible = {tuple(row) for rows in self.parts for row in rows}
        gaps = [abs(share_of(drawn, pattern) - share_of(seen, pattern)) for pattern in np.unique(seen, axis=0)]
        return {"pattern_gap": max(gaps), "impossible": float(np.mean([tuple(row) not in possible for row in drawn]))}


def share_of(exists: np.ndarray, pattern: np.ndarray) -> float:
    """Share of the rows of ``exists`` (n, L) that are just the ``pattern`` (L,)."""
    return float((exists == pattern).all(axis=1).mean())


def joined(known: np.ndarray, real: list, new: list, distances: Callable) -> np.ndarray:
    """The table of all shapes, the real ones first, of which the distances among the real ones are known."""
    between = distances(real, new)
    return np.block([[known, between], [between.T, distances(new)]])


def earth_mover_table(rows: list[np.ndarray], columns: list[np.ndarray] | None = None) -> np.ndarray:
    """Mean distance of the best one-to-one match of every cloud with every other (of the points that both have)."""
    others = rows if columns is None else columns
    table = np.zeros((len(rows), len(others)))
    for i, a in enumerate(rows):
        for j in range(i + 1 if columns is None else 0, len(others)):
            costs = cdist(a, others[j])
            table[i, j] = costs[linear_sum_assignment(costs)].mean()
    return table + table.T if columns is None else table


def nearest_distance(shapes: np.ndarray, training: np.ndarray) -> float:
    """Mean over the shapes of the distance of corresponding points to the nearest training shape that has the same."""
    found = []
    for shape in shapes:
        there = np.isfinite(shape[:, 0])
        away = np.linalg.norm(training[:, there] - shape[there], axis=2).mean(axis=1)
        if np.isfinite(away).any():
            found.append(np.nanmin(away))
    return float(np.mean(found))


def fine_classes(split: Split, machine: BetaShapeMachine, rng: np.random.Generator) -> dict[str, float]:
    """Share of right classes among all shapes that have one, by the machine and by 20 principal components and E."""
    both = [side.observations for side in (split.train, split.test)]
    values, exists = (np.concatenate([getattr(one, name) for one in both]) for name in ("values", "exists"))
    classes = np.concatenate([split.train.classes, split.test.classes])
    known = np.flatnonzero(classes != "")
    seen = replace(both[0], values=values[known], exists=exists[known])
    described = describe_shapes(machine, seen)
    flat = (seen.values * seen.exists[:, seen.part, None]).reshape(len(known), -1)
    left, strength, _ = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    scores = left[:, :20] * strength[:20] / (left[:, :20] * strength[:20]).std()
    tried = {
        "descriptors": described, "top layer alone": described[:, : machine.sizes[-1]],
        "PCA 20 and parts": np.concatenate([scores, 5 * seen.exists], axis=1),
    }  # fmt: skip
    found = {}
    for name, numbers in tried.items():
        score = nearest_neighbour_accuracy(numbers, classes[known].tolist(), 10, rng=rng)
        found[name] = score.accuracy
    return found | {"shapes": len(known), "classes": score.n_classes}


def run(options: argparse.Namespace, family: str, seed: int, gaussian: dict | None) -> dict:
    """Figures of every source on one split of a family."""
    split = parted(options, family, seed, points=options.points, count=options.count)
    judge, train = Judge(split), split.train.observations
    usual = len(layer_sizes([1], train.n_shapes))
    result: dict = {"seed": seed, "shapes": train.n_shapes, "points": train.values.shape[1], "sources": {}}
    for number, name in enumerate((*BASELINES, *VARIANTS)):
        if name not in options.sources:
            continue
        if VARIANTS.get(name, {}).get("layers") == usual:
            continue
        begin, rng = time.process_time(), np.random.default_rng([seed, 3, number])
        if name in VARIANTS:
            state = learnt(train, seed, **VARIANTS[name])
            figures, drawer = of_machine(split, state, rng)
            figures["cpu_seconds"] = time.process_time() - begin
        else:
            figures, drawer = of_baseline(name, split, gaussian, rng)
        result["sources"][name] = figures | judge.of_draws(drawer, rng)
        if name == "machine":
            result["classes"] = fine_classes(split, state.machine, rng)
            result["sliders_percent"] = [100 * d.size for d in directions(state.machine, train, 4)]
        print(f"{family}, seed {seed}, {name}: {time.process_time() - begin:.0f} CPU-seconds", file=sys.stderr)
    return result


def mean_of(results: list[dict]) -> dict[str, dict[str, float]]:
    """Figures of every source, means over the seeds."""
    return {
        name: {key: float(np.mean([r["sources"][name][key] for r in results])) for key in COLUMNS if key in first}
        for name, first in results[0]["sources"].items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--families", nargs="+", choices=("chairs", "airplanes", "real"), default=["chairs", "airplanes"]
    )
    parser.add_argument("--data", type=Path, help="folder of the real shapes")
    parser.add_argument("--project", type=Path, help="where the real shapes are fitted")
    parser.add_argument("--sources", nargs="+", choices=(*BASELINES, *VARIANTS), default=[*BASELINES, *VARIANTS])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--held-out", type=int, default=60)
    parser.add_argument("--points", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    if "real" in options.families and (options.data is None or options.project is None):
        parser.error("--families real: wanted --data, where the chairs are, and --project, where they are fitted")
    whole = {}
    for family in options.families:
        gaussian = tuned_gaussian(options, family) if "Gaussian DBM" in options.sources else None
        results = [run(options, family, seed, gaussian) for seed in range(options.seed, options.seed + options.seeds)]
        whole[family] = {"means": mean_of(results), "gaussian": gaussian, "of_each_seed": results}
        if not options.json:
            print(f"\n{family}: {results[0]['shapes']} shapes, K {results[0]['points']}, {options.seeds} seeds")
            rows = [[name, *(of.get(key, "") for key in COLUMNS)] for name, of in whole[family]["means"].items()]
            print(format_table(["", *COLUMNS.values()], rows))
            if "classes" in results[0]:
                names = results[0]["classes"]
                print(
                    "fine classes:", ", ".join(f"{n} {np.mean([r['classes'][n] for r in results]):.3f}" for n in names)
                )
                print("sliders, %:", ", ".join(f"{s:.1f}" for s in np.mean([r["sliders_percent"] for r in results], 0)))
    blas = [f"{lib.get('internal_api')} {lib.get('architecture', '')} x{lib.get('num_threads')}"
            for lib in threadpool_info() if lib.get("user_api") == "blas"]  # fmt: skip
    print(json.dumps({"families": whole, "held_out": options.held_out, "blas": blas}))


if __name__ == "__main__":
    main()
