"""Part templates: the points that the whole family is explained with (Y in §4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from shapeforge.collection.points import nearest_points
from shapeforge.collection.shape import Shape
from shapeforge.deformation import _kernels_pairs
from shapeforge.deformation.pieces import face_components

NEIGHBOURS = 20

FEWEST_LABELLED = 12
"""Labelled points of templates at least: by fewer they cannot be laid onto a shape."""

FEWEST_POINTS, SMALLEST_SHARE = 12, 0.005
"""Template points of a component that is asked about by itself, at least; and as a share of all of them.  What is
smaller goes with the component of its part that it is nearest to, a pylon with its engine."""

MOST_COMPONENTS = 60
"""Components asked about at most, the largest: what has more is the soup of a modeller, not copies of a thing."""

ALIKE = 1.5
"""Ratio of the extents, along every axis, and of the areas up to which two components of a part are copies of each
other: a frame of four legs is none of its rungs, though both be as wide."""

MIRRORED = 0.06
"""How far (diagonals) the middle of a component is at most from the mirror image of its twin's."""

MARGIN = 0.01
"""What extents (diagonals) are lengthened by before they are compared: a bar may be twice as thick as another."""


@dataclass(frozen=True, eq=False)
class Components:
    """The components of parts that have several: number of each template point (-1: its part has but one), the part
    (C,) of each component, which ones are copies of each other (C, C), and which one is its mirror image across x (C,):
    itself, when there is none."""

    number: Int[np.ndarray, " K"]
    part: Int[np.ndarray, " C"]
    alike: Bool[np.ndarray, "C C"]
    twin: Int[np.ndarray, " C"]


@dataclass(frozen=True, eq=False)
class PartTemplates:
    """The K template points of all parts together (Y in the paper).

    ``label`` is the part of each point, ``component`` the separate piece it belongs to (left or right leg; counted
    within its part), ``neighbours`` indices within the same part, -1 padded; as pairs they are symmetric once made
    into ``neighbour_graph``.  ``pressed`` is learnt, too: how flat each part usually lies (see ``flatness``), empty
    before the first round.
    """

    points: Float[np.ndarray, "K 3"]
    normals: Float[np.ndarray, "K 3"]
    label: Int[np.ndarray, " K"]
    component: Int[np.ndarray, " K"]
    neighbours: Int[np.ndarray, "K n"]
    descriptors: Float[np.ndarray, "K 10"]
    part_names: tuple[str, ...]
    source: str = ""
    pressed: tuple[float, ...] = ()

    @property
    def n_points(self) -> int:
        """Number of template points K."""
        return len(self.points)

    @property
    def n_parts(self) -> int:
        """Number of part labels L."""
        return len(self.part_names)

    @cached_property
    def graph(self) -> tuple[np.ndarray, np.ndarray]:
        """``pair_graph`` of the neighbours; it moves along with the templates."""
        return pair_graph(self.neighbours)

    @cached_property
    def components(self) -> Components:
        """The components that a shape may have or not (see ``components_of``); they stay when the templates move."""
        return components_of(self)

    def has_part(self) -> np.ndarray:
        """(L,) bool: which parts own template points here."""
        return np.bincount(self.label, minlength=self.n_parts) > 0

    @property
    def flatness(self) -> Float[np.ndarray, " L"]:
        """How flat each part (L,) is usually pressed on a shape (see ``existence.usual_flatness``)."""
        return np.array(self.pressed or np.zeros(self.n_parts))

    def moved(self, points: Float[np.ndarray, "K 3"], flatness: Float[np.ndarray, " L"] | None = None) -> PartTemplates:
        """The same templates at other positions, usually pressed as flat as before or as told."""
        pressed = self.pressed if flatness is None else tuple(flatness.tolist())
        moved = replace(self, points=points, pressed=pressed)
        moved.__dict__.update(graph=self.graph, components=self.components)
        return moved


