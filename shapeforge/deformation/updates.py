"""The mean-field updates of one shape (supplement 1), each a public step; and what a shape adds to the shared sums."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection.points import nearest_points
from shapeforge.collection.shape import Shape
from shapeforge.deformation import _kernels, _kernels_pairs, _kernels_soft
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import DESCRIPTOR_WEIGHT, LOG_EPSILON, NORMAL_WEIGHT, Covariances
from shapeforge.deformation.templates import PartTemplates, pair_graph

POINT_CANDIDATES = 12
TEMPLATE_CANDIDATES = 40
MAP_RIDGE = 0.05
SMOOTHING_SWEEPS = 10
QUIET = 1e-4
"""Change of a label probability of which the neighbours need not hear within the same update."""


@runtime_checkable
class GaussianOnDeformation(Protocol):
    """A prior on D of a shape: ``prior(shape index, template index) -> (mean (K,3), precision (K,3)) or None``."""

    def __call__(self, shape: int, template: int) -> tuple[np.ndarray, np.ndarray] | None: ...


@dataclass(frozen=True, eq=False)
class Problem:
    """One shape as the updates see it: contiguous arrays, the symmetric neighbourhood graph, painted evidence.

    ``leaning`` (nats per point and part) is soft evidence: what was known of the labels before the fit, if anything.
    """

    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    descriptors: Float[np.ndarray, "P d"]
    offsets: Int[np.ndarray, " P1"]
    neighbour: Int[np.ndarray, " M"]
    evidence: Int[np.ndarray, " P"]
    leaning: Float[np.ndarray, "P L"] | None = None

    @cached_property
    def spacing(self) -> float:
        """Mean distance of a sample to the next one (diagonals)."""
        return float(nearest_points(self.points, self.points[::8], 2)[1].max(axis=1).mean())

    @cached_property
    def pair_squares(self) -> Float[np.ndarray, " d"]:
        """Squared descriptor differences summed over the neighbour pairs, both directions (d,): for Σ5."""
        return _kernels.pair_squares(self.offsets, self.neighbour, self.descriptors)


@dataclass(frozen=True, eq=False)
class Candidates:
    """The sparse pairs (p, k) that carry probability, in CSR over points, with φ3's cost of each pair."""

    offsets: Int[np.ndarray, " P1"]
    template_index: Int[np.ndarray, " M"]
    costs: Float[np.ndarray, " M"]


@dataclass(frozen=True, eq=False)
class Correspondence:
    """q[p,k] over candidates, and its sums: part share (P,L), mass (K,) and first moment (K,3) of template points."""

    q: Float[np.ndarray, " M"]
    part_share: Float[np.ndarray, "P L"]
    mass: Float[np.ndarray, " K"]
    first_moment: Float[np.ndarray, "K 3"]


def make_problem(shape: Shape, faces: np.ndarray | None = None, leaning: np.ndarray | None = None) -> Problem:
    """Arrays of a shape for the updates; ``faces`` are painted part labels per face record (-1: not painted)."""
    offsets, neighbour = pair_graph(shape.neighbours)
    evidence = np.full(shape.n_points, -1, np.int32)
    if faces is not None:
        evidence = np.asarray(faces)[shape.face_of_point].astype(np.int32)
    return Problem(
        np.ascontiguousarray(shape.points, np.float64), np.ascontiguousarray(shape.normals, np.float64),
        np.ascontiguousarray(shape.descriptors, np.float64), offsets, neighbour, evidence,
        leaning,
    )  # fmt: skip


def leaning_to(seed: Float[np.ndarray, "P L"] | None, weight: float = 1.0) -> Float[np.ndarray, "P L"] | None:
    """Soft evidence (nats, P x L) that label probabilities proposed for a shape are, with this power; None of none."""
    return None if seed is None else weight * np.log(np.asarray(seed, np.float64) + 1e-6)


def find_candidates(
    problem: Problem, templates: PartTemplates, beliefs: Beliefs, descriptor: Float[np.ndarray, " d"]
) -> Candidates:
    """Sparsity of q (supplement): template points keep their nearest samples, samples their nearest template points.

    The latter are looked for where fewer template points have chosen the sample than it may choose: elsewhere they are
    among those.  Only template points of active parts take part.  The normals of the template are carried along by its
    part maps.
    """
    rows = np.flatnonzero(beliefs.alive(templates.label)).astype(np.int32)
    found = nearest_points(problem.points, beliefs.deformed[rows], TEMPLATE_CANDIDATES)[0]
    by_template = np.full((templates.n_points, found.shape[1]), -1, np.int32)
    by_template[rows] = found
    lonely = np.flatnonzero(np.bincount(found.reshape(-1), minlength=len(problem.points)) < POINT_CANDIDATES)
    own = rows[nearest_points(beliefs.deformed[rows], problem.points[lonely], POINT_CANDIDATES)[0]]
    by_point = np.full((len(problem.points), own.shape[1]), -1, np.int32)
    by_point[lonely] = own
    offsets, index = _kernels_pairs.merge_pairs(by_point, by_template, len(problem.points))
    return _priced(problem, templates, beliefs, descriptor, offsets, index, np.full(len(index), np.nan))


