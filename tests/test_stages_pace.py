"""How long a fit still takes: as the rounds cost, from the first shapes on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from shapeforge.deformation.fit import planned_rounds
from shapeforge.stages_pace import FitCosts, Pace

COSTS = FitCosts(shapes=20, points=5000, faces=4000, exemplars=3, of=15, family_from=7, heard=3.0)


def test_family_rounds_come_after_those_of_several_exemplars_and_cost_otherwise():
    alone, several = replace(COSTS, exemplars=1, heard=1.0, of=10, family_from=10).steps, COSTS.steps
    assert len(alone) == 11 and len(several) == 16, "the affine start is the first"
    assert alone[1] < several[1] and alone[9] > alone[1]
    assert several[8] > several[9] and several[-2] < several[1]
    assert planned_rounds(10, 1) == 10 and planned_rounds(10, 3) == 15 and planned_rounds(4, 2) == 7


def test_exemplars_that_were_given_up_cost_nothing_and_fine_meshes_cost_after_the_rounds():
    fewer, finer = replace(COSTS, heard=1.5), replace(COSTS, faces=40000)
    assert fewer.steps[3] == COSTS.steps[3] and fewer.steps[5] == pytest.approx(COSTS.steps[5] / 2)
    assert finer.steps == COSTS.steps and finer.after > 4 * COSTS.after


@pytest.mark.parametrize("begun", [0, 9])
def test_the_time_left_is_right_from_the_first_shapes_on_when_rounds_cost_what_is_believed(begun):
    steps, now = COSTS.steps, [100.0]
    pace = Pace(begun, clock=lambda: now[0])
    assert pace.left(COSTS, float(begun)) is None
    whole = sum(steps[begun:]) + COSTS.after
    for done in (begun + 0.1, begun + 1.0, begun + 3.5, 16.0):
        spent = sum(steps[begun : int(done)]) + (done - int(done)) * (steps[int(done)] if done < 16 else 0.0)
        now[0] = 100.0 + 2.0 * spent
        assert pace.left(COSTS, done) == pytest.approx(2.0 * (whole - spent))
