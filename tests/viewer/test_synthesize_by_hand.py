"""What a designer does in Synthesize, with mouse and keys on the real window: the Session and the pixels say what came
of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from shapeforge.collection.colours import rgb
from shapeforge.stages_recipes import read_recipe, remake
from shapeforge.viewer import movies
from shapeforge.viewer.display import MeshLayer, PointLayer
from shapeforge.viewer.palette import tokens
from shapeforge.viewer.pulling import off_by
from tests.viewer.synthesize_hands import LEFT, LONG, NONE, layer_kinds, wait_for_mesh

CONTROL, RIGHT = Qt.KeyboardModifier.ControlModifier, Qt.MouseButton.RightButton


def at(place: tuple[float, float]) -> QPoint:
    return QPoint(round(place[0]), round(place[1]))


def seen(place, qtbot) -> np.ndarray:
    """The pixels (h, w, 3) of the view, marks and words included, once it has been drawn."""
    qtbot.waitUntil(lambda: place.view.at_rest, timeout=LONG)
    return place.view.picture().astype(int)


def pixels(widget) -> np.ndarray:
    """The pixels (h, w, 3) of a widget."""
    image = widget.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


def shown_of(picture: np.ndarray, colour: str) -> np.ndarray:
    """Places (n, 2), x and y, of the pixels of just this colour."""
    return np.argwhere((picture == rgb(colour)).all(axis=2))[:, ::-1]


def hue_share(picture: np.ndarray, ink: np.ndarray) -> float:
    """The share of pixels that have the hue of an ink, however shaded."""
    length = np.linalg.norm(picture, axis=2)
    along = picture @ (ink / np.linalg.norm(ink.astype(float)))
    return float(((length > 60) & (along > 0.985 * length)).mean())


def drag(place, qtbot, row: int, by: tuple[int, int], *, let_go: bool = True) -> int:
    """Drag a handle of the view; which template point it is."""
    target, start = place.view.plotter, place.view.place_of(place.handles.places[row])
    qtbot.mousePress(target, LEFT, NONE, at(start))
    held = place.handles.held
    assert held is not None
    for share in (0.3, 0.6, 1.0):
        qtbot.mouseMove(target, at((start[0] + share * by[0], start[1] + share * by[1])))
    if let_go:
        qtbot.mouseRelease(target, LEFT, NONE, at((start[0] + by[0], start[1] + by[1])))
    return held.point


def towards(place, row: int, share: float = 0.6) -> tuple[int, int]:
    """By how many pixels a handle has to be dragged to come towards where a shape of the family has it."""
    sculptor, point = place.sculptor, int(place.handles.shown[row])
    alike = np.flatnonzero((sculptor.observations.exists == sculptor.exists()).all(axis=1))
    away = sculptor.positions[alike, point] - place.points[point]
    farthest = away[np.linalg.norm(away, axis=1).argmax()]
    start, end = (
        np.array(place.view.place_of(at)) for at in (place.points[point], place.points[point] + share * farthest)
    )
    return tuple(int(x) for x in np.round(end - start))


def row_of(place, point: int) -> int:
    return int(np.flatnonzero(place.handles.shown == point)[0])


def free_row(place) -> int:
    """A handle that is not pinned."""
    return next(i for i, point in enumerate(place.handles.shown) if int(point) not in place.session.pins)


def choose(menu, words: str, qtbot) -> None:
    """Click an entry of a menu."""
    qtbot.waitUntil(menu.isVisible)
    entry = next(action for action in menu.actions() if action.text() == words)
    qtbot.mouseClick(menu, LEFT, NONE, menu.actionGeometry(entry).center())


def slide(qtbot, slider, value: float) -> None:
    y, start, end = slider.height() - 10, slider.x_of(slider.value), slider.x_of(value)
    qtbot.mousePress(slider, LEFT, NONE, at((start, y)))
    qtbot.mouseMove(slider, at(((start + end) / 2, y)))
    qtbot.mouseMove(slider, at((end, y)))
    qtbot.mouseRelease(slider, LEFT, NONE, at((end, y)))


# ---- points that are pulled --------------------------------------------------------------------------------------


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


# ---- sliders, parts, shapes ----------------------------------------------------------------------------------------


def test_several_sliders_at_once_are_seen_in_pixels_and_undone_one_by_one(place, qtbot):
    wait_for_mesh(place, qtbot)
    pictures, points = [seen(place, qtbot)], [place.points.copy()]
    for index in (0, 1):
        slider = place.inspector.rows[index].slider
        slide(qtbot, slider, slider.inner[1] if slider.value < np.mean(slider.inner) else slider.inner[0])
        wait_for_mesh(place, qtbot)
        pictures.append(seen(place, qtbot))
        points.append(place.points.copy())
    assert set(place.session.sliders) == {0, 1}
    assert all(np.abs(b - a).max() > 60 for a, b in zip(pictures[:-1], pictures[1:], strict=True))
    qtbot.mouseClick(place.strip.cards[1], LEFT, NONE, QPoint(10, 10))
    assert place.sculptor.done == 1 and set(place.session.sliders) == {0}
    np.testing.assert_array_equal(np.nan_to_num(place.points), np.nan_to_num(points[1]))
    qtbot.mouseClick(place.strip.cards[0], LEFT, NONE, QPoint(10, 10))
    assert not place.session.sliders and np.abs(seen(place, qtbot) - pictures[0])[100:-40].max() < 60
    qtbot.mouseClick(place.strip.cards[2], LEFT, NONE, QPoint(10, 10))
    np.testing.assert_array_equal(np.nan_to_num(place.points), np.nan_to_num(points[2]))


def test_you_are_here_moves_with_the_shape_and_a_click_goes_to_another(place, qtbot):
    family, accent = place.inspector.map, tokens("dark")["accent"]

    def marked() -> np.ndarray:
        """Where the accent's disc is on the map, in pixels."""
        return shown_of(pixels(family), accent).mean(axis=0)

    def wanted() -> np.ndarray:
        return family._to_pixels(np.array(place.sculptor.place_on_map(family.places, place.points)))

    places = [marked()]
    assert np.abs(places[0] - wanted()).max() < 2
    for index in range(3):
        slider = place.inspector.rows[index].slider
        slide(qtbot, slider, slider.inner[1] if slider.value < np.mean(slider.inner) else slider.inner[0])
        assert np.abs(marked() - wanted()).max() < 2
    assert np.abs(marked() - places[0]).max() > 1, "it moves with the sliders"
    for index in (len(family.places) - 1, 0, 3):
        qtbot.mouseClick(family, LEFT, NONE, at(family.dot(index)))
        name = place.sculptor.recipe.label
        assert name in place.sculptor.shape_names
        np.testing.assert_allclose(place.points, place.sculptor.points(place.sculptor.recipe), atol=0)
        assert place.sculptor.nearest(place.points)[0] == name
        assert np.abs(marked() - wanted()).max() < 2
        places.append(marked())
    assert np.ptp(places, axis=0).max() > 15
    count = len(place.sculptor.recipes)
    qtbot.mouseClick(family, LEFT, NONE, QPoint(1, 1))
    assert len(place.sculptor.recipes) == count, "nothing is there"


