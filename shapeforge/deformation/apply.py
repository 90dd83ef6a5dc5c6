"""New shapes against a fitted family: the templates stay, only the shape's own beliefs are found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shapeforge.collection.shape import Shape
from shapeforge.deformation import family
from shapeforge.deformation.exemplars import Candidate, weighted, with_copies, worth_hearing
from shapeforge.deformation.factors import FLOORS, Covariances
from shapeforge.deformation.fit import ANNEALING, EXEMPLARS_PER_SHAPE, HEARD_ROUNDS, exemplar_rounds
from shapeforge.deformation.hierarchy import Hierarchy
from shapeforge.deformation.shape_fit import work_on_shape
from shapeforge.deformation.starts import exemplar_starts
from shapeforge.deformation.templates import PartTemplates


def fit_candidates(
    shape: Shape,
    templates: Sequence[PartTemplates],
    covariances: Covariances,
    hierarchy: Hierarchy | None = None,
    *,
    annealed_from: float = 0.03,
    rounds: int = 10,
    inner: int = 3,
    exemplars_per_shape: int = EXEMPLARS_PER_SHAPE,
    faces: np.ndarray | None = None,
) -> tuple[Candidate, ...]:
    """What exemplars say of a new shape under fixed templates and covariances, annealed over ``rounds`` as a fit's are.

    ``blend`` makes one of them.  Where ``hierarchy`` links the family's own templates (the last of ``templates``) too,
    these are fitted after the exemplars', as in ``fit_templates``.  ``annealed_from`` is the fit's first σ1
    (diagonals); ``faces`` are part labels painted on this shape, if any.
    """
    templates = tuple(templates)
    of_family = hierarchy is not None and len(hierarchy.links) == len(templates) and len(templates) > 1
    exemplars = templates[:-1] if of_family else templates
    candidates = exemplar_starts(shape, faces, exemplars, -1, exemplars_per_shape, None)
    shape_of_unary = covariances.unary / covariances.unary.mean()

    def at(sigma: float) -> Covariances:
        return replace(covariances, unary=sigma**2 * shape_of_unary)

    for step in range(exemplar_rounds(rounds) if of_family else rounds):
        sharpened = at(max(FLOORS["unary"], annealed_from * ANNEALING**step))
        candidates = work_on_shape(shape, faces, exemplars, candidates, sharpened, inner, None, False).candidates
        if step + 1 >= HEARD_ROUNDS:
            candidates = worth_hearing(candidates)
    if not of_family:
        return with_copies(shape, exemplars, candidates)
    assert hierarchy is not None
    candidates = weighted([*candidates, *family.family_starts(shape, faces, exemplars, candidates, hierarchy)])
    for step in range(family.ROUNDS):
        sharpened = at(family.sigma_of_round(step, family.ROUNDS))
        candidates = work_on_shape(shape, faces, templates, candidates, sharpened, inner, None, True).candidates
        if step + 1 >= family.TRIAL_ROUNDS:
            candidates = family.better_start(candidates)
    return with_copies(shape, templates, candidates)
