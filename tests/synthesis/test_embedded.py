"""Embedded deformation: exact for rigid and affine motions, exact gradient, energy that never rises."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shapeforge.synthesis.embedded import Problem, build_graph, pre_align, solve_exactly, solve_quickly


def sheet_points(n: int = 900) -> np.ndarray:
    """Points of a bent strip of diagonal about one."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-0.5, 0.5, (2, n))
    return np.stack([u, 0.1 * np.sin(4 * u), 0.5 * v], axis=1)


def problem_for(points: np.ndarray, targets: np.ndarray, *, align: bool = True) -> tuple[Problem, np.ndarray]:
    graph = build_graph(points)
    matrix, offset = pre_align(points, targets) if align else (np.eye(3), np.zeros(3))
    rest = np.broadcast_to(matrix, (len(graph.nodes), 3, 3)).copy()
    strength = np.full(len(points), len(graph.nodes) / len(points))
    return Problem(graph, graph.basis(points), targets, strength, rest), graph.at_rest(matrix, offset)


def bent(points: np.ndarray, noise: float = 0.0) -> np.ndarray:
    """The points wound around a cylinder by 80 degrees."""
    angle = 1.4 * points[:, 0]
    radius = 1 / 1.4 + points[:, 1]
    turned = np.stack([radius * np.sin(angle), radius * np.cos(angle) - 1 / 1.4, points[:, 2]], axis=1)
    return turned + np.random.default_rng(1).normal(0, noise, points.shape)


@pytest.mark.parametrize("solve", [solve_exactly, solve_quickly])
def test_rigid_motion_is_reproduced_exactly(solve) -> None:
    points = sheet_points()
    targets = points @ Rotation.from_rotvec([0.4, -0.8, 0.3]).as_matrix().T + [0.3, -0.2, 0.1]
    problem, x = problem_for(points, targets)
    *_, state = solve(problem, x)
    np.testing.assert_allclose(problem.rows @ state.x, targets, atol=1e-7)
    assert problem.energy(state.x) < 1e-12


def test_rigid_motion_is_found_without_pre_alignment() -> None:
    points = sheet_points()
    targets = points @ Rotation.from_rotvec([0.4, -0.8, 0.3]).as_matrix().T + [0.3, -0.2, 0.1]
    problem, x = problem_for(points, targets, align=False)
    *_, state = solve_exactly(problem, x, steps=60, tolerance=1e-16)
    np.testing.assert_allclose(problem.rows @ state.x, targets, atol=1e-5)


def test_stretch_is_free_after_pre_alignment_and_costs_without() -> None:
    points = sheet_points()
    targets = points * [1.8, 1, 1]
    away = {}
    for align in (True, False):
        problem, x = problem_for(points, targets, align=align)
        *_, state = solve_exactly(problem, x)
        away[align] = np.linalg.norm(problem.rows @ state.x - targets, axis=1).mean()
    assert away[True] < 1e-6
    assert away[False] > 1e-3


