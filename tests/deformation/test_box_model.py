"""Part boxes: they move from shape to shape, agree, and split where the difference is greatest."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.cluster import KMeans
from sklearn.metrics import adjusted_rand_score

from shapeforge.deformation.box_model import (
    adjusted_rand,
    agreed_parts,
    bhattacharyya,
    fit_boxes,
    renamed,
    split_most_distinct,
)


def moving_parts(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features, owner and true part of pieces on 30 shapes; two parts trade places over the shapes, together."""
    rng = np.random.default_rng(seed)
    features, owner, truth = [], [], []
    for t in range(30):
        shift = rng.normal(0, 0.7)
        for part, (middle, many) in enumerate(((-0.8, 4), (0.8, 4))):
            at = np.stack([middle + shift + rng.normal(0, 0.15, many), rng.normal(0, 0.15, many)], axis=1)
            features.append(at)
            owner += [t] * many
            truth += [part] * many
    return np.concatenate(features), np.array(owner), np.array(truth)


def test_boxes_that_move_find_what_still_clusters_miss():
    features, owner, truth = moving_parts(0)
    weight = np.ones(len(truth))
    still = KMeans(2, n_init=10, random_state=0).fit_predict(features)
    moving = fit_boxes(features, owner, weight, 2, rng=np.random.default_rng(0)).part
    assert adjusted_rand_score(truth, still) < 0.8
    assert adjusted_rand_score(truth, moving) > adjusted_rand_score(truth, still) + 0.1


def test_rows_are_probabilities_and_more_starts_are_never_worse():
    features, owner, _ = moving_parts(1)
    weight = np.random.default_rng(2).random(len(features)) + 0.1
    one, many = (fit_boxes(features, owner, weight, 3, rng=np.random.default_rng(0), starts=s) for s in (1, 6))
    assert np.allclose(many.belongs.sum(axis=1), 1) and many.bound >= one.bound
    with pytest.raises(ValueError, match="n_parts: wanted at most"):
        fit_boxes(features[:2], owner[:2], weight[:2], 3, rng=np.random.default_rng(0))


def test_adjusted_rand_equals_the_known_one_for_many_equal_weights():
    rng = np.random.default_rng(0)
    one, other = rng.integers(0, 3, 4000), rng.integers(0, 4, 4000)
    other[:3000] = one[:3000]
    assert adjusted_rand(one, other, np.ones(4000)) == pytest.approx(adjusted_rand_score(one, other), abs=2e-3)
    assert adjusted_rand(one, one, rng.random(4000)) == pytest.approx(1)


def test_names_are_matched_one_to_one_by_weight():
    part, model = np.array([0, 0, 1, 1, 2]), np.array([2, 2, 0, 0, 0])
    assert renamed(part, model, np.array([1, 1, 1, 1, 5.0]), 3).tolist() == [2, 2, 1, 1, 0]


def test_answers_vote_and_the_odd_one_is_outvoted():
    rng = np.random.default_rng(0)
    owner = np.repeat(np.arange(20), 6)
    truth = np.tile([0, 0, 1, 1, 2, 2], 20)
    view = np.eye(3)[truth] * 3 + rng.normal(0, 0.2, (120, 3))
    odd = rng.integers(0, 3, 120)
    found = agreed_parts([view, view], owner, np.ones(120), 3, rng=rng, others=[odd])
    assert adjusted_rand_score(truth, found) == 1.0


def test_the_most_distinct_halves_are_split_and_the_smaller_gets_the_new_number():
    rng = np.random.default_rng(0)
    truth = np.tile([0, 0, 1, 2, 2, 2], 20)
    features = np.array([[0, 0], [2, 0], [9, 9]])[truth] + rng.normal(0, 0.2, (120, 2))
    part = np.where(truth == 2, 1, 0)
    split = split_most_distinct(features, np.repeat(np.arange(20), 6), np.ones(120), part, rng=rng)
    assert adjusted_rand_score(truth, split) > 0.9 and (split[truth == 1] == 2).mean() > 0.9
    lonely = split_most_distinct(features[:5], np.zeros(5, np.int64), np.ones(5), np.zeros(5, np.int64), rng=rng)
    assert not lonely.any()


@pytest.mark.parametrize(("gap", "off"), [(1.02, 3), (1.6, 1)])
def test_of_about_equally_distinct_halves_the_smallest_is_split_off(gap, off):
    """Part 0 holds 0 and 1, part 1 holds 2 and a few pieces of 3; 1 lies ``gap`` times as far from 0 as 3 from 2."""
    rng = np.random.default_rng(0)
    truth = np.repeat([0, 1, 2, 3], [40, 40, 60, 12])
    at = 3.0 * np.array([0.0, gap, 8.0, 9.0])[truth]
    features = np.stack([at + rng.normal(0, 0.05, len(at)), rng.normal(0, 0.05, len(at))], axis=1)
    split = split_most_distinct(features, np.arange(len(at)) % 4, np.ones(len(at)), truth // 2, rng=rng)
    assert (split[truth == off] == 2).all() and not (split[truth != off] == 2).any()


def test_bhattacharyya_of_equal_sets_is_zero_and_grows_with_the_gap():
    rows = np.random.default_rng(0).random((30, 3))
    assert bhattacharyya(rows, rows) == pytest.approx(0)
    assert bhattacharyya(rows, rows + 2) > bhattacharyya(rows, rows + 1) > 0
