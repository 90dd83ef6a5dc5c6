"""Proposed parts put right by hand: renamed, merged and split, on all shapes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from shapeforge.collection.groups import Groups
from shapeforge.collection.symmetry import symmetry_plane
from shapeforge.deformation.box_model import halves
from shapeforge.deformation.boxes import SPLIT_WEIGHTS, SURE, Proposal, gathered, richest_exemplars, standardized
from shapeforge.deformation.pieces import common_frame

EditKind = Literal["rename", "merge", "split"]
EDITS: dict[EditKind, int] = {"rename": 2, "merge": 2, "split": 1}
"""Kinds of edits and how many names each takes: (part, new name), (part that stays, part that joins it), (part)."""


def edit_parts(
    proposal: Proposal, edits: Sequence[Sequence[str]], shapes: Any, groups: Groups, *, rng: np.random.Generator
) -> Proposal:
    """``edits`` done one after the other, each (kind, name, …) as ``EDITS`` says; exemplars are then chosen anew.

    Raises ValueError for a kind, a number of names or a part that is not known, for a new name that is empty or taken,
    and for a part that falls into no two halves.
    """
    for kind, *names in edits:
        if EDITS.get(kind) != len(names):  # type: ignore[call-overload]
            wanted = "; ".join(f"{one} and {count} name{'s' * (count > 1)}" for one, count in EDITS.items())
            raise ValueError(f"edits: wanted {wanted}; got {[kind, *names]}")
        part = _part(proposal, names[0])
        if kind == "rename":
            proposal = rename_part(proposal, part, names[1])
        elif kind == "merge":
            proposal = merge_parts(proposal, part, _part(proposal, names[1]))
        else:
            proposal = split_part(proposal, part, shapes, groups, rng=rng)
    labels = [one.argmax(axis=1) for one in proposal.segmentation]
    return replace(proposal, exemplars=richest_exemplars(groups, labels, len(proposal.part_names)))


def _part(proposal: Proposal, name: str) -> int:
    if name not in proposal.part_names:
        raise ValueError(f"edits: wanted one of the parts {', '.join(proposal.part_names)}; got {name!r}")
    return proposal.part_names.index(name)


def rename_part(proposal: Proposal, part: int, name: str) -> Proposal:
    """The same parts, one of them called otherwise.  Raises ValueError for a name that is empty or taken."""
    name, names = " ".join(name.split()), list(proposal.part_names)
    if not name or name in names[:part] + names[part + 1 :]:
        raise ValueError(f"edits: the part needs a name of its own; {name!r} is {'taken' if name else 'empty'}")
    names[part] = name
    return replace(proposal, part_names=tuple(names))


def merge_parts(proposal: Proposal, kept: int, gone: int) -> Proposal:
    """One part fewer: what was ``gone`` belongs to ``kept``.  Raises ValueError for a part and itself."""
    if kept == gone:
        raise ValueError(f"edits: wanted two parts to merge, got {proposal.part_names[kept]!r} twice")
    new = np.arange(len(proposal.part_names))
    new[gone] = kept
    new -= new > gone
    names = tuple(name for part, name in enumerate(proposal.part_names) if part != gone)
    labels = [new[one.argmax(axis=1)] for one in proposal.segmentation]
    return replace(proposal, part_names=names, segmentation=_certain(labels, len(names)))


def split_part(proposal: Proposal, part: int, shapes: Any, groups: Groups, *, rng: np.random.Generator) -> Proposal:
    """One part more: the most distinct halves of the pieces of ``part`` become two, on all shapes alike.

    The larger half keeps number and name, the other is the last part.  Raises ValueError where there are no two pieces
    that differ.
    """
    labels = [one.argmax(axis=1) for one in proposal.segmentation]
    normal, offset, _ = symmetry_plane(shapes[int(groups.exemplars[0])].points)
    pieces = gathered(shapes, groups, common_frame(shapes, groups), normal, offset)[1]
    inside = np.concatenate(
        [
            np.bincount(of_point, label == part) / np.maximum(np.bincount(of_point), 1)
            for of_point, label in zip(pieces.of_point, labels, strict=True)
        ]
    )
    rows, weight = np.flatnonzero(inside >= 0.5), pieces.weight * inside
    with threadpool_limits(1):
        views = [standardized(view[rows], weight[rows]) * SPLIT_WEIGHTS for view in pieces.views] if len(rows) else []
        off = halves(np.concatenate(views, axis=1) / np.sqrt(len(views)), weight[rows], rng=rng) if views else None
    if off is None:
        raise ValueError(f"edits: {proposal.part_names[part]!r} cannot be split; its pieces are all alike")
    chosen = np.zeros(len(weight), bool)
    chosen[rows[off]] = True
    number = len(proposal.part_names)
    for t, (of_point, label) in enumerate(zip(pieces.of_point, labels, strict=True)):
        label[(label == part) & chosen[pieces.owner == t][of_point]] = number
    name = next(f"part {i}" for i in range(number + 1, 2 * number + 2) if f"part {i}" not in proposal.part_names)
    return replace(proposal, part_names=(*proposal.part_names, name), segmentation=_certain(labels, number + 1))


def _certain(labels: Sequence[np.ndarray], n_parts: int) -> tuple[Float[np.ndarray, "_ _"], ...]:
    """Label probabilities of points as proposals have them."""
    return tuple(SURE * np.eye(n_parts)[label] + (1 - SURE) / n_parts for label in labels)
