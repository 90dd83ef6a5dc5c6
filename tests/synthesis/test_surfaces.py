"""Cutting, welding and refining triangles."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.synthesis.surfaces import cut_out, drop_bad, farthest_points, subdivide_long_edges, vertex_components


def area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def open_sides(triangles: np.ndarray) -> int:
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    return int((np.unique(sides, axis=0, return_counts=True)[1] == 1).sum())


@pytest.mark.parametrize("length", [2.0, 0.7, 0.3, 0.11])
def test_refined_box_stays_closed_and_keeps_area_and_winding(tables, length: float) -> None:
    mesh = tables[0].shape.mesh
    vertices, triangles = cut_out(mesh.vertices, mesh.triangles, (tables[0].faces == 0)[mesh.face_of_triangle])
    fine_vertices, fine = subdivide_long_edges(vertices, triangles, length=length, limit=100_000)
    sides = fine_vertices[fine] - fine_vertices[np.roll(fine, -1, axis=1)]
    assert np.linalg.norm(sides, axis=2).max() <= length
    assert open_sides(triangles) == open_sides(fine) == 0
    assert area(fine_vertices, fine) == pytest.approx(area(vertices, triangles), abs=1e-12)
    volume = np.linalg.det(fine_vertices[fine]).sum()
    assert volume == pytest.approx(np.linalg.det(vertices[triangles]).sum(), abs=1e-12)
    assert len(drop_bad(fine_vertices, fine)[1]) == len(fine)


def test_refining_stops_at_the_limit(tables) -> None:
    mesh = tables[0].shape.mesh
    assert len(subdivide_long_edges(mesh.vertices, mesh.triangles, length=0.001, limit=500)[1]) <= 500


def test_cut_out_welds_drops_and_counts_components(tables) -> None:
    mesh = tables[0].shape.mesh
    soup = mesh.vertices[mesh.triangles].reshape(-1, 3)
    triangles = np.arange(len(soup)).reshape(-1, 3)
    doubled = np.concatenate([triangles, triangles[:7, [1, 2, 0]], triangles[:5, [0, 0, 1]]])
    vertices, cut = cut_out(soup, doubled, np.ones(len(doubled), bool))
    assert len(cut) == len(triangles)
    assert len(vertices) == 36  # 5 boxes of 8 corners; the outer top corner of each leg is a corner of the top as well
    legs_only = drop_bad(vertices, cut[(vertices[cut][:, :, 1] < 0.24).any(axis=1)])
    assert len(np.unique(vertex_components(len(legs_only[0]), legs_only[1]))) == 4


def test_farthest_points_spread() -> None:
    line = np.stack([np.linspace(0, 1, 101), np.zeros(101), np.zeros(101)], axis=1)
    assert sorted(line[farthest_points(line, 3), 0]) == pytest.approx([0, 0.5, 1])
    assert len(farthest_points(line, 500)) == 101
