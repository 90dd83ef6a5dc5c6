"""The project on disk: round trips, atomic writes, one writer, damage, full disks."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shapeforge.collection.groups import Groups
from shapeforge.collection.labels import PartNames
from shapeforge.collection.shape import Frame, Mesh, Shape
from shapeforge.deformation.beliefs import Beliefs
from shapeforge.deformation.hierarchy import Hierarchy, Link
from shapeforge.deformation.templates import template_from_points
from shapeforge.store import Problem, Project, ProjectError, key_of
from shapeforge.store_arrays import decode, encode, read_arrays, read_record, write_arrays, write_record, write_text


def small_shape(name: str = "box", seed: int = 0, n_points: int = 12) -> Shape:
    """A shape whose arrays are random but consistent."""
    rng = np.random.default_rng(seed)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 2, 3], [0, 1, 3]], np.int32)
    mesh = Mesh(rng.random((4, 3)), triangles, np.arange(4, dtype=np.int32), 5, f"{name}.obj")
    triangle = rng.integers(0, 4, n_points).astype(np.int32)
    points, normals = rng.random((n_points, 3)), rng.random((n_points, 3))
    descriptors = rng.random((n_points, 10)).astype(np.float32)
    neighbours = np.full((n_points, 3), -1, np.int32)
    frame = Frame(0.5, np.eye(3), np.ones(3))
    patch = np.zeros(n_points, np.int32)
    return Shape(name, mesh, frame, points, normals, triangle, triangle, descriptors, patch, neighbours)


def add(project: Project, *names: str) -> None:
    """Put small shapes into a project."""
    for seed, name in enumerate(names):
        shape = small_shape(name, seed)
        project.save_shape(shape, f"key-{name}")
        record = {"file": f"meshes/{name}.obj", "source": f"/nowhere/{name}.obj", "sha256": "0", "key": f"key-{name}"}
        record |= {"n_faces": 5, "n_triangles": 4, "notes": [], "size": 0, "modified": 0}
        project.add_shapes({name: record})


@pytest.fixture
def project(tmp_path: Path) -> Project:
    made = Project.create(tmp_path / "family")
    add(made, "b", "a", "c")
    return made


def same(a: object, b: object) -> bool:
    """Deep equality of records, arrays with dtype, containers and numbers."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if dataclasses.is_dataclass(a):
        fields = dataclasses.fields(a)
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields)
    if isinstance(a, (tuple, list)):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    return a == b


def beliefs(k: int, seed: int) -> Beliefs:
    rng = np.random.default_rng(seed)
    return Beliefs(
        seed, rng.random((k, 3)), rng.random((k, 3)), rng.random((2, 3, 3)), rng.random((2, 3)), rng.random((7, 2)),
        np.array([True, False]), np.full(7, -1, np.int32), np.array([1.0, np.nan]),
    )  # fmt: skip


def test_a_shape_comes_back_as_it_was_written(project: Project) -> None:
    assert same(project.shapes[1], small_shape("b", 0))
    assert [shape.name for shape in project.shapes] == ["a", "b", "c"] == list(project.shapes.names)
    with pytest.raises(IndexError):
        project.shapes[3]
    with pytest.raises(ProjectError, match="has no shape 'd'.*a, b, c"):
        project.shapes.named("d")


