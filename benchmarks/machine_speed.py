"""How fast is the Beta Shape Machine: learning, a draw, a slider?

    python -m benchmarks.machine_speed [--points 4488] [--shapes 300 1000] [--target 3000] [--seed 0] [--json]

Random shapes of a full-sized family (four parts of unequal size, units as for thousands of shapes), one BLAS thread.
Times are CPU-seconds of this process, so that others at work on the machine count for little.

Learning is extrapolated to ``--target`` shapes from measured epochs at the two numbers of ``--shapes``: an epoch takes
a fixed time (the projection) and a time for every shape.  ``sgemm share``: the products that a step of fine-tuning
needs, counted as 2 operations a term, by the time the step takes, against the rate of products of the same shapes
alone, in the same run.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from shapeforge.generative.draw import draw, fit_mixture
from shapeforge.generative.evidence import draw_given
from shapeforge.generative.finetuning import Batch, TopPrior, loss_and_gradient
from shapeforge.generative.inference import DOWN_ROUNDS, UP_ROUNDS, infer
from shapeforge.generative.learning import STEPS, learn_machine
from shapeforge.generative.machine import BetaShapeMachine, layer_sizes, start_machine
from shapeforge.generative.observations import Observations, observe
from shapeforge.generative.pretraining import BATCH
from shapeforge.generative.units import directions, drive
from shapeforge.validation.statistics import format_table

PART_SHARES = (0.48, 0.21, 0.21, 0.1)
PRETRAINING_STEPS = 150


def random_family(n_points: int, n_shapes: int, rng: np.random.Generator) -> Observations:
    """Eight random modes of variation of random points."""
    counts = [round(share * n_points) for share in PART_SHARES]
    part = np.repeat(np.arange(len(counts)), counts)
    base, axes = rng.uniform(-0.4, 0.4, (len(part), 3)), 0.02 * rng.standard_normal((8, len(part), 3))
    positions = base + np.einsum("ta,akx->tkx", rng.standard_normal((n_shapes, 8)), axes)
    return observe(positions, part, ("body", "left", "right", "tail"))


def run(n_points: int, shapes: list[int], target: int, seed: int) -> dict:
    """Median milliseconds of each operation, and learning extrapolated."""
    rng = np.random.default_rng(seed)
    observations = random_family(n_points, max(shapes), rng)
    sizes = layer_sizes(np.bincount(observations.part).tolist(), target)
    machine = start_machine(observations, rng=rng, sizes=sizes)
    some = observations.subset(np.arange(BATCH))
    mixture = fit_mixture(machine, some)
    found = directions(machine, some)
    one = infer(machine, some.values[:1], some.exists[:1])
    landmarks = np.full((len(some.part), 3), np.nan)
    landmarks[::500] = some.positions()[0, ::500]
    with threadpool_limits(1, "blas"):
        milliseconds = {
            "slider to points": _median(lambda: drive(machine, one, {0: 1.0, 1: -0.5}, directions=found), 15),
            "one shape's latents": _median(lambda: infer(machine, some.values[:1], some.exists[:1]), 15),
            "20 draws": _median(lambda: draw(machine, mixture, 20, rng=rng), 5),
            "draws given points": _median(lambda: draw_given(machine, mixture, 1, rng=rng, points=landmarks), 3),
            f"gradient of {BATCH} shapes": _median(_gradient(machine, some, rng), 5),
        }
        rates = products(machine, BATCH, rng)
    rate = rates["operations"] / milliseconds[f"gradient of {BATCH} shapes"] / 1e6
    epochs = {n: epoch_seconds(observations.subset(np.arange(n)), sizes, rng) for n in shapes}
    return {
        "points": len(observations.part), "sizes": list(machine.sizes), "weights": machine.n_weights,
        "milliseconds": milliseconds, "sgemm_gflops": rates["gflops"],
        "step_gflops": rate, "sgemm_share": rate / rates["gflops"],
        "epoch_cpu_seconds": epochs, "target": target, "learning_cpu_minutes": extrapolated(epochs, target),
        "blas": [f"{lib.get('internal_api')} {lib.get('architecture', '')} x1" for lib in threadpool_info()
                 if lib.get("user_api") == "blas"],
    }  # fmt: skip


def _gradient(machine: BetaShapeMachine, some: Observations, rng: np.random.Generator) -> Callable[[], object]:
    prior = TopPrior(np.zeros_like(machine.biases[-1]), np.zeros_like(machine.existence_top))
    uniform = rng.random((some.n_shapes, machine.sizes[-1]), dtype=np.float32)
    batch = Batch(some.values, some.exists, np.ones(machine.n_parts), uniform=uniform)
    return lambda: loss_and_gradient(machine, prior, batch)


def products(machine: BetaShapeMachine, batch: int, rng: np.random.Generator) -> dict[str, float]:
    """Operations that one step's matrix products take, and the rate (gflops) of the same products alone.

    Per part: up (batch rows), down and its slopes (twice the batch), and the slope of the weights (three times).  Per
    coupling: once or twice a round upwards and downwards, and twice as much for the slopes.
    """
    shapes: list[tuple[int, int, int, int]] = []
    for weight in machine.weights:
        features, units = 2 * weight.shape[1], weight.shape[2]
        shapes += [(batch, features, units, 1), (2 * batch, units, features, 1), (2 * batch, features, units, 1)]
        shapes += [(features, 3 * batch, units, 1)]
    for coupling in machine.couplings:
        times = 2 * UP_ROUNDS - 1 + (2 * DOWN_ROUNDS - 1 if machine.n_layers > 2 else 1)
        shapes += [(batch, *coupling.shape, 2 * times), (coupling.shape[0], batch, coupling.shape[1], times)]
    operations, taken = 0.0, 0.0
    for rows, inner, columns, times in shapes:
        a = rng.standard_normal((rows, inner), dtype=np.float32)
        b = rng.standard_normal((inner, columns), dtype=np.float32)
        operations += 2.0 * rows * inner * columns * times
        taken += times * _median(lambda a=a, b=b: a @ b, 5)
    return {"operations": operations, "gflops": operations / taken / 1e6}


def epoch_seconds(observations: Observations, sizes: tuple, rng: np.random.Generator, epochs: int = 2) -> dict:
    """CPU-seconds of one epoch: of pre-training (all layers) and of fine-tuning with the check that may follow it."""
    marks: dict[str, list[float]] = {}
    before = time.process_time()
    settings = {"epochs": epochs, "pretraining": epochs, "sizes": sizes, "validation": 0.0}
    for state in learn_machine(observations, rng=rng, **settings):
        now = time.process_time()
        marks.setdefault(state.phase, []).append(now - before)
        before = now
    # The first epoch of a phase bears its preparation.
    last = {phase: taken[-1] for phase, taken in marks.items()}
    fine = last.pop("fine-tune")
    return {"pre-training": sum(last.values()), "fine-tuning": fine}


def extrapolated(epochs: dict[int, dict], target: int) -> float:
    """CPU-minutes of learning from ``target`` shapes with the default numbers of epochs."""
    few, many = min(epochs), max(epochs)
    total, steps = 0.0, -(-target // BATCH)
    for phase, wanted in (("pre-training", PRETRAINING_STEPS), ("fine-tuning", STEPS)):
        slope = (epochs[many][phase] - epochs[few][phase]) / (many - few)
        one = epochs[few][phase] + slope * (target - few)
        total += max(10 if phase == "pre-training" else 20, -(-wanted // steps)) * one
    return total / 60


def _median(action: Callable[[], object], times: int) -> float:
    action()
    taken = []
    for _ in range(times):
        begin = time.process_time()
        action()
        taken.append(1e3 * (time.process_time() - begin))
    return float(np.median(taken))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=4488)
    parser.add_argument("--shapes", type=int, nargs=2, default=[300, 1000])
    parser.add_argument("--target", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    result = run(options.points, options.shapes, options.target, options.seed)
    if not options.json:
        millions = result["weights"] / 1e6
        print(f"K {result['points']}, units {result['sizes']}, {millions:.1f}M weights, {result['blas']}")
        print(format_table(["operation", "CPU ms"], list(map(list, result["milliseconds"].items()))))
        print(f"sgemm {result['sgemm_gflops']:.0f} gflops alone, {result['step_gflops']:.0f} in a step of learning: "
              f"{100 * result['sgemm_share']:.0f}%")  # fmt: skip
        for n, one in result["epoch_cpu_seconds"].items():
            print(f"an epoch at T = {n}: {one['pre-training']:.1f} + {one['fine-tuning']:.1f} CPU-seconds")
        print(f"learning at T = {result['target']}: {result['learning_cpu_minutes']:.0f} CPU-minutes (extrapolated)")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
