"""The priors on the weights: which points are near, the slope of λ1 against finite differences, what a step does."""

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.generative.machine import start_machine
from shapeforge.generative.observations import observe
from shapeforge.generative.priors import Strengths, apply_priors, near_points, smoothness
from tests.generative.synthetic import PART_NAMES, chair_family


@pytest.fixture(scope="module")
def case():
    positions, part, _ = chair_family(12, rng=np.random.default_rng(0), density=0.15)
    seen = observe(positions, part, PART_NAMES)
    sizes = ([3] * len(PART_NAMES), 4, 3)
    machine = start_machine(seen, rng=np.random.default_rng(1), sizes=sizes)
    return seen, machine


def test_near_points_are_those_of_the_same_part_within_a_tenth_of_the_shape(case):
    seen, _ = case
    near = near_points(seen)
    largest = max(
        np.linalg.norm(shape[None] - shape[:, None], axis=2).max()
        for shape in (values[exists[seen.part]] for values, exists in zip(seen.values, seen.exists, strict=True))
    )
    for index, one in enumerate(near):
        members = np.flatnonzero(seen.part == index)
        having = seen.values[seen.exists[:, index]][:, members].astype(float)
        mean = np.linalg.norm(having[:, None] - having[:, :, None], axis=3).mean(axis=0)
        for point in range(len(members)):
            found = one.index[one.start[point] : one.start[point + 1]]
            assert point not in found
            assert set(np.flatnonzero(mean[point] < 0.1 * largest)) - {point} == set(found.tolist())
    assert sum(len(one.index) for one in near) > 50


def test_a_step_goes_down_the_slope_of_the_mean_difference_of_neighbours(case):
    """For regular neighbourhoods (all of a part's points) the step is the exact slope of ``smoothness``."""
    seen, machine = case
    near = near_points(seen, radius=3.0)  # everybody is near everybody: the same number of neighbours everywhere
    machine = machine.astype(np.float64)
    before = machine.copy()
    rate, slopes = 1e-7, []
    apply_priors(machine, near, Strengths(smooth=1.0), rate)
    for part in (0, 3):
        own = before.weights[part]
        for place in [(0, 0, 0), (0, 4, 1), (1, 7, 2)]:
            ends = []
            for step in (1e-7, -1e-7):
                moved = own.copy()
                moved[place] += step
                ends.append(smoothness(moved, near[part]))
            slope = (ends[0] - ends[1]) / 2e-7
            assert (own[place] - machine.weights[part][place]) / rate == pytest.approx(slope, abs=1e-4)
            slopes.append(abs(slope))
    assert max(slopes) > 1e-2


def test_smoothing_brings_neighbours_together_and_sparseness_makes_zeros(case):
    seen, machine = case
    near = near_points(seen)
    smooth, sparse = machine.copy(), machine.copy()
    for _ in range(20):
        apply_priors(smooth, near, Strengths(smooth=1.0), 1e-3)
        apply_priors(sparse, None, Strengths(sparse=1.0), 1e-3)
    for part in range(machine.n_parts):
        assert smoothness(smooth.weights[part], near[part]) < 0.9 * smoothness(machine.weights[part], near[part])
        assert (sparse.weights[part] == 0).mean() > (machine.weights[part] == 0).mean() + 0.05
        assert np.abs(sparse.weights[part]).max() < np.abs(machine.weights[part]).max()
    assert (sparse.couplings[0] == 0).any() and not (smooth.couplings[0] == 0).any()


def test_priors_left_out_change_nothing(case):
    seen, machine = case
    same = replace(machine.copy())
    apply_priors(same, near_points(seen), Strengths(decay=3.0), 1e-3)
    for mine, theirs in zip(machine.weights, same.weights, strict=True):
        np.testing.assert_array_equal(mine, theirs)