def candidates_without(
    problem: Problem,
    templates: PartTemplates,
    candidates: Candidates,
    beliefs: Beliefs,
    descriptor: Float[np.ndarray, " d"],
) -> Candidates:
    """Candidates found for more parts than are active now, by the same maps: without those that are not.

    Only samples left with few look for their nearest template points again; pairs that stay cost the same.
    """
    alive = beliefs.alive(templates.label)
    left = np.concatenate([[0], np.cumsum(alive[candidates.template_index])])[candidates.offsets]
    had = np.diff(candidates.offsets)
    affected = np.flatnonzero(np.diff(left) < np.minimum(had, POINT_CANDIDATES))
    rows = np.flatnonzero(alive).astype(np.int32)
    nearest = rows[nearest_points(beliefs.deformed[rows], problem.points[affected], POINT_CANDIDATES)[0]]
    pairs = _kernels_pairs.refilled_pairs(
        candidates.offsets, candidates.template_index, candidates.costs, alive, affected, nearest
    )
    return _priced(problem, templates, beliefs, descriptor, *pairs)


def _priced(problem, templates, beliefs, descriptor, offsets: np.ndarray, index: np.ndarray, costs) -> Candidates:
    """The pairs with φ3's cost of each; computed where it is NaN in ``costs`` (M,), which are written to."""
    scale = np.sqrt(0.5 * DESCRIPTOR_WEIGHT / descriptor)
    _kernels_pairs.pair_costs(
        offsets, index, problem.descriptors * scale, templates.descriptors * scale, problem.normals,
        mapped_normals(templates, beliefs), NORMAL_WEIGHT, costs,
    )  # fmt: skip
    return Candidates(offsets, index, costs)


def mapped_normals(templates: PartTemplates, beliefs: Beliefs) -> Float[np.ndarray, "K 3"]:
    """Unit normals of the template under the inverse transpose of the shape's part maps (K, 3)."""
    return _kernels.carried_normals(beliefs.maps, templates.label, templates.normals)


def update_correspondences(
    problem: Problem, templates: PartTemplates, candidates: Candidates, beliefs: Beliefs, unary: Float[np.ndarray, " 3"]
) -> Correspondence:
    """q[p,k] (supplement, correspondence update): softmax over the candidates of every sample."""
    precision = 1.0 / unary
    n_points, n_template = len(problem.points), templates.n_points
    q = np.empty(len(candidates.template_index))
    share = np.empty((n_points, templates.n_parts))
    mass, moment = np.empty(n_template), np.empty((n_template, 3))
    _kernels_soft.correspond(
        candidates.offsets, candidates.template_index, candidates.costs, problem.points, beliefs.deformed,
        0.5 * beliefs.variance @ precision, precision, templates.label, beliefs.segmentation, LOG_EPSILON,
        q, share, mass, moment,
    )  # fmt: skip
    return Correspondence(q, share, mass, moment)


def update_segmentation(
    problem: Problem, correspondence: Correspondence, beliefs: Beliefs, pull: Float[np.ndarray, " M"], sweeps: int = 2
) -> Beliefs:
    """s[p,l] (supplement, segmentation update), Gauss-Seidel over the symmetric neighbour pairs; painted points stay.

    ``pull`` is φ5's logit Φ of every pair (``factors.attraction``).
    """
    segmentation = beliefs.segmentation.copy()
    share = correspondence.part_share
    if problem.leaning is not None:  # φ4 is ln ε times the share of the other parts: a leaning adds to the own share
        share = share - problem.leaning / LOG_EPSILON
    _kernels.segment(
        share, problem.offsets, problem.neighbour, pull, LOG_EPSILON, beliefs.active,
        problem.evidence, sweeps, QUIET, segmentation,
    )  # fmt: skip
    return replace(beliefs, segmentation=segmentation)


def mapped_template(templates: PartTemplates, beliefs: Beliefs) -> Float[np.ndarray, "K 3"]:
    """Template points under the shape's linear map of their part, A[part]·Y (offsets cancel in φ2)."""
    return _kernels.carried(beliefs.maps, templates.label, templates.points)


def update_deformations(
    templates: PartTemplates,
    graph: tuple[np.ndarray, np.ndarray],
    correspondence: Correspondence,
    beliefs: Beliefs,
    covariances: Covariances,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    sweeps: int = SMOOTHING_SWEEPS,
) -> Beliefs:
    """⟨D⟩ and its variance (supplement, deformation update), with φ2 taken under the shape's own part maps.

    ``prior`` is a Gaussian (mean (K,3), precision (K,3)) multiplied onto D (joint analysis and synthesis, §5).
    """
    offsets, neighbour = graph
    unary, smooth = 1.0 / covariances.unary, 1.0 / covariances.smooth
    weight, pull = correspondence.mass[:, None] * unary, correspondence.first_moment * unary
    if prior is not None:  # one more observation of each template point, axis by axis
        mean, strength = prior
        weight, pull = weight + strength, pull + strength * mean
    deformed = beliefs.deformed.copy()
    _kernels.deform(weight, pull, mapped_template(templates, beliefs), offsets, neighbour, smooth, sweeps, deformed)
    precision = weight + np.diff(offsets)[:, None] * smooth
    variance = 1.0 / np.maximum(precision, 1e-12)
    return replace(beliefs, deformed=deformed, variance=variance)


