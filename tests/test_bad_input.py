"""Whatever a user hands in: it is named, the reason and the remedy are said on one line, and the rest goes on."""

from __future__ import annotations

import json
import os
import shutil
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from shapeforge import stages_import
from shapeforge.cli import run_command
from shapeforge.cli_output import ODD_FILES, follow
from shapeforge.cli_words import names_in
from shapeforge.collection.families import write_family
from shapeforge.stages import Progress, StageError
from shapeforge.stages_recipes import read_recipe
from shapeforge.stages_status import difference
from shapeforge.store import Problem, Project

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


@pytest.fixture(scope="session")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a cube in ``good`` and the project ``p`` of it."""
    folder = tmp_path_factory.mktemp("imported")
    (folder / "good").mkdir()
    (folder / "good" / "cube.obj").write_text(CUBE)
    assert run_command(["import", str(folder / "p"), str(folder / "good"), "--points", "200"]) == 0
    return folder


@pytest.fixture
def project(tmp_path: Path, cube: Path, imported: Path) -> Project:
    """A project of its own, of one cube, that was imported from ``cube``."""
    shutil.copytree(imported, tmp_path, dirs_exist_ok=True)
    file = tmp_path / "p" / "project.json"
    file.write_text(file.read_text().replace(str(imported), str(tmp_path)))
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
    assert Project.open(tmp_path / "q").names == ("a__chair", "b__chair")
    third = tmp_path / "c" / "b" / "chair.obj"  # its folder's name collides, too
    third.parent.mkdir(parents=True)
    third.write_text(CUBE)
    assert run(capsys, "import", tmp_path / "p", third)[0] == 0
    sources = {name: Project.open(tmp_path / "p").shape_record(name)["source"] for name in ("b__chair", "c__b__chair")}
    assert sources == {"b__chair": str(tmp_path / "b" / "chair.obj"), "c__b__chair": str(third)}
    # all files have their names by now, and the copies in the projects are no further shapes
    assert run(capsys, "import", tmp_path / "p", tmp_path)[0] == 0
    assert len(Project.open(tmp_path / "p").names) == 3


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


@pytest.mark.parametrize("more", [(), ("--restart",), ("--points", 150)])
def test_changed_files_are_read_again_without_being_named(
    project: Project, cube: Path, capsys: pytest.CaptureFixture[str], more: tuple[object, ...]
) -> None:
    cube.write_text(CUBE + "f 1 3 7 5\n")
    assert run(capsys, "import", project.path, *more)[0] == 0
    again = Project.open(project.path)
    assert again.shape_record("cube")["n_faces"] == 7 and again.shapes.named("cube").mesh.n_faces == 7
    assert again.mesh_path("cube").read_bytes() == cube.read_bytes() and again.changed_sources() == []
    cube.unlink()  # the copy is there
    assert run(capsys, "import", project.path, "--restart")[0] == 0
    assert Project.open(project.path).shape_record("cube")["n_faces"] == 7


def test_stages_say_that_files_changed_and_how_to_read_them_again(
    project: Project, cube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cube.write_text(CUBE + "f 1 3 7 5\n")
    status, out, err = run(capsys, "group", project.path, "--json")
    again = f"shapeforge import {project.path}"
    assert status == 0 and json.loads(out.splitlines()[-1])["stale"] == ["import"]
    said = [line for line in err.splitlines() if "1 file changed since being read (cube)" in line]
    assert len(said) == 1 and "warning: " in said[0] and again in said[0] and "redone when needed" not in err
    assert f"next: Read the changed files again: {again}" in err
    status, _, err = run(capsys, "export", project.path, "--out", tmp_path / "out")
    assert status == 1 and err.count("1 file changed since being read") == 1
    cube.write_text("v 0 0 0\n")
    status, _, err = run(capsys, "import", project.path)
    assert status == 0 and "not read: " in err and "cube.obj" in err
    assert "next: Read" not in err, "it cannot be read: other work goes on"
    cube.write_text(CUBE)
    status, out, _ = run(capsys, "info", project.path)
    assert status == 0 and "changed since" not in out and "next: Read" not in out


def test_a_change_that_was_not_read_can_still_be_seen(
    project: Project, cube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "other.obj").write_text(CUBE)
    cube.write_text(CUBE + "f 1 3 7 5\n")
    assert run(capsys, "import", project.path, tmp_path / "other.obj", "--points", 150)[0] == 0
    again = Project.open(project.path)
    assert again.shape_record("cube")["n_faces"] == 6 and again.changed_sources() == ["cube"]

    def change(path: Path) -> tuple[tuple[int, int], str]:
        found = looked(path)
        if path.name == cube.name:
            path.write_text(CUBE + "f 1 3 7 5\n" * 2)
        return found

    looked = stages_import._stamp_and_digest
    monkeypatch.setattr(stages_import, "_stamp_and_digest", change)
    assert run(capsys, "import", project.path, cube)[0] == 0
    assert Project.open(project.path).changed_sources() == ["cube"], "it changed while it was read"


def test_a_mesh_that_is_hardly_a_shape_is_doubtful(
    tmp_path: Path, cube: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "piece.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    status, _, err = run(capsys, "import", tmp_path / "p", cube, tmp_path / "piece.obj", "--points", 200)
    assert status == 0 and Project.open(tmp_path / "p").names == ("cube", "piece")
    said = [line for line in err.splitlines() if "warning: " in line]
    assert len(said) == 1 and "piece.obj: it has only 1 triangle, too few for a shape" in said[0]


def test_all_that_is_odd_about_a_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also what comparing it with the others finds; and what was said comes again in the project's list."""
    write_family(tmp_path / "in", "chairs", 3, seed=3, broken=0.0)
    lying = sorted((tmp_path / "in").glob("*.obj"))[0]
    lines = lying.read_text().splitlines()
    faces = [line for line in lines if line.startswith("f ")]
    turned = [f"v {x} {-float(z)} {y}" for x, y, z in (line.split()[1:4] for line in lines if line.startswith("v "))]
    lying.write_text("\n".join([*turned, *faces, "f 1 1 2", faces[0], ""]))
    status, _, err = run(capsys, "import", tmp_path / "p", tmp_path / "in", "--points", 300)
    said = [line for line in err.splitlines() if "warning: " in line]
    assert status == 0 and len(said) == 1, err
    notes = ("1 face without area, ignored", "drawn twice, counted twice", "turned: +z seems to be up", "in the window")
    assert str(lying) in said[0] and all(note in said[0] for note in notes)
    reasons = [problem.reason for problem in Project.open(tmp_path / "p").problems]
    assert len(reasons) == 3 and all(reason in said[0] for reason in reasons)


