"""New shapes against a fitted family: the templates stay, only the shape's own beliefs are found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shapeforge.collection.shape import Shape
from shapeforge.deformation.exemplars import Candidate, with_copies
from shapeforge.deformation.factors import FLOORS, Covariances
from shapeforge.deformation.fit import ANNEALING, EXEMPLARS_PER_SHAPE, _start, _work_on_shape
from shapeforge.deformation.templates import PartTemplates


def fit_candidates(
    shape: Shape,
    templates: Sequence[PartTemplates],
    covariances: Covariances,
    *,
    annealed_from: float = 0.03,
    rounds: int = 10,
    inner: int = 3,
    exemplars_per_shape: int = EXEMPLARS_PER_SHAPE,
    faces: np.ndarray | None = None,
) -> tuple[Candidate, ...]:
    """What exemplars say of a new shape under fixed templates and covariances, annealed as in the family's own fit.

    ``blend`` makes one of them.  ``annealed_from`` is the fit's first σ1 (diagonals); ``faces`` are part labels
    painted on this shape, if any.
    """
    templates = tuple(templates)
    candidates = _start(shape, faces, templates, -1, exemplars_per_shape, None)
    shape_of_unary = covariances.unary / covariances.unary.mean()
    for step in range(rounds):
        sigma = max(FLOORS["unary"], annealed_from * ANNEALING**step)
        sharpened = replace(covariances, unary=sigma**2 * shape_of_unary)
        candidates, _, _ = _work_on_shape(shape, faces, templates, candidates, sharpened, inner, None)
    return with_copies(shape, templates, candidates)
