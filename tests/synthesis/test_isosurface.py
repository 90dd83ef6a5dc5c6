"""The isosurface is closed, manifold where it can be, wound outwards, and where it should be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shapeforge.synthesis.isosurface import isosurface
from shapeforge.synthesis.measures import open_edges


def lattice(n: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(n, dtype=float)] * 3, indexing="ij"), axis=-1)


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def test_a_ball_is_round_and_wound_outwards() -> None:
    middle, radius = np.array([15.3, 14.8, 15.1]), 10.0
    vertices, triangles = isosurface(radius - np.linalg.norm(lattice(31) - middle, axis=-1), 0.0)
    away = np.linalg.norm(vertices - middle, axis=1)
    assert abs(away - radius).max() < 0.15
    assert volume(vertices, triangles) == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.02)
    assert len(vertices) - 1.5 * len(triangles) + len(triangles) == 2  # Euler's number of a sphere


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_any_field_gives_a_closed_surface(seed: int) -> None:
    field = np.random.default_rng(seed).random((9, 8, 7))
    vertices, triangles = isosurface(field, 0.5)
    assert open_edges(triangles) == 0
    assert volume(vertices, triangles) > 0
    assert (vertices > 0).all() and (vertices < np.array(field.shape) - 1).all()


def test_two_sheets_in_one_cell_are_not_welded() -> None:
    field = np.zeros((6, 6, 6))
    field[2, 2, 2] = field[3, 3, 3] = 1.0  # opposite corners of the cell between them
    vertices, triangles = isosurface(field, 0.5)
    assert len(vertices) == 16 and len(triangles) == 24  # two cubes
    field[3, 3, 2] = 1.0  # now joined by edges
    vertices, triangles = isosurface(field, 0.5)
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    assert (np.unique(ends, axis=0, return_counts=True)[1] == 2).all()


def test_nothing_above_the_level_gives_nothing() -> None:
    vertices, triangles = isosurface(np.zeros((4, 4, 4)), 0.5)
    assert vertices.shape == (0, 3) and triangles.shape == (0, 3)


def test_open_edges_are_counted() -> None:
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    assert open_edges(tetrahedron) == 0
    assert open_edges(tetrahedron[1:]) == 3
    turned = tetrahedron.copy()
    turned[0] = turned[0, ::-1]
    assert open_edges(turned) == 3
