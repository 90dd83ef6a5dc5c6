"""The scene draws what a Display says, touches only what changed, and renders once."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista as pv

from shapeforge.viewer.display import Display, LineLayer, MeshLayer, PointLayer, View
from shapeforge.viewer.look import (
    FEATURE_ANGLE,
    angles_of,
    direction_from,
    floor_shadow,
    frame_of,
    place_camera,
    surface,
)
from shapeforge.viewer.picking import Picker, project
from shapeforge.viewer.scene import Scene

CUBE = np.array([[x, y, z] for x in (-0.25, 0.25) for y in (-0.25, 0.25) for z in (-0.25, 0.25)])
CUBE_TRIANGLES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
RED, BLUE = np.tile(np.array([220, 30, 30], np.uint8), (12, 1)), np.tile(np.array([30, 60, 220], np.uint8), (12, 1))


class Renders:
    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> None:
        self.count += 1


@pytest.fixture
def scene():
    plotter = pv.Plotter(off_screen=True, window_size=(200, 160))
    plotter.ren_win.SetMultiSamples(0)
    made = Scene(plotter, Renders(), background=(0, 0, 0))
    yield made
    made.clear()
    plotter.close()


def cube(colours: np.ndarray = RED, vertices: np.ndarray = CUBE, **more) -> MeshLayer:
    return MeshLayer("cube", vertices, CUBE_TRIANGLES, colours, **more)


def one(*layers, **more) -> Display:
    return Display((View(tuple(layers), ground=False, **more),))


def middle(picture: np.ndarray) -> np.ndarray:
    return picture[picture.shape[0] // 2, picture.shape[1] // 2].astype(int)


def test_a_mesh_is_drawn_in_its_colour_and_recoloured_in_place(scene):
    scene.show(one(cube()))
    r, g, b = middle(scene.pixels())
    assert r > 90 and r > 3 * max(g, b)
    points = scene.cells[0].drawn["cube"].data.GetPoints()
    before = points.GetMTime()
    scene.show(one(cube(BLUE)))
    r, g, b = middle(scene.pixels())
    assert b > 90 and b > 3 * r
    assert scene.cells[0].drawn["cube"].data.GetPoints() is points and points.GetMTime() == before
    assert scene.render.count == 2


def test_the_same_display_again_draws_nothing(scene):
    layer = cube()
    assert scene.show(one(layer))
    assert not scene.show(one(layer))
    assert scene.render.count == 1


def test_a_layer_that_is_gone_is_not_drawn(scene):
    scene.show(one(cube()))
    scene.show(one())
    assert middle(scene.pixels()).max() == 0


def test_moved_vertices_move_the_picture(scene):
    place_camera(scene.camera)
    scene.show(one(cube()))
    scene.show(one(cube(vertices=CUBE + np.array([2.0, 0, 0]))))
    assert middle(scene.pixels()).max() == 0


def test_colours_of_vertices_blend(scene):
    colours = np.where(CUBE[:, 1:2] > 0, [255, 0, 0], [0, 0, 255]).astype(np.uint8)
    scene.show(one(cube(colours, smooth_colours=True)))
    seen = scene.pixels().astype(int)
    mixed = (seen[..., 0] > 40) & (seen[..., 2] > 40)
    assert mixed.sum() > 300


def test_points_and_lines_are_drawn(scene):
    grid = np.stack(np.meshgrid(*[np.linspace(-0.2, 0.2, 3)] * 3), axis=-1).reshape(-1, 3)
    green = np.tile(np.array([0, 255, 0], np.uint8), (27, 1))
    line = LineLayer("line", np.array([[[-0.3, 0, 0], [0.3, 0, 0.0]]]), (255, 255, 0), 3)
    scene.show(one(PointLayer("points", grid, green, 9), line))
    seen = scene.pixels().reshape(-1, 3).astype(int)
    assert ((seen[:, 1] > 200) & (seen[:, 0] < 60)).sum() > 200
    assert ((seen[:, 0] > 200) & (seen[:, 1] > 200)).sum() > 60
    scene.show(one(PointLayer("points", grid[:5], green[:5], 9)))
    fewer = scene.pixels().reshape(-1, 3).astype(int)
    assert 0 < (fewer[:, 1] > 200).sum() < (seen[:, 1] > 200).sum()


def test_cells_fill_the_window_side_by_side(scene):
    scene.show(Display((View((cube(),), ground=False), View((cube(BLUE),), ground=False)), 1, 2))
    place_camera(scene.camera, scale=0.6)
    seen = scene.pixels().astype(int)
    left, right = seen[80, 50], seen[80, 150]
    assert left[0] > 3 * left[2] and right[2] > 3 * right[0]
    assert seen[10, 100].tolist() == list(scene.line), "a line of one pixel between them"
    scene.show(one(cube()))
    assert len(scene.cells) == 1


def test_edges_darken_the_borders(scene):
    plain = one(cube())
    scene.show(plain)
    before = scene.pixels().astype(int).sum()
    scene.show(one(cube(edges=True, record=np.repeat(np.arange(6), 2))))
    assert scene.pixels().astype(int).sum() < before
    scene.show(plain)
    assert scene.pixels().astype(int).sum() == before


def test_normals_split_at_creases_only_and_cells_keep_their_number():
    drawn, origin = surface(CUBE, CUBE_TRIANGLES)
    data = pv.wrap(drawn)
    assert data.n_cells == 12 and data.n_points == 24 and np.allclose(data.points, CUBE[origin], atol=1e-6)
    for k in range(12):
        assert sorted(map(tuple, np.round(data.get_cell(k).points, 6))) == sorted(map(tuple, CUBE[CUBE_TRIANGLES[k]]))
    steps = 48
    angle = np.linspace(0, 2 * np.pi, steps, endpoint=False)
    assert 360 / steps < FEATURE_ANGLE
    ring = np.stack([np.cos(angle), np.zeros(steps), np.sin(angle)], axis=1)
    tube = np.vstack([ring, ring + [0, 1, 0]])
    i = np.arange(steps)
    j = (i + 1) % steps
    triangles = np.vstack([np.stack([i, j, j + steps], 1), np.stack([i, j + steps, i + steps], 1)])
    assert surface(tube, triangles)[0].GetNumberOfPoints() == 2 * steps
    soup = tube[triangles].reshape(-1, 3)
    welded, _ = surface(soup, np.arange(len(soup)).reshape(-1, 3))
    assert welded.GetNumberOfPoints() == 2 * steps, "soup is welded for shading"


def test_the_shadow_lies_under_the_shape_and_fades():
    picture, (x0, x1, z0, z1), y = floor_shadow(CUBE, CUBE_TRIANGLES)
    assert y == pytest.approx(-0.25) and x0 < -0.25 and x1 > 0.25 and z0 < -0.25 and z1 > 0.25
    alpha = picture[..., 3]
    size = len(alpha)
    assert alpha[size // 2, size // 2] > 0.3
    assert max(alpha[0].max(), alpha[-1].max(), alpha[:, 0].max(), alpha[:, -1].max()) == 0
    assert np.array_equal(picture, floor_shadow(CUBE, CUBE_TRIANGLES)[0])


def test_the_camera_frames_the_shape(scene):
    scene.show(one(cube()))
    focus, scale = frame_of(CUBE, 200 / 160)
    place_camera(scene.camera, focus, scale)
    places = project(scene.camera, CUBE, (0, 0, 200, 160))
    assert places.min() > 0 and (places < [200, 160]).all()
    assert max(np.ptp(places[:, 0]) / 200, np.ptp(places[:, 1]) / 160) > 0.8


def test_picking_is_the_inverse_of_projecting(scene):
    scene.show(one(cube()))
    place_camera(scene.camera)
    picker, rectangle = Picker(), (0.0, 0.0, 200.0, 160.0)
    target = np.array([[0.1, 0.25, -0.05]])
    place = project(scene.camera, target, rectangle)[0]
    pick = picker.pick(scene.camera, (cube(),), (float(place[0]), float(place[1])), rectangle)
    assert pick is not None and np.allclose(pick.position, target[0], atol=1e-5)
    assert pick.triangle in (6, 7) and np.allclose(pick.normal, [0, 1, 0])
    assert picker.pick(scene.camera, (cube(),), (2.0, 2.0), rectangle) is None


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (33.7, 20.0), (-170.0, -84.0), (90, 45)])
def test_the_angles_of_a_camera_are_those_it_was_placed_by(scene, azimuth, elevation):
    place_camera(scene.camera, (0.1, -0.2, 0.3), 0.7, direction_from(azimuth, elevation))
    assert angles_of(scene.camera) == pytest.approx((azimuth, elevation), abs=1e-6)
