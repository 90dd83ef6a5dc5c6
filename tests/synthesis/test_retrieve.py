"""Retrieval: the nearest usable part, from one shape where that is close, mirrored parts together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.synthesis.measures import raggedness
from shapeforge.synthesis.retrieve import part_distances, retrieve
from shapeforge.synthesis.sources import make_sources
from shapeforge.synthesis.surfaces import as_mesh

BOTH = np.array([True, True])


def test_every_training_shape_retrieves_itself(tables, sources) -> None:
    for i, table in enumerate(tables):
        found = retrieve(table.points, BOTH, sources)
        assert found.shape[0] == i and found.distance.max() < 2e-3
        assert retrieve(table.points, BOTH, sources, measure="position").shape.tolist() == [i, i]


def test_distance_measures_forgive_what_they_say(tables, sources) -> None:
    moved, stretched = tables[1].points + [0.1, 0, 0.2], tables[1].points * [1.3, 0.8, 1.1]
    position = part_distances(moved, sources, 0, measure="position")
    expected = np.linalg.norm(moved[:384] - tables[3].points[:384], axis=1).mean()
    assert position[3] == pytest.approx(expected, abs=1e-12)
    assert part_distances(moved, sources, 0, measure="translation")[1] < 1e-9
    assert part_distances(stretched, sources, 1, measure="translation")[1] > 0.02
    assert part_distances(stretched, sources, 1, measure="affine")[1] < 2e-3
    with pytest.raises(ValueError, match="measure"):
        part_distances(moved, sources, 0, measure="nearest")


def test_neighbours_come_from_one_shape_when_that_is_close(tables, sources) -> None:
    # The top lies a little nearer to table 4's than to table 0's, whose legs these are.
    points = tables[0].points.copy()
    points[:384] = 0.48 * tables[0].points[:384] + 0.52 * tables[4].points[:384]
    apart = retrieve(points, BOTH, sources, measure="position", switch=0.0).shape
    assert apart.tolist() == [4, 0]
    together = retrieve(points, BOTH, sources, measure="position", switch=0.05).shape
    assert together[0] == together[1]


def test_absent_parts_and_shapes_without_the_part_are_left_out(tables, table_part) -> None:
    positions = np.stack([t.points for t in tables])
    positions[0, table_part == 1] = np.nan
    sources = make_sources(
        [t.shape.name for t in tables], lambda i: tables[i].shape, [t.faces for t in tables], positions, table_part,
        ("top", "legs"),
    )  # fmt: skip
    assert sources.exists[0].tolist() == [True, False]
    found = retrieve(tables[0].points, BOTH, sources)
    assert found.shape[1] > 0
    assert retrieve(tables[0].points, np.array([True, False]), sources).shape[1] == -1
    assert sources.touching[0, 1] >= 0.75


def test_unusable_parts_are_passed_over(tables, table_part) -> None:
    labels = [t.faces.copy() for t in tables]
    labels[2][:] = 0  # the high table says all of it is top: its legs have no face, its top has unexplained surface
    sources = make_sources(
        [t.shape.name for t in tables], lambda i: tables[i].shape, labels, np.stack([t.points for t in tables]),
        table_part, ("top", "legs"),
    )  # fmt: skip
    found = retrieve(tables[2].points, BOTH, sources)
    assert 2 not in found.shape
    assert sources.part_of(2, 1) is None
    assert "surface without corresponding points" in sources.part_of(2, 0).quality.problems[0]


def test_ragged_borders_are_told_from_straight_ones() -> None:
    n = 24
    grid = np.arange((n + 1) * (n + 1)).reshape(n + 1, n + 1)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[1:, :-1].ravel(), grid[1:, 1:].ravel(), grid[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    u, v = np.meshgrid(np.linspace(0, 0.7, n + 1), np.linspace(0, 0.7, n + 1), indexing="ij")
    mesh = as_mesh(np.stack([u.ravel(), v.ravel(), 0 * u.ravel()], 1), triangles)
    centre = mesh.face_centres
    straight = (centre[:, 0] > 0.35).astype(np.int32)
    row = np.round(centre[:, 1] * n / 0.7 - 0.5).astype(int)
    torn = (centre[:, 0] > 0.35 + 0.05 * (-1.0) ** row).astype(np.int32)
    assert raggedness(mesh, straight, 1) < 0.003
    wave = (centre[:, 0] > 0.35 + 0.1 * np.sin(9 * centre[:, 1])).astype(np.int32)
    assert raggedness(mesh, torn, 1) > 0.015
    assert raggedness(mesh, wave, 1) < raggedness(mesh, torn, 1) / 2
    assert raggedness(mesh, np.zeros_like(torn), 1) == raggedness(mesh, np.ones_like(torn), 1) == 0


def test_mirrored_parts_are_tied(tables, table_part) -> None:
    left = np.concatenate([table_part[:384], np.repeat([1, 1, 2, 2], 384)]).astype(np.int32)
    positions = np.stack([t.points for t in tables])
    labels = [np.concatenate([np.zeros(6), np.repeat([1, 1, 2, 2], 6)]).astype(np.int32) for _ in tables]
    sources = make_sources(
        [t.shape.name for t in tables], lambda i: tables[i].shape, labels, positions, left, ("top", "left", "right")
    )
    assert sources.mirror.parts == ((1, 2),)
    draw = tables[0].points.copy()
    draw[left == 2] = tables[3].points[left == 2]
    found = retrieve(draw, np.ones(3, bool), sources, switch=0.0)
    assert found.shape[1] == found.shape[2]


def test_a_part_from_another_shape_comes_from_one_that_is_like_the_first(tables, table_part) -> None:
    # The draw's top is table 0's; its legs are as near to those of b, whose top is alike, as to those of c.
    positions = np.stack([tables[0].points, tables[0].points, tables[2].points])
    legs = table_part == 1
    positions[0, legs] = np.nan
    drawn = tables[0].points.copy()
    drawn[legs] = (positions[1, legs] + positions[2, legs]) / 2 + 1e-4 * (positions[2, legs] - positions[1, legs])
    labels = [tables[0].faces * 0, tables[0].faces, tables[2].faces]
    shapes = [tables[0].shape, tables[0].shape, tables[2].shape]
    sources = make_sources("abc", shapes.__getitem__, labels, positions, table_part, ("top", "legs"))
    sources = replace(sources, touching=np.array([[0.0, 1.0], [1.0, 0.0]]))
    plain = retrieve(drawn, BOTH, sources, fixed={0: 0}, measure="position", switch=0.0).shape
    assert plain.tolist() == [0, 2]
    assert retrieve(drawn, BOTH, sources, fixed={0: 0}, measure="position").shape.tolist() == [0, 1]


def test_the_cache_forgets_the_oldest(tables, sources) -> None:
    small = replace(sources, keep=2, _cache=type(sources._cache)())
    for i in range(4):
        small.parts_of(i)
    assert list(small._cache) == [2, 3]
    with pytest.raises(ValueError, match="positions"):
        make_sources(["a"], lambda i: tables[0].shape, [], np.zeros((2, 3, 3)), np.zeros(3, np.int32), ("x",))