def test_of_many_odd_files_some_are_named_and_the_rest_counted(capsys: pytest.CaptureFixture[str]) -> None:
    found = [Problem(f"{t:03}.obj", "warning", "turned") for t in range(ODD_FILES + 5)]
    steps = [Progress("import", "orient", 0, 1, "", problem=one) for one in found]
    follow(SimpleNamespace(path="P"), iter(steps), "import")
    said = capsys.readouterr().err.splitlines()
    assert len(said) == ODD_FILES + 1 and "5 more files with something odd: shapeforge info P" in said[-1]


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


def test_ids_without_a_name_are_told_and_wipe_no_labels(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def labels(ids: list[int], which: str) -> tuple[int, str]:
        (tmp_path / which).mkdir()
        (tmp_path / which / "labels.json").write_text('{"2": "leg", "3": "seat"}')
        (tmp_path / which / "cube.seg").write_text("".join(f"{i}\n" for i in ids))
        status, _, err = run(capsys, "label", project.path, tmp_path / which)
        return status, err

    status, err = labels([2, 2, 3, 7, 7, -1], "some")
    assert status == 0 and "7 (2 faces)" in err and "labels.json" in err
    kept = [0, 0, 1, -1, -1, -1]
    assert Project.open(project.path).labels("cube").tolist() == kept
    status, err = labels([9] * 6, "none")
    assert status == 1 and "others only (9)" in err and "cube stays as it was" in err
    after = Project.open(project.path)
    assert after.labels("cube").tolist() == kept and after.part_names.names == ("leg", "seat")
    assert [Path(problem.file).parent.name for problem in after.problems if problem.kind == "error"] == ["none"]
    assert labels([2] * 6, "right")[0] == 0
    assert not [one for one in Project.open(project.path).problems if one.kind == "error"], "it is labelled now"


def test_labels_of_meshes_of_one_name_lie_as_the_meshes_do(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for which in ("a", "b"):
        (tmp_path / which).mkdir()
        shutil.copy(project.mesh_path("cube"), tmp_path / which / "twin.obj")
    (tmp_path / "a" / "twin.seg").write_text("1\n" * 6)
    assert run(capsys, "import", tmp_path / "two", tmp_path / "a", tmp_path / "b")[0] == 0
    assert run(capsys, "label", tmp_path / "two", tmp_path)[0] == 0
    two = Project.open(tmp_path / "two")
    assert two.names == ("a__twin", "b__twin") and two.labelled == ("a__twin",)


def test_files_that_are_gone_are_no_longer_complained_of(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "more").mkdir()
    broken = tmp_path / "more" / "broken.obj"
    broken.write_text("nothing")
    shutil.copy(project.mesh_path("cube"), tmp_path / "more" / "other.obj")
    assert "broken.obj" in run(capsys, "import", project.path, tmp_path / "more")[2]
    assert any(problem.file == str(broken) for problem in Project.open(project.path).problems)
    broken.unlink()
    run(capsys, "import", project.path, tmp_path / "more")
    assert not any(problem.file == str(broken) for problem in Project.open(project.path).problems)


def test_labels_of_shapes_that_are_not_there(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, err = run(capsys, "label", project.path, tmp_path, "--only", "sphere")
    assert status == 1 and "has no shape 'sphere'" in err
    status, _, err = run(capsys, "label", project.path, tmp_path / "none")
    assert status == 1 and "is not a folder" in err
    status, _, err = run(capsys, "label", project.path, tmp_path, "--only", "exemplars")
    assert status == 1 and "shapeforge group" in err
    (tmp_path / "empty").mkdir()
    status, _, err = run(capsys, "label", project.path, tmp_path / "empty")
    assert status == 1 and "a folder without .seg files" in err


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
        (("group", "P", "--exemplars", "sphere"), "'sphere' is not a shape of P. Its shapes: cube\n"),
    ],
)
def test_what_is_missing_is_said(
    project: Project, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    words = [str(project.path) if word == "P" else word for word in arguments]
    status, _, err = run(capsys, *words)
    assert status == 1 and expected.replace("P.", f"{project.path}.") in err and err.startswith("error: ")


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


# -- a failure leaves no trace ---------------------------------------------------------------------------------------


def test_refused_options_are_not_kept(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    """Options keep their value from run to run: a name that was refused must not haunt every later command."""
    assert run(capsys, "group", project.path, "--exemplars", "cube")[0] == 0
    before = Project.open(project.path).stage_record("group")
    assert run(capsys, "group", project.path, "--exemplars", "sphere")[0] == 1
    assert run(capsys, "group", project.path, "--exemplars", "cube", "cube")[0] == 1
    assert Project.open(project.path).stage_record("group") == before
    status, out, _ = run(capsys, "group", project.path)
    assert status == 0 and "up to date" in out


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (("fit", "P"), 1),
        (("info", "nowhere"), 1),
        (("validate", "P"), 1),
        (("export", "P", "--out", "o"), 1),
        (("fit", "P", "--rounds", "0"), 2),
        (("fit", "P", "--seed", "-1"), 2),
        (("synthesize", "P", "--count", "0", "--out", "o"), 2),
    ],
)
def test_json_says_what_failed(
    project: Project, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], status: int
) -> None:
    words = [str(project.path) if word == "P" else word for word in arguments]
    got, out, _ = run(capsys, *words, "--json")
    found = json.loads(out.splitlines()[-1])
    assert got == status and found["verb"] == arguments[0] and found["error"]


