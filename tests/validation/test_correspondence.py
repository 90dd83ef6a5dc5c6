"""corr@r equals the definition written as loops."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.shape import Mesh
from shapeforge.validation.correspondence import RADII, corr_curve, landmark_errors


def plate(width: float, height: float) -> Mesh:
    vertices = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0], [99, 99, 99]], float)
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.array([0, 0]), 1)


def family() -> tuple[dict, dict, dict]:
    """Three plates of other sizes; points float .1 above; point 3 is absent on c; landmarks at three places."""
    rng = np.random.default_rng(0)
    sizes = {"a": (1.0, 1.0), "b": (3.0, 1.0), "c": (1.0, 2.0)}
    places = np.array([[0.1, 0.1], [0.9, 0.1], [0.5, 0.5], [0.9, 0.9]])
    meshes = {name: plate(*size) for name, size in sizes.items()}
    points = {
        name: np.column_stack([places * size + rng.normal(0, 0.03, (4, 2)), np.full(4, 0.1)])
        for name, size in sizes.items()
    }
    points["c"][3] = np.nan
    landmarks = {
        name: {f"m{k}": np.array([*(places[k] * size), 0.0]) for k in (0, 2, 3)} for name, size in sizes.items()
    }
    del landmarks["b"]["m2"]
    return meshes, points, landmarks


def test_equals_the_definition_in_loops() -> None:
    meshes, points, landmarks = family()
    expected = []
    for b in meshes:
        for a in meshes:
            for mark in landmarks[a]:
                if a == b or mark not in landmarks[b]:
                    continue
                k = np.nanargmin(np.linalg.norm(points[a] - landmarks[a][mark], axis=1))
                if np.isnan(points[b][k]).any():
                    expected.append(np.inf)
                    continue
                corner = meshes[b].vertices[2]
                surface = np.clip(points[b][k], 0, corner)  # the plate lies in z = 0
                expected.append(np.linalg.norm(surface - landmarks[b][mark]) / np.linalg.norm(corner))
    errors = landmark_errors(landmarks, points, meshes.__getitem__)
    np.testing.assert_allclose(np.sort(errors), np.sort(expected), atol=1e-9)
    assert np.isinf(errors).sum() == 2  # m3 from a and from b: absent on c
    curve = corr_curve(errors)
    assert curve.tolist() == [np.mean(np.array(expected) <= r) for r in RADII]
    assert 0 < curve[2] < 1


def test_absent_everywhere_and_unknown_shapes_are_misses_or_left_out() -> None:
    meshes, points, landmarks = family()
    points["a"][:] = np.nan
    errors = landmark_errors(landmarks, points, meshes.__getitem__)
    assert np.isinf(errors).sum() >= 5 + 5  # whatever starts or ends at a
    del points["a"]
    assert len(landmark_errors(landmarks, points, meshes.__getitem__)) == 4
    assert np.isnan(corr_curve(np.zeros(0))).all()


def test_a_radius_counts_its_own_distance() -> None:
    assert corr_curve(np.array([0.05, 0.051, np.inf]), [0.05]).tolist() == [pytest.approx(1 / 3)]
