"""A mesh for a draw: its parts retrieved, bent to the drawn points, held together where they touch, and merged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from shapeforge.collection.materials import PLAIN
from shapeforge.synthesis.bending import BentPart, bend, start_part, unfolded
from shapeforge.synthesis.contacts import (
    SLACK,
    carry_along,
    choose_contacts,
    contact_depths,
    contact_gaps,
    hold_contacts,
    island_gaps,
    join_islands,
)
from shapeforge.synthesis.measures import symmetry_error
from shapeforge.synthesis.retrieve import retrieve
from shapeforge.synthesis.sources import Sources
from shapeforge.synthesis.surfaces import sized_triangles

CONTACT_ROUNDS = 3
"""Times that the contacts are looked at anew: a part that moved may leave another one behind."""
GOOD = 0.001
"""Faults (diagonals) of a contact that are not worth another look."""
WIDE = 0.004
"""Parts that stay farther (diagonals) apart are taken from one shape or, if they were, from another one ..."""
RETRIES = 4
"""... so often, and the best is kept."""
SEEN = 3.0
"""A gap is seen at once, a part that is a little other than the draw never: so many times as bad."""
FOLD = 0.002
"""A folded pair of triangles is as bad as so wide a gap (diagonals)."""


@dataclass(frozen=True, eq=False)
class SynthesizedShape:
    """A labelled mesh in normal coordinates: ``part`` (N,) per triangle; ``sources[l]`` is the shape part l came from.

    ``sources`` is "" for absent parts.  ``measures`` is ready for JSON: largest gap and gap per touching pair, beyond
    those of the training shapes, and the mean of the whole gaps; how much deeper than on their training shapes parts
    are in each other, the most and per pair; symmetry error; distance of the handles from the draw (all in diagonals);
    number of folded triangle pairs.  ``colours`` (N, 3) are those of the
    sources' materials, PLAIN where a source has none; None where none has any.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "N 3"]
    part: Int[np.ndarray, " N"]
    part_names: tuple[str, ...]
    sources: tuple[str, ...]
    measures: dict
    colours: UInt8[np.ndarray, "N 3"] | None = None


def synthesize(
    points: Float[np.ndarray, "K 3"], exists: Bool[np.ndarray, " L"], sources: Sources, *, preview: bool = False,
    shapes: Int[np.ndarray, " L"] | None = None, fixed: Mapping[int, int] | None = None,
    symmetric: bool | Bool[np.ndarray, " L"] = True,
) -> SynthesizedShape:  # fmt: skip
    """The mesh of one draw: ``points`` in normal coordinates (NaN where absent), ``exists`` per part.

    ``preview`` uses the quick solver and one look at the contacts, none at depths: for a slider that moves.
    ``shapes`` (index of a training shape per part, -1 none) replaces the retrieval: keep it while a slider moves and
    the parts don't flicker.
    ``fixed`` {part: training shape} is for the retrieval, which then chooses the other parts to go with these.
    What the family has ``symmetric`` comes out so, whatever the draw; or those of its parts (L,) that are to.
    A part that no training shape offers is left out, its source "".
    """
    if points.shape != (len(sources.part), 3) or exists.shape != (sources.n_parts,):
        raise ValueError(
            f"points, exists: wanted ({len(sources.part)}, 3) and ({sources.n_parts},), got {points.shape} and "
            f"{exists.shape}. Do the draw and the sources come from the same fit?"
        )
    points = as_symmetric(points, sources, symmetric)
    if shapes is not None:
        return _merge(put_together(points, exists, sources, shapes, preview), sources)
    barred: set[tuple[int, int]] = set()
    joined: list[tuple[int, int]] = []
    best: PutTogether | None = None
    for _ in range(1 if preview else 1 + RETRIES):
        shapes = retrieve(points, exists, sources, fixed=fixed, joined=joined, barred=barred).shape
        parts = put_together(points, exists, sources, shapes, preview)
        best = parts if best is None or parts.cost < best.cost else best
        apart = {pair: new for pair, (_, new) in parts.gaps.items() if new > WIDE}
        if not apart:
            break
        pair = max(apart, key=apart.__getitem__)
        if shapes[pair[0]] != shapes[pair[1]]:
            joined.append(pair)
        else:
            worse = max(pair, key=lambda l: float(_misses(parts.bent[l]).mean()))
            barred.add((worse, int(shapes[worse])))
    return _merge(best, sources)


def as_symmetric(
    points: Float[np.ndarray, "K 3"], sources: Sources, symmetric: bool | Bool[np.ndarray, " L"]
) -> Float[np.ndarray, "K 3"]:
    """A draw as symmetric as the family is: all of it, nothing of it, or these parts (L,)."""
    wanted = np.broadcast_to(np.asarray(symmetric), (sources.n_parts,))
    return sources.mirror.made_symmetric(points, sources.part, wanted) if wanted.any() else points


@dataclass(frozen=True, eq=False)
class PutTogether:
    """Bent parts and, per contact, their gaps (see ``contact_gaps``) and depths; how bad all that is, in diagonals."""

    bent: Mapping[int, BentPart]
    gaps: Mapping[tuple[int, int], tuple[float, float]]
    depths: Mapping[tuple[int, int], float]
    cost: float


