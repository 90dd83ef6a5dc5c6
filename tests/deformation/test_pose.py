"""Orientation by vote: turned chairs come back, upright ones stay; and by the exemplars, during the fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shapeforge.collection.align import affine_align
from shapeforge.collection.directions import AXIS_ROTATIONS, angle_between, turning_angle
from shapeforge.collection.families import generate
from shapeforge.collection.groups import Groups
from shapeforge.collection.prepare import prepare_shape, turned
from shapeforge.collection.upright import surface_of_mesh, surface_of_shape
from shapeforge.deformation import pose as module
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.fit import fit_templates
from shapeforge.deformation.pose import (
    QUARTERS,
    agree,
    candidate_turns,
    chosen_rotations,
    posed_starts,
    settled_turn,
)
from tests.generated import prepared

UP = np.array([0.0, 1.0, 0.0])


def random_turn(rng: np.random.Generator) -> np.ndarray:
    tilt = np.radians(15 * rng.random()) * np.array([np.cos(a := 6.3 * rng.random()), 0, np.sin(a)])
    return Rotation.from_rotvec(tilt).as_matrix() @ AXIS_ROTATIONS[rng.integers(24)]


@pytest.fixture(scope="module")
def upright_turns():
    """Candidates of six side chairs and four armchairs as they are."""
    made = generate("chairs", 6, seed=5, broken=0.0, classes=("side",))
    made += generate("chairs", 4, seed=5, broken=0.0, classes=("armchair",))
    return made, [candidate_turns(surface_of_mesh(one.mesh)) for one in made]


def test_quarters_are_rotations_about_the_vertical():
    assert np.array_equal(QUARTERS[0], np.eye(3)) and len({tuple(turn.ravel()) for turn in QUARTERS}) == 4
    for turn in QUARTERS:
        assert np.linalg.det(turn) == pytest.approx(1) and np.array_equal(turn @ UP, UP)


def test_upright_files_stay_as_they_are(upright_turns):
    _, family = upright_turns
    for rotation in chosen_rotations(family, agree(family)):
        np.testing.assert_allclose(rotation, np.eye(3), atol=1e-12)


def test_a_family_that_faces_another_way_stays_as_it_is():
    made = generate("chairs", 6, seed=5, broken=0.0, classes=("side",))
    meshes = [one.mesh.moved(one.mesh.vertices @ QUARTERS[1].T) for one in made]
    family = [candidate_turns(surface_of_mesh(mesh)) for mesh in meshes]
    for rotation in chosen_rotations(family, agree(family)):
        np.testing.assert_allclose(rotation, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("name", "least"), [("chairs", 0.85), ("airplanes", 0.75)])
def test_turned_and_tilted_shapes_come_back_together(name, least):
    """Four kinds among 15 airplanes are few for telling noses from tails."""
    rng = np.random.default_rng(2)
    made = generate(name, 15, seed=8, broken=0.0)
    applied = [random_turn(rng) for _ in made]
    family = [
        candidate_turns(surface_of_mesh(one.mesh.moved(one.mesh.vertices @ turn.T)))
        for one, turn in zip(made, applied, strict=True)
    ]
    found = chosen_rotations(family, agree(family))
    left = [rotation @ turn for rotation, turn in zip(found, applied, strict=True)]
    assert sum(angle_between(turn[1], UP) < 5 for turn in left) >= 14
    # stools and the like have no front
    clear = [i for i, one in enumerate(made) if one.fine_class not in ("stool", "bench")]
    together = max(sum(turning_angle(quarter.T @ left[i]) < 5 for i in clear) for quarter in QUARTERS)
    assert together >= least * len(clear)


def test_a_lone_turned_file_follows_the_others(upright_turns):
    made, family = upright_turns
    wrong = made[3].mesh.moved(made[3].mesh.vertices @ QUARTERS[2].T @ np.diag([1.0, -1, -1]))
    mixed = [*family[:3], candidate_turns(surface_of_mesh(wrong)), *family[4:]]
    found = chosen_rotations(mixed, agree(mixed))
    assert turning_angle(found[3] @ QUARTERS[2] @ np.diag([1.0, -1, -1])) < 3
    assert all(np.allclose(found[t], np.eye(3)) for t in (0, 1, 2, *range(4, len(mixed))))


def test_settled_shapes_vote_but_are_not_turned(upright_turns):
    made, _ = upright_turns
    quarter = QUARTERS[3]
    settled = [settled_turn(surface_of_mesh(one.mesh), quarter) for one in made[:5]]
    new = candidate_turns(surface_of_mesh(made[5].mesh))
    family = [*settled, new]
    probabilities = agree(family)
    found = chosen_rotations(family, probabilities, standing=True)
    assert all(np.array_equal(rotation, quarter) for rotation in found[:5])
    np.testing.assert_allclose(found[5], quarter, atol=1e-12)
    assert [len(p) for p in probabilities[:5]] == [1] * 5


def test_probabilities_are_such_and_do_not_depend_on_who_is_listened_to(upright_turns, monkeypatch):
    _, family = upright_turns
    everybody = agree(family)
    monkeypatch.setattr(module, "VOTERS", 6)
    some = agree(family)
    for p, q in zip(everybody, some, strict=True):
        assert p.sum() == pytest.approx(1) and q.sum() == pytest.approx(1)
        assert p.argmax() == q.argmax()
    assert agree([]) == [] and agree(family[:1])[0].sum() == pytest.approx(1)


def test_a_turned_shape_is_the_same_shape():
    made = generate("chairs", 1, seed=4, broken=0.0)[0]
    shape = prepare_shape("chair", made.mesh, n_points=300, up="keep", rng=np.random.default_rng(0))
    rotation = random_turn(np.random.default_rng(1))
    other = turned(shape, rotation, "turned")
    np.testing.assert_allclose(other.frame.to_input(other.points), shape.frame.to_input(shape.points), atol=1e-9)
    np.testing.assert_allclose(other.frame.to_input(other.mesh.vertices), made.mesh.vertices, atol=1e-9)
    assert np.linalg.norm(np.ptp(other.mesh.vertices, axis=0)) == pytest.approx(1)
    np.testing.assert_allclose(other.normals @ rotation, shape.normals, atol=1e-9)
    assert other.notes == ("turned", *shape.notes[1:])
    back = surface_of_shape(other)
    assert turning_angle(candidate_turns(back).rotations[0]) < 1, "the surface is in the file's axes"


def test_beliefs_turn_points_and_priors_between_shape_and_family():
    turn = AXIS_ROTATIONS[9]
    none = np.zeros((0, 3))
    beliefs = Beliefs(0, none, none, np.zeros((0, 3, 3)), none, np.zeros((0, 0)), np.zeros(0, bool),
                      np.zeros(0, int), np.zeros(0), pose=turn)  # fmt: skip
    points = np.random.default_rng(0).random((5, 3))
    there = beliefs.to_family(points)
    np.testing.assert_allclose(there, points @ turn.T)
    mean, precision = beliefs.from_family(there, np.abs(there))
    np.testing.assert_allclose(mean, points, atol=1e-12)
    np.testing.assert_allclose(precision, points, atol=1e-12)


@pytest.fixture(scope="module")
def painted():
    """Three side chairs; the first is the exemplar, the last lies on its back, facing away."""
    made = generate("chairs", 3, seed=11, broken=0.0, classes=("side",))
    shapes = prepared(made, 600)
    wrong = AXIS_ROTATIONS[14]
    assert abs(wrong[1, 1]) < 0.5
    shapes[2] = turned(shapes[2], wrong, "")
    truth = [np.asarray(one.faces, np.int32) for one in made]
    return made, shapes, truth, wrong


def test_only_a_shape_that_lies_wrongly_gets_turned_starts(painted):
    _, shapes, _, wrong = painted
    template = shapes[0].points
    for t in (1, 2):
        straight = affine_align(template, shapes[t].points)
        found = posed_starts(shapes[t].points, [template], [straight])
        if t == 1:
            assert found == []
        else:
            assert np.array_equal(found[0].pose, wrong.T)
            assert found[0].alignment.residual < straight.residual
            # the map leads to the shape as it lies
            near = np.linalg.norm(found[0].alignment(template)[:, None] - shapes[t].points, axis=2).min(axis=1)
            assert np.median(near) < 0.05


def test_the_fit_labels_a_shape_that_lies_wrongly_and_says_its_pose(painted):
    made, shapes, truth, wrong = painted
    groups = Groups(("all",), np.zeros(3, int), np.array([0]), np.zeros((3, 2)))
    labels = {0: truth[0]}
    states = list(fit_templates(shapes, groups, labels, made[0].part_names, rng=np.random.default_rng(0), rounds=3))
    beliefs = states[-1].beliefs
    assert beliefs[1].lies_as_the_family
    assert np.array_equal(beliefs[2].pose, wrong.T)
    predicted = beliefs[2].segmentation.argmax(axis=1)
    assert (predicted == truth[2][shapes[2].face_of_point]).mean() > 0.85
    # as the family lies, the deformed template is upright: its back is higher than its seat
    names = made[0].part_names
    heights = beliefs[2].to_family(beliefs[2].deformed)[:, 1]
    label = states[-1].templates[beliefs[2].template].label
    assert heights[label == names.index("back")].mean() > heights[label == names.index("seat")].mean() + 0.1
