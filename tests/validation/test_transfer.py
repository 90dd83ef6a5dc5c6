"""Affine transfer: exact for an affinely stretched copy, from the right exemplar; figures of a whole family by name."""

from __future__ import annotations

import json

import numpy as np
import pytest

from shapeforge.collection.families import generate
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Shape
from shapeforge.validation.family import validate_family
from shapeforge.validation.transfer import affine_transfer, nearest_exemplar, reference_points


@pytest.fixture(scope="module")
def chairs() -> list:
    return generate("chairs", 4, seed=3, broken=0.0)


def prepared(name: str, mesh, seed: int = 0) -> Shape:
    return prepare_shape(name, mesh, n_points=800, up="y", rng=np.random.default_rng(seed))


@pytest.fixture(scope="module")
def shapes(chairs) -> list[Shape]:
    return [prepared(chair.name, chair.mesh) for chair in chairs]


def test_a_stretched_copy_gets_the_labels_of_its_original(chairs, shapes) -> None:
    mesh = chairs[1].mesh
    stretched = prepared("stretched", mesh.moved(mesh.vertices * [1.15, 0.9, 1.05]), seed=1)
    exemplar, alignment = nearest_exemplar(stretched, shapes)
    assert exemplar == 1
    found = affine_transfer(stretched, shapes, [chair.faces for chair in chairs])
    assert found.exemplar == 1 and found.residual == alignment.residual
    area = stretched.mesh.face_areas
    assert area[found.faces == chairs[1].faces].sum() / area.sum() > 0.93
    true = stretched.frame.to_normal(shapes[1].frame.to_input(reference_points(shapes)[1]) * [1.15, 0.9, 1.05])
    assert np.median(np.linalg.norm(found.positions - true, axis=1)) < 0.02


def test_unlabelled_faces_stay_unlabelled_and_lengths_are_checked(chairs, shapes) -> None:
    blank = [np.full(chair.mesh.n_faces, -1, np.int32) for chair in chairs]
    assert (affine_transfer(shapes[0], shapes, blank).faces == -1).all()
    with pytest.raises(ValueError, match="exemplar_faces"):
        affine_transfer(shapes[0], shapes, blank[:1])
    with pytest.raises(ValueError, match="exemplars"):
        reference_points([])


def test_figures_of_a_family(chairs, shapes) -> None:
    names = chairs[0].part_names
    turned = tuple(reversed(names))  # the truth's parts in another order
    truth = {c.name: (len(names) - 1 - c.faces).astype(np.int32) for c in chairs}
    predicted = {c.name: c.faces for c in chairs[:3]}
    predicted[chairs[2].name] = np.full_like(chairs[2].faces, np.bincount(chairs[2].faces).argmax())
    meshes = {c.name: c.mesh for c in chairs}
    shared = set.intersection(*[set(c.landmarks) for c in chairs])
    landmarks = {c.name: {mark: c.landmarks[mark] for mark in sorted(shared)} for c in chairs}
    points = {name: np.stack(list(marks.values())) for name, marks in landmarks.items()}
    figures = validate_family(
        meshes.__getitem__, rng=np.random.default_rng(0), part_names=names, predicted=predicted, truth=truth,
        truth_part_names=turned, landmarks=landmarks, points=points, evidence=[chairs[0].name],
        baseline_faces=predicted, classes={c.name: c.fine_class for c in chairs}, descriptors={},
    )  # fmt: skip
    found = figures["segmentation"]
    assert found["n"] == 2 and found["unanswered"] == [chairs[3].name] and found["parts_without_answer"] == []
    assert found["shapes"][chairs[1].name] == {"faces": 1.0, "area": 1.0, "part_iou": 1.0}
    assert 0.5 < found["faces"] < 1 and found["affine_transfer"]["n"] == 2
    corr = figures["correspondence"]
    assert corr["corr"]["0.01"] == 1.0 and corr["n_shapes"] == 3 and corr["n_pairs"] == 6
    assert corr["n"] == 6 * len(shared) and corr["missing"] == 0
    assert figures["classification"]["n"] == 0
    assert figures["left_out"] == [chairs[0].name]
    json.dumps(figures)
