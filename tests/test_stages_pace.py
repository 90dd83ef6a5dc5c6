"""How long a fit still takes: as the rounds cost, from the first round on."""

from __future__ import annotations

import pytest

from shapeforge.deformation.fit import planned_rounds
from shapeforge.stages_pace import FACES, Pace, round_costs


def test_family_rounds_come_after_those_of_several_exemplars_and_cost_otherwise():
    alone, several = round_costs(10, 1, 10, 50), round_costs(15, 3, 7, 50)
    assert len(alone) == 10 and len(several) == 15
    assert alone[0] < several[0] and alone[-1] > alone[0]
    assert several[7] > several[8] and several[-1] < several[0]
    assert planned_rounds(10, 1) == 10 and planned_rounds(10, 3) == 15 and planned_rounds(4, 2) == 7


@pytest.mark.parametrize("begun", [0, 9])
def test_the_time_left_is_right_from_the_first_shapes_on_when_rounds_cost_what_is_believed(begun):
    costs, now = round_costs(15, 3, 7, 20), [100.0]
    pace = Pace(begun, clock=lambda: now[0])
    assert pace.left(costs, float(begun)) is None
    whole = sum(costs[begun:]) + FACES
    for done in (begun + 0.1, begun + 1.0, begun + 3.5, 15.0):
        spent = sum(costs[begun : int(done)]) + (done - int(done)) * (costs[int(done)] if done < 15 else 0.0)
        now[0] = 100.0 + 2.0 * spent
        assert pace.left(costs, done) == pytest.approx(2.0 * (whole - spent))
