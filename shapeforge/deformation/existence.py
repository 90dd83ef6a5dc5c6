"""Which parts does a shape have?  (§4, deactivation; E in the paper.)

The printed rule (label probability below 1e-3 at every sample) almost never switches a missing part off, because the
part's template settles on some other surface and claims it.  Here a part must *pay for itself*: the surface that it
claims has to be explained markedly better with it than by the other parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from shapeforge.deformation import _kernels
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.templates import PartTemplates
from shapeforge.deformation.updates import Candidates, Problem

SHARPNESS = 0.0165
"""σ1 (diagonals) below which the question may be asked: earlier, thin parts still look dispensable."""

LOSS_CAP = 10.0
"""Nats per point: what a far outlier may add to a part's evidence at most."""

WANTED_LOSS = 5.0
"""Nats per claimed point that a part has to be worth."""

WANTED_SHARE = 0.3
"""Share of the surface claimed, relative to the part's share of the template, below which ``WANTED_LOSS`` applies."""

NEGLIGIBLE_SHARE = 0.05
"""Below this relative share a part is off whatever it is worth: a handful of stray points."""


def part_evidence(
    problem: Problem, templates: PartTemplates, candidates: Candidates, beliefs: Beliefs, unary: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, " L"]]:
    """Mean loss (L,) in nats per claimed point when a part is taken away, and its relative share (L,) of the surface.

    From φ1 and φ3 alone, so that φ4 and φ5 cannot talk a part into existence.
    """
    favourite, loss, _ = _kernels.explained_without(
        candidates.offsets, candidates.template_index, candidates.costs, problem.points, beliefs.deformed,
        1.0 / unary, templates.label, templates.n_parts, LOSS_CAP,
    )  # fmt: skip
    claimed = favourite >= 0
    count = np.bincount(favourite[claimed], minlength=templates.n_parts)
    total = np.bincount(favourite[claimed], loss[claimed], templates.n_parts)
    own = np.bincount(templates.label, minlength=templates.n_parts)
    live = own * beliefs.active
    expected = live / max(live.sum(), 1) * len(problem.points)
    return total / np.maximum(count, 1), np.divide(count, expected, out=np.zeros(len(own)), where=expected > 0)


def switch_off_missing(
    problem: Problem, templates: PartTemplates, candidates: Candidates, beliefs: Beliefs, unary: Float[np.ndarray, " 3"]
) -> Beliefs:
    """Deactivate the parts that the shape does not have; parts painted on it always stay, and one part always stays."""
    if np.sqrt(unary.mean()) > SHARPNESS:
        return beliefs
    loss, share = part_evidence(problem, templates, candidates, beliefs, unary)
    painted = np.bincount(problem.evidence[problem.evidence >= 0], minlength=templates.n_parts) > 0
    missing = ((loss < WANTED_LOSS) & (share < WANTED_SHARE)) | (share < NEGLIGIBLE_SHARE)
    missing &= beliefs.active & ~painted
    active = beliefs.active & ~missing
    misfit = np.where(beliefs.active, loss, beliefs.misfit)
    if not missing.any() or not active.any():
        return replace(beliefs, misfit=misfit)
    segmentation = np.where(active, beliefs.segmentation, 0.0) + 1e-12 * active
    segmentation /= segmentation.sum(axis=1, keepdims=True)
    return replace(beliefs, active=active, segmentation=segmentation, misfit=misfit)
