"""How many shapes are put right, and how many that were right are turned?

    python -m benchmarks.orientation [--shapes 60] [--seed 0] [--sets NAME ...] [--json]
    python -m benchmarks.orientation --learn

Every shape is turned by one of the 24 axis rotations and tilted by up to 15 degrees, at random.  "Alone" is what import
makes of one file, "family" what the shapes of a set agree on.  Up is right within 5 degrees.  A whole orientation is
right when it is within 5 degrees of the truth or of a turn that brings the shape onto itself, for the set up to one
quarter turn that all share.  False turns: of the files as they are, which are taken to be right.  Real sets come from
$SHAPEFORGE_DATA or ../shared/data and are left out where absent.  ``--learn`` prints the weights of
``collection/upright`` anew, from generated shapes.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from shapeforge.collection.align import thinned
from shapeforge.collection.directions import AXIS_ROTATIONS, angle_between, turning_angle
from shapeforge.collection.families import generate
from shapeforge.collection.meshes import MeshError, read_mesh
from shapeforge.collection.orient import poses
from shapeforge.collection.shape import Mesh
from shapeforge.collection.upright import surface_of_mesh, up_candidates, up_features
from shapeforge.deformation.pose import QUARTERS, Turns, agree, candidate_turns, chosen_rotations
from shapeforge.validation.statistics import format_table

DATA = Path(os.environ.get("SHAPEFORGE_DATA", Path(__file__).parents[2] / "shared" / "data"))
REAL = {
    "ikea chairs": "ikea/chairs", "ikea tables": "ikea/tables", "wild chairs": "sweethome3d/chairs",
    "wild tables": "sweethome3d/tables", "wild lamps": "sweethome3d/lamps",
    "wild airliners": "aircraft/flightgear_ai", "wild model planes": "aircraft/crrcsim",
}  # fmt: skip
LARGEST_TILT, RIGHT = 15.0, 5.0  # degrees


@dataclass(frozen=True, eq=False)
class Trial:
    """One file as it is and turned: what import alone says, the candidates for the family, the truth."""

    name: str
    untouched: Turns
    alone: np.ndarray  # rotation found for the file as it is
    turned: Turns
    alone_turned: np.ndarray
    applied: np.ndarray  # the rotation that was applied
    points: np.ndarray  # of the shape as it was


def meshes_of(name: str, count: int, seed: int) -> Iterator[tuple[str, Mesh]]:
    """Names and meshes of a set, nothing where it is absent."""
    if name.startswith("generated"):
        for one in generate(name.split()[1], count, seed=seed):
            yield one.name, one.mesh
        return
    for file in sorted((DATA / REAL[name]).glob("*.obj")):
        try:
            yield file.stem, read_mesh(file)
        except MeshError:
            continue


def random_turn(rng: np.random.Generator) -> np.ndarray:
    """One of the 24 axis rotations (3, 3), then a tilt of up to 15 degrees about any axis."""
    axis = rng.normal(size=3)
    tilt = np.radians(LARGEST_TILT * rng.random()) * axis / np.linalg.norm(axis)
    return Rotation.from_rotvec(tilt).as_matrix() @ AXIS_ROTATIONS[rng.integers(24)]


def trials_of(name: str, count: int, seed: int) -> tuple[list[Trial], float]:
    """The set's trials, and CPU seconds a shape for what import does about orientation."""
    rng = np.random.default_rng(seed)
    found, spent = [], 0.0
    for shape, mesh in meshes_of(name, count, seed + 3):
        applied = random_turn(rng)
        begun = time.process_time()
        surface = surface_of_mesh(mesh)
        if surface is None:
            continue
        alone, untouched = poses(surface)[0].rotation, candidate_turns(surface)
        spent += time.process_time() - begun
        other = surface_of_mesh(mesh.moved(mesh.vertices @ applied.T))
        turned = candidate_turns(other)
        found.append(Trial(shape, untouched, alone, turned, poses(other)[0].rotation, applied, surface.points))
    return found, spent / max(len(found), 1)


def symmetric(points: np.ndarray, turn: np.ndarray) -> bool:
    """Whether ``turn`` (3, 3), or a rotation within 5 degrees of it, brings points (n, 3) of a shape onto the shape."""
    if turning_angle(turn) <= RIGHT:
        return True
    sample = thinned(points, 800)
    tree, moved, refined = cKDTree(sample[::2]), sample[1::2], turn
    for _ in range(8):
        distance, near = tree.query(moved @ refined.T)
        kept = distance <= np.quantile(distance, 0.9)
        left, _, right = np.linalg.svd(moved[kept].T @ tree.data[near[kept]])
        refined = right.T @ np.diag([1, 1, np.sign(np.linalg.det(right.T @ left.T))]) @ left.T
    spacing, gap = (tree.query(moved @ one.T)[0].mean() for one in (np.eye(3), refined))
    return turning_angle(refined.T @ turn) <= RIGHT and gap < 1.3 * spacing + 0.01


