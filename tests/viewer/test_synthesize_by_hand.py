"""What a designer does in Synthesize, with mouse and keys on the real window: the Session and the pixels say what came
of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from shapeforge.viewer import movies
from shapeforge.viewer.display import MeshLayer, PointLayer
from shapeforge.viewer.palette import tokens
from tests.viewer.synthesize_hands import (
    LEFT,
    LONG,
    NONE,
    at,
    choose,
    hue_share,
    layer_kinds,
    pixels,
    seen,
    shown_of,
    slide,
    wait_for_mesh,
)

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
    slide(qtbot, place.inspector.rows[0].slider, place.inspector.rows[0].slider.inner[1])
    assert place.actions.run("reset_sliders") and set(place.session.sliders) == {1}
    assert row.slider.value == pytest.approx(value, abs=1e-3)
    qtbot.mouseClick(row.lock, LEFT)
    assert not place.session.locked and not row.slider.locked


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
            assert movie.n_frames == 4 and movie.size == (60, 60) and (ending != "gif" or movie.info["loop"] == 0)
            first = np.asarray(movie.convert("RGB")).astype(int)
            movie.seek(2)
            assert np.abs(np.asarray(movie.convert("RGB")).astype(int) - first).max() > 30
    with pytest.raises(ValueError, match="wanted an ending"):
        movies.write_movie(tmp_path / "turn.avi", [np.zeros((4, 4, 3), np.uint8)])


def test_a_picture_keeps_the_colours_of_the_theme_and_the_mesh_stays(place, qtbot):
    wait_for_mesh(place, qtbot)
    dark = seen(place, qtbot)
    place.actions.run("theme")
    light = seen(place, qtbot)
    assert light[5, 200].mean() > dark[5, 200].mean() + 80 and layer_kinds(place) == [MeshLayer]
