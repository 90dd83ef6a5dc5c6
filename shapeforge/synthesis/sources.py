"""The training parts that meshes are made from: one part of one shape each, read only when it is wanted."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh, Shape
from shapeforge.collection.surface import SearchedMesh, closest_points
from shapeforge.synthesis.cleaning import neighbours
from shapeforge.synthesis.depths import depths, directions_into
from shapeforge.synthesis.embedded import DeformationGraph, build_graph
from shapeforge.synthesis.measures import PartQuality
from shapeforge.synthesis.mirror import FamilyMirror, find_mirror
from shapeforge.synthesis.parts import cut_mesh, cut_part, one_sided_shares
from shapeforge.synthesis.surfaces import (
    as_mesh,
    distinct_triangles,
    farthest_points,
    touching_pieces,
)

FEWEST_POINTS = 6
"""Corresponding points that a part needs on a shape, or it counts as absent there."""
CONTACT = 0.01
"""Surface of another part nearer than this (diagonals) counts as touching ..."""
NEAR_CONTACT = 0.015
"""... and where nothing does, the nearest surface up to this distance."""
ANCHORS = 12
"""Points at which a part holds on to each part it touches."""
LANDING = 6
"""Corresponding points of the other part that tell where a contact is."""


@dataclass(frozen=True, eq=False)
class Anchors:
    """Where a part holds on to another one.

    Its ``vertices`` (A,), their ``distance`` (A,) from the other's surface on their training shape, the direction
    ``into`` (A, 3) the other (zero where none), and how ``deep`` (A,) they were in there (diagonals).  Where in the
    other part they were: at ``offset`` (A, 3) from the mean of its template points ``landing`` (A, m), weighted by
    ``weight`` (A, m).
    """

    vertices: Int[np.ndarray, " A"]
    distance: Float[np.ndarray, " A"]
    into: Float[np.ndarray, "A 3"]
    deep: Float[np.ndarray, " A"]
    landing: Int[np.ndarray, "A m"]
    weight: Float[np.ndarray, "A m"]
    offset: Float[np.ndarray, "A 3"]


@dataclass(frozen=True, eq=False)
class SourcePart:
    """Part ``part`` of a training shape, ready to be bent; everything in normal coordinates (diagonals).

    ``handles`` (C, 3) are the surface points that correspond to the template points ``template`` (C,);
    ``piece`` numbers the pieces of the part: connected components, those that touch counted as one;
    ``anchors`` tells, for every other part that this one touches, where; ``colours`` (N, 3) are the file's, if any.
    """

    shape: str
    part: int
    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    piece: Int[np.ndarray, " V"]
    template: Int[np.ndarray, " C"]
    handles: Float[np.ndarray, "C 3"]
    quality: PartQuality
    anchors: Mapping[int, Anchors] = field(default_factory=dict)
    colours: UInt8[np.ndarray, "N 3"] | None = None

    @cached_property
    def graph(self) -> DeformationGraph:
        """The deformation graph; made when the part is first bent, since most parts are only ever compared."""
        return build_graph(self.vertices)

    @cached_property
    def rows(self) -> csr_array:
        """Basis (V, 4N) of the vertices in ``graph``."""
        return self.graph.basis(self.vertices)

    @cached_property
    def piece_of_handle(self) -> Int[np.ndarray, " C"]:
        """Number of the piece of the vertex nearest to each handle."""
        return self.piece[cKDTree(self.vertices).query(self.handles)[1]]

    @cached_property
    def piece_of_node(self) -> Int[np.ndarray, " N"]:
        """Number of the piece of the vertex nearest to each node of ``graph``."""
        return self.piece[cKDTree(self.vertices).query(self.graph.nodes)[1]]

    @cached_property
    def surface(self) -> SearchedMesh:
        """The part as a mesh."""
        return as_mesh(self.vertices, self.triangles)

    @cached_property
    def distinct(self) -> Bool[np.ndarray, " N"]:
        """True for the first of equal triangles."""
        return distinct_triangles(self.triangles)

    @cached_property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of triangles with a common edge."""
        return neighbours(self.vertices, self.triangles)[:2]

    @cached_property
    def handle_rows(self) -> csr_array:
        """Basis (C, 4N) of the handles in ``graph``."""
        return self.graph.basis(self.handles)

    @cached_property
    def handle_normal(self) -> Float[np.ndarray, "M M"]:
        """The handles' normal matrix (4N, 4N), all of one weight: it is the same for every draw."""
        return (self.handle_rows.T @ self.handle_rows).toarray()

    def prepare(self) -> None:
        """Make now what is otherwise made when the part is first bent."""
        for name, value in vars(type(self)).items():
            if isinstance(value, cached_property):
                getattr(self, name)
        _ = self.surface.boxes