def rightness(trials: list[Trial], rotations: list[np.ndarray]) -> tuple[float, float, list[str]]:
    """Shares of shapes with up right and with all right, and the names of those without."""
    left = [rotation @ trial.applied for rotation, trial in zip(rotations, trials, strict=True)]
    up = [angle_between(turn[1], np.array([0.0, 1.0, 0.0])) <= RIGHT for turn in left]
    best: list[bool] = []
    for quarter in QUARTERS:
        checked = zip(trials, left, up, strict=True)
        right = [ok and symmetric(trial.points, quarter.T @ turn) for trial, turn, ok in checked]
        best = max(best, right, key=sum)
    wrong = [trial.name for trial, ok in zip(trials, best, strict=True) if not ok]
    return float(np.mean(up)), float(np.mean(best)), wrong


def run(name: str, count: int, seed: int) -> dict | None:
    """Figures of one set; None where it is absent."""
    trials, seconds = trials_of(name, count, seed)
    if not trials:
        return None
    begun = time.process_time()
    untouched = [trial.untouched for trial in trials]
    kept = chosen_rotations(untouched, agree(untouched))
    seconds += (time.process_time() - begun) / len(trials)
    turned = [trial.turned for trial in trials]
    up_alone, full_alone, _ = rightness(trials, [trial.alone_turned for trial in trials])
    up, full, wrong = rightness(trials, chosen_rotations(turned, agree(turned)))
    return {
        "n": len(trials), "up_alone": up_alone, "up": up, "full_alone": full_alone, "full": full,
        "false_turns_alone": sum(turning_angle(trial.alone) > 1 for trial in trials),
        "false_turns": sum(turning_angle(rotation) > 1 for rotation in kept),
        "cpu_seconds": seconds, "wrong": wrong,
    }  # fmt: skip


def learn(count: int = 200, *, decay: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Weights (2, f) and biases (2,) of ``log_likelihoods``: penalised likelihood of the direction that is up.

    Each family counts the same.  ``decay`` is for features scaled to unit variance.
    """
    examples = []
    for family in ("chairs", "airplanes"):
        for index, one in enumerate(generate(family, count, seed=77, broken=0.3)):
            turn = Rotation.random(random_state=index).as_matrix()
            surface = surface_of_mesh(one.mesh.moved(one.mesh.vertices @ turn.T))
            ups = up_candidates(surface, np.zeros((0, 3)))
            right = np.array([angle_between(up.direction, turn[:, 1]) for up in ups]) < RIGHT
            if right.any():
                examples.append((up_features(surface, ups), right, 1 / count))
    features = np.concatenate([example[0] for example in examples])
    middle, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    examples = [((rows - middle) / scale, right, weight) for rows, right, weight in examples]

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        weights = flat.reshape(-1, 2)
        value, gradient = decay * float((weights**2).sum()), 2 * decay * weights
        for rows, right, weight in examples:
            score = rows @ weights
            chance = np.exp(score - score.max())
            chance /= chance.sum()
            wanted = chance * right[:, None]
            value -= weight * np.log(max(float(wanted.sum()), 1e-300))
            gradient = gradient + weight * (rows.T @ (chance - wanted / wanted.sum()))
        return value, gradient.ravel()

    rng = np.random.default_rng(0)
    starts = [0.3 * rng.normal(size=2 * features.shape[1]) for _ in range(3)]
    best = min((minimize(loss, start, jac=True, method="L-BFGS-B") for start in starts), key=lambda found: found.fun)
    weights = (best.x.reshape(-1, 2) / scale[:, None]).T
    bias = -weights @ middle
    return weights, bias - bias.min()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = ["generated chairs", "generated airplanes", *REAL]
    parser.add_argument("--sets", nargs="+", choices=names, default=names)
    parser.add_argument("--shapes", type=int, default=60, help="of each generated family")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="only the JSON object")
    parser.add_argument("--learn", action="store_true", help="print weights for collection/upright")
    options = parser.parse_args()
    with threadpool_limits(1):
        if options.learn:
            weights, bias = learn()
            print(np.array2string(weights, separator=", ", precision=3), np.array2string(bias, precision=3))
            return
        figures = {name: run(name, options.shapes, options.seed) for name in options.sets}
    figures = {name: found for name, found in figures.items() if found is not None}
    if not options.json:
        rows = [
            [name, str(f["n"]), *(f"{100 * f[key]:.0f}" for key in ("up_alone", "up", "full_alone", "full")),
             f"{f['false_turns_alone']} / {f['false_turns']}", f"{f['cpu_seconds']:.3f}"]
            for name, f in figures.items()
        ]  # fmt: skip
        heads = [
            "set",
            "n",
            "up alone %",
            "up %",
            "all alone %",
            "all %",
            "false turns alone / family",
            "CPU s a shape",
        ]
        print(format_table(heads, rows))
    print(json.dumps({"benchmark": "orientation", "seed": options.seed, "sets": figures}))


if __name__ == "__main__":
    main()
