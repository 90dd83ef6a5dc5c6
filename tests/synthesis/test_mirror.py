"""The family's mirror plane is found wherever it lies, and draws become as symmetric as the family."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.synthesis.assemble import synthesize
from shapeforge.synthesis.measures import symmetry_error
from shapeforge.synthesis.mirror import SYMMETRIC, Bend, find_mirror

BOTH = np.array([True, True])


def turn(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def lopsided(points: np.ndarray, leg: slice, by: np.ndarray) -> np.ndarray:
    """One leg moved sideways: what a noisy draw does."""
    moved = points.copy()
    moved[leg] += by
    return moved


def test_the_plane_is_found_on_a_family_that_lies_askew(tables, table_part) -> None:
    turned = np.stack([(t.points + [0.1, 0, 0]) @ turn(25).T for t in tables if "1x1x1" not in t.shape.name])
    mirror = find_mirror(turned, np.ones((len(turned), 2), bool), table_part)
    across = max(abs(turn(25)[:, 0] @ mirror.normal), abs(turn(25)[:, 2] @ mirror.normal))  # tables have two planes
    assert across > 0.9999 and mirror.symmetric.all()
    assert abs(mirror.place(turned[0], table_part) - (turn(25) @ [0.1, 0, 0]) @ mirror.normal) < 1e-3


def test_a_lopsided_draw_becomes_symmetric_and_a_symmetric_one_stays(tables, table_part, sources) -> None:
    points = tables[1].points
    assert np.abs(sources.mirror.made_symmetric(points, table_part) - points).max() < 2e-3
    drawn = lopsided(points, slice(384, 768), np.array([0.03, 0.0, 0.02]))
    better = sources.mirror.made_symmetric(drawn, table_part)
    assert np.linalg.norm(better - drawn, axis=1)[table_part == 1].mean() <= SYMMETRIC
    plane = sources.mirror.normal, sources.mirror.place(better, table_part)
    assert symmetry_error(better, plane) < 0.1 * symmetry_error(drawn, plane)
    assert np.abs(better[:384] - points[:384]).max() < 2e-3


def test_a_part_far_from_symmetric_stays_as_drawn(tables, table_part, sources) -> None:
    drawn = lopsided(tables[1].points, slice(384, 1920), np.array([0.2, 0.0, 0.0]))
    drawn[384:768] += [0.0, 0.3, 0.0]
    made = sources.mirror.made_symmetric(drawn, table_part)
    assert np.array_equal(made[table_part == 1], drawn[table_part == 1])


def test_legs_drawn_on_one_side_stand_on_both(tables, table_part, sources) -> None:
    mirror, points = sources.mirror, tables[1].points
    along = points @ mirror.normal - mirror.place(points, table_part)
    legs = table_part == 1
    for sign in (-1, 1):
        drawn = np.where((legs & (sign * along > 0))[:, None], points - 2 * along[:, None] * mirror.normal, points)
        assert np.abs(mirror.made_symmetric(drawn, table_part) - points).max() < 2e-3
        moved = (drawn @ mirror.normal - mirror.place(points, table_part)) * sign
        assert moved[legs].max() < 0 < (mirror.made_symmetric(drawn, table_part) @ mirror.normal * sign)[legs].max()
    both = np.where(legs[:, None], points - 2 * along[:, None] * mirror.normal, points)
    assert np.array_equal(mirror.on_both_sides(both, table_part), both)  # swapped, they are on both


def test_of_a_family_that_has_a_part_on_either_side_nothing_is_put_on_the_other(tables, table_part) -> None:
    legs = table_part == 1
    left = tables[0].points[legs, 0] < 0
    shapes = np.stack([table.points for table in tables[:4]])
    shapes[:2, np.flatnonzero(legs)[left]] *= [-1, 1, 1]  # two of four tables have all their legs on the right
    mirror = find_mirror(shapes, np.ones((4, 2), bool), table_part)
    assert np.array_equal(mirror.on_both_sides(shapes[0], table_part), shapes[0])


def test_absent_parts_stay_absent_and_families_without_shapes_have_no_pairs(tables, table_part, sources) -> None:
    points = np.where((table_part == 1)[:, None], np.nan, tables[0].points)
    made = sources.mirror.made_symmetric(points, table_part)
    assert np.isnan(made[table_part == 1]).all() and np.isfinite(made[table_part == 0]).all()
    empty = find_mirror(np.full((2, len(table_part), 3), np.nan), np.zeros((2, 2), bool), table_part)
    assert not empty.symmetric.any() and np.array_equal(empty.partner, np.arange(len(table_part)))


def test_meshes_of_lopsided_draws_are_symmetric_unless_asked_not_to_be(tables, sources) -> None:
    drawn = lopsided(tables[2].points, slice(384, 768), np.array([0.03, 0.0, 0.03]))
    made = [synthesize(drawn, BOTH, sources, symmetric=symmetric) for symmetric in (True, False)]
    errors = [shape.measures["symmetry_error"] for shape in made]
    assert errors[0] < 0.5 * errors[1]


def test_where_one_leg_is_pulled_the_other_goes_as_far_and_the_symmetry_halves_nothing(
    tables, table_part, sources
) -> None:
    mirror, points = sources.mirror, tables[1].points
    pull = 0.05 * mirror.normal + np.array([0.0, 0.01, 0.0])
    for k in (400, 700, 1500):
        held = np.full(points.shape, np.nan)
        held[k] = points[k] + pull
        twin = mirror.partner[k]
        found = mirror.with_twins(held, points, table_part)
        assert set(np.flatnonzero(np.isfinite(found[:, 0]))) == {k, twin} and twin != k
        assert np.array_equal(found[k], held[k])
        moved = np.where(np.isfinite(found), found, points)
        made = mirror.made_symmetric(moved, table_part)
        assert np.abs(made[[k, twin]] - moved[[k, twin]]).max() < 2e-3
        alone = mirror.made_symmetric(np.where(np.isfinite(held), held, points), table_part)
        assert np.linalg.norm(alone[k] - held[k]) > 0.02, "without its twin half the way is lost"


def test_a_point_on_the_plane_is_held_on_it_and_a_held_pair_stays_as_it_is(tables, table_part, sources) -> None:
    mirror, points = sources.mirror, tables[1].points
    place = mirror.place(points, table_part)
    middle = int(np.abs(points[:384] @ mirror.normal - place).argmin())
    points = points.copy()
    points[middle] -= (points[middle] @ mirror.normal - place) * mirror.normal
    held = np.full(points.shape, np.nan)
    held[middle] = points[middle] + 0.1 * mirror.normal + [0.0, 0.04, 0.0]
    found = mirror.with_twins(held, points, table_part)
    assert np.abs(found[middle] - points[middle] - [0.0, 0.04, 0.0]).max() < 1e-9
    assert np.isfinite(found[:, 0]).sum() == 1
    pair = [500, mirror.partner[500]]
    assert mirror.partner[pair[1]] == pair[0]
    held = np.full(points.shape, np.nan)
    held[pair] = points[pair] + [[0.02, 0, 0], [0, 0, 0.03]]
    assert np.array_equal(mirror.with_twins(held, points, table_part), held, equal_nan=True)


@pytest.mark.parametrize("aside", [0.0, 0.06])
def test_legs_held_unlike_on_both_sides_both_go_where_they_are_held(tables, table_part, sources, aside) -> None:
    """Also where the other leg's is not the very twin but a point near it; the mesh of the bent legs has both ends."""
    mirror, points = sources.mirror, tables[1].points
    legs = [np.arange(384 * i, 384 * (i + 1)) for i in range(1, 5)]
    own = next(leg for leg in legs if 700 in leg)
    k = own[points[own, 1].argmin()]
    twin = mirror.partner[k]
    opposite = next(leg for leg in legs if twin in leg)
    other = opposite[np.abs(np.linalg.norm(points[opposite] - points[twin], axis=1) - aside).argmin()]
    assert (other == twin) == (aside == 0)
    held, pull = np.full(points.shape, np.nan), np.array([0.0, -0.04, 0.0])
    held[k], held[other] = points[k] + pull, points[other]
    assert np.array_equal(mirror.with_twins(held, points, table_part), held, equal_nan=True), "neither takes the other"
    reached = points + pull / 2  # as a symmetric family does
    bend = mirror.bend_apart(held, points, reached, table_part)
    bent = bend.moved(reached)
    assert np.linalg.norm((reached - held)[[k, other]], axis=1).min() > 0.019
    assert np.linalg.norm((bent - held)[[k, other]], axis=1).max() < 1e-3
    far = np.linalg.norm(points - points[k], axis=1) > 0.4
    far &= np.linalg.norm(points - points[other], axis=1) > 0.4
    assert far.sum() > 300 and np.abs(bent - reached)[far].max() < 1e-3
    halved = mirror.made_symmetric(bent, table_part)
    assert np.linalg.norm((halved - held)[[k, other]], axis=1).min() > 0.012
    kept = mirror.made_symmetric(bent, table_part, np.array([True, False]))
    assert np.array_equal(kept[table_part == 1], bent[table_part == 1])
    missed = []
    for symmetric in (True, np.array([True, False])):
        vertices = synthesize(bent, BOTH, sources, symmetric=symmetric).vertices
        missed.append([foot_off(vertices, bent[leg][bent[leg, 1].argmin()]) for leg in (own, opposite)])
    assert max(missed[1]) < 0.008 and max(missed[1]) < 0.5 * max(missed[0]), missed


