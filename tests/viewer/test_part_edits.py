"""Parts changed in the real window: every change is undone and redone, also after the program was closed."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QApplication

from shapeforge.collection.colours import PARTS
from shapeforge.collection.labels import PartNames
from shapeforge.store import Project
from shapeforge.viewer.painter import Painter
from shapeforge.viewer.palette import rgb
from shapeforge.viewer.part_edits import PartEdits
from shapeforge.viewer.readiness import next_step
from shapeforge.viewer.session import Session
from tests.viewer.conftest import run_stage
from tests.viewer.paint_hands import Painting, hands_of

LEFT, CONTROL, SHIFT = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


def share_of(hands: Painting, colour: str) -> int:
    """Pixels of the view whose hue is that of a colour."""
    picture, wanted = hands.view.picture().astype(int), np.array(rgb(colour), int)
    towards = picture / np.maximum(picture.sum(axis=-1, keepdims=True), 1)
    near = np.abs(towards - wanted / wanted.sum()).max(axis=-1) < 0.03
    return int((near & (picture.max(axis=-1) > 60)).sum())


def paint_pieces(hands: Painting, parts: int = 2) -> np.ndarray:
    """The largest pieces in sight, painted one by one with the first parts."""
    hands.session.tool = "piece"
    seen, piece = hands.visible(), hands.painter.surface.piece
    for part, one in enumerate(np.bincount(piece[seen]).argsort()[::-1][:parts]):
        hands.session.part = part
        hands.click(int(seen[piece[seen] == one][0]))
    assert set(range(parts)) <= set(hands.labels.tolist())
    return hands.labels.copy()


def undo(hands: Painting) -> None:
    hands.key(Qt.Key.Key_Z, CONTROL)


def redo(hands: Painting) -> None:
    hands.key(Qt.Key.Key_Z, CONTROL | SHIFT)


def test_a_part_gets_another_colour_by_mouse_and_it_is_undone(painting, qtbot):
    project = painting.session.project
    paint_pieces(painting)
    purple = PARTS[7]
    qtbot.waitUntil(lambda: share_of(painting, PARTS[0]) > 300, timeout=5000)
    qtbot.mouseClick(painting.place.parts.rows[0].swatch, LEFT)
    sheet = painting.place.parts.sheet
    assert sheet.isVisible() and "the colour of seat" in sheet.buttons[1].toolTip()
    qtbot.mouseClick(sheet.buttons[7], LEFT)
    assert project.part_names.colours == {"back": purple}
    assert Project.open(project.path).part_inks()[0].tolist() == list(rgb(purple))
    qtbot.waitUntil(lambda: share_of(painting, PARTS[0]) < 30 and share_of(painting, purple) > 300, timeout=5000)
    assert painting.place.parts.rows[0].colour == purple
    undo(painting)
    assert project.part_names.colours == {} and painting.session.history.redo_label == "colour back"
    qtbot.waitUntil(lambda: share_of(painting, PARTS[0]) > 300, timeout=5000)
    redo(painting)
    assert project.part_names.colours == {"back": purple}


def test_a_colour_is_chosen_by_keys_and_reset(painting, qtbot):
    project = painting.session.project
    painting.session.part = 2
    painting.key(Qt.Key.Key_C, SHIFT)
    sheet = painting.place.parts.sheet
    qtbot.waitUntil(sheet.isVisible)
    assert QApplication.focusWidget() is sheet.buttons[2]
    qtbot.keyClick(sheet, Qt.Key.Key_Down)
    qtbot.keyClick(sheet, Qt.Key.Key_Right)
    qtbot.keyClick(sheet, Qt.Key.Key_Return)
    assert project.part_names.colours == {"leg": PARTS[7]}
    painting.key(Qt.Key.Key_C, SHIFT)
    qtbot.mouseClick(painting.place.parts.sheet.own, LEFT)
    assert project.part_names.colours == {}


def test_merging_is_undone_on_every_shape_and_what_was_painted_since_stays(painting, qtbot):
    project, parts = painting.session.project, painting.place.parts
    first, other = painting.session.shape, next(n for n in project.names if n != painting.session.shape)
    on_other = np.arange(project.shape_record(other)["n_faces"], dtype=np.int32) % 3
    project.set_labels(other, on_other)
    before = paint_pieces(painting)
    painting.session.part = 0
    qtbot.mouseClick(parts.rows[1], LEFT, CONTROL)
    qtbot.mouseClick(parts.merge, LEFT)
    assert project.part_names.names == ("back", "leg")
    assert project.labels(other).tolist() == [[0, 0, 1][part] for part in on_other]
    assert np.array_equal(painting.labels == 0, before >= 0) and np.array_equal(project.labels(first), painting.labels)
    painting.session.shape = other
    painting.session.part, painting.session.tool = 1, "piece"
    painting.click(int(painting.visible()[0]))
    since = painting.labels == 1
    kept = painting.labels.copy()
    undo(painting)
    undo(painting)
    assert project.part_names.names == ("back", "seat", "leg")
    assert np.array_equal(painting.labels, on_other) and np.array_equal(project.labels(first), before)
    redo(painting)
    redo(painting)
    assert np.array_equal(painting.labels, kept) and since.any()


def test_a_removed_part_comes_back_with_its_paint_after_the_program_was_closed(painting, open_window, qtbot):
    project, name = painting.session.project, painting.session.shape
    before = paint_pieces(painting)
    painting.session.part = 0
    painting.key(Qt.Key.Key_Delete, SHIFT)
    assert project.part_names.names == ("seat", "leg") and np.array_equal(painting.labels >= 0, before == 1)
    assert "Undo brings it back" in painting.session.status
    painting.window.close()
    window = open_window(Project.open(project.path), "paint")
    window.session.shape = name
    again = hands_of(window, qtbot)
    assert np.array_equal(again.labels >= 0, before == 1)
    assert again.session.history.undo_label == "no back"
    undo(again)
    assert again.session.project.part_names.names == ("back", "seat", "leg")
    assert np.array_equal(again.labels, before) and np.array_equal(again.session.project.labels(name), before)
    for _ in range(2):
        undo(again)
    assert (again.labels == -1).all()
    for _ in range(3):
        redo(again)
    assert np.array_equal(again.labels >= 0, before == 1) and again.session.history.redo_label is None


def test_new_and_renamed_parts_are_undone_in_order_with_strokes(painting, qtbot):
    project, history = painting.session.project, painting.painter.history
    painting.key(Qt.Key.Key_N, SHIFT)
    editor = painting.place.parts.rows[-1].editor
    qtbot.waitUntil(editor.hasFocus)
    qtbot.keyClicks(editor, "arm")
    qtbot.keyClick(editor, Qt.Key.Key_Return)
    assert project.part_names.names[3] == "arm"
    painting.session.tool = "piece"
    painting.click(int(painting.visible()[0]))
    assert (painting.labels == 3).any()
    assert [text for text, *_ in history.steps()] == ["new part 1", "part 1 → arm", "arm"]
    undo(painting)
    assert (painting.labels == -1).all() and len(project.part_names) == 4
    undo(painting)
    assert project.part_names.names[3] == "part 1"
    undo(painting)
    assert project.part_names.names == ("back", "seat", "leg") and history.done == 0
    qtbot.mouseClick(painting.place.history.cards[3], LEFT)
    assert (painting.labels == 3).any() and project.part_names.names[3] == "arm"


def test_a_new_stroke_forgets_undone_changes_of_parts(painting):
    painting.painter.rename_part(0, "lean")
    undo(painting)
    assert painting.session.history.redo_label == "back → lean"
    painting.session.tool = "piece"
    painting.click(int(painting.visible()[0]))
    assert painting.session.history.redo_label is None
    assert PartEdits(painting.session.project).edits == []


def test_a_menu_offers_what_can_be_done_to_a_part(painting, qtbot):
    parts = painting.place.parts
    painting.session.part = 0
    parts.rows[2].menu_wanted.emit(parts.rows[2].mapToGlobal(QPoint(5, 5)))
    offered = {action.text(): action for action in parts.menu.actions() if action.text()}
    assert list(offered) == ["Rename", "Colour…", "Hide", "Merge into back", "Remove"]
    offered["Merge into back"].trigger()
    parts.menu.close()
    assert painting.session.project.part_names.names == ("back", "seat")


def test_labels_taken_from_files_meanwhile_are_shown_and_the_old_history_is_left_out(painting, meshes):
    project, name = painting.session.project, painting.session.shape
    paint_pieces(painting)
    painting.painter.rename_part(0, "lean")
    painting.place._save()
    run_stage(project, "label", labels=meshes)
    painting.session.touch("labels")
    assert np.array_equal(painting.labels, project.labels(name))
    assert painting.painter.part_names == project.part_names.names
    assert len(painting.place.parts.rows) == len(project.part_names) and painting.session.history.undo_label is None


@pytest.fixture
def proposed(grouped: Project) -> Project:
    run_stage(grouped, "cosegment", parts=3)
    return grouped


def test_proposed_parts_are_split_and_it_is_undone(open_window, proposed, qtbot):
    hands = hands_of(open_window(proposed, "paint"), qtbot)
    parts = hands.place.parts
    assert parts.split.isVisible() and not parts.remove.isVisible() and "Proposed" in parts.hint.text()
    hands.session.part = 0
    qtbot.mouseClick(parts.split, LEFT)
    qtbot.waitUntil(lambda: len(parts.rows) == 4 and not hands.session.running, timeout=60000)
    assert len(proposed.part_names) == 4 and hands.session.history.undo_label == "split part 1"
    undo(hands)
    qtbot.waitUntil(lambda: len(parts.rows) == 3 and not hands.session.running, timeout=60000)
    assert hands.session.history.redo_label == "split part 1"
    redo(hands)
    qtbot.waitUntil(lambda: len(parts.rows) == 4 and not hands.session.running, timeout=60000)


def test_proposed_parts_are_seen_pale_and_the_fit_can_start_from_them(open_window, proposed, qtbot):
    window = open_window(proposed)
    assert next_step(window.session) == ("go_fit", "Fit the family"), "nothing has to be painted"
    window.session.place = "paint"
    hands = hands_of(window, qtbot)
    shown = hands.view.shown.views[0].layers[0].colours
    assert 2 <= len(np.unique(shown, axis=0)) <= 3 and np.ptp(shown.astype(int), axis=1).max() > 40
    assert hands.place.next.fit.isEnabled() and "proposed parts" in hands.place.next.fit_why.text()
    hands.session.tool = "piece"
    hands.click(int(hands.visible()[0]))
    unpainted = hands.painter.state.labels[hands.painter.mesh.face_of_triangle] < 0
    after = hands.view.shown.views[0].layers[0].colours
    assert np.array_equal(after[unpainted], shown[unpainted]), "a fit takes the proposed parts there"
    assert not np.array_equal(after[~unpainted], shown[~unpainted]) and hands.place.next.fit.isEnabled()
    qtbot.waitUntil(lambda: "Proposed" not in hands.place.parts.hint.text(), timeout=5000)


def test_painted_parts_offer_remove_instead_of_split(painting):
    assert painting.place.parts.remove.isVisible() and not painting.place.parts.split.isVisible()
    can, why = painting.window.actions_table.verdict("split_part")
    assert not can and "proposed" in why


def test_the_parts_of_another_project_are_its_own(grouped, tmp_path):
    session = Session()
    session.open(grouped)
    painter = Painter(session)
    assert painter.add_part("back") == 0 and painter.history.undo_label == "new back"
    grouped.set_part_names(PartNames((4,), ("wing",)))  # somebody else's doing
    assert painter.part_names == ("wing",) and painter.history.undo_label is None
    assert painter.add_part("tail") == 1 and grouped.part_names.ids == (4, 5)
