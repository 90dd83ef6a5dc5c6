"""The mean-field free energy of one shape: what every exact update must not raise."""

from __future__ import annotations

import numpy as np
from scipy.special import xlogy

from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import LOG_EPSILON, Covariances, attraction
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
) -> float:
    """E_Q[-ln P̃] - H(Q) of one shape in nats, up to constants of the covariances (supplement 1).

    Every pair of template points and of samples counts once.  Labels of inactive parts have probability zero.
    """
    q, index = correspondence.q, candidates.template_index
    owner = np.repeat(np.arange(len(problem.points)), np.diff(candidates.offsets))
    difference = beliefs.deformed[index] - problem.points[owner]
    unary = 0.5 * ((difference**2 + beliefs.variance[index]) / covariances.unary).sum(axis=1)
    mismatch = -LOG_EPSILON * (1.0 - beliefs.segmentation[owner, templates.label[index]])
    total = float((q * (unary + candidates.costs + mismatch)).sum() + xlogy(q, q).sum())

    offsets, neighbour = graph
    first = np.repeat(np.arange(templates.n_points), np.diff(offsets))
    once = first < neighbour
    first, second = first[once], neighbour[once]
    mapped = mapped_template(templates, beliefs)
    delta = beliefs.deformed[first] - beliefs.deformed[second] - mapped[first] + mapped[second]
    spread = beliefs.variance[first] + beliefs.variance[second]
    total += float((0.5 * (delta**2 + spread) / covariances.smooth).sum())
    total -= 0.5 * float(np.log(beliefs.variance).sum())

    pull = attraction(problem.descriptors, problem.offsets, problem.neighbour, covariances.segment)
    rows = np.repeat(np.arange(len(problem.points)), np.diff(problem.offsets))
    agree = (beliefs.segmentation[rows] * beliefs.segmentation[problem.neighbour]).sum(axis=1)
    total -= 0.5 * float((pull * agree).sum())
    return total + float(xlogy(beliefs.segmentation, beliefs.segmentation).sum())
