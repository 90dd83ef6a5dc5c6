"""One part bent to the points of a draw: affine pre-alignment piece by piece, then embedded deformation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array, vstack

from shapeforge.collection.shape import Mesh
from shapeforge.synthesis.embedded import Problem, Weights, even_strength, pre_align, solve_exactly, solve_quickly
from shapeforge.synthesis.measures import inverted_pairs, inverted_triangles
from shapeforge.synthesis.sources import Anchors, SourcePart

ANCHOR_STRENGTH = 20.0
"""Weight of an anchor, in constraints per node: a contact outweighs the drawn points around it."""
OWN_MAP = 24
"""A piece with at least so many handles is pre-aligned by itself: four legs spread without growing fat."""
STIFFER = (1.0, 8.0, 64.0)
"""Factors of the regular term to try in turn while the bent part has folds."""
UNFOLDINGS = 60
"""Rounds in which vertices about a fold are moved with their neighbours, at most."""
RADII = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 1e3)
"""Radii (diagonals) about a fold to try in turn, if that does not undo it; the last is all of the part."""


@dataclass(frozen=True, eq=False)
class BentPart:
    """A part under way: ``drawn`` is where the draw wants its handles, ``targets`` what the contacts made of that.

    ``affine`` are the vertices under the whole part's affine map, which folds nothing;
    ``rest`` is the pre-alignment per node; ``start`` are the graph's unknowns after the pre-alignment alone, ``x`` as
    bent so far; ``anchors`` by other part; ``eased`` are the vertices if they were moved since (see :func:`unfolded`).
    """

    source: SourcePart
    drawn: Float[np.ndarray, "C 3"]
    targets: Float[np.ndarray, "C 3"]
    affine: Float[np.ndarray, "V 3"]
    rest: Float[np.ndarray, "N 3 3"]
    start: Float[np.ndarray, "M 3"]
    x: Float[np.ndarray, "M 3"]
    anchors: Mapping[int, Anchors]
    eased: Float[np.ndarray, "V 3"] | None = None

    @cached_property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices as bent so far."""
        return self.source.rows @ self.x if self.eased is None else self.eased

    @cached_property
    def placed(self) -> Float[np.ndarray, "C 3"]:
        """Handles as bent so far."""
        return self.source.handle_rows @ self.x

    @cached_property
    def surface(self) -> Mesh:
        """The bent part as a mesh."""
        return self.source.surface.moved(self.vertices)

    @cached_property
    def folds(self) -> int:
        """Folds as bent so far, beyond those of the part's own mesh (see :func:`inverted_pairs`)."""
        return inverted_triangles(self.affine, self.vertices, self.source.triangles, self.source.neighbours)


def start_part(source: SourcePart, points: Float[np.ndarray, "K 3"]) -> BentPart | None:
    """The part under its affine pre-alignment, each larger piece under its own; None without targets."""
    targets = np.where(np.isfinite(points[source.template]).all(axis=1)[:, None], points[source.template], np.nan)
    if not np.isfinite(targets).any():
        return None
    matrix, offset, rest, x = _pre_aligned(source, targets)
    return BentPart(source, targets, targets, source.vertices @ matrix.T + offset, rest, x, x, source.anchors)


def aim(part: BentPart, targets: Float[np.ndarray, "C 3"]) -> BentPart:
    """The part, as bent so far, with other targets and the pre-alignment to these: what they ask for is no strain."""
    return replace(part, targets=targets, rest=_pre_aligned(part.source, targets)[2])


def _pre_aligned(source: SourcePart, targets: Float[np.ndarray, "C 3"]) -> tuple[np.ndarray, ...]:
    """The affine map (matrix, offset) of the whole part to its targets, and of the nodes, each with its piece: the
    linear maps (N, 3, 3) and the graph's unknowns (M, 3)."""
    known = np.isfinite(targets).all(axis=1)
    nodes = source.graph.nodes
    matrix, offset = pre_align(source.handles[known], targets[known])
    rest = np.broadcast_to(matrix, (len(nodes), 3, 3)).copy()
    moved = nodes @ matrix.T + offset
    for c in np.unique(source.piece_of_node):
        own, at = known & (source.piece_of_handle == c), source.piece_of_node == c
        if own.sum() >= OWN_MAP and own.sum() < known.sum():
            own_matrix, own_offset = pre_align(source.handles[own], targets[own])
            rest[at] = own_matrix
            moved[at] = nodes[at] @ own_matrix.T + own_offset
    return matrix, offset, rest, np.concatenate([rest.transpose(0, 2, 1), moved[:, None]], axis=1).reshape(-1, 3)


