"""One group's templates registered with another's: the model's own updates, the other templates as the surface.

The labels are known on both sides, so every part is fitted by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from shapeforge.collection.align import FEWEST, Alignment, affine_align
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.factors import FLOORS, initial_covariances
from shapeforge.deformation.templates import PartTemplates, pair_graph
from shapeforge.deformation.updates import (
    MAP_RIDGE,
    Problem,
    find_candidates,
    update_correspondences,
    update_deformations,
    update_maps,
)

ROUNDS = 8

WIDE, SHARP = 0.05, 1.5 * FLOORS["unary"]
"""σ1 (diagonals) of the first round and of the last."""

GOING_ON, GOING_ON_ROUNDS = 0.02, 4
"""σ1 of the first round, and rounds, where the start is near already: it came over templates in between."""

LEAST_POINTS = 12
"""Points of a part on both sides from which its own affine start is found: what the labels tell, the start may use."""

CARRIERS = 3
"""Nearest template points with which a point is carried along."""


class Registrations:
    """Registrations of sets of templates (same part names) onto each other, each made once, when it is asked for."""

    def __init__(self, templates: Sequence[PartTemplates]) -> None:
        self.templates = templates
        self.has = np.array([template.has_part() for template in templates])
        self._parts: dict[tuple[int, int], PartTemplates] = {}
        self._wholes: dict[tuple[int, int], Alignment] = {}
        self._found: dict[tuple[int, int, int], np.ndarray] = {}

    def part(self, number: int, part: int) -> PartTemplates:
        """The template of one part of set ``number``, as a family of one part."""
        if (number, part) not in self._parts:
            self._parts[number, part] = _of_part(self.templates[number], part)
        return self._parts[number, part]

    def whole(self, source: int, target: int) -> Alignment:
        """The affine map of what ``source`` and ``target`` both have of their parts; none where that is next to
        nothing: exemplars lie alike."""
        if (source, target) not in self._wholes:
            shared = self.has[source] & self.has[target]
            mine, theirs = (one.points[shared[one.label]] for one in (self.templates[source], self.templates[target]))
            enough = min(len(mine), len(theirs)) >= FEWEST
            self._wholes[source, target] = (
                affine_align(mine, theirs) if enough else Alignment(np.eye(3), np.zeros(3), np.nan)
            )
        return self._wholes[source, target]

    def of_part(self, source: int, target: int, part: int) -> Float[np.ndarray, "k 3"]:
        """``source``'s points (k, 3) of a part that both have, deformed onto ``target``'s.

        From the affine map of the whole and from one of its own; the outcome that leaves the smaller gap.
        """
        if (source, target, part) not in self._found:
            mine, theirs, whole = self.part(source, part), self.part(target, part), self.whole(source, target)
            starts = [whole]
            if min(mine.n_points, theirs.n_points) >= LEAST_POINTS:
                starts.append(affine_align(mine.points, theirs.points))
            sigmas = np.geomspace(WIDE, SHARP, ROUNDS)
            outcomes = [_settled(mine, theirs, start(mine.points), start, sigmas) for start in starts]
            self._found[source, target, part] = min(outcomes, key=lambda points: gap(points, theirs.points))
        return self._found[source, target, part]

    def onward(self, source: int, target: int, part: int, places: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        """``source``'s points (k, 3) of a part, settled on ``target``'s from ``places`` that are near already."""
        mine, theirs = self.part(source, part), self.part(target, part)
        sigmas = np.geomspace(GOING_ON, SHARP, GOING_ON_ROUNDS)
        return _settled(mine, theirs, places, affine_map(mine.points, places), sigmas)


def gap(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"]) -> float:
    """Mean distance to the nearest point, both ways (diagonals)."""
    return float(cKDTree(a).query(b)[0].mean() + cKDTree(b).query(a)[0].mean())


def carried(
    places: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "m 3"], moved: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """``places`` (n, 3) shifted as the nearest of the ``points`` (m, 3) are that have ``moved``, near ones the more."""
    count = min(CARRIERS, len(points))
    distance, near = (found.reshape(-1, count) for found in cKDTree(points).query(places, k=count))
    weight = 1.0 / (distance + 1e-6)
    weight /= weight.sum(axis=1, keepdims=True)
    return places + np.einsum("nk,nki->ni", weight, (moved - points)[near])


def _of_part(templates: PartTemplates, part: int) -> PartTemplates:
    rows = np.flatnonzero(templates.label == part)
    place = np.full(templates.n_points + 1, -1, np.int32)  # the last: neighbours that are none
    place[rows] = np.arange(len(rows))
    return replace(
        templates, points=templates.points[rows], normals=templates.normals[rows], label=np.zeros(len(rows), np.int32),
        component=templates.component[rows], neighbours=place[templates.neighbours[rows]],
        descriptors=templates.descriptors[rows], part_names=templates.part_names[part : part + 1],
        pressed=templates.pressed[part : part + 1],
    )  # fmt: skip


def _settled(
    source: PartTemplates, target: PartTemplates, deformed: np.ndarray, start: Alignment, sigmas: np.ndarray
) -> Float[np.ndarray, "K 3"]:
    """A part's points (K, 3) after the model's updates against another template of the part."""
    problem = Problem(
        np.ascontiguousarray(target.points), np.ascontiguousarray(target.normals),
        np.ascontiguousarray(target.descriptors), np.zeros(target.n_points + 1, np.int64), np.zeros(0, np.int32),
        target.label,
    )  # fmt: skip
    beliefs = Beliefs(
        0, deformed, np.full_like(deformed, 1e-4), start.matrix[None], start.offset[None],
        np.ones((target.n_points, 1)), np.ones(1, bool), problem.evidence, np.full(1, np.nan),
    )  # fmt: skip
    graph = pair_graph(source.neighbours)
    wide = initial_covariances(source.descriptors.shape[1])
    for sigma in sigmas:
        covariances = replace(wide, unary=np.full(3, sigma**2))
        candidates = find_candidates(problem, source, beliefs, covariances.descriptor)
        for _ in range(3):
            correspondence = update_correspondences(problem, source, candidates, beliefs, covariances.unary)
            beliefs = update_deformations(source, graph, correspondence, beliefs, covariances)
        beliefs = update_maps(source, correspondence, beliefs)
    return beliefs.deformed


def affine_map(points: np.ndarray, places: np.ndarray) -> Alignment:
    """The affine map of ``points`` (n, 3) to ``places`` (n, 3) by least squares, with a ridge towards none."""
    mean, onto = points.mean(axis=0), places.mean(axis=0)
    centred, there = points - mean, places - onto
    # not by BLAS, whose sums over many rows depend on its number of threads
    second, cross = np.einsum("ni,nj->ij", centred, centred), np.einsum("ni,nj->ij", there, centred)
    ridge = MAP_RIDGE * max(np.trace(second) / 3, 1e-9) * np.eye(3)
    matrix = (cross + ridge) @ np.linalg.inv(second + ridge)
    return Alignment(matrix, onto - matrix @ mean, np.nan)
