"""Controls used as a person does: clicks on tools, menus, eyes and switches; the Session has it and it is seen."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from PySide6.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from PySide6.QtGui import QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QApplication, QMenu, QWidget

from shapeforge.collection.colours import PARTS
from shapeforge.store import Project
from shapeforge.viewer import spreading
from shapeforge.viewer.palette import SWITCHED_OFF, rgb
from tests.viewer.paint_hands import move
from tests.viewer.test_by_hand import pixels, settled
from tests.viewer.test_collection_place import drag, spot
from tests.viewer.test_correspondence_place import click, seen_points
from tests.viewer.test_correspondence_place import spot as point_spot
from tests.viewer.test_fit_place import LONG, place_of
from tests.viewer.test_part_edits import share_of

LEFT, SHIFT = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ShiftModifier


def choose(qtbot, choice: QWidget, text: str) -> None:
    """Open a choice and click one of its lines."""
    qtbot.mouseClick(choice, LEFT)
    menu = next(one for one in choice.findChildren(QMenu) if one.isVisible())
    line = next(one for one in menu.actions() if one.text() == text)
    qtbot.mouseClick(menu, LEFT, pos=menu.actionGeometry(line).center())


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of the pixels that are clearly others."""
    return float((np.abs(after - before).sum(axis=2) > 60).mean())


# -- Collection ------------------------------------------------------------------------------------------------------


def test_a_lasso_takes_what_it_encloses_and_nothing_else(open_window, grouped, qtbot):
    window = open_window(grouped)
    place = window.places["collection"]
    at = np.array([spot(place, name).toTuple() for name in grouped.names])
    across = np.sort(at[:, 0])
    widest = int(np.diff(across).argmax())
    middle = (across[widest] + across[widest + 1]) // 2
    inside = at[:, 0] < middle
    corners = [(2, 2), (middle, 2), (middle, place.map.height() - 2), (2, place.map.height() - 2), (2, 2)]
    qtbot.mouseClick(place.lasso, LEFT)
    drag(place.map, [QPoint(int(x), int(y)) for x, y in corners])
    assert 0 < inside.sum() < len(at)
    assert set(window.session.selected) == {name for name, one in zip(grouped.names, inside, strict=True) if one}


def test_map_and_grid_are_two_pictures_of_the_same_shapes(open_window, grouped, qtbot):
    window = open_window(grouped)
    place = window.places["collection"]
    qtbot.waitUntil(lambda: place.pictures.waiting == 0, timeout=60000)
    as_map = pixels(place.map)
    qtbot.mouseClick(place.mode.button("grid"), LEFT)
    qtbot.waitUntil(lambda: place.pictures.waiting == 0, timeout=60000)
    assert window.session.arrangement == "grid" and changed(as_map, pixels(place.map)) > 0.01
    qtbot.keyClick(place.map, Qt.Key.Key_1)
    assert window.session.arrangement == "map" and changed(as_map, pixels(place.map)) < 1e-3


def test_models_dropped_on_an_open_project_are_taken_and_other_files_are_not(open_window, grouped, meshes, qtbot):
    window, middle = open_window(grouped), QPoint(600, 400)
    for file, wanted in ((meshes / "chair_0001.seg", False), (meshes / "chair_0001.obj", True)):
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(file))])
        none = Qt.KeyboardModifier.NoModifier
        enter = QDragEnterEvent(middle, Qt.DropAction.CopyAction, data, LEFT, none)
        enter.ignore()
        QApplication.sendEvent(window, enter)
        assert enter.isAccepted() is wanted, file.name
    QApplication.sendEvent(window, QDropEvent(QPointF(middle), Qt.DropAction.CopyAction, data, LEFT, none))
    dialog = window.import_dialog
    qtbot.waitUntil(dialog.start.isEnabled, timeout=60000)
    assert [dialog.table.item(i, 0).text() for i in range(dialog.table.rowCount())] == ["chair_0001"]
    qtbot.keyClick(dialog, Qt.Key.Key_Escape)
    assert not window.session.running


# -- Paint -----------------------------------------------------------------------------------------------------------


def test_every_tool_is_taken_by_a_click_on_it_and_the_slider_sizes_the_brush(painting, qtbot):
    for tool, one in painting.place.tools.buttons.items():
        qtbot.mouseClick(one, LEFT)
        assert painting.session.tool == tool and one.isChecked()
        assert sum(other.isChecked() for other in painting.place.tools.buttons.values()) == 1
    slider, before = painting.place.brush.size, painting.session.brush_size
    middle = slider.height() // 2
    handle = QPoint(round(slider.width() * slider.value() / slider.maximum()), middle)
    drag(slider, [handle, QPoint(slider.width() - 20, middle), QPoint(slider.width() - 4, middle)])
    assert painting.session.brush_size > 2 * before
    assert painting.place.brush.size_value.text() == f"{100 * painting.session.brush_size:.1f}%"


