"""Does a fit of many shapes cost more a shape than one of few, and how much memory does it take?

    python -m benchmarks.scaling [--points 500] [--memory-points 500] [--rounds 2] [--seed 0] [--json]

The growth exponent of CPU time in the number of shapes T between 30 and 300 (10 outer rounds; 1 is linear), and the
peak memory of the process at T = 300 and 1000 (``--rounds`` outer rounds: more of them hold no more).  Three exemplars;
the shapes are twelve generated chairs taking turns, read from disk whenever they are asked for.  Every fit runs in a
process of its own, on one thread.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups
from shapeforge.collection.iterate import last
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Shape
from shapeforge.deformation.fit import FitState, fit_templates
from shapeforge.store_arrays import read_record, write_record
from shapeforge.validation.statistics import format_table

SPECIMENS, EXEMPLARS = 12, 3


class Turns:
    """``count`` shapes that are the specimens of a folder in turns; none is held."""

    def __init__(self, folder: Path, count: int) -> None:
        self.files = [folder / f"{i}.zarr.zip" for i in range(SPECIMENS)]
        self.names = tuple(f"shape_{t:05d}" for t in range(count))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> Shape:
        return replace(read_record(self.files[index % SPECIMENS])[0], name=self.names[index])

    def __iter__(self) -> Iterator[Shape]:
        return (self[t] for t in range(len(self)))


def write_specimens(folder: Path, n_points: int, seed: int) -> None:
    """The specimens and the exemplars' labels into a folder."""
    made = generate("chairs", SPECIMENS, seed=seed, broken=0.0)
    for i, one in enumerate(made):
        shape = prepare_shape(one.name, one.mesh, n_points=n_points, up="keep", rng=np.random.default_rng(i))
        write_record(folder / f"{i}.zarr.zip", shape)
    labels = [np.asarray(made[i].faces, np.int32) for i in range(EXEMPLARS)]
    write_record(folder / "labels.zarr.zip", {"labels": labels, "names": made[0].part_names})


def held(state: FitState) -> int:
    """Bytes of the arrays that a state holds of its shapes."""
    arrays = ("deformed", "variance", "maps", "offsets", "segmentation", "active", "evidence", "misfit")
    return sum(
        getattr(candidate.beliefs, name).nbytes for tried in state.candidates for candidate in tried for name in arrays
    )


def one_fit(folder: Path, count: int, rounds: int) -> dict:
    """A fit of ``count`` shapes in this process: CPU-seconds, peak memory before and after, bytes returned."""
    given = read_record(folder / "labels.zarr.zip")[0]
    labels, names = dict(enumerate(given["labels"])), tuple(given["names"])
    group = np.where(np.arange(count) < EXEMPLARS, np.arange(count), 0)
    called = tuple(f"Group {g + 1}" for g in range(EXEMPLARS))

    def fit(count: int, rounds: int) -> FitState:
        groups = Groups(called, group[:count], np.arange(EXEMPLARS), np.zeros((count, 2)))
        shapes = Turns(folder, count)
        return last(fit_templates(shapes, groups, labels, names, rounds=rounds, rng=np.random.default_rng(0)))

    with threadpool_limits(1):
        fit(5, 8)  # compile
        before, begin = _peak(), time.process_time()
        state = fit(count, rounds)
        seconds = time.process_time() - begin
    return {
        "shapes": count, "rounds": state.round, "seconds": seconds, "before_mb": before, "peak_mb": _peak(),
        "returned_mb": held(state) / 2**20,
    }  # fmt: skip


def _peak() -> float:
    """Largest memory this process has had, in MB."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / 2 ** (20 if sys.platform == "darwin" else 10)


def elsewhere(folder: Path, count: int, rounds: int) -> dict:
    """``one_fit`` in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.scaling", "--one", str(folder), str(count), str(rounds)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def run(n_points: int, memory_points: int, rounds: int, seed: int) -> dict:
    """All of it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_specimens(folder, n_points, seed)
        timed = [elsewhere(folder, count, 10) for count in (30, 300)]
        if memory_points != n_points:
            write_specimens(folder, memory_points, seed)
        memory = [elsewhere(folder, count, rounds) for count in (300, 1000)]
    # rounds may be fewer where the fit comes to rest
    a_round = [one["seconds"] / one["rounds"] for one in timed]
    grown = (memory[1]["peak_mb"] - memory[0]["peak_mb"]) / 700
    blas = [
        f"{lib.get('internal_api')} {lib.get('architecture', '')} x1"
        for lib in threadpool_info()
        if lib.get("user_api") == "blas"
    ]
    return {
        "points": n_points, "memory_points": memory_points, "timed": timed, "memory": memory,
        "exponent": float(np.log(a_round[1] / a_round[0]) / np.log(10)), "grown_mb_a_shape": grown,
        "returned_mb_a_shape": memory[1]["returned_mb"] / 1000, "blas": blas,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--memory-points", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the last line")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one_fit(Path(options.one[0]), int(options.one[1]), int(options.one[2]))))
        return
    result = run(options.points, options.memory_points, options.rounds, options.seed)
    if not options.json:
        print(f"P = {result['points']} (time), {result['memory_points']} (memory), 3 exemplars, {result['blas']}")
        rows = [
            [
                f"{one['shapes']} shapes, {one['rounds']} rounds", one["seconds"], one["seconds"] / one["shapes"],
                one["before_mb"], one["peak_mb"], one["returned_mb"],
            ]
            for one in result["timed"] + result["memory"]
        ]  # fmt: skip
        print(format_table(["fit", "CPU-s", "CPU-s a shape", "MB before", "MB at most", "MB returned"], rows))
        print(f"growth exponent between 30 and 300 shapes: {result['exponent']:.3f}")
        print(
            f"memory grows by {result['grown_mb_a_shape']:.3f} MB a shape between 300 and 1000, "
            f"{result['returned_mb_a_shape']:.3f} MB of it returned"
        )
    print(json.dumps(result))


if __name__ == "__main__":
    main()
