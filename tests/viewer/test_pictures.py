"""Small pictures: what is on them, and the cache in the project's folder."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from shapeforge.collection.shape import Mesh
from shapeforge.viewer.palette import part_colours, rgb, tokens
from shapeforge.viewer.pictures import close_studio, contact_sheet, point_thumbnail, shape_picture, thumbnail


@pytest.fixture(scope="module", autouse=True)
def _closed():
    yield
    close_studio()


def box() -> Mesh:
    vertices = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.3, 0.3)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    return Mesh(vertices, triangles, np.repeat(np.arange(6), 2), 6)


class Shelf:
    """A project with one shape, that counts how often its mesh is read."""

    def __init__(self, path: Path) -> None:
        self.path, self.names, self.read = path, ("box",), 0

    @property
    def shapes(self) -> list:
        self.read += 1
        return [type("S", (), {"mesh": box()})]


def test_the_shape_is_in_the_middle_and_the_ground_around_it():
    picture = thumbnail(box(), np.array([230, 20, 20], np.uint8), 80)
    assert picture.shape == (80, 80, 3) and picture.dtype == np.uint8
    assert picture[0, 0].tolist() == list(rgb(tokens("dark")["view"]))
    r, g, b = picture[40, 40].astype(int)
    assert r > 80 and r > 3 * max(g, b)
    light = thumbnail(box(), None, (90, 60), "light")
    assert light.shape == (60, 90, 3) and light[0, 0].min() > 200


def test_faces_have_their_own_colours():
    colours = np.zeros((6, 3), np.uint8)
    colours[3] = (0, 255, 0)  # the top
    picture = thumbnail(box(), colours, 80).astype(int)
    green = (picture[..., 1] > 100) & (picture[..., 0] < 60)
    rows = np.flatnonzero(green.any(axis=1))
    assert green.sum() > 200 and rows.max() < 45, "the top face is in the upper half"
    with pytest.raises(ValueError, match="one per face record"):
        thumbnail(box(), np.zeros((5, 3), np.uint8), 40)


def test_without_background_only_the_shape_and_its_shadow_are_there():
    picture = thumbnail(box(), np.array([230, 20, 20], np.uint8), 64, transparent=True)
    assert picture.shape == (64, 64, 4)
    assert picture[0, 0, 3] == 0 and picture[32, 32, 3] == 255
    assert picture[32, 32, 0] > 80


def test_points_are_pictured_and_missing_ones_left_out():
    points = np.array([[0.0, 0, 0], [0.2, 0.2, 0.2], [np.nan] * 3])
    picture = point_thumbnail(points, np.tile(np.array([0, 255, 0], np.uint8), (3, 1)), 60, dot=6.0).astype(int)
    assert (picture[..., 1] > 150).sum() > 20


def test_pictures_of_shapes_are_kept_and_told_apart(tmp_path):
    shelf = Shelf(tmp_path)
    first = shape_picture(shelf, "box", 48)
    assert np.array_equal(shape_picture(shelf, "box", 48), first) and shelf.read == 1
    labels = np.zeros(6, np.int32)
    second = shape_picture(shelf, "box", 48, labels=labels, inks=part_colours(2))
    assert shelf.read == 2 and not np.array_equal(first, second)
    hue = second[24, 24].astype(int)
    assert np.argmax(hue) == np.argmax(part_colours(1)[0])
    assert len(list((tmp_path / "thumbs").glob("*.png"))) == 2
    assert shape_picture(shelf, "box", 48, transparent=True).shape == (48, 48, 4)


def test_a_damaged_picture_is_taken_again(tmp_path):
    shelf = Shelf(tmp_path)
    first = shape_picture(shelf, "box", 32)
    for file in (tmp_path / "thumbs").glob("*.png"):
        file.write_bytes(file.read_bytes()[:60])
    assert np.array_equal(shape_picture(shelf, "box", 32), first) and shelf.read == 2


def test_the_same_picture_twice_is_the_same():
    assert np.array_equal(thumbnail(box(), None, 40), thumbnail(box(), None, 40))


def test_other_threads_are_turned_away():
    thumbnail(box(), None, 16)
    raised = []

    def try_it() -> None:
        try:
            thumbnail(box(), None, 16)
        except RuntimeError as error:
            raised.append(str(error))

    thread = threading.Thread(target=try_it)
    thread.start()
    thread.join()
    assert raised and "one thread" in raised[0]


def test_a_sheet_holds_all_pictures_in_order():
    pictures = [np.full((20, 30, 3), 40 * (i + 1), np.uint8) for i in range(5)]
    sheet = contact_sheet(pictures, [f"picture {i} with a long name" for i in range(5)], columns=3, gap=4)
    assert sheet.shape == (4 + 2 * (20 + 18 + 4), 4 + 3 * 34, 3)
    assert sheet[14, 10].tolist() == [40] * 3 and sheet[14, 80].tolist() == [120] * 3
    assert sheet[14 + 42, 44].tolist() == [200] * 3
    with pytest.raises(ValueError, match="at least one picture"):
        contact_sheet([])
    Image.fromarray(sheet)


def test_the_first_picture_waits_for_no_plotting_library():
    """Opening a project and taking a picture load neither matplotlib (by way of PyVista's plots) nor scikit-learn."""
    script = (
        "import sys\n"
        "import shapeforge.store, shapeforge.stages\n"
        "import numpy as np\n"
        "from shapeforge.collection.shape import Mesh\n"
        "from shapeforge.viewer.pictures import close_studio, thumbnail\n"
        "mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), np.zeros(1, int), 1)\n"
        "assert thumbnail(mesh, size=32).std() > 0\n"
        "close_studio()\n"
        "print([name for name in ('matplotlib', 'pyvista', 'sklearn') if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip().splitlines()[-1:] == ["[]"], done.stdout + done.stderr
