"""The automatic start: parts of simple furniture are found, left and right are one part, and odd input is survived."""

from __future__ import annotations

import csv
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import trimesh
from scipy.optimize import linear_sum_assignment
from sklearn.metrics import silhouette_samples

from shapeforge.collection.align import affine_align
from shapeforge.collection.groups import Groups
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Frame, Mesh, Shape
from shapeforge.deformation import boxes, voting
from shapeforge.deformation.boxes import (
    SURE,
    TWO_LEAD,
    Proposal,
    choose_number,
    cluster_patches,
    propose_parts,
    richest_exemplars,
    silhouette,
)
from shapeforge.deformation.pieces import common_frame
from shapeforge.stages_collection import proposed_text
from tests.deformation.test_pieces import box, mesh_of


def chair(seed: int) -> tuple[Shape, np.ndarray]:
    """A chair of box patches: a patch and (0 legs, 1 seat, 2 back) per box; descriptors tell little."""
    rng = np.random.default_rng(seed)
    width, leg, back = rng.uniform(0.4, 0.5), rng.uniform(0.35, 0.5), rng.uniform(0.3, 0.45)
    parts = [((0.05, leg, 0.05), (x * width * 0.45, -leg / 2, z * 0.2), 0) for x in (-1, 1) for z in (-1, 1)]
    parts += [((width, 0.05, 0.45), (0, 0, 0), 1), ((width, back, 0.04), (0, back / 2, -0.2), 2)]
    points, normals, patch, truth = [], [], [], []
    for number, (size, centre, part) in enumerate(parts):
        box = trimesh.creation.box(size)
        sample, face = trimesh.sample.sample_surface(box, int(120 + 600 * box.area), seed=seed * 10 + number)
        points.append(np.asarray(sample) + centre)
        normals.append(np.asarray(box.face_normals[face]))
        patch += [number] * len(sample)
        truth += [part] * len(sample)
    at = np.concatenate(points)
    n = len(at)
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros(1, np.int64), 1)
    shape = Shape(
        f"chair {seed}", mesh, Frame(1.0, np.eye(3), np.zeros(3)), at, np.concatenate(normals), np.zeros(n, np.int64),
        np.zeros(n, np.int64), np.full((n, 10), 0.5), np.array(patch), np.full((n, 20), -1),
    )  # fmt: skip
    return shape, np.array(truth)


def one_group(number: int) -> Groups:
    return Groups(("Group 1",), np.zeros(number, np.int64), np.array([0]), np.zeros((number, 2)))


def matched(segmentations, truths) -> float:
    """Share of points right under the best one-to-one naming of parts."""
    n_parts, n_true = segmentations[0].shape[1], int(max(truth.max() for truth in truths)) + 1
    table = np.zeros((n_parts, n_true))
    for segmentation, truth in zip(segmentations, truths, strict=True):
        keep = truth >= 0
        np.add.at(table, (segmentation.argmax(axis=1)[keep], truth[keep]), 1 / keep.sum())
    return float(table[linear_sum_assignment(-table)].sum() / len(truths))


@pytest.fixture(scope="module")
def chairs() -> tuple[list[Shape], list[np.ndarray]]:
    made = [chair(seed) for seed in range(6)]
    return [shape for shape, _ in made], [truth for _, truth in made]


def test_parts_of_chairs_are_found_and_all_legs_are_one_part(chairs):
    shapes, truths = chairs
    proposal = propose_parts(shapes, one_group(6), n_parts=3, rng=np.random.default_rng(0))
    assert proposal.part_names == ("part 1", "part 2", "part 3")
    assert matched(proposal.segmentation, truths) > 0.99
    assert 0 < proposal.energy < 0.6


def test_number_of_parts_of_chairs_is_found(chairs):
    """Front and back legs may count as two parts, but (except at the joints) no part mixes what is different."""
    shapes, truths = chairs
    proposal = propose_parts(shapes, one_group(6), rng=np.random.default_rng(0))
    part, truth = np.concatenate([s.argmax(axis=1) for s in proposal.segmentation]), np.concatenate(truths)
    assert len(proposal.part_names) in (3, 4)
    assert all(np.bincount(truth[part == p]).max() > 0.97 * (part == p).sum() for p in range(len(proposal.part_names)))


def test_the_others_outvote_a_shape_whose_patches_are_wrong(chairs):
    """One chair's patch lumps its back with its seat: the other chairs know better."""
    shapes, truths = chairs
    lumped = replace(shapes[2], patch=np.where(shapes[2].patch == 5, 4, shapes[2].patch))
    proposal = propose_parts([*shapes[:2], lumped, *shapes[3:]], one_group(6), n_parts=3, rng=np.random.default_rng(0))
    assert matched(proposal.segmentation, truths) > 0.98