@dataclass(frozen=True, eq=False)
class Sources:
    """Training shapes as a store of parts.

    ``positions`` (T, K, 3) are corresponding points in normal coordinates, NaN where absent; ``exists`` (T, L) tells
    which parts a shape has; ``touching`` (L, L) is the share of the shapes having both parts on which the two touch;
    labels of the ``painted`` shapes are taken at their word; without ``smooth`` borders follow the edges of the faces.
    """

    names: tuple[str, ...]
    positions: Float[np.ndarray, "T K 3"]
    exists: Bool[np.ndarray, "T L"]
    part: Int[np.ndarray, " K"]
    part_names: tuple[str, ...]
    touching: Float[np.ndarray, "L L"]
    get_shape: Callable[[int], Shape]
    face_labels: Sequence[np.ndarray]
    painted: frozenset[str] = frozenset()
    smooth: bool = True
    keep: int = 64
    _cache: OrderedDict = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def n_parts(self) -> int:
        """Number of parts L."""
        return len(self.part_names)

    @cached_property
    def mirror(self) -> FamilyMirror:
        """The family's mirror plane; found when it is first asked for."""
        return find_mirror(self.positions, self.exists, self.part)

    def parts_of(self, index: int) -> dict[int, SourcePart]:
        """Usable parts of training shape ``index``; kept in memory for the last ``keep`` shapes."""
        with self._lock:
            if index in self._cache:
                self._cache.move_to_end(index)
                return self._cache[index]
        parts = read_parts(
            self.get_shape(index), np.asarray(self.face_labels[index]), self.positions[index], self.part, self.n_parts,
            painted=self.names[index] in self.painted, smooth=self.smooth, mirror=self.mirror,
        )  # fmt: skip
        with self._lock:
            self._cache[index] = parts
            while len(self._cache) > self.keep:
                self._cache.popitem(last=False)
        return parts

    def is_read(self, index: int) -> bool:
        """Whether the parts of training shape ``index`` are in memory."""
        with self._lock:
            return index in self._cache

    def part_of(self, index: int, part: int) -> SourcePart | None:
        """One part of training shape ``index``; None if its mesh has no usable face of it."""
        return self.parts_of(index).get(part)


def make_sources(
    names: Sequence[str],
    get_shape: Callable[[int], Shape],
    face_labels: Sequence[np.ndarray],
    positions: Float[np.ndarray, "T K 3"],
    part: Int[np.ndarray, " K"],
    part_names: Sequence[str],
    painted: Collection[str] = (),
) -> Sources:
    """Sources of T training shapes.  Only the corresponding points are looked at now; meshes are read on demand.

    ``get_shape(i)`` and ``face_labels[i]`` ((n_faces,) part index, -1 unlabelled) may be as lazy as they like.
    The labels of the ``painted`` shapes are taken at their word, those of the others are tidied.
    """
    if positions.ndim != 3 or positions.shape[:2] != (len(names), len(part)):
        raise ValueError(
            f"positions: wanted (T, K, 3) = ({len(names)}, {len(part)}, 3), got {positions.shape}. "
            "One row of corresponding points per name, in the same order of template points as `part`."
        )
    n_parts = len(part_names)
    if len(part) and (part.min() < 0 or part.max() >= n_parts):
        raise ValueError(f"part: wanted indices 0..{n_parts - 1}, got {part.min()}..{part.max()}.")
    present = np.isfinite(positions).all(axis=2)
    exists = np.stack([present[:, part == l].sum(axis=1) >= FEWEST_POINTS for l in range(n_parts)], axis=1)
    touching = touching_shares(positions, part, n_parts)
    return Sources(
        tuple(names), positions, exists, part, tuple(part_names), touching, get_shape, face_labels, frozenset(painted)
    )


def touching_shares(
    positions: Float[np.ndarray, "T K 3"], part: Int[np.ndarray, " K"], n_parts: int, most: int = 40
) -> Float[np.ndarray, "L L"]:
    """Share of shapes (of at most ``most``, evenly chosen) on which two parts touch, as far as their points can tell.

    Points of touching parts are as near as neighbouring points of one part are: nearer than twice the spacing
    (the 9th decile of nearest distances) of the sparser part.
    """
    present = np.isfinite(positions).all(axis=2)
    counts = np.stack([present[:, part == l].sum(axis=1) for l in range(n_parts)], axis=1)
    present &= (counts >= FEWEST_POINTS)[:, part]
    both, near = np.zeros((n_parts, n_parts)), np.zeros((n_parts, n_parts))
    for t in np.unique(np.linspace(0, len(positions) - 1, min(most, len(positions))).astype(int)):
        trees, spacing = {}, {}
        for l in range(n_parts):
            points = positions[t, present[t] & (part == l)]
            if len(points) > 1:
                trees[l] = cKDTree(points)
                spacing[l] = float(np.quantile(trees[l].query(points, k=2)[0][:, 1], 0.9))
        for l in trees:
            for other in trees:
                if other > l:
                    both[l, other] += 1
                    distance = trees[other].query(trees[l].data)[0].min()
                    near[l, other] += distance < 2 * max(spacing[l], spacing[other], 0.005)
    share = np.divide(near, both, out=np.zeros_like(near), where=both > 0)
    return share + share.T


