"""New shapes in the real window: sliders move points at once, a mesh follows, and all of it can be undone."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest
from PIL import Image
from PySide6.QtCore import QPoint, Qt

from shapeforge.generative.units import drive
from shapeforge.stages_recipes import read_recipe, remake
from shapeforge.viewer import movies
from shapeforge.viewer.display import MeshLayer, PointLayer
from shapeforge.viewer.mesh_worker import MeshWorker, Wish
from shapeforge.viewer.palette import heat
from shapeforge.viewer.pulling import as_place, handles_of, off_by
from shapeforge.viewer.sculptor import Recipe, Sculptor
from shapeforge.viewer.sculptor_files import export_mesh
from shapeforge.viewer.sculpture import measure_words
from shapeforge.viewer.session import Session
from shapeforge.viewer.slider_names import changes, choose_names, what_moves
from tests.viewer.synthesize_hands import LEFT, LONG, NONE, layer_kinds, wait_for_mesh

# ---- the model behind the place ---------------------------------------------------------------------------------


def test_the_middle_of_a_slider_leaves_the_shape_alone(sculptor):
    before = sculptor.points()
    sculptor.session.sliders = {0: 0.0, 1: 0.0}
    assert np.array_equal(np.nan_to_num(before), np.nan_to_num(sculptor.points()))
    sculptor.session.sliders = {0: 2.0}
    assert np.nanmax(np.abs(sculptor.points() - before)) > 0


def test_switched_off_parts_are_gone_and_come_back(sculptor):
    present = np.flatnonzero(sculptor.exists())
    sculptor.session.parts_on = {int(present[0]): False}
    assert np.isnan(sculptor.points()[sculptor.part == present[0]]).all()
    sculptor.session.parts_on = {}
    assert np.isfinite(sculptor.points()[sculptor.part == present[0]]).all()


def test_history_is_walked_back_and_forth(sculptor):
    session = sculptor.session
    session.sliders = {0: 1.0}
    sculptor.keep("wider")
    end = sculptor.points()
    sculptor.undo()
    assert session.sliders == {} and sculptor.redo_label == "wider"
    sculptor.redo()
    assert np.array_equal(np.nan_to_num(sculptor.points()), np.nan_to_num(end))
    sculptor.undo()
    session.sliders = {1: -1.0}
    sculptor.keep("other")
    assert sculptor.redo_label is None and [recipe.label for recipe in sculptor.recipes] == ["mean", "other"]


def test_the_ends_of_the_way_between_two_shapes_are_the_shapes(sculptor):
    a, b = (sculptor.base_of(name) for name in sculptor.shape_names[:2])
    for share, end in ((0.0, a), (1.0, b)):
        middle = sculptor.between(a, b, share)
        assert np.allclose(middle.first, end.first, atol=1e-5) and np.array_equal(middle.exists, end.exists)


def test_draws_differ_and_can_be_repeated(sculptor, learnt):
    first, second = sculptor.random_base(), sculptor.random_base()
    assert not np.array_equal(first.top, second.top) or not np.array_equal(first.exists, second.exists)
    session = Session()
    session.open(learnt)
    again = Sculptor(session)
    again.reload()
    assert np.array_equal(again.random_base().top, first.top)


def test_the_nearest_shape_of_a_shape_is_itself(sculptor):
    name, distance = sculptor.nearest(sculptor.positions[2])
    assert name == sculptor.shape_names[2] and distance == pytest.approx(0, abs=1e-6)


def test_handles_are_far_apart_and_pins_among_them(sculptor):
    points = sculptor.points()
    handles = handles_of(points)
    pinned = {int(handles[4]), int(np.flatnonzero(np.isfinite(points[:, 0]))[0])}
    with_pins = handles_of(points, pinned=pinned)
    assert len(handles) == len(with_pins) == 9 and pinned <= {int(k) for k in with_pins}
    apart = np.linalg.norm(points[with_pins][:, None] - points[with_pins], axis=2) + np.eye(9)
    assert apart.min() > 0.05


def test_pinned_points_stay_while_others_are_moved(sculptor):
    """Several at once, in any order; a locked slider keeps its value meanwhile, and without pins all is as it was."""
    session, points = sculptor.session, sculptor.points()
    first, second = (int(k) for k in handles_of(points)[:2])
    target = sculptor.points(Recipe("other", sculptor.base_of(sculptor.shape_names[1])))
    wanted = {k: as_place(0.4 * target[k] + 0.6 * points[k]) for k in (first, second)}
    session.pins = {first: wanted[first]}
    alone, values = sculptor.points(), sculptor.values()
    session.pins = wanted
    both = sculptor.points()
    session.pins = dict(reversed(wanted.items()))
    assert np.array_equal(np.nan_to_num(both), np.nan_to_num(sculptor.points()))
    missed = {k: (off_by(both, k, wanted[k]), off_by(points, k, wanted[k])) for k in wanted}
    # a point that was nearly there from the start stays so
    assert all(after < max(0.6 * before, 0.01) for after, before in missed.values()), missed
    assert max(before for _, before in missed.values()) > 0.03
    assert off_by(both, first, wanted[first]) < off_by(alone, first, wanted[first]) + 0.01
    assert np.abs(values - sculptor.home()).max() > 0.05, "sliders show what comes of it"
    sculptor.lock(0, True)
    now = sculptor.values()[0]
    session.pins = {first: as_place(points[first] + np.array([0.05, 0.0, 0.0]))}
    held = sculptor.values()[0]
    sculptor.lock(0, False)
    assert abs(held - now) < 0.1 < abs(sculptor.values()[0] - now) + 0.1
    session.pins, session.sliders = {}, {}
    assert np.array_equal(np.nan_to_num(sculptor.points()), np.nan_to_num(points))


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


def test_sliders_are_named_after_what_they_do():
    rng = np.random.default_rng(0)
    base = np.vstack(
        [
            rng.uniform([-0.2, 0, -0.2], [0.2, 0.05, 0.2], (400, 3)),
            rng.uniform([-0.2, 0.05, -0.2], [0.2, 0.5, -0.15], (400, 3)),
        ]
    )
    part, names, exists = np.repeat([0, 1], 400), ["seat", "back"], np.array([True, True])

    def first(after: np.ndarray) -> str:
        return changes(base, after, part, names, exists)[0][1]

    assert first(base * [1.4, 1, 1]) == "Width"
    taller = base.copy()
    taller[400:, 1] = 0.05 + 1.5 * (base[400:, 1] - 0.05)
    assert first(taller) in ("Height", "Height of the back")
    leaning = base.copy()
    leaning[400:, 2] -= 0.5 * (base[400:, 1] - 0.05)
    found = [name for _, name in changes(base, leaning, part, names, exists)]
    assert found.index("Lean of the back") < found.index("Splay of the back") and "Lean of the back" in found[:4]
    wide = [(0.1, "Width"), (0.09, "Depth")]
    found = [wide, [(0.1, "Width"), (0.07, "Height")], [(0.1, "Width")], [(0.001, "Width")]]
    assert choose_names(found, ["a", "b", "c", "d"]) == ["Width", "Height", "Width (2)", "d"]
    moves = np.where(part == 1, 0.09, 0.01)
    assert what_moves(moves, part, names, exists) == "moves: back · 9% of size"
    assert what_moves(moves, part, names, np.array([True, False])) == "moves: seat · 1% of size"


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


def test_random_keeps_what_is_locked(place, qtbot):
    place.session.sliders = {1: 1.5, 2: -1.0}
    place.inspector.rows[1].lock.setChecked(True)
    kept = place.sculptor.values()[1]
    assert place.actions.run("random_shape")
    assert set(place.session.sliders) == {1} and place.sculptor.recipe.label == "random"
    assert place.sculptor.values()[1] == pytest.approx(kept, abs=1e-6)
    place.actions.run("reset_sliders")
    assert place.sculptor.values()[1] == pytest.approx(kept, abs=1e-6)


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


def test_the_other_end_has_the_same_parts_where_there_is_such_a_shape(sculptor):
    exists = sculptor.observations.exists
    for index, name in enumerate(sculptor.shape_names):
        other = sculptor.shape_names.index(sculptor.other_end(name))
        assert other != index
        groups = [sculptor.session.project.groups.group[sculptor.session.project.names.index(n)]
                  for n in sculptor.shape_names]  # fmt: skip
        twins = [
            i for i in range(len(exists))
            if i != index and (exists[i] == exists[index]).all() and groups[i] == groups[index]
        ]  # fmt: skip
        assert not twins or other in twins


def test_a_caption_is_measured_on_the_shape_in_hand(sculptor):
    """From the low to the high end of the slider; another shape in hand, another caption."""
    every = np.ones(len(sculptor.part_names), bool)
    for origin, base in (("mean", sculptor.mean_base()), ("other", sculptor.base_of(sculptor.shape_names[2]))):
        sculptor.start(Recipe(origin, base, origin=origin))
        for index, direction in enumerate(sculptor.directions):
            low, high = (
                drive(sculptor.machine, base, {index: value}, every, directions=sculptor.directions)
                for value in (direction.low, direction.high)
            )
            far = np.linalg.norm(np.asarray(high) - np.asarray(low), axis=1)
            assert sculptor.caption(index) == what_moves(far, sculptor.part, sculptor.part_names, sculptor.exists())


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


def test_a_movie_is_one_turn(place, qtbot, tmp_path, monkeypatch):
    wait_for_mesh(place, qtbot)
    monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name: tmp_path / "chair.gif")
    small = movies.turntable
    monkeypatch.setattr(movies, "turntable", lambda layer, theme: small(layer, 6, (90, 90), theme))
    assert place.actions.run("export_movie")
    with Image.open(tmp_path / "chair.gif") as movie:
        assert movie.n_frames == 6 and movie.size == (90, 90) and movie.info["loop"] == 0
        first = np.asarray(movie.convert("RGB")).astype(int)
        movie.seek(3)
        assert np.abs(np.asarray(movie.convert("RGB")).astype(int) - first).max() > 30
    with pytest.raises(ValueError, match="wanted an ending"):
        movies.write_movie(tmp_path / "chair.avi", [np.zeros((4, 4, 3), np.uint8)])


def test_a_draw_of_the_gallery_is_taken_with_a_click_and_can_be_undone(place, qtbot):
    wait_for_mesh(place, qtbot)
    assert place.actions.run("gallery")
    gallery = place.shows.gallery
    assert gallery.isVisibleTo(place.centre) and not place.view.isVisibleTo(place.centre) and len(gallery.cards) == 12
    qtbot.waitUntil(lambda: len(gallery.made) >= 3, timeout=LONG)
    wanted = gallery.recipes[1]
    qtbot.mouseClick(gallery.cards[1], LEFT, NONE, QPoint(60, 60))
    assert place.view.isVisibleTo(place.centre) and not gallery.isVisibleTo(place.centre)
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
