"""New shapes in the real window: sliders move points at once, a mesh follows, and all of it can be undone."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt

from shapeforge.stages_recipes import read_recipe, remake
from shapeforge.viewer.display import MeshLayer, PointLayer
from shapeforge.viewer.mesh_worker import MeshWorker, Wish
from shapeforge.viewer.palette import heat
from shapeforge.viewer.sculptor import Recipe
from shapeforge.viewer.sculptor_files import export_mesh
from shapeforge.viewer.sculpture import measure_words
from tests.viewer.synthesize_hands import LEFT, LONG, NONE, layer_kinds, wait_for_mesh

# ---- the worker ---------------------------------------------------------------------------------


def test_what_pulling_needs_is_found_while_nobody_waits_for_a_mesh(place, qtbot, monkeypatch):
    found, mirror = [], place.sculptor.mirror
    monkeypatch.setattr(type(mirror), "__call__", lambda self: found.append(threading.current_thread().name) or 1)
    wait_for_mesh(place, qtbot)
    place.actions.run("random_shape")
    wait_for_mesh(place, qtbot)
    qtbot.waitUntil(lambda: bool(found), timeout=LONG)
    assert set(found) == {"meshes"}


def test_the_worker_makes_the_newest_wish_only(sculptor, monkeypatch):
    begun, go, made = threading.Event(), threading.Event(), []

    def slow(self, wish):
        begun.set()
        go.wait(10)
        made.append(wish.number)
        return RuntimeError("as good as a mesh")

    monkeypatch.setattr(MeshWorker, "_make", slow)
    arrived = threading.Semaphore(0)
    worker = MeshWorker(sculptor.session, sculptor.nearest, arrived.release)
    points, exists = sculptor.points(), sculptor.exists()
    wishes = {number: Wish(number, points, exists, False) for number in range(5)}
    worker.ask(wishes[1])
    assert begun.wait(10)
    for number in (2, 3, 4):
        worker.ask(wishes[number])
    worker.ask(wishes[1])  # is under way: nothing else is wanted any more
    assert worker._wish is None
    worker.ask(wishes[4])
    go.set()
    assert arrived.acquire(timeout=10) and arrived.acquire(timeout=10)
    assert made == [1, 4] and isinstance(worker.take(), RuntimeError) and worker.take() is None
    worker.close()


def test_parts_that_may_be_wanted_next_are_read_while_nothing_is(sculptor, monkeypatch):
    """One shape at a time, the nearest first, and a wish goes before them."""
    monkeypatch.setattr("shapeforge.viewer.mesh_worker.REST", 0.05)
    worker = MeshWorker(sculptor.session, sculptor.nearest, lambda: None)
    try:
        points = sculptor.points(Recipe("one", sculptor.base_of(sculptor.shape_names[3])))
        worker.ask(Wish(1, points, sculptor.exists(), False))
        wait = time.monotonic() + 60
        while worker._sources[1] is None or worker._wish is not None or worker._ahead or worker._current is not None:
            assert time.monotonic() < wait
            time.sleep(0.02)
        time.sleep(0.3)
        assert all(worker._sources[1].is_read(t) for t in range(len(sculptor.shape_names)))
        assert worker.take() is not None and not worker.busy
    finally:
        worker.close()


def test_measures_in_words():
    words = measure_words({"largest_gap": 0.0012, "symmetry_error": None, "folded_triangles": 1})
    assert words == "gaps 0.1% · 1 folded triangle"


# ---- the place ---------------------------------------------------------------------------------------------------


def test_it_begins_with_the_mean_as_points_and_then_a_mesh(place, qtbot):
    assert place.sculptor.recipe.label == "mean"
    wait_for_mesh(place, qtbot)
    assert layer_kinds(place) == [MeshLayer]
    assert place.inspector.export.isEnabled()
    corners = {caption.corner: caption for caption in place.view.shown.views[0].captions}
    assert "gaps" in corners["bottom right"].lines[0][0] and "nearest real shape" in corners["top right"].lines[1][0]


def test_a_dragged_slider_moves_points_at_once_and_is_one_undo_item(place, qtbot):
    slider, table = place.inspector.rows[0].slider, place.actions
    y = slider.height() - 10
    home = float(place.sculptor.home()[0])
    x0, x1 = round(slider.x_of(home)), round(slider.x_of(slider.inner[1]))
    before = place.points.copy()
    qtbot.mousePress(slider, LEFT, NONE, QPoint(x0, y))
    for i in range(1, 5):
        qtbot.mouseMove(slider, QPoint(x0 + (x1 - x0) * i // 4, y))
    assert layer_kinds(place)[-1] is PointLayer
    now = place.points[np.isfinite(place.points).all(axis=1)]
    assert np.array_equal(place.view.shown.views[0].layers[-1].positions, now)
    assert np.nanmax(np.abs(place.points - before)) > 0
    value = place.session.sliders[0]
    assert home + value == pytest.approx(slider.inner[1], rel=0.1)
    qtbot.mouseRelease(slider, LEFT, NONE, QPoint(x1, y))
    assert len(place.sculptor.recipes) == 2 and place.sculptor.done == 1
    table.run("undo")
    assert place.session.sliders.get(0, 0.0) == 0.0 and np.allclose(np.nan_to_num(place.points), np.nan_to_num(before))
    table.run("redo")
    assert place.session.sliders[0] == pytest.approx(value)


def test_from_a_shape_on_the_map(place, qtbot):
    x, y = place.inspector.map.dot(3)
    dots = np.array([place.inspector.map.dot(i) for i in range(len(place.sculptor.shape_names))])
    nearest = int(np.linalg.norm(dots - [round(x), round(y)], axis=1).argmin())
    qtbot.mouseClick(place.inspector.map, LEFT, NONE, QPoint(round(x), round(y)))
    label = place.sculptor.recipe.label
    assert label == place.sculptor.shape_names[nearest]
    assert np.array_equal(place.sculptor.recipe.base.exists, place.sculptor.base_of(label).exists)


def test_between_two_shapes_is_one_item_per_drag(place, qtbot):
    place.session.selected = place.sculptor.shape_names[:2]
    assert place.actions.run("between") and place.between.bar.isVisibleTo(place.centre)
    assert place.between.ends == place.sculptor.shape_names[:2]
    count = len(place.sculptor.recipes)
    place.between.bar.slider.setSliderDown(True)
    for value in (55, 60, 70, 80):
        place.between.bar.slider.setValue(value)
    place.between.bar.slider.setSliderDown(False)
    assert len(place.sculptor.recipes) == count + 1 and place.sculptor.recipe.label == "A–B 80%"
    expected = place.sculptor.between(*(place.sculptor.base_of(n) for n in place.between.ends), 0.8)
    assert np.allclose(place.sculptor.recipe.base.layers[1], expected.layers[1])
    assert place.actions.run("between") and not place.between.bar.isVisibleTo(place.centre)
    assert place.actions.run("between") and place.actions.run("mean_shape")
    place.actions.run("undo")
    place._go_to(0)
    assert place.between.ends is None and not place.between.bar.isVisibleTo(place.centre)


def test_part_switches_say_what_is_fixed(place):
    always = place.sculptor.always()
    for part, switch in place.inspector.switches.items():
        assert switch.isEnabled() == (not always[part])
    optional = [part for part in place.inspector.switches if not always[part]]
    if not optional:
        pytest.skip("every part of this family is on every shape")
    switch, part = place.inspector.switches[optional[0]], optional[0]
    was = bool(place.sculptor.exists()[part])
    switch.click()
    assert bool(place.sculptor.exists()[part]) != was and place.sculptor.recipe.label.endswith(("on", "off"))


def test_points_can_be_shown_instead(place, qtbot):
    wait_for_mesh(place, qtbot)
    place.shown_as.button("points").click()
    assert layer_kinds(place) == [PointLayer]
    place.shown_as.button("mesh").click()
    assert layer_kinds(place) == [MeshLayer]


def test_an_old_answer_is_dropped(place, qtbot):
    wait_for_mesh(place, qtbot)
    old = place.made
    place.session.sliders = {0: 1.0}
    assert place.made is None
    place.worker._result = old
    place._read_mail()
    assert place.made is None


def test_export_writes_the_mesh_and_its_recipe(place, qtbot, tmp_path, monkeypatch):
    assert place.actions.verdict("export_mesh") in ((True, ""), (False, "The mesh is being made."))
    wait_for_mesh(place, qtbot)
    monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name: tmp_path / "chair")
    assert place.actions.run("export_mesh")
    assert (tmp_path / "chair.glb").stat().st_size > 1000
    recipe = json.loads((tmp_path / "chair.glb.recipe.json").read_text("utf-8"))
    assert recipe["machine"] == place.session.project.machine_id
    assert len(recipe["hidden"]) == place.sculptor.machine.n_layers
    assert recipe["parts"] == [
        n for n, on in zip(place.sculptor.part_names, place.sculptor.exists(), strict=True) if on
    ]


def test_a_mesh_that_cannot_be_made_is_said(place, qtbot, monkeypatch):
    monkeypatch.setattr(MeshWorker, "_make", lambda *a: (_ for _ in ()).throw(ValueError("no such part")))
    wait_or_any = place.session
    place.session.sliders = {0: 0.5}
    qtbot.waitUntil(lambda: "no such part" in wait_or_any.status, timeout=LONG)
    assert wait_or_any.status_kind == "error"
    assert place.view.shown.views[0].captions[0].lines[1][1] == "error"
    assert place.actions.verdict("export_mesh") == (False, "The mesh could not be made: no such part")
    assert "no such part" in place.inspector.export.toolTip()


def test_a_shape_that_outgrows_the_view_is_seen_whole_again(place, qtbot):
    view = place.view
    for _ in range(9):
        view.zoom(1)
    view._user_camera = False  # as if the shape, not the camera, had changed
    place._let_go(0)
    places = project_all(place)
    (x, y, width, height), *_ = view.rectangles()
    assert (places >= (x, y)).all() and (places <= (x + width, y + height)).all()
    for _ in range(9):
        view.zoom(1)
    scale = view.scene.camera.GetParallelScale()
    place._let_go(0)
    assert view.scene.camera.GetParallelScale() == scale, "who placed the camera keeps it"


def project_all(place) -> np.ndarray:
    points = place.points[np.isfinite(place.points).all(axis=1)]
    return np.array([place.view.place_of(point) for point in points])


# ---- ways to look at it ------------------------------------------------------------------------------------------


def test_pointing_at_a_slider_shows_what_it_moves_and_leaving_shows_the_parts(place, qtbot):
    wait_for_mesh(place, qtbot)
    before = place.view.shown.views[0].layers[0].colours.copy()
    place.inspector.rows[0].entered.emit()
    hot = place.view.shown.views[0].layers[0]
    moves = place.sculptor.moves(0)
    there = np.isfinite(place.points).all(axis=1)
    centres = np.asarray(hot.vertices)[hot.triangles].mean(axis=1)
    nearest = np.linalg.norm(centres[:, None] - place.points[there][None], axis=2).argmin(axis=1)
    own = moves[there][nearest]
    assert np.array_equal(np.unique(hot.colours[own <= own.min()], axis=0), heat(own[own <= own.min()] / np.quantile(
        moves[there], 0.98))[:1])  # fmt: skip
    brightness = hot.colours.astype(float).sum(axis=1)
    assert np.corrcoef(brightness, own)[0, 1] < -0.8, "hot is dark"
    place.inspector.rows[0].left.emit()
    assert np.array_equal(place.view.shown.views[0].layers[0].colours, before)


def test_the_view_turns_by_itself_until_told_to_stop(place, qtbot):
    camera = place.view.scene.camera
    start, focus = np.array(camera.GetPosition()), np.array(camera.GetFocalPoint())
    place.actions.run("spin")
    qtbot.waitUntil(lambda: np.linalg.norm(np.array(camera.GetPosition()) - start) > 0.05, timeout=10_000)
    place.actions.run("spin")
    stopped = np.array(camera.GetPosition())
    qtbot.wait(150)
    assert np.array_equal(np.array(camera.GetPosition()), stopped)
    assert stopped[1] == pytest.approx(start[1], abs=1e-3) and np.allclose(camera.GetFocalPoint(), focus, atol=1e-6)


def test_a_draw_of_the_gallery_is_taken_with_a_click_and_can_be_undone(place, qtbot):
    wait_for_mesh(place, qtbot)
    assert place.actions.run("gallery")
    gallery = place.shows.gallery
    assert gallery.isVisibleTo(place.centre) and not place.view.isVisibleTo(place.centre) and len(gallery.cards) == 12
    assert place.gallery_button.isChecked()
    qtbot.waitUntil(lambda: len(gallery.made) >= 3, timeout=LONG)
    wanted = gallery.recipes[1]
    qtbot.mouseClick(gallery.cards[1], LEFT, NONE, QPoint(60, 60))
    assert place.view.isVisibleTo(place.centre) and not gallery.isVisibleTo(place.centre)
    assert not place.gallery_button.isChecked()
    assert np.array_equal(place.sculptor.recipe.base.top, wanted.base.top)
    taken = place.points.copy()
    place.actions.run("undo")
    assert place.sculptor.recipe.label == "mean"
    mean = np.nan_to_num(place.sculptor.points())
    assert np.array_equal(np.nan_to_num(place.points), mean) and not np.array_equal(np.nan_to_num(taken), mean)
    place.actions.run("gallery")
    assert not np.array_equal(gallery.recipes[1].base.top, wanted.base.top), "other draws each time"
    qtbot.keyClick(gallery, Qt.Key.Key_Escape)
    assert place.view.isVisibleTo(place.centre)
    assert place.actions.run("gallery") and not place.view.isVisibleTo(place.centre)
    place.actions.run("mean_shape")
    assert place.view.isVisibleTo(place.centre) and not gallery.isVisibleTo(place.centre), "what was changed is seen"


def test_a_part_is_taken_from_a_shape_of_ones_choice(place, qtbot):
    wait_for_mesh(place, qtbot)
    part = int(np.flatnonzero(place.sculptor.exists())[0])
    having = np.flatnonzero(place.sculptor.observations.exists[:, part])
    used = place.made.shape.sources[part]
    other = next(place.sculptor.shape_names[i] for i in having if place.sculptor.shape_names[i] != used)
    place.inspector.part_to_take._choose(str(part))
    place.inspector.take_from._choose(other)
    assert place.sculptor.recipe.taken == {part: other} and place.sculptor.recipe.label.endswith(f"of {other}")
    wait_for_mesh(place, qtbot)
    assert place.made.shape.sources[part] == other
    place.actions.run("undo")
    wait_for_mesh(place, qtbot)
    assert place.sculptor.recipe.taken == {} and place.made.shape.sources[part] == used
    assert place.inspector.take_from.value_text() == "the nearest"


def test_what_the_window_exports_is_made_again_by_its_recipe(place, qtbot, tmp_path, sources):
    place.session.sliders = {0: 1.2}
    place._let_go(0)
    wait_for_mesh(place, qtbot)
    beside = export_mesh(tmp_path / "chair.ply", place.sculptor, place.made.shape, place.sculptor.recipe)
    again = remake(place.session.project, read_recipe(beside), sources)
    assert np.array_equal(again.triangles, place.made.shape.triangles)
    np.testing.assert_array_equal(again.vertices, place.made.shape.vertices)
