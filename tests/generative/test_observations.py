"""Into the unit interval and back; holes and absent parts; which parts exist together."""

import numpy as np
import pytest

from shapeforge.generative.observations import LIMIT, observe
from shapeforge.generative.structure import all_states, fit_structure
from tests.generative.synthetic import PART_NAMES, chair_family


def test_there_and_back():
    positions, part, _ = chair_family(12, rng=np.random.default_rng(0), density=0.2)
    seen = observe(positions, part, PART_NAMES)
    assert seen.values.min() >= LIMIT and seen.values.max() <= 1 - LIMIT
    np.testing.assert_allclose(seen.positions(), positions, atol=1e-6, equal_nan=True)
    later = observe(positions[:2], part, PART_NAMES, seen.low, seen.high)
    np.testing.assert_array_equal(later.values[later.exists[:, part]], seen.values[:2][later.exists[:, part]])


def test_a_step_is_as_long_along_every_axis():
    positions, part, _ = chair_family(3, rng=np.random.default_rng(0), density=0.2)
    seen = observe(positions, part, PART_NAMES)
    moved = seen.values.copy()
    moved[0, 0] += 0.01
    from shapeforge.generative.observations import to_positions

    step = to_positions(moved, seen.exists, part, seen.low, seen.high)[0, 0] - seen.positions()[0, 0]
    np.testing.assert_allclose(step, 0.01 * seen.diagonals_per_unit, rtol=1e-4)


def test_single_holes_are_filled_by_the_deformed_mean_part():
    rng = np.random.default_rng(0)
    template = rng.uniform(-0.3, 0.3, (40, 3))
    positions = np.stack([template * rng.uniform(0.6, 1.2, 3) for _ in range(8)])
    truth = positions[3, :4].copy()
    positions[3, :4] = np.nan
    seen = observe(positions, np.zeros(40, int), ("all",))
    assert seen.exists.all()
    gap = np.abs(seen.positions()[3, :4] - truth).max()
    naive = np.abs(np.delete(positions, 3, axis=0)[:, :4].mean(axis=0) - truth).max()
    assert gap < 0.2 * naive


def test_a_part_with_hardly_a_point_is_absent():
    positions = np.random.default_rng(0).uniform(-0.3, 0.3, (3, 20, 3))
    positions[1, 2:10] = np.nan
    seen = observe(positions, np.repeat([0, 1], 10), ("a", "b"))
    assert seen.exists.tolist() == [[True, True], [False, True], [True, True]]


@pytest.mark.parametrize("part", [np.array([0, 2]), np.array([-1, 0])])
def test_parts_without_name_are_refused(part):
    with pytest.raises(ValueError, match="part"):
        observe(np.zeros((1, 2, 3)), part, ("a", "b"))


def test_nothing_at_all_is_refused():
    with pytest.raises(ValueError, match="finite"):
        observe(np.full((2, 2, 3), np.nan), np.array([0, 0]), ("a",))


def test_structure_learns_an_exclusive_choice_exactly():
    """Legs or column-and-base, arms independent of it: no sum of biases can say that."""
    rng = np.random.default_rng(0)
    column = rng.random(400) < 0.4
    exists = np.column_stack([np.ones(400, bool), ~column, column, column, rng.random(400) < 0.3])
    structure = fit_structure(exists, rng=rng)
    states = all_states(5)
    probability = np.exp(structure.log_probability(states))
    assert probability.sum() == pytest.approx(1)
    empirical = np.array([(exists == state).all(axis=1).mean() for state in states])
    assert 0.5 * np.abs(probability - empirical).sum() < 0.04
    drawn = structure.draw(500, rng=rng)
    assert (drawn[:, 1] & drawn[:, 2]).mean() < 0.02


def test_structure_gradient_is_that_of_the_exact_likelihood():
    """At the optimum every expected statistic equals the data's, but for the small ridge."""
    rng = np.random.default_rng(1)
    exists = rng.random((60, 4)) < [0.2, 0.5, 0.8, 0.95]
    structure = fit_structure(exists, rng=rng, n_hidden=3)
    probability = np.exp(structure.log_probability(structure.states))
    np.testing.assert_allclose(probability @ structure.states, exists.mean(axis=0), atol=0.01)
