"""Tiny machines whose every state can be listed."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.special import betaln, logsumexp

from shapeforge.generative.energy import Hidden
from shapeforge.generative.machine import BetaShapeMachine, project, start_machine
from shapeforge.generative.observations import Observations, observe

PART = np.array([0, 0, 1])


def tiny_observations(rng: np.random.Generator, n_shapes: int = 6) -> Observations:
    """A few shapes of three points in two parts, the second part missing here and there."""
    positions = rng.uniform(-0.4, 0.4, (n_shapes, 3, 3))
    positions[1, 2] = np.nan
    positions[-1, 2] = np.nan
    return observe(positions, PART, ("body", "wing"))


def tiny_machine(
    rng: np.random.Generator, couplings: float = 0.7, above: tuple[int, ...] = (3, 2)
) -> tuple[BetaShapeMachine, Observations]:
    """A positive machine with 2+2 and then ``above`` hidden units, every parameter at random, in float64."""
    observations = tiny_observations(rng)
    machine = start_machine(observations, rng=rng, concentration=6.0, sizes=([2, 2], *above)).astype(np.float64)
    machine = replace(
        machine,
        weights=tuple(rng.normal(0, 0.4, w.shape) for w in machine.weights),
        biases=tuple(rng.normal(size=size) for size in machine.sizes),
        couplings=tuple(couplings * rng.normal(size=pair) for pair in itertools.pairwise(machine.sizes)),
        existence_top=couplings * rng.normal(size=(2, machine.sizes[-1])),
        centres=tuple(rng.uniform(0.2, 0.8, size) for size in machine.sizes),
    )  # fmt: skip
    return project(machine), observations


def all_hidden(machine: BetaShapeMachine) -> Hidden:
    """Every binary state of the hidden units."""
    sizes = machine.sizes
    states = np.array(list(itertools.product((0.0, 1.0), repeat=sum(sizes))))
    return np.split(states, np.cumsum(sizes)[:-1], axis=1)


def repeated(array: np.ndarray, n: int) -> np.ndarray:
    """One shape's row n times."""
    return np.repeat(array[None], n, axis=0)


def log_integral_over_points(machine: BetaShapeMachine, exists: np.ndarray, hidden: Hidden) -> np.ndarray:
    """ln of the integral of p~(D, H | E) over D in (0, 1) for each hidden state: products of Beta functions."""
    from shapeforge.generative.energy import log_unnormalized

    middle = np.full((len(hidden[0]), machine.n_points, 3), 0.5)
    at_middle = log_unnormalized(machine, middle, repeated(exists, len(hidden[0])), hidden)
    total = at_middle
    for index, slot in enumerate(machine.units_of_part):
        if exists[index]:
            both = machine.rest[index] + np.einsum(
                "sfm,nm->nsf", machine.weights[index], hidden[0][:, slot] - machine.centres[0][slot]
            )
            constant = (both - 1).sum(axis=(1, 2)) * np.log(0.5)
            total = total - constant + betaln(both[:, 0], both[:, 1]).sum(axis=1)
    return total


def log_sum(values: np.ndarray) -> float:
    """ln Σ exp."""
    return float(logsumexp(values))
