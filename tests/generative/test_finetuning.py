"""The reverse pass through the unrolled mean field, against finite differences."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from shapeforge.generative.finetuning import Batch, TopPrior, loss_and_gradient
from tests.generative.tiny import tiny_machine
from tests.oracles import finite_differences


def setting(seed, above=(3, 2)):
    rng = np.random.default_rng(seed)
    machine, observations = tiny_machine(rng, above=above)
    top = machine.sizes[-1]
    prior = TopPrior(rng.normal(size=top), rng.normal(size=(2, top)))
    noise = rng.uniform(-0.5, 0.5, (observations.n_shapes, top))
    batch = Batch(observations.values.astype(float), observations.exists, np.array([1.0, 1.5]), noise=noise)
    return machine, prior, batch


NAMES = [
    "weights", "rest", "biases", "couplings", "existence_top", "prior_bias", "prior_weights",
]  # fmt: skip


@pytest.mark.parametrize(("seed", "above"), [(0, (3, 2)), (1, (3, 2)), (2, ()), (3, (3,)), (4, (3, 2, 2))])
@pytest.mark.parametrize("name", NAMES)
def test_reverse_pass_equals_finite_differences(name, seed, above):
    machine, prior, batch = setting(seed, above)
    gradient = loss_and_gradient(machine, prior, batch)[1][name]
    owner, field = (prior, name.removeprefix("prior_")) if name.startswith("prior_") else (machine, name)
    slopes = gradient if isinstance(gradient, tuple) else (gradient,)

    def loss(changed):
        pair = (machine, changed) if owner is prior else (changed, prior)
        return loss_and_gradient(*pair, batch)[0].loss

    largest = 0.0
    for slope, measured in zip(slopes, finite_differences(owner, field, loss, 1e-6), strict=True):
        np.testing.assert_allclose(slope, measured, atol=2e-6, rtol=2e-5)
        largest = max(largest, float(np.abs(measured).max()))
    nothing_between = name == "couplings" and not above
    assert nothing_between or largest > 1e-5, "a gradient that is zero everywhere proves nothing"


def test_threads_change_no_bit():
    machine, prior, batch = setting(3)
    alone = loss_and_gradient(machine, prior, batch)
    with ThreadPoolExecutor(2) as executor:
        together = loss_and_gradient(machine, prior, batch, executor.map)
    assert alone[0] == together[0]
    for name in NAMES:
        one, two = alone[1][name], together[1][name]
        one, two = (one, two) if isinstance(one, tuple) else ((one,), (two,))
        assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True)), name


def test_sampled_top_is_binary():
    machine, prior, batch = setting(4)
    uniform = np.random.default_rng(0).random(batch.noise.shape)
    sampled = loss_and_gradient(machine, prior, replace(batch, noise=None, uniform=uniform))[0]
    mean = loss_and_gradient(machine, prior, replace(batch, noise=None))[0]
    assert sampled.top != mean.top and sampled.first == mean.first
