"""Points that are pulled and pinned, with mouse and keys on the real window."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from shapeforge.stages_recipes import read_recipe, remake
from shapeforge.viewer.display import PointLayer
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.pulling import off_by
from tests.viewer.synthesize_hands import (
    CONTROL,
    LEFT,
    LONG,
    NONE,
    RIGHT,
    at,
    choose,
    drag,
    free_row,
    layer_kinds,
    row_of,
    seen,
    shown_of,
    slide,
    towards,
    wait_for_mesh,
)


def test_handles_that_were_pulled_stay_where_they_were_put(place, qtbot):
    """One, then another: both are pins, seen as such, and the first is as near as before."""
    wait_for_mesh(place, qtbot)
    camera, before, empty = place.view.scene.camera.GetPosition(), place.points.copy(), seen(place, qtbot)
    first = drag(place, qtbot, 0, towards(place, 0), let_go=False)
    assert any(mark.kind == "arrow" for mark in place.view.shown.views[0].marks) and place.is_dragging
    assert layer_kinds(place)[-1] is PointLayer, "points at once"
    qtbot.mouseRelease(place.view.plotter, LEFT)
    assert list(place.session.pins) == [first] and place.sculptor.recipe.label.endswith("pulled")
    moved = off_by(before, first, place.session.pins[first]), off_by(place.points, first, place.session.pins[first])
    assert moved[1] < 0.8 * moved[0], "it came nearer to where it was pulled"
    assert np.nanmax(np.abs(place.sculptor.values() - place.sculptor.home())) > 0.02, "the sliders go along"
    second = drag(place, qtbot, free_row(place), towards(place, free_row(place)))
    assert list(place.session.pins) == [first, second] and place.handles.held is None
    assert off_by(place.points, first, place.session.pins[first]) < max(0.8 * moved[0], 0.012)
    assert [mark.kind for mark in place.view.shown.views[0].marks].count("pin") == 2
    assert place.view.scene.camera.GetPosition() == camera, "the view did not turn"
    assert place.inspector.pins.isVisible() and sorted(place.inspector.pins.rows) == sorted([first, second])
    wait_for_mesh(place, qtbot)
    accent = tokens("dark")["accent"]
    assert len(shown_of(seen(place, qtbot), accent)) > len(shown_of(empty, accent)) + 80
    for pins in ([first], []):  # one step a pin, with the keys
        qtbot.keyClick(place.centre, Qt.Key.Key_Z, CONTROL)
        assert list(place.session.pins) == pins
    assert np.array_equal(np.nan_to_num(place.points), np.nan_to_num(before)) and not place.inspector.pins.isVisible()
    qtbot.keyClick(place.centre, Qt.Key.Key_Z, CONTROL | Qt.KeyboardModifier.ShiftModifier)
    assert list(place.session.pins) == [first]


def test_pins_are_put_and_taken_away_in_many_ways(place, qtbot):
    target, session = place.view.plotter, place.session
    points = [int(k) for k in place.handles.shown[:3]]
    before = place.points.copy()
    for point in points:  # a click pins a point where it is, and the shape stays
        qtbot.mouseClick(target, LEFT, NONE, at(place.view.place_of(place.handles.places[row_of(place, point)])))
    assert list(session.pins) == points and np.nanmax(np.abs(place.points - before)) < 0.01
    qtbot.mouseClick(target, LEFT, CONTROL, at(place.view.place_of(place.handles.places[row_of(place, points[0])])))
    assert list(session.pins) == points[1:] and place.sculptor.recipe.label.endswith("unpinned")
    where = at(place.view.place_of(place.handles.places[row_of(place, points[1])]))
    QTest.mouseMove(target, where)
    qtbot.waitUntil(lambda: place.handles.pointed == points[1], timeout=LONG)
    assert "Ctrl+click" in target.toolTip() and target.cursor().shape() is Qt.CursorShape.OpenHandCursor
    qtbot.keyClick(place.centre, Qt.Key.Key_Delete)
    assert list(session.pins) == [points[2]]
    qtbot.mouseClick(target, RIGHT, NONE, at(place.view.place_of(place.handles.places[row_of(place, points[2])])))
    choose(place.handles.menu, "Take the pin away", qtbot)
    assert not session.pins and not place.actions.verdict("unpin")[0]
    undone = len(place.sculptor.recipes)
    qtbot.keyClick(place.centre, Qt.Key.Key_Delete)
    assert len(place.sculptor.recipes) == undone and session.status == "Nothing is pinned."
    qtbot.keyClick(place.centre, Qt.Key.Key_Z, CONTROL)
    assert list(session.pins) == [points[2]], "taking away is undone, too"
    qtbot.mouseClick(place.inspector.pins.rows[points[2]].away, LEFT)
    assert not session.pins


def test_a_second_button_in_the_middle_of_a_pull_changes_nothing(place, qtbot):
    point, target, camera = int(place.handles.shown[0]), place.view.plotter, place.view.scene.camera.GetPosition()
    x, y = place.view.place_of(place.handles.places[0])
    qtbot.mousePress(target, LEFT, NONE, at((x, y)))
    qtbot.mouseMove(target, at((x, y - 20)))
    qtbot.mousePress(target, RIGHT, NONE, at((x, y - 20)))
    qtbot.mouseRelease(target, RIGHT, NONE, at((x, y - 20)))
    assert place.handles.held is not None and place.is_dragging
    qtbot.mouseMove(target, at((x, y - 30)))
    qtbot.mouseRelease(target, LEFT, NONE, at((x, y - 30)))
    assert place.handles.held is None and not place.is_dragging and list(place.session.pins) == [point]
    assert place.sculptor.recipe.label.endswith("pulled") and place.view.scene.camera.GetPosition() == camera


def test_any_place_of_the_surface_is_pinned_from_its_menu_and_all_pins_go_at_once(place, qtbot):
    wait_for_mesh(place, qtbot)
    middle = np.nanmean(place.points[place.sculptor.part == int(np.flatnonzero(place.sculptor.exists())[-1])], axis=0)
    spot = place.view.place_of(place.points[np.nanargmin(np.linalg.norm(place.points - middle, axis=1))])
    pick = place.view.pick_near(*spot)
    assert pick is not None and place.handles.at(*spot) is None
    qtbot.mouseClick(place.view.plotter, RIGHT, NONE, at(spot))
    point = int(np.nanargmin(np.linalg.norm(place.points - pick.position, axis=1)))
    choose(place.handles.menu, f"Pin the {place.handles.part_of(point)} here", qtbot)
    assert list(place.session.pins) == [point]
    qtbot.mouseClick(place.view.plotter, LEFT, NONE, at(place.view.place_of(place.handles.places[free_row(place)])))
    assert len(place.session.pins) == 2 and place.actions.verdict("reset_sliders")[0]
    assert place.actions.run("reset_sliders") and not place.session.pins
    assert place.actions.verdict("reset_sliders") == (False, "No free slider has been moved, and nothing is pinned.")
    qtbot.keyClick(place.centre, Qt.Key.Key_Z, CONTROL)
    assert len(place.session.pins) == 2
    qtbot.keyClick(place.centre, Qt.Key.Key_Delete, Qt.KeyboardModifier.ShiftModifier)
    assert not place.session.pins


def test_a_pin_out_of_reach_says_so_and_a_line_leads_to_it(place, qtbot):
    point = drag(place, qtbot, 0, (-220, -200))
    marks = [mark.kind for mark in place.view.shown.views[0].marks]
    assert marks.count("line") == 1 and marks.count("pin") == 1
    one = place.inspector.pins.rows[point]
    assert float(one.off.text().partition("%")[0]) > 5 and "no shape" in one.off.toolTip()
    assert one.off.property("role") == "caption_warning"
    away = place.sculptor.nearest(place.points)[1]
    assert away < 0.12, "and the shape is not torn for it"


def test_draws_and_the_gallery_keep_pinned_points(place, qtbot):
    handle = place.view.place_of(place.handles.places[0])
    point = int(place.handles.shown[0])
    qtbot.mouseClick(place.view.plotter, LEFT, NONE, at(handle))
    pin = place.session.pins[point]
    assert place.inspector.draws.kept.text() == "They keep: 1 pin."
    kept, tops = [], []
    for _ in range(4):
        qtbot.keyClick(place.centre, Qt.Key.Key_R)
        assert place.sculptor.recipe.label == "random" and place.session.pins == {point: pin}
        kept.append(off_by(place.points, point, pin))
        tops.append(place.points.copy())
    place.inspector.pins.rows[point].away.setFocus()
    qtbot.keyClick(place.inspector.pins.rows[point].away, Qt.Key.Key_Space)
    assert QApplication.focusWidget() is place.centre, "the keys are not lost with the button"
    free = []
    for _ in range(4):
        qtbot.keyClick(place.centre, Qt.Key.Key_R)
        assert place.sculptor.recipe.label == "random"
        free.append(off_by(place.points, point, pin) if np.isfinite(place.points[point]).all() else 0.5)
    assert max(kept) < 0.03 and np.mean(kept) < 0.5 * np.mean(free), (kept, free)
    assert np.nanmean(np.abs(tops[0] - tops[1])) > 0.001, "and differ elsewhere"


def test_pins_are_written_beside_an_export_and_taken_up_again(place, qtbot, tmp_path, monkeypatch, sources):
    point = drag(place, qtbot, 0, (0, -40))
    qtbot.mouseClick(place.inspector.rows[0].lock, LEFT)
    assert place.session.locked == {0} and place.sculptor.recipe.label.endswith(" locked")
    wait_for_mesh(place, qtbot)
    shape, points = place.made.shape, place.points.copy()
    monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name: tmp_path / "chair.glb")
    qtbot.keyClick(place.centre, Qt.Key.Key_E, CONTROL)
    recipe = read_recipe(tmp_path / "chair.glb.recipe.json")
    (pin,) = recipe["pins"]
    assert pin["point"] == point and pin["part"] == place.handles.part_of(point)
    assert pin["at"] == list(place.session.pins[point]) and pin["off_by"] == pytest.approx(
        off_by(points, point, place.session.pins[point]), abs=1e-5
    )
    np.testing.assert_array_equal(remake(place.session.project, recipe, sources).vertices, shape.vertices)
    place.take_mean()
    place.inspector.rows[0].lock.click()
    monkeypatch.setattr(place.actions.desk, "choose_files", lambda *_: (tmp_path / "chair.glb.recipe.json",))
    place.actions.run("open_recipe")
    assert place.session.pins == {point: tuple(pin["at"])} and place.session.locked == {0}
    np.testing.assert_allclose(place.points, points, atol=2e-4)


def test_a_slider_is_pulled_against_pins(place, qtbot):
    """It moves as far as the pins allow, they stay, and its value is the shape's."""
    for _ in range(2):
        qtbot.mouseClick(place.view.plotter, LEFT, NONE, at(place.view.place_of(place.handles.places[free_row(place)])))
    pins = dict(place.session.pins)
    slider = place.inspector.rows[0].slider
    before, goal = place.points.copy(), slider.inner[1] if slider.value < np.mean(slider.inner) else slider.inner[0]
    slide(qtbot, slider, goal)
    assert np.nanmax(np.abs(place.points - before)) > 1e-3 and place.session.pins == pins
    assert max(off_by(place.points, point, pin) for point, pin in pins.items()) < 0.03
    assert slider.value == pytest.approx(np.clip(place.sculptor.values()[0], slider.low, slider.high), abs=1e-6)


