"""From scratch: clouds become denser and know the way out, and a closed labelled surface grows around them."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.oriented import Orientations, between
from shapeforge.synthesis.sources import Sources, make_sources
from shapeforge.synthesis.surface import synthesize_surface
from shapeforge.synthesis.surfaces import as_mesh
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
def sources(tables: list[Table]) -> Sources:
    n_top = len(even_points(*np.zeros((2, 3)), np.ptp(tables[0].shape.mesh.vertices[:8], axis=0)))
    part = (np.arange(len(tables[0].points)) >= n_top).astype(np.int32)
    return make_sources(
        [t.shape.name for t in tables], lambda i: tables[i].shape, [t.faces for t in tables],
        np.stack([t.points for t in tables]), part, PART_NAMES,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cell() -> float:
    return 0.01


def test_points_between_two_of_a_sphere_lie_on_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    turn = 0.3 * rng.normal(size=(40, 3))
    others = points + turn - (turn * points).sum(axis=1, keepdims=True) * points
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    both = np.concatenate([points, others])
    pairs = np.stack([np.arange(40), 40 + np.arange(40)], axis=1)
    made, normals = between(both, both, pairs)
    angle = np.arccos((points * others).sum(axis=1))
    assert np.array_equal(made[:80], both)
    # The chord's middle is angle^2 / 8 inside, the new point two powers better.
    assert (np.abs(np.linalg.norm(made[80:], axis=1) - 1) < angle**4 / 20).all() and angle.max() > 0.5
    assert np.allclose(normals[80:], made[80:] / np.linalg.norm(made[80:], axis=1, keepdims=True))


def test_normals_and_thickness_are_those_of_the_boxes(tables, sources) -> None:
    normals, thickness = Orientations(sources).of_shape(0)
    top = tables[0].shape.mesh.vertices[:8, 1]
    over = (sources.part == 0) & (np.abs(tables[0].points[:, 1] - top.max()) < 1e-6)
    assert (normals[over, 1] > 0.99).mean() > 0.97
    assert np.median(thickness[over]) == pytest.approx(np.ptp(top), rel=0.35)
    leg = tables[0].shape.mesh.vertices[8:16]
    front = (sources.part == 1) & (np.abs(tables[0].points[:, 2] - leg[:, 2].min()) < 1e-6)
    assert front.sum() > 20 and (normals[front, 2] < -0.99).mean() > 0.95


def test_the_cloud_is_denser_and_stays_on_the_surface(tables, sources) -> None:
    draw = tables[0].points
    plain, dense = (Orientations(sources).cloud(draw, BOTH, refinements=n) for n in (0, 1))
    assert len(plain.points) == len(draw) and len(dense.points) > 2 * len(draw)
    away = closest_points(tables[0].shape.mesh, dense.points)[2]
    assert np.quantile(away, 0.99) < 2e-3
    assert np.allclose(np.linalg.norm(dense.normals, axis=1), 1)


def test_a_table_from_scratch_is_closed_and_like_the_draw(tables, sources, cell) -> None:
    halfway = (tables[0].points + tables[1].points) / 2
    made = synthesize_surface(halfway, BOTH, Orientations(sources), cell=cell)
    assert made.measures["open_edges"] == 0 and made.sources == ("", "")
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
    made = synthesize_surface(tables[0].points, np.array([True, False]), Orientations(sources), cell=cell)
    assert set(made.part.tolist()) == {0} and made.measures["open_edges"] == 0
    assert np.ptp(made.vertices[:, 1]) < 0.2


def test_the_same_draw_gives_the_same_bytes(tables, sources, cell) -> None:
    made = [synthesize_surface(tables[2].points, BOTH, Orientations(sources), cell=cell) for _ in range(2)]
    assert made[0].vertices.tobytes() == made[1].vertices.tobytes()


@pytest.mark.parametrize(
    ("rows", "parts", "message"), [(3, BOTH, "same fit"), (None, np.array([False, False]), "no|none")]
)
def test_other_draws_are_refused(tables, sources, rows, parts, message) -> None:
    with pytest.raises(ValueError, match=message):
        synthesize_surface(tables[0].points[:rows], parts, Orientations(sources))
