"""Templates of the whole family: parts that no exemplar has together, and the same points on every shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups
from shapeforge.collection.iterate import last
from shapeforge.collection.points import nearest_points
from shapeforge.deformation import family
from shapeforge.deformation.exemplars import (
    BROUGHT_ODDS,
    NOWHERE,
    WORTHLESS,
    believed_parts,
    blend,
    leading,
    lenders,
    voices,
    voices_for,
    worth_hearing,
)
from shapeforge.deformation.existence import DOUBT
from shapeforge.deformation.factors import FLOORS
from shapeforge.deformation.fit import HEARD_ROUNDS, fit_templates
from shapeforge.deformation.hierarchy import family_templates
from shapeforge.deformation.partial import LEFT_OUT, PartialStart
from tests.deformation.test_hierarchy import PARTS, chair
from tests.generated import prepared, true_parts


@pytest.fixture(scope="module")
def family_fit():
    """A side chair is painted, and an armchair but for its legs; among the others is another armchair."""
    made = generate("chairs", 2, seed=11, broken=0.0, classes=("side",))
    made += generate("chairs", 2, seed=11, broken=0.0, classes=("armchair",))
    shapes = prepared(made, 700)
    names = made[-1].part_names
    truth = true_parts(made, names)
    groups = Groups(("a", "b"), np.array([0, 0, 0, 1]), np.array([0, 3]), np.zeros((4, 2)))
    labels = {0: truth[0], 3: np.where(truth[3] == names.index("leg"), -1, truth[3])}
    return names, last(fit_templates(shapes, groups, labels, names, rounds=8, rng=np.random.default_rng(0)))


def test_a_hub_gives_all_the_parts_that_it_has():
    plain, armed, stool = chair(0.8, 0.5), chair(0.8, 0.6, arms=True), chair(0.3, 0.9)
    found = family_templates([plain, armed, stool], [9, 1, 2])
    for hierarchy in found:
        assert hierarchy.top.has_part().all() and hierarchy.top.part_names == PARTS
    # the armchair alone has all parts, so it is the only hub; parts chosen one by one come from the frequent one
    assert len(found) == 2
    identity = [(link.weight[:, 0] == 1).all() and link.exists.all() for link in found[1].links]
    assert identity == [False, True, False]


def test_sigma_falls_to_its_floor_with_the_last_round():
    sigma = [family.sigma_of_round(number, 8) for number in range(9)]
    assert sigma[0] == family.SIGMA and sigma[-2:] == [pytest.approx(FLOORS["unary"])] * 2
    np.testing.assert_allclose(np.diff(np.log(sigma[:8])), np.log(FLOORS["unary"] / family.SIGMA) / 7)


def test_the_better_start_goes_on_with_the_exemplars(family_fit):
    state = family_fit[1]
    for candidates in state.candidates:
        of_family = [one for one in candidates if one.family]
        worse = replace(of_family[0], misfit=of_family[0].misfit + 1.0)
        kept = family.better_start((*candidates, worse))
        assert kept == tuple(candidates)


def test_every_shape_is_led_by_the_same_templates(family_fit):
    _, state = family_fit
    number = len(state.templates) - 1
    assert state.phase == "family" and {beliefs.template for beliefs in state.beliefs} == {number}
    hierarchy = state.hierarchy()
    assert hierarchy.top is state.templates[-1] and len(hierarchy.links) == len(state.templates)
    itself = hierarchy.links[-1]
    assert (itself.index[:, 0] == np.arange(hierarchy.top.n_points)).all() and itself.exists.all()
    assert hierarchy.over.shape == (len(hierarchy.links), len(hierarchy.top.part_names)) and hierarchy.levels == 2


def test_parts_of_two_exemplars_are_found_together_on_a_shape_that_has_both(family_fit):
    names, state = family_fit
    both = state.beliefs[2]
    wanted = [names.index(part) for part in ("arm", "leg", "back", "seat")]
    assert both.active[wanted].all() and not both.lent
    exemplars = [candidate for candidate in state.candidates[2] if not candidate.family]
    assert not any(candidate.beliefs.active[wanted].all() for candidate in exemplars)
    assert leading(state.candidates[2]).misfit < min(candidate.misfit for candidate in exemplars)


def test_a_part_that_the_best_exemplar_lacks_is_doubted_earlier(family_fit):
    names, state = family_fit
    leg = names.index("leg")
    of_family = next(one for one in state.candidates[2] if one.family)
    exemplar = next(one for one in state.candidates[2] if not one.family)
    without_leg = np.arange(len(names)) != leg

    def candidates(odds: float, painted: bool = False, against: float = np.nan):
        belief = of_family.beliefs
        said = np.where(without_leg, belief.misfit, odds)
        evidence = np.full_like(belief.evidence, leg if painted else -1)
        lacking = replace(exemplar.beliefs, active=without_leg, misfit=np.where(without_leg, np.nan, against))
        return (
            replace(of_family, beliefs=replace(belief, misfit=said, evidence=evidence), weight=1.0),
            replace(exemplar, beliefs=lacking, weight=0.5),
        )

    assert BROUGHT_ODDS > DOUBT
    assert believed_parts(candidates(BROUGHT_ODDS + 0.5))[leg]
    assert not believed_parts(candidates(BROUGHT_ODDS - 0.5))[leg]
    assert believed_parts(candidates(BROUGHT_ODDS - 0.5, painted=True))[leg]
    # an exemplar to whose template no surface was left speaks against it, but not against one that is quite sure
    assert believed_parts(candidates(BROUGHT_ODDS - NOWHERE + 0.5, against=-np.inf))[leg]
    assert not believed_parts(candidates(BROUGHT_ODDS - NOWHERE - 0.5, against=-np.inf))[leg]


def two_opinions(family_fit, arm_of_first: bool, said: tuple[float, float], weight: float, family: bool = False):
    """Two candidates for the armchair: the best, with arms or not, and another with them; what they say of the odds."""
    names, state = family_fit
    arm, one = names.index("arm"), next(one for one in state.candidates[2] if one.family)
    evidence = np.full_like(one.beliefs.evidence, -1)
    odds = [np.where(np.arange(len(names)) == arm, value, np.nan) for value in said]
    active = one.beliefs.active & ((np.arange(len(names)) != arm) | arm_of_first)
    segmentation = np.where(active, one.beliefs.segmentation, 0.0)
    first = replace(one.beliefs, active=active, segmentation=segmentation, misfit=odds[0], evidence=evidence)
    second = replace(one.beliefs, misfit=odds[1], evidence=evidence)
    found = (
        replace(one, beliefs=first, weight=1.0, family=False),
        replace(one, beliefs=second, weight=weight, family=family),
    )
    return arm, found


def test_a_part_is_not_lent_that_who_explains_the_shape_as_well_doubts(family_fit):
    """The third is as good as the lender, or counts for little beside it."""
    arm, (best, lender) = two_opinions(family_fit, False, (np.nan, np.nan), 0.5)
    assert lenders((best, lender)) == {arm: 1}
    against = np.where(np.isnan(best.beliefs.misfit), DOUBT - 1.0, np.nan)
    third = replace(best, beliefs=replace(best.beliefs, misfit=against), misfit=best.misfit + 50.0)
    assert lenders((best, lender, replace(third, weight=0.5))) == {}
    assert lenders((best, lender, replace(third, weight=0.05))) == {arm: 1}


def test_what_the_family_lends_is_doubted_earlier(family_fit):
    for odds, lent in ((BROUGHT_ODDS + 0.5, True), (BROUGHT_ODDS - 0.5, False), (np.nan, True)):
        arm, found = two_opinions(family_fit, False, (np.nan, odds), 0.9, family=True)
        assert (arm in lenders(found)) == lent
        # an exemplar's own part is only doubted further down
        assert arm in lenders(two_opinions(family_fit, False, (np.nan, odds), 0.9)[1])


def test_an_explanation_that_needs_a_part_nobody_believes_in_is_heard_less(family_fit):
    """Half of its shape is an arm, which the best doubts: then the other half is no seat because of it, either."""
    names, state = family_fit
    arm, leg, seat = (names.index(name) for name in ("arm", "leg", "seat"))
    own, exemplar = (next(one for one in state.candidates[0] if one.family == of) for of in (True, False))
    number, n_parts = own.beliefs.segmentation.shape
    lower = np.arange(number) % 2 == 0

    def saying(one, on_lower: int, elsewhere: int, **changes):
        said = np.eye(n_parts)[np.where(lower, on_lower, elsewhere)]
        active = np.isin(np.arange(n_parts), (on_lower, elsewhere))
        beliefs = replace(one.beliefs, segmentation=said, active=active, evidence=np.full(number, -1), **changes)
        return replace(one, beliefs=beliefs, misfit=5.0, local=np.zeros(number), weight=1.0)

    unasked, doubt = np.full(n_parts, np.nan), np.where(np.arange(n_parts) == arm, -4.0, np.nan)
    right = saying(own, leg, seat, misfit=doubt, copies=np.zeros(0, np.int32))
    wrong = saying(exemplar, seat, arm, misfit=unasked)
    assert not believed_parts((right, wrong))[arm]
    assert voices((right, wrong))[1].max() == pytest.approx(0.5)
    mixed = blend((right, wrong)).segmentation
    assert mixed[lower, leg].min() > 0.9 and mixed[~lower, seat].min() > 0.9
    # between exemplars alone it is no fault: arms may still be found by the family
    earlier = (replace(right, family=False), wrong)
    assert np.allclose(voices_for(earlier, believed_parts(earlier)), voices(earlier))


def test_the_best_is_doubted_by_others_where_nobody_asked_it(family_fit):
    for own, others, weight, believed in (
        (np.nan, DOUBT - 1.0, 0.9, False), (np.nan, DOUBT - 1.0, 0.2, True), (0.5, DOUBT - 1.0, 0.9, True),
        (np.nan, np.nan, 0.9, True),
    ):  # fmt: skip
        arm, found = two_opinions(family_fit, True, (own, others), weight)
        assert believed_parts(found)[arm] == believed


def test_a_shape_that_is_believed_to_have_next_to_nothing_starts_with_all(family_fit):
    names, state = family_fit
    hierarchy, exemplar = state.family, next(one for one in state.candidates[1] if not one.family)
    links = list(hierarchy.links)
    of_exemplar = links[exemplar.beliefs.template]
    known = np.flatnonzero(of_exemplar.exists & exemplar.beliefs.active[hierarchy.top.label])
    links[exemplar.beliefs.template] = replace(
        of_exemplar, exists=np.isin(np.arange(len(of_exemplar.exists)), known[:3])
    )
    made = generate("chairs", 2, seed=11, broken=0.0, classes=("side",))
    shape = prepared(made, 700)[1]
    few = replace(hierarchy, links=tuple(links))
    started = family.family_starts(shape, None, state.templates[:-1], (replace(exemplar, weight=1.0),), few)
    assert started[0].beliefs.active.sum() > 1
    gaps = nearest_points(started[0].beliefs.deformed, shape.points)[1]
    assert gaps.mean() < 0.05


def test_the_family_starts_with_what_was_doubted_still_in_doubt(family_fit):
    names, state = family_fit
    arm, hierarchy = names.index("arm"), state.family
    exemplar = next(one for one in state.candidates[1] if not one.family)
    odds = np.where(np.arange(len(names)) == arm, LEFT_OUT, np.nan)
    doubting = replace(exemplar, beliefs=replace(exemplar.beliefs, misfit=odds), weight=1.0)
    made = generate("chairs", 2, seed=11, broken=0.0, classes=("side",))
    shape = prepared(made, 700)[1]
    started = family.family_starts(shape, None, state.templates[:-1], (doubting,), hierarchy)
    believed = started[-1].beliefs
    assert not believed.active[arm] and believed.misfit[arm] == LEFT_OUT
    assert np.isnan(believed.misfit[believed.active]).all()


def test_the_family_does_without_a_part_only_if_an_exemplar_does(family_fit, monkeypatch):
    """Else all parts together explain a bench as back and seat alone, though every exemplar finds its legs."""
    names, state = family_fit
    leg, arm, hierarchy = names.index("leg"), names.index("arm"), state.family
    sure = next(one for one in state.candidates[1] if not one.family)
    whole = replace(sure, beliefs=replace(sure.beliefs, active=np.ones(len(names), bool)))
    armless = replace(whole, beliefs=replace(whole.beliefs, active=np.arange(len(names)) != arm))
    shape = prepared(generate("chairs", 2, seed=11, broken=0.0, classes=("side",)), 700)[1]

    def better_without_legs_and_arms(points, normals, templates, alignments, kept, prevalence):
        """As if that explained the shape far better, wherever it is allowed."""
        active = templates[0].has_part()
        active[[part for part in (leg, arm) if not kept[part]]] = False
        return [PartialStart(0, active, alignments[0])]

    monkeypatch.setattr(family, "partial_starts", better_without_legs_and_arms)
    first = family.family_starts(shape, None, state.templates[:-1], (whole, armless), hierarchy)[0].beliefs
    assert first.active[leg] and not first.active[arm] and first.segmentation[:, leg].max() > 0.01
    both = family.family_starts(shape, None, state.templates[:-1], (whole, whole), hierarchy)[0].beliefs
    assert both.active[leg] and both.active[arm]


def test_an_exemplar_far_behind_the_best_is_given_up(family_fit):
    shape = family_fit[1].candidates[2]
    near, far = (replace(shape[0], misfit=shape[0].misfit + behind) for behind in (WORTHLESS - 0.1, WORTHLESS + 0.1))
    assert worth_hearing((far, shape[0], near)) == (shape[0], near)


def test_given_up_exemplars_are_not_taken_up_again():
    """A chair and a bench ask both exemplars at first; the one of the other kind is dropped on the way."""
    made = generate("chairs", 2, seed=3, broken=0.0, classes=("side",)) + generate(
        "chairs", 2, seed=3, broken=0.0, classes=("bench",)
    )
    shapes = prepared(made, 400)
    names = made[0].part_names
    truth = true_parts(made, names)
    labels = {t: truth[t] for t in (0, 2)}
    groups = Groups(("chairs", "benches"), np.array([0, 0, 1, 1]), np.array([0, 2]), np.zeros((4, 2)))
    counts = []
    for state in fit_templates(shapes, groups, labels, names, rounds=10, rng=np.random.default_rng(0)):
        counts.append(sum(not one.family for found in state.candidates for one in found))
    assert counts[0] == counts[HEARD_ROUNDS - 1] == 8
    assert (np.diff(counts) <= 0).all() and counts[-1] < 8
