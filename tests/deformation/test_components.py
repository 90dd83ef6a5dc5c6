"""Components of a part that a shape lacks: told from those that look different, and of no account from then on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.families import generate_one
from shapeforge.collection.families.copies import with_copy
from shapeforge.deformation.apply import fit_candidates
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.components import (
    count_parts,
    least_likely,
    mostly_spare,
    spare_in_place,
    without_component,
)
from shapeforge.deformation.exemplars import blend
from shapeforge.deformation.faces import explanations, label_faces
from shapeforge.deformation.hierarchy import Hierarchy, Link, corresponding_points, deformed_family
from shapeforge.deformation.templates import (
    Components,
    PartTemplates,
    template_from_exemplar,
    template_from_points,
)
from shapeforge.deformation.updates import (
    candidates_without,
    find_candidates,
    make_problem,
    update_correspondences,
)
from shapeforge.store_arrays import read_record, write_record
from tests.deformation.test_copies import N_POINTS, component_of_face, fitted, jets, right_share
from tests.generated import prepared

INNER, OUTER = ("engine left", "engine right"), ("outer engine left", "outer engine right")


@pytest.fixture(scope="module")
def four_and_two():
    """An airliner with four engines, which explains two others with two and one with four."""
    exemplar, four = jets(True, 2)
    made = [exemplar, *jets(False, 2), four]
    return made, *fitted(exemplar, made[1:])


def points_of(made, shape, templates, name: str) -> np.ndarray:
    """Template points (K,) bool of an exemplar's component, by the samples that they were."""
    names = component_of_face(made)[shape.face_of_point]
    owner = dict(zip(map(tuple, shape.points.tolist()), names.tolist(), strict=True))
    first = template_from_exemplar(shape, made.faces, made.part_names)
    assert first.n_points == templates.n_points
    return np.array([owner[tuple(point)] == name for point in first.points.tolist()])


def test_outer_engines_are_spare_on_a_shape_with_two(four_and_two):
    made, state, shapes = four_and_two
    templates, hierarchy = state.templates[0], state.hierarchy()
    on = {name: points_of(made[0], shapes[0], templates, name) for name in (*INNER, *OUTER, "wing left")}
    for t in (1, 2):
        positions, exists = corresponding_points(shapes[t], state.beliefs[t], hierarchy)
        np.testing.assert_array_equal(np.isfinite(positions).all(axis=1), exists)
        for name, mine in on.items():
            assert exists[mine].all() if name not in OUTER else not exists[mine].any(), (t, name)
        # those that stay are on the shape's engines
        names = component_of_face(made[t])
        centres = made[t].mesh.face_centres
        for name in INNER:
            mine = shapes[t].frame.to_input(positions[on[name]])
            away = np.linalg.norm(mine[:, None] - centres[names == name][None], axis=2).min(axis=1)
            size = np.linalg.norm(np.ptp(centres[names == name], axis=0))
            assert np.mean(away < 0.2 * size) > 0.9, (t, name)


def test_two_engines_against_an_exemplar_with_four(four_and_two):
    """Nothing else is taken for an engine, and both engines are."""
    made, state, shapes = four_and_two
    engine = made[0].part_names.index("engine")
    for t in (1, 2):
        faces = label_faces(shapes[t], state.beliefs[t], explained=explanations(state, t))[0]
        area = made[t].mesh.face_areas
        assert all(right_share(made[t], faces, name) > 0.8 for name in INNER), t
        assert area[(faces == engine) & (made[t].faces != engine)].sum() < 0.01 * area.sum(), t


def test_shapes_with_as_many_components_lose_none(four_and_two):
    _, state, _ = four_and_two
    assert all(not len(state.candidates[t][0].beliefs.spare) for t in (0, 3))


def test_new_shapes_are_asked_too_and_it_is_stored(four_and_two, tmp_path):
    _, state, shapes = four_and_two
    candidates = fit_candidates(shapes[1], state.templates, state.covariances)
    np.testing.assert_array_equal(blend(candidates).spare, state.beliefs[1].spare)
    write_record(tmp_path / "fit.zarr.zip", state)
    read = read_record(tmp_path / "fit.zarr.zip")[0]
    for before, after in zip(state.beliefs, read.beliefs, strict=True):
        np.testing.assert_array_equal(before.spare, after.spare)


