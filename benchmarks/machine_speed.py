"""How fast is the Beta Shape Machine: a step of fine-tuning, a draw, a slider?

    python -m benchmarks.machine_speed [--points 4488] [--shapes 100] [--seed 0] [--json]

Random shapes of a full-sized family (three parts of unequal size, units as for thousands of shapes), one BLAS thread.
The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from shapeforge.generative.draw import draw, fit_mixture
from shapeforge.generative.finetuning import Batch, TopPrior, loss_and_gradient
from shapeforge.generative.inference import infer
from shapeforge.generative.machine import layer_sizes, start_machine
from shapeforge.generative.observations import observe
from shapeforge.generative.units import directions, drive
from shapeforge.validation.statistics import format_table

PART_SHARES = (0.48, 0.21, 0.21, 0.1)


def run(n_points: int, n_shapes: int, seed: int) -> dict:
    """Median milliseconds of each operation."""
    rng = np.random.default_rng(seed)
    counts = [round(share * n_points) for share in PART_SHARES]
    part = np.repeat(np.arange(len(counts)), counts)
    base, axes = rng.uniform(-0.4, 0.4, (len(part), 3)), 0.02 * rng.standard_normal((8, len(part), 3))
    positions = base + np.einsum("ta,akx->tkx", rng.standard_normal((n_shapes, 8)), axes)
    observations = observe(positions, part, ("body", "left", "right", "tail"))
    machine = start_machine(observations, rng=rng, sizes=layer_sizes(counts, 3000))
    mixture = fit_mixture(machine, observations)
    found = directions(machine, mixture, observations)
    one = infer(machine, observations.values[:1], observations.exists[:1])
    prior = TopPrior(np.zeros_like(machine.biases[-1]), np.zeros_like(machine.existence_top))
    uniform = rng.random((n_shapes, machine.sizes[-1]), dtype=np.float32)
    batch = Batch(observations.values, observations.exists, np.ones(len(counts)), uniform=uniform)
    timed = {
        "slider to points": lambda: drive(machine, one, {0: 1.0, 1: -0.5}, directions=found),
        "one shape's latents": lambda: infer(machine, observations.values[:1], observations.exists[:1]),
        "20 draws": lambda: draw(machine, mixture, 20, rng=rng),
        f"gradient of {n_shapes} shapes": lambda: loss_and_gradient(machine, prior, batch),
    }
    with threadpool_limits(1, "blas"):
        milliseconds = {name: _median(action, 5 if "gradient" in name else 15) for name, action in timed.items()}
    return {
        "points": len(part), "sizes": list(machine.sizes), "weights": machine.n_weights, "milliseconds": milliseconds,
        "blas": [f"{lib.get('internal_api')} {lib.get('architecture', '')} x1" for lib in threadpool_info()
                 if lib.get("user_api") == "blas"],
    }  # fmt: skip


def _median(action: Callable[[], object], times: int) -> float:
    action()
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        action()
        taken.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(taken))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=4488)
    parser.add_argument("--shapes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    result = run(options.points, options.shapes, options.seed)
    if not options.json:
        millions = result["weights"] / 1e6
        print(f"K {result['points']}, units {result['sizes']}, {millions:.1f}M weights, {result['blas']}")
        print(format_table(["operation", "ms"], [[name, value] for name, value in result["milliseconds"].items()]))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
