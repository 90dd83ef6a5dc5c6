"""Colours of faces: read from the materials, textures, faces and vertices of files, written triangle by triangle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

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


# ---- other files: made by trimesh, read by us -----------------------------------------------------------------------

RANDOM = np.random.default_rng(0).integers(0, 256, (12, 3)).astype(np.uint8)


def box() -> trimesh.Trimesh:
    return trimesh.creation.box()


def read_back(mesh: trimesh.Trimesh, path: Path, **options: object) -> np.ndarray | None:
    """The colours that are read from a file that trimesh wrote."""
    path.write_bytes(trimesh.exchange.export.export_mesh(mesh, path, path.suffix[1:], **options) and path.read_bytes())
    return read_mesh(path).colours


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_faces_of_ply_keep_their_colours(tmp_path: Path, encoding: str) -> None:
    mesh = box()
    mesh.visual.face_colors = np.column_stack([RANDOM, np.full(12, 255)])
    assert np.array_equal(read_back(mesh, tmp_path / "x.ply", encoding=encoding), RANDOM)


@pytest.mark.parametrize("ending", ["ply", "glb", "obj", "off"])
def test_faces_between_coloured_vertices_have_their_mean(tmp_path: Path, ending: str) -> None:
    mesh = box()
    mesh.visual.vertex_colors = np.column_stack([RANDOM[:8], np.full(8, 255)])
    wanted = RANDOM[mesh.faces].astype(float).mean(axis=1)
    if ending == "off":
        rows = [f"{x} {y} {z} {r} {g} {b} 255" for (x, y, z), (r, g, b) in zip(mesh.vertices, RANDOM, strict=False)]
        rows += [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
        (tmp_path / "x.off").write_text("\n".join(["COFF", "8 12 0", *rows]))
        colours = read_mesh(tmp_path / "x.off").colours
    else:
        colours = read_back(mesh, tmp_path / f"x.{ending}")
    assert np.abs(colours - wanted).max() <= 1


def test_faces_of_off_may_have_colours_of_either_kind(tmp_path: Path) -> None:
    mesh = box()
    for scale, text in ((1, "{} {} {}"), (255, "{:.4f} {:.4f} {:.4f}")):
        rows = ["OFF", "8 12 0", *(" ".join(map(str, v)) for v in mesh.vertices)]
        rows += [f"3 {a} {b} {c} " + text.format(*(RANDOM[i] / scale if scale > 1 else RANDOM[i]))
                 for i, (a, b, c) in enumerate(mesh.faces)]  # fmt: skip
        (tmp_path / "x.off").write_text("\n".join(rows))
        assert np.array_equal(read_mesh(tmp_path / "x.off").colours, RANDOM)
    pure = [row if i < 10 else f"{' '.join(row.split()[:4])} 1 0 0" for i, row in enumerate(rows)]
    (tmp_path / "x.off").write_text("\n".join(pure))
    assert (read_mesh(tmp_path / "x.off").colours == (255, 0, 0)).all(), "whole numbers up to 1 are shares, too"
    (tmp_path / "x.off").write_text("\n".join(row.rpartition(" ")[0] if i > 9 else row for i, row in enumerate(rows)))
    assert read_mesh(tmp_path / "x.off").colours is None, "two numbers are no colour"


def halves() -> Image.Image:
    """A picture, red at the left and blue at the right."""
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:, :4, 0], picture[:, 4:, 2] = 255, 255
    return Image.fromarray(picture)


def test_each_node_of_a_glb_has_its_material_or_texture(tmp_path: Path) -> None:
    plain, printed, dark, bare = nodes = box(), box(), box(), box()
    for place, one in enumerate(nodes):
        one.apply_translation([2.0 * place, 0, 0])
    plain.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[10, 20, 30, 255]))
    uv = np.where(np.arange(8)[:, None] < 4, 0.2, 0.8) * np.ones((8, 2))
    printed.visual = TextureVisuals(uv=uv, material=PBRMaterial(baseColorTexture=halves()))
    dark.visual = TextureVisuals(
        uv=uv, material=PBRMaterial(baseColorTexture=halves(), baseColorFactor=[128, 128, 128, 255])
    )
    scene = trimesh.Scene({"a": plain, "b": printed, "c": dark, "d": bare})
    (tmp_path / "x.glb").write_bytes(trimesh.exchange.gltf.export_glb(scene))
    mesh = read_mesh(tmp_path / "x.glb")
    order = np.argsort(mesh.face_centres.reshape(4, 12, 3)[:, :, 0].mean(axis=1))  # as the nodes stand side by side
    blocks = mesh.colours.reshape(4, 12, 3)[order]
    assert (blocks[0] == (10, 20, 30)).all() and (blocks[3] == PLAIN).all()
    left = np.array([(printed.faces[i] < 4).all() for i in range(12)])
    right = np.array([(printed.faces[i] >= 4).all() for i in range(12)])
    assert left.any() and right.any()
    assert (blocks[1][left] == (255, 0, 0)).all() and (blocks[1][right] == (0, 0, 255)).all()
    assert (blocks[2][left] == (128, 0, 0)).all() and (blocks[2][right] == (0, 0, 128)).all()


def test_a_glb_whose_texture_is_damaged_is_read_without(tmp_path: Path) -> None:
    mesh = box()
    mesh.visual = TextureVisuals(uv=np.zeros((8, 2)), material=PBRMaterial(baseColorTexture=halves()))
    data = trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh))
    (tmp_path / "x.glb").write_bytes(data.replace(b"PNG", b"XXX").replace(b"IHDR", b"XXXX"))
    assert read_mesh(tmp_path / "x.glb").n_faces == 12


def test_a_glb_whose_texture_breaks_off_keeps_its_base_colour(tmp_path: Path) -> None:
    """The header of the picture is sound, so that the damage is met only when it is looked at."""
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8))
    for factor, wanted in (([10, 20, 30, 255], (10, 20, 30)), (None, None)):
        mesh, material = box(), PBRMaterial(baseColorTexture=noise, baseColorFactor=factor)
        mesh.visual = TextureVisuals(uv=np.zeros((8, 2)), material=material)
        data = trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh))
        middle = data.index(b"IDAT") + 500
        (tmp_path / "x.glb").write_bytes(data[:middle] + bytes(2000) + data[middle + 2000 :])
        colours = read_mesh(tmp_path / "x.glb").colours
        assert colours is None if wanted is None else (colours == wanted).all()


@pytest.mark.parametrize("words", ["", " ", " -clamp on", " ..", " /", " a\0b.png", f" {'x' * 400}.png"])
def test_a_texture_that_names_no_file_is_no_reason_to_refuse_the_mesh(tmp_path: Path, words: str) -> None:
    """Material libraries are often cut short by exporters; the material's own colour counts then."""
    read = colours_of(tmp_path, library=f"newmtl oak\nmap_Kd{words}\nKd 1 0 0\n")
    assert read[1].tolist() == [255, 0, 0]


