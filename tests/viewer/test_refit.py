"""After a fit: a shape is corrected by painting and the fit is taken up from there; how far a round is, is told."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QPushButton

from shapeforge.collection.families import write_family
from shapeforge.collection.labels import PartNames, read_seg
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


def test_an_exemplar_is_repainted_in_the_window_and_refitted_from_there(open_window, fitted, qtbot):
    exemplar, before = fitted.names[int(fitted.groups.exemplars[0])], fitted.fit().round
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    session.shape = exemplar
    qtbot.mouseClick(place.correction.correct, LEFT)
    hands = hands_of(window, qtbot)
    face = int(hands.visible()[0])
    session.tool, session.part = "piece", int(hands.labels[face] == 0)
    hands.click(face)
    painted = hands.labels.copy()
    session.place = "fit"
    place._show_all()
    qtbot.waitUntil(place.correction.refit.isVisible)
    assert f"Repainted: {exemplar}" in place.correction.words.text() and not place.correction.anew.isVisible()
    offered = [one.text() for one in place.report.findChildren(QPushButton) if one.isVisible()]
    assert "Refit from here" in offered and "Run it again" not in offered
    session.place = "paint"
    again = hands.place.next.fit
    qtbot.waitUntil(again.isVisible)
    assert again.text() == "Refit from here"
    qtbot.mouseClick(again, LEFT)
    assert session.place == "fit" and session.running
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    assert session.status_kind == "ok", session.status
    after = fitted.fit()
    assert after.round > before and place.record.newest == after.round
    template = next(one for one in after.templates if one.source == exemplar)
    on = fitted.shapes.named(exemplar).face_of_point
    assert np.array_equal(np.bincount(template.label, minlength=8), np.bincount(painted[on], minlength=8))
    for number in (1, after.round):  # rounds of the templates before have no points any more; looking at them is safe
        place.look_back(number)
        place._show_all()
    assert place.record.points(exemplar, after.round) is not None


def test_where_a_fit_cannot_be_taken_up_the_window_says_why_and_offers_a_new_one(open_window, fitted, qtbot):
    name = not_an_exemplar(fitted)
    window = open_window(fitted, "fit")
    place = place_of(window)
    fitted.set_part_names(PartNames((*fitted.part_names.ids, 90), (*fitted.part_names.names, "wing")))
    fitted.set_labels(name, np.zeros(fitted.shape_record(name)["n_faces"], np.int32))
    window.session.touch("labels")
    qtbot.waitUntil(place.correction.anew.isVisible)
    assert not place.correction.refit.isVisible()
    assert place.correction.words.text().startswith("The parts are others than in the fit. So it cannot")
    assert name in place.correction.words.text()
    qtbot.mouseClick(place.correction.anew, LEFT)
    qtbot.waitUntil(lambda: not window.session.running, timeout=LONG)
    assert "wing" in fitted.fit().templates[0].part_names and not place.correction.anew.isVisible()


def test_shapes_imported_after_the_fit_are_taken_into_it(open_window, fitted, tmp_path, qtbot):
    exemplars = {fitted.names[int(t)] for t in fitted.groups.exemplars}
    before = fitted.fit().round
    window = open_window(fitted, "fit")
    session, place = window.session, place_of(window)
    write_family(tmp_path / "more", "chairs", 1, seed=12)
    (new,) = (tmp_path / "more").glob("*.obj")
    new.rename(new.with_name("another.obj"))
    window.actions_table.import_shapes((tmp_path / "more" / "another.obj",))
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    assert {fitted.names[int(t)] for t in fitted.groups.exemplars} == exemplars, "painted exemplars stay"
    session.place = "fit"
    place._show_all()
    qtbot.waitUntil(place.correction.refit.isVisible)
    assert place.correction.words.text().startswith("New: another.")
    qtbot.mouseClick(place.correction.refit, LEFT)
    qtbot.waitUntil(lambda: not session.running, timeout=LONG)
    assert session.status_kind == "ok", session.status
    assert fitted.fit().round == before + 2 and "another" in fitted.fit_names
    session.shape = "another"
    place._show_all()
    assert place.record.points("another", fitted.fit().round) is not None
    assert place.record.points("another", 0) is None, "it was not there then"


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