def foot_off(vertices: np.ndarray, foot: np.ndarray) -> float:
    """How much higher or lower than this the mesh ends there."""
    near = np.linalg.norm((vertices - foot)[:, [0, 2]], axis=1) < 0.08
    return float(abs(vertices[near, 1].min() - foot[1]))


def test_what_is_held_alike_or_on_one_side_bends_nothing(tables, table_part, sources) -> None:
    mirror, points = sources.mirror, tables[1].points
    held, pull = np.full(points.shape, np.nan), np.array([0.0, 0.02, 0.0]) + 0.03 * mirror.normal
    twin = mirror.partner[700]
    held[700], held[twin] = points[700] + pull, points[twin] + pull - 2 * (pull @ mirror.normal) * mirror.normal
    assert mirror.bend_apart(held, points, points, table_part) is None
    held[twin] = np.nan
    assert mirror.bend_apart(held, points, points, table_part) is None
    held[710] = points[710] - pull
    assert mirror.bend_apart(held, points, points, table_part) is None, "two on one side say nothing of the other"


@pytest.mark.parametrize("by", [0.02, 0.15, 0.6])
def test_a_bend_folds_nothing_however_far_it_goes(by) -> None:
    """Along a line through the centre, points keep their order."""
    line = np.linspace(-1.0, 1.0, 2001)[:, None] * [1.0, 0.0, 0.0]
    bend = Bend.through(np.zeros((1, 3)), np.array([[by, 0.0, 0.0]]))
    assert np.diff(bend.moved(line)[:, 0]).min() > 0 and np.abs(bend.moved(np.zeros((1, 3)))[0, 0] - by) < 2e-3 * by
    twice = Bend.through(np.zeros((2, 3)), np.array([[by, 0.0, 0.0], [-by, 0.0, 0.0]]))
    assert np.linalg.norm(twice.moved(np.zeros((1, 3)))) < 1e-6, "two ways at one place"
