"""1-NN classes: separable ones are found, meaningless descriptors give chance."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.validation.classification import nearest_neighbour_accuracy


def test_separable_classes_are_found_and_noise_gives_chance() -> None:
    rng = np.random.default_rng(0)
    classes = np.repeat(["bench", "chair", "stool"], 30)
    centres = np.repeat(np.eye(3) * 10, 30, axis=0)
    found = nearest_neighbour_accuracy(centres + rng.normal(size=(90, 3)), classes.tolist(), rng=rng)
    assert found.accuracy == 1.0
    assert (found.n_training, found.n_test, found.n_classes) == (30, 60, 3)
    lost = nearest_neighbour_accuracy(rng.normal(size=(90, 3)), classes.tolist(), rng=rng)
    assert lost.accuracy == pytest.approx(1 / 3, abs=0.06)
    assert lost.chance == pytest.approx(1 / 3)


def test_the_distance_is_l1() -> None:
    # Query (0, 0): L2 prefers (2, 2) of class a to (3, 0) of class b; L1 the other way round.
    descriptors = np.array([[2.0, 2.0], [0.0, 0.0], [3.0, 0.0], [50.0, 0.0]])
    rng = np.random.default_rng(1)
    found = nearest_neighbour_accuracy(descriptors, ["a", "b", "b", "a"], per_class=1, n_splits=400, rng=rng)
    # Of the 4 equally likely splits: b trains with (3,0): (0,0) is right under L1 only when ...
    expected = []
    for a in (0, 3):
        for b in (1, 2):
            for test in {0, 1, 2, 3} - {a, b}:
                l1 = [np.abs(descriptors[test] - descriptors[t]).sum() for t in (a, b)]
                expected.append((l1[0] < l1[1]) == (test in (0, 3)))
    assert found.accuracy == pytest.approx(np.mean(expected), abs=0.05)


def test_small_classes_share_and_single_ones_are_left_out() -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate([np.zeros((12, 1)), np.ones((4, 1)), np.full((1, 1), 5.0)])
    found = nearest_neighbour_accuracy(values, ["a"] * 12 + ["b"] * 4 + ["c"], rng=rng)
    assert (found.n_training, found.n_test, found.n_classes) == (12, 4, 2)
    assert nearest_neighbour_accuracy(values, ["a"] * 17, rng=rng) is None
    with pytest.raises(ValueError, match="classes"):
        nearest_neighbour_accuracy(values, ["a"], rng=rng)
