"""Whatever a user hands in: it is named, the reason and the remedy are said on one line, and the rest goes on."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from shapeforge.cli import run_command
from shapeforge.store import Project

CUBE = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1 2 3 4
f 5 6 7 8
f 1 2 6 5
f 3 4 8 7
f 2 3 7 6
f 1 4 8 5
"""
BAD_MESHES: dict[str, bytes] = {
    "empty.obj": b"",
    "prose.obj": b"Dear all,\nplease find the chair attached.\n",
    "junk.obj": bytes(range(256)) * 40,
    "points.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n",
    "beyond.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "notanumber.obj": b"v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n",
    "infinite.obj": b"v 0 0 0\nv 1 inf 0\nv 0 1 0\nf 1 2 3\n",
    "flat.obj": b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
    "onepoint.obj": b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n",
    "enormous.obj": b"v 0 0 0\nv 1e300 0 0\nv 0 1e300 0\nf 1 2 3\n",
    "short.off": b"OFF\n8 6 0\n0 0 0\n1 0 0\n",
    "header.off": b"COFF?\n",
    "header.ply": b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n",
    "short.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 900\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\x00\x01",
    "greedy.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 4000000000\nproperty list uchar int vertex_indices\nend_header\n" + b"\0" * 36,
    "short.stl": b"\0" * 80 + struct.pack("<I", 1000) + b"\0" * 50,
    "junk.glb": b"glTF\x02\0\0\0" + b"\xff" * 40,
    "junk.gltf": b"{",
    "elsewhere.gltf": json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": "../../etc/passwd"}]}).encode(),
    "scan.xyz": b"0 0 0\n",
}


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of one command."""
    status = run_command([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    return status, out, err


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    folder = tmp_path / "good"
    folder.mkdir()
    (folder / "cube.obj").write_text(CUBE)
    return folder / "cube.obj"


@pytest.fixture
def project(tmp_path: Path, cube: Path, capsys: pytest.CaptureFixture[str]) -> Project:
    status, _, err = run(capsys, "import", tmp_path / "p", cube, "--points", 200)
    assert status == 0, err
    return Project.open(tmp_path / "p")


def test_bad_files_are_named_and_the_good_one_goes_on(
    tmp_path: Path, cube: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "bad"
    folder.mkdir()
    for name, content in BAD_MESHES.items():
        (folder / name).write_bytes(content)
    files = [folder / name for name in BAD_MESHES]
    status, out, err = run(capsys, "import", tmp_path / "p", cube, *files, "--points", 200, "--json")
    assert status == 0, err
    project = Project.open(tmp_path / "p")
    assert project.names == ("cube",)
    summary = json.loads(out.splitlines()[-1])
    assert summary["read"] == 1 and summary["not_read"] == len(BAD_MESHES)
    problems = {Path(problem.file).name: problem for problem in project.problems if problem.kind == "error"}
    assert problems.keys() == BAD_MESHES.keys()
    for name, problem in problems.items():
        assert problem.reason and problem.remedy, name
        assert "\n" not in str(problem) and len(str(problem)) < 400
        assert name in err
    assert not any((project.path / "meshes").glob("*junk*"))


def test_only_bad_files_is_a_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty.obj").write_bytes(b"")
    status, _, err = run(capsys, "import", tmp_path / "p", tmp_path / "empty.obj")
    assert status == 1 and "error: none of the 1 files could be read" in err and "empty.obj" in err


@pytest.mark.parametrize("what", ["nothing.obj", "no_folder", "folder_without_meshes"])
def test_absent_meshes_are_a_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str) -> None:
    (tmp_path / "folder_without_meshes").mkdir()
    status, _, err = run(capsys, "import", tmp_path / "p", tmp_path / what)
    assert status == 1 and what in err and len(err.strip().splitlines()) == 1


@pytest.mark.timeout(60)
def test_a_pipe_or_device_is_no_mesh(tmp_path: Path, cube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Reading a pipe would wait for ever."""
    os.mkfifo(tmp_path / "pipe.obj")
    status, _, err = run(capsys, "import", tmp_path / "p", tmp_path / "pipe.obj", cube, "--points", 200)
    assert status == 0 and "pipe.obj" in err
    assert Project.open(tmp_path / "p").names == ("cube",)


@pytest.mark.parametrize("name", ["chair no 4", "стул", "a'b\"c", "[red]x", "-dash", "a,b", "ä" * 100])
def test_odd_names_survive(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / f"{name}.obj").write_text(CUBE)
    status, _, err = run(capsys, "import", tmp_path / "p", tmp_path / "in", "--points", 200)
    assert status == 0, err
    assert Project.open(tmp_path / "p").shapes.named(name).name == name
    status, out, err = run(capsys, "info", tmp_path / "p", "--json")
    assert status == 0 and json.loads(out.splitlines()[-1])["shapes"] == [name]


