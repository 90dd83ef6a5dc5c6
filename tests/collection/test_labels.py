"""Label files: what is written is read, and whatever is wrong is named."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shapeforge.collection.labels import (
    LabelError,
    PartNames,
    find_part_names,
    read_part_names,
    read_seg,
    write_part_names,
    write_seg,
)

CHAIR = PartNames((1, 2, 7), ("back", "seat", "leg"))


def written(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@given(
    st.dictionaries(st.integers(0, 2**31 - 1), st.text(min_size=1).map(str.strip).filter(bool), min_size=1).filter(
        lambda d: len(set(d.values())) == len(d)
    )
)
def test_part_names_survive_writing_and_reading(tmp_path_factory, parts):
    path = tmp_path_factory.getbasetemp() / "labels.json"
    names = PartNames(tuple(sorted(parts)), tuple(parts[i] for i in sorted(parts)))
    write_part_names(path, names)
    assert read_part_names(path) == names


@given(st.lists(st.integers(-1, 2)))
def test_labels_survive_writing_and_reading(tmp_path_factory, faces):
    path = tmp_path_factory.getbasetemp() / "a.seg"
    labels = np.array(faces, np.int32)
    write_seg(path, labels, CHAIR)
    np.testing.assert_array_equal(read_seg(path, len(faces), CHAIR), labels)


def test_ids_become_part_indices_and_unnamed_ids_are_unlabelled(tmp_path):
    path = written(tmp_path / "a.seg", "\ufeff7\r\n1\r\n-1\r\n3\r\n 2 \r\n\r\n0\r\n-5\r\n")
    assert read_seg(path, 7, CHAIR).tolist() == [2, 0, -1, -1, 1, -1, -1]
    assert read_seg(path, 7).tolist() == [4, 1, -1, 3, 2, 0, -1]
    unsorted = PartNames((7, 1), ("leg", "back"))
    assert read_seg(path, 7, unsorted).tolist() == [0, 1, -1, -1, -1, -1, -1]
    assert read_seg(written(tmp_path / "b.seg", "-1\n-1\n"), 2).tolist() == [-1, -1]


def test_labels_of_another_mesh_are_refused(tmp_path):
    path = written(tmp_path / "a.seg", "1\n1\n")
    with pytest.raises(LabelError, match=r"a.seg: wanted 3 labels, one per face, got 2\..*face records") as caught:
        read_seg(path, 3, CHAIR)
    assert caught.value.path == path
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


@pytest.mark.parametrize("line", ["1.0", "seat", "1 2", "0x1", "9" * 30, "1_0", "١"])
def test_lines_that_are_no_integers_are_named(tmp_path, line):
    with pytest.raises(LabelError, match="one integer per line, got .* in line 2"):
        read_seg(written(tmp_path / "a.seg", f"1\n{line}\n"), 2, CHAIR)


def test_files_that_are_no_text_or_not_there(tmp_path):
    with pytest.raises(LabelError, match="a text file"):
        read_seg(written(tmp_path / "a.seg", b"\xff\xfe\x00\x81"), 1)
    with pytest.raises(LabelError, match=r"none.seg: wanted a file that can be read"):
        read_seg(tmp_path / "none.seg", 1)


@pytest.mark.parametrize(
    "content",
    ["", "{", "[]", "{}", "3", '{"a": "seat"}', '{"-1": "none"}', '{"1": ""}', '{"1": 2}', '{"1": "a", "1": "b"}',
     '{"1": "a", "01": "b"}', '{"1": "a", "2": "a"}', '{"1.5": "a"}', '{"99999999999": "a"}'],
)  # fmt: skip
def test_bad_part_names_are_refused(tmp_path, content):
    with pytest.raises(LabelError, match=r"labels.json: wanted .* got ") as caught:
        read_part_names(written(tmp_path / "labels.json", content))
    assert caught.value.wanted and caught.value.got


def test_part_names_of_a_folder(tmp_path):
    written(tmp_path / "x" / "a.seg", "3\n-1\n0\n")
    written(tmp_path / "x" / "b.seg", "3\n12\n")
    assert find_part_names(tmp_path / "x") == PartNames((0, 3, 12), ("part 0", "part 3", "part 12"))
    written(tmp_path / "x" / "labels.json", json.dumps({"12": "leg", "3": "séat"}))
    assert find_part_names(tmp_path / "x") == PartNames((3, 12), ("séat", "leg"))
    with pytest.raises(LabelError, match="no such folder"):
        find_part_names(tmp_path / "y")
    written(tmp_path / "z" / "a.seg", "-1\n")
    with pytest.raises(LabelError, match="1 .seg files without labels"):
        find_part_names(tmp_path / "z")


def test_writing_refuses_indices_that_are_no_parts(tmp_path):
    with pytest.raises(ValueError, match=r"faces: wanted part indices -1..2, got 0..3"):
        write_seg(tmp_path / "a.seg", np.array([0, 3]), CHAIR)
    assert not list(tmp_path.iterdir())


def test_labels_of_real_shapes_fit_their_files(real_shapes):
    folder = real_shapes / "ikea" / "chairs"
    names = find_part_names(folder)
    assert names.names == ("back", "seat", "leg", "arm")
    for file in sorted(folder.glob("*.seg"))[::7]:
        records = sum(line.startswith("f ") for line in file.with_suffix(".obj").read_text().splitlines())
        assert set(read_seg(file, records, names)) <= {-1, 0, 1, 2, 3}
