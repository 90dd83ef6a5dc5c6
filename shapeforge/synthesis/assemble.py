"""A mesh for a draw: its parts retrieved, bent to the drawn points, held together where they touch, and merged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import vstack
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

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
"""A piece with at least so many handles is pre-aligned by itself: four legs spread without growing fat."""
SLACK = 0.003
"""An anchor may be so much (diagonals) farther from the other part than it was on its training shape."""
FARTHEST_CONTACT = 0.06
"""Parts that only one training shape or most others join are left apart if the draw sets them farther apart than this."""
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
    """The part under its affine pre-alignment, each larger piece under its own; None without targets."""
    known = np.isfinite(points[source.template]).all(axis=1)
    if not known.any():
        return None
    targets = np.where(known[:, None], points[source.template], np.nan)
    nodes = source.graph.nodes
    matrix, offset = pre_align(source.handles[known], targets[known])
    rest = np.broadcast_to(matrix, (len(nodes), 3, 3)).copy()
    moved = nodes @ matrix.T + offset
    vertex = cKDTree(source.vertices)
    piece_of_handle = source.piece[vertex.query(source.handles)[1]]
    piece_of_node = source.piece[vertex.query(nodes)[1]]
    for c in np.unique(piece_of_node):
        own = known & (piece_of_handle == c)
        if own.sum() >= OWN_MAP and own.sum() < known.sum():
            own_matrix, own_offset = pre_align(source.handles[own], targets[own])
            rest[piece_of_node == c] = own_matrix
            moved[piece_of_node == c] = nodes[piece_of_node == c] @ own_matrix.T + own_offset
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
    """The part with its targets shifted as its held vertices are, piece by piece.

    A piece that can follow by stretching (the shift points along the way from the contact to its middle, as at the top of
    a leg) does so: the shift fades out over FALLOFF.  One that would have to bend or shear is carried as a whole.
    """
    if not held:
        return part
    source = part.source
    vertices = np.fromiter(held, np.int64)
    here = source.rows[vertices] @ part.x
    shifts = np.stack([held[v] for v in held]) - here
    handles = source.handle_rows @ part.x
    piece_of_handle = source.piece[cKDTree(source.vertices).query(source.handles)[1]]
    targets = part.targets.copy()
    for piece in np.unique(source.piece[vertices]):
        own, at = piece_of_handle == piece, source.piece[vertices] == piece
        if not own.any():
            continue
        stretch = _stretchiness(handles[own], here[at], shifts[at])
        distance = cdist(handles[own], here[at])
        weight = 1 / (distance**2 + (FALLOFF / 3) ** 2)
        shift = weight @ shifts[at] / weight.sum(axis=1, keepdims=True)
        fade = 1 - stretch * (1 - np.exp(-0.5 * (distance.min(axis=1) / FALLOFF) ** 2))
        targets[own] += fade[:, None] * shift
    return replace(part, targets=targets)


def _stretchiness(points: np.ndarray, anchors: np.ndarray, shifts: np.ndarray) -> float:
    """0 (moving the anchors by ``shifts`` bends a piece with these points, or only moves it) to 1 (it stretches)."""
    direction = shifts.mean(axis=0)
    length = float(np.linalg.norm(direction))
    reach = float(np.linalg.norm(np.ptp(points, axis=0))) / 2
    if length < 1e-9 or reach < 1e-9:
        return 0.0
    along = abs(float((points.mean(axis=0) - anchors.mean(axis=0)) @ direction)) / length
    return min(1.0, along / reach)


def choose_contacts(bent: Mapping[int, BentPart], touching: Float[np.ndarray, "L L"]) -> list[tuple[int, int]]:
    """Pairs of present parts that should touch: both training parts touched the other, or one did and most shapes do.

    In the second case only if the draw has them near: a T-tail rests on the fin, whatever most tailplanes do.
    """
    pairs = []
    for l in bent:
        for other in bent:
            if l < other:
                told = [way for way in ((l, other), (other, l)) if way[1] in bent[way[0]].source.anchors]
                if len(told) == 2 or (len(told) == 1 and touching[l, other] >= 0.5 and _near(bent, *told[0])):
                    pairs.append((l, other))
    return pairs


def _near(bent: Mapping[int, BentPart], l: int, other: int) -> bool:
    anchors = bent[l].source.rows[bent[l].source.anchors[other][0]] @ bent[l].x
    return bool(closest_points(bent[other].surface, anchors)[2].min() <= FARTHEST_CONTACT)


def hold_contacts(
    bent: Mapping[int, BentPart], contacts: list[tuple[int, int]]
) -> dict[int, dict[int, np.ndarray]]:
    """Where the anchors that came loose should go: {part: {vertex: position}}.

    Loose means farther from the other part than on the training shape, so a leg let into its seat stays as deep.  Of the two parts of a contact that one moves whose anchors are nearer to the other's surface (the top ends of
    other legs may sit anywhere under a seat, but a corner of the seat should not reach out for them), and rather one that
    stretches than one that bends: the fin reaches up to the tailplane, the tailplane does not sag onto the fin.
    """
    loose: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, float]] = {}
    for other, piece in bent.items():
        asking = [sum(pair) - other for pair in contacts if other in pair]
        asking = [l for l in asking if other in bent[l].source.anchors]
        if not asking:
            continue
        places = [bent[l].source.rows[bent[l].source.anchors[other][0]] @ bent[l].x for l in asking]
        position, _, distance = closest_points(piece.surface, np.concatenate(places))
        ends = np.cumsum([len(p) for p in places])[:-1]
        for l, q, p, d in zip(asking, places, np.split(position, ends), np.split(distance, ends), strict=True):
            vertices, before = bent[l].source.anchors[other]
            far = d > before + SLACK
            bending = 2.0 - _stretchiness(bent[l].vertices, q, p - q)
            loose[l, other] = vertices[far], p[far], bending * float(d.mean())
    held: dict[int, dict[int, np.ndarray]] = {l: {} for l in bent}
    for pair in contacts:
        l, other = min((way for way in (pair, pair[::-1]) if way in loose), key=lambda way: loose[way][2])
        vertices, positions, _ = loose[l, other]
        held[l].update(zip(vertices.tolist(), positions, strict=True))
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
            gap(surfaces[l].vertices, surfaces[l].triangles, *bent[l].source.anchors[other], surfaces[other])
            for l, other in (pair, pair[::-1])
            if other in bent[l].source.anchors
        ]
        gaps[f"{part_names[pair[0]]} – {part_names[pair[1]]}"] = min(found)
    return gaps