def test_rows_are_probabilities_with_the_agreed_certainty(chairs):
    shapes, _ = chairs
    proposal = propose_parts(shapes, one_group(6), n_parts=4, rng=np.random.default_rng(0))
    for shape, segmentation in zip(shapes, proposal.segmentation, strict=True):
        assert segmentation.shape == (shape.n_points, 4)
        assert np.allclose(segmentation.sum(axis=1), 1)
        assert np.allclose(segmentation.max(axis=1), SURE + (1 - SURE) / 4)


def test_same_seed_same_bytes(chairs):
    shapes, _ = chairs
    one, two = (propose_parts(shapes, one_group(6), rng=np.random.default_rng(3)) for _ in range(2))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(one.segmentation, two.segmentation, strict=True))


def test_single_shape_many_parts_and_ungrouped_shapes(chairs):
    shapes, truths = chairs
    alone = propose_parts(shapes[:1], one_group(1), n_parts=8, rng=np.random.default_rng(0))
    assert alone.segmentation[0].shape[1] == 8 and np.allclose(alone.segmentation[0].sum(axis=1), 1)
    groups = Groups(("Group 1",), np.array([0, -1, 0, 0, 0, 0]), np.array([0]), np.zeros((6, 2)))
    proposal = propose_parts(shapes, groups, n_parts=3, rng=np.random.default_rng(0))
    assert matched(proposal.segmentation, truths) > 0.99


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("asked", [None, 6])
def test_shapes_of_fewer_pieces_than_kinds_of_patches_get_parts(number: int, asked: int | None):
    """A box on a box: the sides of either are patches apart, but there are two pieces to a shape."""
    rng = np.random.default_rng(0)
    stack = mesh_of(box((1, 0.5, 0.8), (0, 0.25, 0)), box((0.4, 0.6, 0.4), (0, 0.81, 0)))
    shapes = [prepare_shape(f"stack {t}", stack, n_points=600, up="y", rng=rng) for t in range(number)]
    proposal = propose_parts(shapes, one_group(number), n_parts=asked, rng=rng)
    assert len(proposal.part_names) == (asked or 2 * number)
    for shape, segmentation in zip(shapes, proposal.segmentation, strict=True):
        part = segmentation.argmax(axis=1)
        lower, upper = (set(part[half].tolist()) for half in (shape.face_of_point < 12, shape.face_of_point >= 12))
        assert lower and upper and not lower & upper


def test_common_frame_goes_through_the_groups_exemplar(chairs):
    shapes, _ = chairs
    groups = Groups(("Group 1", "Group 2"), np.array([0, 0, 0, 1, 1, 1]), np.array([0, 3]), np.zeros((6, 2)))
    frames = common_frame(shapes, groups)
    assert np.array_equal(frames[0].matrix, np.eye(3))
    first = affine_align(shapes[4].points, shapes[3].points)
    through = affine_align(shapes[3].points, shapes[0].points)(first(shapes[4].points))
    assert np.allclose(frames[4](shapes[4].points), through)
    assert np.linalg.norm(through - shapes[4].points, axis=1).mean() > 1e-3


def rack(seed: int) -> tuple[Shape, np.ndarray]:
    """Four rods (0) and a slab (1) that lie anywhere in any direction: nothing but their looks tells which is which."""
    rng = np.random.default_rng(seed)
    kinds = [((0.5, 0.06, 0.06), 0)] * 4 + [((0.4, 0.3, 0.06), 1)]
    made = [
        trimesh.creation.box(rng.permutation(size), trimesh.transformations.translation_matrix(at))
        for (size, _), at in zip(kinds, rng.uniform(-1, 1, (5, 3)), strict=True)
    ]
    shape = prepare_shape(f"rack {seed}", mesh_of(*made), n_points=500, up="y", rng=rng)
    return shape, np.repeat([part for _, part in kinds], 12)[shape.face_of_point]


def test_copies_are_one_part_wherever_they_lie(monkeypatch):
    monkeypatch.setattr(voting, "ROUNDS", 0)
    shapes, truths = zip(*[rack(seed) for seed in range(10)], strict=True)
    start = propose_parts(shapes, one_group(10), n_parts=2, rng=np.random.default_rng(0))
    assert matched(start.segmentation, truths) > 0.9
    monkeypatch.setattr(boxes, "_LOOKS_WEIGHTS", np.zeros(5))
    blind = propose_parts(shapes, one_group(10), n_parts=2, rng=np.random.default_rng(0))
    assert matched(blind.segmentation, truths) < 0.8


def test_a_proposal_says_which_parts_hardly_any_shape_has():
    sure = np.eye(4) * 0.6 + 0.1
    labels = np.array([0] * 50 + [1] * 50), np.array([0] * 50 + [1] * 49 + [2]), np.array([0, 1, 3, 3] * 25)
    proposal = Proposal(tuple(sure[one] for one in labels), ("seat", "leg", "part 3", "arm"), 0.5, np.array([0]))
    assert proposal.shapes_with().tolist() == [3, 3, 1, 1]
    text = "4 parts proposed; part 3, arm are found on hardly any shape: they agree on 2 (ask for 2)"
    assert proposed_text(proposal, edited=False) == text
    alone = replace(proposal, segmentation=proposal.segmentation[2:])
    assert "part 3 is found on hardly any" in proposed_text(alone, edited=True)
    both = replace(alone, segmentation=(sure[:, :2][np.array([0, 1])],) * 2, part_names=("seat", "leg"))
    assert proposed_text(both, edited=True) == "2 parts: seat, leg"