def test_a_part_is_taken_by_a_click_on_it_painted_erased_and_seen(painting, qtbot):
    place = painting.place
    qtbot.mouseClick(place.parts.rows[1], LEFT)
    assert painting.session.part == 1
    qtbot.mouseClick(place.tools.buttons["piece"], LEFT)
    seen, piece = painting.visible(), painting.painter.surface.piece
    largest = int(seen[piece[seen] == np.bincount(piece[seen]).argmax()][0])
    settled(painting.view, qtbot)
    painting.click(largest)
    qtbot.waitUntil(lambda: share_of(painting, PARTS[1]) > 300, timeout=5000)
    share = painting.painter.surface.areas[painting.labels == 1].sum() / painting.painter.surface.areas.sum()
    assert place.parts.rows[1].share.text() == f"{share:.0%}" and place.blank.text() == f"{1 - share:.0%}"
    painting.click(largest, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: share_of(painting, PARTS[1]) < 30, timeout=5000)
    assert (painting.labels < 0).all()


def test_the_eye_of_a_part_hides_it_and_shows_it_again(painting, qtbot):
    painting.session.tool = "piece"
    painting.click(int(painting.visible()[0]))
    before, eye = settled(painting.view, qtbot), painting.place.parts.rows[0].eye
    qtbot.mouseClick(eye, LEFT)
    assert painting.painter.hidden == {0} and changed(before, settled(painting.view, qtbot)) > 1e-3
    qtbot.mouseClick(eye, LEFT)
    assert painting.painter.hidden == frozenset() and changed(before, settled(painting.view, qtbot)) < 1e-3


def test_the_mirror_is_switched_on_by_click_and_key_and_paints_both_sides(painting, qtbot):
    plane = painting.painter.mirror_plane
    if plane is None:
        pytest.skip("this chair was generated without a mirror plane")
    qtbot.mouseClick(painting.place.brush.mirror, LEFT)
    assert painting.session.mirror and painting.place.tools.mirror.isChecked()
    painting.key(Qt.Key.Key_M)
    assert not painting.session.mirror and not painting.place.brush.mirror.isChecked()
    qtbot.mouseClick(painting.place.tools.mirror, LEFT)
    side = painting.painter.surface.centres @ plane[0] - plane[1]
    painting.session.brush_size = 0.02
    seen = painting.visible()
    painting.click(int(seen[np.abs(side[seen]).argmax()]))
    assert {-1.0, 1.0} <= set(np.sign(side[painting.labels == 0]).tolist())


def test_next_piece_turns_what_is_behind_to_the_front(painting, qtbot):
    """What is seen is painted: the largest piece that is left lies where it can't be seen."""
    painting.session.tool = "lasso"
    w, h = painting.view.width(), painting.view.height()
    painting.drag(*(QPoint(x, y) for x, y in ((4, 4), (w - 4, 4), (w - 4, h - 4), (4, h - 4), (4, 4))))
    piece = painting.place._pieces[0]
    before = np.array(painting.view.scene.camera.GetPosition())
    qtbot.mouseClick(painting.place.next_piece, LEFT)
    note = next(mark for mark in painting.view.shown.views[0].marks if mark.kind == "note")
    x, y = painting.view.place_of(note.at)
    assert 0 <= x <= w and 0 <= y <= h
    assert np.linalg.norm(painting.painter.surface.centres[piece] - note.at, axis=1).min() < 0.1
    if not np.allclose(before, painting.view.scene.camera.GetPosition()):
        assert painting.place.hand.sees(piece), "it turned to where the piece is seen"


# -- Fit -------------------------------------------------------------------------------------------------------------


