"""Colours of materials: read from OBJ files face by face, written triangle by triangle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shapeforge.collection.materials import PLAIN
from shapeforge.collection.meshes import read_mesh, write_mesh

FACES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\n"
TEXT = FACES + "mtllib some wood.mtl\nf 1 2 3 4\nusemtl oak\nf 1 2 5\nusemtl blue paint\nf 2 3 5\nusemtl oak\nf 3 4 5\n"
LIBRARY = "newmtl oak\nKa 1 1 1\nKd 0.6 0.4 0.2\n\nnewmtl blue paint\n\tKd 0 0 2\nnewmtl odd\nKd spectral x.rfl 1\n"


def colours_of(folder: Path, text: str = TEXT, library: str | None = LIBRARY) -> np.ndarray | None:
    (folder / "chair.obj").write_text(text)
    if library is not None:
        (folder / "some wood.mtl").write_text(library)
    return read_mesh(folder / "chair.obj").colours


def test_each_face_record_has_the_colour_of_its_material(tmp_path: Path) -> None:
    assert colours_of(tmp_path).tolist() == [list(PLAIN), [153, 102, 51], [0, 0, 255], [153, 102, 51]]


def test_a_library_of_the_files_own_name_will_do(tmp_path: Path) -> None:
    (tmp_path / "chair.mtl").write_text(LIBRARY)
    assert colours_of(tmp_path, TEXT.replace("mtllib some wood.mtl\n", ""), None)[1].tolist() == [153, 102, 51]


@pytest.mark.parametrize(
    ("text", "library"),
    [
        (TEXT, None),
        (TEXT, "newmtl other\nKd 1 0 0\n"),
        (FACES + "f 1 2 3\n", LIBRARY),
        (TEXT.replace("oak", "odd").replace("blue paint", "odd"), LIBRARY),
    ],
)
def test_without_colours_there_are_none(tmp_path: Path, text: str, library: str | None) -> None:
    assert colours_of(tmp_path, text, library) is None


def test_libraries_elsewhere_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "some wood.mtl").write_text(LIBRARY)
    assert colours_of(tmp_path / "in", TEXT.replace("some wood", "../some wood"), None) is None


def test_colours_stay_when_the_mesh_is_moved(tmp_path: Path) -> None:
    colours_of(tmp_path)
    mesh = read_mesh(tmp_path / "chair.obj")
    assert np.array_equal(mesh.moved(2 * mesh.vertices).colours, mesh.colours)


@pytest.mark.parametrize("ending", ["obj", "ply", "glb"])
def test_colours_of_triangles_are_written(tmp_path: Path, ending: str) -> None:
    import trimesh

    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.0]])
    triangles, part = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]], np.int32), np.array([0, 0, 1])
    colours = np.array([[255, 0, 0], [0, 255, 0], [255, 0, 0]], np.uint8)
    path = tmp_path / f"x.{ending}"
    write_mesh(path, vertices, triangles, part, ("seat", "leg"), np.zeros((2, 3), np.uint8), colours)
    if ending == "obj":
        assert read_mesh(path).colours.tolist() == colours.tolist()
        assert path.read_text().count("g seat") == 2
    elif ending == "ply":
        record = np.dtype([("n", "u1"), ("corners", "<i4", 3), ("rgb", "u1", 3), ("part", "<i4")])
        faces = np.frombuffer(path.read_bytes()[-3 * record.itemsize :], record)
        assert np.array_equal(faces["rgb"], colours) and np.array_equal(faces["corners"], triangles)
    else:
        scene = trimesh.load_scene(path)
        shades = {name: g.visual.material.baseColorFactor[:3].tolist() for name, g in scene.geometry.items()}
        assert shades == {"seat": [0, 255, 0], "seat 2": [255, 0, 0], "leg": [255, 0, 0]}
    with pytest.raises(ValueError, match="triangle_colours"):
        write_mesh(path, vertices, triangles, part, ("seat", "leg"), np.zeros((2, 3), np.uint8), colours[:2])
