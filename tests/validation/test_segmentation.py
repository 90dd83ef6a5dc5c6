"""Faces, area and part IoU by hand; parts matched by name."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.shape import Mesh
from shapeforge.validation.segmentation import mean_score, rename_parts, score_segmentation


@pytest.fixture
def strip() -> Mesh:
    """Five rectangles of areas 1, 2, 3, 4 and 0 (a record without triangles), two triangles each."""
    ends = np.cumsum([0, 1, 2, 3, 4])
    vertices = np.array([[x, y, 0] for x in ends for y in (0, 1)], float)
    quads = np.array([[2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1] for i in range(4)])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(vertices, triangles, np.tile(np.arange(4), 2), 5)


def test_by_hand(strip: Mesh) -> None:
    score = score_segmentation(strip, np.array([0, 1, 1, 1, 0]), np.array([0, 0, 1, 1, 0]))
    assert score.faces == pytest.approx(4 / 5)
    assert score.area == pytest.approx(8 / 10)
    assert score.part_iou == pytest.approx((1 / 3 + 7 / 9) / 2)


def test_unlabelled_truth_is_left_out_and_missing_answers_are_wrong(strip: Mesh) -> None:
    score = score_segmentation(strip, np.array([0, -1, 2, 1, 1]), np.array([0, 1, -1, 1, -1]))
    assert score.faces == pytest.approx(2 / 3)
    assert score.area == pytest.approx(5 / 7)
    assert score.part_iou == pytest.approx((1 + 4 / 6) / 2)
    assert score_segmentation(strip, np.zeros(5, int), np.full(5, -1)) is None


def test_everything_one_part_has_high_faces_and_low_iou(strip: Mesh) -> None:
    score = score_segmentation(strip, np.ones(5, int), np.array([0, 1, 1, 1, 1]))
    assert score.faces == pytest.approx(0.8)
    assert score.part_iou == pytest.approx(0.9 / 2)


def test_mean_is_over_shapes_and_lengths_are_checked(strip: Mesh) -> None:
    good = score_segmentation(strip, np.zeros(5, int), np.zeros(5, int))
    bad = score_segmentation(strip, np.ones(5, int), np.zeros(5, int))
    assert mean_score([good, bad]).faces == 0.5
    assert mean_score([]) is None
    with pytest.raises(ValueError, match="face record"):
        score_segmentation(strip, np.zeros(8, int), np.zeros(8, int))


def test_parts_are_matched_by_name() -> None:
    labels = rename_parts(np.array([0, 1, 2, -1]), ["Seat", "antenna", "back"], ["back", "seat", "legs"])
    assert labels.tolist() == [1, 3, 0, -1]
    with pytest.raises(ValueError, match="labels"):
        rename_parts(np.array([3]), ["a"], ["a"])
