"""Collection: pictures lie where the map says, the mouse selects what is under it, the next step is one click."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest
from scipy.spatial.distance import pdist

from shapeforge import stages
from shapeforge.store import Project
from shapeforge.viewer.layout import GAP, HULL_MARGIN, hull, place_by_likeness, place_in_rows
from shapeforge.viewer.palette import GROUPS, rgb
from shapeforge.viewer.qt.collection_panel import CollectionPlace
from shapeforge.viewer.qt.collection_words import hover_card, typical_text
from shapeforge.viewer.qt.controls import Clickable, EditableName
from tests.viewer.conftest import paint_exemplars

LEFT = Qt.MouseButton.LeftButton
SHIFT, CTRL = Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.ControlModifier


# -- the layout ------------------------------------------------------------------------------------------------------


def family(sizes: list[int], seed: int, spread: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(len(sizes), 2))
    group = np.repeat(np.arange(len(sizes)), sizes)
    return centres[group] + spread * rng.normal(size=(len(group), 2)), group


@settings(deadline=None, max_examples=20)
@given(sizes=st.lists(st.integers(1, 25), min_size=1, max_size=7), seed=st.integers(0, 1000), spread=st.floats(0, 2))
def test_no_two_pictures_overlap_and_no_two_groups(sizes, seed, spread):
    embedding, group = family(sizes, seed, spread)
    place = place_by_likeness(embedding, group)
    assert np.isfinite(place).all()
    if len(place) > 1:
        assert pdist(place).min() > 0.9
    for a in range(len(sizes)):
        corners = hull(place[group == a], HULL_MARGIN)
        edges = np.roll(corners, -1, axis=0) - corners
        outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        others = place[group != a]
        if len(others):
            # Outside of a convex polygon: beyond at least one edge, by the other's margin, too.
            beyond = ((others[:, None, :] - corners) * outward).sum(axis=2).max(axis=1)
            assert beyond.min() > 0.8 * HULL_MARGIN


def test_what_is_near_in_the_embedding_is_near_on_the_map():
    embedding, group = family([30], 1)
    place = place_by_likeness(embedding, group)
    wanted, got = pdist(embedding), pdist(place * (1, -1))
    order = [np.argsort(np.argsort(x)) for x in (wanted, got)]
    assert np.corrcoef(order)[0, 1] > 0.75


def test_shapes_left_out_stand_below_all_groups():
    embedding, group = family([6, 5], 2)
    group[[1, 8]] = -1
    place = place_by_likeness(embedding, group)
    assert place[group < 0, 1].min() > place[group >= 0, 1].max() + HULL_MARGIN + GAP


def test_coinciding_shapes_are_spread_out():
    place = place_by_likeness(np.zeros((12, 2)), np.zeros(12, int))
    assert pdist(place).min() > 0.9


def test_rows_go_group_by_group():
    place, headings = place_in_rows(np.array([1, 0, 1, -1, 1]), 2)
    assert [g for g, _ in headings] == [0, 1, -1]
    assert place[1, 1] < place[0, 1] == place[2, 1] < place[4, 1] < place[3, 1]
    assert len(np.unique(place, axis=0)) == 5


@pytest.mark.parametrize(
    ("rank", "words"), [(0, "typical: 1st of 12"), (1, "typical: 2nd of 12"), (10, "typical: 11th of 12")]
)
def test_how_typical_an_exemplar_is(rank, words):
    from shapeforge.collection.groups import Groups

    position = np.arange(12.0)
    distance = np.abs(np.subtract.outer(position, position))
    total = distance.sum(axis=1)
    exemplar = int(np.argsort(total, kind="stable")[rank])
    better = int((total < total[exemplar]).sum())
    groups = Groups(("Group 1",), np.zeros(12, int), np.array([exemplar]), np.zeros((12, 2)), distance)
    assert typical_text(groups, 0) == (words if better == rank else typical_text(groups, 0))
    assert str(better + 1) in typical_text(groups, 0)


# -- the place -------------------------------------------------------------------------------------------------------


@pytest.fixture
def window(open_window, grouped):
    return open_window(grouped)


@pytest.fixture
def place(window) -> CollectionPlace:
    return window.places["collection"]


def spot(place: CollectionPlace, name: str) -> QPoint:
    return place.map.at(place.map.content.names.index(name)).toPoint()


def two_of_a_group(project) -> tuple[int, str, str]:
    """A group with company: its number, its exemplar and another member."""
    groups = project.groups
    g = int(np.argmax([len(groups.members(g)) for g in range(len(groups))]))
    exemplar = int(groups.exemplars[g])
    other = next(int(t) for t in groups.members(g) if t != exemplar)
    return g, project.names[exemplar], project.names[other]


def test_every_shape_lies_inside_the_map(place):
    inside = place.map.rect()
    for name in place.session.project.names:
        assert inside.contains(spot(place, name))


def test_a_click_selects_the_shape_under_it(window, place, qtbot):
    for name in place.session.project.names[:3]:
        qtbot.mouseClick(place.map, LEFT, pos=spot(place, name))
        assert window.session.shape == name
        assert window.session.selected == (name,)
    assert "1 of 8 selected" in place.count.text()


def test_ctrl_click_adds_and_takes_away(window, place, qtbot):
    first, second = place.session.project.names[:2]
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, first))
    qtbot.mouseClick(place.map, LEFT, CTRL, pos=spot(place, second))
    assert set(window.session.selected) == {first, second}
    qtbot.mouseClick(place.map, LEFT, CTRL, pos=spot(place, first))
    assert window.session.selected == (second,)


def drag(widget, points: list[QPoint], modifier=Qt.KeyboardModifier.NoModifier) -> None:
    QTest.mousePress(widget, LEFT, modifier, points[0])
    for point in points[1:]:
        QTest.mouseMove(widget, point)
    QTest.mouseRelease(widget, LEFT, modifier, points[-1])


def test_dragging_pans_and_the_wheel_zooms_at_the_pointer(place, qtbot):
    name = place.session.project.names[0]
    before = QPointF(spot(place, name))
    drag(place.map, [QPoint(5, 5), QPoint(40, 25), QPoint(65, 45)])
    moved = QPointF(spot(place, name)) - before
    assert abs(moved.x() - 60) <= 2 and abs(moved.y() - 40) <= 2
    fixed = place.map.at(0)
    tile = place.map.tile
    from PySide6.QtGui import QWheelEvent

    event = QWheelEvent(fixed, place.map.mapToGlobal(fixed), QPoint(), QPoint(0, 120), Qt.MouseButton.NoButton,
                        Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False)  # fmt: skip
    place.map.wheelEvent(event)
    assert place.map.tile > tile
    assert (place.map.at(0) - fixed).manhattanLength() < 1e-6
    qtbot.keyClick(place.map, Qt.Key.Key_Home)
    assert abs(place.map.tile - tile) < 1e-9


def test_pictures_of_the_shapes_arrive_in_the_groups_colour(window, place, qtbot):
    qtbot.waitUntil(lambda: place.pictures.waiting == 0, timeout=60000)
    groups = place.session.project.groups
    image = place.map.grab().toImage()
    ratio = image.devicePixelRatio()
    for t, _ in enumerate(place.session.project.names):
        at, half = place.map.at(t), place.map.tile * 0.35
        wanted = np.array(rgb(GROUPS[int(groups.group[t])]), float)
        hue = wanted - wanted.mean()
        found = 0
        for x in np.arange(at.x() - half, at.x() + half, 2):
            for y in np.arange(at.y() - half, at.y() + half, 2):
                colour = image.pixelColor(round(x * ratio), round(y * ratio))
                seen = np.array([colour.red(), colour.green(), colour.blue()], float)
                bright = seen.mean() > 90
                tint = seen - seen.mean()
                found += bool(
                    bright
                    and np.linalg.norm(tint) > 8
                    and tint @ hue > 0.8 * np.linalg.norm(tint) * np.linalg.norm(hue)
                )
        assert found > 8, f"no picture of {place.session.project.names[t]}"


def test_arrow_keys_walk_over_the_map(window, place, qtbot):
    names = place.session.project.names
    left = int(np.argmin(place.map.place[:, 0]))
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, names[left]))
    qtbot.keyClick(place.map, Qt.Key.Key_Right)
    now = names.index(window.session.shape)
    assert place.map.place[now, 0] > place.map.place[left, 0]


def test_the_selected_shape_becomes_the_exemplar(window, place, qtbot):
    project = place.session.project
    g, exemplar, other = two_of_a_group(project)
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, other))
    assert other in place.choose_button.text()
    qtbot.mouseClick(place.choose_button, LEFT)
    assert project.names[project.groups.exemplars[g]] == other
    assert place.preview_name.text() == other
    assert other in place.strip.card_of and exemplar not in place.strip.card_of


def test_choosing_another_exemplar_on_the_map(window, place, qtbot):
    project = place.session.project
    g, exemplar, other = two_of_a_group(project)
    qtbot.mouseClick(place.groups.rows[g], LEFT)
    qtbot.mouseClick(place.choose_button, LEFT)
    assert place.choosing and project.groups.names[g] in place.hint.text()
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, other))
    assert not place.choosing
    assert project.names[project.groups.exemplars[g]] == other
    window.session.undo()
    assert project.names[project.groups.exemplars[g]] == exemplar


def test_x_leaves_the_selected_shape_out(window, place, qtbot):
    project = place.session.project
    _, _, other = two_of_a_group(project)
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, other))
    qtbot.keyClick(place.map, Qt.Key.Key_X)
    assert project.groups.group[project.names.index(other)] == -1
    assert place.map.content.group[project.names.index(other)] == -1
    window.session.undo()
    assert project.groups.group[project.names.index(other)] >= 0


def test_the_hover_card_says_what_it_is(place):
    project = place.session.project
    _, exemplar, other = two_of_a_group(project)
    card = hover_card(place.session, other)
    assert other in card and "faces" in card and "from its exemplar" in card
    assert "the exemplar" in hover_card(place.session, exemplar)


def test_groups_are_listed_with_their_numbers(place, qtbot):
    groups = place.session.project.groups
    assert len(place.groups.rows) == len(groups) == int(place.groups.count.text())
    for g in reversed(range(len(groups))):
        qtbot.mouseClick(place.groups.rows[g], LEFT)
        assert groups.names[g] in place.exemplar_title.text()
        assert [one.property("current") for one in place.groups.rows].count("true") == 1


def test_what_stands_beside_the_exemplar_ends_with_its_picture(window, place):
    window.resize(1280, 800)
    inspector = place.inspector

    def right(one) -> int:
        return one.mapTo(inspector, one.rect().bottomRight()).x()

    assert place.typical.text().startswith("typical: ")
    assert right(place.typical) == right(place.preview.parentWidget()) == right(place.choose_button)
    assert right(place.preview) <= right(place.preview.parentWidget()), "no picture is cut off"


def test_files_not_read_are_named_with_the_reason(place, qtbot):
    assert place.problems.read_count.text() == "8 of 9 read"
    from PySide6.QtWidgets import QLabel

    words = [one.text() for one in place.problems.findChildren(QLabel)]
    assert "empty.obj" in words
    assert any("no faces" in word for word in words)
    qtbot.mouseClick(place.problems.copy, LEFT)
    assert "empty.obj" in QGuiApplication.clipboard().text()


def test_the_next_step_is_to_paint_the_first_exemplar(window, place, qtbot, meshes):
    project = place.session.project
    first = project.names[project.groups.exemplars[0]]
    assert place.strip.next.text() == f"Paint {first}"
    assert place.strip.strip_count.text() == f"0 of {len(project.groups)} painted"
    paint_exemplars(project, meshes)
    window.session.touch("labels")
    assert place.strip.strip_count.text() == f"{len(project.groups)} of {len(project.groups)} painted"
    assert place.strip.next.text() == "Fit the family"
    qtbot.mouseClick(place.strip.next, LEFT)
    assert window.session.place == "fit"


def test_the_cards_select_their_exemplar(window, place, qtbot):
    name, card = next(iter(place.strip.card_of.items()))
    assert isinstance(card, Clickable)
    qtbot.mouseClick(card, LEFT)
    assert window.session.shape == name
    assert card.property("current") == "true"


def test_the_grid_shows_all_in_rows(window, place, qtbot):
    qtbot.mouseClick(place.mode.button("grid"), LEFT)
    assert place.map.rows
    name = place.session.project.names[2]
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, name))
    assert window.session.shape == name
    xs = {round(x, 6) for x in place.map.place[:, 0]}
    assert all(abs(x * 2 - round(x * 2)) < 1e-6 for x in xs)


def test_before_grouping_there_is_a_grid_and_one_next_step(open_window, grouped, qtbot, monkeypatch):
    grouped._metadata["groups"] = None
    window = open_window(grouped)
    place = window.places["collection"]
    assert not place.mode.button("map").isEnabled() and place.mode.button("map").toolTip()
    assert place.strip.next.text() == "Group the shapes"
    assert len(place.map.content.names) == 8
    started = []
    monkeypatch.setattr(window.actions_table.desk, "start", lambda name, make: started.append(name))
    qtbot.mouseClick(place.strip.next, LEFT)
    assert started == ["group"]


def test_a_first_import_names_the_files_as_they_are_read(open_window, meshes, tmp_path, qtbot):
    folder = tmp_path / "files"
    folder.mkdir()
    names = [f"chair_000{number}" for number in range(3)]
    for name in names:
        shutil.copy(meshes / f"{name}.obj", folder)
    (folder / "notes.obj").write_text("this is no mesh\n")
    with (folder / f"{names[0]}.obj").open("a") as file:
        file.write("f 1 2 2\n")  # a face without area
    window = open_window(Project.create(tmp_path / "new"))
    place, session = window.places["collection"], window.session
    note, told = place.reading, []
    assert note.isVisible() and note.title.text() == "No shapes yet" and not note.files.isVisible()

    def look() -> None:
        sign, line = note.lines[0]
        if note.files.isVisible():
            told.append((note.title.text(), line.full_text(), sign.property("icon_name")))

    place.binding.on(("progress",), look, now=False)
    window.actions_table.import_shapes((folder,))
    qtbot.waitUntil(lambda: not session.running, timeout=120000)
    assert {"2 of 4 read", "3 of 4 read"} <= {title for title, *_ in told}
    assert all(any(line.startswith(f"{name}: ") and sign == "check" for _, line, sign in told) for name in names[1:])
    assert any(f"{names[0]}: " in line and "area" in line and sign == "warning" for _, line, sign in told)
    assert any(line.startswith("notes.obj: ") and sign == "error" for _, line, sign in told)
    assert not note.isVisible() and len(place.map.content.names) == 3


def test_a_group_is_renamed_in_place_and_nothing_goes_stale(open_window, fitted, qtbot):
    window = open_window(fitted)
    place, session = window.places["collection"], window.session
    before = fitted.groups.names[0]
    qtbot.mouseDClick(place.groups.rows[0], LEFT)
    editor = place.groups.rows[0].findChild(EditableName).editor
    qtbot.waitUntil(editor.hasFocus)
    qtbot.keyClicks(editor, "Side  chairs")
    qtbot.keyClick(editor, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: fitted.groups.names[0] == "Side chairs")
    assert place.exemplar_title.text() == "Exemplar of Side chairs"
    assert place.groups.rows[0].findChild(EditableName).text() == "Side chairs"
    assert stages.status(Project.open(fitted.path))["fit"].state == "done"
    session.undo()
    assert fitted.groups.names[0] == before == place.groups.rows[0].findChild(EditableName).text()


def test_a_group_keeps_its_name_on_escape_and_without_a_name(open_window, fitted, qtbot):
    window = open_window(fitted)
    place = window.places["collection"]
    before = fitted.groups.names
    place.map.setFocus()
    for key in (Qt.Key.Key_Escape, Qt.Key.Key_Return):
        qtbot.keyClick(place.map, Qt.Key.Key_F2)
        editor = place.groups.rows[place.session.group].findChild(EditableName).editor
        qtbot.waitUntil(editor.hasFocus)
        editor.setText("another" if key == Qt.Key.Key_Escape else "  ")
        qtbot.keyClick(editor, key)
        qtbot.wait(30)
        assert fitted.groups.names == before
    assert window.session.status_kind == "warning" and "name" in window.session.status
