"""Painting in the real window: mouse and keys go in; Session, pixels and project are looked at."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtWidgets import QApplication

from shapeforge.store import Project
from shapeforge.viewer.palette import part_colours
from tests.viewer.paint_hands import Painting, move

CONTROL, ALT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.AltModifier
LEFT, RIGHT = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton


def test_the_first_exemplar_is_opened_and_nothing_is_painted(painting):
    project, name = painting.session.project, painting.session.shape
    assert name == project.names[project.groups.exemplars[0]]
    assert (painting.labels == -1).all() and painting.painter.mesh.n_faces == len(painting.labels)
    assert not painting.place.next.fit.isEnabled()
    assert "unpainted" in painting.place.next.fit_why.text()


def test_a_drag_paints_under_the_ring_as_one_undo_item(painting):
    seen = painting.visible()
    first = int(seen[np.argmax(painting.painter.surface.centres[seen, 1])])
    second = int(seen[np.argmin(painting.painter.surface.centres[seen, 1])])
    painting.session.part = 1
    painting.drag(painting.at(first), painting.at(second))
    painted = np.flatnonzero(painting.labels == 1)
    assert first in painted and second in painted and len(painting.painter.state.strokes) == 1
    assert painting.session.history.undo_label == "seat"
    painting.window.actions_table.run("undo")
    assert (painting.labels == -1).all()
    painting.window.actions_table.run("redo")
    assert np.array_equal(np.flatnonzero(painting.labels == 1), painted)


def test_paint_is_seen_in_the_picture(painting, qtbot):
    colour = part_colours(3)[1].astype(int)

    def blue() -> int:
        picture = painting.view.picture().astype(int)
        towards = picture / np.maximum(picture.sum(axis=-1, keepdims=True), 1)
        return int((np.abs(towards - colour / colour.sum()).max(axis=-1) < 0.04)[picture.max(axis=-1) > 60].sum())

    before = blue()
    painting.session.part, painting.session.tool = 1, "piece"
    seen = painting.visible()
    largest = np.bincount(painting.painter.surface.piece[seen]).argmax()
    painting.click(int(seen[painting.painter.surface.piece[seen] == largest][0]))
    qtbot.waitUntil(lambda: blue() > before + 300, timeout=5000)


def test_control_erases_and_the_brush_keeps_to_its_size(painting):
    painting.session.brush_size = 0.02
    face = int(painting.visible()[3])
    painting.click(face)
    painted = np.flatnonzero(painting.labels == 0)
    away = np.linalg.norm(painting.painter.surface.centres[painted] - painting.painter.surface.centres[face], axis=1)
    assert face in painted and (away[painted != face] <= 0.04).all()
    painting.click(face, CONTROL)
    assert painting.labels[face] == -1
    assert [s.tool for s in painting.painter.state.strokes] == ["brush", "eraser"]


def test_keys_take_tools_and_parts(painting, qtbot):
    for key, tool in (
        (Qt.Key.Key_F, "fill"),
        (Qt.Key.Key_E, "eraser"),
        (Qt.Key.Key_P, "piece"),
        (Qt.Key.Key_B, "brush"),
    ):
        painting.key(key)
        assert painting.session.tool == tool
    painting.key(Qt.Key.Key_3)
    assert painting.session.part == 2
    painting.key(Qt.Key.Key_9)
    assert painting.session.part == 2, "there is no ninth part"
    size = painting.session.brush_size
    painting.key(Qt.Key.Key_BracketRight)
    assert painting.session.brush_size > size


def test_fill_and_piece_take_what_they_say(painting):
    surface = painting.painter.surface
    face = int(painting.visible()[0])
    painting.session.tool, painting.session.part = "piece", 2
    painting.click(face)
    assert np.array_equal(painting.labels == 2, surface.piece == surface.piece[face])
    painting.session.tool, painting.session.part = "fill", 0
    painting.click(face)
    filled = np.flatnonzero(painting.labels == 0)
    assert face in filled and (surface.piece[filled] == surface.piece[face]).all()


def test_mirror_paints_the_opposite_side(painting):
    if painting.painter.mirror_plane is None:
        pytest.skip("this chair was generated without a mirror plane")
    painting.session.mirror, painting.session.brush_size = True, 0.02
    normal, offset, _ = painting.painter.mirror_plane
    centres = painting.painter.surface.centres
    aside = [f for f in painting.visible() if abs(centres[f] @ normal - offset) > 0.08]
    painted: np.ndarray = np.zeros(0, int)
    for face in aside[:40]:
        if painting.painter.twin(centres[face]) is not None:
            painting.click(int(face))
            painted = np.flatnonzero(painting.labels == 0)
            break
    sides = np.sign(centres[painted] @ normal - offset)
    assert (sides > 0).any() and (sides < 0).any()
    marks = [mark.kind for mark in painting.view.shown.views[0].marks]
    assert marks.count("brush") == 1 and marks.count("twin") == 1


def test_the_ring_moves_without_drawing_the_shape_again(painting, qtbot):
    qtbot.waitUntil(lambda: painting.view.at_rest, timeout=20000)
    qtbot.wait(100)
    frames = painting.view.frames
    seen = painting.visible()
    for face in seen[:: max(len(seen) // 10, 1)]:
        move(painting.target, painting.at(int(face)), Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier)
        qtbot.wait(10)
    assert any(mark.kind == "brush" for mark in painting.view.shown.views[0].marks)
    assert painting.view.frames == frames


def test_alt_drag_turns_the_view_and_paints_nothing(painting):
    before = np.array(painting.view.scene.camera.GetPosition())
    middle = QPoint(painting.view.width() // 2, painting.view.height() // 2)
    painting.drag(middle, middle + QPoint(60, 0), middle + QPoint(120, 10), modifiers=ALT)
    turned = np.array(painting.view.scene.camera.GetPosition())
    assert np.linalg.norm(turned - before) > 0.3 and (painting.labels == -1).all()
    painting.drag(middle, middle + QPoint(-60, 0), middle + QPoint(-120, 0), button=RIGHT)
    assert np.linalg.norm(np.array(painting.view.scene.camera.GetPosition()) - turned) > 0.3
    assert (painting.labels == -1).all() and not painting.painter.state.strokes


def test_the_wheel_sizes_the_brush_and_with_control_zooms(painting):
    def wheel(modifiers) -> None:
        at = QPointF(painting.view.width() / 2, painting.view.height() / 2)
        event = QWheelEvent(at, painting.target.mapToGlobal(at), QPoint(), QPoint(0, 120), Qt.MouseButton.NoButton,
                            modifiers, Qt.ScrollPhase.NoScrollPhase, False)  # fmt: skip
        QApplication.sendEvent(painting.target, event)

    size, scale = painting.session.brush_size, painting.view.scene.camera.GetParallelScale()
    wheel(Qt.KeyboardModifier.NoModifier)
    assert painting.session.brush_size > size and painting.view.scene.camera.GetParallelScale() == scale
    size = painting.session.brush_size
    wheel(CONTROL)
    assert painting.session.brush_size == size and painting.view.scene.camera.GetParallelScale() < scale


def test_the_lasso_takes_what_is_seen_inside(painting):
    painting.session.tool = "lasso"
    w, h = painting.view.width(), painting.view.height()
    corners = [QPoint(4, 4), QPoint(w - 4, 4), QPoint(w - 4, h - 4), QPoint(4, h - 4), QPoint(4, 4)]
    painting.drag(*corners)
    painted = np.flatnonzero(painting.labels == 0)
    seen = painting.visible()
    assert np.isin(seen, painted).mean() > 0.95 and len(painted) < len(painting.labels)
    assert painting.view.overlay.path == []


def test_the_eyedropper_takes_the_part_under_it(painting):
    face = int(painting.visible()[0])
    for key in (Qt.Key.Key_3, Qt.Key.Key_P):
        painting.key(key)
    painting.click(face)
    for key in (Qt.Key.Key_1, Qt.Key.Key_I):
        painting.key(key)
    assert painting.session.part == 0
    painting.click(face)
    assert painting.session.part == 2 and painting.session.tool == "brush"
    painting.session.tool = "eyedropper"
    painting.drag(painting.at(face), painting.at(face) + QPoint(8, 8))
    assert len(painting.painter.state.strokes) == 1, "dragging it paints nothing"


def test_painting_is_saved_with_its_history_and_comes_back(painting, open_window, qtbot):
    name, face = painting.session.shape, int(painting.visible()[0])
    painting.session.tool, painting.session.part = "piece", 1
    painting.click(face)
    path = painting.session.project.path
    qtbot.waitUntil(lambda: Project.open(path).labels(name) is not None, timeout=5000)
    assert np.array_equal(Project.open(path).labels(name), painting.labels)
    again = open_window(Project.open(path), "paint")
    again.session.shape = name
    place = again.places["paint"]
    assert np.array_equal(place.painter.state.labels, painting.labels)
    again.actions_table.run("undo")
    assert (place.painter.state.labels == -1).all()
    again.session.place = "collection"
    assert Project.open(path).labels(name) is None, "a shape without paint has no labels"


def test_a_save_during_a_drag_does_not_cut_the_stroke(painting, qtbot):
    seen = painting.visible()
    a, b = painting.at(int(seen[0])), painting.at(int(seen[-1]))
    qtbot.mousePress(painting.target, LEFT, Qt.KeyboardModifier.NoModifier, a)
    qtbot.wait(1000)
    move(painting.target, b, LEFT, Qt.KeyboardModifier.NoModifier)
    qtbot.mouseRelease(painting.target, LEFT, Qt.KeyboardModifier.NoModifier, b)
    assert len(painting.painter.state.strokes) == 1


def test_history_cards_go_back_and_forth(painting, qtbot):
    surface = painting.painter.surface
    painting.session.tool = "piece"
    for part, face in enumerate(painting.visible()[[0, -1]]):
        painting.session.part = part
        painting.click(int(face))
    done = painting.painter.state.done
    assert done == len(painting.painter.state.strokes) >= 1 and surface.n_faces
    qtbot.mouseClick(painting.place.history.cards[0], LEFT)
    assert painting.painter.state.done == 0 and (painting.labels == -1).all()
    qtbot.mouseClick(painting.place.history.cards[1], LEFT)
    assert painting.painter.state.done == 1


def test_complete_fills_the_rest_and_says_when_it_cannot(painting):
    table = painting.window.actions_table
    assert table.verdict("complete") == (False, "Paint a stroke on each part first.")
    painting.session.tool = "piece"
    seen = painting.visible()
    for part, face in enumerate((seen[0], seen[-1])):
        painting.session.part = part
        painting.click(int(face))
    kept = painting.labels >= 0
    before = painting.labels.copy()
    assert table.run("complete")
    assert (painting.labels >= 0).all() and np.array_equal(painting.labels[kept], before[kept])
    assert painting.place.blank.text() == "All painted"
    assert table.verdict("complete")[0] is False
    table.run("undo")
    assert np.array_equal(painting.labels, before)


def test_parts_are_added_renamed_and_merged(painting, qtbot):
    project, place = painting.session.project, painting.place
    place.parts.new_part()
    assert project.part_names.names == ("back", "seat", "leg", "part 1") and painting.session.part == 3
    editor = place.parts.rows[3].editor
    editor.setText("arm")
    qtbot.keyClick(editor, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: project.part_names.names[3] == "arm")
    qtbot.wait(50)
    place.parts.rows[3].rename()
    place.parts.rows[3].editor.setText("seat")
    qtbot.keyClick(place.parts.rows[3].editor, Qt.Key.Key_Return)
    assert project.part_names.names[3] == "arm" and "taken" in painting.session.status
    qtbot.wait(50)
    painting.session.tool = "piece"
    seen = painting.visible()
    painting.click(int(seen[0]))
    assert (painting.labels == 3).any()
    was = painting.labels == 3
    painting.session.part = 0
    assert not place.parts.merge.isEnabled() and "Ctrl-click" in place.parts.merge.toolTip()
    qtbot.mouseClick(place.parts.rows[3], LEFT, CONTROL)
    assert place.parts.second == 3
    qtbot.mouseClick(place.parts.merge, LEFT)
    assert project.part_names.names == ("back", "seat", "leg") and np.array_equal(painting.labels == 0, was)
    assert np.array_equal(project.labels(painting.session.shape), painting.labels)


def test_hidden_parts_are_neither_seen_nor_painted(painting):
    face = int(painting.visible()[0])
    painting.session.tool = "piece"
    painting.click(face)
    count = len(painting.view.shown.views[0].layers[0].triangles)
    painting.place.parts.hide_part(0)
    assert len(painting.view.shown.views[0].layers[0].triangles) < count
    painting.session.part = 1
    before = painting.labels.copy()
    painting.painter.begin()
    painting.painter.paint(painting.painter.touched(face, painting.painter.surface.centres[face], "piece"))
    painting.painter.end()
    assert np.array_equal(painting.labels, before)


def test_painting_without_parts_makes_the_first(open_window, grouped, qtbot):
    window = open_window(grouped, "paint")
    hands = Painting(window, qtbot)
    assert hands.painter.part_names == ()
    hands.session.tool = "piece"
    hands.click(int(hands.visible()[0]))
    assert hands.painter.part_names == ("part 1",) and (hands.labels == 0).any()


def test_when_every_exemplar_is_painted_the_next_step_is_open(painting, qtbot):
    project = painting.session.project
    painting.session.tool = "piece"
    for index in project.groups.exemplars:
        painting.session.shape = project.names[index]
        painting.click(int(painting.visible()[0]))
    painting.place._save()
    assert painting.place.next.fit.isEnabled(), painting.place.next.fit.toolTip()
    assert painting.place.next.fit_why.text() == "Every exemplar is painted."


def test_both_themes_colour_the_ground(painting, qtbot):
    dark = painting.view.picture()[5, 5]
    painting.session.theme = "light"
    qtbot.waitUntil(lambda: painting.view.picture()[5, 5].min() > 200, timeout=5000)
    assert dark.max() < 60
