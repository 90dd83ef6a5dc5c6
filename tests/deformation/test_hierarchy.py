"""Links between the templates of different groups, and what exemplars lend each other, on shapes made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.exemplars import Candidate, blend
from shapeforge.deformation.existence import DOUBT
from shapeforge.deformation.hierarchy import deformed_family, link_templates
from shapeforge.deformation.templates import PartTemplates, template_from_points

PARTS = ("back", "seat", "leg", "arm")


def box(rng, count, low, high):
    """Points (count, 3) and normals on the surface of a box."""
    low, high = np.array(low, float), np.array(high, float)
    size = high - low
    area = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    axis = rng.choice(3, count, p=area / area.sum())
    side = rng.integers(0, 2, count)
    points = low + rng.random((count, 3)) * size
    rows = np.arange(count)
    points[rows, axis] = np.where(side == 1, high[axis], low[axis])
    normals = np.zeros((count, 3))
    normals[rows, axis] = 2.0 * side - 1
    return points, normals


def chair(back: float, leg: float, arms: bool = False) -> PartTemplates:
    """Templates of a chair with a back and legs of these heights, in units of the chair's width."""
    rng = np.random.default_rng(5)
    pieces = [(0, 150, (-0.5, 0.1, -0.5), (0.5, 0.1 + back, -0.4)), (1, 150, (-0.5, 0, -0.5), (0.5, 0.1, 0.5))]
    pieces += [(2, 60, (x, -leg, z), (x + 0.1, 0, z + 0.1)) for x in (-0.5, 0.4) for z in (-0.5, 0.4)]
    if arms:
        pieces += [(3, 40, (x, 0.35, -0.4), (x + 0.1, 0.42, 0.4)) for x in (-0.5, 0.4)]
    points, normals, label = [], [], []
    for part, count, low, high in pieces:
        place, normal = box(rng, count, low, high)
        points.append(place)
        normals.append(normal)
        label += [part] * count
    points = np.concatenate(points)
    points = points / np.linalg.norm(np.ptp(points, axis=0))
    descriptors = np.zeros((len(points), 10))
    return template_from_points(points, np.concatenate(normals), descriptors, np.array(label), PARTS)


def identity_beliefs(templates: PartTemplates, index: int, segmentation: np.ndarray, misfit: np.ndarray) -> Beliefs:
    """Beliefs on the very shape that the templates came from."""
    return Beliefs(
        index, templates.points.copy(), np.full_like(templates.points, 1e-4), np.tile(np.eye(3), (len(PARTS), 1, 1)),
        np.zeros((len(PARTS), 3)), segmentation, templates.has_part(), np.full(len(segmentation), -1, np.int32), misfit,
    )  # fmt: skip


def test_legs_of_another_length_are_reached_to_their_ends():
    low, tall = chair(back=2.0, leg=0.3), chair(back=0.2, leg=2.0)
    hierarchy = link_templates([low, tall], [5, 1])
    link = hierarchy.links[1]
    moved = np.einsum("kj,kji->ki", link.weight, tall.points[link.index])
    for part, name in enumerate(PARTS[:3]):
        mine, theirs = moved[hierarchy.top.label == part, 1], tall.points[tall.label == part, 1]
        assert mine.min() == pytest.approx(theirs.min(), abs=0.03), name
        assert mine.max() == pytest.approx(theirs.max(), abs=0.03), name


def test_templates_that_explain_many_shapes_need_no_link():
    a, b = chair(back=0.8, leg=0.5), chair(back=0.4, leg=0.9)
    for sizes, owner in (([9, 1], 0), ([1, 9], 1)):
        link = link_templates([a, b], sizes).links[owner]
        assert (link.weight[:, 0] == 1).all() and link.exists.all()


