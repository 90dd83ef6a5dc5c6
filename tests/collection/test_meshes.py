"""Readers and writers of meshes: every record keeps its number, every bad file is a MeshError."""

from __future__ import annotations

import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from shapeforge.collection.meshes import (
    MeshError,
    find_meshes,
    read_mesh,
    repair_notes,
    too_little,
    triangulate_records,
    write_mesh,
)

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def written(tmp_path: Path, name: str, content: str | bytes) -> Path:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# ---- OBJ


def test_obj_keeps_the_order_of_mixed_polygons_groups_and_materials(tmp_path):
    text = (
        "mtllib a.mtl\no thing\n" + SQUARE + "v 0.5 2 0\nvn 0 0 1\nvt 0 0\n"
        "usemtl red\nf 1/1/1 2/1/1 3/1/1 4/1/1\ng roof\ns 1\nusemtl blue\nf 4//1 3//1 5//1\nl 1 2\np 1\n"
        "usemtl red\nf 1 2 3\n"
    )
    mesh = read_mesh(written(tmp_path, "a.obj", text))
    assert mesh.n_faces == 3
    assert mesh.face_of_triangle.tolist() == [0, 0, 1, 2]
    np.testing.assert_allclose(mesh.face_areas, [1.0, 0.5, 0.5])


def test_obj_negative_numbers_count_back_from_the_line(tmp_path):
    text = "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nf -4/-1 -3/-1 -2/-1\n"
    mesh = read_mesh(written(tmp_path, "a.obj", text))
    assert mesh.triangles.tolist() == [[1, 2, 3], [1, 2, 3]]


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_obj_line_ends_continuations_blanks_and_comments(tmp_path, line_end):
    text = "\ufeff# a comment\n\n  v 0 0 0 # origin\nv\t1e0 0. .0\nv 1 \\\n 1 0 0.5 0.5 0.5\nf 1 2 \\\n  3\n\n"
    mesh = read_mesh(written(tmp_path, "a.obj", text.replace("\n", line_end)))
    assert mesh.triangles.tolist() == [[0, 1, 2]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


def test_degenerate_records_keep_their_number(tmp_path):
    text = SQUARE + "f 1\nf 1 2\nf 1 1 2\nf 1 2 3\nf 1 2 2 3\n"
    mesh = read_mesh(written(tmp_path, "a.obj", text))
    assert mesh.n_faces == 5
    assert set(mesh.face_of_triangle) == {3, 4}
    np.testing.assert_allclose(mesh.face_areas, [0, 0, 0, 0.5, 0.5])
    assert repair_notes(mesh)[0] == "3 faces without area, ignored"


def test_a_clean_mesh_has_no_notes_and_a_repeated_triangle_is_noted(tmp_path):
    assert repair_notes(read_mesh(written(tmp_path, "a.obj", SQUARE + "f 1 2 3 4\n"))) == ()
    twice = read_mesh(written(tmp_path, "b.obj", SQUARE + "f 1 2 3\nf 3 2 1\n"))
    assert repair_notes(twice) == ("1 triangle drawn twice, counted twice",)


def test_too_few_triangles_or_a_flat_mesh_are_no_whole_shape(tmp_path):
    above, fan = "v 0.5 0.5 1\n", "f 1 2 5\nf 2 3 5\nf 3 4 5\n"
    said = {
        SQUARE + "f 1 2 3\n": "it has only 1 triangle, too few for a shape",
        SQUARE + above + fan + "f 1 1 2\n": "it has only 3 triangles, too few for a shape",
        SQUARE + "v 0.5 0.5 0\n" + fan + "f 4 1 5\n": "all of its faces lie in one plane",
        SQUARE + above + fan + "f 4 1 5\n": "",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 .001\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 3 1 4\n": "",
    }
    for text, words in said.items():
        assert too_little(read_mesh(written(tmp_path, "a.obj", text))) == words


@given(
    st.lists(
        st.one_of(
            st.floats(-1e40, 1e40).filter(lambda x: x == 0 or abs(x) > 1e-40),
            st.floats(-1e4, 1e4).map(lambda x: round(x, 6)),
            st.integers(-(10**15), 10**15),
        ),
        min_size=9,
        max_size=9,
    ),
    st.sampled_from(["{!r}", "{:.6f}", "{:.17e}", "{:+.9g}"]),
)
def test_coordinates_are_the_nearest_binary_number(tmp_path_factory, numbers, form):
    words = [form.format(float(x)) for x in numbers]
    rows = "".join(f"v {' '.join(words[i : i + 3])}\n" for i in (0, 3, 6))
    path = tmp_path_factory.mktemp("obj") / "a.obj"
    path.write_text(rows + "v 0 0 0\nv 1e41 0 0\nv 0 1e41 0\nf 4 5 6\n")
    assert read_mesh(path).vertices[:3].reshape(-1).tolist() == [float(w) for w in words]


@pytest.mark.parametrize("coding", ["utf-8-sig", "utf-16", "latin-1"])
def test_obj_in_other_encodings(tmp_path, coding):
    mesh = read_mesh(written(tmp_path, "a.obj", ("o stühl\n" + SQUARE + "v 10.25 0 0\nf 1 2 3 4\n").encode(coding)))
    assert mesh.vertices[4].tolist() == [10.25, 0, 0]


# ---- polygons


def polygon_area(corners: np.ndarray) -> float:
    a, b = corners, np.roll(corners, -1, axis=0)
    return float(np.linalg.norm(np.cross(a, b).sum(axis=0)) / 2)


@given(st.integers(4, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_star_shaped_polygons_are_cut_exactly_however_they_lie(n, seed):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, n)) * 0.5 + np.arange(n) / n * np.pi
    assume(np.diff(angle, append=angle[0] + 2 * np.pi).max() < np.pi)  # else it is no star about the origin
    radius = rng.uniform(0.2, 1.0, n)
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)], axis=1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vertices = flat @ turn.T + rng.normal(size=3)
    triangles, record = triangulate_records(vertices, np.arange(n), np.array([n]))
    assert len(triangles) == n - 2 and set(record) == {0}
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # signed areas all of one sign that sum up to the polygon's: no overlap, no gap, no flip
    facing = cross @ (turn[:, 2])
    assert (facing > -1e-12).all() or (facing < 1e-12).all()
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(polygon_area(flat), rel=1e-9)


