"""Eq. 2: its value, its gradient, and mean field's bound, against enumeration."""

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.generative.energy import log_unnormalized, log_unnormalized_gradient, mean_field_bound
from shapeforge.generative.inference import infer
from shapeforge.generative.machine import project, recentre
from shapeforge.generative.paper_form import from_paper, log_unnormalized_as_printed, to_paper
from tests.generative.tiny import all_hidden, log_integral_over_points, log_sum, repeated, tiny_machine
from tests.oracles import finite_differences


@pytest.fixture(params=[(0, (3, 2)), (1, (3, 2)), (2, (3, 2)), (3, ()), (4, (3,)), (5, (3, 2, 2))], ids=str)
def case(request):
    seed, above = request.param
    return tiny_machine(np.random.default_rng(seed), above=above)


def random_hidden(machine, n, rng):
    return [rng.uniform(0, 1, (n, size)) for size in machine.sizes]


def test_natural_form_equals_the_print_up_to_a_constant(case):
    """The difference must not depend on D or H (it may depend on E, which the machine is conditioned on)."""
    machine, observations = case
    states = all_hidden(machine)
    form = to_paper(machine)
    for exists in ([True, True], [True, False], [False, True]):
        gaps = []
        for shape in range(3):
            arguments = (
                repeated(observations.values[shape].astype(float), len(states[0])),
                repeated(np.array(exists), len(states[0])), states,
            )  # fmt: skip
            gaps.append(log_unnormalized(machine, *arguments) - log_unnormalized_as_printed(form, machine, *arguments))
        assert np.ptp(gaps) < 1e-9


def test_paper_form_is_positive_and_maps_back(case):
    machine, _ = case
    form = to_paper(machine)
    for name in ("on", "off", "base"):
        assert min(array.min() for array in getattr(form, name)) >= 0
    back = from_paper(form, machine)
    for name in ("weights", "rest"):
        for mine, theirs in zip(getattr(machine, name), getattr(back, name), strict=True):
            np.testing.assert_allclose(theirs, mine, atol=1e-12)
    for name in ("biases", "couplings"):
        for mine, theirs in zip(getattr(machine, name), getattr(back, name), strict=True):
            np.testing.assert_allclose(theirs, mine, atol=1e-12)
    np.testing.assert_allclose(back.existence_top, machine.existence_top, atol=1e-12)


def test_projection_repairs_a_machine_that_is_not_positive(case):
    machine, _ = case
    broken = replace(machine, weights=tuple(30 * weight for weight in machine.weights))
    assert min(base.min() for base in to_paper(broken).base) < 0
    repaired = project(broken)
    assert min(base.min() for base in to_paper(repaired).base) >= 0
    again = project(repaired)
    for once, twice in zip(repaired.weights, again.weights, strict=True):
        np.testing.assert_allclose(twice, once, rtol=1e-9)


def test_recentring_changes_nothing(case):
    machine, observations = case
    states = all_hidden(machine)
    rng = np.random.default_rng(5)
    moved = recentre(machine, [rng.uniform(0.1, 0.9, size) for size in machine.sizes])
    assert not np.allclose(moved.rest[0], machine.rest[0])
    gaps = []
    for shape in range(2):
        arguments = (
            repeated(observations.values[shape].astype(float), len(states[0])),
            np.ones((len(states[0]), 2), bool), states,
        )  # fmt: skip
        gaps.append(log_unnormalized(machine, *arguments) - log_unnormalized(moved, *arguments))
    assert np.ptp(gaps) < 1e-9


@pytest.mark.parametrize("name", ["weights", "rest", "biases", "couplings", "existence_top"])
def test_gradient_equals_finite_differences(case, name):
    machine, observations = case
    values, exists = observations.values.astype(float), observations.exists
    hidden = random_hidden(machine, len(values), np.random.default_rng(3))
    gradient = log_unnormalized_gradient(machine, values, exists, hidden)[name]
    slopes = gradient if isinstance(gradient, tuple) else (gradient,)

    def total(changed):
        return log_unnormalized(changed, values, exists, hidden).sum()

    for slope, measured in zip(slopes, finite_differences(machine, name, total, 1e-5), strict=True):
        np.testing.assert_allclose(slope, measured, atol=1e-6)


def test_points_of_absent_parts_count_for_nothing(case):
    machine, observations = case
    hidden = random_hidden(machine, 1, np.random.default_rng(4))
    values = observations.values[:1].astype(float)
    other = values.copy()
    other[:, 2] = 0.3
    absent = np.array([[True, False]])
    assert log_unnormalized(machine, values, absent, hidden) == log_unnormalized(machine, other, absent, hidden)
    gradient = log_unnormalized_gradient(machine, values, absent, hidden)
    assert np.all(gradient["weights"][1] == 0) and np.all(gradient["rest"][1] == 0)


def test_mean_field_is_a_bound_and_the_best_of_its_neighbours(case):
    machine, observations = case
    states = all_hidden(machine)
    for shape in range(len(observations.values)):
        values = repeated(observations.values[shape].astype(float), len(states[0]))
        exists = repeated(observations.exists[shape], len(states[0]))
        log_z = log_sum(log_unnormalized(machine, values, exists, states))
        latents = infer(machine, values[:1], exists[:1], rounds=200)
        q = latents.layers
        bound = float(mean_field_bound(machine, values[:1], exists[:1], q)[0])
        assert bound <= log_z + 1e-9
        rng = np.random.default_rng(shape)
        for _ in range(20):
            near = [np.clip(layer + rng.normal(0, 0.05, layer.shape), 0, 1) for layer in q]
            assert mean_field_bound(machine, values[:1], exists[:1], near)[0] <= bound + 1e-9


def test_mean_field_is_exact_without_couplings_between_hidden_layers():
    machine, observations = tiny_machine(np.random.default_rng(8), couplings=0.0)
    states = all_hidden(machine)
    values = repeated(observations.values[0].astype(float), len(states[0]))
    exists = repeated(observations.exists[0], len(states[0]))
    log_p = log_unnormalized(machine, values, exists, states)
    latents = infer(machine, values[:1], exists[:1])
    bound = mean_field_bound(machine, values[:1], exists[:1], latents.layers)
    assert float(bound[0]) == pytest.approx(log_sum(log_p), abs=1e-9)
    expected = np.exp(log_p - log_sum(log_p)) @ states[0]
    np.testing.assert_allclose(latents.first[0], expected, atol=1e-9)


def test_points_are_betas_given_the_hidden_units(case):
    """Integrating p~ over D numerically, coordinate by coordinate, gives the Beta functions of α and β."""
    machine, _ = case
    rng = np.random.default_rng(0)
    hidden = [rng.integers(0, 2, (1, size)).astype(float) for size in machine.sizes]
    exists = np.array([True, False])
    closed = float(log_integral_over_points(machine, exists, hidden)[0])
    grid = (np.arange(2000) + 0.5) / 2000
    values = np.full((1, 3, 3), 0.5)
    at_middle = float(log_unnormalized(machine, values, exists[None], hidden)[0])
    total = at_middle
    for point in range(2):
        for axis in range(3):
            moved = np.repeat(values, len(grid), axis=0)
            moved[:, point, axis] = grid
            many = [np.repeat(layer, len(grid), axis=0) for layer in hidden]
            ratio = log_unnormalized(machine, moved, repeated(exists, len(grid)), many) - at_middle
            total += np.log(np.exp(ratio).mean())
    assert total == pytest.approx(closed, abs=2e-2)