def test_an_obj_material_with_a_texture_has_its_mean_colour(tmp_path: Path) -> None:
    halves().save(tmp_path / "print 1.png")
    library = "newmtl oak\nKd 0.5 0.5 0.5\nmap_Kd -clamp on {}\nnewmtl blue paint\nKd 0 0 1\n"
    for name, wanted in (("textures\\print.png", [64, 0, 64]), ("gone.png", [128, 128, 128])):
        halves().save(tmp_path / "print.png")
        assert colours_of(tmp_path, library=library.format(name))[1].tolist() == wanted
    (tmp_path / "print.png").write_bytes(b"no picture")
    assert colours_of(tmp_path, library=library.format("print.png"))[1].tolist() == [128, 128, 128]


@pytest.mark.parametrize("ending", ["glb", "ply", "obj"])
def test_parts_of_very_many_colours_are_written_in_few_nodes(tmp_path: Path, ending: str) -> None:
    mesh = trimesh.creation.icosphere(3)
    shades = np.random.default_rng(1).integers(0, 256, (len(mesh.faces), 3)).astype(np.uint8)
    part = (mesh.triangles_center[:, 0] > 0).astype(int)
    shades[part == 1] = (10, 20, 30)
    path = tmp_path / f"x.{ending}"
    write_mesh(path, mesh.vertices, mesh.faces.astype(np.int32), part, ("a", "b"), np.zeros((2, 3), np.uint8), shades)
    read = read_mesh(path)
    order = np.lexsort(np.round(read.face_centres, 5).T)
    wanted = shades[np.lexsort(np.round(mesh.triangles_center, 5).T)].astype(int)
    away = np.abs(read.colours[order] - wanted).max(axis=1)
    if ending == "obj":
        assert len(np.unique(read.colours, axis=0)) <= 65 and away.mean() < 40
    else:
        assert away.max() == 0
    if ending == "glb":
        assert sorted(trimesh.load_scene(path).geometry) == ["a", "b"]


def test_colours_of_a_file_reach_the_project_and_its_parts(tmp_path: Path) -> None:
    """Imported from GLB with a material a node: the stored shape has them, whatever became of the file."""
    from shapeforge.collection.iterate import last
    from shapeforge.stages import run
    from shapeforge.store import Project

    scene = trimesh.Scene()
    for name, height, shade in (("seat", 0.0, [200, 0, 0, 255]), ("back", 1.0, [0, 0, 200, 255])):
        one = box()
        one.apply_translation([0, height, 0])
        one.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=shade))
        scene.add_geometry(one, node_name=name)
    (tmp_path / "x.glb").write_bytes(trimesh.exchange.gltf.export_glb(scene))
    project = Project.create(tmp_path / "project")
    last(run(project, "import", meshes=[tmp_path / "x.glb"], points=100, up="keep", jobs=1))
    mesh = Project.open(tmp_path / "project").shapes.named("x").mesh
    high, low = mesh.face_centres[:, 1] > 0.01, mesh.face_centres[:, 1] < -0.01
    assert (mesh.colours[high] == (0, 0, 200)).all() and (mesh.colours[low] == (200, 0, 0)).all()