def test_templates_that_share_next_to_nothing_are_linked_as_they_lie():
    whole = chair(back=0.8, leg=0.5)
    label = np.where(whole.label == PARTS.index("back"), PARTS.index("arm"), -1)
    label[np.flatnonzero(whole.label == PARTS.index("seat"))[:3]] = PARTS.index("seat")
    other = template_from_points(whole.points, whole.normals, whole.descriptors, label, PARTS)
    hierarchy = link_templates([whole, other], [1, 1])
    assert hierarchy.top.has_part().all()
    link, seat = hierarchy.links[1], hierarchy.top.label == PARTS.index("seat")
    assert link.exists[seat].all()
    np.testing.assert_allclose(hierarchy.top.points[hierarchy.top.label == PARTS.index("arm")], other.points[3:])


@pytest.fixture
def explained_twice():
    """100 points, the last 20 an arm that only the second exemplar's template knows and that it explains better."""
    plain, armed = chair(0.8, 0.5), chair(0.8, 0.5, arms=True)
    seat, both = np.zeros((100, 4)), np.zeros((100, 4))
    seat[:, 1] = 1.0
    both[:80, 1], both[80:, 3] = 1.0, 1.0
    far = np.where(np.arange(100) < 80, 0.0, 5.0).astype(np.float32)
    unknown = np.array([2.0, 2.0, 2.0, np.nan])
    best = Candidate(identity_beliefs(plain, 0, seat, unknown), 1.0, 0.0, far)
    other = Candidate(
        identity_beliefs(armed, 1, both, np.full(4, 2.0)), float(np.exp(-2)), 2.0, np.zeros(100, np.float32)
    )
    return (plain, armed), best, other


def test_a_part_that_the_best_exemplar_lacks_is_lent(explained_twice):
    templates, best, other = explained_twice
    mixed = blend((best, other))
    assert mixed.template == 0 and [part for part, _ in mixed.lent] == [3]
    assert (mixed.segmentation.argmax(axis=1) == np.where(np.arange(100) < 80, 1, 3)).all()
    np.testing.assert_allclose(mixed.segmentation.sum(axis=1), 1)
    hierarchy = link_templates(templates, [3, 1])
    places, variance, exists = deformed_family(mixed, hierarchy)
    arm = hierarchy.top.label == 3
    assert exists.all() and np.isfinite(places).all() and (variance > 0).all()
    own = templates[1].points[templates[1].label == 3]
    np.testing.assert_allclose(places[arm], own, atol=1e-12)
    assert not deformed_family(best.beliefs, hierarchy)[2][arm].any()


def test_a_part_that_the_best_exemplar_found_missing_is_not_lent(explained_twice):
    _, best, other = explained_twice
    condemned = replace(best, beliefs=replace(best.beliefs, misfit=np.array([2.0, 2.0, 2.0, -6.0])))
    mixed = blend((condemned, other))
    assert mixed.lent == ()
    assert (mixed.segmentation[:, 3] < 1e-6).all()
    np.testing.assert_allclose(mixed.segmentation.sum(axis=1), 1)


def test_one_that_doubts_a_part_a_little_is_overruled_by_one_that_is_sure(explained_twice):
    _, best, other = explained_twice
    doubting = replace(best, beliefs=replace(best.beliefs, misfit=np.array([2.0, 2.0, 2.0, -5.0])))
    assert blend((doubting, other)).lent == ()
    sure = replace(other, beliefs=replace(other.beliefs, misfit=np.array([2.0, 2.0, 2.0, 4.0])))
    mixed = blend((doubting, sure))
    assert [part for part, _ in mixed.lent] == [3] and (mixed.segmentation[80:].argmax(axis=1) == 3).all()


def test_a_part_that_only_one_exemplar_knows_is_doubted_as_its_own_parts_are(explained_twice):
    _, best, other = explained_twice
    for odds, lent in ((DOUBT + 0.1, [3]), (DOUBT - 0.1, [])):
        unsure = replace(other, beliefs=replace(other.beliefs, misfit=np.array([2.0, 2.0, 2.0, odds])))
        assert [part for part, _ in blend((best, unsure)).lent] == lent
