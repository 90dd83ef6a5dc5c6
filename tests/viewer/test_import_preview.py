"""Before an import: what is read, guessed and refused is said; and the projects opened last are remembered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt

from shapeforge.collection.meshes import read_mesh, write_mesh
from shapeforge.store import Project
from shapeforge.viewer.import_preview import (
    FilePreview,
    doubts,
    other_size_words,
    possible_units,
    previews,
    size_words,
    summary,
    usual,
)
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.recent import recent_projects, remember
from tests.viewer.test_window import drop

LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def models(meshes: Path, tmp_path: Path) -> Path:
    """Three chairs, one of them lying, one in millimetres; and a file that is no mesh."""
    folder = tmp_path / "models"
    folder.mkdir()
    lines = (meshes / "chair_0000.obj").read_text().splitlines()
    (folder / "a.obj").write_text("\n".join(lines))
    turned, large = [], []
    for line in lines:
        words = line.split()
        if words[:1] == ["v"]:
            x, y, z = map(float, words[1:4])
            turned.append(f"v {x} {-z} {y}")
            large.append(f"v {1000 * x} {1000 * y} {1000 * z}")
        else:
            turned.append(line)
            large.append(line)
    (folder / "lying.obj").write_text("\n".join(turned))
    (folder / "large.obj").write_text("\n".join(large))
    (folder / "notes.obj").write_text("this is no mesh\n")
    return folder


SIZES = [
    (0.9, "m"),
    (35.0, "cm m"),
    (70.0, "cm m"),
    (85.0, "cm"),
    (870.0, "mm cm"),
    (9000.0, "mm"),
    (1.0, ""),
    (1e6, ""),
]


@pytest.mark.parametrize(("longest", "units"), SIZES)
def test_the_possible_units(longest, units):
    """An airliner in metres is as large as a lamp in centimetres: size does not tell, and both are said."""
    assert possible_units(longest) == tuple(units.split())


def test_the_files_of_a_folder_tell_the_unit_of_one_whose_size_does_not():
    """The unit is that of most files, also for those that by themselves had two; the likeliest is named first."""
    planes = files_of(4.2, 5.0, 6.1, 9.8, 12.5, 21.0)
    assert [size_words(one, usual(planes)).split()[-1] for one in planes] == ["m?"] * 6
    assert size_words(planes[-1]).endswith(" cm or m?"), "alone"
    airliners = files_of(30.0, 38.7, 71.0, 64.0)
    assert all(size_words(one, usual(airliners)).endswith(" cm or m?") for one in airliners)
    assert "sizes may be centimetres or metres" in summary(airliners)
    assert not any(doubts(one, usual(airliners)) for one in airliners), "that it is not known makes no file odd"


def test_a_format_that_has_one_unit_is_believed(meshes, tmp_path):
    mesh = read_mesh(meshes / "chair_0000.obj")
    longest = float(np.ptp(mesh.vertices, axis=0).max())
    for ending in (".glb", ".obj"):
        for i in range(3):
            vertices, part = mesh.vertices * (38.0 + i) / longest, np.zeros(len(mesh.triangles), int)
            write_mesh(
                tmp_path / f"{i}{ending}", vertices, mesh.triangles, part, ["all"], np.full((1, 3), 99, np.uint8)
            )
    seen = list(previews([tmp_path]))
    stated = [one for one in seen if one.path.suffix == ".glb"]
    assert len(seen) == 6 and {one.units for one in stated} == {("m",)} == {usual(stated).units and ("m",)}
    assert usual(seen).units == ("cm", "m"), "not all say so"


def test_every_file_is_seen_before_it_is_imported(models):
    seen = {one.name: one for one in previews([models])}
    assert seen["a"].n_faces > 0 and seen["a"].up == "y is up" and not seen["a"].problem
    among = usual(list(seen.values()))
    assert seen["lying"].up.startswith("turned") and doubts(seen["lying"], among) and not doubts(seen["a"], among)
    assert seen["large"].units == ("mm", "cm") and seen["a"].units == ("m",)
    assert seen["notes"].problem and seen["notes"].remedy and seen["notes"].mesh is None
    words = summary(list(seen.values()))
    assert words.startswith("3 of 4 can be read") and "2 need a look" in words


def files_of(*longest: float) -> list[FilePreview]:
    """Previews of files that are so large."""
    return [
        FilePreview(f"{i}", Path(f"{i}.obj"), len(longest), 10, (0.5 * one, one, 0.4 * one), possible_units(one))
        for i, one in enumerate(longest)
    ]


@pytest.mark.parametrize("scale", [1.0, 30.0, 60.0, 900.0])
def test_files_of_a_folder_are_in_one_unit(scale):
    """Some are on the other side of a bound by themselves, one had been scaled to 1: none is another kind of file."""
    low, high = {1.0: (0.7, 13.0), 30.0: (9.0, 95.0), 60.0: (11.0, 150.0), 900.0: (90.0, 9000.0)}[scale]
    files = files_of(low, scale * 1.1, scale * 1.2, scale * 2, scale * 3, high)
    among = usual(files)
    assert among.units == possible_units(scale * 1.65) and len({one.units for one in files}) > 1
    kin = [one for one in files if 1 / 8 < max(one.size) / among.middle < 8]
    assert len(kin) >= 5 and len({size_words(one, among).partition(f"{one.size[2]:.3g} ")[2] for one in kin}) == 1
    assert not any(other_size_words(one, among) for one in kin)


def test_a_file_in_another_unit_is_marked():
    files = files_of(0.9, 0.8, 1.1, 0.85, 2.0, 9700.0, 88.0)
    among = usual(files)
    assert [size_words(one, among).split()[-1] for one in files] == ["m?"] * 5 + ["mm?", "cm?"]
    assert [other_size_words(one, among) for one in files[:5]] == [""] * 5
    assert other_size_words(files[5], among) == "11\u202f000 times as large as the others"
    assert "metres · 2 need a look" in summary(files)
    large = files_of(870.0, 900.0, 0.9)
    assert other_size_words(large[2], usual(large)) == "980 times as small as the others"


def test_without_a_majority_every_file_has_its_own_unit():
    files = files_of(0.9, 0.8, 8700.0, 9000.0)
    among = usual(files)
    assert among.units is None and [size_words(one, among).split()[-1] for one in files] == ["m?", "m?", "mm?", "mm?"]
    assert usual([]).units is usual([]).up is None and "sizes" not in summary(files)


def test_a_much_smaller_file_is_marked():
    files = files_of(0.9, 0.8, 1.1, 0.06)
    assert doubts(files[3], usual(files)) == ("15 times as small as the others",)
    assert not any(doubts(one, usual(files)) for one in files[:3])


UP, TURNED = "y is up", "turned: z seems to be up in the file"


@pytest.mark.parametrize(("most", "odd"), [(UP, TURNED), (TURNED, UP)])
def test_a_file_is_marked_in_which_another_way_is_up_than_in_the_others(most, odd):
    files = [replace(one, up=odd if i == 2 else most) for i, one in enumerate(files_of(0.9, 0.8, 1.1, 0.85))]
    among = usual(files)
    assert [bool(doubts(one, among)) for one in files] == [False, False, True, False]
    assert doubts(files[2], among) == (f"{odd}, unlike the others",)
    assert not any(doubts(one, among, "z") for one in files), "nothing is guessed"
    assert (f"most are {TURNED}" in summary(files)) == (most == TURNED)
    assert summary(files).endswith("1 needs a look") and "a look" not in summary(files, "z")


def test_a_repaired_file_is_marked():
    files = files_of(0.9, 0.8, 1.1)
    files[1] = replace(files[1], notes=("2 faces without area, ignored",))
    assert [doubts(one, usual(files)) for one in files] == [(), files[1].notes, ()]


def has_tick(dialog, line: int) -> bool:
    """Whether a tick is seen in the box before a name."""
    return shows(dialog, line, 0, tokens(dialog.session.theme)["on_accent"].lower(), 26)


def shows(dialog, line: int, column: int, wanted: str, width: int | None = None) -> bool:
    """Whether a colour is seen in a cell, or in the first ``width`` pixels of it."""
    table = dialog.table
    where = table.visualItemRect(table.item(line, column))
    where.setWidth(width or where.width())
    shot = table.viewport().grab(where).toImage()
    return any(shot.pixelColor(x, y).name() == wanted for x in range(shot.width()) for y in range(shot.height()))


def test_a_drop_shows_what_was_found_and_imports_what_is_ticked(open_window, qtbot, models):
    window = open_window()
    drop(window, models)
    dialog = window.import_dialog
    assert not dialog.start.isEnabled() and dialog.start.toolTip()
    qtbot.waitUntil(dialog.start.isEnabled, timeout=60000)
    rows = {dialog.table.item(i, 0).text(): i for i in range(dialog.table.rowCount())}
    assert set(rows) == {"a", "lying", "large", "notes"}
    assert dialog.table.item(rows["notes"], 3).text().startswith("not read")
    assert dialog.start.text() == "Import 3 shapes"
    assert [dialog.table.item(rows[name], 2).text().split()[-1] for name in ("a", "large")] == ["m?", "cm?"]
    assert dialog.table.item(rows["large"], 3).text().startswith("1\u202f000 times as large as the others · ")
    assert "times" not in dialog.table.item(rows["lying"], 3).text()
    assert dialog.table.item(rows["lying"], 3).text().endswith(", unlike the others")
    assert [rows[name] for name in ("notes", "large", "lying", "a")] == [0, 1, 2, 3], "what needs a look comes first"
    warned = tokens(window.session.theme)["warning"].lower()
    assert [shows(dialog, rows[name], 3, warned) for name in ("a", "large", "lying")] == [False, True, True]
    qtbot.waitUntil(lambda: dialog.pictures.waiting == 0, timeout=60000)
    icon = dialog.table.item(rows["a"], 0).icon().pixmap(40, 40).toImage()
    assert any(icon.pixelColor(x, y).alpha() > 100 for x in range(icon.width()) for y in range(icon.height()))
    box = dialog.table.visualItemRect(dialog.table.item(rows["large"], 0))
    qtbot.mouseClick(dialog.table.viewport(), LEFT, pos=box.center())
    qtbot.keyClick(dialog.table, Qt.Key.Key_Space)
    assert dialog.start.text() == "Import 2 shapes"
    assert has_tick(dialog, rows["a"]) and not has_tick(dialog, rows["large"])
    assert window.session.project is None
    qtbot.mouseClick(dialog.start, LEFT)
    assert window.session.running
    qtbot.waitUntil(lambda: not window.session.running, timeout=120000)
    project = Project.open(models.parent / "models-project")
    assert project.names == ("a", "lying")
    assert [Path(problem.file).name for problem in project.problems if problem.kind == "error"] == ["notes.obj"]


def test_thinking_again_imports_nothing(open_window, qtbot, models):
    window = open_window()
    drop(window, models)
    qtbot.keyClick(window.import_dialog, Qt.Key.Key_Escape)
    assert window.session.project is None and not window.session.running
    assert not (models.parent / "models-project").exists()


def test_projects_opened_last_come_first_and_lost_ones_go(grouped, tmp_path):
    other = Project.create(tmp_path / "other")
    for path in (grouped.path, other.path, grouped.path):
        remember(path)
    assert recent_projects() == (grouped.path.resolve(), other.path.resolve())
    (other.path / "project.json").unlink()
    assert recent_projects() == (grouped.path.resolve(),)


def test_the_start_page_opens_a_project_of_before(open_window, qtbot, grouped):
    window = open_window(grouped, "paint")
    qtbot.keyClick(window, Qt.Key.Key_W, Qt.KeyboardModifier.ControlModifier)
    assert window.session.project is None
    link = window.start_page.recent_links[grouped.path.resolve()]
    assert link.isVisible()
    qtbot.mouseClick(link, LEFT)
    assert window.session.project is not None and window.session.project.names == grouped.names
