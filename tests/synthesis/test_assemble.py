"""Meshes of draws: training shapes come back, mixed parts touch, nothing folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.materials import PLAIN
from shapeforge.collection.surface import closest_points
from shapeforge.synthesis import assemble, bending, contacts
from shapeforge.synthesis.assemble import synthesize
from shapeforge.synthesis.bending import bend, start_part, unfolded
from shapeforge.synthesis.contacts import (
    carry_along,
    choose_contacts,
    contact_depths,
    hold_contacts,
    island_gaps,
    join_islands,
)
from shapeforge.synthesis.depths import depths, pushed_back
from shapeforge.synthesis.measures import inverted_triangles
from shapeforge.synthesis.sources import Sources, make_sources
from shapeforge.synthesis.surfaces import as_mesh
from tests.synthesis.conftest import CORNERS, PART_NAMES, QUADS, box_points, make_table

BOTH = np.array([True, True])


def distances(vertices: np.ndarray, triangles: np.ndarray, queries: np.ndarray) -> np.ndarray:
    return closest_points(as_mesh(vertices, triangles), queries)[2]


def test_a_training_shape_comes_back(tables, sources) -> None:
    made = synthesize(tables[1].points, BOTH, sources)
    assert made.sources == (tables[1].shape.name,) * 2
    mesh = tables[1].shape.mesh
    assert distances(mesh.vertices, mesh.triangles, made.vertices).max() < 2e-3
    assert distances(made.vertices, made.triangles, mesh.vertices).max() < 2e-3
    assert made.measures["folded_triangles"] == 0
    assert made.measures["largest_gap"] < 1e-3
    assert set(np.unique(made.part)) == {0, 1}
    assert made.triangles.dtype == made.part.dtype == np.int32 and made.vertices.dtype == np.float64
    assert len(made.part) == len(made.triangles) == made.measures["n_triangles"]


@pytest.mark.parametrize("preview", [False, True])
def test_a_new_size_is_reached_by_bending(tables, sources, preview: bool) -> None:
    between = 0.5 * (tables[0].points + tables[2].points)
    made = synthesize(between, BOTH, sources, preview=preview)
    assert distances(made.vertices, made.triangles, between).mean() < 0.005
    assert made.measures["distance_from_draw"] < 0.01


@pytest.mark.parametrize(("preview", "most"), [(False, 0.004), (True, 0.012)])
def test_parts_that_the_draw_tore_apart_touch_again(tables, sources, preview: bool, most: float) -> None:
    torn = tables[0].points.copy()
    torn[:384] += [0, 0.03, 0]
    made = synthesize(torn, BOTH, sources, preview=preview)
    assert made.measures["largest_gap"] < most
    assert list(made.measures["gaps"]) == ["top – legs"]


def test_parts_of_different_shapes_touch(tables, sources) -> None:
    draw = tables[0].points.copy()
    made = synthesize(draw, BOTH, sources, shapes=np.array([0, 4]))
    assert made.sources == (tables[0].shape.name, tables[4].shape.name)
    assert made.measures["largest_gap"] < 0.005


def test_noise_of_a_draw_is_smoothed(tables, sources) -> None:
    rng = np.random.default_rng(0)
    noisy = tables[3].points + rng.normal(0, 0.01, tables[3].points.shape)
    made = synthesize(noisy, BOTH, sources)
    mesh = tables[3].shape.mesh
    away = distances(mesh.vertices, mesh.triangles, made.vertices)
    assert away.mean() < 0.006
    assert made.measures["folded_triangles"] == 0


def test_absent_parts_are_left_out_and_errors_say_what_was_wanted(tables, sources) -> None:
    points = tables[2].points.copy()
    points[384:] = np.nan
    made = synthesize(points, np.array([True, False]), sources)
    assert made.sources == (tables[2].shape.name, "") and set(made.part) == {0}
    nothing = synthesize(points, np.array([False, False]), sources)
    assert len(nothing.triangles) == 0 and nothing.measures["n_triangles"] == 0
    with pytest.raises(ValueError, match="points, exists"):
        synthesize(points[:10], BOTH, sources)


def test_a_leg_follows_by_stretching_and_a_plate_is_carried_whole(tables, sources) -> None:
    part = start_part(sources.part_of(0, 1), tables[0].points)
    top = part.source.vertices[:, 1] > part.source.vertices[:, 1].max() - 1e-6
    lifted = {int(v): part.source.vertices[v] + [0, 0.05, 0] for v in np.flatnonzero(top)}
    shift = (carry_along(part, lifted).targets - part.targets)[:, 1]
    feet = part.source.handles[:, 1] < part.source.handles[:, 1].min() + 0.05
    assert shift.max() > 0.04 and shift[feet].max() < 0.02
    plate = start_part(sources.part_of(0, 0), tables[0].points)
    middle = np.argsort(np.linalg.norm(plate.source.vertices - plate.source.vertices.mean(axis=0), axis=1))[:6]
    lifted = {int(v): plate.source.vertices[v] + [0, 0.05, 0] for v in middle}
    shift = (carry_along(plate, lifted).targets - plate.targets)[:, 1]
    assert shift.min() > 0.045


def test_a_part_that_touched_nothing_on_its_shape_is_joined(tables, sources) -> None:
    bent = {l: start_part(sources.part_of(0, l), tables[0].points) for l in (0, 1)}
    bent = {l: replace(part, anchors={}) for l, part in bent.items()}
    assert choose_contacts(bent, sources.touching) == []
    joined, contacts = join_islands(bent, [], sources.touching)
    assert contacts == [(0, 1)]
    assert not any(hold_contacts(joined, contacts).values())  # the parts touch: nothing has to move
    x = joined[0].x.copy()
    x[3::4] += [0, 0.05, 0]  # the rows of the nodes' positions
    away = replace(joined[0], x=x)
    moved = hold_contacts({0: away, 1: joined[1]}, contacts)
    assert sum(len(h) for h in moved.values()) >= 4
    assert join_islands(bent, [], np.zeros((2, 2)))[1] == []  # parts that never touch are left alone


def test_what_no_contact_holds_is_told_to_stay_apart_and_legs_from_elsewhere_are_taken(tables, sources) -> None:
    """A seat of a swivel chair holds on to no leg, and legs that are drawn far off hold on to no seat."""
    off = tables[0].points.copy()
    off[sources.part == 1] -= [0, 0.3, 0]
    bent = {l: start_part(sources.part_of(0, l), off) for l in (0, 1)}
    wide, new = island_gaps(bent, [], sources.touching)[0, 1]
    assert 0.25 < new <= wide < 0.35
    assert island_gaps(bent, [(0, 1)], sources.touching) == {}
    alone = {l: replace(part, source=replace(part.source, anchors={}), anchors={}) for l, part in bent.items()}
    assert island_gaps(alone, [], np.zeros((2, 2))) == {}, "what touches nothing anywhere may stand alone"
    assert island_gaps(alone, [], sources.touching)[0, 1][1] == pytest.approx(wide)

    held = sources.parts_of(0)
    sources._cache[0] = {0: replace(held[0], anchors={}), 1: held[1]}
    apart = assemble.put_together(off, BOTH, sources, np.array([0, 0]), False)
    assert apart.gaps[0, 1][1] > 0.25
    made = synthesize(off, BOTH, sources)
    assert made.measures["largest_gap"] < 0.01 and tables[0].shape.name != made.sources[0]


def test_what_would_fold_is_bent_stiffer(tables, sources, monkeypatch) -> None:
    part = start_part(sources.part_of(0, 0), tables[0].points)
    at = part.source.vertices
    strip = np.flatnonzero((np.abs(at[:, [0, 2]]) < 0.07).all(axis=1) & (at[:, 1] > at[:, 1].max() - 1e-6))
    crossed = {int(v): at[v] * [-1, 1, 1] for v in strip}  # left and right want to change places
    with monkeypatch.context() as patch:
        patch.setattr(bending, "STIFFER", (1.0,))
        plain = bend(part, crossed, preview=False)
    stiffer = bend(part, crossed, preview=False)
    assert plain.folds > 10
    assert stiffer.folds == 0
    # What is left of them is eased where it is.
    eased = unfolded(plain)
    assert inverted_triangles(part.affine, eased.vertices, part.source.triangles) == 0
    far = np.abs(at[:, 0]) > 0.2
    np.testing.assert_allclose(eased.vertices[far], plain.vertices[far], atol=0.01)
    assert unfolded(part) is part
    ways = bending._eased(plain), bending._flattened(plain, plain.vertices)
    least = min(np.abs(vertices - plain.vertices).max() for vertices in ways)
    assert np.abs(eased.vertices - plain.vertices).max() <= least + 1e-12
    with monkeypatch.context() as patch:
        patch.setattr(bending, "UNFOLDINGS", 2)  # what easing cannot undo is moved as one
        flattened = unfolded(plain)
        assert flattened.folds == 0
        np.testing.assert_allclose(flattened.vertices[np.abs(at[:, 0]) > 0.35], plain.vertices[np.abs(at[:, 0]) > 0.35],
                                   atol=0.02)  # fmt: skip
        patch.setattr(bending, "RADII", (1e3,))  # all of the part, in the end
        assert unfolded(plain).folds == 0
        patch.setattr(bending, "RADII", ())
        assert unfolded(plain).folds > 0
    assert part.folds == 0


def test_legs_that_the_draw_drove_through_the_top_stop_under_it(tables, sources) -> None:
    low = tables[0].points.copy()
    low[:384] -= [0, 0.05, 0]  # the top is .03 thick: the legs would come out above it
    made = synthesize(low, BOTH, sources, shapes=np.array([0, 0]))
    legs, top = (np.unique(made.triangles[made.part == l]) for l in (1, 0))
    above = made.vertices[legs, 1].max() - made.vertices[top, 1].max()
    assert above < -0.01
    assert made.measures["too_deep"] < 0.008 and list(made.measures["depths"]) == ["top – legs"]
    loose = {l: start_part(sources.part_of(0, l), low) for l in (0, 1)}
    assert contact_depths(loose, [(0, 1)])[0, 1] > 0.03  # without the contacts' say


def test_a_direction_into_the_other_part_is_found_and_depth_is_the_way_back(sources) -> None:
    anchors = sources.part_of(0, 1).anchors[0]
    np.testing.assert_allclose(anchors.into, np.tile([0.0, 1.0, 0.0], (len(anchors.vertices), 1)), atol=1e-9)
    np.testing.assert_allclose(anchors.deep, 0, atol=1e-5)
    plate = as_mesh(np.array([[-1, 0, -1], [1, 0, -1], [0, 0, 1.0]]), np.array([[0, 1, 2]], np.int32))
    points = np.array([[0, 0.04, 0], [0, -0.04, 0], [0, 0.5, 0], [0, 0.04, 0]])
    into = np.array([[0, 1.0, 0], [0, 1.0, 0], [0, 1.0, 0], [0, 0, 0]])
    np.testing.assert_allclose(depths(points, into, np.arange(4), plate), [0.04, 0, 0, 0], atol=1e-6)


def test_a_short_shelf_stretches_to_both_sides(tables, sources) -> None:
    part = start_part(sources.part_of(0, 0), tables[0].points)
    at = part.source.vertices
    ends = np.flatnonzero(np.abs(at[:, 0]) > np.abs(at[:, 0]).max() - 1e-6)
    pulled = {int(v): at[v] + [0.05 * np.sign(at[v, 0]), 0, 0] for v in ends}
    shift = (carry_along(part, pulled).targets - part.targets)[:, 0]
    right, middle = part.source.handles[:, 0] > 0.9 * at[:, 0].max(), np.abs(part.source.handles[:, 0]) < 0.05
    assert shift[right].min() > 0.03 and np.abs(shift[middle]).max() < 0.01


def shelf_between_walls() -> tuple[Sources, np.ndarray, np.ndarray]:
    """Sources of one shape, a plate that reaches from wall to wall; its points and their parts."""
    boxes = [((-0.4, -0.01, -0.2), (0.4, 0.01, 0.2)), ((-0.43, -0.3, -0.2), (-0.4, 0.3, 0.2)),
             ((0.4, -0.3, -0.2), (0.43, 0.3, 0.2))]  # fmt: skip
    boxes = [(np.array(low), np.array(high)) for low, high in boxes]
    vertices = np.concatenate([low + CORNERS * (high - low) for low, high in boxes])
    quads = np.concatenate([QUADS + 8 * i for i in range(3)])
    mesh = as_mesh(vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32))
    points = np.concatenate([box_points(low, high, 8) for low, high in boxes])
    shape = replace(make_table(1.0, 1.0, 1.0).shape, mesh=mesh)
    part = np.repeat([0, 1, 1], 384)
    labels = np.tile(np.repeat([0, 1, 1], 6), 2)
    return make_sources(["shelf"], lambda i: shape, [labels], points[None], part, PART_NAMES), points, part


def test_a_shelf_that_was_drawn_far_too_short_and_to_one_side_reaches_both_walls() -> None:
    sources, points, part = shelf_between_walls()
    draw = np.where((part == 0)[:, None], points * [0.6, 1, 1] - [0.1, 0, 0], points)
    made = synthesize(draw, BOTH, sources, symmetric=False)
    assert made.measures["largest_gap"] < 0.004
    shelf = made.vertices[np.unique(made.triangles[made.part == 0])]
    assert np.ptp(shelf[:, 0]) > 0.77


def test_a_loose_contact_is_sought_where_it_corresponds_to_when_the_nearest_place_did_not_do() -> None:
    sources, points, part = shelf_between_walls()
    draw = np.where((part == 0)[:, None], points * [0.1, 1, 1] - [0.2, 0, 0], points)  # all nearer to the left wall
    bent = {l: start_part(sources.part_of(0, l), draw) for l in (0, 1)}
    anchors = bent[0].anchors[1]
    right = bent[0].source.vertices[anchors.vertices, 0] > 0
    for stubborn, side in ((set(), -1), ({(0, 1)}, 1)):
        held = hold_contacts({0: bent[0], 1: replace(bent[1], anchors={})}, [(0, 1)], stubborn)[0]
        assert len(held) == len(anchors.vertices)
        assert {np.sign(held[int(v)][0]) for v in anchors.vertices[right]} == {side}


def test_a_shelf_between_slanted_walls_goes_there_straight_though_nearest_places_lie_this_way_and_that() -> None:
    x, z = np.meshgrid(np.linspace(-0.3, 0.3, 6), [-0.1, 0.1])
    here = np.stack([x.ravel(), np.zeros(12), z.ravel()], axis=1)
    wanted = here * [1.2, 1, 1] + [0, 0.05, 0]
    wave = wanted + [0, 0.08, 0] * (np.arange(12) % 2)[:, None] - [0, 0.04, 0]
    floor = as_mesh(np.array([[-2, 0.05, -2], [2, 0.05, -2], [0, 0.05, 3]]), np.array([[0, 1, 2]], np.int32))
    there, held = contacts._straight(here, wave, np.zeros(12, int), floor)
    assert held.all() and np.abs(there - wanted).max() < 0.01
    few, held = contacts._straight(here[:4], wave[:4], np.zeros(4, int), floor)
    assert held.all() and np.array_equal(few, wave[:4])  # four anchors say too little


def test_parts_that_stay_apart_are_taken_from_elsewhere_and_the_best_is_kept(tables, sources, monkeypatch) -> None:
    asked, costs = [], []
    really, put_together = assemble.retrieve, assemble.put_together

    def recording(*given, joined, barred, **more):
        asked.append((list(joined), set(barred)))
        return really(*given, joined=joined, barred=barred, **more)

    def measured(*given):
        costs.append(put_together(*given))
        return costs[-1]

    monkeypatch.setattr(assemble, "retrieve", recording)
    monkeypatch.setattr(assemble, "put_together", measured)
    draw = tables[0].points.copy()
    draw[384:] = tables[4].points[384:]  # legs of another table, which stand too far in
    monkeypatch.setattr(assemble, "WIDE", 1.0)
    plain = synthesize(draw, BOTH, sources)
    assert asked == [([], set())]
    monkeypatch.setattr(assemble, "WIDE", -1.0)  # as if nothing was ever near enough
    made = synthesize(draw, BOTH, sources)
    assert plain.sources == (tables[0].shape.name, tables[4].shape.name)
    assert [(joined, len(barred)) for joined, barred in asked[1:4]] == [([], 0), ([(0, 1)], 0), ([(0, 1)], 1)]
    assert len(asked) == len(costs) == 2 + assemble.RETRIES
    assert len({tuple(part.source.shape for part in one.bent.values()) for one in costs[1:]}) >= 3
    assert made.measures == assemble._merge(min(costs[1:], key=lambda one: one.cost), sources).measures


def test_a_gap_that_a_part_less_like_the_draw_would_close_is_not_left(tables, sources, monkeypatch) -> None:
    first, gap = tables[0].shape.name, [0.0]
    monkeypatch.setattr(assemble, "_misses", lambda part: np.array([0.01 if part.source.shape == first else 0.02]))
    monkeypatch.setattr(
        assemble, "contact_gaps", lambda bent, _: {(0, 1): (gap[0] * (bent[0].source.shape == first),) * 2}
    )

    def cost(t: int) -> float:
        return assemble.put_together(tables[0].points, BOTH, sources, np.array([t, t]), False).cost

    assert cost(0) < cost(1)  # the table itself is most like it ...
    gap[0] = 0.012
    assert cost(0) > cost(1)  # ... but not if it gapes


def test_gaps_are_told_of_the_parts_as_they_come_out(tables, sources, monkeypatch) -> None:
    at = sources.part_of(0, 0).vertices
    strip = np.flatnonzero((np.abs(at[:, [0, 2]]) < 0.07).all(axis=1) & (at[:, 1] > at[:, 1].max() - 1e-6))
    crossed = {int(v): at[v] * [-1, 1, 1] for v in strip}  # left and right want to change places
    monkeypatch.setattr(bending, "STIFFER", (1.0,))
    monkeypatch.setattr(assemble, "hold_contacts", lambda *_: {0: crossed, 1: {}})
    parts = assemble.put_together(tables[0].points, BOTH, sources, np.array([0, 0]), False)
    assert sum(part.folds for part in parts.bent.values()) == 0
    assert any(part.eased is not None for part in parts.bent.values())
    assert parts.gaps == contacts.contact_gaps(parts.bent, list(parts.gaps))
    assert parts.depths == contact_depths(parts.bent, list(parts.gaps))


def test_triangles_without_a_side_do_not_fold() -> None:
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0.5, 0, -1e-7]])
    flat = np.array([[0, 2, 1], [0, 1, 3]], np.int32)
    turned = rest + [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 3e-7]]
    assert inverted_triangles(rest, turned, flat) == 0
    rest[3, 2], turned[3, 2] = -0.1, 0.1
    assert inverted_triangles(rest, turned, flat) == 1


def test_what_is_let_in_or_far_through_is_not_pushed_back() -> None:
    into, piece, on = np.tile([0.0, 1.0, 0.0], (4, 1)), np.zeros(4, int), np.zeros(4)
    np.testing.assert_allclose(pushed_back(np.full(4, 0.03), on, into, piece, 0.003), 0.03)
    assert not pushed_back(np.full(4, 0.08), on, into, piece, 0.003).any()
    assert not pushed_back(np.full(4, 0.03), np.full(4, 0.02), into, piece, 0.003).any()
    rim = pushed_back(np.array([0.03, 0.03, 0.0, 0.02]), on, into, piece, 0.003)
    np.testing.assert_allclose(rim, [0.03, 0.03, 0.03, 0.02])  # the ray of one missed: it goes with the rest
    assert not pushed_back(np.array([0.03, 0.0, 0.0, 0.0]), on, into, piece, 0.003).any()


def test_colours_of_the_sources_go_along(tables, table_part) -> None:
    red, blue = [200, 0, 0], [0, 0, 200]
    shapes = [t.shape for t in tables]
    painted = np.where(tables[0].faces[:, None] == 0, red, blue).astype(np.uint8)
    shapes[0] = replace(shapes[0], mesh=replace(shapes[0].mesh, colours=painted))
    sources = make_sources(
        [s.name for s in shapes], shapes.__getitem__, [t.faces for t in tables],
        np.stack([t.points for t in tables]), table_part, PART_NAMES,
    )  # fmt: skip
    made = synthesize(tables[0].points, BOTH, sources, shapes=np.array([0, 0]))
    assert np.array_equal(made.colours, np.where(made.part[:, None] == 0, red, blue))
    mixed = synthesize(tables[0].points, BOTH, sources, shapes=np.array([0, 1]))
    assert np.array_equal(mixed.colours, np.where(mixed.part[:, None] == 0, red, PLAIN))
    assert synthesize(tables[1].points, BOTH, sources, shapes=np.array([1, 1])).colours is None