def components_of(templates: PartTemplates) -> Components:
    """The components of a template set that a shape may have or not, each by itself."""
    number = np.full(templates.n_points, -1, np.int32)
    pieces, piece, size = np.unique(
        np.stack([templates.label, templates.component], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    piece = piece.reshape(-1)
    large = np.flatnonzero(size >= max(FEWEST_POINTS, SMALLEST_SHARE * templates.n_points))
    large = np.sort(large[np.argsort(-size[large], kind="stable")[:MOST_COMPONENTS]])
    parts: list[int] = []
    extents, areas, middles = [], [], []
    for part in np.unique(pieces[large, 0]).tolist():
        mine = large[pieces[large, 0] == part]
        if len(mine) < 2:
            continue
        for one in mine.tolist():
            number[piece == one] = len(parts)
            parts.append(part)
            extents.append(np.ptp(templates.points[piece == one], axis=0) + MARGIN)
            areas.append(size[one])
            middles.append(templates.points[piece == one].mean(axis=0))
        crumbs = np.flatnonzero((templates.label == part) & (number < 0))
        known = np.flatnonzero((templates.label == part) & (number >= 0))
        number[crumbs] = number[known[nearest_points(templates.points[known], templates.points[crumbs])[0][:, 0]]]
    measures = np.column_stack([np.array(extents).reshape(-1, 3), np.array(areas, float)])
    part_of, ratio = np.array(parts, np.int32), measures[:, None] / measures[None]
    close = np.maximum(ratio, 1 / ratio).max(axis=2, initial=1.0) < ALIKE
    alike = close & (part_of[:, None] == part_of) & ~np.eye(len(parts), dtype=bool)
    return Components(number, part_of, alike, _twins(np.array(middles).reshape(-1, 3), alike))


def _twins(middle: np.ndarray, alike: np.ndarray) -> Int[np.ndarray, " C"]:
    """Mirror image across x of each component (C,), by their middles (C, 3): a copy that is there, else itself."""
    off = np.linalg.norm(middle[:, None] * [-1, 1, 1] - middle[None], axis=2)
    itself = np.eye(len(middle), dtype=bool)
    off = np.where(alike | itself, off, np.inf)
    nearest = off.argmin(axis=1) if len(middle) else np.zeros(0, int)
    return np.where(off.min(axis=1, initial=np.inf) < MIRRORED, nearest, np.arange(len(middle))).astype(np.int32)


def template_from_points(
    points: Float[np.ndarray, "K 3"],
    normals: Float[np.ndarray, "K 3"],
    descriptors: Float[np.ndarray, "K 10"],
    label: Int[np.ndarray, " K"],
    part_names: tuple[str, ...],
    source: str = "",
    surface: Int[np.ndarray, " K"] | None = None,
) -> PartTemplates:
    """Templates from labelled points: neighbourhoods inside one part only (across parts they tear the borders).

    ``surface`` is the connected surface of the mesh that each point is on, if known: legs that rails tie together are
    components each.  Points with label -1 are left out.

    Raises ValueError when fewer than 12 points have a label.
    """
    keep = np.flatnonzero((label >= 0) & (label < len(part_names)))
    if not len(keep):
        raise ValueError(
            f"label: wanted at least one labelled point for the templates of {source or 'the exemplar'}, got none; "
            "paint the exemplar, or propose parts with `shapeforge cosegment`"
        )
    if len(keep) < FEWEST_LABELLED:
        raise ValueError(
            f"label: wanted at least {FEWEST_LABELLED} labelled points for the templates of "
            f"{source or 'the exemplar'}, got {len(keep)}; paint more of it"
        )
    keep = keep[np.argsort(label[keep], kind="stable")]
    points, normals, descriptors, label = points[keep], normals[keep], descriptors[keep], label[keep]
    surface = np.zeros(len(keep), np.int32) if surface is None else surface[keep]
    neighbours = np.full((len(points), NEIGHBOURS), -1, np.int32)
    component = np.zeros(len(points), np.int32)
    for part in range(len(part_names)):
        rows = np.flatnonzero(label == part)
        if len(rows) < 2:
            continue
        k = min(NEIGHBOURS, len(rows) - 1)
        near = cKDTree(points[rows]).query(points[rows], k=k + 1)[1][:, 1:]
        neighbours[rows[:, None], np.arange(k)] = rows[near]
        component[rows] = _pieces(near[:, :6], surface[rows])
    return PartTemplates(
        np.ascontiguousarray(points, np.float64), np.ascontiguousarray(normals, np.float64), label.astype(np.int32),
        component, neighbours, np.ascontiguousarray(descriptors, np.float64), part_names, source,
    )  # fmt: skip


def _pieces(near: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Connected pieces (n,) of a one-sided nearest-neighbour table (n, k); what lies on other surfaces is apart."""
    n, k = near.shape
    graph = coo_matrix((np.ones(near.size), (np.repeat(np.arange(n), k), near.ravel())), shape=(n, n))
    piece = connected_components(graph.tocsr(), directed=False)[1]
    both = np.stack([piece, surface], axis=1)
    return np.unique(both, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)


def template_from_exemplar(shape: Shape, faces: Int[np.ndarray, " F"], part_names: tuple[str, ...]) -> PartTemplates:
    """Templates from the painted exemplar: its labelled surface points (Algorithm 1, line 1)."""
    return template_from_points(
        shape.points, shape.normals, shape.descriptors, painted_parts(shape, faces), part_names, shape.name,
        face_components(shape.mesh)[shape.face_of_point],
    )  # fmt: skip


def painted_parts(shape: Shape, faces: Int[np.ndarray, " F"]) -> Int[np.ndarray, " P"]:
    """The part painted at every point, -1 where nothing is.  Raises ValueError for labels of another mesh."""
    if len(faces) != shape.mesh.n_faces:
        raise ValueError(
            f"faces: wanted {shape.mesh.n_faces} labels for {shape.name}, got {len(faces)}; "
            "the labels belong to another version of the mesh"
        )
    return np.asarray(faces)[shape.face_of_point]


def pair_graph(neighbours: Int[np.ndarray, "N n"]) -> tuple[np.ndarray, np.ndarray]:
    """Symmetric CSR (offsets (N+1,), index (M,)) of one-sided neighbour lists, each pair once in each direction.

    One-sided lists make the sums of φ2 and φ5 count some pairs once and others twice, and then the coordinate updates
    no longer descend on the energy they claim to descend on.
    """
    listed = np.ascontiguousarray(neighbours, np.int32)
    return _kernels_pairs.merge_pairs(listed, listed, len(listed))