def test_twins_pinned_unlike_are_said_to_be_and_the_recipe_has_it(place, qtbot, tmp_path, monkeypatch, sources):
    sculptor, points = place.sculptor, place.points
    mirror, part = sculptor.mirror(), sculptor.part
    there = np.isfinite(points).all(axis=1) & mirror.symmetric[part]
    k = int(np.where(there, np.abs(points @ mirror.normal - mirror.place(points, part)), 0.0).argmax())
    twin = int(mirror.partner[k])
    place.session.pins = {k: tuple(points[k] + [0.0, 0.04, 0.0])}
    assert not place.inspector.pins.unlike.isVisible(), "one side alone takes the other along"
    place.session.pins = {**place.session.pins, twin: tuple(points[twin])}
    said, name = place.inspector.pins.unlike, sculptor.part_names[part[k]]
    assert said.isVisible() and said.text().startswith("Pinned unlike on both sides") and name in said.text()
    place.handles.let_go("pinned")
    wait_for_mesh(place, qtbot)
    monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name: tmp_path / "chair.glb")
    qtbot.keyClick(place.centre, Qt.Key.Key_E, CONTROL)
    recipe, shape = read_recipe(tmp_path / "chair.glb.recipe.json"), place.made.shape
    assert name in recipe["unsymmetric"]
    np.testing.assert_array_equal(remake(place.session.project, recipe, sources).vertices, shape.vertices)
    for without in ("bend", "unsymmetric"):
        other = remake(place.session.project, {key: recipe[key] for key in recipe if key != without}, sources)
        assert other.vertices.shape != shape.vertices.shape or np.abs(other.vertices - shape.vertices).max() > 0.004