def bend(part: BentPart, held: Mapping[int, np.ndarray], *, preview: bool) -> BentPart:
    """The part bent to its targets and to ``held`` (vertex -> position wanted by a contact).

    Thin plates fold where noisy targets pull their sides apart; what folds is bent again, stiffer (not in previews).
    """
    source = part.source
    known = np.isfinite(part.targets).all(axis=1)
    rows, targets = [source.handle_rows[known]], [part.targets[known]]
    strength = [even_strength(int(known.sum()), len(source.graph.nodes))]
    normal = strength[0][0] * source.handle_normal if known.all() else None
    if held:
        vertices = np.fromiter(held, np.int64)
        rows.append(source.rows[vertices])
        targets.append(np.stack([held[v] for v in held]))
        strength.append(np.full(len(held), ANCHOR_STRENGTH))
        if normal is not None:
            normal += ANCHOR_STRENGTH * (rows[1].T @ rows[1]).toarray()
    matrix = vstack(rows, format="csr")
    best = None
    for factor in STIFFER[:1] if preview else STIFFER:
        weights = Weights(regular=factor * Weights.regular)
        problem = Problem(
            source.graph, matrix, np.concatenate(targets), np.concatenate(strength), part.rest, weights, normal
        )  # fmt: skip
        x = part.x
        for state in (solve_quickly if preview else solve_exactly)(problem, x):
            x = state.x
        found = replace(part, x=x)
        if best is None or (found.folds < best.folds):
            best = found
        if preview or best.folds == 0:
            break
    return best


def unfolded(part: BentPart) -> BentPart:
    """The part with what is folded still moved as little as will undo it.

    The affine map folds nothing, and displacements from it that are alike don't either.  The least folded is kept, and
    of those the one that moved least: contacts were closed before.
    """
    if part.folds == 0:
        return part
    eased = _eased(part)
    found = [eased, _flattened(part, part.vertices)]
    if all(_n_folds(part, vertices) for vertices in found):
        found.append(_flattened(part, eased))
    moved = [float(np.abs(vertices - part.vertices).max()) for vertices in found]
    best = min(range(len(found)), key=lambda i: (_n_folds(part, found[i]), moved[i]))
    return replace(part, eased=found[best])


def _n_folds(part: BentPart, vertices: Float[np.ndarray, "V 3"]) -> int:
    return inverted_triangles(part.affine, vertices, part.source.triangles, part.source.neighbours)


def _eased(part: BentPart) -> Float[np.ndarray, "V 3"]:
    """The vertices; those about what is folded still are moved with their neighbours, until nothing is."""
    source, vertices = part.source, part.vertices
    best, fewest, n = vertices, np.inf, len(vertices)
    ends = np.concatenate([source.triangles[:, [0, 1]], source.triangles[:, [1, 2]], source.triangles[:, [2, 0]]])
    joined = csr_array((np.ones(2 * len(ends)), np.concatenate([ends, ends[:, ::-1]]).T), shape=(n, n))
    degree = np.maximum(joined.sum(axis=1), 1)[:, None]
    for turn in range(UNFOLDINGS):
        pairs = inverted_pairs(part.affine, vertices, source.triangles, source.neighbours)
        if len(pairs[0]) < fewest:
            best, fewest = vertices, len(pairs[0])
        if fewest == 0:
            break
        near = np.zeros(n)
        near[source.triangles[np.concatenate(pairs)]] = 1
        for _ in range(1 + turn // 5):  # what stays folded is eased from farther around, and more
            near = np.minimum(near + joined @ near, 1)
        shift = vertices - part.affine
        for _ in range(1 + turn):
            shift = np.where(near[:, None] > 0, (shift + (joined @ shift) / degree) / 2, shift)
        vertices = part.affine + shift
    return best


def _flattened(part: BentPart, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """The vertices; what is about a fold is displaced from the affine map as one, in the least radius that will do.

    Where a part was squeezed to nothing, displacements that are alike with their neighbours' may differ too much still.
    """
    best = vertices
    pairs = fewest = inverted_pairs(part.affine, best, part.source.triangles, part.source.neighbours)
    for radius in RADII:
        for _ in range(len(fewest[0])):
            middle = part.affine[part.source.triangles[pairs[0][0]]].mean(axis=0)
            weight = np.exp(-0.5 * ((part.affine - middle) ** 2).sum(axis=1) / radius**2)[:, None]
            shift = vertices - part.affine
            vertices = vertices + weight * ((weight * shift).sum(axis=0) / weight.sum() - shift)
            pairs = inverted_pairs(part.affine, vertices, part.source.triangles, part.source.neighbours)
            if len(pairs[0]) < len(fewest[0]):
                best, fewest = vertices, pairs
            if not len(pairs[0]):
                return best
        vertices, pairs = best, fewest
    return best
