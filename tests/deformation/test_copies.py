"""More copies of a part than the exemplar has, at other places than there: recognised by their looks, and told so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.families import generate_one
from shapeforge.collection.families.copies import with_copy, without_components
from shapeforge.collection.groups import Groups
from shapeforge.collection.iterate import last
from shapeforge.deformation.apply import fit_candidates
from shapeforge.deformation.copies import find_copies
from shapeforge.deformation.exemplars import AS_GOOD, as_good, blend, weighted, with_copies
from shapeforge.deformation.existence import without
from shapeforge.deformation.faces import Explanations, explanations, label_faces, template_probabilities
from shapeforge.deformation.fit import fit_templates
from shapeforge.deformation.templates import template_from_exemplar
from shapeforge.store_arrays import read_record, write_record
from tests.generated import prepared

N_POINTS = 1500


def fitted(exemplar, others):
    """The last state of a fit with one painted exemplar, and the shapes."""
    shapes = prepared([exemplar, *others], N_POINTS)
    count = len(shapes)
    groups = Groups(("a",), np.zeros(count, int), np.array([0]), np.zeros((count, 2)))
    painted = {0: exemplar.faces.astype(np.int32)}
    states = fit_templates(shapes, groups, painted, exemplar.part_names, rng=np.random.default_rng(0))
    return last(states), shapes


def component_of_face(made) -> np.ndarray:
    names = np.empty(made.mesh.n_faces, object)
    names[made.mesh.face_of_triangle] = [made.component_names[int(c)] for c in made.address[:, 0, 0]]
    return names


def right_share(made, faces: np.ndarray, component: str) -> float:
    """Share of a component's area with the true label."""
    mine = component_of_face(made) == component
    area = made.mesh.face_areas[mine]
    return float(area[faces[mine] == made.faces[mine]].sum() / area.sum())


def jets(outer: bool, count: int):
    """Airliners with engines below the wings; ``outer``: with four of them."""
    found = []
    for index in range(400):
        made = generate_one("airplanes", index, seed=0, broken=0.0, classes=("airliner",))
        hang = "engine_front_left" in made.landmarks and made.landmarks["engine_front_left"][2] > 0
        if hang and ("outer engine left" in made.components) == outer:
            found.append(made)
        if len(found) == count:
            break
    return found


@pytest.fixture(scope="module")
def two_and_four():
    (exemplar, alike), four = jets(False, 2), jets(True, 2)
    return (exemplar, [*four, alike]), *fitted(exemplar, [*four, alike])


def test_engines_three_and_four_are_engines(two_and_four):
    (_, made), state, shapes = two_and_four
    engine = made[0].part_names.index("engine")
    for t in (1, 2):
        beliefs = state.beliefs[t]
        faces = label_faces(shapes[t], beliefs, explained=explanations(state, t))[0]
        for name in ("engine left", "engine right", "outer engine left", "outer engine right"):
            assert right_share(made[t - 1], faces, name) > 0.8, (t, name)
        on_copy = np.flatnonzero(beliefs.copies == engine)
        assert len(on_copy) and (beliefs.segmentation[on_copy].argmax(axis=1) == engine).all()
        # without them the outer engines are taken for the wing they hang under
        bare = tuple(
            replace(one, beliefs=replace(one.beliefs, copies=np.zeros(0, np.int32))) for one in state.candidates[t]
        )
        without = label_faces(shapes[t], blend(bare), explained=explanations(state, t))[0]
        assert right_share(made[t - 1], without, "outer engine left") < 0.5


def test_what_the_exemplar_explains_has_no_copies(two_and_four):
    """The exemplar itself, and any shape whose labels are right already; and what is called a copy is one."""
    (_, made), state, shapes = two_and_four
    assert len(state.beliefs[0].copies) == 0
    for t in (1, 2, 3):
        true = made[t - 1].faces[shapes[t].face_of_point].astype(np.int64)
        assert find_copies(shapes[t], state.templates, state.beliefs[t], true) == ()
        copies = state.beliefs[t].copies
        assert len(copies) in (0, len(true)) and (copies[copies >= 0] == true[: len(copies)][copies >= 0]).all()


def test_painted_pieces_stay(two_and_four):
    (_, made), state, shapes = two_and_four
    beliefs, wing = state.beliefs[1], made[0].part_names.index("wing")
    copies = np.flatnonzero(beliefs.copies >= 0)
    labels = beliefs.segmentation.argmax(axis=1)
    labels[copies] = wing
    again = find_copies(shapes[1], state.templates, beliefs, labels)
    assert sorted(np.concatenate([one.rows for one in again]).tolist()) == copies.tolist()
    evidence = beliefs.evidence.copy()
    evidence[again[0].rows[0]] = wing
    kept = find_copies(shapes[1], state.templates, replace(beliefs, evidence=evidence), labels)
    assert len(kept) == len(again) - 1 and again[0].rows[0] not in np.concatenate([one.rows for one in kept])