def test_number_is_that_of_clear_clusters():
    rng = np.random.default_rng(0)
    for k in (2, 4, 6):
        centres = 10 * np.array(list(permutations(range(3))))[:k]
        features = np.repeat(centres, 20, axis=0) + rng.normal(size=(20 * k, 3))
        assert choose_number(features, rng.random(20 * k) + 0.1, rng=rng) == k


def test_two_parts_have_to_be_clearly_better_than_three():
    """Two clusters near each other and one far off: by the silhouette alone it would be two."""
    rng = np.random.default_rng(0)
    places = np.array([0.0, 2.3, 9.0]).repeat(20)[:, None] + rng.normal(scale=0.5, size=(60, 1))
    weight = np.ones(60)
    distance = np.abs(places - places.T)
    two, three = (silhouette(distance, cluster_patches(places, weight, k, rng=rng)[0], weight) for k in (2, 3))
    assert three < two < three + TWO_LEAD
    assert choose_number(places, weight, rng=rng) == 3


def test_clusters_are_numbered_by_weight_and_ignore_empty_patches():
    features = np.array([[0.0], [0.1], [5.0], [5.1], [99.0]])
    part, energy = cluster_patches(features, np.array([1, 1, 3, 3, 0.0]), 2, rng=np.random.default_rng(0))
    assert np.array_equal(part[:4], [1, 1, 0, 0]) and energy < 0.01


def test_silhouette_equals_the_known_one_for_equal_weights():
    rng = np.random.default_rng(0)
    places, part = rng.random((30, 2)), rng.integers(0, 3, 30)
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    expected = silhouette_samples(distance, part, metric="precomputed").mean()
    assert silhouette(distance, part, np.ones(30)) == pytest.approx(expected, abs=1e-9)
    assert silhouette(distance, np.zeros(30, np.int64), np.ones(30)) == 0


def test_errors_name_the_argument(chairs):
    with pytest.raises(ValueError, match="shapes: wanted at least one"):
        propose_parts([], one_group(1), rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="n_parts: wanted at least 1, got 0"):
        propose_parts(chairs[0], one_group(6), n_parts=0, rng=np.random.default_rng(0))


def test_real_side_chairs_are_cut_about_as_people_would(real_shapes):
    from shapeforge.collection.meshes import read_mesh

    folder = real_shapes / "ikea" / "chairs"
    with open(folder / "classes.csv") as file:
        names = [row["name"] for row in csv.DictReader(file) if row["class"] == "side"][:8]
    shapes, truths = [], []
    for name in names:
        shape = prepare_shape(name, read_mesh(folder / f"{name}.obj"), n_points=1200, rng=np.random.default_rng(0))
        shapes.append(shape)
        # back, seat, leg; the few faces of anything else are left out
        faces = np.loadtxt(folder / f"{name}.seg", dtype=np.int64).reshape(-1) - 1
        truths.append(np.where(faces < 3, faces, -1)[shape.face_of_point])
    proposal = propose_parts(shapes, one_group(8), n_parts=3, rng=np.random.default_rng(0))
    assert matched(proposal.segmentation, truths) > 0.8


def test_exemplars_are_among_the_shapes_with_the_most_parts():
    """The group's own if it is one of them, else the one nearest to the group."""
    distance = np.abs(np.subtract.outer(np.arange(6.0), np.arange(6.0)))
    groups = Groups(("A", "B"), np.array([0, 0, 0, 0, 1, 1]), np.array([0, 4]), np.zeros((6, 2)), distance)
    two, three = np.repeat([0, 1], 50), np.repeat([0, 1, 2], 50)
    hardly = np.where(np.arange(1000) < 5, 2, np.arange(1000) % 2)  # a few stray points are no part
    chosen = richest_exemplars(groups, [two, three, three, hardly, three, two], 3)
    assert chosen.tolist() == [1, 4]
    odd = np.repeat([0, 1, 3], 50)  # a part that a single shape has is no reason to choose it
    assert richest_exemplars(groups, [two, odd, two, two, two, two], 4).tolist() == [0, 4]


def test_many_shapes_follow_those_that_were_taught(chairs, monkeypatch):
    shapes, truths = chairs
    monkeypatch.setattr("shapeforge.deformation.boxes.TAUGHT", 4)
    proposal = propose_parts(shapes, one_group(6), n_parts=3, rng=np.random.default_rng(0))
    assert matched(proposal.segmentation, truths) > 0.99
