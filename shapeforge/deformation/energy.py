"""The mean-field free energy of one shape: what every exact update must not raise."""

from __future__ import annotations

import numpy as np

from shapeforge.deformation import _kernels
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import DESCRIPTOR_WEIGHT, LOG_EPSILON, Covariances, attraction
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Candidates, Correspondence, Problem, mapped_template


def free_energy(
    problem: Problem,
    templates: PartTemplates,
    graph: tuple[np.ndarray, np.ndarray],
    candidates: Candidates,
    correspondence: Correspondence,
    beliefs: Beliefs,
    covariances: Covariances,
    pull: np.ndarray | None = None,
) -> float:
    """E_Q[-ln P̃] - H(Q) of one shape in nats, with the normalisers of the Gaussian factors (supplement 1).

    Every pair of template points and of samples counts once; ``pull`` is φ5's logit Φ per pair if it is at hand.
    Labels of inactive parts have probability zero.
    """
    if pull is None:
        pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)
    total = _kernels.energy_of_correspondence(
        candidates.offsets, candidates.template_index, correspondence.q, candidates.costs, problem.points,
        beliefs.deformed, beliefs.variance, 1.0 / covariances.unary, templates.label, beliefs.segmentation, LOG_EPSILON,
    )  # fmt: skip
    mapped = mapped_template(templates, beliefs)
    total += _kernels.energy_of_smoothness(*graph, beliefs.deformed, beliefs.variance, mapped, 1.0 / covariances.smooth)
    total -= 0.5 * float(np.log(beliefs.variance).sum())
    # the Gaussians' normalisers: without them the curve would rise merely because Σ1 is annealed
    n_points, n_pairs = len(problem.points), len(graph[1]) / 2
    total += 0.5 * n_points * float(np.log(2 * np.pi * covariances.unary).sum())
    total += 0.5 * n_points * DESCRIPTOR_WEIGHT * float(np.log(2 * np.pi * covariances.descriptor).sum())
    total += 0.5 * n_pairs * float(np.log(2 * np.pi * covariances.smooth).sum())
    if problem.leaning is not None:
        total -= float((problem.leaning * beliefs.segmentation).sum())
    return float(
        total + _kernels.energy_of_segmentation(problem.offsets, problem.neighbour, pull, beliefs.segmentation)
    )
