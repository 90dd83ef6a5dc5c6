"""Parts cut cleanly: islands go home, borders become smooth, cuts get lids, and nothing of the surface is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.shape import Mesh
from shapeforge.synthesis.capping import cap
from shapeforge.synthesis.cleaning import areas, clean_labels
from shapeforge.synthesis.cutting import smooth_borders
from shapeforge.synthesis.measures import far_from, raggedness
from shapeforge.synthesis.parts import cut_mesh, cut_part
from shapeforge.synthesis.retrieve import retrieve
from shapeforge.synthesis.sources import make_sources
from shapeforge.synthesis.surfaces import as_mesh, refine, sides_of, weld
from tests.synthesis.conftest import PART_NAMES

BOTH = np.array([True, True])


def sheet(n: int = 30, size: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """A square of 2 n^2 triangles."""
    u, v = np.meshgrid(np.linspace(0, size, n + 1), np.linspace(0, size, n + 1), indexing="ij")
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([u.ravel(), v.ravel(), 0 * u.ravel()], 1), triangles


def tube(n_around: int = 24, n_along: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """A closed cylinder of radius .08 from x = -.4 to .4."""
    angle = np.linspace(0, 2 * np.pi, n_around, endpoint=False)
    x = np.linspace(-0.4, 0.4, n_along + 1)
    ring = np.stack([np.zeros(n_around), 0.08 * np.cos(angle), 0.08 * np.sin(angle)], 1)
    vertices = (ring[None] + np.stack([x, 0 * x, 0 * x], 1)[:, None]).reshape(-1, 3)
    at = np.arange(len(vertices)).reshape(n_along + 1, n_around)
    after = np.roll(at, -1, axis=1)
    a, b, c, d = at[:-1].ravel(), after[:-1].ravel(), after[1:].ravel(), at[1:].ravel()
    sides = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    low, high = len(vertices), len(vertices) + 1
    lids = [[low, after[0, i], at[0, i]] for i in range(n_around)]
    lids += [[high, at[-1, i], after[-1, i]] for i in range(n_around)]
    vertices = np.concatenate([vertices, [[-0.4, 0, 0], [0.4, 0, 0]]])
    return vertices, np.concatenate([sides, lids])


def n_open(triangles: np.ndarray) -> int:
    edges, edge_of_side = sides_of(triangles)
    return int((np.bincount(edge_of_side, minlength=len(edges)) == 1).sum())


def open_length(vertices: np.ndarray, triangles: np.ndarray) -> float:
    edges, edge_of_side = sides_of(triangles)
    single = edges[np.bincount(edge_of_side, minlength=len(edges)) == 1]
    return float(np.linalg.norm(vertices[single[:, 0]] - vertices[single[:, 1]], axis=1).sum())


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    return float(np.linalg.det(vertices[triangles]).sum() / 6)


def test_specks_and_islands_go_home_and_points_keep_what_is_theirs(tables) -> None:
    mesh, faces = tables[2].shape.mesh, tables[2].faces
    vertices, triangles = weld(mesh.vertices, mesh.triangles)
    vertices, triangles, parent = refine(vertices, triangles, length=0.05, limit=20_000)
    truth = faces[mesh.face_of_triangle][parent]
    assert (clean_labels(vertices, triangles, truth, 2) == truth).all()
    middle = vertices[triangles].mean(axis=1)
    # The upper end of every leg is called top, a bit of the top is called leg, some of it nothing.
    wrong = truth.copy()
    legs_upper = (truth == 1) & (middle[:, 1] > middle[truth == 1, 1].max() - 0.05)
    speck = (truth == 0) & (np.linalg.norm(middle - middle[truth == 0].mean(axis=0), axis=1) < 0.06)
    wrong[legs_upper], wrong[speck] = 0, 1
    wrong[np.flatnonzero(truth == 0)[:3]] = -1
    assert legs_upper.sum() > 20 and speck.sum() > 5
    assert (clean_labels(vertices, triangles, wrong, 2) == truth).all()
    points = np.zeros((len(triangles), 2), int)
    points[truth == 0, 0] = points[truth == 1, 1] = 1
    points[legs_upper] = [3, 0]
    kept = clean_labels(vertices, triangles, wrong, 2, points)
    assert (kept[legs_upper] == 0).all() and (kept[~legs_upper] == truth[~legs_upper]).all()


def test_equal_pieces_that_touch_nothing_of_their_part_are_no_islands(tables) -> None:
    # Four legs far apart are each a quarter of their part; twenty slats would be a twentieth each.
    mesh = tables[0].shape.mesh
    slats = [mesh.vertices[:8] * [1, 1, 0.01] + [0, 0, 0.2 * i] for i in range(20)]
    vertices = np.concatenate([*slats, [[-1, 0.6, -1], [1, 0.6, -1], [1, 0.6, 5]]])
    box = mesh.triangles[(mesh.triangles < 8).all(axis=1)]
    triangles = np.concatenate([box + 8 * i for i in range(20)] + [[[160, 161, 162]]])
    label = np.r_[np.ones(20 * len(box), int), 0]
    assert (clean_labels(vertices, triangles, label, 2) == label).all()


def test_smooth_borders_cut_through_triangles_and_lose_nothing() -> None:
    vertices, triangles = sheet()
    middle = vertices[triangles].mean(axis=1)
    row = np.round(middle[:, 1] * 30 / 0.7 - 0.5).astype(int)
    torn = (middle[:, 0] > 0.35 + 0.03 * (-1.0) ** row).astype(np.int32)
    at, cut, label = smooth_borders(vertices, triangles, torn)
    assert areas(at, cut).sum() == pytest.approx(0.49, abs=1e-12)
    assert open_length(at, cut) == pytest.approx(2.8, abs=1e-9)  # the sheet's own edge: no cracks
    before, after = raggedness(as_mesh(vertices, triangles), torn, 1), raggedness(as_mesh(at, cut), label, 1)
    assert before > 0.01 and after < before / 8
    assert areas(at, cut)[label == 1].sum() == pytest.approx(areas(vertices, triangles)[torn == 1].sum(), rel=0.03)


def test_three_parts_may_meet_in_a_triangle() -> None:
    vertices, triangles = sheet()
    middle = vertices[triangles].mean(axis=1) - [0.352, 0.353, 0]
    angle = np.degrees(np.arctan2(middle[:, 1], middle[:, 0]) + 0.05 * np.sin(40 * middle[:, 0])) % 360
    label = (angle // 120).astype(int)
    at, cut, new = smooth_borders(vertices, triangles, label)
    assert set(new) == {0, 1, 2} and open_length(at, cut) == pytest.approx(2.8, abs=1e-9)
    assert areas(at, cut).sum() == pytest.approx(0.49, abs=1e-12)
    for l in range(3):
        assert areas(at, cut)[new == l].sum() == pytest.approx(areas(vertices, triangles)[label == l].sum(), rel=0.05)


def test_borders_along_edges_and_creases_stay_and_thin_parts_do_not_vanish() -> None:
    vertices, triangles = tube()
    middle = vertices[triangles].mean(axis=1)
    ends = (np.abs(middle[:, 0]) > 0.3999).astype(int)  # the border is the sharp rim
    at, cut, label = smooth_borders(vertices, triangles, ends)
    assert areas(at, cut)[label == 1].sum() == pytest.approx(areas(vertices, triangles)[ends == 1].sum(), rel=1e-6)
    flat, faces = sheet()
    middle = flat[faces].mean(axis=1)
    straight = (middle[:, 0] > 0.35).astype(int)
    at, cut, label = smooth_borders(flat, faces, straight)
    assert len(cut) <= len(faces) + 4  # at the ends of the border only
    thin = ((np.abs(middle[:, 0] - 0.35) < 0.03) & (middle[:, 1] < 0.05)).astype(int)
    kept = smooth_borders(flat, faces, thin)
    assert areas(*kept[:2])[kept[2] == 1].sum() >= 0.7 * areas(flat, faces)[thin == 1].sum()


def test_lids_close_what_the_saw_opened() -> None:
    vertices, triangles = tube()
    left = vertices[triangles].mean(axis=1)[:, 0] < 0.01
    whole, parts = volume(vertices, triangles), []
    for chosen in (left, ~left):
        lids, still_open = cap(vertices, triangles, chosen)
        closed = np.concatenate([triangles[chosen], lids])
        assert n_open(triangles[chosen]) > 0 and n_open(closed) == 0 and still_open == 0
        parts.append(volume(vertices, closed))
    assert min(parts) > 0.4 * whole and sum(parts) == pytest.approx(whole, rel=1e-9)
    # A sheet was never closed: nothing to close, and nothing that counts as open.
    flat, faces = sheet()
    assert [len(cap(flat, faces, faces[:, 0] < 400)[0]), cap(flat, faces, faces[:, 0] < 400)[1]] == [0, 0.0]
    # A cut that is no plane's (a saddle around the tube) stays open, and counts.
    height = vertices[triangles].mean(axis=1)
    wave = height[:, 0] < 0.25 * np.sign(height[:, 1])
    lids, still_open = cap(vertices, triangles, wave)
    assert len(lids) == 0 and still_open > 0.5


def test_arms_that_no_point_explains_are_left_out(tables, table_part) -> None:
    mesh, faces = tables[0].shape.mesh, tables[0].faces
    arm = np.concatenate([mesh.vertices[:8] * [0.05, 1, 0.05] + [0, 0.35, 0]])
    box = mesh.triangles[(mesh.triangles < 8).all(axis=1)]
    with_arm = as_mesh(np.concatenate([mesh.vertices, arm]), np.concatenate([mesh.triangles, box + len(mesh.vertices)]))
    label = np.r_[faces[mesh.face_of_triangle], np.zeros(len(box), np.int32)]
    cut = cut_mesh(with_arm, label, tables[0].points, table_part, 2)
    vertices, triangles, quality = cut_part(cut, 0, tables[0].points[table_part == 0])
    assert vertices[:, 1].max() < mesh.vertices[:, 1].max() + 1e-6
    assert not quality.problems and quality.unexplained > 0 and n_open(triangles) == 0
    assert not far_from(tables[0].points[table_part == 0], vertices).any()


def test_painted_labels_are_taken_at_their_word(tables, table_part) -> None:
    mesh, faces = tables[2].shape.mesh, tables[2].faces.copy()
    faces[6] = 0  # a side of one leg
    cut = {
        painted: cut_mesh(mesh, faces[mesh.face_of_triangle], tables[2].points, table_part, 2, painted=painted)
        for painted in (True, False)
    }
    area = {painted: areas(c.vertices, c.triangles)[c.label == 0].sum() for painted, c in cut.items()}
    assert cut[True].mended.max() == 0 < cut[False].mended.max()
    assert area[False] < area[True]


def test_of_two_equal_parts_the_unblemished_one_is_taken(tables, table_part) -> None:
    points = np.stack([tables[0].points, tables[0].points + [1e-4, 0, 0], tables[3].points])
    torn = tables[0].faces.copy()
    torn[6], torn[13] = 0, 0  # sides of two legs are called top: cleaned, but doubtful
    for order, wanted in (([torn, tables[0].faces], 1), ([tables[0].faces, torn], 0)):
        sources = make_sources(
            ["a", "b", "c"], lambda i: replace(tables[0 if i < 2 else 3].shape, name="abc"[i]),
            [*order, tables[3].faces], points, table_part, ("top", "legs"),
        )  # fmt: skip
        draw = tables[0].points + [5e-5, 0, 0]
        assert retrieve(draw, BOTH, sources).shape[1] == wanted
        assert sources.part_of(1 - wanted, 1).quality.blemish > sources.part_of(wanted, 1).quality.blemish


def test_legs_of_one_side_only_are_not_lent_unless_the_shape_has_no_others(tables, table_part) -> None:
    left = np.r_[[False], tables[0].points[384:].reshape(4, -1, 3)[:, :, 0].mean(axis=1) < 0].repeat(6)
    half = np.where(left, 0, tables[0].faces)  # the left legs are called top
    without = replace(tables[0].shape, name="three", mesh=without_faces(tables[0].shape.mesh, left))
    shapes = [tables[0].shape, *(table.shape for table in tables[1:4]), without]
    faces = [half, *(table.faces for table in tables[1:4]), tables[0].faces[~left]]
    positions = np.stack([table.points for table in [*tables[:4], tables[0]]])
    positions[4, np.r_[np.zeros(384, bool), left[6:].repeat(64)]] = np.nan
    names = [shape.name for shape in shapes]
    sources = make_sources(names, lambda i: shapes[i], faces, positions, table_part, PART_NAMES, painted=names)
    assert sources.part_of(0, 1).quality.one_sided > 0.9
    assert any("one side" in problem for problem in sources.part_of(0, 1).quality.problems)
    assert max(sources.part_of(t, 1).quality.one_sided for t in (1, 2, 3, 4)) < 0.1
    assert max(sources.part_of(t, 0).quality.one_sided for t in (1, 2, 3, 4)) < 0.1
    assert retrieve(tables[0].points, BOTH, sources).shape[1] != 0


def without_faces(mesh: Mesh, out: np.ndarray) -> Mesh:
    kept = ~out[mesh.face_of_triangle]
    number = np.cumsum(~out) - 1
    return Mesh(mesh.vertices, mesh.triangles[kept], number[mesh.face_of_triangle[kept]], int((~out).sum()))
