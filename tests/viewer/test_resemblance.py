"""Where new shapes lie among those of a family."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.viewer.resemblance import blend, least_like


def family(seed: int) -> np.ndarray:
    """Twelve shapes of forty points, two of them without the last ten."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(40, 3)) + 0.1 * rng.normal(size=(12, 40, 3))
    positions[10:, 30:] = np.nan
    return positions


@pytest.mark.parametrize("seed", range(3))
def test_a_shape_of_the_family_lies_at_its_own_place_and_one_between_two_between_them(seed: int) -> None:
    positions = family(seed)
    for index in (0, 5, 11):
        weight = blend(positions, positions[index])
        assert weight.sum() == pytest.approx(1) and weight[index] > 0.95
    last = None
    for share in (0.2, 0.4, 0.6, 0.8):
        weight = blend(positions, (1 - share) * positions[1] + share * positions[2])
        assert weight[[1, 2]] == pytest.approx([1 - share, share], abs=0.1)
        assert last is None or weight[2] > last + 0.1, "step by step"
        last = weight[2]


def test_the_shape_least_like_another_has_the_same_parts_where_there_is_one() -> None:
    positions, group = family(0), np.zeros(12, int)
    exists = np.isfinite(positions[:, [0, 35], 0])
    assert least_like(positions, exists, group, 10) == 11 and least_like(positions, exists, group, 0) < 10
    assert least_like(positions[:1], exists[:1], group[:1], 0) == 0
