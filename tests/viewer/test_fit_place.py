"""Fit: it runs, pauses, steps and stops; looking changes nothing; every number shown is the fit's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QFrame, QLabel, QWidget

from shapeforge import stages
from shapeforge.collection.colours import PARTS
from shapeforge.store import Project
from shapeforge.store_arrays import read_record, write_record
from shapeforge.viewer.display import PointLayer
from shapeforge.viewer.fit_display import FittedPoints, TemplateLook, movement, point_colours, sureness, to_plane
from shapeforge.viewer.palette import SWITCHED_OFF, part_colours, rgb, tokens
from shapeforge.viewer.qt.fit_panel import FitPlace
from shapeforge.viewer.qt.fit_report import energy_text, existence_text
from shapeforge.viewer.qt.fit_widgets import Scrubber, draw_points
from shapeforge.viewer.qt.plots import Curves, nice_ticks
from shapeforge.viewer.readiness import QUALITIES
from tests.viewer.turned import turn_shape

LEFT = Qt.MouseButton.LeftButton
LONG = 240000


# -- what is shown ---------------------------------------------------------------------------------------------------


def points(positions: np.ndarray, active: tuple[bool, ...] = (True, True), template: int = 0) -> FittedPoints:
    return FittedPoints(positions.astype(np.float32), template, np.array(active))


LOOK = TemplateLook(np.array([0, 0, 1, 1]), ("back", "seat"), "a", part_colours(2))


def test_switched_off_parts_are_grey():
    colours = point_colours(LOOK, points(np.zeros((4, 3)), (True, False)), "part")
    assert [tuple(c) for c in colours] == [rgb(PARTS[0])] * 2 + [rgb(SWITCHED_OFF)] * 2


def test_points_of_components_that_the_shape_lacks_are_grey():
    spare = np.array([False, True, False, False])
    colours = point_colours(LOOK, replace(points(np.zeros((4, 3))), spare=spare), "part")
    assert [tuple(c) for c in colours] == [rgb(PARTS[0]), rgb(SWITCHED_OFF), *[rgb(PARTS[1])] * 2]


def test_movement_is_per_point_and_only_within_a_template():
    before, now = points(np.zeros((4, 3))), points(np.eye(4, 3) * 0.01)
    np.testing.assert_allclose(movement(now, before), [0.01, 0.01, 0.01, 0], atol=1e-7)
    assert movement(now, None) is None
    assert movement(now, points(np.zeros((4, 3)), template=1)) is None
    assert movement(now, points(np.zeros((5, 3)))) is None


def test_sureness_of_a_part_without_points_is_unknown():
    sure = sureness(np.array([[0.9, 0.1, 0.0], [0.7, 0.3, 0.0], [0.4, 0.6, 0.0]]))
    np.testing.assert_allclose(sure[:2], [0.8, 0.6])
    assert np.isnan(sure[2])


def test_seen_from_the_front_right_is_right_and_up_is_up():
    flat = to_plane(np.eye(3), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(flat, [[1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-12)


def test_the_nearest_point_is_drawn_last():
    positions = np.array([[0, 0, 0.5], [0, 0, -0.5], [1, 1, 0], [-1, -1, 0]], float)
    inks = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [0, 0, 255]], np.uint8)
    for order in ([0, 1, 2, 3], [3, 2, 1, 0]):
        image = draw_points(positions[order], inks[order], (41, 41), (0.0, 0.0, 1.0), 3)
        middle = QColor(image.pixelColor(20, 20))
        assert (middle.red(), middle.green()) == (255, 0)


def test_what_is_switched_off_makes_no_small_picture_smaller():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    far = np.array([[0.5, 9.0, 0]])
    inks = np.tile(np.array(rgb(PARTS[0]), np.uint8), (4, 1))
    alone = draw_points(square, inks, (40, 40), (0.0, 0.0, 1.0))
    grey = np.array([rgb(SWITCHED_OFF)], np.uint8)
    with_far = draw_points(np.concatenate([square, far]), np.concatenate([inks, grey]), (40, 40), (0.0, 0.0, 1.0))
    assert with_far == alone
    seen = draw_points(np.concatenate([square, far]), np.concatenate([inks, inks[:1]]), (40, 40), (0.0, 0.0, 1.0))
    assert seen != alone, "a point of a part that is on is always seen"


@pytest.mark.parametrize(("low", "high"), [(2.2, 3.9), (0.0, 1e-6), (-12.4, -11.9), (0.0, 97.0), (1.0, 1.0001)])
def test_ticks_enclose_the_values_and_are_few(low, high):
    ticks = nice_ticks(low, high)
    assert 2 <= len(ticks) <= 6
    assert ticks[0] <= low + 1e-9 and ticks[-1] >= high - 1e-9
    np.testing.assert_allclose(np.diff(ticks), ticks[1] - ticks[0], rtol=1e-6)


# -- the place -------------------------------------------------------------------------------------------------------


def place_of(window) -> FitPlace:
    place = window.place("fit")
    place._soon.stop()
    place._show_all()
    return place


def test_a_finished_fit_is_shown_from_disk(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    state = fitted.fit()
    assert place.strip.round_text.text() == f"Round {state.round} of {state.of}"
    np.testing.assert_allclose(place.report.energy.values[0][-1], state.energy)
    np.testing.assert_allclose([curve[-1] for curve in place.report.sigma.values], 100 * state.sigma_by_part, rtol=1e-6)
    assert place.run.text() == "Run again"
    assert place.next.isVisible()
    assert place.scrubber.recorded == state.round == place.scrubber.at


def test_three_views_show_the_shape_the_points_and_the_parts(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    display = place.view.shown
    assert len(display.views) == 3
    name = window.session.shape
    beliefs = fitted.beliefs(name)
    shown = sum(len(layer.positions) for layer in display.views[1].layers if layer.key in ("points", "off"))
    assert shown == len(beliefs.deformed)
    qtbot.waitUntil(lambda: place.view.frames > 0)
    qtbot.wait(300)
    picture = place.view.picture().astype(int)
    third = picture[:, 2 * picture.shape[1] // 3 :]
    first = picture[:, : picture.shape[1] // 3]
    colourful = np.ptp(third, axis=2) > 60
    assert colourful.mean() > 0.01, "the probable parts are in colour"
    assert (np.ptp(first, axis=2) > 60).mean() < 0.001, "the input is grey"


def test_dragging_the_scrubber_looks_back_and_forth(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    y = 60
    newest = place.record.newest
    qtbot.mouseClick(place.scrubber, LEFT, pos=QPoint(round(place.scrubber.x_of(0)), y))
    assert window.session.round == 0
    place._show_all()
    name = window.session.shape
    want = np.asarray(fitted.rounds(name)[0], float)
    layers = [layer for layer in place.view.shown.views[1].layers if layer.key in ("points", "off")]
    got = np.concatenate([layer.positions for layer in layers])
    assert {tuple(np.round(p, 3)) for p in got} == {tuple(np.round(p, 3)) for p in want}
    qtbot.mouseClick(place.scrubber, LEFT, pos=QPoint(round(place.scrubber.x_of(newest)), y))
    assert window.session.round is None


def test_watching_another_shape(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    other = next(one for one in place.also_watching.pictures if one.name != window.session.shape)
    qtbot.mouseClick(other, LEFT)
    assert window.session.shape == other.name
    qtbot.waitUntil(lambda: place.heads[0][1].full_text().startswith(other.name))
    assert other.name in place.report.parts_title.full_text() and other.name in place.correction.correct.text()


def test_the_grid_shows_all_watched_shapes(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    qtbot.mouseClick(place.mode.button("grid"), LEFT)
    place._show_all()
    names = {window.session.shape, *window.session.watched}
    shown = {view.captions[0].lines[0][0] for view in place.view.shown.views if view.captions}
    assert shown == names


def test_turning_the_view_turns_the_small_pictures(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place = place_of(window)
    before = place.also_watching.pictures[0]._direction
    place.view.turn(120, 0)
    assert place.also_watching.pictures[0]._direction != before
    place.linked.setChecked(False)
    assert place.also_watching.pictures[0]._direction == (1.0, 0.6, 1.5)


def test_correcting_goes_to_paint_with_the_shape(open_window, fitted, qtbot, monkeypatch):
    window = open_window(fitted, "fit")
    place = place_of(window)
    name = window.session.shape
    monkeypatch.setattr(window, "_show_place", lambda: None)
    qtbot.mouseClick(place.correction.correct, LEFT)
    assert (window.session.place, window.session.shape) == ("paint", name)


def test_running_pausing_stepping_stopping(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    qtbot.mouseClick(place.step, LEFT)
    assert session.running and session.stage == "fit"
    assert window.rail.places["fit"].mark == "running"
    qtbot.waitUntil(lambda: window.runner.paused, timeout=LONG)
    qtbot.wait(50)
    assert place.record.newest == 0, "a step is one round: the affine start"
    assert session.is_paused and place.run.text() == "Resume"
    assert place.strip.left_text.text() == "· paused" and "kept" in place.strip.phase_text.full_text()
    qtbot.mouseClick(place.step, LEFT)
    qtbot.waitUntil(lambda: place.record.newest == 1 and window.runner.paused, timeout=LONG)
    qtbot.wait(50)
    assert np.isfinite(place.report.energy.values[0][-1])
    can, why = window.actions_table.verdict("correct")
    assert not can and "Stop" in why
    qtbot.mouseClick(place.stop, LEFT)
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    assert session.status_kind == "warning" and "goes on" in session.status
    assert stages.status(Project.open(fitted.path))["fit"].state == "partial"
    assert place.run.text() == "Go on"


def bytes_of(project: Project) -> dict[str, bytes]:
    """All results of the fit of every shape, and the templates."""
    found = {}
    for name in project.fit_names:
        beliefs = project.beliefs(name)
        found[name] = b"".join(
            np.ascontiguousarray(array).tobytes()
            for array in (
                beliefs.deformed,
                beliefs.variance,
                beliefs.maps,
                beliefs.segmentation,
                project.face_labels(name),
            )
        )
    state = project.fit()
    found["templates"] = b"".join(np.ascontiguousarray(t.points).tobytes() for t in state.templates)
    found["energy"] = np.float64(state.energy).tobytes()
    return found


def test_a_watched_fit_equals_an_unwatched_fit_bit_for_bit(open_window, fitted, qtbot):
    unwatched = bytes_of(fitted)  # made by the stages alone, with nobody watching
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    session.watched = fitted.names
    qtbot.mouseClick(place.run, LEFT)
    turns = 0
    while session.running:
        session.shape = fitted.names[turns % len(fitted.names)]  # look around meanwhile
        turns += 1
        qtbot.wait(30)
        assert turns < 5000
    assert session.status_kind == "ok", session.status
    watched = bytes_of(Project.open(fitted.path))
    assert watched.keys() == unwatched.keys()
    for name in unwatched:
        assert watched[name] == unwatched[name], name


def test_a_run_that_was_stopped_ends_like_one_that_was_not(open_window, fitted, qtbot):
    whole = bytes_of(fitted)
    window = open_window(fitted, "fit")
    place = place_of(window)
    qtbot.mouseClick(place.step, LEFT)
    qtbot.waitUntil(lambda: place.record.newest == 0 and window.runner.paused, timeout=LONG)
    window.close()  # in the middle of a fit
    again = open_window(Project.open(fitted.path), "fit")
    qtbot.mouseClick(place_of(again).run, LEFT)
    qtbot.waitUntil(lambda: not again.session.running, timeout=LONG)
    assert again.session.status_kind == "ok", again.session.status
    assert bytes_of(Project.open(fitted.path)) == whole


def test_a_damaged_fit_is_said_and_the_rest_goes_on(open_window, fitted, qtbot):
    folder = fitted.current_folder("fit")
    (folder / "fit.zarr.zip").write_bytes(b"no zip")
    window = open_window(fitted, "fit")
    assert window.session.place == "fit"
    assert window.session.status_kind == "error" and "fit.zarr.zip" in window.session.status
    window.session.place = "collection"
    assert window.stacks["centre"].currentWidget() is window.places["collection"].centre


def switch_off(project: Project, name: str, part: int) -> None:
    """As if the fit had found that a shape has no such part."""
    path = project.current_folder("fit") / "shapes" / f"{name}.zarr.zip"
    found, _ = read_record(path)
    active, odds = found["beliefs"].active.copy(), found["beliefs"].misfit.copy()
    active[part], odds[part] = False, -3.0
    write_record(path, {**found, "beliefs": replace(found["beliefs"], active=active, misfit=odds)})


def test_a_switched_off_part_can_be_insisted_on(open_window, fitted, qtbot):
    name = fitted.names[-1]
    switch_off(fitted, name, int(np.flatnonzero(fitted.beliefs(name).active)[0]))
    fitted = Project.open(fitted.path)
    off = {name: np.flatnonzero(~fitted.beliefs(name).active)}
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    session.shape = name
    place._show_all()
    part = fitted.part_names.names[int(off[name][0])]
    note = place.report.notes[part]
    assert part in note.title.text().lower() and "likely to be there" in note.text.text() and note.override.isEnabled()
    qtbot.mouseClick(note.override, LEFT)
    assert (session.place, session.shape, session.part) == ("paint", name, int(off[name][0]))
    assert part in session.status


@pytest.mark.parametrize(
    ("odds", "words"),
    [(-9.0, "less than 1%"), (-2.0, "12%"), (float("nan"), "has no such part"), (float("-inf"), "no surface")],
)
def test_why_a_part_is_off_is_said_as_a_chance(odds, words):
    assert words in existence_text(odds)


# -- turned shapes, and parts that other exemplars bring -------------------------------------------------------------

UPSIDE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""A quarter turn about x."""


