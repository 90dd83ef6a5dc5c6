"""One part bent to the points of a draw: affine pre-alignment piece by piece, then embedded deformation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.sparse import vstack

from shapeforge.collection.shape import Mesh
from shapeforge.synthesis.embedded import Problem, Weights, even_strength, pre_align, solve_exactly, solve_quickly
from shapeforge.synthesis.measures import inverted_triangles
from shapeforge.synthesis.sources import Anchors, SourcePart

ANCHOR_STRENGTH = 20.0
"""Weight of an anchor, in constraints per node: a contact outweighs the drawn points around it."""
OWN_MAP = 24
"""A piece with at least so many handles is pre-aligned by itself: four legs spread without growing fat."""
STIFFER = (1.0, 8.0, 64.0)
"""Factors of the regular term to try in turn while the bent part has folds."""


@dataclass(frozen=True, eq=False)
class BentPart:
    """A part under way: ``drawn`` is where the draw wants its handles, ``targets`` what the contacts made of that.

    ``affine`` are the vertices under the whole part's affine map, which folds nothing;
    ``rest`` is the pre-alignment per node; ``start`` are the graph's unknowns after the pre-alignment alone, ``x`` as
    bent so far; ``anchors`` by other part.
    """

    source: SourcePart
    drawn: Float[np.ndarray, "C 3"]
    targets: Float[np.ndarray, "C 3"]
    affine: Float[np.ndarray, "V 3"]
    rest: Float[np.ndarray, "N 3 3"]
    start: Float[np.ndarray, "M 3"]
    x: Float[np.ndarray, "M 3"]
    anchors: Mapping[int, Anchors]

    @cached_property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices as bent so far."""
        return self.source.rows @ self.x

    @cached_property
    def surface(self) -> Mesh:
        """The bent part as a mesh."""
        return self.source.surface.moved(self.vertices)


def start_part(source: SourcePart, points: Float[np.ndarray, "K 3"]) -> BentPart | None:
    """The part under its affine pre-alignment, each larger piece under its own; None without targets."""
    known = np.isfinite(points[source.template]).all(axis=1)
    if not known.any():
        return None
    targets = np.where(known[:, None], points[source.template], np.nan)
    nodes = source.graph.nodes
    matrix, offset = pre_align(source.handles[known], targets[known])
    rest = np.broadcast_to(matrix, (len(nodes), 3, 3)).copy()
    moved = nodes @ matrix.T + offset
    piece_of_handle, piece_of_node = source.piece_of_handle, source.piece_of_node
    for c in np.unique(piece_of_node):
        own = known & (piece_of_handle == c)
        if own.sum() >= OWN_MAP and own.sum() < known.sum():
            own_matrix, own_offset = pre_align(source.handles[own], targets[own])
            rest[piece_of_node == c] = own_matrix
            moved[piece_of_node == c] = nodes[piece_of_node == c] @ own_matrix.T + own_offset
    x = np.concatenate([rest.transpose(0, 2, 1), moved[:, None]], axis=1).reshape(-1, 3)
    return BentPart(source, targets, targets, source.vertices @ matrix.T + offset, rest, x, x, source.anchors)


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
    fewest, best = np.inf, part.x
    for factor in STIFFER[:1] if preview else STIFFER:
        weights = Weights(regular=factor * Weights.regular)
        problem = Problem(
            source.graph, matrix, np.concatenate(targets), np.concatenate(strength), part.rest, weights, normal
        )  # fmt: skip
        x = part.x
        for state in (solve_quickly if preview else solve_exactly)(problem, x):
            x = state.x
        folds = 0 if preview else count_folds(part, x)
        if folds < fewest:
            fewest, best = folds, x
        if fewest == 0:
            break
    return replace(part, x=best)


def count_folds(part: BentPart, x: Float[np.ndarray, "M 3"]) -> int:
    """Folds of the part bent by the unknowns ``x``, beyond those of its mesh (see :func:`inverted_triangles`)."""
    source = part.source
    return inverted_triangles(part.affine, source.rows @ x, source.triangles, source.neighbours)