def test_a_spiral_with_flat_corners_is_cut_exactly():
    flat = [(0, 0), (5, 0), (5, 4), (1, 4), (1, 2), (3, 2), (3, 3), (4, 3), (4, 1), (2, 1), (1, 1), (0, 1)]
    vertices = np.array([(x, 0.0, y) for x, y in flat])
    triangles, _ = triangulate_records(vertices, np.arange(len(flat)), np.array([len(flat)]))
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(polygon_area(vertices))


def test_polygons_that_cross_themselves_still_give_all_their_triangles():
    bow = np.array([[0.0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0], [0.5, 2, 0]])
    triangles, _ = triangulate_records(bow, np.arange(5), np.array([5]))
    assert len(triangles) == 3


# ---- OFF


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n",
        "OFF 4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n",
        "OFF4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n",
        "# c\n\nCOFF # header\n# counts\n4 2\n0 0 0 255 0 0 255\n1 0 0 1 1 1 1\n\n1 1 0 0 0 0 0\n0 1 0 9 9 9 9\n"
        "4 0 1 2 3 255 0 0\n3 0 1 2 # the last\n",
        "NOFF\r\n4 2 0\r\n0 0 0 0 0 1\r\n1 0 0 0 0 1\r\n1 1 0 0 0 1\r\n0 1 0 0 0 1\r\n4 0 1 2 3\r\n3 0 1 2\r\n",
        "4OFF\n4 2 0\n0 0 0 1\n1 0 0 1\n1 1 0 1\n0 1 0 1\n4 0 1 2 3\n3 0 1 2\n",
        "4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n",
        "OFF\n4 2 0\n0 0 0 1 0 0\n1 1 0 0 1 0 4 0 1 2 3\n3 0 1 2\n",
        "OFF\n4\n2\n0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n",
    ],
)
def test_off_in_all_its_dresses(tmp_path, text):
    mesh = read_mesh(written(tmp_path, "a.off", text))
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert mesh.n_faces == 2
    assert mesh.face_of_triangle.tolist() == [0, 0, 1]


