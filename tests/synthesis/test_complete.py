"""Draws that fall asunder get the part that joins them, and no others do."""

from __future__ import annotations

import numpy as np

from shapeforge.synthesis.complete import bridging_parts, completed_parts

SEAT, LEG, COLUMN, BASE, PLATE = range(5)


def table(*pairs: tuple[int, int, float]) -> np.ndarray:
    touching = np.zeros((5, 5))
    for a, b, share in pairs:
        touching[a, b] = touching[b, a] = share
    return touching


def pattern(*parts: int) -> np.ndarray:
    return np.isin(np.arange(5), parts)


TOUCHING = table((SEAT, LEG, 1.0), (SEAT, COLUMN, 0.9), (COLUMN, BASE, 1.0), (SEAT, BASE, 0.1))


def test_the_column_comes_between_seat_and_base() -> None:
    assert np.array_equal(bridging_parts(pattern(SEAT, BASE), TOUCHING), pattern(SEAT, COLUMN, BASE))


def test_what_holds_together_stays_as_it_is() -> None:
    for whole in (pattern(SEAT, LEG), pattern(SEAT, COLUMN, BASE), pattern(SEAT), pattern()):
        assert np.array_equal(bridging_parts(whole, TOUCHING), whole)
    rarely = TOUCHING.copy()
    rarely[SEAT, BASE] = rarely[BASE, SEAT] = 0.3  # it does happen
    assert np.array_equal(bridging_parts(pattern(SEAT, BASE), rarely), pattern(SEAT, BASE))


def test_nothing_is_added_where_nothing_joins() -> None:
    assert np.array_equal(bridging_parts(pattern(SEAT, PLATE), TOUCHING), pattern(SEAT, PLATE))
    seldom = table((SEAT, COLUMN, 0.4), (COLUMN, BASE, 1.0))
    assert np.array_equal(bridging_parts(pattern(SEAT, BASE), seldom), pattern(SEAT, BASE))


def test_two_parts_may_be_needed() -> None:
    chain = table((SEAT, COLUMN, 1.0), (COLUMN, PLATE, 0.8), (PLATE, BASE, 1.0))
    assert bridging_parts(pattern(SEAT, BASE), chain).sum() == 4


def test_what_almost_all_shapes_have_is_not_left_out() -> None:
    having = np.where(pattern(SEAT), 0.96, 0.9)
    assert np.array_equal(completed_parts(pattern(BASE), TOUCHING, having), pattern(SEAT, COLUMN, BASE))
    assert np.array_equal(completed_parts(pattern(BASE), TOUCHING, np.full(len(having), 0.9)), pattern(BASE))
