"""A mesh for a draw: its parts retrieved, bent to the drawn points, held together where they touch, and merged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import vstack
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.embedded import Problem, even_strength, pre_align, solve_exactly, solve_quickly
from shapeforge.synthesis.measures import gap, inverted_triangles, symmetry_error
from shapeforge.synthesis.retrieve import retrieve
from shapeforge.synthesis.sources import SourcePart, Sources
from shapeforge.synthesis.surfaces import as_mesh, good_triangles

ANCHOR_STRENGTH = 20.0
"""Weight of an anchor, in constraints per node: a contact outweighs the drawn points around it."""
FALLOFF = 0.12
"""Drawn points move along with an anchor up to about this distance (diagonals), so that the part bends and doesn't kink."""
OWN_MAP = 24
"""A connected component with at least so many handles is pre-aligned by itself: four legs spread without growing fat."""
CONTACT_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class SynthesizedShape:
    """A labelled mesh in normal coordinates: ``part`` (N,) of every triangle; ``sources[l]`` is the shape part l came from.

    ``sources`` is "" for absent parts.  ``measures`` is ready for JSON: largest gap, gap per touching pair, symmetry error
    and distance of the handles from the draw (diagonals), number of folded triangle pairs.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    part: Int[np.ndarray, " N"]
    part_names: tuple[str, ...]
    sources: tuple[str, ...]
    measures: dict


@dataclass(frozen=True, eq=False)
class BentPart:
    """A part under way: where the draw wants its handles and where the contacts made of that; ``rest`` map per node;

    unknowns ``start`` of the graph (after the pre-alignment alone) and ``x`` (as bent so far).
    """

    source: SourcePart
    drawn: Float[np.ndarray, "C 3"]
    targets: Float[np.ndarray, "C 3"]
    rest: Float[np.ndarray, "N 3 3"]
    start: Float[np.ndarray, "M 3"]
    x: Float[np.ndarray, "M 3"]

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices as bent so far."""
        return self.source.rows @ self.x

    @property
    def surface(self) -> Mesh:
        """The bent part as a mesh."""
        return as_mesh(self.vertices, self.source.triangles)


def synthesize(
    points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], sources: Sources, *, preview: bool = False,
    shapes: Int[np.ndarray, " L"] | None = None,
) -> SynthesizedShape:  # fmt: skip
    """The mesh of one draw: ``points`` in normal coordinates (NaN where absent), ``exists`` per part.

    ``preview`` uses the quick solver and one look at the contacts: for a slider that moves.  ``shapes`` (index of a
    training shape per part, -1 none) replaces the retrieval: keep it while a slider moves and the parts don't flicker.
    A part that no training shape offers is left out, its source "".
    """
    if points.shape != (len(sources.part), 3) or exists.shape != (sources.n_parts,):
        raise ValueError(
            f"points, exists: wanted ({len(sources.part)}, 3) and ({sources.n_parts},), got {points.shape} and "
            f"{exists.shape}. Do the draw and the sources come from the same fit?"
        )
    if shapes is None:
        shapes = retrieve(points, exists, sources).shape
    bent: dict[int, BentPart] = {}
    for l in np.flatnonzero(exists & (shapes >= 0)):
        source = sources.part_of(int(shapes[l]), int(l))
        started = None if source is None else start_part(source, points)
        if started is not None:
            bent[int(l)] = bend(started, {}, preview=True)
    contacts = choose_contacts(bent, sources.touching)
    for turn in range(1 if preview else CONTACT_ROUNDS):
        held = hold_contacts(bent, contacts)
        for l, part in bent.items():
            if held[l] or (turn == 0 and not preview):
                bent[l] = bend(carry_along(part, held[l]), held[l], preview=preview)
    return _merge(bent, contacts, sources)


def start_part(source: SourcePart, points: Float[np.ndarray, "K 3"]) -> BentPart | None:
    """The part under its affine pre-alignment, each larger connected component under its own; None without targets."""
    known = np.isfinite(points[source.template]).all(axis=1)
    if not known.any():
        return None
    targets = np.where(known[:, None], points[source.template], np.nan)
    nodes = source.graph.nodes
    matrix, offset = pre_align(source.handles[known], targets[known])
    rest = np.broadcast_to(matrix, (len(nodes), 3, 3)).copy()
    moved = nodes @ matrix.T + offset
    vertex = cKDTree(source.vertices)
    component_of_handle = source.component[vertex.query(source.handles)[1]]
    component_of_node = source.component[vertex.query(nodes)[1]]
    for c in np.unique(component_of_node):
        own = known & (component_of_handle == c)
        if own.sum() >= OWN_MAP and own.sum() < known.sum():
            own_matrix, own_offset = pre_align(source.handles[own], targets[own])
            rest[component_of_node == c] = own_matrix
            moved[component_of_node == c] = nodes[component_of_node == c] @ own_matrix.T + own_offset
    x = np.concatenate([rest.transpose(0, 2, 1), moved[:, None]], axis=1).reshape(-1, 3)
    return BentPart(source, targets, targets, rest, x, x)