def read_parts(
    shape: Shape,
    faces: Int[np.ndarray, " F"],
    positions: Float[np.ndarray, "K 3"],
    part: Int[np.ndarray, " K"],
    n_parts: int,
    *,
    painted: bool = False,
    smooth: bool = True,
    mirror: FamilyMirror | None = None,
) -> dict[int, SourcePart]:
    """Every part of a shape: cut from the mesh by label, cleanly, with handles, quality and anchors.

    Without the family's ``mirror`` no part is found to be on one side only.
    """
    mesh = shape.mesh
    if len(faces) != mesh.n_faces:
        raise ValueError(
            f"faces: wanted one label per face record of {shape.name} ({mesh.n_faces}), got {len(faces)}. "
            "Do the labels belong to another version of the mesh?"
        )
    labels = np.asarray(faces)[mesh.face_of_triangle]
    cut = cut_mesh(mesh, labels, np.asarray(positions, float), part, n_parts, painted=painted, smooth=smooth)
    one_sided = np.zeros(n_parts) if mirror is None else one_sided_shares(cut, positions, part, mirror)
    found: dict[int, SourcePart] = {}
    for l in range(n_parts):
        template = np.flatnonzero((part == l) & np.isfinite(positions).all(axis=1))
        if not (cut.label == l).any() or len(template) == 0:
            continue
        handles = np.asarray(positions[template], float)
        vertices, triangles, quality = cut_part(cut, l, handles)
        found[l] = SourcePart(
            shape.name, l, vertices, triangles, touching_pieces(vertices, triangles), template, handles,
            replace(quality, one_sided=float(one_sided[l])),
            colours=_colours_of(mesh, labels == l, vertices[triangles].mean(axis=1)),
        )  # fmt: skip
    anchors = _find_anchors(found)
    return {l: replace(source, anchors=anchors[l]) for l, source in found.items()}


def _colours_of(
    mesh: Mesh, own: Bool[np.ndarray, " M"], centres: Float[np.ndarray, "N 3"]
) -> UInt8[np.ndarray, "N 3"] | None:
    """Colours of triangles with these ``centres``, cut from a mesh: those of the nearest of the part's ``own``.

    What cleaning gave to the part has the colours around it, as lids have.
    """
    if mesh.colours is None:
        return None
    rows = np.flatnonzero(own) if own.any() else np.arange(len(own))
    under = closest_points(as_mesh(mesh.vertices, mesh.triangles[rows]), centres)[1]
    return mesh.colours[mesh.face_of_triangle[rows[under]]]


def land_on(
    at: Float[np.ndarray, "A 3"], template: Int[np.ndarray, " C"], points: Float[np.ndarray, "C 3"]
) -> tuple[Int[np.ndarray, "A m"], Float[np.ndarray, "A m"], Float[np.ndarray, "A 3"]]:
    """``landing``, ``weight`` and ``offset`` of :class:`Anchors` for places ``at`` a part with these points."""
    count = min(LANDING, len(points))
    distance, near = (found.reshape(len(at), count) for found in cKDTree(points).query(at, k=count))
    weight = 1 / (distance**2 + (0.25 * distance.mean(axis=1, keepdims=True)) ** 2 + 1e-12)
    weight /= weight.sum(axis=1, keepdims=True)
    return template[near], weight, at - (weight[..., None] * points[near]).sum(axis=1)


def _find_anchors(parts: Mapping[int, SourcePart]) -> dict[int, dict[int, Anchors]]:
    """For each part and each other one that it touches, up to ANCHORS vertices of the contact, spread over it."""
    anchors: dict[int, dict[int, Anchors]] = {l: {} for l in parts}
    for other, surface in parts.items():
        asking = [l for l in parts if l != other]
        if not asking:
            continue
        queries = np.concatenate([parts[l].vertices for l in asking])
        mesh = as_mesh(surface.vertices, surface.triangles)
        _, triangle, distance = closest_points(mesh, queries)
        start = 0
        for l in asking:
            rows = start + np.arange(len(parts[l].vertices))
            start += len(rows)
            near = float(distance[rows].min())
            if near > NEAR_CONTACT:
                continue
            close = np.flatnonzero(distance[rows] <= max(CONTACT, near + 0.005))
            chosen = close[farthest_points(parts[l].vertices[close], ANCHORS)]
            into = directions_into(parts[l].vertices, parts[l].piece, chosen, mesh, triangle[rows[chosen]])
            deep = depths(parts[l].vertices[chosen], into, parts[l].piece[chosen], mesh)
            landing = land_on(parts[l].vertices[chosen], surface.template, surface.handles)
            anchors[l][other] = Anchors(chosen, distance[rows[chosen]], into, deep, *landing)
    return anchors
