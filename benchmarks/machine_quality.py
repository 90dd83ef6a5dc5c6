"""How good is the Beta Shape Machine, beside PCA per combination of parts, kernels on its scores, and a Gaussian DBM?

    python -m benchmarks.machine_quality [--family chairs] [--count 200] [--held-out 60] [--points 1500] [--seeds 1]
                                         [--layers N] [--smooth 0] [--sparse 0] [--pretrained] [--json]
    python -m benchmarks.machine_quality --corresponding POINTS.npz

A generated family with its true correspondences, so that only the machine is judged, or corresponding points of a
fitted family: an npz with ``positions`` (T, K, 3), NaN where absent, ``part`` (K,) and ``names`` (L,).  Errors are mean
|D - D'| per coordinate on held-out shapes, in % of the diagonal, and in the same unit for PCA.  Plausibility is between
clouds of the held-out shapes and as many new ones, by Chamfer distance (300 points) and, at most 30 shapes, by earth
mover's (256 points); ``novelty`` is the mean distance of new shapes to the nearest training shape, relative to that of
held-out shapes (0 is a copy).  A seed draws the family and the split; means over seeds.  The last line is one JSON
object.

The Gaussian DBM's sizes and rate are chosen from ``GAUSSIAN_GRID`` by the error on held-out shapes of the family that
seed ``TUNING_SEED`` stands for, at a fifth of the points (of a fitted family: of another split).  ``--pretrained``
leaves out fine-tuning, ``--no-gaussian`` the Gaussian DBM.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_info

from benchmarks.synthesis_quality import true_family
from shapeforge.collection.iterate import last
from shapeforge.generative.baselines import draw_from_components, fit_principal_components, reconstruct_by_components
from shapeforge.generative.draw import draw, fit_mixture
from shapeforge.generative.gaussian import (
    draw_from_gaussian_machine,
    fit_gaussian_machine,
    reconstruct_by_gaussian_machine,
)
from shapeforge.generative.inference import decode, infer
from shapeforge.generative.learning import LearnState, dead_units, learn_machine, sampled_reconstruction
from shapeforge.generative.machine import layer_sizes
from shapeforge.generative.observations import Observations, observe, to_positions
from shapeforge.generative.priors import Strengths
from shapeforge.generative.units import directions
from shapeforge.validation.plausibility import chamfer_table, plausibility_of_table, thin_cloud
from shapeforge.validation.statistics import format_table

CLOUD, FINE_CLOUD, MOST_FINE = 300, 256, 30
TUNING_SEED, TUNING_SHAPES, THINNED = 1000, 150, 5
GAUSSIAN_GRID = [(units, rate) for units in ((100, 50), (300, 100)) for rate in (0.3, 1.0, 3.0)]


def observed(options: argparse.Namespace, seed: int) -> Observations:
    """The family that is asked for."""
    if options.corresponding is not None:
        with np.load(options.corresponding) as stored:
            return observe(stored["positions"].astype(float), stored["part"], tuple(str(n) for n in stored["names"]))
    family = true_family(options.family, options.count + options.held_out, seed=seed, n_points=options.points)
    return observe(family.positions, family.part, family.part_names)


def reconstruction_error(observations: Observations, values: np.ndarray) -> float:
    """Mean |D - D'| per coordinate over the points that exist, in diagonals."""
    there = observations.exists[:, observations.part]
    return float(np.abs(values - observations.values).mean(axis=2)[there].mean() * observations.diagonals_per_unit)


def earth_mover_table(clouds: list[np.ndarray]) -> np.ndarray:
    """Mean distance of the best one-to-one match, all clouds to each other (of the points that both have)."""
    table = np.zeros((len(clouds), len(clouds)))
    for i, a in enumerate(clouds):
        for j, b in enumerate(clouds[:i]):
            costs = cdist(a, b)
            table[i, j] = table[j, i] = costs[linear_sum_assignment(costs)].mean()
    return table


def parted(options: argparse.Namespace, seed: int) -> tuple[Observations, Observations]:
    """(``--count`` shapes to learn from, ``--held-out`` others)."""
    observations = observed(options, seed)
    order = np.random.default_rng(seed).permutation(observations.n_shapes)
    count = min(options.count, observations.n_shapes - 2)
    if options.corresponding is not None:
        count = min(count, observations.n_shapes - options.held_out)
    return observations.subset(order[:count]), observations.subset(order[count : count + options.held_out])


