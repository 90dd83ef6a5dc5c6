"""Parts that touched on the training shapes touch on the new one: which pairs, who moves, and where to."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.bending import BentPart, aim
from shapeforge.synthesis.depths import depths, pushed_back
from shapeforge.synthesis.measures import gap
from shapeforge.synthesis.sources import ANCHORS, Anchors, SourcePart, land_on
from shapeforge.synthesis.surfaces import farthest_points

FALLOFF = 0.12
"""Drawn points move along with an anchor up to about this distance (diagonals), so that the part doesn't kink."""
SLACK = 0.003
"""An anchor may be so much (diagonals) farther from the other part than it was on its training shape."""
FEWEST_STRAIGHT = 6
"""A piece with so many anchors is moved and stretched by a contact, but not bent ..."""
ARRIVED = 0.01
"""... if a third of these then come so near (diagonals) to the other part; only they are held."""
STRAIGHT_RIDGE = 0.02
"""Spread (diagonals) of anchors along an axis from which on they tell how to stretch along it."""
FARTHEST_CONTACT = 0.06
"""Parts that only one training shape or most others join stay apart if the draw sets them farther apart than this."""
FARTHEST_ISLAND = 0.12
"""A part that touches nothing is joined to one that it usually touches, up to this distance (diagonals)."""


def choose_contacts(bent: Mapping[int, BentPart], touching: Float[np.ndarray, "L L"]) -> list[tuple[int, int]]:
    """Pairs of present parts that should touch: both training parts touched the other, or one did and most shapes do.

    In the second case only if the draw has them near: a T-tail rests on the fin, whatever most tailplanes do.
    """
    pairs = []
    for l in bent:
        for other in bent:
            if l < other:
                told = [way for way in ((l, other), (other, l)) if way[1] in bent[way[0]].anchors]
                if len(told) == 2 or (len(told) == 1 and touching[l, other] >= 0.5 and _near(bent, *told[0])):
                    pairs.append((l, other))
    return pairs


def _near(bent: Mapping[int, BentPart], l: int, other: int) -> bool:
    anchors = bent[l].vertices[bent[l].anchors[other].vertices]
    return bool(closest_points(bent[other].surface, anchors)[2].min() <= FARTHEST_CONTACT)


def join_islands(
    bent: dict[int, BentPart], contacts: list[tuple[int, int]], touching: Float[np.ndarray, "L L"]
) -> tuple[dict[int, BentPart], list[tuple[int, int]]]:
    """Anchors and contacts for parts that nothing holds: to the part that they touch most often, where that is near.

    Happens when a part comes from a shape on which it touched only parts that the draw does not have.
    """
    bent, contacts, parts = dict(bent), list(contacts), list(bent)
    for _ in range(len(parts)):
        island, largest = _islands(bent, contacts)
        joined = False
        for l in parts:
            if island[l] == largest:
                continue
            outside = [o for o in parts if island[o] != island[l] and touching[l, o] >= 0.25]
            for other in sorted(outside, key=lambda o: -touching[l, o]):
                vertices = bent[l].vertices
                distance = closest_points(bent[other].surface, vertices)[2]
                if distance.min() <= FARTHEST_ISLAND:
                    close = np.flatnonzero(distance <= distance.min() + 0.01)
                    chosen = close[farthest_points(vertices[close], ANCHORS)]
                    nothing = np.zeros(len(chosen))
                    found = bent[other].source.template, bent[other].placed
                    held_on = Anchors(
                        chosen, distance[chosen] - distance.min(), np.zeros((len(chosen), 3)), nothing,
                        *land_on(vertices[chosen], *found),
                    )  # fmt: skip
                    bent[l] = replace(bent[l], anchors={**bent[l].anchors, other: held_on})
                    contacts.append((min(l, other), max(l, other)))
                    joined = True
                    break
            if joined:
                break
        if not joined:
            break
    return bent, contacts


