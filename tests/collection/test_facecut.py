"""The face cut: exact on tiny problems, never rising, sound on soup, folds and faces without area."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from shapeforge.collection.facecut import (
    cut_faces,
    expand,
    face_graph,
    minimize_potts,
    minimize_some,
    potts_energy,
    surface_diagonal,
)
from shapeforge.collection.shape import Mesh


def grid(n: int, *, soup: bool = False, fold: int | None = None) -> Mesh:
    """A sheet of n x n unit quads, y = 0; ``soup`` gives each its own corners; ``fold`` bends it up at a column."""
    vertices, triangles, face = [], [], []
    for row, column in itertools.product(range(n), range(n)):
        quad = [(column, row), (column + 1, row), (column + 1, row + 1), (column, row + 1)]
        corners = [(x, 0.0, z) if fold is None or x <= fold else (fold, x - fold, z) for x, z in quad]
        base = len(vertices)
        vertices += corners
        triangles += [(base, base + 1, base + 2), (base, base + 2, base + 3)]
        face += [row * n + column] * 2
    points = np.array(vertices, float)
    index = np.array(triangles)
    if not soup:
        points, place = np.unique(points, axis=0, return_inverse=True)
        index = place.reshape(-1)[index]
    return Mesh(points, index, np.array(face), n * n)


def random_problem(rng: np.random.Generator, n: int, n_labels: int):
    unary = rng.integers(0, 100, (n, n_labels))
    pairs = np.array([pair for pair in itertools.combinations(range(n), 2) if rng.random() < 0.6]).reshape(-1, 2)
    return unary, pairs, rng.integers(0, 60, len(pairs))


def best_by_enumeration(unary, pairs, pairwise) -> int:
    n, n_labels = unary.shape
    everything = itertools.product(range(n_labels), repeat=n)
    return min(potts_energy(np.array(labels), unary, pairs, pairwise) for labels in everything)


@pytest.mark.parametrize("seed", range(20))
def test_two_labels_are_exact(seed):
    problem = random_problem(np.random.default_rng(seed), 9, 2)
    assert potts_energy(minimize_potts(*problem), *problem) == best_by_enumeration(*problem)


def test_vertices_that_no_face_uses_change_nothing():
    """However far away they lie: what is welded, and how near components are linked, goes by the surface."""
    sheets = grid(4, soup=True)
    apart = np.concatenate([sheets.vertices, sheets.vertices + [0.0, 0.1, 0.0]])
    mesh = Mesh(apart, np.concatenate([sheets.triangles, sheets.triangles + 64]), np.repeat(np.arange(32), 2), 32)
    stray = np.concatenate([[[-1e4, 0.0, 0.0]], apart, [[1e4, 1e4, 1e4], [1e300, 0.0, 0.0]]])
    graph, same = face_graph(mesh), face_graph(Mesh(stray, mesh.triangles + 1, mesh.face_of_triangle, 32))
    assert len(graph.pairs) > 2 * 24
    np.testing.assert_array_equal(same.pairs, graph.pairs)
    np.testing.assert_array_equal(same.border, graph.border)
    assert surface_diagonal(mesh) == pytest.approx(np.sqrt(32.01))


@pytest.mark.parametrize("seed", range(20))
def test_one_expansion_is_the_best_of_all_moves(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, 9, 4)
    labels, alpha = rng.integers(0, 4, 9), int(rng.integers(0, 4))
    moves = [np.where(np.array(take), alpha, labels) for take in itertools.product((False, True), repeat=9)]
    best = min(potts_energy(move, *problem) for move in moves)
    assert potts_energy(expand(labels, alpha, *problem), *problem) == best <= potts_energy(labels, *problem)


@pytest.mark.parametrize("seed", range(20))
def test_some_nodes_are_exact_where_the_others_keep_their_labels(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, 10, 2)
    labels, asked = rng.integers(0, 2, 10), rng.random(10) < 0.5
    found = minimize_some(asked, labels, *problem)
    assert np.array_equal(found[~asked], labels[~asked])
    best = potts_energy(labels, *problem)
    for some in itertools.product((0, 1), repeat=int(asked.sum())):
        trial = labels.copy()
        trial[asked] = some
        best = min(best, potts_energy(trial, *problem))
    assert potts_energy(found, *problem) == best


def test_three_labels_reach_the_minimum_nearly_always_and_never_twice_it():
    hits = 0
    for seed in range(30):
        problem = random_problem(np.random.default_rng(seed), 7, 3)
        reached, best = potts_energy(minimize_potts(*problem), *problem), best_by_enumeration(*problem)
        assert best <= reached <= 2 * best
        hits += reached == best
    assert hits >= 26


def test_no_expansion_raises_the_energy_on_a_large_problem():
    rng = np.random.default_rng(3)
    mesh = grid(40)
    graph = face_graph(mesh)
    unary, pairwise = rng.integers(0, 1000, (1600, 6)), np.full(len(graph.pairs), 300)
    labels, worst = unary.argmin(axis=1), 0
    for alpha in [0, 1, 2, 3, 4, 5] * 2:
        after = expand(labels, alpha, unary, graph.pairs, pairwise)
        rise = potts_energy(after, unary, graph.pairs, pairwise) - potts_energy(labels, unary, graph.pairs, pairwise)
        worst, labels = max(worst, rise), after
    assert worst <= 0


def noisy_halves(mesh: Mesh, n: int, flips: float) -> tuple[np.ndarray, np.ndarray]:
    """Truth (left and right half of the sheet) and costs that are wrong on some faces."""
    truth = (np.arange(n * n) % n >= n // 2).astype(int)
    wrong = np.random.default_rng(1).random(n * n) < flips
    seen = np.where(wrong, 1 - truth, truth)
    return truth, np.where(np.arange(3) == seen[:, None], 0.2, 2.0)


@pytest.mark.parametrize("soup", [False, True])
def test_noise_is_removed_whether_corners_are_shared_or_not(soup):
    mesh = grid(30, soup=soup)
    truth, cost = noisy_halves(mesh, 30, 0.15)
    assert (cost.argmin(axis=1) == truth).mean() < 0.9
    assert (cut_faces(mesh, cost, weight=60.0) == truth).mean() > 0.98
    assert np.array_equal(cut_faces(mesh, cost, weight=0.0), cost.argmin(axis=1))


def test_size_of_the_mesh_does_not_matter():
    mesh = grid(12)
    _, cost = noisy_halves(mesh, 12, 0.2)
    assert np.array_equal(cut_faces(mesh, cost), cut_faces(mesh.moved(mesh.vertices * 731.0 + 5), cost))


def test_the_border_settles_in_the_fold():
    mesh = grid(20, fold=8)
    column = np.arange(400) % 20
    # Left is 0, right is 1, and between columns 5 and 12 nobody knows.
    cost = np.zeros((400, 2))
    cost[column < 5, 1] = cost[column > 12, 0] = 3.0
    cost[(column >= 5) & (column <= 12), 0] = 1e-3
    assert np.array_equal(cut_faces(mesh, cost), (column >= 8).astype(np.int32))


def test_non_manifold_edges_and_doubled_faces_are_adjacent():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], float)
    triangles = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [0, 2, 1]])
    graph = face_graph(Mesh(vertices, triangles, np.arange(4), 4))
    assert {tuple(pair) for pair in graph.pairs.tolist()} == set(itertools.combinations(range(4), 2))
    assert (graph.border > 0).all()


def test_loose_component_joins_what_it_touches():
    """A screw: a tiny separate sheet just above one half, whose own costs hardly decide."""
    sheet, screw = grid(10), grid(2, soup=True)
    small = screw.vertices * 0.1 + [2.4, 0.05, 4.4]
    mesh = Mesh(
        np.concatenate([sheet.vertices, small]),
        np.concatenate([sheet.triangles, screw.triangles + len(sheet.vertices)]),
        np.concatenate([sheet.face_of_triangle, screw.face_of_triangle + 100]),
        104,
    )
    truth, cost = noisy_halves(sheet, 10, 0.0)
    cost = np.concatenate([cost, np.tile([0.5, 0.4, 0.5], (4, 1))])
    labels = cut_faces(mesh, cost)
    assert np.array_equal(labels[:100], truth) and (labels[100:] == labels[42]).all()


def test_faces_without_area_or_triangles_get_a_label():
    mesh = grid(6)
    triangles = np.concatenate([mesh.triangles, [[0, 0, 1], [2, 2, 2]]])
    broken = Mesh(mesh.vertices, triangles, np.concatenate([mesh.face_of_triangle, [36, 37]]), 39)
    _, cost = noisy_halves(mesh, 6, 0.0)
    cost = np.concatenate([cost, [[1.0, 0, 2], [2, 1, 0], [0, 1, 2]]])
    labels = cut_faces(broken, cost)
    assert labels.dtype == np.int32 and labels.shape == (39,)
    assert labels[36] == labels[0], "lies on an edge of face 0"
    assert labels[38] == 0, "owns no triangle: its cheapest part"
    empty = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros(1, np.int64), 1)
    assert np.array_equal(cut_faces(empty, np.array([[1.0, 0.5]])), [1])


def test_strong_evidence_survives_smoothing():
    mesh = grid(30)
    _, cost = noisy_halves(mesh, 30, 0.0)
    cost[95] = [1e9, 1e9, 0]
    assert cut_faces(mesh, cost)[95] == 2


def test_sure_faces_are_not_asked_and_the_others_settle_beside_them():
    """A sheet of two halves: noise among unsure faces goes as without ``sure``, a sure one stays what it is."""
    mesh, rng = grid(20), np.random.default_rng(1)
    left = np.arange(400) % 20 < 10
    cost = np.where(left[:, None], [0.0, 1.0], [1.0, 0.0])
    noisy = rng.random(400) < 0.1
    cost[noisy] = cost[noisy, ::-1]
    odd = 5 * 20 + 4
    cost[odd] = [4.0, 0.0]
    asked, kept = cut_faces(mesh, cost, weight=100.0), cut_faces(mesh, cost, weight=100.0, sure=3.0)
    assert np.array_equal(asked, ~left) and asked[odd] == 0
    assert kept[odd] == 1 and np.array_equal(np.delete(kept, odd), np.delete(asked, odd))


def test_errors_name_the_argument():
    mesh = grid(2)
    with pytest.raises(ValueError, match=r"cost: wanted \(4, L\)"):
        cut_faces(mesh, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="cost: wanted finite"):
        cut_faces(mesh, np.full((4, 2), np.inf))
    with pytest.raises(ValueError, match="weight: wanted"):
        cut_faces(mesh, np.zeros((4, 2)), weight=-1.0)
