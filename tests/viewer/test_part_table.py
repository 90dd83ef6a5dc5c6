"""Parts that come, go, join and are called otherwise: paint is kept, and comes back with them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shapeforge.collection.colours import PARTS, as_hex, inks_of
from shapeforge.viewer.part_table import PartTable, plain_table, table_of


def inks(table: PartTable) -> list[str]:
    return [as_hex(ink) for ink in inks_of(table.names, table.colours)]


def test_a_part_that_goes_leaves_the_others_their_colours():
    table = plain_table(4).recoloured(3, "#123456")
    before = inks(table)
    assert inks(table.without(1)) == [before[0], before[2], before[3]]
    assert inks(table.without(0, kept=2)) == before[1:]
    new = table.without(1).with_new(9, "arm")
    assert inks(new)[:3] == [before[0], before[2], before[3]] and inks(new)[3] not in inks(new)[:3]


def test_a_name_that_changes_takes_the_colour_along_and_resetting_gives_that_of_the_place():
    table = plain_table(2).recoloured(1, "#123456").renamed(1, "seat")
    assert table.names == ("part 1", "seat") and inks(table) == [PARTS[0], "#123456"]
    assert inks(table.recoloured(1, None)) == list(PARTS[:2])


def test_joined_paint_follows_wherever_its_part_goes():
    table = plain_table(4).without(0, kept=1)  # 0 counts as 1
    paint = np.array([0, 1, 2, 3, -1, 7], np.int32)
    assert table.labels(paint).tolist() == [0, 0, 1, 2, -1, -1]
    twice = table.without(0, kept=1)  # and 1, with it, as 2
    assert twice.labels(paint).tolist() == [0, 0, 0, 1, -1, -1]
    assert twice.without(0).labels(paint).tolist() == [-1, -1, -1, 0, -1, -1]


steps = st.lists(
    st.tuples(st.sampled_from(["join", "remove", "rename", "new", "colour"]), st.integers(0, 9)), max_size=8
)


@settings(deadline=None)
@given(steps=steps)
def test_any_edits_keep_a_table_whole_and_it_comes_back_from_its_record(steps):
    table, fresh = plain_table(3), 3
    for kind, number in steps:
        n = len(table.ids)
        if kind == "new":
            table, fresh = table.with_new(fresh, f"new {fresh}"), fresh + 1
        elif n:
            part = number % n
            table = {
                "join": lambda table=table, part=part, n=n: table.without(part, (part + 1) % n) if n > 1 else table,
                "remove": lambda table=table, part=part: table.without(part),
                "rename": lambda table=table, part=part, number=number: table.renamed(part, f"called {part} {number}"),
                "colour": lambda table=table, part=part, number=number: table.recoloured(part, PARTS[number]),
            }[kind]()
    assert table_of(table.to_record()) == table
    assert len(table.ids) == len(table.names) and set(table.colours) <= set(table.names)
    labels = np.arange(-1, len(table.ids), dtype=np.int32)
    assert np.array_equal(table.labels(table.paint(labels)), labels)
    assert set(table.part_of.values()) <= set(range(len(table.ids)))