def _islands(bent: Mapping[int, BentPart], contacts: list[tuple[int, int]]) -> tuple[dict[int, int], int]:
    """The group of parts, joined by contacts, that each part belongs to; and the one with most handles."""
    place = {l: i for i, l in enumerate(bent)}
    ends = np.array([(place[a], place[b]) for a, b in contacts], int).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(bent), len(bent)))
    island = connected_components(graph, directed=False)[1]
    weight = np.bincount(island, [len(part.source.handles) for part in bent.values()]) if bent else np.zeros(1)
    return {l: int(island[i]) for l, i in place.items()}, int(weight.argmax())


def island_gaps(
    bent: Mapping[int, BentPart], contacts: list[tuple[int, int]], touching: Float[np.ndarray, "L L"]
) -> dict[tuple[int, int], tuple[float, float]]:
    """Gaps as of :func:`contact_gaps` between groups of parts that no contact joins: to the nearest other part.

    A seat that comes from a swivel chair holds on to no leg, and legs drawn far off are not joined to it: neither is a
    contact that could be told to gape.  What touches nothing on its own shape, nor on most others, may stand alone.
    """
    island, largest = _islands(bent, contacts)
    found: dict[tuple[int, int], tuple[float, float]] = {}
    for one in set(island.values()) - {largest}:
        nearest = []
        for l in (l for l in bent if island[l] == one):
            others = [o for o in bent if island[o] != one]
            held = [anchors.distance.min() for anchors in bent[l].source.anchors.values()]
            if held or max(touching[l, o] for o in others) >= 0.5:
                away = {o: float(closest_points(bent[o].surface, bent[l].vertices)[2].min()) for o in others}
                away = {o: min(d, float(closest_points(bent[l].surface, bent[o].vertices)[2].min()))
                        for o, d in away.items()}  # fmt: skip
                other = min(away, key=away.__getitem__)
                new = max(0.0, away[other] - float(min(held, default=0.0)))
                nearest.append((away[other], new, (min(l, other), max(l, other))))
        if nearest:
            wide, new, pair = min(nearest)
            found[pair] = wide, new
    return found


def hold_contacts(
    bent: Mapping[int, BentPart], contacts: list[tuple[int, int]], stubborn: Collection[tuple[int, int]] = ()
) -> dict[int, dict[int, np.ndarray]]:
    """Where the anchors that came loose, or went in too deep, should go: {part: {vertex: position}}.

    Loose is what is farther from the other part than on the training shape, too deep what came farther through it.
    Of the two parts of a contact that one moves whose anchors have less far to go (the top ends of other legs may sit
    anywhere under a seat, but a corner of the seat should not reach out for them), and rather one that stretches than
    one that bends: the fin reaches up to the tailplane, the tailplane does not sag onto the fin.

    What is loose goes to the nearest surface; in the contacts that are ``stubborn`` everything goes to the place that
    corresponds to where it was on the training shape: a small shelf in the middle is as near to one leg as to another.
    """
    loose: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, tuple[bool, float]]] = {}
    for pair in contacts:
        for l, other in (pair, pair[::-1]):
            if other in bent[l].anchors:
                anchors = bent[l].anchors[other]
                here = bent[l].vertices[anchors.vertices]
                there, _, distance = closest_points(bent[other].surface, here)
                if pair in stubborn and (distance > anchors.distance + SLACK).any():
                    there = closest_points(bent[other].surface, _corresponding(anchors, bent[other], there))[0]
                    distance = np.linalg.norm(there - here, axis=1)
                moves = distance > anchors.distance + SLACK
                piece = bent[l].source.piece[anchors.vertices]
                excess = depths(here, anchors.into, piece, bent[other].surface) - anchors.deep
                back = pushed_back(excess, anchors.deep, anchors.into, piece, SLACK)
                deep = back > 0
                there = np.where(deep[:, None], here - back[:, None] * anchors.into, there)
                moves, distance = moves | deep, np.where(deep, back, distance)
                if moves.any():  # the others are held where they are: free, they would be drawn back
                    there = np.where(moves[:, None], there, here)
                    there, moves = _straight(here, there, piece, bent[other].surface)
                bending = 2.0 - _stretchiness(bent[l].vertices, here, there - here)
                # Who sees no depth (a plate into which others go) doesn't get by with doing nothing about it.
                cost = not deep.any(), bending * float(distance.mean())
                loose[l, other] = anchors.vertices[moves], there[moves], cost
    held: dict[int, dict[int, np.ndarray]] = {l: {} for l in bent}
    for pair in contacts:
        ways = [way for way in (pair, pair[::-1]) if way in loose]
        if ways:
            l, other = min(ways, key=lambda way: loose[way][2])
            held[l].update(zip(loose[l, other][0].tolist(), loose[l, other][1], strict=True))
    return held