@given(
    hnp.arrays(
        st.sampled_from([np.bool_, np.int8, np.int32, np.int64, np.uint8, np.float16, np.float32, np.float64]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
    )
)
def test_any_numeric_array_survives_the_disk(tmp_path_factory: pytest.TempPathFactory, array: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("arrays") / "a.zarr.zip"
    write_arrays(path, {"x": array}, {"é": [1, None]})
    arrays, attributes = read_arrays(path)
    assert arrays["x"].dtype == array.dtype and np.array_equal(arrays["x"], array, equal_nan=array.dtype.kind == "f")
    assert attributes == {"é": [1, None]}


def test_records_of_unequal_length_go_through_columns(tmp_path: Path) -> None:
    record = {"all": tuple(beliefs(k, k) for k in (3, 5, 2)), "odd": (beliefs(3, 1), (beliefs(2, 0),)), "none": ()}
    outline, arrays = encode(record)
    assert "all.deformed" in arrays and arrays["all.deformed"].shape == (10, 3)
    assert json.dumps(outline)
    assert same(decode(outline, arrays), record)
    write_record(tmp_path / "r.zarr.zip", record, {"round": 3})
    found, attributes = read_record(tmp_path / "r.zarr.zip")
    assert same(found, record) and attributes == {"round": 3}


def test_nested_tuples_of_records_go_through_columns() -> None:
    record = ((beliefs(3, 0), beliefs(2, 1)), (beliefs(4, 2),), ())
    outline, arrays = encode(record)
    assert len(arrays) == len(dataclasses.fields(Beliefs)) - 2  # ``template`` is a number, and nothing is ``lent``
    assert same(decode(outline, arrays), record)
    lending = dataclasses.replace(beliefs(3, 0), lent=((1, beliefs(2, 1)),))
    assert same(decode(*encode((lending, beliefs(2, 1)))), (lending, beliefs(2, 1)))


def test_a_hierarchy_that_was_stored_before_there_were_levels_is_read_as_one_of_two() -> None:
    rng = np.random.default_rng(0)
    top = template_from_points(
        rng.random((30, 3)), rng.random((30, 3)), rng.random((30, 10)), np.zeros(30, int), ("a",)
    )
    link = Link(np.zeros((30, 3), np.int32), np.full((30, 3), 1 / 3), np.ones(30, bool))
    hierarchy = Hierarchy(top, (link, link), np.array([[-1], [0]], np.int32))
    outline, arrays = encode(hierarchy)
    assert same(decode(outline, arrays), hierarchy) and decode(outline, arrays).levels == 3
    del outline["fields"]["over"]
    assert decode(outline, arrays).levels == 2


def test_what_is_no_plain_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="cannot be stored"):
        encode({"x": object()})
    with pytest.raises(TypeError, match="wanted bool, integer or float"):
        write_arrays(tmp_path / "a.zarr.zip", {"x": np.array([object()])})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ProjectError, match="another version"):
        write_arrays(tmp_path / "b.zarr.zip", {}, {"outline": {"record": "os.system", "fields": {}}})
        read_record(tmp_path / "b.zarr.zip")


def test_labels_groups_problems_and_records_survive_reopening(project: Project) -> None:
    project.set_part_names(PartNames((3, 7), ("leg", "top")))
    project.set_labels("a", np.array([0, 1, 1, -1, 0], np.int32))
    groups = Groups(("g",), np.zeros(3, np.int64), np.array([2]), np.zeros((3, 2)), np.eye(3))
    project.set_groups(groups)
    project.set_problems([Problem("x.obj", "error", "is empty", "Export it again")], ["x.obj"])
    project.set_problems([Problem("y.obj", "warning", "is odd")], ["y.obj"])
    project.set_problems([], ["x.obj"])
    project.set_stage_record("fit", {"key": "1", "state": "done"})
    again = Project.open(project.path)
    assert again.part_names == PartNames((3, 7), ("leg", "top"))
    assert again.labels("a").tolist() == [0, 1, 1, -1, 0] and again.labels("b") is None and again.labelled == ("a",)
    assert same(again.groups, groups)
    assert again.problems == [Problem("y.obj", "warning", "is odd")]
    assert again.stage_record("fit") == {"key": "1", "state": "done"} and again.stage_record("learn") is None
    again.set_labels("a", None)
    assert again.labels("a") is None


def test_labels_that_do_not_fit_are_refused(project: Project) -> None:
    project.set_part_names(PartNames((1,), ("leg",)))
    with pytest.raises(ValueError, match="5 faces of a, got 4"):
        project.set_labels("a", np.zeros(4, np.int32))
    with pytest.raises(ValueError, match="wanted -1 to 0, got 0 to 1"):
        project.set_labels("a", np.array([0, 0, 0, 0, 1], np.int32))
    assert project.labels("a") is None