def test_spare_points_take_no_samples(four_and_two):
    _, state, shapes = four_and_two
    templates, beliefs = state.templates[0], state.beliefs[1]
    problem, sigma = make_problem(shapes[1]), state.covariances
    assert beliefs.spare.any()
    found = find_candidates(problem, templates, beliefs, sigma.descriptor)
    assert not beliefs.spare[found.template_index].any()
    whole = find_candidates(problem, templates, replace(beliefs, spare=np.zeros(0, bool)), sigma.descriptor)
    assert beliefs.spare[whole.template_index].any()
    left = candidates_without(problem, templates, whole, beliefs, sigma.descriptor)
    assert not beliefs.spare[left.template_index].any()
    mass = update_correspondences(problem, templates, found, beliefs, sigma.unary).mass
    assert (mass[beliefs.spare] == 0).all() and mass.sum() == pytest.approx(shapes[1].n_points)


def test_spare_points_lie_where_their_part_would_have_them(four_and_two):
    _, state, _ = four_and_two
    templates, beliefs = state.templates[0], state.beliefs[1]
    thrown = replace(beliefs, deformed=beliefs.deformed + 3.0 * beliefs.spare[:, None])
    back = spare_in_place(templates, thrown)
    label = templates.label[beliefs.spare]
    wanted = np.einsum("kij,kj->ki", beliefs.maps[label], templates.points[beliefs.spare]) + beliefs.offsets[label]
    np.testing.assert_allclose(back.deformed[beliefs.spare], wanted)
    np.testing.assert_array_equal(back.deformed[~beliefs.spare], beliefs.deformed[~beliefs.spare])


def test_parts_are_counted(four_and_two):
    made, state, shapes = four_and_two
    top, engine = state.hierarchy().top, made[0].part_names.index("engine")
    counted = []
    for t in range(4):
        exists = deformed_family(state.beliefs[t], state.hierarchy())[2]
        counted.append(count_parts(shapes[t], top, exists, state.beliefs[t]))
    all_of = len(np.unique(top.components.number[top.label == engine]))
    assert [one.components[engine] for one in counted][::3] == [all_of, all_of]
    assert all(one.components[engine] == all_of - 2 for one in counted[1:3])
    fuselage = made[0].part_names.index("fuselage")
    assert all(one.components[fuselage] == 1 and not one.copies.any() for one in counted)


def test_copies_are_counted_by_pieces():
    made = generate_one("chairs", 0, seed=11, broken=0.0, classes=("side",))
    more = with_copy(made, ["leg front left"], [0.1, 0.0, 0.0])
    (shape,), leg = prepared([more], N_POINTS), made.part_names.index("leg")
    templates = template_from_exemplar(shape, more.faces, more.part_names)
    names = component_of_face(more)[shape.face_of_point]
    copies = np.where(np.isin(names, ["leg front left again", "leg front right"]), leg, -1).astype(np.int32)
    exists = templates.label == leg
    beliefs = _beliefs(templates, copies=copies)
    counted = count_parts(shape, templates, exists, beliefs)
    assert counted.copies.tolist() == [2 * (part == leg) for part in range(templates.n_parts)]
    legs = len({name for name in more.components if name.startswith("leg")})
    assert counted.components[leg] >= legs and counted.components.sum() == counted.components[leg]
    none = count_parts(shape, templates, exists, replace(beliefs, copies=np.zeros(0, np.int32)))
    assert not none.copies.any()


def _beliefs(templates: PartTemplates, **more: np.ndarray) -> Beliefs:
    parts = templates.n_parts
    return Beliefs(
        0, templates.points.copy(), np.full_like(templates.points, 1e-4), np.tile(np.eye(3), (parts, 1, 1)),
        np.zeros((parts, 3)), np.full((1, parts), 1 / parts), np.ones(parts, bool), np.full(1, -1, np.int32),
        np.full(parts, np.nan), **more,
    )  # fmt: skip


