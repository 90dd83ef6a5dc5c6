"""Parts that a shape lacks: their templates settle on something else, and lie there pressed flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.align import Alignment
from shapeforge.collection.families import generate, generate_one
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.existence import FLAT, SHARPNESS, flatness, part_prevalence
from shapeforge.deformation.factors import initial_covariances
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
