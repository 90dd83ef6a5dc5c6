"""The shape in hand without a window: sliders, parts, draws and the history, pins and locks, and another machine."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.generative.units import drive
from shapeforge.viewer.pulling import as_place, handles_of, off_by
from shapeforge.viewer.sculptor import Recipe, Sculptor
from shapeforge.viewer.session import Session
from shapeforge.viewer.slider_names import changes, choose_names, what_moves


def test_the_middle_of_a_slider_leaves_the_shape_alone(sculptor):
    before = sculptor.points()
    sculptor.session.sliders = {0: 0.0, 1: 0.0}
    assert np.array_equal(np.nan_to_num(before), np.nan_to_num(sculptor.points()))
    sculptor.session.sliders = {0: 2.0}
    assert np.nanmax(np.abs(sculptor.points() - before)) > 0


def test_switched_off_parts_are_gone_and_come_back(sculptor):
    present = np.flatnonzero(sculptor.exists())
    sculptor.session.parts_on = {int(present[0]): False}
    assert np.isnan(sculptor.points()[sculptor.part == present[0]]).all()
    sculptor.session.parts_on = {}
    assert np.isfinite(sculptor.points()[sculptor.part == present[0]]).all()


def test_history_is_walked_back_and_forth(sculptor):
    session = sculptor.session
    session.sliders = {0: 1.0}
    sculptor.keep("wider")
    end = sculptor.points()
    sculptor.undo()
    assert session.sliders == {} and sculptor.redo_label == "wider"
    sculptor.redo()
    assert np.array_equal(np.nan_to_num(sculptor.points()), np.nan_to_num(end))
    sculptor.undo()
    session.sliders = {1: -1.0}
    sculptor.keep("other")
    assert sculptor.redo_label is None and [recipe.label for recipe in sculptor.recipes] == ["mean", "other"]


def test_the_ends_of_the_way_between_two_shapes_are_the_shapes(sculptor):
    a, b = (sculptor.base_of(name) for name in sculptor.shape_names[:2])
    for share, end in ((0.0, a), (1.0, b)):
        middle = sculptor.between(a, b, share)
        assert np.allclose(middle.first, end.first, atol=1e-5) and np.array_equal(middle.exists, end.exists)


def test_draws_differ_and_can_be_repeated(sculptor, learnt):
    first, second = sculptor.random_base(), sculptor.random_base()
    assert not np.array_equal(first.top, second.top) or not np.array_equal(first.exists, second.exists)
    session = Session()
    session.open(learnt)
    again = Sculptor(session)
    again.reload()
    assert np.array_equal(again.random_base().top, first.top)


def test_the_nearest_shape_of_a_shape_is_itself(sculptor):
    name, distance = sculptor.nearest(sculptor.positions[2])
    assert name == sculptor.shape_names[2] and distance == pytest.approx(0, abs=1e-6)


def test_the_other_end_has_the_same_parts_where_there_is_such_a_shape(sculptor):
    exists = sculptor.observations.exists
    for index, name in enumerate(sculptor.shape_names):
        other = sculptor.shape_names.index(sculptor.other_end(name))
        assert other != index
        groups = [sculptor.session.project.groups.group[sculptor.session.project.names.index(n)]
                  for n in sculptor.shape_names]  # fmt: skip
        twins = [
            i for i in range(len(exists))
            if i != index and (exists[i] == exists[index]).all() and groups[i] == groups[index]
        ]  # fmt: skip
        assert not twins or other in twins


def test_a_caption_is_measured_on_the_shape_in_hand(sculptor):
    """From the low to the high end of the slider; another shape in hand, another caption."""
    every = np.ones(len(sculptor.part_names), bool)
    for origin, base in (("mean", sculptor.mean_base()), ("other", sculptor.base_of(sculptor.shape_names[2]))):
        sculptor.start(Recipe(origin, base, origin=origin))
        for index, direction in enumerate(sculptor.directions):
            low, high = (
                drive(sculptor.machine, base, {index: value}, every, directions=sculptor.directions)
                for value in (direction.low, direction.high)
            )
            far = np.linalg.norm(np.asarray(high) - np.asarray(low), axis=1)
            assert sculptor.caption(index) == what_moves(far, sculptor.part, sculptor.part_names, sculptor.exists())


def test_sliders_are_named_after_what_they_do():
    rng = np.random.default_rng(0)
    base = np.vstack(
        [
            rng.uniform([-0.2, 0, -0.2], [0.2, 0.05, 0.2], (400, 3)),
            rng.uniform([-0.2, 0.05, -0.2], [0.2, 0.5, -0.15], (400, 3)),
        ]
    )
    part, names, exists = np.repeat([0, 1], 400), ["seat", "back"], np.array([True, True])

    def first(after: np.ndarray) -> str:
        return changes(base, after, part, names, exists)[0][1]

    assert first(base * [1.4, 1, 1]) == "Width"
    taller = base.copy()
    taller[400:, 1] = 0.05 + 1.5 * (base[400:, 1] - 0.05)
    assert first(taller) in ("Height", "Height of the back")
    leaning = base.copy()
    leaning[400:, 2] -= 0.5 * (base[400:, 1] - 0.05)
    found = [name for _, name in changes(base, leaning, part, names, exists)]
    assert found.index("Lean of the back") < found.index("Splay of the back") and "Lean of the back" in found[:4]
    wide = [(0.1, "Width"), (0.09, "Depth")]
    found = [wide, [(0.1, "Width"), (0.07, "Height")], [(0.1, "Width")], [(0.001, "Width")]]
    assert choose_names(found, ["a", "b", "c", "d"]) == ["Width", "Height", "Width (2)", "d"]
    moves = np.where(part == 1, 0.09, 0.01)
    assert what_moves(moves, part, names, exists) == "moves: back · 9% of size"
    assert what_moves(moves, part, names, np.array([True, False])) == "moves: seat · 1% of size"


# ---- pins and locks -----------------------------------------------------------------------------------------------


def test_handles_are_far_apart_and_pins_among_them(sculptor):
    points = sculptor.points()
    handles = handles_of(points)
    pinned = {int(handles[4]), int(np.flatnonzero(np.isfinite(points[:, 0]))[0])}
    with_pins = handles_of(points, pinned=pinned)
    assert len(handles) == len(with_pins) == 9 and pinned <= {int(k) for k in with_pins}
    apart = np.linalg.norm(points[with_pins][:, None] - points[with_pins], axis=2) + np.eye(9)
    assert apart.min() > 0.05


def test_pinned_points_stay_while_others_are_moved(sculptor):
    """Several at once, in any order; a locked slider keeps its value meanwhile, and without pins all is as it was."""
    session, points = sculptor.session, sculptor.points()
    first, second = (int(k) for k in handles_of(points)[:2])
    alike = np.flatnonzero((sculptor.observations.exists == sculptor.exists()).all(axis=1))
    away = np.linalg.norm(sculptor.positions[alike][:, [first, second]] - points[[first, second]], axis=2).min(axis=1)
    target = sculptor.positions[alike[away.argmax()]]  # where another shape has both of them elsewhere
    wanted = {k: as_place(0.4 * target[k] + 0.6 * points[k]) for k in (first, second)}
    session.pins = {first: wanted[first]}
    alone, values = sculptor.points(), sculptor.values()
    session.pins = wanted
    both = sculptor.points()
    session.pins = dict(reversed(wanted.items()))
    assert np.array_equal(np.nan_to_num(both), np.nan_to_num(sculptor.points()))
    missed = {k: (off_by(both, k, wanted[k]), off_by(points, k, wanted[k])) for k in wanted}
    # a point that was nearly there from the start stays so
    assert all(after < max(0.6 * before, 0.01) for after, before in missed.values()), missed
    assert max(before for _, before in missed.values()) > 0.03
    assert off_by(both, first, wanted[first]) < off_by(alone, first, wanted[first]) + 0.01
    assert np.abs(values - sculptor.home()).max() > 0.05, "sliders show what comes of it"
    sculptor.lock(0, True)
    now = sculptor.values()[0]
    session.pins = {first: as_place(points[first] + np.array([0.05, 0.0, 0.0]))}
    held = sculptor.values()[0]
    sculptor.lock(0, False)
    assert abs(held - now) < 0.1 and abs(sculptor.values()[0] - now) > 3 * abs(held - now)
    session.pins, session.sliders = {}, {}
    assert np.array_equal(np.nan_to_num(sculptor.points()), np.nan_to_num(points))


@pytest.fixture
def pinned(sculptor):
    """Two points are held a little beside where the mean has them, in the history, too."""
    points = sculptor.points()
    sculptor.session.pins = {int(k): as_place(points[k] + 0.03) for k in handles_of(points)[:2]}
    sculptor.keep("pinned")
    return sculptor


def test_another_machine_knows_no_pins_and_no_locked_sliders(pinned):
    """Points and sliders of the old one may not be there any more, and nobody is told before the new one is."""
    session, heard = pinned.session, []
    session.parts_on = {0: True}
    pinned.lock(3, True)
    pinned.keep("locked")
    for name in ("pins", "parts_on", "sliders"):
        getattr(session.events, name).connect(lambda *_: heard.append(pinned.points()), check_nargs=False)
    pinned.part = np.zeros(0, int)  # as if the new templates had fewer points
    pinned._key = None
    assert pinned.reload()
    assert session.locked == frozenset() and session.pins == session.sliders == session.parts_on == {}
    assert len(pinned.recipes) == 1 and heard and all(points.shape == heard[0].shape for points in heard)


def test_what_follows_pins_is_another_shape_when_a_slider_is_let_go(pinned):
    pinned.lock(0, True)
    pinned.keep("locked")
    assert pinned.as_kept
    before = pinned.points()
    pinned.lock(0, False)
    assert np.nanmax(np.abs(pinned.points() - before)) > 1e-4 and not pinned.as_kept
    pinned.session.pins = {}
    pinned.keep("free")
    pinned.lock(0, True)
    assert pinned.as_kept, "without pins a lock changes nothing"


def test_a_draw_has_locked_sliders_where_they_are_with_pins_and_without(pinned):
    pinned.slide(1, float(pinned.home()[1]) + 1.0)
    pinned.lock(1, True)
    for pins, within in ((dict(pinned.session.pins), 0.1), ({}, 1e-6)):
        pinned.session.pins = pins
        value, before = pinned.values()[1], pinned.home()[1]
        pinned.start(pinned.drawn())
        assert pinned.session.locked == {1} and pinned.session.pins == pins
        assert pinned.values()[1] == pytest.approx(value, abs=within) and abs(pinned.home()[1] - before) > 2 * within


def test_a_pulled_point_and_its_twin_go_as_far_as_each_other_and_the_mesh_with_them(sculptor):
    """Points that move on one side only would be halved by the symmetry of the mesh."""
    before, mirror, part = sculptor.points(), sculptor.mirror(), sculptor.part
    assert mirror.symmetric[part].any()
    there = np.isfinite(before).all(axis=1) & mirror.symmetric[part]
    off = np.where(there, np.abs(before @ mirror.normal - mirror.place(before, part)), 0.0)
    k = int(off.argmax())
    twin = int(mirror.partner[k])
    inwards = -0.04 * np.sign(before[k] @ mirror.normal - mirror.place(before, part)) * mirror.normal
    sculptor.session.pins = {k: as_place(before[k] + inwards)}
    points = sculptor.points()
    made = mirror.made_symmetric(points, part)
    went = [float((at[k] - before[k]) @ inwards) / 0.04**2 for at in (points, made)]
    assert went[0] > 0.5 and went[1] > 0.9 * went[0]
    assert float((points[twin] - before[twin]) @ -inwards) / 0.04**2 > 0.7 * went[0]


def farthest_off(sculptor) -> tuple[int, int, np.ndarray]:
    """A point far from the mirror plane, its twin, and a way of .04 diagonals towards the plane."""
    points, mirror, part = sculptor.points(), sculptor.mirror(), sculptor.part
    there = np.isfinite(points).all(axis=1) & mirror.symmetric[part]
    k = int(np.where(there, np.abs(points @ mirror.normal - mirror.place(points, part)), 0.0).argmax())
    return (
        k,
        int(mirror.partner[k]),
        -0.04 * np.sign(points[k] @ mirror.normal - mirror.place(points, part)) * mirror.normal,
    )


def test_a_point_and_its_twin_that_are_pinned_unlike_both_hold(sculptor):
    """The family has symmetric shapes only: it had gone half-way, and the mesh been made symmetric."""
    session, before, mirror, part = sculptor.session, sculptor.points(), sculptor.mirror(), sculptor.part
    k, twin, inwards = farthest_off(sculptor)
    session.pins = {k: as_place(before[k] + inwards), twin: as_place(before[twin])}
    points, symmetric = sculptor.points(), sculptor.symmetric()
    assert {part[k], part[twin]} <= set(np.flatnonzero(~symmetric)) and sculptor.bend() is not None
    made = mirror.made_symmetric(points, part, symmetric)
    for one in (points, made):
        assert max(off_by(one, point, pin) for point, pin in session.pins.items()) < 1e-3
    halved = mirror.made_symmetric(points, part)
    assert max(off_by(halved, point, pin) for point, pin in session.pins.items()) > 0.012
    session.pins = {k: as_place(before[k] + inwards), twin: as_place(before[twin] - inwards)}
    assert sculptor.symmetric().all() and sculptor.bend() is None, "held alike"
    session.pins = {}
    assert sculptor.symmetric().all() and np.array_equal(sculptor.points(), before, equal_nan=True)