def test_a_fifth_leg_of_the_exemplar_is_spare_and_no_leg_of_another_build_is():
    """Thicker, longer and splayed legs merely look different; the leg that the others lack is not there."""
    made = [generate_one("chairs", i, seed=11, broken=0.0, classes=("side", "armchair")) for i in range(5)]
    tip = made[0].landmarks["leg_tip_front_left"]
    exemplar = with_copy(made[0], ["leg front left"], [-tip[0], 0, 0])
    state, shapes = fitted(exemplar, made[1:])
    extra = points_of(exemplar, shapes[0], state.templates[0], "leg front left again")
    legs = [name for name in made[0].components if name.startswith("leg")]
    assert extra.any() and len(legs) == 4
    for t in range(1, 5):
        exists = deformed_family(state.beliefs[t], state.hierarchy())[2]
        assert not exists[extra].any(), t
        for name in legs:
            assert exists[points_of(exemplar, shapes[0], state.templates[0], name)].all(), (t, name)


# -- by hand -----------------------------------------------------------------------------------------------------------


def rods(rng, places, counts, length: float = 0.4) -> np.ndarray:
    """Points on upright rods: (x, z) of each, and how many points."""
    return np.concatenate(
        [
            np.column_stack([np.full(n, x), rng.uniform(0, length, n), np.full(n, z)])
            + 0.01 * rng.normal(size=(n, 3)) * [1, 0, 1]
            for (x, z), n in zip(places, counts, strict=True)
        ]
    )


@pytest.fixture
def table() -> PartTemplates:
    """A plate, and three rods, a crumb of five points beside the second and a bar that is no copy of the rods."""
    rng = np.random.default_rng(3)
    plate = rng.uniform(-0.5, 0.5, (200, 3)) * [1, 0.02, 1] + [0, 0.45, 0]
    legs = rods(rng, [(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4)], [40, 40, 30])
    crumb = [0.5, 0.1, -0.4] + 0.005 * rng.normal(size=(5, 3))
    bar = np.column_stack([rng.uniform(-0.3, 0.3, 30), np.full(30, 0.05), np.zeros(30)]) + 0.003 * rng.normal(
        size=(30, 3)
    )
    points = np.concatenate([plate, legs, crumb, bar])
    label = np.repeat([0, 1], [200, len(points) - 200])
    surface = np.repeat([0, 1, 2, 3, 4, 5], [200, 40, 40, 30, 5, 30])
    order = rng.permutation(len(points))
    return template_from_points(
        points[order], np.ones_like(points), np.zeros((len(points), 10)), label[order], ("top", "leg"),
        surface=surface[order],
    )  # fmt: skip


def test_components_of_parts_that_have_several(table):
    known = table.components
    assert known.part.tolist() == [1, 1, 1, 1] and (known.number[table.label == 0] == -1).all()
    sizes = np.bincount(known.number[known.number >= 0])
    assert sorted(sizes.tolist()) == [30, 30, 40, 45]  # the crumb went with the rod beside it
    beside = table.points[known.number == sizes.argmax()]
    assert np.allclose(beside[:, [0, 2]].mean(axis=0), [0.41, -0.4], atol=0.02)
    bar = int(known.number[(table.label == 1) & (np.abs(table.points[:, 2]) < 0.1)][0])
    assert not known.alike[bar].any() and known.alike.sum() == 6 and not known.alike.diagonal().any()
    np.testing.assert_array_equal(known.alike, known.alike.T)
    middles = np.array([table.points[known.number == one].mean(axis=0) for one in range(4)])
    for one, (x, _, z) in enumerate(middles):  # the first two rods face each other, the third one has no mirror image
        other = middles[known.twin[one]]
        pair = np.isclose(z, -0.4, atol=0.02)
        assert (known.twin[one] != one) == pair and (not pair or other[0] * x < 0)
    # a template that moves keeps them, though its extents change
    moved = table.moved(table.points * [1, 3, 1])
    assert moved.components is known