def test_templates_deform_before_the_eyes_while_the_fit_goes_on(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    pictures, points = [], []
    for number in (0, 1):
        qtbot.mouseClick(place.step, LEFT)
        qtbot.waitUntil(lambda n=number: place.record.newest == n and window.runner.paused, timeout=LONG)
        pictures.append(settled(place.view, qtbot))
        layers = [one for one in place.view.shown.views[1].layers if one.key in ("points", "off")]
        points.append(np.concatenate([one.positions for one in layers]))
        known = place.record.points(window.session.shape, number).positions
        np.testing.assert_allclose(np.sort(points[-1], axis=0), np.sort(known, axis=0), atol=1e-5)
    third = pictures[0].shape[1] // 3
    assert changed(pictures[0][:, third : 2 * third], pictures[1][:, third : 2 * third]) > 1e-3
    assert changed(pictures[0][:, : third - 4], pictures[1][:, : third - 4]) < 1e-3, "the input stands still"
    qtbot.mouseClick(place.stop, LEFT)
    qtbot.waitUntil(lambda: not window.session.running, timeout=LONG)


def test_points_are_coloured_by_movement_and_the_small_pictures_sorted_by_name(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    before = settled(place.view, qtbot)
    choose(qtbot, place.by, "movement")
    place._show_all()
    layer = next(one for one in place.view.shown.views[1].layers if one.key == "points")
    assert not {tuple(c) for c in layer.colours} & {rgb(ink) for ink in PARTS} - {rgb(SWITCHED_OFF)}
    assert changed(before, settled(place.view, qtbot)) > 1e-3
    choose(qtbot, place.also_watching.sort, "name")
    place._show_all()
    names = [one.name for one in place.also_watching.pictures]
    assert names == sorted(names)


# -- Correspondence --------------------------------------------------------------------------------------------------


def test_colours_order_and_number_are_chosen_in_the_menus(lightbox, qtbot):
    place = lightbox
    parts = settled(place.view, qtbot)
    choose(qtbot, place.colour, "template coordinate")
    assert changed(parts, settled(place.view, qtbot)) > 0.01
    choose(qtbot, place.sorting, "name")
    assert list(place.names) == sorted(place.names)
    choose(qtbot, place.showing, "4 at once")
    assert len(place.names) == len(place.view.shown.views) == 4
    choose(qtbot, place.showing, f"all {len(place.session.project.fit_names)}")
    choose(qtbot, place.sorting, "group")
    groups = place.session.project.groups
    order = [int(groups.group[place.session.project.index(name)]) for name in place.names]
    assert order == sorted(order) and len(set(order)) > 1


def test_a_picked_point_is_seen_on_every_shape_with_its_heat(lightbox, qtbot):
    place = lightbox
    before = pixels(place.view)
    click(qtbot, place, point_spot(place, 0, seen_points(place, 0)[2]))
    settled(place.view, qtbot)
    after, ratio = pixels(place.view), place.view.devicePixelRatio()
    for cell, view in enumerate(place.view.shown.views):
        dots = [mark for mark in view.marks if mark.kind == "dot"]
        if dots:
            x, y = (round(ratio * one) for one in place.view.place_of(dots[0].at, cell))
            near = after[y - 3 : y + 4, x - 3 : x + 4] - before[y - 3 : y + 4, x - 3 : x + 4]
            assert (np.abs(near).sum(axis=2) > 60).mean() > 0.3, f"no dot on {view.name}"
    warm = place.view.picture().astype(int)
    assert (warm[..., 0] - warm[..., 2] > 60).mean() > 1e-4, "heat"


# -- closing ---------------------------------------------------------------------------------------------------------


def test_closing_in_the_middle_of_a_stroke_keeps_what_was_painted(painting, qtbot):
    name, path = painting.session.shape, painting.session.project.path
    seen = painting.visible()
    a, b = painting.at(int(seen[0])), painting.at(int(seen[-1]))
    qtbot.mousePress(painting.target, LEFT, Qt.KeyboardModifier.NoModifier, a)
    move(painting.target, b, LEFT, Qt.KeyboardModifier.NoModifier)
    painted = painting.labels.copy()
    assert (painted >= 0).any()
    painting.window.close()
    assert np.array_equal(Project.open(path).labels(name), painted)


def test_closing_while_a_painting_is_filled_in_leaves_no_thread(painting, qtbot, monkeypatch):
    monkeypatch.setattr("shapeforge.viewer.completing.AT_ONCE", 0)
    complete = spreading.complete
    monkeypatch.setattr(spreading, "complete", lambda *given: (time.sleep(0.5), complete(*given))[1])
    name, path = painting.session.shape, painting.session.project.path
    painting.key(Qt.Key.Key_S)
    seen = painting.visible()
    for part, face in enumerate(seen[[0, -1]]):
        painting.key(Qt.Key(Qt.Key.Key_1 + part))
        painting.click(int(face))
    strokes = painting.labels.copy()
    assert painting.place.completion.busy
    painting.window.close()
    assert not any(thread.name == "completing" for thread in threading.enumerate())
    assert np.array_equal(Project.open(path).labels(name), strokes)