def test_groups_follow_the_shapes_that_are_there_now(project: Project) -> None:
    groups = Groups(("g0", "g1"), np.array([0, 1, 0]), np.array([0, 1]), np.arange(6.0).reshape(3, 2))
    project.set_groups(groups)
    add(project, "aa")
    assert project.groups.group.tolist() == [0, -1, 1, 0]
    assert [project.names[t] for t in project.groups.exemplars] == ["a", "b"]
    (project.path / "meshes").mkdir()
    project.remove_shapes(["b"])
    assert project.groups.group.tolist() == [0, -1, 0] and project.groups.names == ("g0",)
    assert project.groups.embedding[2].tolist() == [4.0, 5.0]


def test_a_shape_with_another_number_of_faces_loses_its_labels(project: Project) -> None:
    project.set_part_names(PartNames((1,), ("leg",)))
    for name in ("a", "b"):
        project.set_labels(name, np.zeros(5, np.int32))
    project.add_shapes({"a": {**project.shape_record("a"), "n_faces": 6}, "b": project.shape_record("b")})
    assert project.labelled == ("b",)


def test_of_many_shapes_those_called_much_alike_are_named(project: Project) -> None:
    assert project.names_near("d") == "Its shapes: a, b, c"
    add(project, *(f"chair_{number:04d}" for number in range(4)), "table")
    assert project.names_near("tabel") == "Called much like it: table"
    assert project.names_near("chair_01") == "Called much like it: chair_0001, chair_0003, chair_0002, chair_0000"
    assert project.names_near("x") == "Its shapes: a, b, c, chair_0000, chair_0001, …"
    with pytest.raises(ProjectError, match=r"has no shape 'tabel'. Called much like it: table\.$"):
        project.index("tabel")


def test_few_shapes_stay_in_memory(project: Project) -> None:
    from shapeforge.store import StoredShapes

    shapes = StoredShapes(project, capacity=1)
    assert shapes[0] is shapes[0]
    first = shapes[0]
    assert shapes[1] is not None and shapes[0] is not first  # capacity holds one shape only
    roomy = StoredShapes(project)
    assert all(roomy[t] is roomy[t] for t in range(3))


def test_keys_tell_contents_apart() -> None:
    assert key_of("a", [1, 2]) == key_of("a", [1, 2]) != key_of("a", [2, 1])
    assert key_of(np.zeros(2, np.int32)) != key_of(np.zeros(2, np.int64)) != key_of(np.zeros((1, 2), np.int64))


# -- opening what is no project --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "is not a shapeforge project"),
        ("{", "cannot be read"),
        ("[]", "is not a shapeforge project's"),
        ('{"format": "shapeforge project", "version": 99}', "format version 99, this shapeforge reads 1"),
    ],
)
def test_opening_says_what_is_wrong(tmp_path: Path, content: str | None, expected: str) -> None:
    if content is not None:
        (tmp_path / "project.json").write_text(content)
    with pytest.raises(ProjectError, match=expected) as caught:
        Project.open(tmp_path)
    assert caught.value.remedy and str(tmp_path) in str(caught.value)


def test_creating_keeps_its_hands_off_other_folders(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match="does not exist"):
        Project.open(tmp_path / "none")
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(ProjectError, match="has other files"):
        Project.create(tmp_path)
    with pytest.raises(ProjectError, match="is a file"):
        Project.create(tmp_path / "thesis.tex")
    project = Project.create(tmp_path / "new")
    with pytest.raises(ProjectError, match="is a project already"):
        Project.create(project.path)
    assert Project.open_or_create(project.path).name == "new"


def test_a_damaged_file_is_named(project: Project) -> None:
    path = project.shape_path("a")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ProjectError, match=r"a\.zarr\.zip: is damaged"):
        Project.open(project.path).shapes.named("a")
    path.unlink()
    with pytest.raises(ProjectError, match=r"a\.zarr\.zip: is missing"):
        Project.open(project.path).shapes.named("a")


# -- atomic writes ---------------------------------------------------------------------------------------------------


