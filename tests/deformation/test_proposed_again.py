"""Parts proposed again keep the numbers that they had, as far as they are the same."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.deformation.boxes import Proposal
from shapeforge.deformation.proposed_again import numbered_as, shared_surface


def proposal(*labels: list[int], parts: int) -> Proposal:
    names = tuple(f"part {i + 1}" for i in range(parts))
    return Proposal(tuple(np.eye(parts)[one] for one in labels), names, 0.0, np.array([0]))


BEFORE = proposal([0, 0, 1, 1], [0, 0, 0, 1], parts=2)


def test_parts_in_another_order_get_their_numbers_back_and_new_ones_come_last():
    now = proposal([2, 2, 2, 2], [1, 1, 0, 2], [1, 1, 1, 0], parts=3)  # a shape more, and it comes first
    same = [(0, 1), (1, 2)]
    again = numbered_as(BEFORE, now, same)
    assert [one.argmax(axis=1).tolist() for one in again.segmentation] == [[2] * 4, [0, 0, 1, 2], [0, 0, 0, 1]]
    np.testing.assert_allclose(shared_surface(BEFORE, again, same), [[1, 0, 0], [0, 2 / 3, 1 / 3]])


def test_a_part_of_no_shape_shares_nothing_and_fewer_parts_are_refused():
    assert shared_surface(BEFORE, BEFORE, []).tolist() == [[0, 0], [0, 0]]
    with pytest.raises(ValueError, match="at least 2 parts, got 1"):
        numbered_as(BEFORE, proposal([0, 0, 0, 0], parts=1), [(0, 0)])
