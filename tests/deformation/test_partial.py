"""Starts without some parts: stools beside chairs with backs."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.align import affine_align
from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups
from shapeforge.deformation.fit import fit_templates
from shapeforge.deformation.partial import partial_starts
from shapeforge.deformation.templates import template_from_exemplar, template_from_points
from tests.generated import prepared

NOTHING, EVEN = np.zeros(6, bool), np.full(6, 0.5)


@pytest.fixture(scope="module")
def family():
    """Two armchairs, two side chairs and two stools on legs: generated, prepared, the part of every face."""
    made = [
        one
        for fine_class, seed in (("armchair", 5), ("side", 5), ("stool", 7))
        for one in generate("chairs", 2, seed=seed, broken=0.0, classes=(fine_class,))
    ]
    return made, prepared(made, 1200), [np.asarray(one.faces, np.int32) for one in made]


def found_on(family, t, exemplars=(0,), kept=NOTHING, prevalence=EVEN):
    """Partial starts of these exemplars' templates on shape ``t``, and the names of their parts."""
    made, shapes, truth = family
    names = made[0].part_names
    templates = [template_from_exemplar(shapes[e], truth[e], names) for e in exemplars]
    alignments = [affine_align(template.points, shapes[t].points) for template in templates]
    starts = partial_starts(shapes[t].points, shapes[t].normals, templates, alignments, kept, prevalence)
    return starts, [{names[part] for part in np.flatnonzero(start.active)} for start in starts]


@pytest.mark.parametrize("t", [4, 5])
def test_on_a_stool_an_armchair_starts_without_back_and_arms(family, t):
    made, shapes, truth = family
    starts, parts = found_on(family, t)
    assert parts == [{"seat", "leg"}]
    seat = made[0].part_names.index("seat")
    template = template_from_exemplar(shapes[0], truth[0], made[0].part_names)
    moved = starts[0].alignment(template.points[template.label == seat])
    theirs = shapes[t].points[truth[t][shapes[t].face_of_point] == seat]
    assert abs(moved[:, 1].mean() - theirs[:, 1].mean()) < 0.05


def test_on_a_chair_without_arms_an_armchair_starts_without_them(family):
    for t in (2, 3):
        assert found_on(family, t)[1] == [{"back", "seat", "leg"}]


def test_a_shape_with_all_parts_gets_no_such_start_and_neither_does_the_exemplar(family):
    assert found_on(family, 0)[0] == found_on(family, 1)[0] == []


def test_a_template_that_fits_whole_speaks_against_others_without_parts(family):
    assert found_on(family, 3, (0,))[0]
    assert found_on(family, 3, (0, 3))[0] == []


def test_a_part_that_is_usual_is_not_left_out_for_a_nat():
    """The plate on top of a swivel chair's column, ever larger, explains the seat of a bar stool, too."""
    chair = generate("chairs", 1, seed=0, broken=0.0, classes=("swivel",))[0]
    stool = generate("chairs", 2, seed=0, broken=0.0, classes=("stool",))[1]
    names, shapes = np.array(chair.part_names), prepared([chair, stool], 1200)
    family = [chair, stool], shapes, [np.asarray(one.faces, np.int32) for one in (chair, stool)]
    usual = np.where(names == "seat", 0.8, 0.5)
    assert found_on(family, 1)[1] == [{"column", "base"}]
    assert found_on(family, 1, prevalence=usual)[1] == [{"seat", "column", "base"}]


def test_painted_parts_stay(family):
    names = family[0][0].part_names
    assert all("back" in parts for parts in found_on(family, 4, kept=np.array(names) == "back")[1])


def test_what_is_left_of_a_template_is_enough_to_lay_it_onto_a_shape(family):
    """Three points of the seat are a sixth of a template that is hardly painted, but no start by themselves."""
    made, shapes, truth = family
    seat, back = (made[0].part_names.index(part) for part in ("seat", "back"))
    label, few = truth[0][shapes[0].face_of_point], np.full(1200, -1)
    for part, count in ((seat, 3), (back, 15)):
        few[np.flatnonzero(label == part)[:count]] = part
    described = shapes[0].points, shapes[0].normals, shapes[0].descriptors
    template = template_from_points(*described, few, made[0].part_names)
    alignment = affine_align(template.points, shapes[4].points)
    starts = partial_starts(shapes[4].points, shapes[4].normals, [template], [alignment], NOTHING, EVEN)
    assert all(start.active[back] for start in starts)


def test_the_fit_labels_stools_by_the_parts_that_they_have(family):
    made, shapes, truth = family
    names, chosen = made[0].part_names, [0, 2, 4, 5]
    group = Groups(("all",), np.zeros(4, int), np.array([0]), np.zeros((4, 2)))
    states = fit_templates(
        [shapes[t] for t in chosen], group, {0: truth[0]}, names, rng=np.random.default_rng(0), rounds=5
    )
    beliefs = list(states)[-1].beliefs
    for here, t in enumerate(chosen[2:], start=2):
        said = beliefs[here].segmentation.argmax(axis=1)
        assert {names[part] for part in np.flatnonzero(beliefs[here].active)} == {"seat", "leg"}
        assert (said == truth[t][shapes[t].face_of_point]).mean() > 0.85
