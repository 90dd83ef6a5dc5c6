"""The learning curve and what it says."""

import numpy as np
import pytest

from shapeforge.generative.curve import CurvePoint, learning_curve, more_shapes
from shapeforge.generative.observations import observe
from tests.generative.synthetic import PART_NAMES, chair_family


def test_more_shapes_give_less_error_on_the_same_judges():
    positions, part, _ = chair_family(60, rng=np.random.default_rng(0), density=0.08)
    observations = observe(positions, part, PART_NAMES)
    shares = (0.1, 1.0)
    curve = list(learning_curve(observations, rng=np.random.default_rng(0), shares=shares, epochs=120))
    assert [point.shapes for point in curve] == [5, 48]
    assert curve[1].held_out_error < 0.9 * curve[0].held_out_error
    assert curve[0].train_error < curve[0].held_out_error
    with pytest.raises(ValueError, match="fewer than 10"):
        next(learning_curve(observations.subset(np.arange(6)), rng=np.random.default_rng(0)))


def test_verdict_follows_the_slope():
    falling = [CurvePoint(n, 0.001, 0.1 * n**-0.5) for n in (25, 50, 100)]
    expected, words = more_shapes(falling)
    assert expected == pytest.approx(0.1 * 200**-0.5, rel=1e-6) and words.endswith("more shapes would help.")
    flat = [CurvePoint(n, 0.001, 0.01 + 1e-5 * (n == 25)) for n in (25, 50, 100)]
    expected, words = more_shapes(flat)
    assert expected == pytest.approx(0.01, rel=1e-2) and "hardly" in words
    # What is left is the machine's own error on the shapes that it knows: more of them do not lower that.
    assert more_shapes([CurvePoint(n, 0.0095, 0.1 * n**-0.5) for n in (25, 50, 100)])[0] == pytest.approx(0.0095)
    with pytest.raises(ValueError, match="2 points"):
        more_shapes(flat[:1])
