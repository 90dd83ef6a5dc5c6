"""After a fit: a shape is corrected by painting and the fit is taken up from there; how far a round is, is told."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import Qt

from shapeforge.collection.labels import read_seg
from shapeforge.viewer.qt.fit_panel import FitPlace
from shapeforge.viewer.readiness import QUALITIES, planned_rounds, rounds_text
from tests.viewer.paint_hands import hands_of

LEFT = Qt.MouseButton.LeftButton
LONG = 240000


def place_of(window) -> FitPlace:
    place = window.place("fit")
    place._soon.stop()
    place._show_all()
    return place


def not_an_exemplar(project) -> str:
    exemplars = {project.names[int(t)] for t in project.groups.exemplars}
    return next(name for name in project.names if name not in exemplars)


def test_a_shape_is_corrected_by_painting_and_refitted_from_there(open_window, fitted, qtbot):
    name, before = not_an_exemplar(fitted), fitted.fit()
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    session.shape = name
    assert not place.correction.refit.isVisible()
    can, why = window.actions_table.verdict("refit")
    assert not can and "Nothing was painted" in why
    qtbot.mouseClick(place.correction.correct, LEFT)
    hands = hands_of(window, qtbot)
    assert session.place == "paint" and session.shape == name
    session.tool, session.part = "piece", 1
    face = int(hands.visible()[0])
    hands.click(face)
    painted = hands.labels == 1
    session.place = "fit"
    place._show_all()
    qtbot.waitUntil(place.correction.refit.isVisible)
    assert name in place.correction.words.text()
    others = {n: fitted.beliefs(n).deformed for n in fitted.names if n != name}
    qtbot.mouseClick(place.correction.refit, LEFT)
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    assert session.status_kind == "ok", session.status
    after = fitted.fit()
    assert after.round == before.round + 2 and place.record.newest == after.round
    assert place.strip.round_text.text() == f"Round {after.round} of {after.of}"
    assert (fitted.face_labels(name)[painted] == 1).mean() > 0.9
    moved = [
        np.linalg.norm(fitted.beliefs(n).deformed - points, axis=1).mean()
        for n, points in others.items()
        if len(points) == len(fitted.beliefs(n).deformed)
    ]
    assert len(moved) and np.median(moved) < 0.02, "the others go on from where they were"
    qtbot.wait(50)
    assert not place.correction.refit.isVisible()
    place.look_back(1)
    place._show_all()
    other = next(iter(others))
    session.shape = other
    assert place.record.points(other, 1) is not None, "the rounds before can still be looked at"


def test_a_repainted_exemplar_says_that_it_needs_a_new_fit(open_window, fitted, qtbot):
    exemplar = fitted.names[int(fitted.groups.exemplars[0])]
    fitted.set_labels(exemplar, np.zeros(fitted.shape_record(exemplar)["n_faces"], np.int32))
    window = open_window(fitted, "fit")
    place = place_of(window)
    window.session.touch("labels")
    qtbot.waitUntil(place.correction.refit.isVisible)
    assert not place.correction.refit.isEnabled() and f"{exemplar} is an exemplar" in place.correction.refit.toolTip()
    assert "Run the fit again" in place.correction.words.text()


def test_run_again_after_a_refit_begins_at_the_start(open_window, fitted, meshes, qtbot):
    name = not_an_exemplar(fitted)
    faces = read_seg(meshes / f"{name}.seg", fitted.shape_record(name)["n_faces"], fitted.part_names)
    fitted.set_labels(name, faces)
    window = open_window(fitted, "fit")
    place = place_of(window)
    window.actions_table.run("refit")
    qtbot.waitUntil(lambda: not window.session.running, timeout=LONG)
    longer = fitted.fit().round
    qtbot.mouseClick(place.run, LEFT)
    qtbot.waitUntil(lambda: not window.session.running, timeout=LONG)
    assert fitted.fit().round < longer and place.record.newest == fitted.fit().round


def test_the_bar_moves_within_a_round_and_the_time_left_is_said_in_the_first(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    seen: list[tuple[int, float, str, str]] = []

    def note() -> None:
        progress = session.progress
        if progress is not None and progress.phase == "fit" and progress.within:
            seen.append((progress.step, place.scrubber.share, place.strip.left_text.text(),
                         place.strip.phase_text.full_text()))  # fmt: skip

    place.binding.on(("progress",), note, now=False)
    qtbot.mouseClick(place.run, LEFT)
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    first = [one for one in seen if one[0] == 0]
    assert len(first) == len(fitted.names) - 1
    assert [share for _, share, *_ in first] == pytest.approx(np.arange(1, len(fitted.names)) / len(fitted.names))
    assert all("left" in left for *_, left, _ in first)
    assert first[0][3] == f"round 1, shape 1 of {len(fitted.names)}"
    assert place.scrubber.share == 0.0


def test_the_true_number_of_rounds_is_named_before_and_after(open_window, fitted, qtbot):
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    exemplars = len(fitted.groups.exemplars)
    for name, options in QUALITIES.items():
        said = place.quality.button(name).toolTip()
        assert said.startswith(rounds_text(session, options["rounds"]))
        assert str(planned_rounds(session, options["rounds"])) in said
    if exemplars > 1:
        assert planned_rounds(session, 10) == 15 and "7 of the exemplars'" in rounds_text(session, 10)
    assert place.quality_text.text() == f"{planned_rounds(session)} rounds, or"
    assert planned_rounds(session) == fitted.fit().of
