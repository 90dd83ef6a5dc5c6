"""Collection, changed by hand: members, merging, splitting, the large view and turning, by mouse and keys."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QContextMenuEvent
from PySide6.QtWidgets import QApplication

from shapeforge import stages
from shapeforge.collection.groups import Groups
from shapeforge.store import Project
from shapeforge.viewer.regroup import second_half, tidied
from shapeforge.viewer.turning import AXES, about, ring
from tests.viewer.paint_hands import move
from tests.viewer.test_collection_place import spot, two_of_a_group

LEFT, CTRL = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ControlModifier


@pytest.fixture
def window(open_window, grouped):
    return open_window(grouped)


@pytest.fixture
def place(window):
    return window.places["collection"]


def choose(qtbot, menus, text: str) -> None:
    """Choose a line of the menu that is open."""
    menu = menus.open_menu
    action = next(a for a in menu.actions() if text in a.text())
    qtbot.mouseClick(menu, LEFT, pos=menu.actionGeometry(action).center())


def some_groups() -> Groups:
    position = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 9.0])
    distance = np.abs(np.subtract.outer(position, position))
    plane = np.stack([position, np.zeros(6)], axis=1)
    return Groups(("all", "last"), np.array([0, 0, 0, 0, 0, 1]), np.array([1, 5]), plane, distance)


# -- groups ----------------------------------------------------------------------------------------------------------


def test_the_second_half_is_what_is_unlike_the_exemplar():
    assert second_half(some_groups(), 0).tolist() == [3, 4]


def test_groups_without_members_go_and_lost_exemplars_are_replaced():
    groups = some_groups()
    groups.group[:] = [1, 1, 0, 0, 0, 1]
    after = tidied(groups)
    assert after.names == ("all", "last") and after.exemplars.tolist() == [3, 5]
    groups.group[:] = 1
    after = tidied(groups)
    assert after.names == ("last",) and after.exemplars.tolist() == [5] and set(after.group.tolist()) == {0}


def test_shapes_move_to_another_group_by_the_key_g(window, place, qtbot):
    project = place.session.project
    if len(project.groups) < 2:
        window.actions_table.run("split_group")
    g, _, other = two_of_a_group(project)
    before = project.groups
    target = next(h for h in range(len(before)) if h != g)
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, other))
    qtbot.keyClick(place.map, Qt.Key.Key_G)
    choose(qtbot, place.menus, before.names[target])
    t = project.names.index(other)
    assert project.groups.names[project.groups.group[t]] == before.names[target]
    assert place.map.content.group[t] == project.groups.group[t]
    window.session.undo()
    assert np.array_equal(project.groups.group, before.group)


def test_the_exemplar_moved_away_leaves_a_group_with_another(window, place, qtbot):
    project = place.session.project
    g, exemplar, other = two_of_a_group(project)
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, exemplar))
    qtbot.mouseClick(place.selection.new, LEFT)
    groups = project.groups
    own = int(groups.group[project.names.index(exemplar)])
    assert project.names[groups.exemplars[own]] == exemplar and len(groups.members(own)) == 1
    rest = int(groups.group[project.names.index(other)])
    assert rest != own and groups.exemplars[rest] in groups.members(rest)
    assert window.session.group == own
    assert not place.selection.new.isEnabled() and "already" in place.selection.new.toolTip()
    qtbot.keyClick(place.map, Qt.Key.Key_Z, CTRL)
    assert len(project.groups) == len(groups) - 1


def test_a_group_is_split_and_merged_again(window, place, qtbot):
    project = place.session.project
    g, exemplar, _ = two_of_a_group(project)
    called, count = project.groups.names[g], len(project.groups)
    qtbot.mouseClick(place.groups.rows[g], LEFT)
    qtbot.keyClick(place.map, Qt.Key.Key_S)
    assert len(project.groups) == count + 1 == len(place.groups.rows)
    assert project.names[project.groups.exemplars[project.groups.names.index(called)]] == exemplar
    assert stages.status(Project.open(project.path))["group"].state == "done"
    fresh = window.session.group
    qtbot.mouseClick(place.groups.rows[fresh], LEFT)
    qtbot.keyClick(place.map, Qt.Key.Key_M)
    choose(qtbot, place.menus, called)
    assert len(project.groups) == count
    assert project.names[project.groups.exemplars[project.groups.names.index(called)]] == exemplar


def test_a_right_click_offers_what_can_be_done_to_the_shape_under_it(window, place, qtbot):
    project = place.session.project
    _, exemplar, _ = two_of_a_group(project)
    at = spot(place, exemplar)
    event = QContextMenuEvent(QContextMenuEvent.Reason.Mouse, at, place.map.mapToGlobal(at))
    QApplication.sendEvent(place.map, event)
    assert window.session.shape == exemplar
    offered = {a.text().split("\t")[0]: a for a in place.menus.open_menu.actions() if a.text()}
    assert {"Paint it", "Turn…", "Make it the exemplar", "New group", "Leave out"} <= offered.keys()
    assert not offered["Leave out"].isEnabled() and "is an exemplar" in offered["Leave out"].toolTip()
    place.menus.open_menu.close()


def test_several_shapes_are_left_out_at_once_and_put_back(window, place, qtbot):
    project, groups = place.session.project, place.session.project.groups
    loose = [name for t, name in enumerate(project.names) if t not in groups.exemplars][:2]
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, loose[0]))
    qtbot.mouseClick(place.map, LEFT, CTRL, pos=spot(place, loose[1]))
    qtbot.keyClick(place.map, Qt.Key.Key_X)
    assert sorted(project.names[t] for t in np.flatnonzero(project.groups.group < 0)) == sorted(loose)
    assert place.selection.out.text() == "Put it back"
    qtbot.mouseClick(place.selection.out, LEFT)
    assert (project.groups.group >= 0).all()


# -- the large view --------------------------------------------------------------------------------------------------


def large(window, place, qtbot, *names: str):
    place._select(names)
    qtbot.keyClick(place.map, Qt.Key.Key_3)
    qtbot.waitUntil(lambda: place.large is not None and place.large.view.at_rest, timeout=20000)
    return place.large


def test_selected_shapes_are_seen_large_and_linked(window, place, qtbot):
    names = place.session.project.names[:3]
    seen = large(window, place, qtbot, *names)
    assert seen.names == names and len(seen.view.shown.views) == 3
    ground = seen.view.picture()[3, 3].astype(int)
    for x, y, w, h in seen.view.rectangles()[:3]:
        cell = seen.view.picture()[y + 40 : y + h - 10, x + 10 : x + w - 10].astype(int)
        assert (np.abs(cell - ground).sum(axis=2) > 60).mean() > 0.02
    qtbot.keyClick(place.centre, Qt.Key.Key_1)
    assert window.session.arrangement == "map" and place.pages.currentIndex() == 0


def test_a_click_in_the_large_view_selects_and_a_double_click_paints(window, place, qtbot):
    names = place.session.project.names[:2]
    seen = large(window, place, qtbot, *names)
    mesh = seen.view.shown.views[1].layers[0]
    at = QPointF(*seen.view.place_of(mesh.vertices[mesh.triangles[0]].mean(axis=0), 1)).toPoint()
    qtbot.mouseClick(seen.view.plotter, LEFT, pos=at)
    assert window.session.shape == names[1] and window.session.selected == names
    qtbot.mouseDClick(seen.view.plotter, LEFT, pos=at)
    assert window.session.place == "paint" and window.session.shape == names[1]


# -- turning ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", range(3))
def test_a_turn_is_counter_clockwise_about_its_axis(axis):
    a, b = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    assert np.allclose(about(axis, 90) @ a, b) and np.allclose(about(axis, 90) @ np.eye(3)[axis], np.eye(3)[axis])
    assert np.allclose(about(axis, 30) @ about(axis, 60), about(axis, 90))


def test_a_shape_is_turned_by_keys_kept_and_taken_back(window, place, qtbot):
    project = place.session.project
    name = project.names[0]
    before = project.shapes.named(name)
    qtbot.mouseClick(place.map, LEFT, pos=spot(place, name))
    qtbot.keyClick(place.map, Qt.Key.Key_O)
    assert window.session.turn is not None and window.session.arrangement == "large"
    qtbot.waitUntil(lambda: place.large.view.at_rest, timeout=20000)
    first = place.large.view.picture().astype(int)
    qtbot.keyClick(place.large.view, Qt.Key.Key_X, Qt.KeyboardModifier.ShiftModifier)
    qtbot.waitUntil(lambda: place.large.view.at_rest, timeout=20000)
    qtbot.wait(300)
    assert (np.abs(place.large.view.picture().astype(int) - first).sum(axis=2) > 60).mean() > 0.01
    qtbot.keyClick(place.large.view, Qt.Key.Key_Return)
    assert window.session.turn is None and window.session.place == "collection"
    after = project.shapes.named(name)
    assert np.allclose(after.normals, before.normals @ about(0, 90).T, atol=1e-6)
    assert "turned" in window.session.status
    qtbot.keyClick(place.large.view, Qt.Key.Key_Z, CTRL)
    assert np.array_equal(project.shapes.named(name).points, before.points)


def test_dragging_a_ring_turns_about_its_axis(window, place, qtbot):
    name = place.session.project.names[1]
    place._select((name,))
    window.actions_table.run("turn_shape")
    seen = place.large
    qtbot.waitUntil(lambda: seen.view.at_rest, timeout=20000)
    for axis in range(3):
        places = ring(axis)
        towards = places @ seen.view._camera(0).GetDirectionOfProjection()
        start = int(np.argmin(towards))  # in front
        ends = [QPointF(*seen.view.place_of(places[(start + i) % len(places)])).toPoint() for i in (0, 4, 8)]
        if seen.ring_at(ends[0].x(), ends[0].y())[0] != axis:
            continue  # two rings cross here
        qtbot.mousePress(seen.view.plotter, LEFT, pos=ends[0])

        for end in ends[1:]:
            move(seen.view.plotter, end, LEFT, Qt.KeyboardModifier.NoModifier)
        qtbot.mouseRelease(seen.view.plotter, LEFT, pos=ends[-1])
        turned = np.array(window.session.turn)
        assert np.allclose(turned, about(axis, 30), atol=1e-6), AXES[axis]
        window.session.turn = tuple(map(tuple, np.eye(3).tolist()))
    qtbot.keyClick(seen.view, Qt.Key.Key_Escape)
    assert window.session.turn is None and place.large.bars.currentIndex() == 0


def test_a_turn_about_something_else_leaves_the_comparison_alone(window, place, qtbot):
    project = place.session.project
    _, exemplar, other = two_of_a_group(project)
    place._select((other,))
    window.actions_table.run("turn_shape")
    assert place.large.names == (other, exemplar)
    vertices = place.large.view.shown.views[1].layers[0].vertices
    window.actions_table.run("turn_y")
    assert place.large.view.shown.views[1].layers[0].vertices is vertices
    assert [window.actions_table.verdict(f"turn_{axis}")[0] for axis in AXES] == [True] * 3
    window.session.arrangement = "map"
    qtbot.keyClick(place.centre, Qt.Key.Key_Escape)
    assert window.actions_table.verdict("turn_x") == (False, "Nothing is being turned: press O first.")


def test_escape_gives_up_choosing_and_then_the_selection(window, place, qtbot):
    g, _, other = two_of_a_group(place.session.project)
    qtbot.mouseClick(place.groups.rows[g], LEFT)
    qtbot.mouseClick(place.choose_button, LEFT)
    assert place.choosing
    qtbot.keyClick(place.map, Qt.Key.Key_Escape)
    assert not place.choosing
    qtbot.mouseClick(place.map, LEFT, pos=QPoint(*(spot(place, other).toTuple())))
    qtbot.keyClick(place.map, Qt.Key.Key_Escape)
    assert window.session.shape is None and window.session.selected == ()


def test_a_whole_group_is_left_out_with_its_exemplar(window, place, qtbot):
    project = place.session.project
    if len(project.groups) < 2:
        window.actions_table.run("split_group")
    before = project.groups
    g, exemplar, _ = two_of_a_group(project)
    qtbot.mouseClick(place.groups.rows[g], LEFT)
    qtbot.keyClick(place.map, Qt.Key.Key_L, Qt.KeyboardModifier.ShiftModifier)
    assert len(project.groups) == len(before) - 1 and before.names[g] not in project.groups.names
    assert project.groups.group[project.names.index(exemplar)] == -1
    assert exemplar not in place.strip.card_of
    while len(project.groups) > 1:
        window.actions_table.run("leave_group")
    assert not window.actions_table.verdict("leave_group")[0]
    while window.session.history.undo_label:
        window.session.undo()
    assert set(before.names) <= {*project.groups.names, "Group 1", "Group 2"}


def test_no_key_means_two_things_in_a_place(open_window, grouped):
    window = open_window(grouped, "paint")
    window.place("collection")
    for name in ("collection", "paint"):
        keys = [a.shortcut for a in window.actions_table.values() if a.place in (None, name) and a.shortcut]
        assert sorted(keys) == sorted(set(keys)), name


def test_the_map_comes_by_itself_when_there_are_groups(open_window, grouped):
    groups = grouped.groups
    grouped._metadata["groups"] = None
    window = open_window(grouped)
    place = window.places["collection"]
    assert place.mode.button("grid").isChecked() and not place.mode.button("map").isEnabled()
    grouped._metadata["groups"] = "known"
    assert grouped.groups is not None and len(groups)
    window.session.touch("groups")
    assert place.mode.button("map").isChecked() and not place.map.rows