def shown_points(place) -> np.ndarray:
    layers = place.view.shown.views[1].layers
    return np.concatenate([layer.positions for layer in layers if isinstance(layer, PointLayer)])


def test_a_shape_explained_after_a_turn_is_shown_as_the_family_lies(open_window, fitted, qtbot):
    name = fitted.names[-1]
    upright = fitted.beliefs(name).deformed
    turn_shape(fitted, name, UPSIDE)
    fitted = Project.open(fitted.path)
    assert not np.allclose(fitted.beliefs(name).deformed, upright)
    window = open_window(fitted, "fit")
    window.session.shape = name
    place = place_of(window)
    np.testing.assert_allclose(np.sort(shown_points(place), axis=0), np.sort(upright, axis=0), atol=1e-5)
    tops = [view.layers[0].vertices[:, 1].max() for view in place.view.shown.views]
    own = fitted.shapes.named(name).mesh.vertices
    np.testing.assert_allclose(tops, [(own @ UPSIDE.T)[:, 1].max()] * 3, atol=1e-6)
    assert "turned" in place.heads[0][1].full_text()


def test_parts_that_another_exemplar_brings_are_there(open_window, fitted, qtbot):
    """A shape whose template lacks a part that another exemplar's has: it is shown, named, and not called off."""
    name = fitted.names[-1]
    path = fitted.current_folder("fit") / "shapes" / f"{name}.zarr.zip"
    found, attributes = read_record(path)
    beliefs = found["beliefs"]
    part = int(np.flatnonzero(beliefs.active)[0])
    active = beliefs.active.copy()
    active[part] = False
    lender = replace(beliefs, deformed=beliefs.deformed + 0.01)
    lent = replace(beliefs, active=active, lent=((part, lender),))
    write_record(path, {**found, "beliefs": lent}, attributes)
    window = open_window(Project.open(fitted.path), "fit")
    window.session.shape = name
    place = place_of(window)
    label = fitted.fit().templates[beliefs.template].label
    layers = {layer.key: layer for layer in place.view.shown.views[1].layers}
    assert "off" not in layers or len(layers["off"].positions) == (~beliefs.active[label]).sum()
    np.testing.assert_allclose(layers[f"lent {part}"].positions, lender.deformed[label == part], atol=1e-6)
    assert tuple(layers[f"lent {part}"].colours[0]) == rgb(PARTS[part])
    assert fitted.part_names.names[part] not in place.report.notes
    words = {one.text() for one in place.report.findChildren(QLabel)}
    assert beliefs.template == len(fitted.fit().templates) - 1 and "from the whole family" in words