def test_new_shapes_have_copies_too_and_they_are_stored(two_and_four, tmp_path):
    (_, made), state, shapes = two_and_four
    candidates = fit_candidates(shapes[1], state.templates, state.covariances)
    explained = Explanations(candidates, state.templates, state.covariances.unary)
    faces = label_faces(shapes[1], blend(candidates), explained=explained)[0]
    assert right_share(made[0], faces, "outer engine left") > 0.8
    write_record(tmp_path / "fit.zarr.zip", state)
    read = read_record(tmp_path / "fit.zarr.zip")[0]
    for before, after in zip(state.beliefs, read.beliefs, strict=True):
        np.testing.assert_array_equal(before.copies, after.copies)


def grown_together(template):
    """The template as a family's may be put together: what touches is one component, here all engines and pylons."""
    engine = template.label == template.part_names.index("engine")
    return replace(template, component=np.where(engine, 0, template.component).astype(np.int32), source="")


def with_family(state, t: int, behind: float):
    """Templates and candidates of shape t, with the same as the family's own; the exemplar is ``behind`` (nats)."""
    return (state.templates[0], grown_together(state.templates[0])), twice(state, t, behind)


def twice(state, t: int, behind: float):
    """Candidates of shape t: the exemplar's, and the same as the family's own, by the second template."""
    (one,) = state.candidates[t]
    bare = replace(one, beliefs=replace(one.beliefs, copies=np.zeros(0, np.int32)))
    family = replace(bare, beliefs=replace(bare.beliefs, template=1), misfit=one.misfit - behind, family=True)
    return weighted([bare, family])


def test_pieces_look_like_components_of_exemplars_and_not_of_the_family(two_and_four):
    _, state, shapes = two_and_four
    for t in (1, 2):
        known = np.flatnonzero(state.beliefs[t].copies >= 0)
        templates, candidates = with_family(state, t, behind=0.5 * AS_GOOD)
        blended = blend(candidates)
        assert len(known) and blended.template == 1
        assert find_copies(shapes[t], templates, blended, blended.segmentation.argmax(axis=1)) == ()
        np.testing.assert_array_equal(
            np.flatnonzero(with_copies(shapes[t], templates, candidates)[0].beliefs.copies >= 0), known
        )


def test_what_the_family_knows_comes_before_what_exemplars_do(two_and_four):
    """Pods are engines by the family, though an exemplar has such things at its fuselage."""
    (_, made), state, shapes = two_and_four
    engine, fuselage = (made[0].part_names.index(name) for name in ("engine", "fuselage"))
    label = state.templates[0].label
    otherwise = replace(state.templates[0], label=np.where(label == engine, fuselage, label).astype(label.dtype))
    templates, candidates = (otherwise, state.templates[0]), twice(state, 1, 0.5 * AS_GOOD)
    blended = blend(candidates)
    found = find_copies(shapes[1], templates, blended, blended.segmentation.argmax(axis=1), [as_good(candidates)])
    assert fuselage in {one.part for one in found}
    copies = with_copies(shapes[1], templates, candidates)[0].beliefs.copies
    assert set(copies[copies >= 0].tolist()) == {engine}


def test_exemplars_that_do_not_explain_a_shape_are_not_compared(two_and_four):
    _, state, shapes = two_and_four
    for behind, compared in ((0.5, (0,)), (-0.5, (0,)), (1.5, ())):
        templates, candidates = with_family(state, 1, behind * AS_GOOD)
        assert as_good(candidates) == compared
        found = with_copies(shapes[1], templates, candidates)[0].beliefs.copies
        assert bool(len(found)) == bool(compared)


def test_leading_templates_without_any_part_have_no_copies_and_say_nothing_of_faces(two_and_four):
    """The family's have engines only, which the exemplar, that explains the shape better, does not believe in."""
    (_, made), state, shapes = two_and_four
    engine = np.arange(len(made[0].part_names)) == made[0].part_names.index("engine")
    templates, (best, led) = with_family(state, 1, behind=-2 * AS_GOOD)
    doubt = np.where(engine, -20.0, np.nan)
    best = replace(best, beliefs=replace(best.beliefs, active=best.beliefs.active & ~engine, misfit=doubt))
    led = replace(led, beliefs=replace(led.beliefs, active=engine))
    assert blend([best, led]).template == 1 and not blend([best, led]).active.any()
    assert with_copies(shapes[1], templates, (best, led)) == (best, led)
    empty = replace(led, beliefs=replace(led.beliefs, spare=np.ones(templates[1].n_points, bool)))
    spoken = template_probabilities(shapes[1], Explanations((best, empty), templates, state.covariances.unary))
    alone = template_probabilities(shapes[1], Explanations((best,), templates, state.covariances.unary))
    np.testing.assert_allclose(spoken, alone, atol=1e-6)


