"""The Session says what changed, once; edits go back and forth; colours are those of the house."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shapeforge.collection.colours import PARTS
from shapeforge.viewer import palette
from shapeforge.viewer.session import Session


def test_a_change_is_told_once_and_no_change_is_not():
    session, heard = Session(), []
    session.events.shape.connect(lambda new, old: heard.append((new, old)))
    session.shape = "a"
    session.shape = "a"
    session.shape = None
    assert heard == [("a", None), (None, "a")]


def test_progress_with_arrays_is_compared_by_identity():
    session, heard = Session(), []
    session.events.progress.connect(heard.append)
    state = np.ones(3)
    session.progress = state
    session.progress = state
    session.progress = state.copy()
    assert len(heard) == 2


def test_opening_another_project_drops_every_selection():
    class Folder:
        path = "/somewhere/chairs"

    session = Session(shape="a", watched=("a",), compare=("b",), round=3, picked=7, sliders={0: 1.0}, place="fit")
    session.open(Folder())
    assert (session.shape, session.watched, session.compare, session.round) == (None, (), (), None)
    assert (session.picked, session.sliders, session.place, session.status) == (None, {}, "collection", "Opened chairs")


def test_touching_counts_a_revision_before_it_tells():
    session, heard = Session(), []
    session.data_changed.connect(lambda what: heard.append((what, session.revision)))
    session.touch("groups")
    assert heard == [("groups", 1)]


@given(st.lists(st.sampled_from(["do", "undo", "redo"]), max_size=30))
def test_undo_then_redo_is_the_identity(steps):
    session, value = Session(), [0]
    number = 0
    for step in steps:
        if step == "do":
            number += 1
            old, new = value[0], number
            session.do(str(new), lambda new=new: value.__setitem__(0, new), lambda old=old: value.__setitem__(0, old))
        else:
            getattr(session, step)()
    before = value[0]
    if session.history.undo_label is not None:
        session.undo()
        assert value[0] != before
        session.redo()
    assert value[0] == before


def test_a_new_edit_forgets_what_was_undone():
    session = Session()
    session.do("first", lambda: None, lambda: None)
    session.undo()
    assert session.history.redo_label == "first"
    session.do("second", lambda: None, lambda: None)
    assert session.history.redo_label is None
    assert session.history.undo_label == "second"


def test_both_themes_name_the_same_colours():
    assert palette.DARK.keys() == palette.LIGHT.keys()
    for colour in (*palette.DARK.values(), *palette.LIGHT.values()):
        assert len(palette.rgb(colour)) == 3


def luminance(colours: np.ndarray) -> np.ndarray:
    linear = (colours / 255.0) ** 2.2
    return linear @ (0.2126, 0.7152, 0.0722)


def test_heat_grows_darker_all_the_way():
    dark = luminance(palette.heat(np.linspace(0, 1, 41)))
    assert np.diff(dark).max() < 0, "the worst step must darken, too"


def test_heat_takes_what_is_outside_and_what_is_no_number():
    colours = palette.heat(np.array([-1.0, np.nan, 0.0, 2.0, 1.0]))
    assert (colours[:3] == colours[0]).all()
    assert (colours[3] == colours[4]).all()


def test_neighbouring_parts_never_share_a_colour():
    colours = palette.part_colours(40).astype(int)
    apart = np.abs(colours[1:] - colours[:-1]).sum(axis=1)
    assert apart.min() > 60
    assert len(np.unique(colours[:36], axis=0)) == 36


def test_unknown_labels_are_unpainted_grey():
    colours = palette.label_colours(np.array([0, -1, 5]), palette.part_colours(2))
    assert tuple(colours[1]) == tuple(colours[2]) == palette.rgb(palette.UNPAINTED)
    assert tuple(colours[0]) == palette.rgb(PARTS[0])


@pytest.mark.parametrize("name", ["DARK", "LIGHT"])
def test_text_can_be_read_on_its_ground(name):
    tokens = getattr(palette, name)

    def contrast(first: str, second: str) -> float:
        high, low = sorted((float(luminance(np.array(palette.rgb(c)))) for c in (first, second)), reverse=True)
        return (high + 0.05) / (low + 0.05)

    assert contrast(tokens["text"], tokens["panel"]) > 7
    assert contrast(tokens["text_2"], tokens["panel"]) > 4.5
    for status in ("ok", "warning", "error"):
        assert contrast(tokens[status], tokens["panel"]) > 4.0


def test_the_session_loads_no_window():
    code = (
        "import sys, shapeforge.viewer.actions, shapeforge.viewer.runner; "
        "print([m for m in sys.modules if 'PySide6' in m or 'vtk' in m.lower()])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