def test_names_that_collide_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "chair.obj").write_text(CUBE)
    assert run(capsys, "import", tmp_path / "p", tmp_path / "a", "--points", 200)[0] == 0
    assert run(capsys, "import", tmp_path / "p", tmp_path / "b")[0] == 0
    assert Project.open(tmp_path / "p").names == ("b__chair", "chair")
    assert run(capsys, "import", tmp_path / "q", tmp_path / "a", tmp_path / "b", "--points", 200)[0] == 0
    assert len(Project.open(tmp_path / "q").names) == 2


def test_a_file_that_goes_bad_keeps_its_shape(project: Project, cube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = project.shapes.named("cube").points
    cube.write_text("v 0 0 0\n")
    status, _, err = run(capsys, "import", project.path, cube)
    assert status == 1 and "cube.obj" in err
    again = Project.open(project.path)
    assert np.array_equal(again.shapes.named("cube").points, before)
    assert [problem.kind for problem in again.problems] == ["error"]
    cube.write_text(CUBE + "f 1 3 7 5\n")
    assert run(capsys, "import", project.path, cube)[0] == 0
    again = Project.open(project.path)
    assert again.problems == [] and again.shape_record("cube")["n_faces"] == 7


# -- labels ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seg", "names", "expected"),
    [
        ("0\n" * 5, None, "cube.seg"),
        ("0\n" * 7, None, "cube.seg"),
        ("0\n0\nleg\n0\n0\n0\n", None, "cube.seg"),
        ("0\n0\n0.5\n0\n0\n0\n", None, "cube.seg"),
        ("", None, ".seg"),
        ("0\n" * 6, "{", "labels.json"),
        ("0\n" * 6, "[1]", "labels.json"),
        ("0\n" * 6, '{"leg": 1}', "labels.json"),
        (None, None, "labels"),
    ],
)
def test_bad_labels_are_a_failure(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], seg: str | None, names: str | None,
    expected: str,
) -> None:  # fmt: skip
    folder = tmp_path / "labels"
    folder.mkdir()
    if seg is not None:
        (folder / "cube.seg").write_text(seg)
    if names is not None:
        (folder / "labels.json").write_text(names)
    status, _, err = run(capsys, "label", project.path, folder)
    assert status == 1 and "error: " in err and expected in err
    assert Project.open(project.path).labelled == ()


def test_labels_of_shapes_that_are_not_there(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, err = run(capsys, "label", project.path, tmp_path, "--only", "sphere")
    assert status == 1 and "has no shape 'sphere'" in err
    status, _, err = run(capsys, "label", project.path, tmp_path / "none")
    assert status == 1 and "is not a folder" in err
    status, _, err = run(capsys, "label", project.path, tmp_path, "--only", "exemplars")
    assert status == 1 and "shapeforge group" in err


# -- the rest of the command line ------------------------------------------------------------------------------------


@pytest.mark.parametrize("verb", ["group", "fit", "learn", "refine", "cosegment", "info"])
def test_a_folder_that_is_no_project(tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    status, _, err = run(capsys, verb, tmp_path)
    assert status == 1 and "is not a shapeforge project" in err
    status, _, err = run(capsys, verb, tmp_path / "none")
    assert status == 1 and "does not exist" in err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("fit", "P"), "needs group first"),
        (("learn", "P"), "needs fit first"),
        (("refine", "P"), "first"),
        (("synthesize", "P", "--out", "o"), "needs fit first"),
        (("export", "P", "--out", "o"), "needs fit first"),
        (("apply", "P", "m.obj", "--out", "o"), "needs fit first"),
        (("validate", "P"), "nothing to compare with"),
        (("group", "P", "--exemplars", "sphere"), "'sphere' is not a shape"),
    ],
)
def test_what_is_missing_is_said(
    project: Project, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    words = [str(project.path) if word == "P" else word for word in arguments]
    status, _, err = run(capsys, *words)
    assert status == 1 and expected in err and err.startswith("error: ")


@pytest.mark.parametrize(
    "arguments",
    [("fly", "P"), ("fit",), ("import", "P", "--up", "w"), ("fit", "P", "--rounds", "0"), ("synthesize", "P")],
)
def test_wrong_usage_has_status_2(
    project: Project, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
) -> None:
    words = [str(project.path) if word == "P" else word for word in arguments]
    assert run(capsys, *words)[0] == 2


@pytest.mark.parametrize(
    ("option", "content", "expected"),
    [
        ("--landmarks", "{", "cannot be read"),
        ("--landmarks", "[]", "wanted {shape"),
        ("--landmarks", '{"cube": {"corner": [1, 2]}}', "three finite numbers for corner of cube"),
        ("--landmarks", '{"cube": {"corner": [1, 2, "x"]}}', "three finite numbers"),
        ("--classes", "", "columns name and class"),
        ("--classes", "shape;class\n", "columns name and class"),
        ("--landmarks", None, "cannot be read"),
        ("--classes", None, "cannot be read"),
    ],
)
def test_bad_truth_is_named(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, content: str | None,
    expected: str,
) -> None:  # fmt: skip
    file = tmp_path / "truth"
    if content is not None:
        file.write_text(content)
    status, _, err = run(capsys, "validate", project.path, option, file)
    assert status == 1 and str(file) in err and expected in err