def test_lines_for_a_file_tell_rounds_and_not_epochs(capsys: pytest.CaptureFixture[str]) -> None:
    """Where there is no terminal for a bar: learning within refine has hundreds of epochs."""
    phases = [("alternate", "round 1"), *(("learn", f"epoch {e}") for e in range(300)), ("faces", "labelled")]
    steps = [Progress("refine", phase, 0, 3, message) for phase, message in phases]
    assert follow(None, iter(steps), "refine") is steps[-1]
    assert capsys.readouterr().err.split("\n") == ["  round 1", ""]


def test_help_shows_what_a_landmark_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert "[x, y, z]" in run(capsys, "validate", "--help")[1]


def test_one_shape_is_no_shapes(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "info", project.path)
    assert status == 0 and "p: 1 shape\n" in out and "1 shapes" not in out


def test_a_recipe_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(StageError, match=r"x\.ply\.recipe\.json: no such file.*shapeforge synthesize"):
        read_recipe(tmp_path / "x.ply.recipe.json")
    (tmp_path / "x.glb").write_bytes(b"glTF\xc4\xff")
    with pytest.raises(StageError, match=r"x\.glb: wanted a MESH\.recipe\.json"):
        read_recipe(tmp_path / "x.glb")


def test_a_file_of_names_that_is_something_else_is_named_and_not_recited(tmp_path: Path) -> None:
    (tmp_path / "chair.glb").write_bytes(b"glTF\xc4\xff")
    with pytest.raises(typer.BadParameter, match="chair.glb: wanted a text file"):
        names_in([str(tmp_path / "chair.glb")])
    told = difference({"options": {"train": None}}, {"train": [f"v {i} 0 0" for i in range(5000)]}, {})
    assert told.startswith("train ['v 0 0 0'") and "instead of None" in told and len(told) < 120