def test_what_is_spare():
    """Components 0 and 1 are copies of each other; 2, of the same part, is not; 3 is another part's."""
    alike = np.zeros((4, 4), bool)
    alike[0, 1] = alike[1, 0] = True
    known = Components(np.zeros(0, np.int32), np.array([0, 0, 0, 1], np.int32), alike, np.arange(4, dtype=np.int32))
    low, gone = -5.0, -np.inf
    for odds, wanted in (
        ([low, 3.0, 2.0, 1.0], 0),
        ([-1.9, 3.0, 2.0, 1.0], None),  # in doubt it stays
        ([low, -0.1, 2.0, 1.0], None),  # its copy is not sure either: the part looks different
        ([3.0, 3.0, gone, 1.0], None),  # unlike the others, it may be there in another form
        ([gone, 3.0, 2.0, 1.0], 0),
        ([low, -6.0, 2.0, 1.0], None),
        ([gone, gone, gone, 3.0], None),  # one of the part must be there
        ([low, 3.0, gone, 1.0], 0),
        ([np.nan, 3.0, np.nan, low], None),
        ([low, 3.0, np.nan, gone], 0),
    ):
        assert least_likely(known, np.array(odds)) == wanted, odds


def test_left_and_right_go_together():
    """Four copies, 0 and 1 each other's mirror image, 2 and 3 too."""
    alike, twin = ~np.eye(4, dtype=bool), np.array([1, 0, 3, 2], np.int32)
    known = Components(np.zeros(0, np.int32), np.zeros(4, np.int32), alike, twin)
    for odds, wanted in (
        ([-4.0, -3.0, 2.0, 2.0], 0),
        ([np.nan, -3.0, 2.0, 2.0], 1),  # the other one has gone before
        ([-4.0, 1.0, 2.0, 2.0], None),
        ([-4.0, 1.0, -3.0, -2.5], 2),
    ):
        assert least_likely(known, np.array(odds)) == wanted, odds


def test_components_go_one_by_one_and_whole(table):
    known, beliefs = table.components, _beliefs(table)
    assert beliefs.alive(table.label).all()
    for component in (2, 0):
        beliefs = without_component(beliefs, known, component)
    np.testing.assert_array_equal(beliefs.alive(table.label), ~np.isin(known.number, [0, 2]))
    off = replace(beliefs, active=np.array([False, True]))
    np.testing.assert_array_equal(off.alive(table.label), ~np.isin(known.number, [0, 2]) & (table.label == 1))


def test_most_of_a_component_has_to_be_missing(table):
    known = table.components
    first, second = (np.flatnonzero(known.number == one) for one in (0, 1))
    missing = np.zeros(table.n_points, bool)
    missing[table.label == 0] = True  # a part of one component is never spare
    missing[first[: len(first) // 2]] = True
    assert len(mostly_spare(table, missing)) == 0
    missing[second[: len(second) // 2 + 1]] = True
    np.testing.assert_array_equal(np.flatnonzero(mostly_spare(table, missing)), second)


def test_links_lead_to_no_spare_component(table):
    """Also of templates that lend a part; a component goes whole, wherever single points of it are linked to."""
    known, count = table.components, table.n_points
    index = np.tile(np.arange(count)[:, None], (1, 3)).astype(np.int32)
    weight = np.tile([1.0, 0.0, 0.0], (count, 1))
    astray = np.flatnonzero(known.number == 1)[:2]
    index[astray, 1] = np.flatnonzero(known.number == 0)[0]
    weight[astray] = [0.4, 0.6, 0.0]
    link = Link(index, weight, np.ones(count, bool))
    hierarchy = Hierarchy(table, (link, link))
    beliefs = without_component(_beliefs(table), known, 0)
    wanted = known.number != 0
    np.testing.assert_array_equal(deformed_family(beliefs, hierarchy)[2], wanted)
    lender = replace(beliefs, template=1)
    lacking = replace(_beliefs(table), active=np.array([True, False]), lent=((1, lender),))
    np.testing.assert_array_equal(deformed_family(lacking, hierarchy)[2], wanted)
