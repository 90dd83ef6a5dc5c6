"""A fit taken up again: what was corrected, repainted or is new is found, the rest keeps what it had."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups
from shapeforge.collection.prepare import prepare_shape
from shapeforge.deformation.fit import fit_templates
from shapeforge.deformation.warm import (
    FAMILY_ROUNDS,
    WARM_ROUNDS,
    corrected_shapes,
    gathered,
    refit_templates,
    why_not_warm,
)

SHAPES, WRONG, POINTS = 6, 2, 600


@pytest.fixture(scope="module")
def family():
    """Six chairs, of which two are exemplars; on another one seat and back were painted the wrong way round."""
    made = generate("chairs", SHAPES, seed=5, broken=0.0)
    names = made[0].part_names
    shapes = [
        prepare_shape(f"{i}_{one.name}", one.mesh, n_points=POINTS, up="keep", rng=np.random.default_rng(i))
        for i, one in enumerate(made)
    ]
    truth = [np.array([names.index(one.part_names[part]) for part in one.faces], np.int32) for one in made]
    groups = Groups(("a", "b"), np.array([0, 0, 0, 0, 1, 1]), np.array([0, 4]), np.zeros((SHAPES, 2)))
    exemplars = {0: truth[0], 4: truth[4]}
    one, other = np.unique(truth[WRONG])[:2]
    wrong = np.select([truth[WRONG] == one, truth[WRONG] == other], [other, one], truth[WRONG]).astype(np.int32)
    state = list(
        fit_templates(shapes, groups, {**exemplars, WRONG: wrong}, names, rounds=6, rng=np.random.default_rng(0))
    )[-1]
    stroke = np.where(np.random.default_rng(3).random(len(wrong)) < 0.1, truth[WRONG], -1).astype(np.int32)
    return shapes, groups, truth, names, state, {**exemplars, WRONG: stroke}


def share_right(family, state, t: int) -> float:
    """Share of the points of shape t, unpainted ones only, whose probable part is the true one."""
    shapes, _, truth, _, _, labels = family
    on = shapes[t].face_of_point
    blank = labels[t][on] < 0 if t in labels else np.ones(POINTS, bool)
    return float((state.beliefs[t].segmentation.argmax(axis=1) == truth[t][on])[blank].mean())


def refit(family, **options):
    shapes, groups, _, names, state, labels = family
    options = {"rng": np.random.default_rng(0), **options}
    return list(refit_templates(state, shapes, groups, labels, names, **options))


def test_a_few_strokes_put_a_shape_right_and_the_others_keep_what_was_good(family):
    shapes, groups, _, names, before, labels = family
    states = refit(family)
    after = states[-1]
    assert share_right(family, before, WRONG) < 0.5 and share_right(family, after, WRONG) > 0.8
    others = [t for t in range(SHAPES) if t not in labels]
    kept, had = ([share_right(family, state, t) for t in others] for state in (after, before))
    assert np.mean(kept) >= np.mean(had) and np.min(np.subtract(kept, had)) > -0.02
    # merely going on from the sharp state is worse: the templates stay on the wrong surface
    plain = list(
        fit_templates(
            shapes, groups, labels, names, resume=before, rounds=before.round + WARM_ROUNDS,
            family_rounds=before.round - before.family_from, rng=np.random.default_rng(0),
        )
    )[-1]  # fmt: skip
    assert share_right(family, after, WRONG) > share_right(family, plain, WRONG) + 0.02


def test_it_is_a_few_rounds_and_tells_them(family):
    before = family[4]
    states = refit(family)
    assert states[0].phase == "corrected" and states[0].round == before.round
    assert [state.round for state in states[1:]] == list(range(before.round + 1, before.round + WARM_ROUNDS + 1))
    assert all(state.of == before.round + WARM_ROUNDS for state in states) and states[-1].stop_reason
    assert len(states[-1].templates) == len(before.templates)


def test_stopped_after_any_state_it_goes_on_to_the_same_end(family):
    shapes, groups, _, names, _, labels = family
    whole = refit(family)
    for stopped in whole[:-1]:
        rng = np.random.default_rng(0)
        end = list(refit_templates(stopped, shapes, groups, labels, names, rng=rng))[-1]
        for one, other in zip(end.beliefs, whole[-1].beliefs, strict=True):
            assert np.array_equal(one.deformed, other.deformed)


def test_only_what_was_painted_otherwise_counts_as_corrected(family):
    shapes, _, _, _, state, labels = family
    assert corrected_shapes(state, shapes, labels) == (WRONG,)
    assert corrected_shapes(state, shapes, {t: faces for t, faces in labels.items() if t != WRONG}) == (WRONG,)
    assert corrected_shapes(refit(family)[0], shapes, labels) == ()


def test_it_says_why_a_fit_has_to_start_anew(family):
    shapes, groups, truth, names, state, labels = family
    assert why_not_warm(state, shapes, groups, labels, names) == ""
    assert "parts" in why_not_warm(state, shapes, groups, labels, (*names, "wing"))
    assert "other shapes" in why_not_warm(state, shapes[:-1], groups, labels, names)
    moved = Groups(groups.names, groups.group, np.array([1, 4]), groups.embedding)
    assert "exemplars" in why_not_warm(state, shapes, moved, labels, names)
    unpainted = {t: faces for t, faces in labels.items() if t != 4}
    assert f"{shapes[4].name} is an exemplar, and is no longer" in why_not_warm(state, shapes, groups, unpainted, names)
    third = Groups(("a", "b", "c"), np.array([0, 0, 0, 2, 1, 1]), np.array([0, 4, 3]), groups.embedding)
    assert "had no templates" in why_not_warm(state, shapes, third, {**labels, 3: truth[3]}, names)
    parts = np.bincount(truth[4][shapes[4].face_of_point])
    lacking = {**labels, 4: np.where(truth[4] == parts.argmax(), -1, truth[4]).astype(np.int32)}
    assert f"Much of {shapes[4].name} was painted" in why_not_warm(state, shapes, groups, lacking, names)
    whole = truth[4][shapes[4].face_of_point]
    little = {**labels, 4: np.where(np.isin(np.arange(len(truth[4])), shapes[4].face_of_point[:40]), -1, truth[4])}
    assert 0 < (little[4][shapes[4].face_of_point] < 0).sum() < 0.1 * len(whole)
    assert why_not_warm(state, shapes, groups, little, names) == "", "some paint may go"
    bare = family_without(family, state, parts.argmax())
    assert f"Much of {shapes[4].name} was unpainted" in why_not_warm(bare, shapes, groups, labels, names)
    other = [replace(shapes[0], descriptors=shapes[0].descriptors + 1.0), *shapes[1:]]
    repainted = {**labels, 0: np.zeros_like(truth[0])}
    assert "read anew" in why_not_warm(state, other, groups, repainted, names)
    forgotten = gathered(state, ["" if t == 0 else one.name for t, one in enumerate(shapes)], of_names(shapes))
    assert "read anew" in why_not_warm(forgotten, shapes, groups, labels, names)
    with pytest.raises(ValueError, match="Fit from the start"):
        next(refit_templates(state, shapes, moved, labels, names, rng=np.random.default_rng(0)))


def test_strokes_on_an_exemplar_of_proposed_parts_change_its_templates_there_alone(family):
    shapes, groups, truth, names, *_ = family
    parts = [faces[shape.face_of_point] for shape, faces in zip(shapes, truth, strict=True)]
    seeds = [0.7 * np.eye(len(names))[one] + 0.3 / len(names) for one in parts]
    known = {"seeds": seeds, "rng": np.random.default_rng(0)}
    before = next(fit_templates(shapes, groups, {}, names, rounds=1, **known))
    faces = np.full(len(truth[0]), -1, np.int32)
    faces[shapes[0].face_of_point[:30]] = 0  # some of it was something else
    wanted = np.where(faces[shapes[0].face_of_point] == 0, 0, parts[0])
    assert 0 < (wanted != parts[0]).sum() < 0.2 * POINTS
    cold = next(fit_templates(shapes, groups, {0: faces}, names, rounds=1, **known))
    assert why_not_warm(before, shapes, groups, {0: faces}, names, seeds) == ""
    warm = next(refit_templates(before, shapes, groups, {0: faces}, names, **known))
    for state in (cold, warm):
        assert np.array_equal(np.bincount(state.templates[0].label), np.bincount(wanted))
        assert np.array_equal(state.templates[1].label, before.templates[1].label)
    assert "was painted in the fit and no longer" in why_not_warm(before, shapes, groups, {0: faces}, names)


def family_without(family, state, part: int):
    """The first state of a fit whose second exemplar had no such part, in the place of ``state``."""
    shapes, groups, truth, names, *_ = family
    labels = {0: truth[0], 4: np.where(truth[4] == part, -1, truth[4]).astype(np.int32)}
    return next(fit_templates(shapes, groups, labels, names, rounds=6, rng=np.random.default_rng(0)))


def of_names(shapes) -> list[str]:
    return [shape.name for shape in shapes]


def share_of_all(family, state) -> list[float]:
    """Share of the points of every shape whose probable part is the true one."""
    shapes, _, truth, *_ = family
    return [
        float((one.segmentation.argmax(axis=1) == truth[t][shapes[t].face_of_point]).mean())
        for t, one in enumerate(state.beliefs)
    ]


@pytest.fixture(scope="module")
def badly_painted(family):
    """The same chairs, fitted with the two largest parts of the first exemplar painted as each other."""
    shapes, groups, truth, names, *_ = family
    a, b = np.argsort(-np.bincount(truth[0][shapes[0].face_of_point]))[:2]
    bad = np.select([truth[0] == a, truth[0] == b], [b, a], truth[0]).astype(np.int32)
    labels, rng = {0: bad, 4: truth[4]}, np.random.default_rng(0)
    return list(fit_templates(shapes, groups, labels, names, rounds=6, rng=rng))[-1]


def repaint(family, state, **options):
    shapes, groups, truth, names, *_ = family
    labels, rng = {0: truth[0], 4: truth[4]}, np.random.default_rng(0)
    return list(refit_templates(state, shapes, groups, labels, names, rng=rng, **options))


def test_an_exemplar_painted_otherwise_gives_new_templates_and_all_shapes_follow(family, badly_painted):
    shapes, _, truth, names, *_ = family
    states = repaint(family, badly_painted)
    after, first = states[-1], states[0]
    assert np.mean(share_of_all(family, badly_painted)) < 0.7
    assert np.mean(share_of_all(family, after)) > 0.85 and np.min(share_of_all(family, after)) > 0.7
    assert [state.round for state in states] == list(range(first.round, first.of + 1))
    assert after.round == badly_painted.round + WARM_ROUNDS + FAMILY_ROUNDS and after.stop_reason
    template = first.templates[0]
    counts = np.bincount(truth[0][shapes[0].face_of_point], minlength=len(names))
    assert np.array_equal(np.bincount(template.label, minlength=len(names)), counts), "made of the paint of now"
    assert after.templates[1].source == badly_painted.templates[1].source and len(after.templates) == 3


def test_carried_templates_lie_where_the_old_ones_did_before_any_round(family, badly_painted):
    first = repaint(family, badly_painted)[0]
    for t in range(1, SHAPES):
        old = [one.beliefs for one in badly_painted.candidates[t] if one.beliefs.template == 0 and not one.family]
        new = [one.beliefs for one in first.candidates[t] if one.beliefs.template == 0]
        assert len(old) == len(new)
        for before, now in zip(old, new, strict=True):
            assert np.allclose(
                np.sort(now.deformed.astype(float), axis=0), np.sort(before.deformed.astype(float), axis=0), atol=1e-6
            )


def test_a_repaint_stopped_after_any_state_goes_on_to_the_same_end(family, badly_painted):
    whole = repaint(family, badly_painted)
    for stopped in (whole[0], whole[WARM_ROUNDS], whole[-2]):
        end = repaint(family, stopped)[-1]
        for one, other in zip(end.beliefs, whole[-1].beliefs, strict=True):
            assert np.array_equal(one.deformed, other.deformed)


def test_shapes_that_came_since_are_explained_and_the_others_keep_theirs(family):
    shapes, groups, truth, names, *_ = family
    kept = [0, 1, 3, 4]
    few = Groups(groups.names, groups.group[kept], np.array([0, 3]), groups.embedding[kept])
    painted, rng = {0: truth[0], 3: truth[4]}, np.random.default_rng(0)
    before = list(fit_templates([shapes[t] for t in kept], few, painted, names, rounds=6, rng=rng))[-1]
    start = gathered(before, [shapes[t].name for t in kept], of_names(shapes))
    labels = {0: truth[0], 4: truth[4]}
    assert corrected_shapes(start, shapes, labels) == (2, 5) and not why_not_warm(start, shapes, groups, labels, names)
    told = []
    states = []
    for step in refit_templates(start, shapes, groups, labels, names, rng=np.random.default_rng(0), within=True):
        (states if hasattr(step, "templates") else told).append(step)
    assert (told[0].round, told[0].shape, told[0].of_shapes) == (before.round, 1, 2)
    assert states[-1].round == before.round + WARM_ROUNDS
    right = share_of_all(family, states[-1])
    assert min(right[2], right[5]) > 0.75, "the new ones"
    for i, t in enumerate(kept):
        moved = np.linalg.norm(states[-1].beliefs[t].deformed - before.beliefs[i].deformed, axis=1)
        assert np.median(moved) < 0.02
