"""Every control of the places says what it does and, where it is off, why; and the keyboard reaches it."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QAbstractButton, QAbstractSlider, QComboBox, QLineEdit, QScrollBar, QWidget

from shapeforge.collection.labels import PartNames
from shapeforge.viewer.qt.controls import Clickable, EditableName
from shapeforge.viewer.qt.paint_words import can_fit
from shapeforge.viewer.qt.widgets import ElidedLabel, button, column, framed, row, scrolled

LEFT = Qt.MouseButton.LeftButton
PLACES = ("collection", "paint", "fit", "correspondence")
LONG = "a part that somebody gave a very long name so that it says all that is to be said"


def controls_of(window: QWidget) -> list[QWidget]:
    """What can be clicked or typed into, and is seen."""
    kinds = (QAbstractButton, QAbstractSlider, QComboBox, QLineEdit, Clickable)
    found = [one for one in window.findChildren(QWidget) if isinstance(one, kinds) and one.isVisible()]
    return [one for one in found if not isinstance(one, QScrollBar)]


def called(one: QWidget) -> str:
    text = one.text() if hasattr(one, "text") else ""
    return f"{type(one).__name__} {text or one.accessibleName() or one.objectName()!r}"


@pytest.mark.parametrize("stage", ["grouped", "fitted"])
def test_every_control_says_what_it_does_and_the_keyboard_reaches_it(open_window, request, stage):
    """Those that Tab does not stop at name their key in brackets."""
    window = open_window(request.getfixturevalue(stage))
    silent, unreached, unexplained = set(), set(), set()
    for place in PLACES[: 2 if stage == "grouped" else 4]:
        window.session.place = place
        for one in controls_of(window):
            tip = one.toolTip()
            if not tip.strip():
                silent.add((place, called(one)))
            if not one.focusPolicy() & Qt.FocusPolicy.TabFocus and not re.search(r"\(\S.*\)", tip):
                unreached.add((place, called(one)))
            if not one.isEnabled() and "\n" not in tip:  # what it does, and in a line of its own why not now
                unexplained.add((place, called(one), tip))
    assert not silent, silent
    assert not unreached, unreached
    assert not unexplained, unexplained


def test_long_names_are_shortened_and_push_nothing_out(open_window, fitted, qtbot):
    """The inspector keeps its width whatever parts, groups and shapes are called; tooltips say all of it."""
    names = fitted.part_names
    fitted.set_part_names(PartNames(names.ids, (LONG, *names.names[1:])))
    window = open_window(fitted)
    for place in ("collection", "paint", "fit"):
        window.session.place = place
        if place == "collection":
            window.places[place].groups._rename(0, LONG.capitalize())
            qtbot.waitUntil(lambda: fitted.groups.names[0] == LONG.capitalize())
            qtbot.mouseClick(window.places[place].groups.rows[0], LEFT)
        if place == "fit":
            record = window.places[place].record
            record.looks = tuple(replace(look, part_names=(LONG, *look.part_names[1:])) for look in record.looks)
            window.places[place].report.show_fit(record, window.session, record.newest)
        qtbot.wait(50)
        inspector = window.stacks["inspector"].currentWidget()
        width = window.stacks["inspector"].width()
        for one in inspector.findChildren(QWidget):
            if one.isVisible():
                right = one.mapTo(inspector, one.rect().topRight()).x()
                assert right <= width, f"{place}: {called(one)} ends at {right} of {width}"

        def named(inspector: QWidget = inspector) -> list[ElidedLabel]:
            labels = [one for one in inspector.findChildren(ElidedLabel) if one.isVisible()]
            return [one for one in labels if LONG in one.full_text().lower()]

        qtbot.waitUntil(lambda: len(named()) > 0, timeout=5000)
        assert all("…" in one.text() and LONG in one.toolTip().lower() for one in named()), place


def test_a_long_name_is_edited_whole(qtbot):
    name = EditableName(LONG)
    qtbot.addWidget(name)
    name.resize(90, 24)
    name.show()
    heard: list[str] = []
    name.renamed.connect(heard.append)
    name.start()
    assert name.editor.text() == LONG
    qtbot.keyClick(name.editor, Qt.Key.Key_Return)
    assert heard == [] and name.text() == LONG, "nothing was changed"


def test_the_next_exemplar_of_a_long_name_is_named_in_one_line(open_window, grouped, qtbot, monkeypatch):
    monkeypatch.setattr("shapeforge.viewer.qt.paint_sections.next_to_paint", lambda session: LONG)
    monkeypatch.setattr("shapeforge.viewer.qt.paint_words.unpainted_exemplars", lambda session: [LONG])
    window = open_window(grouped, "paint")
    window.resize(1280, 800)
    step = window.places["paint"].next
    can, why = can_fit(window.session, window.places["paint"].painter)
    step.show_next((can, why), None)
    qtbot.waitUntil(lambda: step.fit_why.height() >= step.fit_why.heightForWidth(step.fit_why.width()))
    assert not can and step.go_exemplar.isVisible() and LONG in step.go_exemplar.toolTip()
    assert step.go_exemplar.fontMetrics().horizontalAdvance(step.go_exemplar.text()) <= step.width() - 32


def test_what_is_too_wide_in_an_inspector_pushes_nothing_else_out(qtbot):
    wide, last = button(LONG), button("Turn…")
    area = scrolled(framed(column(wide, row(button("Move to…"), None, last))))
    qtbot.addWidget(area)
    area.resize(312, 400)
    area.show()
    qtbot.waitExposed(area)
    assert last.mapTo(area, last.rect().topRight()).x() < 312
    area.resize(360, 400)
    assert 330 < last.mapTo(area, last.rect().topRight()).x() < 360, "and it grows with the window"