def test_a_part_is_switched_off_and_its_colour_leaves_the_picture(place, qtbot):
    always, exists = place.sculptor.always(), place.sculptor.exists()
    part = next(p for p in place.inspector.switches if not always[p])
    switch = place.inspector.switches[part]
    place.inspector._sections.ensureWidgetVisible(switch)
    if not exists[part]:
        qtbot.mouseClick(switch, LEFT)
    wait_for_mesh(place, qtbot)
    ink = place.sculptor.inks[part]
    there = hue_share(seen(place, qtbot)[100:-40], ink)
    qtbot.mouseClick(switch, LEFT)
    assert place.session.parts_on == {part: False} and place.sculptor.recipe.label.endswith("off")
    wait_for_mesh(place, qtbot)
    assert there > 0.003 and hue_share(seen(place, qtbot)[100:-40], ink) < 0.2 * there
    assert part not in set(place.made.shape.part)


def test_a_shape_is_chosen_from_the_menu(place, qtbot):
    qtbot.mouseClick(place.from_button, LEFT)
    menu = QApplication.activePopupWidget()
    assert [action.text() for action in menu.actions()][2:] == list(place.sculptor.shape_names)
    assert menu.actions()[0].text() == "From a recipe…"
    name = place.sculptor.shape_names[2]
    choose(menu, name, qtbot)
    assert place.sculptor.recipe.label == name
    np.testing.assert_allclose(place.points, place.sculptor.points(place.sculptor.recipe))
    assert place.sculptor.nearest(place.points)[0] == name