def run_python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a script in another process."""
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_a_full_disk_loses_nothing(project: Project) -> None:
    """A process that may write no file above 4 kB: the write fails with a clear error, the old file is whole."""
    done = run_python(
        """
        import resource, sys
        import numpy as np
        from shapeforge.store import Project, ProjectError
        from shapeforge.collection.labels import PartNames
        project = Project.open(sys.argv[1])
        project.set_part_names(PartNames((1,), ("leg",)))
        before = project.shapes.named("a").points.tobytes()
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            project.save_shape(project.shapes.named("a"), "other")
        except ProjectError as error:
            print(error)
        assert Project.open(sys.argv[1]).shapes.named("a").points.tobytes() == before
        try:
            project.set_stage_record("fit", {"text": "x" * 9000})
        except ProjectError as error:
            print(error)
        assert project.stage_record("fit") is None
        """,
        project.path,
    )
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert "a.zarr.zip: cannot be written (File too large). Allow larger files" in first
    assert "project.json: cannot be written (File too large)" in second
    assert Project.open(project.path).names == ("a", "b", "c")
    assert list(project.path.rglob("*.tmp-*")) == []


def test_a_write_protected_project_says_so(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(ProjectError, match=r"cannot be written \(Permission denied\)\. Make the folder writable"):
        project.set_part_names(PartNames((1,), ("leg",)))
    monkeypatch.undo()
    assert project.part_names is None and Project.open(project.path).part_names is None
    assert list(project.path.glob("*.tmp-*")) == []


# -- one writer ------------------------------------------------------------------------------------------------------

HOLD = """
    import sys, time
    from shapeforge.store import Project
    project = Project.open(sys.argv[1])
    with project.writing():
        print("held", flush=True)
        time.sleep(600)
"""


def test_two_processes_cannot_write_at_once_and_a_killed_one_leaves_no_lock(project: Project) -> None:
    command = [sys.executable, "-c", textwrap.dedent(HOLD), str(project.path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        try:
            assert holder.stdout is not None and holder.stdout.readline() == "held\n"
            with pytest.raises(ProjectError, match=f"being written by process {holder.pid}. Wait"):
                project.set_stage_record("fit", {})
            assert Project.open(project.path).names == ("a", "b", "c")  # reading needs no lock
        finally:
            holder.send_signal(signal.SIGKILL)
    project.set_stage_record("fit", {"key": "1"})
    assert project.stage_record("fit") == {"key": "1"}


def test_a_lock_file_of_a_dead_process_is_taken_over(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where files cannot be locked, the process id in the file decides."""
    from shapeforge import store_lock

    monkeypatch.setattr(store_lock, "fcntl", None)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (project.path / "lock").write_text(f"{dead.pid}\n")
    project.set_stage_record("fit", {"key": "1"})
    (project.path / "lock").write_text(f"{os.getppid()}\n")
    with pytest.raises(ProjectError, match=f"process {os.getppid()}"):
        project.set_stage_record("fit", {"key": "2"})


def test_another_process_change_is_not_overwritten(project: Project) -> None:
    other = Project.open(project.path)
    other.set_stage_record("group", {"key": "other"})
    project.set_stage_record("fit", {"key": "mine"})
    assert set(Project.open(project.path).stage_records) == {"group", "fit"}


def test_threads_of_one_project_may_write_together(project: Project) -> None:
    project.set_part_names(PartNames((1,), ("leg",)))
    errors: list[BaseException] = []

    def work(name: str) -> None:
        try:
            for _ in range(5):
                project.set_labels(name, np.zeros(5, np.int32))
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(name,)) for name in project.names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == [] and Project.open(project.path).labelled == ("a", "b", "c")


def test_painting_history_comes_back(project: Project) -> None:
    history = {"done": [{"label": "leg", "faces": np.arange(3), "before": np.zeros(3, np.int32)}], "at": 1}
    project.set_painting({}, {"a": history})
    assert same(project.read_history("a"), history) and project.read_history("b") is None
    next((project.path / "history" / "a").glob("*.zarr.zip")).write_bytes(b"PK")
    assert project.read_history("a") is None


