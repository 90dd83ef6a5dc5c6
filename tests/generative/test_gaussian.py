"""The Gaussian-Bernoulli DBM that the machine is compared with."""

import numpy as np
import pytest

from shapeforge.generative.gaussian import (
    draw_from_gaussian_machine,
    fit_gaussian_machine,
    reconstruct_by_gaussian_machine,
)
from shapeforge.generative.observations import LIMIT, observe
from tests.generative.synthetic import PART_NAMES, chair_family


@pytest.fixture(scope="module")
def family():
    positions, part, _ = chair_family(120, rng=np.random.default_rng(0), density=0.1)
    observations = observe(positions, part, PART_NAMES)
    return observations.subset(np.arange(100)), observations.subset(np.arange(100, 120))


@pytest.fixture(scope="module")
def machine(family):
    return fit_gaussian_machine(family[0], rng=np.random.default_rng(1), units=(60, 30), steps=1200)


def error(observations, values):
    there = observations.exists[:, observations.part]
    return float(np.abs(values - observations.values).mean(axis=2)[there].mean())


def test_new_shapes_come_back_far_better_than_as_the_mean_shape(family, machine):
    test = family[1]
    mean = np.broadcast_to(machine.mean.reshape(1, -1, 3), test.values.shape)
    assert error(test, reconstruct_by_gaussian_machine(machine, test)) < 0.6 * error(test, mean)
    assert machine.variance.mean() < 0.5, "H1 must explain most of what the coordinates do"


def test_joint_distribution_is_that_of_the_written_energy(family, machine):
    """One unit's conditional against the energy, term by term, with the unit on and off."""
    points, _, known = machine.standardised(family[1])
    rng = np.random.default_rng(0)
    n = len(points)
    first = (rng.random((n, len(machine.centres[0]))) < 0.5).astype(np.float64)
    second = (rng.random((n, len(machine.centres[1]))) < 0.5).astype(np.float64)

    def energy(first):
        total = (0.5 * points**2 / machine.variance).sum(axis=1)
        total -= (points / machine.variance * ((first - machine.centres[0]) @ machine.weights.T)).sum(axis=1)
        total -= first @ machine.biases[0] + second @ machine.biases[1]
        total -= ((first - machine.centres[0]) @ machine.couplings * (second - machine.centres[1])).sum(axis=1)
        return total - ((known @ machine.existence_top) * second).sum(axis=1)

    on, off = first.copy(), first.copy()
    on[:, 7], off[:, 7] = 1, 0
    said = machine.from_points(points) + (second - machine.centres[1]) @ machine.couplings.T
    np.testing.assert_allclose(said[:, 7], energy(off) - energy(on), rtol=2e-3, atol=2e-2)


def test_draws_keep_to_the_parts_seen_and_spread_like_the_family(family, machine):
    train = family[0]
    values, exists = draw_from_gaussian_machine(machine, 80, rng=np.random.default_rng(2), sweeps=30)
    assert {tuple(row) for row in exists} <= {tuple(row) for row in train.exists}
    assert values.min() >= LIMIT and values.max() <= 1 - LIMIT
    seat = train.part == 0  # every chair has one
    ratio = values[:, seat].std(axis=0).mean() / train.values[:, seat].std(axis=0).mean()
    assert 0.5 < ratio < 1.5
    again = draw_from_gaussian_machine(machine, 80, rng=np.random.default_rng(2), sweeps=30)[0]
    np.testing.assert_array_equal(values, again)