# ---- PLY


def ply_text(vertex_rows: list[str], extra_first: bool = False) -> str:
    camera = "element camera 2\nproperty float view\nproperty list uchar int pixels\n"
    header = "ply\nformat ascii 1.0\ncomment made by hand\n" + (camera if extra_first else "")
    header += "element vertex 4\nproperty uchar red\nproperty float z\nproperty float x\nproperty double y\n"
    header += "element face 2\nproperty int quality\nproperty list uchar int vertex_indices\n"
    header += "property list uint8 float uv\n"
    cameras = "0.5 3 7 8 9\n0.25 0\n" if extra_first else ""
    return header + "end_header\n" + cameras + "\n".join(vertex_rows) + "\n7 4 0 1 2 3 2 .5 .5\n8 3 0 1 2 0\n"


@pytest.mark.parametrize("extra_first", [False, True])
def test_ascii_ply_with_any_order_of_properties_and_other_elements(tmp_path, extra_first):
    text = ply_text(["255 0 0 0", "255 0 1 0", "1 0 1 1", "2 0 0 1"], extra_first)
    mesh = read_mesh(written(tmp_path, "a.ply", text))
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert mesh.n_faces == 2 and mesh.face_of_triangle.tolist() == [0, 0, 1]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("index", ["i", "I", "H", "h", "b", "f"])
@pytest.mark.parametrize("length", ["B", "H", "i"])
def test_binary_ply_of_both_byte_orders_and_all_index_types(tmp_path, order, index, length):
    names = {"i": "int", "I": "uint32", "H": "ushort", "h": "int16", "b": "char", "B": "uchar", "f": "float"}
    header = f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement vertex 4\n"
    header += "property uchar red\nproperty double x\nproperty float y\nproperty float z\n"
    header += f"element face 2\nproperty list {names[length]} {names[index]} vertex_index\nproperty uchar flag\n"
    header += "element edge 1\nproperty int a\nend_header\n"
    body = b"".join(struct.pack(order + "Bdff", 9, x, y, 0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    body += struct.pack(f"{order}{length}4{index}B", 4, 0, 1, 2, 3, 1)
    body += struct.pack(f"{order}{length}3{index}B", 3, 0, 1, 2, 1)
    mesh = read_mesh(written(tmp_path, "a.ply", header.encode() + body + struct.pack(order + "i", 5)))
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert mesh.face_of_triangle.tolist() == [0, 0, 1]
    np.testing.assert_allclose(mesh.face_areas, [1.0, 0.5])


# ---- what cannot be used

BAD = {
    "empty.obj": ("", "empty"),
    "blank.obj": (" \n\n", "empty"),
    "prose.obj": ("Dear reader,\nthis is a letter.\n", "no OBJ text"),
    "page.obj": ("<!DOCTYPE html><html><body>404</body></html>", "no OBJ text"),
    "cloud.obj": (SQUARE, "no faces"),
    "no_vertices.obj": ("f 1 2 3\n", "no vertices"),
    "wide.obj": ((SQUARE + "f 1 2 3\n").encode("utf-16-le"), "no text"),
    "picture.obj": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "no text"),
    "high.obj": (SQUARE + "f 1 2 3\nf 1 2 9\n", "face 2 uses a vertex that does not exist"),
    "zero.obj": (SQUARE + "f 0 1 2\n", "line 5"),
    "below.obj": ("v 0 0 0\nf -1 -2 -3\n", "line 2"),
    "word.obj": (SQUARE + "f one two three\n", "line 5"),
    "comma.obj": ("v 0,5 1,5 2\n" + SQUARE + "f 1 2 3\n", "'0,5'"),
    "short.obj": ("v 0 0 0\nv 1 0\n", "line 2"),
    "cut_face.obj": (SQUARE + "f 1 2 3\nf 3 4", "line 6: a face with fewer than 3 corners"),
    "cut_corner.obj": (SQUARE + "f 1 2 3\nf 3/", "line 6: a face with fewer than 3 corners"),
    "cut_letter.obj": (SQUARE + "f 1 2 3\nf", "line 6: a face with fewer than 3 corners"),
    "nan.obj": (SQUARE + "v nan 0 0\nf 1 2 5\n", "vertex 5"),
    "inf.obj": (SQUARE + "v 0 1e999 0\nf 1 2 5\n", "vertex 5"),
    "windows_nan.obj": (SQUARE + "v -1.#IND 0 0\nf 1 2 5\n", "line 5"),
    "point.obj": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "shrink"),
    "line.obj": ("v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n", "no area"),
    "only_edges.obj": (SQUARE + "f 1 2\n", "shrink"),
    "huge.obj": ("v 0 0 0\nv 1e200 0 0\nv 0 1e200 0\nf 1 2 3\n", "size"),
    "tiny.obj": ("v 0 0 0\nv 1e-200 0 0\nv 0 1e-200 0\nf 1 2 3\n", "size"),
    "far.obj": ("v 1e12 0 0\nv 1000000000001 0 0\nv 1e12 1 0\nf 1 2 3\n", "far from the origin"),
    "not.off": ("solid thing\n", "OFF"),
    "binary.off": ("OFF BINARY\n\0\0", "binary OFF"),
    "counts.off": ("OFF\n", "missing"),
    "short.off": ("OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n", "announces 4 vertices and 2 faces"),
    "vast.off": ("OFF\n2000000000 2000000000 0\n0 0 0\n", "announces 2000000000"),
    "nan_index.off": ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 nan 2\n", "vertex number"),
    "half_index.off": ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1.5 2\n", "1.5"),
    "nan_count.off": ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\nnan 0 1 2\n", "vertex number"),
    "greedy.off": ("OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n7 0 1 2\n", "fewer corners"),
    "not.ply": ("OFF\n", "does not begin with ply"),
    "open.ply": ("ply\nformat ascii 1.0\n", "no end"),
    "odd.ply": ("ply\nformat ascii 1.0\nelement vertex\nend_header\n", "'element vertex'"),
    "zip.ply": ("ply\nformat zip 1.0\nend_header\n", "'zip'"),
    "type.ply": ("ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\nend_header\n", "property real x"),
    "cut.ply": (ply_text(["0 0 0 0"]), "announces 2 rows of face"),
    "vast.ply": (
        "ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\nend_header\n",
        "announces 2000000000",
    ),
    "thing.blend": ("x", "not read"),
    "nothing": ("x", "not read"),
    "bad.stl": ("this is no stl", "no faces"),
    "bad.glb": (b"glTF\x02\0\0\0", "glb"),
    "bad.gltf": ("{}", "no faces"),
}


