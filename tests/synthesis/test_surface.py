"""From scratch: distances are signed, and a closed labelled surface is the mean of several shapes' bent parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.distance_field import signed_distance, winding_number
from shapeforge.synthesis.isosurface import isosurface
from shapeforge.synthesis.sources import Sources, make_sources
from shapeforge.synthesis.surface import held_back, synthesize_surface
from shapeforge.synthesis.surfaces import as_mesh, vertex_components
from tests.synthesis.conftest import PART_NAMES, Table, make_table

BOTH = np.array([True, True])
SIZES = [(1.0, 1.0, 1.0), (1.3, 0.9, 0.8), (0.8, 0.8, 1.2), (1.2, 1.1, 0.7)]
STEP = 0.035


def even_points(low: np.ndarray, high: np.ndarray, model: np.ndarray) -> np.ndarray:
    """A lattice on each side of a box, of square meshes on a box of the extents ``model``."""
    sides = []
    for axis in range(3):
        counts = [max(2, round(model[(axis + k) % 3] / STEP)) for k in (1, 2)]
        u, v = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts))
        for end in (0.0, 1.0):
            side = np.empty((u.size, 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = end, u.ravel(), v.ravel()
            sides.append(low + side * (high - low))
    return np.concatenate(sides)


@pytest.fixture(scope="module")
def tables() -> list[Table]:
    """Tables as in the other tests, but with points as even as those that are sampled."""
    made = [make_table(*size) for size in SIZES]
    boxes = [t.shape.mesh.vertices.reshape(5, 8, 3) for t in made]
    points = [
        np.concatenate([even_points(box.min(axis=0), box.max(axis=0), np.ptp(model, axis=0))
                        for box, model in zip(own, boxes[0], strict=True)])
        for own in boxes
    ]  # fmt: skip
    return [Table(t.shape, t.faces, p) for t, p in zip(made, points, strict=True)]


@pytest.fixture(scope="module")
def table_part_of(tables: list[Table]) -> np.ndarray:
    n_top = len(even_points(*np.zeros((2, 3)), np.ptp(tables[0].shape.mesh.vertices[:8], axis=0)))
    return (np.arange(len(tables[0].points)) >= n_top).astype(np.int32)


@pytest.fixture(scope="module")
def sources(tables: list[Table], table_part_of: np.ndarray) -> Sources:
    return make_sources(
        [t.shape.name for t in tables], lambda i: tables[i].shape, [t.faces for t in tables],
        np.stack([t.points for t in tables]), table_part_of, PART_NAMES,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cell() -> float:
    return 0.01


def test_a_table_from_scratch_is_closed_and_like_the_draw(tables, sources, cell) -> None:
    halfway = (tables[0].points + tables[1].points) / 2
    made = synthesize_surface(halfway, BOTH, sources, cell=cell)
    assert made.measures["open_edges"] == 0 and made.sources == ("", "")
    assert made.measures["folded_triangles"] == 0
    assert made.measures["n_triangles"] == len(made.triangles) == len(made.part)
    mesh = as_mesh(made.vertices, made.triangles)
    assert closest_points(mesh, halfway)[2].mean() < 0.5 * cell
    for l in (0, 1):
        label = made.part[closest_points(mesh, halfway[sources.part == l])[1]]
        assert (label == l).mean() > 0.9
    volume = np.einsum("ij,ij->", *(mesh.vertices[mesh.triangles[:, 0]],
                                    np.cross(*(mesh.vertices[mesh.triangles[:, i]] for i in (1, 2))))) / 6  # fmt: skip
    size = np.ptp(halfway, axis=0)
    assert 0 < volume < 0.5 * np.prod(size)


def test_a_part_that_is_switched_off_is_not_there(tables, sources, cell) -> None:
    made = synthesize_surface(tables[0].points, np.array([True, False]), sources, cell=cell)
    assert set(made.part.tolist()) == {0} and made.measures["open_edges"] == 0
    assert np.ptp(made.vertices[:, 1]) < 0.2


def test_the_same_draw_gives_the_same_bytes(tables, sources, cell) -> None:
    made = [synthesize_surface(tables[2].points, BOTH, sources, cell=cell) for _ in range(2)]
    assert made[0].vertices.tobytes() == made[1].vertices.tobytes()


@pytest.mark.parametrize(
    ("rows", "parts", "message"), [(3, BOTH, "same fit"), (None, np.array([False, False]), "no|none")]
)
def test_other_draws_are_refused(tables, sources, rows, parts, message) -> None:
    with pytest.raises(ValueError, match=message):
        synthesize_surface(tables[0].points[:rows], parts, sources)


def test_distances_are_those_of_a_sphere_and_overlaps_count_as_inside() -> None:
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 3, indexing="ij"), axis=-1)
    ball, corners = isosurface(0.6 - np.linalg.norm(steps, axis=-1), 0.0)
    ball = -1 + 0.05 * ball
    both = np.concatenate([ball, ball + [0.4, 0.0, 0.0]])
    args = np.concatenate([corners, corners + len(ball)]), np.full(3, -1.0), 0.05, (50, 41, 41)
    at = -1 + 0.05 * np.stack(np.meshgrid(np.arange(50), np.arange(41), np.arange(41), indexing="ij"), axis=-1)
    depth = [0.6 - np.linalg.norm(at - [x, 0, 0], axis=-1) for x in (0.0, 0.4)]
    sure = np.minimum(np.abs(depth[0]), np.abs(depth[1])) > 0.01
    expected = (depth[0] > 0).astype(int) + (depth[1] > 0)
    assert np.array_equal(winding_number(both, *args)[sure], expected[sure])
    field = signed_distance(both, *args, 0.15)
    assert np.array_equal(field[sure] > 0, expected[sure] > 0)
    outside = sure & (expected == 0)
    assert np.abs(field - np.clip(np.maximum(*depth), -0.15, 0.15))[outside].max() < 0.01


def test_a_part_is_the_mean_of_those_that_are_like_it(tables, sources, cell) -> None:
    halfway = (tables[0].points + tables[1].points) / 2
    made = synthesize_surface(halfway, BOTH, sources, cell=cell)
    assert all(len(names) > 1 for names in made.measures["lenders"].values())
    # Bent to one place, boxes are alike: the mean is as thin as they are.
    top = made.vertices[np.unique(made.triangles[made.part == 0])]
    assert np.ptp(top[:, 1]) == pytest.approx(np.ptp(halfway[sources.part == 0, 1]), abs=cell)


def turned(table: Table, degrees: float) -> Table:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    mesh = table.shape.mesh
    return Table(replace(table.shape, mesh=replace(mesh, vertices=mesh.vertices @ turn)), table.faces,
                 table.points @ turn)  # fmt: skip


def test_a_slanted_plate_hardly_thicker_than_a_step_has_no_terraces(tables, table_part_of) -> None:
    slanted = [turned(table, 20) for table in tables]
    own = make_sources(
        [t.shape.name for t in tables], lambda i: slanted[i].shape, [t.faces for t in tables],
        np.stack([t.points for t in slanted]), table_part_of, PART_NAMES,
    )  # fmt: skip
    made = synthesize_surface(slanted[0].points, BOTH, own, cell=0.02)  # the top is .029 thick
    assert made.measures["open_edges"] == 0
    at, triangles = made.vertices, made.triangles[made.part == 0]
    normal = np.cross(at[triangles[:, 1]] - at[triangles[:, 0]], at[triangles[:, 2]] - at[triangles[:, 0]])
    area = np.linalg.norm(normal, axis=1)
    up = np.array([np.sin(np.deg2rad(20)), np.cos(np.deg2rad(20)), 0])
    facing = np.abs(normal @ up) / np.maximum(area, 1e-300)
    flat = facing > 0.8  # the two sides of the plate, not its rim
    assert area[flat].sum() > 0.7 * area.sum()
    assert np.average(facing[flat], weights=area[flat]) > 0.995


def test_no_triangle_turns_over_where_many_vertices_are_drawn_to_one_edge() -> None:
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 25)] * 3, indexing="ij"), axis=-1)
    plain, triangles = isosurface(0.6 - np.linalg.norm(steps, axis=-1), 0.0)
    plain = plain / 12 - 1
    shaken = plain + np.random.default_rng(0).normal(0, 0.04, plain.shape)  # half a step: a third of them turn over
    shaken[np.abs(plain[:, 1]) < 0.1, 1] = 0.0  # and a knife's edge
    before = normals(plain, triangles)
    assert ((normals(shaken, triangles) * before).sum(axis=1) < 0).mean() > 0.05
    held = held_back(plain, shaken, triangles)
    assert ((normals(held, triangles) * before).sum(axis=1) >= 0).all()
    went = np.linalg.norm(held - plain, axis=1).sum() / np.linalg.norm(shaken - plain, axis=1).sum()
    assert 0.3 < went < 1
    calm = plain * [1.0, 0.8, 1.1]
    assert np.abs(held_back(plain, calm, triangles) - calm).max() < 1e-12


def normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def test_legs_of_all_lenders_reach_the_top_though_the_draw_has_them_too_short(tables, sources, cell) -> None:
    short = (tables[0].points + tables[1].points) / 2
    short[sources.part == 0] += [0, 0.04, 0]
    made = synthesize_surface(short, BOTH, sources, cell=cell)
    assert len(made.measures["lenders"]["legs"]) > 1
    assert vertex_components(len(made.vertices), made.triangles).max() == 0  # one piece


def test_colours_are_those_of_the_nearest_lender(tables, table_part_of, cell) -> None:
    red, blue = np.uint8([200, 0, 0]), np.uint8([0, 0, 200])
    coloured = [
        replace(t.shape, mesh=replace(t.shape.mesh, colours=np.where((t.faces == 0)[:, None], red, blue)))
        for t in tables
    ]
    own = make_sources(
        [t.shape.name for t in tables], lambda i: coloured[i], [t.faces for t in tables],
        np.stack([t.points for t in tables]), table_part_of, PART_NAMES,
    )  # fmt: skip
    made = synthesize_surface(tables[0].points, BOTH, own, cell=cell)
    assert (made.colours[made.part == 0] == red).all() and (made.colours[made.part == 1] == blue).all()