def _straight(
    here: np.ndarray, there: np.ndarray, piece: np.ndarray, surface: Mesh
) -> tuple[Float[np.ndarray, "A 3"], Bool[np.ndarray, " A"]]:
    """Where the anchors (A, 3) of each piece go if it only moves and stretches along the axes; and which get there.

    Nearest places on a trestle lie this way and that: a shelf that each of its anchors followed would be a wave.
    """
    there, held = there.copy(), np.ones(len(here), bool)
    for one in np.unique(piece):
        rows = np.flatnonzero(piece == one)
        if len(rows) < FEWEST_STRAIGHT:
            continue
        p, q = here[rows] - here[rows].mean(axis=0), there[rows] - there[rows].mean(axis=0)
        ridge = STRAIGHT_RIDGE**2
        scale = np.clip(((p * q).mean(axis=0) + ridge) / ((p**2).mean(axis=0) + ridge), 0.5, 2.0)
        moved = there[rows].mean(axis=0) + scale * p
        if np.linalg.norm(moved - there[rows], axis=1).mean() <= SLACK:
            continue
        on, _, away = closest_points(surface, moved)
        near = away <= ARRIVED
        if near.sum() >= max(3, len(rows) // 3):
            there[rows[near]], held[rows] = on[near], near
    return there, held


def _corresponding(anchors: Anchors, other: BentPart, instead: np.ndarray) -> Float[np.ndarray, "A 3"]:
    """Where the anchors are at home on the other part, as it is now; ``instead`` (A, 3) if its points do not tell."""
    points = np.full((max(int(anchors.landing.max()), int(other.source.template.max())) + 1, 3), np.nan)
    points[other.source.template] = other.placed
    near = points[anchors.landing]
    weight = np.where(np.isfinite(near).all(axis=2), anchors.weight, 0.0)
    total = weight.sum(axis=1, keepdims=True)
    mean = (weight[..., None] * np.nan_to_num(near)).sum(axis=1) / np.maximum(total, 1e-12)
    return np.where(total > 0.5, mean + anchors.offset, instead)


def carry_along(part: BentPart, held: Mapping[int, np.ndarray]) -> BentPart:
    """The part with its targets shifted as its held vertices are, piece by piece.

    A piece that can follow by stretching (the shift points along the way from the contact to its middle, as at the top
    of a leg) does so: the shift fades out over FALLOFF.  One that would have to bend or shear is carried as a whole.
    """
    if not held:
        return part
    source = part.source
    vertices = np.fromiter(held, np.int64)
    here = part.vertices[vertices]
    shifts = np.stack([held[v] for v in held]) - here
    handles = part.placed
    targets = part.targets.copy()
    for piece in np.unique(source.piece[vertices]):
        own, at = source.piece_of_handle == piece, source.piece[vertices] == piece
        if not own.any():
            continue
        common = shifts[at].mean(axis=0, keepdims=True)
        apart = shifts[at] - common  # the two ends of a shelf that is too short go opposite ways
        distance = cdist(handles[own], here[at])
        weight = 1 / (distance**2 + (FALLOFF / 3) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        near = np.exp(-0.5 * (distance.min(axis=1) / FALLOFF) ** 2)[:, None]
        for shift, stretch in (
            (np.broadcast_to(common, apart.shape), _stretchiness(handles[own], here[at], shifts[at])),
            (apart, _spreading(handles[own], here[at], apart)),
        ):
            targets[own] += (1 - stretch * (1 - near)) * (weight @ shift)
    return aim(part, targets)


def _stretchiness(points: np.ndarray, anchors: np.ndarray, shifts: np.ndarray) -> float:
    """0 (moving the anchors by ``shifts`` bends a piece with these points, or only moves it) to 1 (it stretches)."""
    direction = shifts.mean(axis=0)
    length = float(np.linalg.norm(direction))
    reach = float(np.linalg.norm(np.ptp(points, axis=0))) / 2
    if length < 1e-9 or reach < 1e-9:
        return 0.0
    along = abs(float((points.mean(axis=0) - anchors.mean(axis=0)) @ direction)) / length
    return min(1.0, along / reach)


def _spreading(points: np.ndarray, anchors: np.ndarray, shifts: np.ndarray) -> float:
    """The same for shifts that differ: 1 where each anchor moves along the line from the points' middle to it."""
    length = np.linalg.norm(shifts, axis=1)
    reach = float(np.linalg.norm(np.ptp(points, axis=0))) / 2
    if length.sum() < 1e-9 or reach < 1e-9:
        return 0.0
    along = np.abs(((anchors - points.mean(axis=0)) * shifts).sum(axis=1)).sum() / length.sum()
    return min(1.0, float(along) / reach)


def contact_depths(bent: Mapping[int, BentPart], contacts: list[tuple[int, int]]) -> dict[tuple[int, int], float]:
    """How much deeper (diagonals) the parts of each contact are in each other than on their training shapes.

    The median over the contact of the deepest piece; of what the two parts tell, the less.
    """
    surfaces = {l: piece.surface for l, piece in bent.items()}
    found = {}
    for pair in contacts:
        told = []
        for l, other in (pair, pair[::-1]):
            anchors = bent[l].anchors.get(other)
            if anchors is not None and anchors.into.any():
                at = bent[l].vertices[anchors.vertices]
                piece = bent[l].source.piece[anchors.vertices]
                excess = np.maximum(depths(at, anchors.into, piece, surfaces[other]) - anchors.deep, 0.0)
                piece = np.where(anchors.into.any(axis=1), piece, -1)
                told.append(max(float(np.median(excess[piece == one])) for one in np.unique(piece) if one >= 0))
        found[pair] = min(told, default=0.0)
    return found


def contact_gaps(
    bent: Mapping[int, BentPart], contacts: list[tuple[int, int]]
) -> dict[tuple[int, int], tuple[float, float]]:
    """Gap of every contact and how much of it is new (diagonals): the wider of those from its two parts."""
    surfaces = {l: piece.surface for l, piece in bent.items()}
    anchors = {l: piece.anchors for l, piece in bent.items()}
    pieces = {l: piece.source.piece for l, piece in bent.items()}
    return {pair: _gap(pair, surfaces, pieces, anchors) for pair in contacts}


def training_gaps(parts: Mapping[int, SourcePart]) -> dict[tuple[int, int], float]:
    """The same (diagonals) of the parts of a training shape that touch, as they are there."""
    surfaces = {l: part.surface for l, part in parts.items()}
    anchors, pieces = {l: part.anchors for l, part in parts.items()}, {l: part.piece for l, part in parts.items()}
    pairs = [(l, o) for l in parts for o in parts if l < o and o in anchors[l] and l in anchors[o]]
    return {pair: _gap(pair, surfaces, pieces, anchors)[0] for pair in pairs}


def _gap(pair: tuple[int, int], surfaces: Mapping, pieces: Mapping, anchors: Mapping) -> tuple[float, float]:
    found = [
        gap(surfaces[l].vertices, pieces[l], anchors[l][o].vertices, anchors[l][o].distance, surfaces[o])
        for l, o in (pair, pair[::-1]) if o in anchors[l]
    ]  # fmt: skip
    return max(one for one, _ in found), max(new for _, new in found)
