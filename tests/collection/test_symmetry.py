"""The mirror plane: found where it is, whichever way the shape faces; x preferred among equals."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.symmetry import mirrored, symmetry_plane


def airplane(rng: np.random.Generator, count: int = 2500) -> np.ndarray:
    """Fuselage along z, swept wings and a fin: symmetric about x = 0 and nothing else."""
    body = rng.uniform([-0.05, -0.05, -0.5], [0.05, 0.05, 0.5], (count // 2, 3))
    span = rng.uniform(-0.5, 0.5, count // 3)
    chord = 0.1 - 0.6 * np.abs(span) + rng.uniform(0, 0.15, span.size)
    wings = np.stack([span, rng.uniform(0, 0.01, span.size), chord], axis=1)
    fin = rng.uniform([-0.01, 0, -0.5], [0.01, 0.25, -0.35], (count // 6, 3))
    return rng.permutation(np.concatenate([body, wings, fin]))


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return points @ turn.T


@pytest.mark.parametrize("degrees", [0, 13, 47.5, 90, 151])
def test_plane_is_found_whichever_way_the_shape_faces(degrees):
    shift = np.array([0.07, 0.2, -0.03])
    points = turned(airplane(np.random.default_rng(0)), degrees) + shift
    normal, offset, error = symmetry_plane(points)
    expected = turned(np.array([[1.0, 0, 0]]), degrees)[0]
    assert np.degrees(np.arccos(min(1.0, abs(normal @ expected)))) < 2
    assert abs(offset - normal @ shift) < 0.01
    assert error < 0.03


def test_among_equal_planes_the_one_across_x_wins():
    rng = np.random.default_rng(1)
    table = rng.uniform([-0.5, 0.4, -0.5], [0.5, 0.42, 0.5], (1500, 3))
    legs = [rng.uniform(-0.03, 0.03, (200, 3)) * [1, 12, 1] + [x, 0, z] for x in (-0.45, 0.45) for z in (-0.45, 0.45)]
    normal, offset, _ = symmetry_plane(np.concatenate([table, *legs]))
    assert normal[0] > 0.999 and abs(offset) < 0.01


def test_asymmetric_shape_has_a_large_error_and_an_outlier_part_does_not_move_the_plane():
    rng = np.random.default_rng(2)
    plane = airplane(rng)
    pod = rng.uniform([0.3, -0.2, 0.1], [0.36, -0.1, 0.3], (150, 3))
    normal, offset, error = symmetry_plane(np.concatenate([plane, pod]))
    assert normal[0] > 0.999 and abs(offset) < 0.01
    assert symmetry_plane(plane)[2] < error
    turn = rng.uniform(0, 6, 2000)
    spiral = np.stack([np.cos(turn) * turn / 12, rng.random(2000) * 0.1, np.sin(turn) * turn / 12], axis=1)
    assert symmetry_plane(spiral)[2] > 2 * symmetry_plane(plane)[2]


def test_mirroring_twice_changes_nothing_and_keeps_the_plane():
    rng = np.random.default_rng(3)
    points, normal = rng.random((20, 3)), np.array([0.6, 0, 0.8])
    assert np.allclose(mirrored(mirrored(points, normal, 0.3), normal, 0.3), points)
    assert np.allclose(mirrored(points, normal, 0.3) @ normal - 0.3, -(points @ normal - 0.3))


def test_errors_name_the_argument():
    with pytest.raises(ValueError, match="points: wanted at least 4"):
        symmetry_plane(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="points: wanted at least 4 finite"):
        symmetry_plane(np.full((9, 3), np.nan))
