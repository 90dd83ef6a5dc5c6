"""Intervals cover as often as they say; tables line up."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.validation.statistics import bootstrap_interval, format_table, paired_difference, summarize


def test_intervals_cover_the_mean_about_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(200):
        low, high = bootstrap_interval(rng.exponential(size=60), n_resamples=300, rng=rng)
        covered += low <= 1.0 <= high
    assert 170 <= covered <= 198


def test_summary_and_paired_difference() -> None:
    rng = np.random.default_rng(0)
    found = summarize([1.0, 2.0, 3.0, 10.0], rng=rng)
    assert (found.mean, found.median, found.n) == (4.0, 2.5, 4)
    assert found.low < found.mean < found.high
    hard = rng.uniform(0.3, 0.9, 50)  # shapes differ far more than methods do: pairing sees it all the same
    difference = paired_difference(hard + 0.02, hard + rng.normal(0, 0.01, 50), rng=rng)
    assert difference.low > 0.01 and difference.high < 0.03
    assert np.isnan(summarize([], rng=rng).mean) and summarize([], rng=rng).n == 0


def test_tables_line_up() -> None:
    text = format_table(["set", "faces", "n"], [["chairs", 0.91234, 16], ["x", 1.0, 4]])
    lines = text.splitlines()
    assert lines[2] == "chairs  0.912  16" and lines[3] == "x       1.000   4"
    with pytest.raises(ValueError, match="rows"):
        format_table(["a", "b"], [["only one"]])