def test_a_part_is_taken_from_another_shape_through_the_menus(place, qtbot):
    wait_for_mesh(place, qtbot)
    inspector, part = place.inspector, int(np.flatnonzero(place.sculptor.exists())[1])
    inspector._sections.ensureWidgetVisible(inspector.take_from)
    qtbot.mouseClick(inspector.part_to_take, LEFT)
    choose(QApplication.activePopupWidget(), place.sculptor.part_names[part], qtbot)
    having = np.flatnonzero(place.sculptor.observations.exists[:, part])
    other = next(place.sculptor.shape_names[i] for i in having
                 if place.sculptor.shape_names[i] != place.made.shape.sources[part])  # fmt: skip
    qtbot.mouseClick(inspector.take_from, LEFT)
    choose(QApplication.activePopupWidget(), other, qtbot)
    assert place.sculptor.recipe.taken == {part: other}
    wait_for_mesh(place, qtbot)
    assert place.made.shape.sources[part] == other


def test_the_way_between_two_shapes_is_dragged(place, qtbot):
    qtbot.mouseClick(place.between_button, LEFT)
    bar, count = place.between.bar, len(place.sculptor.recipes)
    assert bar.isVisible() and place.between_button.isChecked() and place.between.share == 0.5
    slider = bar.slider
    span, y = slider.width() - 16, slider.height() // 2
    start = 8 + span * slider.value() / 100
    qtbot.mousePress(slider, LEFT, NONE, at((start, y)))
    shown = []
    for share in (0.6, 0.75, 0.9):
        qtbot.mouseMove(slider, at((8 + span * share, y)))
        shown.append(place.between.share)
        assert place.is_dragging and layer_kinds(place)[-1] is PointLayer
    qtbot.mouseRelease(slider, LEFT, NONE, at((8 + span * 0.9, y)))
    assert shown == sorted(shown) and shown[-1] == pytest.approx(0.9, abs=0.05)
    assert len(place.sculptor.recipes) == count + 1, "one step for the whole drag"
    first, second = (place.sculptor.base_of(name) for name in place.between.ends)
    expected = place.sculptor.between(first, second, place.between.share)
    np.testing.assert_allclose(place.sculptor.recipe.base.first, expected.first, atol=1e-6)
    assert bar.value.text() == f"{place.between.share:.0%}"
    assert place.inspector.map.ends is not None
    qtbot.mouseClick(place.between_button, LEFT)
    assert not bar.isVisible()


def test_pointing_with_the_mouse_shows_heat_in_pixels(place, qtbot):
    wait_for_mesh(place, qtbot)
    plain = seen(place, qtbot)
    QTest.mouseMove(place.view, QPoint(3, 3))
    qtbot.wait(30)
    QTest.mouseMove(place.inspector.rows[0].name, QPoint(5, 5))
    qtbot.waitUntil(lambda: place.shows.heated == 0, timeout=LONG)
    hot = seen(place, qtbot)
    inside = np.s_[100:-40]
    assert (np.abs(hot[inside] - plain[inside]).max(axis=2) > 40).mean() > 0.02
    QTest.mouseMove(place.view, QPoint(3, 3))
    qtbot.waitUntil(lambda: place.shows.heated is None, timeout=LONG)
    assert np.abs(seen(place, qtbot)[inside] - plain[inside]).max() < 30


def test_a_lock_is_clicked_and_its_slider_stays(place, qtbot):
    row = place.inspector.rows[1]
    slide(
        qtbot, row.slider, row.slider.inner[1] if row.slider.value < np.mean(row.slider.inner) else row.slider.inner[0]
    )
    value = row.slider.value
    qtbot.mouseClick(row.lock, LEFT)
    assert place.session.locked == {1} and row.slider.locked
    slide(qtbot, row.slider, row.slider.inner[0])
    qtbot.keyClick(place.centre, Qt.Key.Key_R)
    assert place.sculptor.recipe.label == "random" and row.slider.value == pytest.approx(value, abs=1e-3)
    qtbot.mouseClick(row.lock, LEFT)
    assert not place.session.locked and not row.slider.locked


