"""The ablations of ``fit_accuracy``: what of the deformation model is patched to go without a part of it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from shapeforge.collection.shape import Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import Covariances, floored, initial_covariances
from shapeforge.deformation.templates import PartTemplates, template_from_exemplar
from shapeforge.deformation.updates import Correspondence, update_maps

HUGE = 1.0  # a variance (diagonals squared) under which a factor says nothing: as wide as the whole shape


def _start_without(factor: str) -> Covariances:
    return replace(initial_covariances(), **{factor: np.full(3, HUGE)})


def _floored_without(factor: str, name: str, variance: np.ndarray) -> np.ndarray:
    return np.full(3, HUGE) if name == factor else floored(name, variance)


def _without(factor: str) -> dict[str, object]:
    """The covariance of a Gaussian factor is huge from the start on."""
    start, floors = partial(_start_without, factor), partial(_floored_without, factor)
    return {"fit.initial_covariances": start, "fit.floored": floors}


def _no_attraction(descriptors, offsets, neighbour, segment) -> np.ndarray:
    return np.zeros(len(neighbour))


def _one_map(templates: PartTemplates, correspondence: Correspondence, beliefs: Beliefs) -> Beliefs:
    """``update_maps`` with the whole shape as one part: the map all parts share."""
    whole = replace(templates, label=np.zeros_like(templates.label), part_names=("all",))
    alone = replace(beliefs, maps=beliefs.maps[:1], offsets=beliefs.offsets[:1], active=np.ones(1, bool))
    found, n_parts = update_maps(whole, correspondence, alone), templates.n_parts
    return replace(beliefs, maps=np.tile(found.maps, (n_parts, 1, 1)), offsets=np.tile(found.offsets, (n_parts, 1)))


def _boxed_template(shape: Shape, faces: np.ndarray, part_names: tuple[str, ...]) -> PartTemplates:
    """The exemplar's points moved onto the bounding boxes of the pieces of its parts."""
    templates = template_from_exemplar(shape, faces, part_names)
    points, normals = templates.points.copy(), templates.normals.copy()
    pieces = np.stack([templates.label, templates.component], axis=1)
    for piece in np.unique(pieces, axis=0):
        rows = np.flatnonzero((pieces == piece).all(axis=1))
        points[rows], normals[rows] = _onto_box(points[rows])
    return replace(templates, points=points, normals=normals)


def _onto_box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) moved to the nearest side of their box, and its normals: along the axes or the principal axes,
    whichever is smaller."""
    centred = points - points.mean(axis=0)
    turns = (np.eye(3), np.linalg.eigh(centred.T @ centred)[1])
    turn = min(turns, key=lambda axes: np.prod(np.ptp(points @ axes, axis=0) + 1e-3))
    own = points @ turn
    low, high = own.min(axis=0), own.max(axis=0)
    to_side = np.concatenate([own - low, high - own], axis=1)
    side = to_side.argmin(axis=1)
    axis, rows = side % 3, np.arange(len(points))
    own[rows, axis] = np.where(side < 3, low[axis], high[axis])
    normals = np.zeros_like(own)
    normals[rows, axis] = np.where(side < 3, -1.0, 1.0)
    return own @ turn.T, normals @ turn.T


_WHOLE_STARTS: dict[str, object] = {f"{room}.partial_starts": lambda *_: [] for room in ("starts", "family")}

ABLATIONS: dict[str, tuple[str, dict[str, object]]] = {
    "no-phi1": ("without φ1, nearness", _without("unary")),
    "no-phi2": ("without φ2, smoothness", _without("smooth")),
    "no-phi3": ("without φ3, looks", {"updates.DESCRIPTOR_WEIGHT": 0.0, "updates.NORMAL_WEIGHT": 0.0}),
    "no-phi4": ("without φ4, labels agree", {"updates.LOG_EPSILON": 0.0, "energy.LOG_EPSILON": 0.0}),
    "no-phi5": ("without φ5, like neighbours", {"shape_fit.attraction": _no_attraction}),
    "all-parts": (
        "no part is missing",
        {
            "shape_fit.switch_off_missing": lambda *given: given[4],
            "shape_fit.switch_off_spare": lambda *given: (given[4], given[2], given[3]),
            **_WHOLE_STARTS,
        },
    ),
    "whole-starts": ("starts with all parts only", _WHOLE_STARTS),
    "one-map": ("one map for all parts", {"shape_fit.update_maps": _one_map}),
    "no-annealing": ("no annealing", {"fit.ANNEALING": 1.0, "family.sigma_of_round": lambda *_: HUGE}),
    "boxes": (
        "box templates",
        {
            "starts.template_from_exemplar": _boxed_template,
            "fit.update_templates": lambda templates, summary: templates,
        },
    ),
    "exemplars-alone": ("no templates of the family", {"family.ROUNDS": 0}),
    "one-exemplar": ("one exemplar", {}),
}
"""Title, and what is patched in ``shapeforge.deformation``."""