def test_json_has_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    from shapeforge.cli_output import print_json

    print_json({"a": float("nan"), "b": [np.float32(1.5), np.inf], "c": np.arange(2), "d": Path("x"), "e": {1: None}})
    found = json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert found == {"a": None, "b": [1.5, None], "c": [0, 1], "d": "x", "e": {"1": None}}


def test_what_a_killed_import_left_is_swept(project: Project, cube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = [project.path / "shapes" / "cube.zarr.zip.tmp-17-0a9ee6", project.path / "meshes" / "x.obj.tmp-17-0a9ee6"]
    for file in left:
        file.write_bytes(b"half")
    assert run(capsys, "import", project.path, cube)[0] == 0
    assert not any(file.exists() for file in left) and project.shape_path("cube").is_file()


# -- damaged projects ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [
        "",
        '{"format": "shapeforge project", "ver',
        "[]",
        '{"format": "shapeforge project", "version": 1}',
        '{"format": "shapeforge project", "version": 1, "name": "x", "shapes": {"a": 1}, "problems": [], "labels": {}, '
        '"stages": {}}',
    ],
)
def test_a_damaged_project_file_is_named(project: Project, capsys: pytest.CaptureFixture[str], content: str) -> None:
    (project.path / "project.json").write_text(content)
    status, _, err = run(capsys, "info", project.path)
    assert status == 1 and "project.json" in err and str(project.path) in err and "Error" not in err


