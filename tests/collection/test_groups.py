"""Grouping: families that differ are told apart, few shapes and odd matrices are survived, same seed same bytes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

import shapeforge.collection.groups as module
from shapeforge.collection.groups import (
    classical_scaling,
    find_exemplars,
    group_shapes,
    medoids,
    shape_descriptor,
    similarity_graph,
)  # fmt: skip
from shapeforge.collection.iterate import last


@dataclass
class Sampled:
    """What grouping needs of a shape."""

    points: np.ndarray


def boxes(rng: np.random.Generator, *size_centre_count) -> Sampled:
    parts = []
    for size, centre, count in size_centre_count:
        points = rng.uniform(-0.5, 0.5, (count, 3))
        points[np.arange(count), rng.integers(0, 3, count)] = rng.choice([-0.5, 0.5], count)
        parts.append(points * size + centre)
    points = rng.permutation(np.concatenate(parts))
    low, high = points.min(axis=0), points.max(axis=0)
    return Sampled((points - (low + high) / 2) / np.linalg.norm(high - low))


def chair(rng) -> Sampled:
    w, h = rng.uniform(0.9, 1.1, 2)
    legs = [((0.1, 0.9 * h, 0.1), (x * w / 2, -0.45 * h, z * 0.45), 60) for x in (-1, 1) for z in (-1, 1)]
    return boxes(rng, ((w, 0.1, 1), (0, 0, 0), 200), ((w, h, 0.1), (0, h / 2, -0.5), 200), *legs)


def table(rng) -> Sampled:
    w, h = rng.uniform(1.8, 2.2), rng.uniform(0.8, 1)
    legs = [((0.1, h, 0.1), (x * w / 2, -h / 2, z * 0.45), 60) for x in (-1, 1) for z in (-1, 1)]
    return boxes(rng, ((w, 0.1, 1), (0, 0, 0), 400), *legs)


def lamp(rng) -> Sampled:
    h = rng.uniform(1.8, 2.2)
    shade, foot = ((0.8, 0.5, 0.8), (0, h / 2, 0), 250), ((0.5, 0.05, 0.5), (0, -h / 2, 0), 100)
    return boxes(rng, ((0.1, h, 0.1), (0, 0, 0), 200), shade, foot)


def mixed(count_each: int, *, seed: int = 0) -> tuple[list[Sampled], np.ndarray]:
    rng = np.random.default_rng(seed)
    shapes = [build(rng) for build in (chair, table, lamp) for _ in range(count_each)]
    order = rng.permutation(len(shapes))
    return [shapes[i] for i in order], order // count_each


def grouped(shapes, **options):
    return last(group_shapes(shapes, rng=np.random.default_rng(7), **options))


def test_three_families_are_never_mixed_and_exemplars_are_members():
    shapes, kind = mixed(7)
    states = list(group_shapes(shapes, rng=np.random.default_rng(7)))
    assert [state.groups for state in states[:-1]] == [None] * (len(states) - 1)
    assert {state.phase for state in states} == {"reading shapes", "comparing shapes", "grouping"}
    groups = states[-1].groups
    assert len(groups) == 3 and states[-1].stop_reason
    for g in range(3):
        assert len(set(kind[groups.members(g)])) == 1 and groups.group[groups.exemplars[g]] == g
    sizes = np.bincount(groups.group)
    assert groups.names == ("Group 1", "Group 2", "Group 3") and (np.diff(sizes) <= 0).all()
    assert groups.embedding.shape == (21, 2) and np.allclose(groups.dissimilarity, groups.dissimilarity.T)


def test_embedding_keeps_families_together():
    shapes, kind = mixed(4)
    place = grouped(shapes).groups.embedding
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    np.fill_diagonal(apart, np.inf)
    assert (kind[apart.argmin(axis=1)] == kind).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_tiny_collections_are_one_group(count):
    shapes = mixed(1)[0][:count]
    groups = grouped(shapes).groups
    assert len(groups) == 1 and (groups.group == 0).all()
    assert groups.embedding.shape == (count, 2) and np.isfinite(groups.embedding).all()


def test_few_alike_stay_together_and_few_unlike_do_not():
    rng = np.random.default_rng(2)
    assert len(grouped([chair(rng) for _ in range(8)]).groups) == 1
    assert len(grouped([chair(rng) for _ in range(5)] + [lamp(rng) for _ in range(5)]).groups) == 2


def test_same_seed_same_bytes_with_any_workers():
    shapes, _ = mixed(5)
    alone = grouped(shapes).groups
    with ThreadPoolExecutor(2) as executor:
        together = grouped(shapes, executor=executor).groups
    for field in ("group", "exemplars", "embedding", "dissimilarity"):
        assert getattr(alone, field).tobytes() == getattr(together, field).tobytes()


@pytest.mark.parametrize("limit", [100, 10])
def test_exemplars_of_the_user_are_kept(monkeypatch, limit):
    monkeypatch.setattr(module, "ALL_PAIRS_UP_TO", limit)
    shapes, kind = mixed(5)
    chosen = [int(np.flatnonzero(kind == k)[-1]) for k in (2, 0, 1)]
    groups = grouped(shapes, exemplars=chosen).groups
    assert sorted(groups.exemplars) == sorted(chosen)
    assert (kind[groups.exemplars[groups.group]] == kind).all()


def test_large_collections_go_by_the_graph(monkeypatch):
    monkeypatch.setattr(module, "ALL_PAIRS_UP_TO", 10)
    monkeypatch.setattr(module, "GRAPH_NEIGHBOURS", 5)
    shapes, kind = mixed(8)
    state = grouped(shapes)
    assert state.groups.dissimilarity is None and state.groups.embedding.shape == (24, 2)
    for g in range(len(state.groups)):
        assert len(set(kind[state.groups.members(g)])) == 1


def test_similarity_graph_is_connected_even_across_far_clusters():
    places = np.concatenate([np.random.default_rng(0).random((6, 2)) + offset for offset in (0, 50, 500)])
    edges = similarity_graph(np.linalg.norm(places[:, None] - places, axis=2), 2)
    reached, grown = {0}, True
    while grown:
        more = {int(b) for a, b in edges if a in reached} | {int(a) for a, b in edges if b in reached}
        grown = not more <= reached
        reached |= more
    assert reached == set(range(18)) and (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_classical_scaling_recovers_a_plane():
    places = np.random.default_rng(1).random((12, 2))
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    found = classical_scaling(distance, 2)
    assert np.allclose(np.linalg.norm(found[:, None] - found, axis=2), distance, atol=1e-9)


def test_equal_distances_do_not_break_grouping():
    distance = 1.0 - np.eye(30)
    centres, reason = find_exemplars(distance, rng=np.random.default_rng(0))
    assert 1 <= len(centres) <= 5 and reason
    assert len(find_exemplars(np.zeros((30, 30)), rng=np.random.default_rng(0))[0]) == 1


def test_medoids_are_the_middles():
    places = np.array([0, 1, 2, 10, 11, 12, 13.0])
    assert np.array_equal(medoids(np.abs(places[:, None] - places), 2), [1, 4])


def test_shape_descriptor_tells_families_apart():
    shapes, kind = mixed(5)
    features = np.array([shape_descriptor(shape.points) for shape in shapes])
    apart = np.linalg.norm(features[:, None] - features, axis=2)
    np.fill_diagonal(apart, np.inf)
    assert (kind[apart.argmin(axis=1)] == kind).all()


def test_errors_name_the_argument():
    shapes = mixed(1)[0]
    with pytest.raises(ValueError, match="shapes: wanted at least one"):
        grouped([])
    for wrong in ([3], [-1], [0, 0]):
        with pytest.raises(ValueError, match="exemplars: wanted different indices from 0 to 2"):
            grouped(shapes, exemplars=wrong)