def test_every_part_that_is_off_says_why_and_where_else(open_window, fitted, qtbot):
    name, other = fitted.names[-1], fitted.names[-2]
    window = open_window(fitted, "fit")
    place = place_of(window)
    off = [fitted.part_names.names[p] for p in np.flatnonzero(~fitted.beliefs(name).active)]
    window.session.shape = name
    place._show_all()
    assert set(off) <= set(place.report.notes) and all(note.text.text() for note in place.report.notes.values())
    for part, note in place.report.notes.items():
        elsewhere = [one for one in place.record.off_on(fitted.part_names.names.index(part)) if one != name]
        assert f"{len(elsewhere)} other" in note.text.text() or not elsewhere
    part, many = next((part, one) for part, one in place.report.notes.items() if "other shapes" in one.text.text())
    place.report.explain(part)
    qtbot.mouseClick(many.show_others, LEFT)
    assert window.session.watched and name not in window.session.watched
    assert other in fitted.names


# -- quality, keys ---------------------------------------------------------------------------------------------------


def test_the_quality_is_chosen_and_is_what_runs(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    assert session.quality == "", "as it was fitted last"
    assert place.quality_text.text() == f"{fitted.fit().of} rounds, or", "those of the family's templates, too"
    qtbot.mouseClick(place.quality.button("draft"), LEFT)
    assert session.quality == "draft" and place.quality.button("draft").isChecked()
    qtbot.mouseClick(place.step, LEFT)
    assert not place.quality.button("fine").isEnabled() and "Stop" in place.quality.button("fine").toolTip()
    qtbot.waitUntil(lambda: place.record.newest == 0 and window.runner.paused, timeout=LONG)
    qtbot.wait(50)
    assert QUALITIES["draft"]["rounds"] == 4, "of two exemplars: three rounds, and four of the family's templates"
    assert place.record.planned == 7 and place.strip.round_text.text() == "Round 0 of 7"
    qtbot.mouseClick(place.stop, LEFT)
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    assert place.run.text() == "Go on"
    qtbot.mouseClick(place.quality.button("fine"), LEFT)
    assert place.run.text() == "Run", "another quality begins anew"


def test_rounds_and_shapes_by_keyboard(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    newest = place.record.newest
    qtbot.keyClick(place.centre, Qt.Key.Key_Left)
    assert session.round == newest - 1
    qtbot.keyClick(place.centre, Qt.Key.Key_Right)
    assert session.round is None
    assert window.actions_table.verdict("round_forth")[0] is False
    shown = [one.name for one in place.also_watching.pictures]
    session.shape = shown[0]
    qtbot.keyClick(place.centre, Qt.Key.Key_PageDown)
    assert session.shape == shown[1]
    watched = session.watched
    qtbot.keyClick(place.centre, Qt.Key.Key_A)
    assert set(session.watched) == set(watched) - {shown[1]}
    qtbot.waitUntil(lambda: shown[1] not in [one.name for one in place.also_watching.pictures])
    qtbot.mouseClick(place.watch_it, LEFT)
    assert session.watched[-1] == shown[1]


def test_energy_movement_and_spread_are_the_fits_own(open_window, fitted, qtbot):
    place = place_of(open_window(fitted, "fit"))
    figures = fitted.round_figures()
    np.testing.assert_allclose(place.report.change.values[0][1:], [100 * one["change"] for one in figures[1:]])
    ink = place.report.change.grab().toImage()
    columns = [ink.pixelColor(ink.width() // 2, y).name() for y in range(ink.height())]
    assert len(set(columns)) > 1, "a curve is drawn"
    begun = fitted.fit().family_from
    assert place.record.family_after == begun and 0 <= begun < place.record.newest
    assert "another sum" in place.report.energy.toolTip()
    first = energy_text(place.record, begun + 1)
    assert first.startswith(f"{figures[begun + 1]['energy']:.3f} nats: the family's first round".replace("-", "−"))
    assert "This round" not in first, "nothing got better or worse: it is another sum"


INK = "#ff0000"


def inked(curves: Curves) -> set[int]:
    """Columns of pixels with the curve's red in them."""
    shot = curves.grab().toImage()
    columns = range(shot.width())
    return {x for x in columns for y in range(shot.height()) if redness(shot.pixelColor(x, y)) > 100}


def redness(colour: QColor) -> int:
    return colour.red() - colour.green()


def test_no_curve_goes_from_one_phase_into_the_next(qtbot):
    curves = Curves(height=90, phases=("exemplars", "family"))
    qtbot.addWidget(curves)
    curves.resize(44 + 8 + 200, 90)
    curves.set_series([(range(11), [5.0, 4.0, 3.0, 2.0, 1.0, 1.0, 1.0, 5.0, 4.0, 4.0, 4.0], INK)], 10, None)
    between = set(range(44 + 6 * 20 + 4, 44 + 7 * 20 - 4))
    assert between <= inked(curves), "one curve"
    curves.set_phase(6)
    cut = inked(curves)
    assert not between & cut
    assert all(set(range(44 + n * 20 + 4, 44 + n * 20 + 16)) & cut for n in (0, 4, 5, 7, 8, 9)), "the rest is drawn"
    shot, grey = curves.grab().toImage(), {tokens("dark")["separator_strong"].lower()}
    assert {shot.pixelColor(44 + 130, y).name() for y in range(12, 60)} == grey, "a line stands between them"


def test_a_phase_of_one_round_is_seen(qtbot):
    curves = Curves(height=90)
    qtbot.addWidget(curves)
    curves.resize(252, 90)
    curves.set_series([(range(4), [5.0, 4.0, 3.0, 4.0], INK)], 10, 0.0)
    curves.set_phase(2)
    assert inked(curves) & set(range(44 + 60 - 2, 44 + 60 + 3))


def test_the_rounds_to_look_back_at_are_parted_where_the_familys_begin(qtbot):
    scrubber, grey = Scrubber(), tokens("dark")["separator_strong"].lower()
    qtbot.addWidget(scrubber)
    scrubber.resize(26 + 26 + 400, 96)
    scrubber.set_state(10, 10, 10, {})

    def parted() -> set[int]:
        """Rounds after which a line stands."""
        shot = scrubber.grab().toImage()
        columns = {n: 26 + 40 * n + 20 for n in range(10)}
        return {n for n, x in columns.items() if all(shot.pixelColor(x, y).name() == grey for y in range(20, 55))}

    assert parted() == set()
    scrubber.set_phase(6)
    assert parted() == {6} and "from round 7 on by the family's own" in scrubber.toolTip()
    scrubber.set_phase(None)
    assert parted() == set()


def all_seen(*widgets: QWidget) -> bool:
    """Whether every pixel of the widgets is in sight."""
    return all(one.visibleRegion().boundingRect().size() == one.size() for one in widgets)


@pytest.mark.parametrize("size", [(1280, 800), (1600, 1000)])
def test_why_a_part_is_off_is_seen_without_scrolling(open_window, fitted, qtbot, size):
    """Of every part that is off, one after the other, however low the window, below the note that the fit is stale."""
    name = fitted.names[-1]
    for part in np.flatnonzero(fitted.beliefs(name).active)[:4]:
        switch_off(fitted, name, int(part))
    labelled = fitted.labelled[0]
    fitted.set_labels(labelled, np.full(fitted.shape_record(labelled)["n_faces"], -1, np.int32))
    window = open_window(Project.open(fitted.path), "fit")
    window.resize(*size)
    place = place_of(window)
    window.session.shape = name
    place._show_all()
    notes = place.report.notes
    assert next(one for one in place.inspector.findChildren(QFrame) if one.objectName() == "stale").isVisible()
    assert len(notes) >= 4 and place.record.family_after is not None, "the curves are in two phases"
    shown = next(iter(notes))
    for _ in range(len(notes)):
        note = notes[shown]
        qtbot.waitUntil(lambda note=note: note.isVisible() and all_seen(note, note.text, note.next))
        assert [one for one in notes if notes[one].isVisible()] == [shown]
        assert place.report.off_rows[shown].property("current") == "true"
        qtbot.mouseClick(note.next, LEFT)
        shown = next(one for one in notes if notes[one].isVisible())
    assert shown == next(iter(notes)), "after the last comes the first"


def test_a_click_on_a_part_that_is_off_tells_why(open_window, fitted, qtbot):
    name = fitted.names[-1]
    for part in np.flatnonzero(fitted.beliefs(name).active)[:2]:
        switch_off(fitted, name, int(part))
    window = open_window(Project.open(fitted.path), "fit")
    window.resize(1600, 1000)
    place = place_of(window)
    window.session.shape = name
    place._show_all()
    report = place.report
    last = list(report.notes)[-1]
    assert not report.notes[last].isVisible()
    qtbot.waitUntil(lambda: all_seen(report.off_rows[last]))
    qtbot.mouseClick(report.off_rows[last], LEFT)
    assert report.notes[last].isVisible() and sum(one.isVisible() for one in report.notes.values()) == 1
    place._show_all()
    assert report.notes[last].isVisible(), "it stays so"


def test_a_fit_that_became_stale_says_so(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    place_of(window)
    note = next(one for one in window.places["fit"].inspector.findChildren(QFrame) if one.objectName() == "stale")
    assert not note.isVisible()
    name = fitted.labelled[0]
    labels = fitted.labels(name).copy()
    labels[:5] = -1
    window.session.project.set_labels(name, labels)
    window.session.touch("labels")
    assert note.isVisible() and "labels" in " ".join(one.text() for one in note.findChildren(QLabel))
    assert window.places["fit"].run.text() == "Run"


def test_a_click_in_the_grid_looks_at_the_shape_and_an_error_is_read_in_full(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    qtbot.mouseClick(place.mode.button("grid"), LEFT)
    place._show_all()
    names = [view.name for view in place.view.shown.views]
    cell = next(i for i, name in enumerate(names) if name != session.shape)
    for corner in place.view.shown.views[cell].layers[0].vertices[::7]:
        x, y = place.view.place_of(corner, cell)
        found = place.view.pick(x, y)
        if found is not None and found.view == cell:
            break
    qtbot.mouseClick(place.view.plotter, LEFT, pos=QPoint(round(x), round(y)))
    assert session.shape == names[cell]
    place._show_all()
    assert [view.name for view in place.view.shown.views] == names, "a click moves none"
    assert [view.selected for view in place.view.shown.views] == [name == names[cell] for name in names]
    session.say("No space left on device. Free some, then run it again.", "error")
    problem = place.strip.problem
    assert problem.isVisible() and problem.text() == session.status
    lines = problem.fontMetrics().boundingRect(0, 0, problem.width(), 99, 0x1000, problem.text())
    assert lines.height() <= problem.height(), "all of it is seen"