def test_damaged_results_name_the_command_that_helps(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    def cut(path: Path) -> None:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    assert run(capsys, "group", project.path)[0] == 0
    cut(project.path / "groups.zarr.zip")
    status, _, err = run(capsys, "info", project.path)
    assert status == 1 and "groups.zarr.zip" in err and f"shapeforge group {project.path}" in err
    (project.path / "groups.zarr.zip").unlink()
    status, out, _ = run(capsys, "info", project.path, "--json")
    assert status == 0 and json.loads(out.splitlines()[-1])["stages"]["group"]["state"] == "stale"
    assert run(capsys, "group", project.path)[0] == 0 and (project.path / "groups.zarr.zip").is_file()

    cut(project.shape_path("cube"))
    status, _, err = run(capsys, "cosegment", project.path)
    assert status == 1 and "cube.zarr.zip" in err and f"shapeforge import {project.path}" in err
    project.shape_path("cube").unlink()
    assert run(capsys, "import", project.path)[0] == 0 and project.shape_path("cube").is_file()


def test_another_sampling_says_what_became_stale(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "group", project.path)[0] == 0
    status, out, err = run(capsys, "import", project.path, "--points", 150, "--json")
    assert status == 0 and "stale now" in err and json.loads(out.splitlines()[-1])["stale"] == ["group"]


# -- labels of several files -----------------------------------------------------------------------------------------


@pytest.fixture
def two(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Project:
    """A project of two cubes, a and b."""
    (tmp_path / "two").mkdir()
    for name in "ab":
        (tmp_path / "two" / f"{name}.obj").write_text(CUBE)
    assert run(capsys, "import", tmp_path / "p2", tmp_path / "two", "--points", 200)[0] == 0
    return Project.open(tmp_path / "p2")


def test_a_bad_seg_does_not_spoil_the_others(two: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also without a labels.json, where the parts are looked up in all files."""
    (tmp_path / "two" / "a.seg").write_text("leg\n")
    (tmp_path / "two" / "b.seg").write_text("0\n0\n3\n-1\n3\n0\n")
    status, _, err = run(capsys, "label", two.path, tmp_path / "two")
    assert status == 0 and "a.seg" in err
    assert Project.open(two.path).labelled == ("b",)
    status, _, err = run(capsys, "label", two.path, tmp_path / "two", "--only", "a")
    assert status == 1 and "a.seg" in err and "0 of 1 shapes were labelled" in err


def test_exemplars_without_labels_are_said(two: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "group", two.path, "--exemplars", "a", "b")[0] == 0
    (tmp_path / "two" / "b.seg").write_text("0\n" * 6)
    status, out, err = run(capsys, "label", two.path, tmp_path / "two", "--only", "exemplars", "--json")
    assert status == 0 and "a.seg" in err and json.loads(out.splitlines()[-1])["without"] == ["a"]
    (tmp_path / "two" / "a.seg").write_text("0\n")
    assert run(capsys, "label", two.path, tmp_path / "two", "--only", "exemplars")[0] == 1


@pytest.mark.parametrize("damaged", [False, True])
def test_labels_that_no_longer_fit_are_kept_beside_their_mesh(
    project: Project, cube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damaged: bool
) -> None:
    (tmp_path / "good" / "cube.seg").write_text("4\n2\n4\n-1\n4\n2\n")
    (tmp_path / "good" / "labels.json").write_text('{"4": "leg", "2": "seat"}')
    assert run(capsys, "label", project.path, tmp_path / "good")[0] == 0
    cube.write_text(CUBE.replace("v 1 1 1", "v 1 1 1.5"))
    status, _, err = run(capsys, "import", project.path)
    assert status == 0 and "taken away" not in err and Project.open(project.path).labelled == ("cube",)
    before = cube.read_bytes()
    for file in (project.path / "labels" / "cube").iterdir() if damaged else ():
        file.write_bytes(b"half")
    cube.write_text(CUBE + "f 1 3 7 5\n")
    status, _, err = run(capsys, "import", project.path)
    said = "it had 6 faces and now has 7: the labels of cube no longer fit and were taken away"
    assert status == 0 and f"warning: {cube}: {said}" in err
    again = Project.open(project.path)
    assert again.labelled == () and said in [problem.reason for problem in again.problems]
    kept = sorted((project.path / "meshes").glob("before/*"))
    if damaged:
        assert kept == [] and "Label it again" in err
        return
    assert [file.suffix for file in kept] == [".obj", ".seg"] and str(kept[1]) in err
    assert kept[0].read_bytes() == before and kept[1].read_text() == "4\n2\n4\n-1\n4\n2\n"
    cube.write_text(CUBE)
    assert run(capsys, "import", project.path, tmp_path)[0] == 0
    assert Project.open(project.path).names == ("cube",), "what is kept is no further shape"


def test_a_label_file_without_labels_is_doubtful(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "good" / "cube.seg").write_text("-1\n" * 6)
    (tmp_path / "good" / "labels.json").write_text('{"1": "leg"}')
    status, _, err = run(capsys, "label", project.path, tmp_path / "good")
    assert status == 0 and "cube.seg" in err and "unlabelled" in err


def test_names_of_parts_survive_and_stay_different(
    two: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "two"
    for name in "ab":
        (folder / f"{name}.seg").write_text("0\n0\n3\n-1\n3\n0\n")
    (folder / "labels.json").write_text('{"0": "seat", "3": "leg"}')
    assert run(capsys, "label", two.path, folder)[0] == 0
    (folder / "labels.json").unlink()
    assert run(capsys, "label", two.path, folder, "--only", "a")[0] == 0
    assert Project.open(two.path).part_names.names == ("seat", "leg")
    (folder / "labels.json").write_text('{"7": "seat"}')
    status, _, err = run(capsys, "label", two.path, folder, "--only", "a")
    assert status == 1 and "'seat'" in err and "0 and 7" in err
    (folder / "labels.json").write_text('{"0": "top", "3": "seat"}')
    assert run(capsys, "label", two.path, folder)[0] == 0
    assert Project.open(two.path).part_names.names == ("top", "seat")


def test_a_report_needs_a_file(project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, _, err = run(capsys, "report", project.path, "--out", tmp_path)
    assert status == 1 and "is a folder" in err