@pytest.mark.parametrize("name", BAD)
def test_unusable_files_say_which_what_and_what_to_do(tmp_path, name):
    content, problem = BAD[name]
    path = written(tmp_path, name, content)
    with pytest.raises(MeshError) as caught:
        read_mesh(path)
    error = caught.value
    assert problem in error.problem
    assert str(error) == f"{name}: {error.problem}. {error.remedy}" and error.remedy and error.path == path
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) and again.path == path


def test_absent_files_and_folders_are_mesh_errors(tmp_path):
    with pytest.raises(MeshError, match=r"none.obj: there is no such file"):
        read_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(MeshError, match="cannot be opened"):
        read_mesh(tmp_path / "folder.obj")


def sound_files() -> list[tuple[str, bytes]]:
    text = SQUARE + "v .5 .5 1\nf 1 2 3 4\nf 1 2 5\nf 2 3 5\n"
    ball = trimesh.creation.icosphere(1)
    ascii_ply = ply_text(["255 0 0 0", "255 0 1 0", "1 0 1 1", "2 0 0 1"], True)
    off = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n"
    return [
        (".obj", text.encode()),
        (".off", off.encode()),
        (".ply", ascii_ply.encode()),
        (".ply", ball.export(file_type="ply")),
        (".stl", ball.export(file_type="stl")),
        (".glb", ball.export(file_type="glb")),
    ]