def update_maps(templates: PartTemplates, correspondence: Correspondence, beliefs: Beliefs) -> Beliefs:
    """One linear map per part by q-weighted least squares of the surface on the template, ridge towards the last one.

    The paper has no such map: its φ2 compares with Y in the exemplar's own frame and so undoes the affine start.
    """
    maps, offsets = beliefs.maps.copy(), beliefs.offsets.copy()
    target = correspondence.first_moment / np.maximum(correspondence.mass, 1e-12)[:, None]
    for part in np.flatnonzero(beliefs.active):
        rows = templates.label == part
        weight = correspondence.mass[rows]
        total = weight.sum()
        if rows.sum() < 4 or total < 1.0:
            continue
        y, x = templates.points[rows], target[rows]
        # not by BLAS, whose sums over many rows depend on its number of threads
        y_mean, x_mean = (np.einsum("n,ni->i", weight, one) / total for one in (y, x))
        yc, xc = y - y_mean, x - x_mean
        second = np.einsum("n,ni,nj->ij", weight, yc, yc)
        # all mass on one template point says nothing of the map: the ridge then keeps the last one
        ridge = MAP_RIDGE * max(np.trace(second) / 3, 1e-9) * np.eye(3)
        cross = np.einsum("n,ni,nj->ij", weight, xc, yc)
        maps[part] = (cross + maps[part] @ ridge) @ np.linalg.inv(second + ridge)
        offsets[part] = x_mean - maps[part] @ y_mean
    return replace(beliefs, maps=maps, offsets=offsets)


@dataclass(frozen=True, eq=False)
class Summary:
    """Sufficient statistics of one shape for Σ1 to Σ5, for Y, and for the figures that are watched.  They add up."""

    weight: float
    unary: Float[np.ndarray, " 3"]
    descriptor: Float[np.ndarray, " d"]
    by_part: Float[np.ndarray, "L 2"]
    pairs: int
    smooth: Float[np.ndarray, " 3"]
    segment_pairs: int
    segment: Float[np.ndarray, " d"]
    template_normal: Float[np.ndarray, "L 3 3"]
    template_moment: Float[np.ndarray, "K 3"]
    energy: float
    points: int

    def __add__(self, other: Summary) -> Summary:
        return Summary(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))


def summarize(
    problem: Problem, templates: PartTemplates, graph: tuple[np.ndarray, np.ndarray], candidates: Candidates,
    correspondence: Correspondence, beliefs: Beliefs, energy: float,
) -> Summary:  # fmt: skip
    """What this shape adds to the piecewise maximum-likelihood covariances and to the template update."""
    alive = beliefs.alive(templates.label)
    weight, unary, descriptor, by_part = _kernels.residual_sums(
        candidates.offsets, candidates.template_index, correspondence.q, problem.points, beliefs.deformed,
        problem.descriptors, templates.descriptors, templates.label, templates.n_parts,
    )  # fmt: skip
    smooth, pairs = _kernels.smoothness_sums(*graph, beliefs.deformed, mapped_template(templates, beliefs), alive)
    normal = np.zeros((templates.n_parts, 3, 3))
    moment = np.zeros((templates.n_points, 3))
    for part in np.flatnonzero(beliefs.active):
        rows = templates.label == part
        if not rows.any():
            continue
        a = beliefs.maps[part]
        centred = beliefs.deformed[rows] - beliefs.deformed[rows].mean(axis=0)
        normal[part] = a.T @ a
        moment[rows] = centred @ a
    return Summary(
        float(weight), unary, descriptor, by_part, int(pairs), smooth, len(problem.neighbour),
        problem.pair_squares, normal, moment, float(energy), len(problem.points),
    )  # fmt: skip


def update_templates(templates: PartTemplates, summary: Summary) -> PartTemplates:
    """Y = (Σ_t AᵀA)⁻¹ Σ_t AᵀD per part, centred on the part's old centre.

    The printed update is a Jacobi step on a Laplacian and hardly moves; this is the minimiser of φ2 over Y up to each
    part's free translation, when every template point weighs the same.
    """
    points = templates.points.copy()
    for part in range(templates.n_parts):
        rows = templates.label == part
        normal = summary.template_normal[part]
        if not rows.any() or np.linalg.cond(normal) > 1e6:
            continue
        points[rows] = summary.template_moment[rows] @ np.linalg.inv(normal).T + points[rows].mean(axis=0)
    return templates.moved(points)
