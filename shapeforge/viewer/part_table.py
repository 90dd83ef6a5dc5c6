"""Which parts there are, and which part the paint on a face counts as: the paint itself never changes for that.

Paint is kept as the *id* of the part it was painted with; no later part gets that id again.  The table says which ids
are parts now.  Joining parts lets one id count as another, removing a part leaves its id out: so what was painted comes
back on every shape when such an edit is taken back, and what was painted since stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Int

from shapeforge.collection.colours import PARTS, as_hex, inks_of
from shapeforge.collection.labels import UNLABELLED, PartNames


@dataclass(frozen=True)
class PartTable:
    """The parts in order (``ids``, ``names``), ``colours`` chosen for them by name, and ids ``joined`` to others."""

    ids: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    colours: Mapping[str, str] = field(default_factory=dict)
    joined: Mapping[int, int] = field(default_factory=dict)

    @property
    def named(self) -> PartNames:
        """The parts as the project keeps them."""
        return PartNames(self.ids, self.names, self.colours)

    @property
    def part_of(self) -> dict[int, int]:
        """Part index of every id that counts as a part."""
        place = {identity: part for part, identity in enumerate(self.ids)}
        found = dict(place)
        for identity in self.joined:
            end, seen = identity, {identity}
            while end in self.joined and end not in place and self.joined[end] not in seen:
                end = self.joined[end]
                seen.add(end)
            if end in place:
                found[identity] = place[end]
        return found

    def labels(self, paint: Int[np.ndarray, " F"]) -> Int[np.ndarray, " F"]:
        """Part index (F,) of ids of paint (F,); -1 where there is none, or none that is a part."""
        part_of = self.part_of
        known = np.array(sorted(part_of), np.int64)
        if not len(known):
            return np.full(len(paint), UNLABELLED, np.int32)
        parts = np.array([part_of[identity] for identity in known.tolist()], np.int32)
        at = np.minimum(np.searchsorted(known, paint), len(known) - 1)
        return np.where(known[at] == paint, parts[at], UNLABELLED).astype(np.int32)

    def paint(self, labels: Int[np.ndarray, " F"]) -> Int[np.ndarray, " F"]:
        """Ids of paint (F,) that give the part indices ``labels`` (F,)."""
        return np.array([*self.ids, UNLABELLED], np.int32)[labels]

    # -- edits -----------------------------------------------------------------------------------------------------

    def with_new(self, identity: int, name: str) -> PartTable:
        """One part more, at the end, in a colour that no other has (as long as there is one)."""
        names = (*self.names, name)
        taken = {as_hex(ink) for ink in inks_of(self.names, self.colours)}
        own = as_hex(inks_of(names, self.colours)[-1])
        free = [own, *PARTS] if own not in taken else [colour for colour in PARTS if colour not in taken]
        colours = dict(self.colours) if not free or free[0] == own else {**self.colours, name: free[0]}
        return PartTable((*self.ids, identity), names, colours, self.joined)

    def renamed(self, part: int, name: str) -> PartTable:
        """A part called otherwise; its colour stays."""
        names = tuple(name if i == part else other for i, other in enumerate(self.names))
        colours = {(name if other == self.names[part] else other): ink for other, ink in self.colours.items()}
        return PartTable(self.ids, names, colours, self.joined)

    def recoloured(self, part: int, colour: str | None) -> PartTable:
        """A part in another colour ("#RRGGBB"; None: that of its place)."""
        colours = {name: ink for name, ink in self.colours.items() if name != self.names[part]}
        return PartTable(
            self.ids, self.names, colours if colour is None else {**colours, self.names[part]: colour}, self.joined
        )

    def without(self, part: int, kept: int | None = None) -> PartTable:
        """One part fewer; its paint counts as ``kept``, or as none.  All others keep the colours they have."""
        inks = inks_of(self.names, self.colours)
        left = [i for i in range(len(self.ids)) if i != part]
        after = {self.names[i] for i in left if i > part or self.names[i] in self.colours}
        colours = {self.names[i]: as_hex(inks[i]) for i in left if self.names[i] in after}
        joined = dict(self.joined) if kept is None else {**self.joined, self.ids[part]: self.ids[kept]}
        return PartTable(tuple(self.ids[i] for i in left), tuple(self.names[i] for i in left), colours, joined)

    # -- keeping it ------------------------------------------------------------------------------------------------

    def to_record(self) -> dict[str, Any]:
        """As JSON keeps it."""
        joined = [[gone, kept] for gone, kept in self.joined.items()]
        return {"ids": list(self.ids), "names": list(self.names), "colours": dict(self.colours), "joined": joined}


def table_of(record: Mapping[str, Any]) -> PartTable:
    """The table of a record.  Raises KeyError, TypeError or ValueError when it is not one."""
    ids, names = tuple(int(i) for i in record["ids"]), tuple(str(name) for name in record["names"])
    if len(ids) != len(names):
        raise ValueError(f"{len(ids)} ids for {len(names)} names")
    colours = {str(name): str(ink) for name, ink in record["colours"].items()}
    return PartTable(ids, names, colours, {int(gone): int(kept) for gone, kept in record["joined"]})


def plain_table(n: int) -> PartTable:
    """Parts 0..n-1 whose ids are their indices."""
    return PartTable(tuple(range(n)), tuple(f"part {i + 1}" for i in range(n)))
