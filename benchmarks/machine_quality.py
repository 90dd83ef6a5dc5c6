"""How good is the Beta Shape Machine, beside PCA per combination of parts and kernels on its scores?

    python -m benchmarks.machine_quality [--family chairs] [--count 200] [--held-out 60] [--points 1500] [--json]

A generated family with its true correspondences, so that only the machine is judged.  Errors are mean |D - D'| per
coordinate on held-out shapes, in % of the diagonal, and in the same unit for PCA; plausibility is between clouds of the
held-out shapes and as many new ones.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from threadpoolctl import threadpool_info

from benchmarks.synthesis_quality import true_family
from shapeforge.collection.iterate import last
from shapeforge.generative.baselines import draw_from_components, fit_principal_components, reconstruct_by_components
from shapeforge.generative.draw import draw, fit_mixture
from shapeforge.generative.inference import decode
from shapeforge.generative.learning import learn_machine, reconstruction_error, sampled_reconstruction
from shapeforge.generative.observations import observe, to_positions
from shapeforge.generative.units import directions
from shapeforge.validation.plausibility import plausibility, thin_cloud
from shapeforge.validation.statistics import format_table

CLOUD = 300


def run(family_name: str, count: int, held_out: int, n_points: int, seed: int, epochs: int | None) -> dict:
    """Learn on ``count`` shapes, judge on ``held_out`` others."""
    family = true_family(family_name, count + held_out, seed=seed, n_points=n_points)
    observations = observe(family.positions, family.part, family.part_names)
    rng = np.random.default_rng(seed)
    order = rng.permutation(count + held_out)
    train, test = observations.subset(order[:count]), observations.subset(order[count:])

    begin, processor = time.perf_counter(), time.process_time()
    state = last(learn_machine(train, rng=rng, epochs=epochs))
    seconds, processor = time.perf_counter() - begin, time.process_time() - processor
    machine = state.machine
    sampled, latents = sampled_reconstruction(machine, test, rng=rng)
    errors = {
        "H1": reconstruction_error(machine, test, decode(machine, latents)),
        "H3 probabilities": reconstruction_error(machine, test, decode(machine, latents.top)),
        "H3 sampled": reconstruction_error(machine, test, sampled),
    }
    for components in (3, 5, 10):
        model = fit_principal_components(train, components)
        errors[f"PCA {components}"] = reconstruction_error(machine, test, reconstruct_by_components(model, test))
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
    real = [thin_cloud(points, CLOUD, rng=rng) for points in test.positions()]
    judged = {
        name: plausibility(real, [thin_cloud(points, CLOUD, rng=rng) for points in positions])
        for name, positions in sources.items()
    }
    many = draw(machine, mixture, 1000, rng=rng).exists
    shares = [
        abs(float((many == state_).all(axis=1).mean()) - float((train.exists == state_).all(axis=1).mean()))
        for state_ in mixture.patterns
    ]
    return {
        "family": family_name, "shapes": count, "held_out": n, "points": int(observations.values.shape[1]),
        "sizes": list(machine.sizes), "epochs": state.epoch, "seconds": seconds, "cpu_seconds": processor,
        "dead_units": list(state.dead_units),
        "error_percent": {name: 100 * error for name, error in errors.items()},
        "held_out_with_parts_seen": float(known.mean()),
        "plausibility": {
            name: {"mmd": p.mmd, "coverage": p.coverage, "one_nn": p.one_nn} for name, p in judged.items()
        },
        "largest_pattern_gap": max(shares),
        "sliders_percent": [100 * d.size for d in directions(machine, mixture, train, 4)],
        "blas": [f"{lib.get('internal_api')} {lib.get('architecture', '')} x1" for lib in threadpool_info()
                 if lib.get("user_api") == "blas"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--family", default="chairs", choices=("chairs", "airplanes"))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--held-out", type=int, default=60)
    parser.add_argument("--points", type=int, default=1500)
    parser.add_argument("--epochs", type=int, default=None)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    result = run(options.family, options.count, options.held_out, options.points, options.seed, options.epochs)
    if not options.json:
        print(f"{result['shapes']} {result['family']}, K {result['points']}, units {result['sizes']}, "
              f"{result['cpu_seconds']:.0f} CPU-seconds, dead {result['dead_units']}, {result['blas']}")  # fmt: skip
        print(format_table(["held out, from", "error %"], [[k, v] for k, v in result["error_percent"].items()]))
        rows = [[name, p["mmd"], p["coverage"], p["one_nn"]] for name, p in result["plausibility"].items()]
        print(format_table(["source", "MMD", "coverage", "1-NNA"], rows))
        print("sliders move points by", ", ".join(f"{size:.1f}%" for size in result["sliders_percent"]))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
