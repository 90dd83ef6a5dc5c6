"""The mean-field updates: equal to the oracles, and never up the free energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.energy import free_energy
from shapeforge.deformation.factors import (
    DESCRIPTOR_WEIGHT,
    LOG_EPSILON,
    NORMAL_WEIGHT,
    attraction,
    initial_covariances,
)
from shapeforge.deformation.templates import pair_graph, template_from_points
from shapeforge.deformation.updates import (
    POINT_CANDIDATES,
    TEMPLATE_CANDIDATES,
    Problem,
    candidates_without,
    find_candidates,
    mapped_normals,
    mapped_template,
    update_correspondences,
    update_deformations,
    update_maps,
    update_segmentation,
)
from tests import oracles

N_PARTS = 3


def toy(seed: int, n_points: int = 90, n_template: int = 60):
    """A small random problem: three blobs of template points, a moved and noisy surface."""
    rng = np.random.default_rng(seed)
    label = np.sort(rng.integers(0, N_PARTS, n_template)).astype(np.int32)
    template_points = rng.normal(scale=0.08, size=(n_template, 3)) + label[:, None] * 0.2
    descriptors = rng.uniform(size=(n_template, 10))
    templates = template_from_points(
        template_points, rng.normal(size=(n_template, 3)), descriptors, label, ("a", "b", "c"), "toy"
    )
    pick = rng.integers(0, n_template, n_points)
    points = templates.points[pick] * 1.1 + rng.normal(scale=0.02, size=(n_points, 3))
    neighbours = rng.integers(-1, n_points, size=(n_points, 5)).astype(np.int32)
    neighbours[neighbours == np.arange(n_points)[:, None]] = -1
    offsets, index = pair_graph(neighbours)
    evidence = np.full(n_points, -1, np.int32)
    evidence[:4] = templates.label[pick[:4]]
    normals = rng.normal(size=(n_points, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    problem = Problem(
        points, normals, descriptors[pick] + rng.normal(scale=0.05, size=(n_points, 10)), offsets, index, evidence
    )
    segmentation = rng.dirichlet(np.ones(N_PARTS), n_points)
    segmentation[:4] = np.eye(N_PARTS)[evidence[:4]]
    beliefs = Beliefs(
        0, templates.points + rng.normal(scale=0.03, size=(n_template, 3)), rng.uniform(1e-5, 1e-4, (n_template, 3)),
        np.tile(np.eye(3) * 1.05, (N_PARTS, 1, 1)), np.zeros((N_PARTS, 3)), segmentation, np.ones(N_PARTS, bool),
        evidence, np.zeros(N_PARTS),
    )  # fmt: skip
    return problem, templates, beliefs, initial_covariances()


def test_correspondences_equal_the_oracle():
    problem, templates, beliefs, covariances = toy(0)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    got = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    pairs = np.split(candidates.template_index, candidates.offsets[1:-1])
    wanted = oracles.correspondences(
        problem.points, problem.descriptors, problem.normals, beliefs.deformed, beliefs.variance,
        templates.descriptors, mapped_normals(templates, beliefs), templates.label, pairs, beliefs.segmentation,
        covariances.unary, DESCRIPTOR_WEIGHT / covariances.descriptor, LOG_EPSILON, NORMAL_WEIGHT,
    )  # fmt: skip
    # logits are in single precision
    np.testing.assert_allclose(got.q, np.concatenate(wanted), rtol=3e-5, atol=1e-9)
    sums = np.add.reduceat(got.q, candidates.offsets[:-1])
    np.testing.assert_allclose(sums, 1.0, atol=1e-6)
    np.testing.assert_allclose(got.part_share.sum(axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(got.mass, np.bincount(candidates.template_index, got.q, templates.n_points), rtol=1e-12)


def test_sparse_equals_dense_when_every_pair_is_kept(monkeypatch):
    problem, templates, beliefs, covariances = toy(1)
    monkeypatch.setattr("shapeforge.deformation.updates.POINT_CANDIDATES", templates.n_points)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    assert len(candidates.template_index) == len(problem.points) * templates.n_points
    assert (candidates.template_index[: templates.n_points] == np.arange(templates.n_points)).all()


def test_candidates_leave_out_inactive_parts_and_hold_no_pair_twice():
    problem, templates, beliefs, covariances = toy(2)
    alive = templates.label != 1
    beliefs = replace(beliefs, active=np.array([True, False, True]))
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    assert alive[candidates.template_index].all()
    for row in np.split(candidates.template_index, candidates.offsets[1:-1]):
        assert (np.diff(row) > 0).all()


def test_deformations_reach_the_solution_of_the_linear_system():
    problem, templates, beliefs, covariances = toy(3)
    graph = pair_graph(templates.neighbours)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    got = update_deformations(templates, graph, correspondence, beliefs, covariances, sweeps=4000)
    owner = np.repeat(np.arange(templates.n_points), np.diff(graph[0]))
    edges = [(a, b) for a, b in zip(owner, graph[1], strict=True) if a < b]
    wanted = oracles.deformations_fixed_point(
        correspondence.mass, correspondence.first_moment, mapped_template(templates, beliefs), edges,
        covariances.unary, covariances.smooth,
    )  # fmt: skip
    np.testing.assert_allclose(got.deformed, wanted, atol=1e-9)


def test_a_prior_pulls_every_point_to_its_mean_in_proportion_to_its_precision():
    problem, templates, beliefs, covariances = toy(4)
    graph = pair_graph(templates.neighbours)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    mean = templates.points + 0.3
    free = update_deformations(templates, graph, correspondence, beliefs, covariances, sweeps=500)
    none = update_deformations(
        templates, graph, correspondence, beliefs, covariances, (mean, np.zeros_like(mean)), sweeps=500
    )
    strong = update_deformations(
        templates, graph, correspondence, beliefs, covariances, (mean, np.full_like(mean, 1e9)), sweeps=500
    )
    np.testing.assert_allclose(none.deformed, free.deformed, atol=1e-9)
    np.testing.assert_allclose(strong.deformed, mean, atol=1e-4)


def test_segmentation_equals_the_oracle_point_by_point():
    problem, templates, beliefs, covariances = toy(5)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    beliefs = replace(beliefs, active=np.array([True, True, False]))
    start = np.where(beliefs.active, beliefs.segmentation + 1e-9, 0.0)
    beliefs = replace(beliefs, segmentation=start / start.sum(axis=1, keepdims=True))
    pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)
    got = update_segmentation(problem, correspondence, beliefs, pull, sweeps=1).segmentation
    neighbours = np.split(problem.neighbour, problem.offsets[1:-1])
    pulls = np.split(pull, problem.offsets[1:-1])
    wanted = beliefs.segmentation.copy()
    for p in range(len(wanted)):
        if problem.evidence[p] >= 0:
            wanted[p] = np.eye(N_PARTS)[problem.evidence[p]]
        else:
            wanted[p] = oracles.segmentation_of_point(
                p, correspondence.part_share, wanted, neighbours, pulls, LOG_EPSILON, beliefs.active
            )
    np.testing.assert_allclose(got, wanted, atol=1e-10)


def test_a_leaning_multiplies_the_odds_and_painted_points_do_not_hear_it():
    problem, templates, beliefs, covariances = toy(6)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    leaning = np.random.default_rng(0).normal(scale=2.0, size=beliefs.segmentation.shape)
    alone = np.zeros(len(problem.neighbour))  # φ5 left out
    plain = update_segmentation(problem, correspondence, beliefs, alone).segmentation
    leant = update_segmentation(replace(problem, leaning=leaning), correspondence, beliefs, alone).segmentation
    wanted = plain * np.exp(leaning)
    painted = problem.evidence >= 0
    np.testing.assert_allclose(leant[~painted], (wanted / wanted.sum(axis=1, keepdims=True))[~painted], atol=1e-10)
    np.testing.assert_array_equal(leant[painted], plain[painted])


@pytest.mark.parametrize("leans", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_no_exact_update_raises_the_free_energy(seed, leans):
    problem, templates, beliefs, covariances = toy(seed)
    if leans:
        problem = replace(problem, leaning=np.random.default_rng(seed).normal(size=beliefs.segmentation.shape))
    graph = pair_graph(templates.neighbours)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)

    pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)

    def energy():
        return free_energy(problem, templates, graph, candidates, correspondence, beliefs, covariances)

    track = [energy()]
    for _ in range(5):
        correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
        track.append(energy())
        beliefs = update_segmentation(problem, correspondence, beliefs, pull)
        track.append(energy())
        beliefs = update_deformations(templates, graph, correspondence, beliefs, covariances)
        track.append(energy())
    steps = np.diff(track)
    assert steps.max() <= 1e-9 * abs(track[0]), f"worst step {steps.argmax()}: {steps.max():.3g} nats"
    assert track[-1] < track[0] - 1.0


def test_part_maps_recover_an_affine_change_of_each_part():
    problem, templates, beliefs, covariances = toy(7, n_points=600, n_template=240)
    truth = np.array([[1.3, 0.1, 0.0], [0.0, 0.8, 0.0], [0.0, 0.05, 1.1]])
    points = templates.points @ truth.T + 0.02
    problem = replace(problem, points=points, normals=templates.normals,
                      descriptors=templates.descriptors, offsets=np.zeros(241, np.int64),
                      neighbour=np.zeros(0, np.int32), evidence=np.full(240, -1, np.int32))  # fmt: skip
    correspondence = update_correspondences(
        problem, templates,
        find_candidates(problem, templates, replace(beliefs, deformed=points), covariances.descriptor),
        replace(beliefs, deformed=points, segmentation=np.full((240, N_PARTS), 1 / 3), evidence=problem.evidence),
        np.full(3, 1e-6),
    )  # fmt: skip
    for _ in range(30):  # the ridge leans on the previous map, so it takes a few rounds
        beliefs = update_maps(templates, correspondence, beliefs)
    for part in range(N_PARTS):
        np.testing.assert_allclose(beliefs.maps[part], truth, atol=0.02)


def test_sparse_updates_equal_dense_ones_when_every_pair_is_kept(monkeypatch):
    """Dropping no pair, correspondence over lists of pairs is the full P x K softmax."""
    problem, templates, beliefs, covariances = toy(8)
    monkeypatch.setattr("shapeforge.deformation.updates.POINT_CANDIDATES", templates.n_points)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    got = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    apart = beliefs.deformed[None] - problem.points[:, None]
    logit = -0.5 * (apart**2 + beliefs.variance) @ (1 / covariances.unary)
    differs = templates.descriptors[None] - problem.descriptors[:, None]
    logit -= 0.5 * differs**2 @ (DESCRIPTOR_WEIGHT / covariances.descriptor)
    logit -= NORMAL_WEIGHT * (1 - np.abs(problem.normals @ mapped_normals(templates, beliefs).T))
    logit += LOG_EPSILON * (1 - beliefs.segmentation[:, templates.label])
    wanted = np.exp(logit - logit.max(axis=1, keepdims=True))
    wanted /= wanted.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(got.q.reshape(wanted.shape), wanted, rtol=3e-5, atol=1e-9)  # in single precision
    np.testing.assert_allclose(got.mass, wanted.sum(axis=0), rtol=1e-5)
    np.testing.assert_allclose(got.first_moment, wanted.T @ problem.points, rtol=1e-5, atol=1e-6)


def test_candidates_are_the_nearest_both_ways():
    problem, templates, beliefs, covariances = toy(9, n_points=400, n_template=300)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    pairs = np.zeros((400, 300), bool)
    pairs[np.repeat(np.arange(400), np.diff(candidates.offsets)), candidates.template_index] = True
    distance = np.linalg.norm(problem.points[:, None] - beliefs.deformed[None], axis=2)
    by_point = distance <= np.sort(distance, axis=1)[:, POINT_CANDIDATES - 1 : POINT_CANDIDATES]
    by_template = distance <= np.sort(distance, axis=0)[TEMPLATE_CANDIDATES - 1]
    lonely = by_template.sum(axis=1, keepdims=True) < POINT_CANDIDATES
    assert (pairs == (by_template | (by_point & lonely))).all()
    assert 0 < lonely.mean() < 1
    assert (pairs & by_point).sum() > 0.95 * by_point.sum()  # what is left out is far among a sample's nearest


def test_candidates_of_a_trial_lose_the_part_and_samples_left_with_few_look_again():
    problem, templates, beliefs, covariances = toy(12, n_points=400, n_template=300)
    before = find_candidates(problem, templates, beliefs, covariances.descriptor)
    beliefs = replace(beliefs, active=np.array([True, False, True]))
    got = candidates_without(problem, templates, before, beliefs, covariances.descriptor)
    fresh = find_candidates(problem, templates, beliefs, covariances.descriptor)
    alive = templates.label != 1
    costs = {}
    for p, (old, new, afresh) in enumerate(
        zip(*(np.split(c.template_index, c.offsets[1:-1]) for c in (before, got, fresh)), strict=True)
    ):
        assert (np.diff(new) > 0).all() and alive[new].all()
        assert set(old[alive[old]]) <= set(new) <= set(afresh) | set(old)
        nearest = np.argsort(np.linalg.norm(problem.points[p] - beliefs.deformed, axis=1) + 9.0 * ~alive)
        if alive[old].sum() < POINT_CANDIDATES:
            assert set(nearest[:POINT_CANDIDATES]) <= set(new)
        else:
            assert set(new) == set(old[alive[old]])
        costs |= {(p, k): cost for k, cost in zip(afresh, fresh.costs[slice(*fresh.offsets[p : p + 2])], strict=True)}
    for p in range(400):
        for c in range(got.offsets[p], got.offsets[p + 1]):
            wanted = costs.get((p, got.template_index[c]))
            assert wanted is None or np.isclose(got.costs[c], wanted, atol=1e-10)


def test_pairs_of_neighbours_are_symmetric_and_none_is_there_twice():
    rng = np.random.default_rng(3)
    neighbours = rng.integers(-1, 40, size=(40, 6)).astype(np.int32)
    offsets, index = pair_graph(neighbours)
    wanted = np.zeros((40, 40), bool)
    for p, row in enumerate(neighbours):
        for other in row[row >= 0]:
            wanted[p, other] = wanted[other, p] = True
    for p in range(40):
        assert (index[offsets[p] : offsets[p + 1]] == np.flatnonzero(wanted[p])).all()


def test_a_part_whose_mass_is_on_one_point_keeps_its_map():
    problem, templates, beliefs, covariances = toy(0)
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    correspondence = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    mass = np.where(np.arange(templates.n_points) == np.flatnonzero(templates.label == 1)[0], 2.0, 0.0)
    target = 2.0 * templates.points * (mass > 0)[:, None]
    alone = replace(correspondence, mass=mass, first_moment=target)
    got = update_maps(templates, alone, beliefs)
    np.testing.assert_allclose(got.maps[1], beliefs.maps[1], atol=1e-9)