def test_labels_and_history_of_an_earlier_version_are_read_and_replaced(project: Project) -> None:
    project.set_part_names(PartNames((0, 1), ("leg", "seat")))
    faces = np.array([0, 1, 1, 0, -1], np.int32)
    project.set_painting({"a": faces}, {"a": {"at": 1}})
    for kind in ("labels", "history"):
        file = next((project.path / kind / "a").glob("*.zarr.zip"))
        file.rename(project.path / kind / "a.zarr.zip")
    metadata = json.loads((project.path / "project.json").read_text())
    del metadata["history"]
    (project.path / "project.json").write_text(json.dumps(metadata))
    old = Project.open(project.path)
    assert np.array_equal(old.labels("a"), faces) and old.read_history("a") == {"at": 1}
    old.set_painting({"a": faces[::-1]}, {"a": {"at": 2}})
    assert np.array_equal(old.labels("a"), faces[::-1]) and old.read_history("a") == {"at": 2}


def test_labels_that_no_longer_count_are_swept_and_a_reader_keeps_those_it_knows(project: Project) -> None:
    project.set_part_names(PartNames((0, 1, 2), ("leg", "seat", "back")))
    for part in range(3):
        reader = Project.open(project.path)
        project.set_labels("a", np.full(5, part, np.int32))
        if part:
            assert np.array_equal(reader.labels("a"), np.full(5, part - 1)), "read before, asked for after"
        assert len(list((project.path / "labels" / "a").iterdir())) <= 2


KILLED_AT = """
    import os, signal, sys
    import numpy as np
    from shapeforge import store_arrays
    from shapeforge.collection.labels import PartNames
    from shapeforge.store import Project

    def change(path, at):
        project, rename, done = Project.open(path), os.replace, 0

        def replace(*paths):
            nonlocal done
            done += 1
            if done == at:
                os.kill(os.getpid(), signal.SIGKILL)
            rename(*paths)

        store_arrays.os.replace = replace
        one = np.zeros(5, np.int32)
        project.set_painting(
            {"a": one, "b": one + 1, "c": None}, {"a": {"at": 1}}, part_names=PartNames((3, 2), ("all", "rest")),
            edits={"done": 1, "edits": []},
        )

    for at, path in enumerate(sys.argv[1:], start=1):
        child = os.fork()
        if child == 0:
            change(path, at)
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_parts_and_labels_change_together_or_not_at_all_wherever_the_process_is_killed(
    project: Project, tmp_path: Path
) -> None:
    project.set_part_names(PartNames((0, 1, 2), ("leg", "seat", "back")))
    for name in project.names:
        project.set_labels(name, np.array([0, 1, 2, 2, -1], np.int32))
    project.set_painting({}, {"a": {"at": 0}})

    def what_is_there(path: Path) -> tuple:
        found = Project.open(path)
        faces = {name: None if (one := found.labels(name)) is None else one.tolist() for name in found.names}
        return found.part_names, faces, found.read_history("a"), found.part_edits

    before = what_is_there(project.path)
    copies = [str(shutil.copytree(project.path, tmp_path / str(at))) for at in range(1, 6)]
    command = [sys.executable, "-c", textwrap.dedent(KILLED_AT), *copies]
    ends = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert ends == [str(-signal.SIGKILL)] * 4 + ["0"], "three files, then the one that counts, then no more"
    found = [what_is_there(tmp_path / str(at)) for at in range(1, 6)]
    assert all(one == before for one in found[:4])
    parts, faces, history, edits = found[4]
    assert parts == PartNames((3, 2), ("all", "rest")) and history == {"at": 1} and edits["done"] == 1
    assert faces == {"a": [0] * 5, "b": [1] * 5, "c": None}


def test_a_link_stays_one_and_what_is_no_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "there").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "there").read_text() == "new"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ProjectError, match="no ordinary file"):
        write_text(tmp_path / "pipe", "new")
    assert (tmp_path / "pipe").is_fifo()