def bend(part: BentPart, held: Mapping[int, np.ndarray], *, preview: bool) -> BentPart:
    """The part bent to its targets and to ``held`` (vertex -> position wanted by a contact)."""
    source = part.source
    known = np.isfinite(part.targets).all(axis=1)
    rows, targets = [source.handle_rows[known]], [part.targets[known]]
    strength = [even_strength(int(known.sum()), len(source.graph.nodes))]
    if held:
        vertices = np.fromiter(held, np.int64)
        rows.append(source.rows[vertices])
        targets.append(np.stack([held[v] for v in held]))
        strength.append(np.full(len(held), ANCHOR_STRENGTH))
    problem = Problem(
        source.graph, vstack(rows, format="csr"), np.concatenate(targets), np.concatenate(strength), part.rest
    )
    x = part.x
    for state in (solve_quickly if preview else solve_exactly)(problem, x):
        x = state.x
    return replace(part, x=x)


def carry_along(part: BentPart, held: Mapping[int, np.ndarray]) -> BentPart:
    """The part with its targets shifted as the nearest held vertex is, fading out over FALLOFF."""
    if not held:
        return part
    vertices = np.fromiter(held, np.int64)
    shift = np.stack([held[v] for v in held]) - part.source.rows[vertices] @ part.x
    distance, nearest = cKDTree(part.source.vertices[vertices]).query(part.source.handles)
    fade = np.exp(-0.5 * (distance / FALLOFF) ** 2)
    return replace(part, targets=part.targets + fade[:, None] * shift[nearest])


def choose_contacts(bent: Mapping[int, BentPart], touching: Float[np.ndarray, "L L"]) -> list[tuple[int, int]]:
    """Pairs of present parts that should touch: both training parts touched the other, or one did and most shapes do."""
    pairs = []
    for l in bent:
        for other in bent:
            if l < other:
                told = (other in bent[l].source.anchors) + (l in bent[other].source.anchors)
                if told == 2 or (told == 1 and touching[l, other] >= 0.5):
                    pairs.append((l, other))
    return pairs


def hold_contacts(
    bent: Mapping[int, BentPart], contacts: list[tuple[int, int]]
) -> dict[int, dict[int, np.ndarray]]:
    """Where each part's anchors should go: {part: {vertex: position}}.

    Of the two parts of a contact that one moves whose anchors are nearer to the other's surface already: the top ends of
    other legs may sit anywhere under a seat, but a corner of the seat should not reach out for them.
    """
    wanted: dict[tuple[int, int], tuple[np.ndarray, float]] = {}
    for other, piece in bent.items():
        asking = [sum(pair) - other for pair in contacts if other in pair]
        asking = [l for l in asking if other in bent[l].source.anchors]
        if not asking:
            continue
        anchors = [(bent[l].source.rows[bent[l].source.anchors[other]]) @ bent[l].x for l in asking]
        position, _, distance = closest_points(piece.surface, np.concatenate(anchors))
        ends = np.cumsum([len(a) for a in anchors])[:-1]
        for l, p, d in zip(asking, np.split(position, ends), np.split(distance, ends), strict=True):
            wanted[l, other] = p, float(d.mean())
    held: dict[int, dict[int, np.ndarray]] = {l: {} for l in bent}
    for pair in contacts:
        l, other = min((way for way in (pair, pair[::-1]) if way in wanted), key=lambda way: wanted[way][1])
        held[l].update(zip(bent[l].source.anchors[other].tolist(), wanted[l, other][0], strict=True))
    return held


def _merge(bent: Mapping[int, BentPart], contacts: list[tuple[int, int]], sources: Sources) -> SynthesizedShape:
    """All parts in one mesh, without triangles that collapsed, and its measures."""
    vertices, triangles, part, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int32)], 0
    folds, miss = 0, []
    for l, piece in bent.items():
        moved = piece.vertices
        keep = good_triangles(moved, piece.source.triangles)
        vertices.append(moved)
        triangles.append((piece.source.triangles[keep] + count).astype(np.int32))
        part.append(np.full(int(keep.sum()), l, np.int32))
        count += len(moved)
        folds += inverted_triangles(piece.source.rows @ piece.start, moved, piece.source.triangles)
        known = np.isfinite(piece.drawn).all(axis=1)
        miss.append(np.linalg.norm(piece.source.handle_rows[known] @ piece.x - piece.drawn[known], axis=1))
    gaps = _gaps(bent, contacts, sources.part_names)
    handles = [node for piece in bent.values() for node in piece.source.handle_rows @ piece.x]
    measures = {
        "largest_gap": max(gaps.values(), default=0.0),
        "gaps": gaps,
        "symmetry_error": symmetry_error(np.array(handles)) if handles else None,
        "folded_triangles": folds,
        "distance_from_draw": float(np.concatenate(miss).mean()) if miss else None,
        "n_triangles": int(sum(len(t) for t in triangles)),
    }
    names = tuple(bent[l].source.shape if l in bent else "" for l in range(sources.n_parts))
    return SynthesizedShape(
        np.concatenate(vertices), np.concatenate(triangles), np.concatenate(part), sources.part_names, names, measures
    )


def _gaps(bent: Mapping[int, BentPart], contacts: list[tuple[int, int]], part_names: tuple[str, ...]) -> dict:
    """Gap of every contact (diagonals), measured from the part whose pieces are to hold on to the other."""
    surfaces = {l: piece.surface for l, piece in bent.items()}
    gaps = {}
    for pair in contacts:
        found = [
            gap(surfaces[l].vertices, surfaces[l].triangles, bent[l].source.anchors[other], surfaces[other])
            for l, other in (pair, pair[::-1])
            if other in bent[l].source.anchors
        ]
        gaps[f"{part_names[pair[0]]} – {part_names[pair[1]]}"] = min(found)
    return gaps