def test_a_draw_of_the_gallery_is_taken_with_the_mouse(place, qtbot):
    qtbot.keyClick(place.centre, Qt.Key.Key_G)
    gallery = place.shows.gallery
    assert gallery.isVisible() and len(gallery.cards) == 12 and place.gallery_button.isChecked()
    wanted = gallery.recipes[5]
    qtbot.mouseClick(gallery.cards[5], LEFT, NONE, QPoint(40, 40))
    assert not gallery.isVisible() and place.view.isVisible() and not place.gallery_button.isChecked()
    np.testing.assert_array_equal(place.sculptor.recipe.base.first, wanted.base.first)
    np.testing.assert_allclose(place.points, place.sculptor.points(wanted))
    qtbot.keyClick(place.centre, Qt.Key.Key_Z, CONTROL)
    assert place.sculptor.recipe.label == "mean"


# ---- files -------------------------------------------------------------------------------------------------------


def test_every_format_is_exported_with_names_colours_and_a_recipe(place, qtbot, tmp_path, monkeypatch):
    wait_for_mesh(place, qtbot)
    shape, names = place.made.shape, place.sculptor.part_names
    own = [names[part] for part in np.unique(shape.part)]
    inks = {names[part]: place.sculptor.inks[part].tolist() for part in np.unique(shape.part)}
    for ending in ("glb", "obj", "ply", "stl"):
        path = tmp_path / f"chair.{ending}"
        monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name, path=path: path)
        qtbot.mouseClick(place.inspector.export, LEFT)
        assert place.session.status == f"Saved chair.{ending} and its recipe"
        mesh = trimesh.load(path, process=False)
        whole = mesh.to_geometry() if isinstance(mesh, trimesh.Scene) else mesh
        assert len(whole.faces) == len(shape.triangles), ending
        np.testing.assert_allclose(whole.bounds, [shape.vertices.min(axis=0), shape.vertices.max(axis=0)], atol=1e-5)
        recipe = json.loads((tmp_path / f"chair.{ending}.recipe.json").read_text("utf-8"))
        assert recipe["parts"] == own and recipe["label"] == "mean" and recipe["unit"].startswith("1 is the diagonal")
        if ending == "glb":
            found = {name: one.visual.material.baseColorFactor[:3].tolist() for name, one in mesh.geometry.items()}
            assert found == inks
        elif ending == "obj":
            groups = [line[2:] for line in path.read_text().splitlines() if line.startswith("g ")]
            assert groups == own and "Kd" in path.with_suffix(".mtl").read_text()
        elif ending == "ply":
            shades = {tuple(shade[:3]) for shade in np.asarray(mesh.visual.face_colors)}
            assert shades == {tuple(ink) for ink in inks.values()}


def test_the_view_turns_around_and_a_movie_of_it_is_saved(place, qtbot, tmp_path, monkeypatch):
    wait_for_mesh(place, qtbot)
    before = seen(place, qtbot)
    qtbot.keyClick(place.centre, Qt.Key.Key_T)
    assert place.shows.spin.is_on
    start = np.array(place.view.scene.camera.GetPosition())
    qtbot.waitUntil(lambda: np.linalg.norm(np.array(place.view.scene.camera.GetPosition()) - start) > 0.1, timeout=LONG)
    qtbot.keyClick(place.centre, Qt.Key.Key_T)
    assert not place.shows.spin.is_on and np.abs(seen(place, qtbot) - before).max() > 60
    small = movies.turntable
    monkeypatch.setattr(movies, "turntable", lambda layer, theme: small(layer, 4, (60, 60), theme))
    for ending in ("gif", "webp", "png"):
        path = tmp_path / f"turn.{ending}"
        monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name, path=path: path)
        assert place.actions.run("export_movie")
        with Image.open(path) as movie:
            assert movie.n_frames == 4
            first = np.asarray(movie.convert("RGB")).astype(int)
            movie.seek(2)
            assert np.abs(np.asarray(movie.convert("RGB")).astype(int) - first).max() > 30


def test_a_picture_keeps_the_colours_of_the_theme_and_the_mesh_stays(place, qtbot):
    wait_for_mesh(place, qtbot)
    dark = seen(place, qtbot)
    place.actions.run("theme")
    light = seen(place, qtbot)
    assert light[5, 200].mean() > dark[5, 200].mean() + 80 and layer_kinds(place) == [MeshLayer]
