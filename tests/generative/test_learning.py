"""The chain observe -> learn -> mixture -> draw -> directions -> drive on a small family."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.iterate import last
from shapeforge.generative.baselines import draw_from_components, fit_principal_components, reconstruct_by_components
from shapeforge.generative.descriptors import describe_shapes
from shapeforge.generative.draw import _spread_choice, draw, fit_mixture
from shapeforge.generative.inference import Latents, carried, decode, infer
from shapeforge.generative.joint import family_prior, held_out_errors, is_worse, mostly_falls, shape_prior
from shapeforge.generative.learning import learn_machine, reconstruction_error, split, vary
from shapeforge.generative.machine import PARAMETERS, layer_sizes
from shapeforge.generative.observations import observe
from shapeforge.generative.paper_form import to_paper
from shapeforge.generative.scales import Scales
from shapeforge.generative.units import (
    Direction,
    bundles,
    directions,
    drive,
    drive_latents,
    middle_shape,
    single_units,
)
from tests.generative.synthetic import PART_NAMES, chair_family
from tests.generative.tiny import tiny_machine


@pytest.fixture(scope="module")
def family():
    positions, part, classes = chair_family(60, rng=np.random.default_rng(0), density=0.3)
    observations = observe(positions, part, PART_NAMES)
    return observations.subset(np.arange(45)), observations.subset(np.arange(45, 60)), classes


@pytest.fixture(scope="module")
def learned(family):
    return last(learn_machine(family[0], rng=np.random.default_rng(1), epochs=500, pretraining=60))


@pytest.fixture(scope="module")
def mixture(family, learned):
    return fit_mixture(learned.machine, family[0])


def mean_shape_error(family):
    train, test, _ = family
    counted = train.exists[:, train.part][..., None]
    mean = (train.values * counted).sum(axis=0) / np.maximum(counted.sum(axis=0), 1)
    return float(
        (np.abs(test.values - mean).mean(axis=2) * test.exists[:, test.part]).sum()
        / test.exists[:, test.part].sum() * test.diagonals_per_unit
    )  # fmt: skip


def test_new_shapes_come_back_far_better_than_as_the_mean_shape(family, learned):
    test, machine = family[1], learned.machine
    latents = infer(machine, test.values, test.exists)
    floor = mean_shape_error(family)
    assert reconstruction_error(machine, test, decode(machine, latents)) < 0.6 * floor
    assert reconstruction_error(machine, test, decode(machine, latents.top)) < 0.7 * floor


def test_last_state_says_why_it_stopped_and_few_units_are_dead(learned):
    assert learned.stop_reason
    assert max(learned.dead_units) <= 0.05
    assert np.isfinite(learned.held_out_error)


def test_learned_machine_is_positive_as_the_print_asks(learned):
    form = to_paper(learned.machine.astype(np.float64))
    assert min(base.min() for base in form.base) > -1e-4


def test_same_seed_same_bytes_whatever_the_workers(family):
    small = family[0].subset(np.arange(12))
    settings = {"epochs": 6, "pretraining": 3}
    alone = last(learn_machine(small, rng=np.random.default_rng(5), **settings))
    with ThreadPoolExecutor(2) as executor:
        together = last(learn_machine(small, rng=np.random.default_rng(5), executor=executor, **settings))
    for name in PARAMETERS:
        for one, other in zip(getattr(alone.machine, name), getattr(together.machine, name), strict=True):
            np.testing.assert_array_equal(one, other, err_msg=name)


def test_two_shapes_are_enough_and_one_is_refused(family):
    state = last(learn_machine(family[0].subset(np.arange(2)), rng=np.random.default_rng(0), epochs=3, pretraining=2))
    assert np.isnan(state.held_out_error) and np.isfinite(state.train_error)
    with pytest.raises(ValueError, match="at least 2"):
        next(learn_machine(family[0].subset(np.arange(1)), rng=np.random.default_rng(0)))


def test_draws_keep_to_the_parts_seen_and_differ(family, learned, mixture):
    train = family[0]
    drawn = draw(learned.machine, mixture, 200, rng=np.random.default_rng(3))
    seen = {tuple(row) for row in train.exists}
    assert {tuple(row) for row in drawn.exists} <= seen
    for pattern in seen:
        share = (drawn.exists == pattern).all(axis=1).mean()
        assert abs(share - (train.exists == pattern).all(axis=1).mean()) < 0.12
    absent = ~drawn.exists[:, train.part]
    assert np.isnan(drawn.points[absent]).all() and np.isfinite(drawn.points[~absent]).all()
    assert len(np.unique(np.nan_to_num(drawn.points[:, 0, 0]).round(6))) > 50
    again = draw(learned.machine, mixture, 200, rng=np.random.default_rng(3))
    np.testing.assert_array_equal(again.points, drawn.points)


def test_draws_made_at_once_start_from_every_shape_as_often_as_its_weight_asks():
    weight, rng = np.array([1.0, 0.0, 3.0, 2.0]), np.random.default_rng(0)
    for n in (1, 4, 60):
        counts = np.array([np.bincount(_spread_choice(weight, n, rng), minlength=4) for _ in range(300)])
        expected = n * weight / weight.sum()
        assert (np.abs(counts - expected) < 1).all()
        np.testing.assert_allclose(counts.mean(axis=0), expected, atol=0.15)
    assert len(np.unique(_spread_choice(np.ones(50), 50, rng))) == 50


def test_every_kind_of_shape_gets_its_share_of_the_draws():
    kind, rng = np.array([0, 1, 0, 1, 1, 0, 2, 2, 1, 0]), np.random.default_rng(0)
    for _ in range(50):
        shares = np.bincount(kind[_spread_choice(np.ones(10), 5, rng, kind)], minlength=3)
        assert (np.abs(shares - np.array([2, 2, 1])) < 1).all()


def test_draws_are_as_new_as_the_familys_own_shapes_are_to_each_other(family, learned, mixture):
    train, machine = family[0], learned.machine

    def away(rows: np.ndarray, exists: np.ndarray, rank: int) -> float:
        """Mean distance to the nearest shapes with the same parts, bar ``rank``; of those that have another such."""
        found = []
        for row, state in zip(rows, exists, strict=True):
            alike = train.values[(train.exists == state).all(axis=1)][:, state[train.part]]
            if len(alike) > 1:
                squares = ((alike - row[state[train.part]]) ** 2).mean(axis=(1, 2))
                found.append(np.sqrt(np.sort(squares)[rank]))
        return float(np.mean(found))

    usual = away(train.values, train.exists, 1)
    drawn = draw(machine, mixture, 150, rng=np.random.default_rng(3))
    assert 0.75 * usual < away(decode(machine, drawn.latents), drawn.exists, 0) < 1.33 * usual
    narrow = draw(machine, replace(mixture, width=0.05), 150, rng=np.random.default_rng(3))
    assert away(decode(machine, narrow.latents), narrow.exists, 0) < 0.6 * usual


def test_draws_owe_half_to_a_shape_where_shapes_have_too_much_of_their_own(family, learned):
    """Noise on every point, as of a fit: no width can make draws, which are smooth, as new as that."""
    train, rng = family[0], np.random.default_rng(0)
    noisy = np.clip(train.values + rng.normal(0, 0.05, train.values.shape), 0.02, 0.98).astype(np.float32)
    width = fit_mixture(learned.machine, replace(train, values=noisy)).width
    assert 0.45 < width**2 <= 0.5


def test_draw_with_parts_asked_for(learned, mixture):
    wanted = np.array([True, True, True, False, False, False])
    drawn = draw(learned.machine, mixture, 5, rng=np.random.default_rng(0), exists=wanted)
    assert (drawn.exists == wanted).all()
    with pytest.raises(ValueError, match="temperature"):
        draw(learned.machine, mixture, 1, rng=np.random.default_rng(0), temperature=0.0)


def test_a_unit_that_is_quite_on_turns_off_when_the_layers_above_say_so():
    own, before, after = np.array([[1.0, 0.9, 0.3, 0.0]]), np.full((1, 4), 0.9), np.array([[0.1, 0.9, 0.1, 0.1]])
    np.testing.assert_allclose(carried(own, before, after), [[0.2, 0.9, 0.0, 0.0]])
    np.testing.assert_array_equal(carried(own, before, before), own)


@pytest.mark.parametrize("above", [(), (3,), (3, 2)])
def test_a_slider_at_rest_changes_no_unit_and_a_unit_goes_where_its_slider_says(above):
    machine, observations = tiny_machine(np.random.default_rng(0), above=above)
    units = machine.sizes[0]
    base = Latents(
        (np.array([[1.0, 0.0, 0.5, 0.999999]]), *(np.full((1, n), 0.3) for n in above)), np.ones((1, 2), bool)
    )
    few = np.zeros(1)
    sliders = [Direction("", "", "unit", row, -1.0, 1.0, few, few, few, (), i) for i, row in enumerate(np.eye(units))]
    _, still = drive_latents(machine, base, {0: 0.0}, directions=sliders)
    for own, after in zip(base.layers, still.layers, strict=True):
        np.testing.assert_array_equal(own, after)
    _, moved = drive_latents(machine, base, {0: -12.0, 3: -12.0}, directions=sliders)
    assert moved.first[0, [0, 3]].max() < 0.01, "a unit that was quite on is off"


def test_sliders_move_what_their_caption_says(family, learned, mixture):
    train, machine = family[0], learned.machine
    found = directions(machine, train)
    assert [d.vector.tolist() for d in found] == [d.vector.tolist() for d in directions(machine, train)]
    sizes = [d.size for d in found]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[2] >= 0.03, "three sliders must do something one can see"
    assert all(d.low < 0 < d.high and d.histogram.sum() == train.n_shapes and d.heat.max() == 1 for d in found)
    assert found[0].parts[0] in found[0].caption and "%" in found[0].caption
    base = infer(machine, train.values[:1], train.exists[:1])
    still = drive(machine, base, {}, directions=found)
    np.testing.assert_allclose(
        still, machine.to_positions(decode(machine, base), base.exists)[0], atol=1e-6, equal_nan=True
    )
    present = np.isfinite(still[:, 0])
    previous, steps = still, []
    for value in np.linspace(0, found[0].high, 5)[1:]:
        moved = drive(machine, base, {0: float(value)}, directions=found)
        steps.append(np.linalg.norm(moved - still, axis=1)[present].mean())
        assert np.linalg.norm(moved - previous, axis=1)[present].mean() > 0
        previous = moved
    assert steps == sorted(steps)


def test_a_bundle_is_seen_and_goes_one_way(family, learned):
    train, machine = family[0], learned.machine
    found = bundles(machine, train, 3)
    assert [d.vector.tolist() for d in found] == [d.vector.tolist() for d in bundles(machine, train, 3)]
    assert all(d.kind == "bundle" and d.vector.shape == (machine.sizes[0],) for d in found)
    assert found[0].size >= 0.01, "the strongest bundle must do something one can see"
    base = infer(machine, train.values[:1], train.exists[:1])
    ends = [drive(machine, base, {0: value}, directions=found) for value in np.linspace(found[0].low, found[0].high, 5)]
    there = np.isfinite(ends[0][:, 0])
    way = (ends[4] - ends[0])[there]
    along = [float(((end - ends[0])[there] * way).sum() / (way**2).sum()) for end in ends]
    assert along == sorted(along) and along[2] == pytest.approx(0.5, abs=0.3)


def test_single_units_are_those_that_move_most_of_all(family, learned):
    """The promise by which they are chosen is kept: no unit left out moves the family more than the last one shown."""
    train, machine = family[0], learned.machine
    found, every = single_units(machine, train, 6), single_units(machine, train, machine.sizes[0])
    assert [d.unit for d in found] == [d.unit for d in single_units(machine, train, 6)]
    assert len({d.unit for d in every}) == len(every) > 20
    sizes = [d.size for d in every]
    assert sizes == sorted(sizes, reverse=True)
    kept = sum(d.unit in {one.unit for one in found} for d in every[:6])
    assert kept >= 5 and found[0].unit == every[0].unit
    for d in found:
        assert d.kind == "unit" and np.flatnonzero(d.vector).tolist() == [d.unit] and d.low < 0 < d.high


def test_a_slider_s_setting_is_added_to_where_a_shape_stands(family, learned):
    """What a unit is held at is where its slider stands: read off, set and read again."""
    train, machine = family[0], learned.machine
    latents = infer(machine, train.values, train.exists)
    sliders = [*bundles(machine, train, 2), *single_units(machine, train, 3)]
    scales = Scales(machine, latents, sliders)
    for row in (0, 7):
        shape = latents[row]
        values = scales.values(shape)
        for index, slider in enumerate(sliders):
            (layer, unit), level = scales.level(index, float(values[index]), shape.exists[0])
            own = float(shape.layers[layer][0, unit])
            assert (layer, unit) == (0 if slider.kind == "unit" else 1, slider.unit)
            assert level == pytest.approx(np.clip(own, 0.0025, 0.9975), abs=1e-3)
        both = []
        for level in (-1.0, -0.3):
            first = shape.layers[0].copy()
            first[0, sliders[-1].unit] = 1 / (1 + np.exp(-level))
            both.append(scales.values(replace(shape, layers=(first, *shape.layers[1:]))))
        np.testing.assert_allclose(both[1] - both[0], [0, 0, 0, 0, 0.7], atol=1e-3)


def test_the_middle_shape_lies_among_those_with_the_commonest_parts(family, learned):
    train, machine = family[0], learned.machine
    patterns, counts = np.unique(train.exists, axis=0, return_counts=True)
    middle = middle_shape(machine, train)
    np.testing.assert_array_equal(middle.exists[0], patterns[counts.argmax()])
    alike = train.positions()[(train.exists == middle.exists).all(axis=1)]
    there = np.isfinite(alike[0, :, 0])
    points = machine.to_positions(decode(machine, middle), middle.exists)[0][there]

    def mean_distance(one):
        return np.linalg.norm(alike[:, there] - one, axis=2).mean(axis=1)

    assert mean_distance(points).mean() < min(np.delete(mean_distance(a[there]), i).mean() for i, a in enumerate(alike))


def test_small_parts_get_units_of_their_own():
    assert layer_sizes([40, 400, 2], 500) == ([40, 120, 6], 55, 37)
    assert layer_sizes([40, 400, 2], 20, layers=3) == ([20, 20, 6], 15, 10)


def test_a_small_family_gets_two_layers_unless_asked():
    assert len(layer_sizes([40, 400], 150)) == 2 and len(layer_sizes([40, 400], 151)) == 3
    assert len(layer_sizes([40, 400], 150, layers=4)) == 4


def test_descriptors_tell_classes_apart(family, learned):
    train, test, classes = family
    known, new = describe_shapes(learned.machine, train), describe_shapes(learned.machine, test)
    nearest = np.abs(new[:, None] - known[None]).sum(axis=2).argmin(axis=1)
    assert (classes[nearest] == classes[45:]).mean() >= 0.8


def test_prior_is_near_the_shape_and_silent_where_nothing_is(family, learned):
    test, machine = family[1], learned.machine
    positions = test.positions()[0]
    mean, precision = shape_prior(machine, positions)
    present = np.isfinite(positions[:, 0])
    assert np.abs(mean - positions)[present].mean() < 0.03
    assert (precision[~present] == 0).all() and (precision[present] > 0).all()
    # The residuals on shapes never seen must be of the size that the precision claims, not ten times larger.
    prior = family_prior(machine, test)
    gaps = ((prior.mean - test.positions()) ** 2 * prior.precision)[np.isfinite(prior.mean)]
    assert 0.2 < gaps.mean() < 5


def test_shapes_set_aside_are_judged_by_their_surfaces(family, learned):
    test, machine = family[1], learned.machine
    positions = test.positions()[:4]
    surfaces = [p[np.isfinite(p[:, 0])] for p in positions]
    errors = held_out_errors(machine, positions, surfaces)
    assert errors.shape == (4,) and 0 < errors.min() and errors.max() < 0.05
    swapped = positions.copy()
    there = np.flatnonzero(np.isfinite(positions[0, :, 0]))
    swapped[0, there] = positions[0, there[::-1]]  # on the surface, and all wrong
    wrong = held_out_errors(machine, swapped, surfaces)
    assert wrong[0] > 1.5 * errors[0] and np.array_equal(wrong[1:], errors[1:])
    assert is_worse(errors, errors + 1e-4) and not is_worse(errors, errors) and not is_worse(errors, errors - 1e-4)
    assert not is_worse(np.zeros(4), np.array([1.0, -1.1, 1.0, -0.8])), "as good as chance"


def test_a_few_shapes_that_change_much_do_not_decide():
    before = np.ones(20)
    after = np.where(np.arange(20) < 3, 9.0, 0.99)
    assert mostly_falls(before, after), "three rise by much, all others fall a little"
    after = np.where(np.arange(20) < 9, 1.01, 0.1)
    assert not mostly_falls(before, after), "nine of twenty rise: as good as chance"
    assert not mostly_falls(before, before + 0.01) and mostly_falls(before, before)


def test_variations_stay_in_the_family_and_leave_lone_shapes_alone(family):
    train = family[0]
    population = np.full(train.n_shapes, 10)
    varied = vary(train.values, train.exists, population, rng=np.random.default_rng(0))
    assert varied.dtype == train.values.dtype and 0.02 <= varied.min() and varied.max() <= 0.98
    patterns = fit_principal_components(train, components=100)
    inside = (varied > 0.0201) & (varied < 0.9799)
    moved = observe(train.positions(), train.part, PART_NAMES)
    combined = type(moved)(varied, train.exists, train.part, PART_NAMES, train.low, train.high)
    gap = np.abs(reconstruct_by_components(patterns, combined) - varied)[inside]
    assert gap.max() < 1e-2 and np.abs(varied - train.values).mean() > 1e-3
    alone = vary(train.values[:1], train.exists[:1], population[:1], rng=np.random.default_rng(0))
    np.testing.assert_array_equal(alone, train.values[:1])


def test_components_reproduce_training_shapes_and_draw(family):
    train = family[0]
    model = fit_principal_components(train, components=100)
    np.testing.assert_allclose(reconstruct_by_components(model, train), train.values, atol=1e-5)
    for kernel in (False, True):
        values, exists = draw_from_components(model, 5, rng=np.random.default_rng(0), kernel=kernel)
        assert values.shape == (5, *train.values.shape[1:])
        assert {tuple(row) for row in exists} <= {tuple(row) for row in train.exists}


def test_the_shapes_that_judge_may_be_named(family):
    small = family[0].subset(np.arange(14))
    named = np.array([1, 5, 9])
    train, judges = split(small, rng=np.random.default_rng(0), held_out=named)
    np.testing.assert_array_equal(judges.values, small.values[named])
    assert train.n_shapes == 11
    settings = {"epochs": 4, "pretraining": 2, "held_out": named}
    state = last(learn_machine(small, rng=np.random.default_rng(0), **settings))
    # Whatever the judges look like, nothing of them may enter the weights (the cube is the family's).
    changed = replace(small, values=np.where(np.isin(np.arange(14), named)[:, None, None], 0.4, small.values))
    other = last(learn_machine(changed, rng=np.random.default_rng(0), **settings))
    assert state.held_out_error != other.held_out_error
    for mine, theirs in zip(state.machine.weights, other.machine.weights, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    with pytest.raises(ValueError, match="held_out"):
        split(small, rng=np.random.default_rng(0), held_out=np.array([14]))
    with pytest.raises(ValueError, match="held out"):
        next(learn_machine(small, rng=np.random.default_rng(0), held_out=np.arange(13)))


def test_variations_keep_every_part_of_many_apart(family):
    """Two shapes that differ in the first and the last of 63 parts have nothing to vary towards each other by."""
    train, exists = family[0].subset(np.arange(2)), np.zeros((2, 63), bool)
    exists[0, 0], exists[1, 62] = True, True
    varied = vary(train.values, exists, np.ones(2, int), rng=np.random.default_rng(0))
    np.testing.assert_array_equal(varied, train.values)