def test_a_piece_that_its_own_part_has_in_some_exemplar_is_no_copy(two_and_four):
    """The rail of one chair is no arm of another's base, if a third has such a rail."""
    (_, made), state, shapes = two_and_four
    beliefs, wing = state.beliefs[1], made[0].part_names.index("wing")
    labels = beliefs.segmentation.argmax(axis=1)
    labels[beliefs.copies >= 0] = wing
    names = component_of_face(made[1])
    pods = np.isin(names, ["outer engine left", "outer engine right", "outer pylon left", "outer pylon right"])
    otherwise = template_from_exemplar(shapes[2], np.where(pods, wing, made[1].faces), made[1].part_names)
    templates = (state.templates[0], otherwise)
    assert find_copies(shapes[1], templates, beliefs, labels, [(0,)])
    assert find_copies(shapes[1], templates, beliefs, labels, [(0, 1)]) == ()


def test_a_thin_component_may_be_thicker_in_the_template(two_and_four):
    """The tailplane is found though that of the template rises three times as high: hardly a gap tells them apart."""
    (_, made), state, shapes = two_and_four
    part, template = made[0].part_names.index("tailplane"), state.templates[0]
    mine, points = template.label == part, template.points.copy()
    middle = points[mine, 1].mean()
    points[mine, 1] = middle + (points[mine, 1] - middle) * 0.056 / np.ptp(points[mine, 1])
    for t in (1, 2):
        beliefs, true = without(state.beliefs[t], part), made[t - 1].faces[shapes[t].face_of_point]
        label = beliefs.segmentation.argmax(axis=1)
        assert np.ptp(shapes[t].points[true == part, 1]) < 0.056 / 3 and (label != part).all()
        found = find_copies(shapes[t], (template.moved(points),), beliefs, label)
        rows = np.concatenate([one.rows for one in found if one.part == part])
        assert (true[rows] == part).all() and len(rows) > 0.9 * (true == part).sum()


def test_a_fifth_leg_is_a_leg():
    made = [generate_one("chairs", i, seed=11, broken=0.0, classes=("side",)) for i in range(3)]
    exemplar, five = made[0], []
    for one in made[1:]:
        tip = one.landmarks["leg_tip_front_left"]
        five.append(with_copy(one, ["leg front left"], [-tip[0], 0, 0]))
    state, shapes = fitted(exemplar, five)
    for t, one in enumerate(five, 1):
        faces = label_faces(shapes[t], state.beliefs[t], explained=explanations(state, t))[0]
        for name in one.components:
            if name.startswith("leg"):
                assert right_share(one, faces, name) > 0.8, (t, name)


def test_legs_that_rails_tie_together_are_components_each():
    for index in range(40):
        made = generate_one("chairs", index, seed=11, broken=0.0, classes=("side",))
        if "stretcher left" in made.components:
            break
    (shape,), leg = prepared([made], N_POINTS), made.part_names.index("leg")
    templates = template_from_exemplar(shape, made.faces, made.part_names)
    mine = np.flatnonzero(templates.label == leg)
    true = component_of_face(made)[shape.face_of_point]
    owner = dict(zip(map(tuple, shape.points.tolist()), true.tolist(), strict=True))
    names = np.array([owner[tuple(point)] for point in templates.points[mine].tolist()])
    for number in np.unique(templates.component[mine]):
        assert len(set(names[templates.component[mine] == number])) == 1
    for name in ("leg front left", "leg rear right", "stretcher left"):
        assert len(set(templates.component[mine][names == name])) == 1


def test_components_come_and_go():
    made = generate_one("chairs", 0, seed=11, broken=0.0, classes=("side",))
    more = with_copy(made, ["leg front left"], [0.1, 0.0, 0.0])
    assert set(more.components) - set(made.components) == {"leg front left again"}
    here, there = (component_of_face(more) == name for name in ("leg front left", "leg front left again"))
    assert here.sum() == there.sum() and (more.faces[there] == more.part_names.index("leg")).all()
    np.testing.assert_allclose(more.mesh.face_centres[there], more.mesh.face_centres[here] + [0.1, 0, 0], atol=1e-9)
    less = without_components(more, ["leg front left again", "back"])
    assert set(less.components) == set(made.components) - {"back"} and len(less.faces) == less.mesh.n_faces
    with pytest.raises(ValueError, match="got wheel"):
        with_copy(made, ["wheel"], [0, 0, 0])