def put_together(
    points: np.ndarray, exists: np.ndarray, sources: Sources, shapes: np.ndarray, preview: bool
) -> PutTogether:
    """The parts of these training shapes bent to the draw, and to each other in as many rounds as it takes."""
    bent: dict[int, BentPart] = {}
    for l in np.flatnonzero(exists & (shapes >= 0)):
        source = sources.part_of(int(shapes[l]), int(l))
        started = None if source is None else start_part(source, points)
        if started is not None:
            bent[int(l)] = bend(started, {}, preview=True)
    bent, contacts = join_islands(bent, choose_contacts(bent, sources.touching), sources.touching)
    best, least, told, stubborn = bent, np.inf, None, set()
    for turn in range(1 if preview else CONTACT_ROUNDS):
        held = hold_contacts(bent, contacts, stubborn)
        moving = [l for l in bent if held[l] or (turn == 0 and not preview)]
        if not moving:
            break
        for l in moving:
            bent[l] = bend(carry_along(bent[l], held[l]), held[l], preview=preview)
        touch = contact_gaps(bent, contacts), {} if preview else contact_depths(bent, contacts)
        faults = 0.0 if preview else _faults(bent, *touch)
        if faults < least:
            best, least, told = dict(bent), faults, touch
        if faults <= GOOD * len(contacts):
            break
        stubborn |= {pair for pair, (_, new) in touch[0].items() if new > SLACK}
    if told is None:
        told = contact_gaps(best, contacts), {} if preview else contact_depths(best, contacts)
    if any(part.folds for part in best.values()):  # to ease these may move a contact
        best = {l: unfolded(part) for l, part in best.items()}
        told = contact_gaps(best, contacts), {} if preview else contact_depths(best, contacts)
    if not preview:
        told = {**told[0], **island_gaps(best, contacts, sources.touching)}, told[1]
    misses = sum(float(_misses(part).mean()) for part in best.values())
    return PutTogether(best, *told, misses + SEEN * _faults(best, *told))


def _misses(part: BentPart) -> np.ndarray:
    """Distances (diagonals) of the part's handles from where the draw has them."""
    known = np.isfinite(part.drawn).all(axis=1)
    return np.linalg.norm(part.placed[known] - part.drawn[known], axis=1)


def _faults(bent: Mapping[int, BentPart], apart: Mapping, deep: Mapping) -> float:
    """What is wrong with the parts as they are, in diagonals: a round that mends one contact may spoil another."""
    folds = sum(part.folds for part in bent.values())
    return sum(new for _, new in apart.values()) + sum(deep.values()) + FOLD * folds


def _merge(parts: PutTogether, sources: Sources) -> SynthesizedShape:
    """All parts in one mesh, without triangles that collapsed, and its measures."""
    bent, apart, depths = parts.bent, parts.gaps, parts.depths
    vertices, triangles, part, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int32)], 0
    folds, miss, colours = 0, [], [np.zeros((0, 3), np.uint8)]
    for l, piece in bent.items():
        keep = sized_triangles(piece.vertices, piece.source.triangles) & piece.source.distinct
        vertices.append(piece.vertices)
        triangles.append((piece.source.triangles[keep] + count).astype(np.int32))
        part.append(np.full(int(keep.sum()), l, np.int32))
        own = piece.source.colours
        colours.append(np.tile(np.uint8(PLAIN), (int(keep.sum()), 1)) if own is None else own[keep])
        count += len(piece.vertices)
        folds += piece.folds
        miss.append(_misses(piece))
    names = sources.part_names
    gaps = {f"{names[l]} – {names[other]}": new for (l, other), (_, new) in apart.items()}
    deep = {f"{names[l]} – {names[other]}": d for (l, other), d in depths.items()}
    placed = np.full((len(sources.part), 3), np.nan)
    for piece in bent.values():
        placed[piece.source.template] = piece.placed
    plane = sources.mirror.normal, sources.mirror.place(placed, sources.part)
    measures = {
        "largest_gap": max(gaps.values(), default=0.0),
        "gaps": gaps,
        "contact_gap": float(np.mean([wide for wide, _ in apart.values()])) if apart else None,
        "too_deep": max(deep.values(), default=0.0),
        "depths": deep,
        "symmetry_error": symmetry_error(placed[np.isfinite(placed).all(axis=1)], plane) if bent else None,
        "folded_triangles": folds,
        "distance_from_draw": float(np.concatenate(miss).mean()) if miss else None,
        "n_triangles": int(sum(len(t) for t in triangles)),
    }
    taken = tuple(bent[l].source.shape if l in bent else "" for l in range(sources.n_parts))
    coloured = any(piece.source.colours is not None for piece in bent.values())
    return SynthesizedShape(
        np.concatenate(vertices), np.concatenate(triangles), np.concatenate(part), sources.part_names, taken, measures,
        np.concatenate(colours) if coloured else None,
    )  # fmt: skip
