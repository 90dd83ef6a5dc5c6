"""From a few strokes to a whole painting: along the surface, over gaps, to copies and mirror images."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.families import generate
from shapeforge.collection.shape import Mesh
from shapeforge.viewer import spreading
from shapeforge.viewer.brushes import along, face_surface, mirror_plane
from shapeforge.viewer.spreading import Ground, complete
from tests.viewer.test_painting import joined, sheet


def ground_of(mesh: Mesh, mirror: spreading.Plane | None = None) -> Ground:
    return Ground(mesh, face_surface(mesh), mirror)


def moved(mesh: Mesh, size: tuple[float, float, float], by: tuple[float, float, float]) -> Mesh:
    return mesh.moved(mesh.vertices * size + by)


def painted(mesh: Mesh, **parts: int) -> np.ndarray:
    """Paint (F,) with part ``p`` on face ``part_p``."""
    paint = np.full(mesh.n_faces, -1, np.int32)
    for name, face in parts.items():
        paint[face] = int(name[-1])
    return paint


def test_two_strokes_share_a_sheet_half_way_and_keep_their_own():
    mesh = sheet(20)
    paint = painted(mesh, part_2=3 * 20 + 10, part_0=16 * 20 + 10)
    done = complete(ground_of(mesh), paint)
    truth = np.where(np.arange(400) // 20 < 10, 2, 0)
    assert (done == truth).mean() > 0.97
    assert np.array_equal(done[paint >= 0], paint[paint >= 0])
    with pytest.raises(ValueError, match="at least one painted face"):
        complete(ground_of(mesh), np.full(400, -1, np.int32))


def test_the_border_is_drawn_to_a_crease_nearby():
    """Half-way between the strokes lies a row beyond the crease."""
    mesh = sheet(40, lift=1.5)
    done = complete(ground_of(mesh), painted(mesh, part_2=6 * 40 + 20, part_0=29 * 40 + 20))
    assert np.array_equal(done, np.where(np.arange(1600) // 40 < 20, 2, 0))


def test_paint_goes_over_to_shells_that_touch_at_a_price_and_not_to_those_apart():
    first, second = moved(sheet(10), (0.3, 1, 0.3), (0, 0, 0)), moved(sheet(10), (0.3, 1, 0.3), (0.302, 0, 0))
    mesh = joined(joined(first, second), moved(sheet(10), (0.3, 1, 0.3), (0.302, 0.5, 0)))
    ground = ground_of(mesh)
    assert ground.surface.piece.max() == 2
    start, neighbour, length = ground.ways
    row = np.repeat(np.arange(mesh.n_faces), np.diff(start))
    across = ground.surface.piece[row] != ground.surface.piece[neighbour]
    assert across.any() and length[across].min() >= spreading.GAP
    assert set(ground.surface.piece[row[across]]) == {0, 1}


def test_a_stroke_on_one_copy_counts_for_all_copies():
    """Three upright boards and two lying ones, two strokes: what stands is one part, what lies is the other."""
    standing = [moved(sheet(6), (0.05, 1, 0.4), (x, 0, 0)) for x in (0.0, 0.5, 1.0)]
    lying = [moved(sheet(6), (0.4, 1, 0.05), (x, 0, 0.6)) for x in (0.05, 0.55)]
    mesh = standing[0]
    for one in (*standing[1:], *lying):
        mesh = joined(mesh, one)
    done = complete(ground_of(mesh), painted(mesh, part_0=3, part_1=3 * 36 + 3))
    assert done.reshape(5, 36).tolist() == [[0] * 36] * 3 + [[1] * 36] * 2


def test_the_mirror_image_of_a_stroke_counts_unless_something_else_is_painted_there():
    mesh = sheet(20)
    mirror = (np.array([1.0, 0, 0]), 0.5)
    rows = np.arange(400) // 20
    paint = painted(mesh, part_0=1 * 20 + 10, part_1=9 * 20 + 10)
    without, with_it = complete(ground_of(mesh), paint), complete(ground_of(mesh, mirror), paint)
    assert (without[rows >= 15] == 1).all() and (with_it[rows >= 17] == 0).all()
    paint[18 * 20 + 10] = 1
    assert (complete(ground_of(mesh, mirror), paint)[rows >= 17] == 1).mean() > 0.9


def test_looks_are_those_of_copies_and_mirror_images_and_no_others():
    a = sheet(5, lift=0.6)
    mirrored = a.moved(a.vertices * [-1, 1, 1] + [9, 3, 2])
    turned = a.moved(a.vertices[:, [1, 0, 2]] + [0, 7, 0])
    longer = a.moved(a.vertices * [1, 1, 1.5] + [5, 0, 0])
    looks = ground_of(joined(joined(a, mirrored), joined(turned, longer))).looks
    apart = np.linalg.norm(looks - looks[0], axis=1)
    assert apart[1] < 1e-9 and apart[2] > 0.05 and apart[3] > 0.05


def test_four_strokes_a_part_make_chairs_right():
    right, seen = [], 0
    for one in generate("chairs", 6, seed=41, broken=0.0):
        mesh = one.mesh.moved(one.mesh.vertices / np.linalg.norm(np.ptp(one.mesh.vertices, axis=0)))
        truth, surface = np.asarray(one.faces), face_surface(mesh)
        plane = mirror_plane(surface.centres[:: max(mesh.n_faces // 1500, 1)])
        paint, rng = np.full(mesh.n_faces, -1, np.int32), np.random.default_rng(seen)
        for part in np.unique(truth[truth >= 0]):
            own = np.flatnonzero(truth == part)
            for face in rng.choice(own, min(4, len(own)), p=surface.areas[own] / surface.areas[own].sum()):
                touched = along(surface, int(face), surface.centres[face], 0.014)
                paint[touched[truth[touched] == part]] = part
        done = complete(Ground(mesh, surface, None if plane is None else plane[:2]), paint)
        asked = truth >= 0
        right.append(np.average(done[asked] == truth[asked], weights=surface.areas[asked]))
        seen += 1
    assert np.mean(right) > 0.95 and min(right) > 0.85