@given(st.sampled_from(sound_files()), st.data())
@settings(max_examples=400, deadline=None)
def test_damaged_files_are_read_or_refused_never_worse(tmp_path_factory, sound, data):
    ending, content = sound
    damaged = bytearray(content[: data.draw(st.integers(0, len(content)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / f"damaged{ending}"
    path.write_bytes(bytes(damaged))
    try:
        mesh = read_mesh(path)
    except MeshError:
        return
    assert mesh.triangle_areas.sum() > 0 and np.isfinite(mesh.vertices).all()
    assert mesh.triangles.min() >= 0 and mesh.triangles.max() < len(mesh.vertices)


# ---- STL, GLB, GLTF


def test_stl_keeps_the_order_of_its_triangles_and_joins_equal_corners(tmp_path):
    box = trimesh.creation.box()
    for name, content in (("a.stl", box.export(file_type="stl")), ("b.stl", box.export(file_type="stl_ascii"))):
        mesh = read_mesh(written(tmp_path, name, content))
        assert len(mesh.vertices) == 8 and mesh.n_faces == 12
        np.testing.assert_allclose(mesh.vertices[mesh.triangles], box.triangles, atol=1e-6)


@pytest.mark.parametrize("ending", ["stl", "glb"])
def test_a_file_is_read_once(tmp_path, monkeypatch, ending):
    path = written(tmp_path, f"a.{ending}", trimesh.creation.box().export(file_type=ending))
    first = Path.read_bytes

    def read_and_gone(self: Path) -> bytes:
        content = first(self)
        self.unlink()
        return content

    monkeypatch.setattr(Path, "read_bytes", read_and_gone)
    assert read_mesh(path).n_faces == 12


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_the_nodes_of_a_scene_stand_where_the_scene_puts_them(tmp_path, ending):
    scene = trimesh.Scene()
    box = trimesh.creation.box()
    scene.add_geometry(box, geom_name="box", node_name="left")
    move = trimesh.transformations.translation_matrix([5, 0, 0])
    move[0, 0] = -2  # mirrored and stretched
    scene.graph.update(frame_to="right", frame_from="left", matrix=move, geometry="box")
    if ending == "glb":
        path = written(tmp_path, "a.glb", scene.export(file_type="glb"))
    else:
        for name, content in scene.export(file_type="gltf").items():
            path = written(tmp_path, name, content)
        path = tmp_path / "model.gltf"
    mesh = read_mesh(path)
    whole = trimesh.load_scene(path, process=False).to_mesh()
    np.testing.assert_allclose(mesh.vertices[mesh.triangles], whole.vertices[whole.faces], atol=1e-6)
    assert mesh.n_faces == 24
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [-0.5, -0.5, -0.5])
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [6, 0.5, 0.5])
    for half in (mesh.triangles[:12], mesh.triangles[12:]):
        assert np.linalg.det(mesh.vertices[half]).sum() > 0  # still wound outward: the signed volume


def test_gltf_that_points_to_the_network_is_refused(tmp_path):
    text = '{"asset": {"version": "2.0"}, "buffers": [{"uri": "http://127.0.0.1:9/x.bin", "byteLength": 4}]}'
    with pytest.raises(MeshError):
        read_mesh(written(tmp_path, "a.gltf", text))


# ---- finding


def test_names_are_stems_and_grow_only_where_they_collide(tmp_path):
    tables = ("tables/a.off", "tables/b.ply", "tables/c.obj", "tables/c.stl")
    for name in ("chairs/a.obj", *tables, "x/.hidden.obj", "x/n.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    found = dict(find_meshes([tmp_path]))
    assert sorted(found) == ["b", "chairs__a", "tables__a", "tables__c.obj", "tables__c.stl"]
    assert found["tables__a"] == tmp_path / "tables/a.off"
    assert dict(find_meshes([tmp_path / "chairs", tmp_path / "tables"])) == found
    assert list(dict(find_meshes([tmp_path / "chairs", tmp_path / "chairs" / "a.obj"]))) == ["a"]
    assert list(dict(find_meshes(sorted(tmp_path.glob("*/a.*"))))) == ["chairs__a", "tables__a"]
    assert list(dict(find_meshes([tmp_path / "x/n.txt"]))) == ["n"]  # named outright: reading it reports it


def test_nothing_to_find_is_a_mesh_error(tmp_path):
    with pytest.raises(MeshError, match="no mesh files in"):
        find_meshes([tmp_path])
    with pytest.raises(MeshError, match="there is no such"):
        find_meshes([tmp_path / "gone"])
    with pytest.raises(MeshError, match="no mesh files"):
        find_meshes([])


# ---- writing


@pytest.fixture
def two_parts():
    box = trimesh.creation.box()
    vertices = np.vstack([box.vertices, box.vertices / 3 + [0, 1, 0]])
    triangles = np.vstack([box.faces, box.faces + 8])[::-1].copy()
    part = np.array([1] * 12 + [0] * 12)
    part[5] = -1
    return vertices, triangles, part, ("seat of it", "leg"), np.array([[255, 0, 0], [0, 128, 255]], np.uint8)


@pytest.mark.parametrize("ending", ["ply", "obj", "stl", "glb"])
def test_what_is_written_is_read_back(tmp_path, two_parts, ending):
    vertices, triangles, part, names, colours = two_parts
    path = tmp_path / f"a.{ending}"
    write_mesh(path, vertices, triangles, part, names, colours)
    mesh = read_mesh(path)
    order = np.concatenate([np.flatnonzero(part == p) for p in (1, 0, -1)]) if ending == "glb" else np.arange(24)
    tolerance = 0 if ending in ("ply", "obj") else 1e-6
    np.testing.assert_allclose(mesh.vertices[mesh.triangles], vertices[triangles][order], atol=tolerance, rtol=0)
    assert {p.name for p in tmp_path.iterdir()} == {f"a.{ending}"} | ({"a.mtl"} if ending == "obj" else set())


def test_parts_and_colours_are_in_the_files(tmp_path, two_parts):
    vertices, triangles, part, names, colours = two_parts
    for ending in ("ply", "obj", "glb"):
        write_mesh(tmp_path / f"a.{ending}", *two_parts)
    scene = trimesh.load_scene(tmp_path / "a.glb")
    assert set(scene.graph.nodes_geometry) == {"seat of it", "leg", "unlabelled"}
    assert scene.geometry["leg"].visual.material.baseColorFactor.tolist() == [0, 128, 255, 255]
    ply = trimesh.load(tmp_path / "a.ply", process=False)
    data = ply.metadata["_ply_raw"]["face"]["data"]
    assert data["part"].reshape(-1).tolist() == part.tolist()
    assert data["red"].reshape(-1).tolist() == [255 if p == 0 else 160 if p < 0 else 0 for p in part]
    lines = (tmp_path / "a.obj").read_text().splitlines()
    assert [line for line in lines if line.startswith("g ")] == ["g leg", "g unlabelled", "g leg", "g seat_of_it"]
    assert "newmtl leg\nKd 0.0000 0.5020 1.0000" in (tmp_path / "a.mtl").read_text()


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, two_parts):
    vertices, triangles, part, names, colours = two_parts
    path = tmp_path / "a.ply"
    path.write_text("old")
    with pytest.raises(ValueError, match="part: wanted -1..1, got -1..7"):
        write_mesh(path, vertices, triangles, np.where(part == 1, 7, part), names, colours)
    with pytest.raises(ValueError, match="ending"):
        write_mesh(tmp_path / "a.step", *two_parts)
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


# ---- real files


def test_every_real_file_is_read_record_by_record(real_shapes):
    files = sorted(real_shapes.rglob("*.obj"))[::12]
    assert files
    for file in files:
        records = [line.split()[1:] for line in file.read_text(errors="replace").splitlines() if line[:2] == "f "]
        mesh = read_mesh(file)
        assert mesh.n_faces == len(records)
        k = len(records) // 2
        corners = {int(word.split("/")[0]) - 1 for word in records[k]}
        assert set(mesh.triangles[mesh.face_of_triangle == k].reshape(-1).tolist()) <= corners