def tuned_gaussian(options: argparse.Namespace) -> dict:
    """Sizes and rate of the Gaussian DBM with the least error on held-out shapes of another seed."""
    most = min(options.count, TUNING_SHAPES)
    other = argparse.Namespace(**{**vars(options), "points": options.points // THINNED, "count": most})
    parts = parted(other, TUNING_SEED)
    if options.corresponding is not None:
        few = parts[0].part[::THINNED]
        parts = [replace(side, values=side.values[:, ::THINNED], part=few) for side in parts]
    errors = []
    with np.errstate(all="ignore"):  # too high a rate runs away
        for units, rate in GAUSSIAN_GRID:
            model = fit_gaussian_machine(parts[0], rng=np.random.default_rng(TUNING_SEED), units=units, rate=rate)
            error = reconstruction_error(parts[1], reconstruct_by_gaussian_machine(model, parts[1]))
            errors.append(error if np.isfinite(error) else np.inf)
    units, rate = GAUSSIAN_GRID[int(np.argmin(errors))]
    return {"units": units, "rate": rate}


def learnt(train: Observations, options: argparse.Namespace, rng: np.random.Generator) -> LearnState:
    """The last state of learning, or of pre-training."""
    counts = np.bincount(train.part, minlength=len(train.part_names)).tolist()
    settings = {
        "sizes": layer_sizes(counts, train.n_shapes, options.layers), "epochs": options.epochs,
        "strengths": Strengths(smooth=options.smooth, sparse=options.sparse),
    }  # fmt: skip
    states = learn_machine(train, rng=rng, **settings)
    if not options.pretrained:
        return last(states)
    state = last(takewhile(lambda state: state.phase != "fine-tune", states))
    return replace(state, dead_units=dead_units(state.machine, infer(state.machine, train.values, train.exists)))


def run(options: argparse.Namespace, seed: int, gaussian: dict | None) -> dict:
    """Learn on ``--count`` shapes, judge on ``--held-out`` others."""
    train, test = parted(options, seed)
    count, rng = train.n_shapes, np.random.default_rng([seed, 1])
    begin, processor = time.perf_counter(), time.process_time()
    state = learnt(train, options, rng)
    seconds, processor = time.perf_counter() - begin, time.process_time() - processor
    machine = state.machine
    sampled, latents = sampled_reconstruction(machine, test, rng=rng)
    errors = {
        "H1": reconstruction_error(test, decode(machine, latents)),
        "top probabilities": reconstruction_error(test, decode(machine, latents.top)),
        "top sampled": reconstruction_error(test, sampled),
    }
    for components in (3, 5, 10):
        model = fit_principal_components(train, components)
        errors[f"PCA {components}"] = reconstruction_error(test, reconstruct_by_components(model, test))
    seen = {tuple(row) for row in train.exists}
    known = np.array([tuple(row) in seen for row in test.exists])

    n = test.n_shapes
    mixture = fit_mixture(machine, train)
    drawn = draw(machine, mixture, n, rng=rng)
    sources = {"training shapes": train.positions()[rng.permutation(count)[:n]], "machine": drawn.points}
    model = fit_principal_components(train)
    for name, kernel in (("PCA", False), ("KDE", True)):
        values, exists = draw_from_components(model, n, rng=rng, kernel=kernel)
        sources[name] = to_positions(values, exists, train.part, train.low, train.high)
    if gaussian is not None:
        model = fit_gaussian_machine(train, rng=rng, **gaussian)
        errors["Gaussian DBM"] = reconstruction_error(test, reconstruct_by_gaussian_machine(model, test))
        values, exists = draw_from_gaussian_machine(model, n, rng=rng)
        sources["Gaussian DBM"] = to_positions(values, exists, train.part, train.low, train.high)
    judged = {name: judge(test.positions(), positions, rng) for name, positions in sources.items()}
    real = nearest_distance(test.positions(), train.positions())
    for name in list(judged)[1:]:
        judged[name]["novelty"] = nearest_distance(sources[name], train.positions()) / real
    many = draw(machine, mixture, 1000, rng=rng).exists
    shares = [
        abs(float((many == pattern).all(axis=1).mean()) - float((train.exists == pattern).all(axis=1).mean()))
        for pattern in mixture.patterns
    ]
    possible = seen | {tuple(row) for row in test.exists}
    return {
        "family": str(options.corresponding or options.family), "shapes": count, "held_out": n,
        "points": int(train.values.shape[1]),
        "sizes": list(machine.sizes), "epochs": state.epoch, "seconds": seconds, "cpu_seconds": processor,
        "dead_units": list(state.dead_units), "gaussian": gaussian,
        "error_percent": {name: 100 * error for name, error in errors.items()},
        "held_out_with_parts_seen": float(known.mean()),
        "plausibility": judged,
        "largest_pattern_gap": max(shares),
        "impossible_combinations": float(np.mean([tuple(row) not in possible for row in many])),
        "sliders_percent": [100 * d.size for d in directions(machine, mixture, train, 4)],
        "blas": [f"{lib.get('internal_api')} {lib.get('architecture', '')} x1" for lib in threadpool_info()
                 if lib.get("user_api") == "blas"],
    }  # fmt: skip


def judge(real: np.ndarray, new: np.ndarray, rng: np.random.Generator) -> dict[str, float]:
    """MMD, coverage and 1-NNA of new shapes (n, K, 3) beside real ones, by two distances of clouds."""
    clouds = [thin_cloud(points, CLOUD, rng=rng) for points in (*real, *new)]
    rough = plausibility_of_table(chamfer_table(clouds), len(real))
    few_real, few_new = real[:MOST_FINE], new[:MOST_FINE]
    fine = [thin_cloud(points, FINE_CLOUD, rng=rng) for points in (*few_real, *few_new)]
    moved = plausibility_of_table(earth_mover_table(fine), len(few_real))
    return {
        "mmd": rough.mmd, "coverage": rough.coverage, "one_nn": rough.one_nn, "novelty": 0.0,
        "emd_mmd": moved.mmd, "emd_coverage": moved.coverage, "emd_one_nn": moved.one_nn,
    }  # fmt: skip


def nearest_distance(shapes: np.ndarray, training: np.ndarray) -> float:
    """Mean over the shapes of the distance of corresponding points to the nearest training shape that has the same."""
    found = []
    for shape in shapes:
        there = np.isfinite(shape[:, 0])
        away = np.linalg.norm(training[:, there] - shape[there], axis=2).mean(axis=1)
        if np.isfinite(away).any():
            found.append(np.nanmin(away))
    return float(np.mean(found))


def mean_of(results: list[dict]) -> dict:
    """The first result with its figures replaced by means over all."""
    whole = dict(results[0])
    for key in ("error_percent", "plausibility"):
        for name, first in results[0][key].items():
            every = [result[key][name] for result in results]
            mean = (
                {k: float(np.mean([e[k] for e in every])) for k in first} if isinstance(first, dict) else np.mean(every)
            )
            whole[key] = {**whole[key], name: mean if isinstance(mean, dict) else float(mean)}
    for key in ("cpu_seconds", "largest_pattern_gap", "impossible_combinations"):
        whole[key] = float(np.mean([result[key] for result in results]))
    for key in ("dead_units", "sliders_percent"):
        whole[key] = np.mean([result[key] for result in results], axis=0).tolist()
    return whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--family", default="chairs", choices=("chairs", "airplanes"))
    parser.add_argument("--corresponding", type=Path, default=None)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--held-out", type=int, default=60)
    parser.add_argument("--points", type=int, default=1500)
    parser.add_argument("--layers", type=int, default=None, help="by default 3, of a small family 2")
    parser.add_argument("--smooth", type=float, default=0.0, help="the spatial prior's strength, λ1")
    parser.add_argument("--sparse", type=float, default=0.0, help="strength of L1 on the weights, λ2")
    parser.add_argument("--epochs", type=int, default=None)
    parser.add_argument("--pretrained", action="store_true", help="leave fine-tuning out")
    parser.add_argument("--no-gaussian", action="store_true", help="leave the Gaussian DBM out")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    gaussian = None if options.no_gaussian else tuned_gaussian(options)
    results = [run(options, seed, gaussian) for seed in range(options.seed, options.seed + options.seeds)]
    result = mean_of(results) | {"seeds": options.seeds, "of_each_seed": [r["plausibility"] for r in results]}
    if not options.json:
        print(f"{result['shapes']} {result['family']}, K {result['points']}, units {result['sizes']}, "
              f"{result['cpu_seconds']:.0f} CPU-seconds, dead {result['dead_units']}, {result['blas']}")  # fmt: skip
        print(format_table(["held out, from", "error %"], [[k, v] for k, v in result["error_percent"].items()]))
        rows = [[name, *p.values()] for name, p in result["plausibility"].items()]
        head = ["source", "MMD", "coverage", "1-NNA", "novelty", "EMD MMD", "EMD coverage", "EMD 1-NNA"]
        print(format_table(head, rows))
        print(f"combinations of parts: shares off by at most {result['largest_pattern_gap']:.3f}, "
              f"{100 * result['impossible_combinations']:.1f}% never seen")  # fmt: skip
        print("sliders move points by", ", ".join(f"{size:.1f}%" for size in result["sliders_percent"]))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
