"""Shapes imported in the window join the groups that were made by hand there."""

from __future__ import annotations

from shapeforge.collection.families import write_family


def test_import_after_moving_a_shape_keeps_it_where_it_was_put(open_window, grouped, tmp_path, qtbot):
    window = open_window(grouped)
    session, table = window.session, window.actions_table
    exemplars = {grouped.names[int(t)] for t in grouped.groups.exemplars}
    alone = next(name for name in grouped.names if name not in exemplars)
    session.selected, session.shape = (alone,), alone
    assert table.run("make_group")
    by_hand = dict(zip(grouped.names, grouped.groups.group.tolist(), strict=True))
    assert grouped.grouped_by_hand
    write_family(tmp_path / "more", "chairs", 2, seed=12)
    table.import_shapes((tmp_path / "more",))
    qtbot.waitUntil(lambda: not session.running, timeout=120000)
    assert session.status_kind == "ok" and "joined" in session.status
    after = dict(zip(grouped.names, grouped.groups.group.tolist(), strict=True))
    assert len(after) == len(by_hand) + 2 and {name: after[name] for name in by_hand} == by_hand
    assert alone in {grouped.names[int(t)] for t in grouped.groups.exemplars}
    assert all(group >= 0 for name, group in after.items() if name not in by_hand)