def test_gradient_equals_finite_differences() -> None:
    rng = np.random.default_rng(2)
    points = sheet_points(120)
    graph = build_graph(points, n_nodes=12, n_neighbours=5)
    rest = np.eye(3) + rng.normal(0, 0.15, (12, 3, 3))
    problem = Problem(graph, graph.basis(points), bent(points), rng.uniform(0.1, 1, 120), rest)
    x = graph.at_rest(np.eye(3), np.zeros(3)) + rng.normal(0, 0.05, (48, 3))
    gradient, step = problem.gradient(x), 1e-5
    for i, d in zip(rng.integers(0, 48, 40), rng.integers(0, 3, 40), strict=True):
        move = np.zeros_like(x)
        move[i, d] = step
        slope = (problem.energy(x + move) - problem.energy(x - move)) / (2 * step)
        assert gradient[i, d] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_a_step_solves_the_whole_gauss_newton_system() -> None:
    """Also the positions, which are eliminated: against residuals differentiated numerically, all unknowns at once."""
    rng = np.random.default_rng(4)
    points = sheet_points(150)
    graph = build_graph(points, n_nodes=9, n_neighbours=4)
    rest = np.eye(3) + rng.normal(0, 0.1, (9, 3, 3))
    problem = Problem(graph, graph.basis(points), bent(points), rng.uniform(0.1, 1, 150), rest)
    x = graph.at_rest(np.eye(3), np.zeros(3)) + rng.normal(0, 0.05, (36, 3))

    def residuals(at: np.ndarray) -> np.ndarray:
        return np.sqrt(problem.weights.rotation) * problem._rotation_terms(at.reshape(3, 36).T)[0].reshape(-1)

    long, step = x.T.reshape(-1), 1e-6
    jacobian = np.stack([(residuals(long + d) - residuals(long - d)) / (2 * step) for d in step * np.eye(108)], axis=1)
    hessian = jacobian.T @ jacobian + np.kron(np.eye(3), problem.linear)
    expected = np.linalg.solve(hessian, -0.5 * problem.gradient(x).T.reshape(-1)).reshape(3, 36).T
    first = next(iter(solve_exactly(problem, x))).x - x
    length = (first * expected).sum() / (expected**2).sum()
    assert np.isclose(np.log2(length), np.round(np.log2(length)), atol=1e-4)  # halved until the energy falls
    np.testing.assert_allclose(first, length * expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_energy_never_rises_and_reaches_a_stationary_point() -> None:
    points = sheet_points()
    problem, x = problem_for(points, bent(points, noise=0.02))
    energies = [problem.energy(x)] + [s.energy for s in solve_exactly(problem, x, steps=40, tolerance=1e-12)]
    assert max(np.diff(energies)) <= 0
    *_, state = solve_exactly(problem, x, steps=40, tolerance=1e-12)
    assert state.energy == pytest.approx(problem.energy(state.x), rel=1e-12)
    assert np.abs(problem.gradient(state.x)).max() < 1e-3 * np.abs(problem.gradient(x)).max()
    assert state.stop_reason is not None


def test_preview_surrogate_never_rises_and_comes_close() -> None:
    points = sheet_points()
    targets = bent(points)
    problem, x = problem_for(points, targets)
    quick = list(solve_quickly(problem, x, steps=8))
    assert max(np.diff([s.energy for s in quick])) <= 1e-9 * quick[0].energy
    *_, final = solve_exactly(problem, x)
    before, preview, best = (
        np.linalg.norm(problem.rows @ at - targets, axis=1).mean() for at in (x, quick[1].x, final.x)
    )
    assert best < 0.25 * before
    assert preview < 1.25 * best


def test_basis_reproduces_affine_maps_and_sums_to_one() -> None:
    points = sheet_points(300)
    graph = build_graph(points, n_nodes=40)
    matrix, offset = np.array([[1.2, 0.1, 0], [0, 0.8, -0.3], [0.2, 0, 1]]), np.array([0.1, 0.2, 0.3])
    moved = graph.basis(points) @ graph.at_rest(matrix, offset)
    np.testing.assert_allclose(moved, points @ matrix.T + offset, atol=1e-12)


@pytest.mark.parametrize("n_points", [1, 2, 5])
def test_tiny_parts_move_without_complaint(n_points: int) -> None:
    points = sheet_points(n_points)
    problem, x = problem_for(points, points + [0.1, 0, 0])
    for solve in (solve_exactly, solve_quickly):
        *_, state = solve(problem, x)
        np.testing.assert_allclose(problem.rows @ state.x, points + [0.1, 0, 0], atol=1e-6)


def test_pre_align_is_exact_on_exact_flat_points_and_sober_on_noise() -> None:
    rng = np.random.default_rng(3)
    flat = rng.uniform(-0.3, 0.3, (50, 3)) * [1, 0, 1]
    rotation = Rotation.from_rotvec([0.5, 0.2, -0.4]).as_matrix()
    matrix, offset = pre_align(flat, flat @ rotation.T + 0.1)
    np.testing.assert_allclose(matrix, rotation, atol=1e-6)
    np.testing.assert_allclose(offset, 0.1, atol=1e-9)
    stick = rng.uniform(-1, 1, (60, 3)) * [0.01, 0.4, 0.01]
    matrix, _ = pre_align(stick, stick + rng.normal(0, 0.03, stick.shape))
    assert np.abs(matrix - np.eye(3)).max() < 0.3
    with pytest.raises(ValueError, match="target"):
        pre_align(flat[:0], flat[:0])
