"""Parts that a shape lacks: their templates settle on something else, and lie there pressed flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from shapeforge.collection.align import Alignment
from shapeforge.collection.families import generate, generate_one
from shapeforge.collection.groups import Groups
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.deformation.apply import fit_candidates
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.exemplars import blend
from shapeforge.deformation.existence import FLAT, SHARPNESS, flatness, part_prevalence, usual_flatness
from shapeforge.deformation.factors import initial_covariances
from shapeforge.deformation.fit import fit_templates
from shapeforge.deformation.shape_fit import fit_shape
from shapeforge.deformation.starts import affine_beliefs
from shapeforge.deformation.templates import PartTemplates, template_from_exemplar, template_from_points
from shapeforge.deformation.updates import make_problem
from tests.generated import prepared

BOX, SHEET = 0, 1
POSE = Alignment(np.array([[0.0, -3.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.5]]), np.array([0.1, 0.0, 0.2]), 0.0)
"""A turn by a right angle with a stretch along one axis and a squeeze along another: a bench beside a chair."""


@pytest.fixture(scope="module")
def box_and_sheet() -> tuple[PartTemplates, Beliefs]:
    """A box and a sheet of a thousandth of its width, under an affine map of both."""
    rng = np.random.default_rng(0)
    box = rng.uniform(-0.2, 0.2, (200, 3))
    sheet = rng.uniform(-0.2, 0.2, (200, 3)) * (1.0, 0.001, 1.0) + (0.0, 0.4, 0.0)
    points, label = np.concatenate([box, sheet]), np.repeat([BOX, SHEET], 200).astype(np.int32)
    normals = np.tile([0.0, 1.0, 0.0], (400, 1))
    template = template_from_points(points, normals, np.zeros((400, 10)), label, ("box", "sheet"))
    shape = prepared(generate("chairs", 1, seed=0, broken=0.0), 100)[0]
    return template, affine_beliefs(shape, make_problem(shape, None), template, 0, POSE)


def pressed(beliefs: Beliefs, part: int, by: np.ndarray) -> Beliefs:
    """The beliefs with one part pressed by a diagonal map, before all else moves it."""
    maps = beliefs.maps.copy()
    maps[part] = maps[part] @ np.diag(by)
    return replace(beliefs, maps=maps)


def test_no_part_is_flat_under_one_map_of_the_whole(box_and_sheet):
    assert np.allclose(flatness(*box_and_sheet), 0.0)


@pytest.mark.parametrize("axis", range(3))
def test_a_part_is_as_flat_as_its_own_map_presses_it_beside_the_others(box_and_sheet, axis):
    template, beliefs = box_and_sheet
    by = np.where(np.arange(3) == axis, 0.1, 1.0)
    found = flatness(template, pressed(beliefs, BOX, by))
    assert found[BOX] == pytest.approx(np.log(FLAT / 0.1), abs=0.15) and found[SHEET] == 0.0
    less = flatness(template, pressed(beliefs, BOX, np.where(np.arange(3) == axis, 0.5, 1.0)))
    assert (less == 0.0).all()


def test_what_is_thin_can_lose_its_length_only(box_and_sheet):
    template, beliefs = box_and_sheet
    assert flatness(template, pressed(beliefs, SHEET, np.array([1.0, 1e-3, 1.0])))[SHEET] == 0.0
    assert flatness(template, pressed(beliefs, SHEET, np.array([0.05, 1.0, 1.0])))[SHEET] > 1.0


def test_a_part_that_is_pressed_flat_is_doubted_and_the_others_are_not():
    """The column of a swivel chair, explained by its own template, and pressed as on a rail beneath the seat."""
    made = generate_one("chairs", 1, seed=2, broken=0.0, classes=("swivel",))
    shape = prepared([made], 700)[0]
    names, templates = made.part_names, template_from_exemplar(shape, made.faces, made.part_names)
    problem = make_problem(shape, None)
    whole = Alignment(np.eye(3), np.zeros(3), 0.0)
    beliefs = affine_beliefs(shape, problem, templates, 0, whole)
    sharp = replace(initial_covariances(), unary=np.full(3, (0.8 * SHARPNESS) ** 2))
    prevalence = part_prevalence([templates])
    there = fit_shape(problem, templates, beliefs, sharp, prevalence)[0]
    assert (there.active == templates.has_part()).all() and (there.misfit[there.active] > 0.0).all()
    column = names.index("column")
    flat = fit_shape(problem, templates, pressed(beliefs, column, np.array([1.0, 0.02, 1.0])), sharp, prevalence)[0]
    others = np.flatnonzero(there.active & (np.arange(len(names)) != column))
    assert flat.misfit[column] < there.misfit[column] - 4.0
    assert np.abs(flat.misfit[others] - there.misfit[others]).max() < 2.0


def test_the_prior_odds_of_a_part_count_in_full():
    made = generate_one("chairs", 1, seed=2, broken=0.0, classes=("swivel",))
    shape = prepared([made], 700)[0]
    templates = template_from_exemplar(shape, made.faces, made.part_names)
    problem = make_problem(shape, None)
    beliefs = affine_beliefs(shape, problem, templates, 0, Alignment(np.eye(3), np.zeros(3), 0.0))
    sharp = replace(initial_covariances(), unary=np.full(3, (0.8 * SHARPNESS) ** 2))
    rare, usual = (
        fit_shape(problem, templates, beliefs, sharp, np.full(templates.n_parts, share))[0].misfit[templates.has_part()]
        for share in (0.5, 0.875)
    )
    assert np.allclose(usual - rare, np.log(7.0))


# -- how flat is usual -----------------------------------------------------------------------------------------------


def test_what_most_shapes_press_flat_is_usual_and_what_some_do_is_not():
    def usual(*values: float) -> float:
        return float(usual_flatness([np.array([value]) for value in values])[0])

    assert 1.3 < usual(1.3, 1.4, 1.4, 1.5, 1.6, 1.7, 2.0) < 1.6
    assert usual(1.3, 1.4, 1.4, 0.0, 0.0, 0.0, 0.0) == 0.0
    assert usual(2.0) == usual(2.0, 2.0) == 0.0, "one or two shapes make no habit"
    assert usual(1.3, 1.4, 1.4, 1.5, 1.6, 1.7, 2.0, *[np.nan] * 20) == usual(1.3, 1.4, 1.4, 1.5, 1.6, 1.7, 2.0)
    assert usual(np.nan) == 0.0, "nobody has the part"


TOP, LEG, SHELF = range(3)


def table(number: int, width: float, shelf: str) -> tuple[Shape, np.ndarray]:
    """A table with a ``cabinet`` or a ``board`` for a shelf, or ``none``, and the part of each of its faces."""
    boxes = [((width, 0.04, 0.6), (0, 0.7, 0), TOP)]
    boxes += [((0.05, 0.7, 0.05), (x * (width / 2 - 0.05), 0.35, z), LEG) for x in (-1, 1) for z in (-0.25, 0.25)]
    inside = width - 0.25
    if shelf == "cabinet":
        boxes += [((inside, 0.03, 0.45), (0, y, 0), SHELF) for y in (0.12, 0.34, 0.56)]
        boxes += [((0.03, 0.44, 0.45), (x * inside / 2, 0.34, 0), SHELF) for x in (-1, 1)]
    elif shelf == "board":
        boxes += [((inside + 0.13, 0.03, 0.48), (0, 0.15 + 0.03 * number, 0), SHELF)]
    made = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for size, at, _ in boxes]
    whole = trimesh.util.concatenate(made)
    faces = np.repeat([part for *_, part in boxes], [len(one.faces) for one in made]).astype(np.int32)
    mesh = Mesh(np.asarray(whole.vertices), np.asarray(whole.faces), np.arange(len(faces)), len(faces))
    rng = np.random.default_rng(number)
    return prepare_shape(f"{number}_{shelf}", mesh, n_points=600, up="keep", rng=rng), faces


def test_boards_are_shelves_though_the_only_exemplar_with_a_shelf_has_a_cabinet():
    kinds = ("cabinet", "none", "board", "board", "board", "board", "board", "none", "none")
    widths = (1.15, 1.0, 0.9, 1.1, 1.3, 1.0, 1.2, 0.95, 1.25)
    tables = [table(t, width, kind) for t, (width, kind) in enumerate(zip(widths, kinds, strict=True))]
    new, _ = tables.pop(6)
    shapes = [shape for shape, _ in tables]
    groups = Groups(("a", "b"), np.array([0] + [1] * 7), np.array([0, 1]), np.zeros((8, 2)))
    painted = {t: tables[t][1] for t in (0, 1)}
    rng = np.random.default_rng(0)
    states = list(fit_templates(shapes, groups, painted, ("top", "leg", "shelf"), rng=rng))
    state = states[-1]
    for shape, beliefs in zip(shapes, state.beliefs, strict=True):
        assert beliefs.active[SHELF] == (not shape.name.endswith("none")), shape.name
    assert state.templates[-1].flatness[SHELF] > 0.3 and (state.templates[-1].flatness[[TOP, LEG]] == 0.0).all()
    asked = [one.templates[-1].flatness[SHELF] for one in states if np.sqrt(one.covariances.unary.mean()) <= SHARPNESS]
    assert len(asked) > 3 and np.ptp(asked[1:]) == 0.0, "who was found to have none does not change what is usual"
    found = fit_candidates(
        new, state.templates, state.covariances, state.hierarchy(), annealed_from=state.annealed_from
    )  # fmt: skip
    assert blend(found).active[SHELF], "the templates remember it for new shapes"
