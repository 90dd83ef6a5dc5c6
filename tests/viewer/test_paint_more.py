"""Painting in the real window, continued: lassos with their twins, filling up to patches, parts hidden by keys."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from scipy.spatial import cKDTree

from shapeforge.viewer import spreading
from shapeforge.viewer.brushes import face_surface, mirrored_faces, patch_of_faces, up_to_patch
from tests.viewer.paint_hands import Painting
from tests.viewer.test_painting import sheet

SHIFT = Qt.KeyboardModifier.ShiftModifier


def around(hands: Painting, faces: np.ndarray, margin: int = 6) -> list[QPoint]:
    """A closed line around the places of faces on the screen."""
    places = np.array([hands.view.place_of(hands.painter.surface.centres[f]) for f in faces])
    (x0, y0), (x1, y1) = places.min(axis=0) - margin, places.max(axis=0) + margin
    return [QPoint(round(x), round(y)) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))]


def test_filling_stops_at_the_edge_of_the_patch():
    surface = face_surface(sheet(10))
    points = surface.centres + [0, 0.001, 0]
    patch = (surface.centres[:, 0] > 0.5).astype(int)
    found = patch_of_faces(surface, points, patch)
    assert np.array_equal(found, patch)
    assert np.array_equal(up_to_patch(surface, 0, found), np.flatnonzero(patch == patch[0]))


def test_twins_of_faces_are_those_opposite_and_again_themselves():
    surface = face_surface(sheet(10))
    normal = np.array([1.0, 0, 0])
    faces = np.array([3, 17, 40])
    twins = mirrored_faces(surface, faces, normal, 0.5)
    opposite = surface.centres[faces] * [-1, 1, 1] + [1, 0, 0]
    assert np.allclose(np.sort(surface.centres[twins], axis=0), np.sort(opposite, axis=0))
    assert np.array_equal(mirrored_faces(surface, twins, normal, 0.5), np.sort(faces))
    assert len(mirrored_faces(surface, faces, normal, 5.0)) == 0


def test_a_lasso_paints_the_opposite_side_too(painting):
    if painting.painter.mirror_plane is None:
        pytest.skip("this chair was generated without a mirror plane")
    painting.session.tool, painting.session.mirror = "lasso", True
    normal, offset, _ = painting.painter.mirror_plane
    centres = painting.painter.surface.centres
    side = centres[painting.visible()] @ normal - offset
    seen = painting.visible()[np.argsort(-np.abs(side))[:1]]
    painting.drag(*around(painting, seen, 12))
    done = painting.labels >= 0
    assert done.any()
    across = centres[done] - 2 * (centres[done] @ normal - offset)[:, None] * normal
    apart = cKDTree(centres[done]).query(across)[0]
    sides = np.sign(centres[done] @ normal - offset)
    assert {-1.0, 1.0} <= set(sides.tolist()) and np.median(apart) < 0.03
    assert painting.painter.state.undo_label is not None
    painting.session.undo()
    assert (painting.labels < 0).all()


def test_t_lets_the_lasso_take_what_lies_behind(painting, qtbot):
    painting.session.tool = "lasso"
    corners = around(painting, painting.visible())
    painting.drag(*corners)
    seen = painting.labels >= 0
    painting.session.undo()
    painting.key(Qt.Key.Key_T)
    assert painting.session.reach == "through" and "through" in painting.place.tool_hint.text()
    painting.drag(*corners)
    through = painting.labels >= 0
    assert through.sum() > 1.3 * seen.sum() and not (seen & ~through).any()


def test_the_fill_tool_stops_at_a_patch_when_told_to(painting, qtbot):
    face = int(painting.visible()[0])
    painting.key(Qt.Key.Key_F)
    painting.key(Qt.Key.Key_F, SHIFT)
    assert painting.session.fill_to == "patch" and painting.place.brush.fill.button("patch").isChecked()
    painting.click(face)
    done = np.flatnonzero(painting.labels >= 0)
    patches = painting.painter.face_patches
    assert face in done and set(patches[done].tolist()) == {patches[face]}
    row = np.repeat(np.arange(len(patches)), np.diff(painting.painter.surface.start))
    neighbour = painting.painter.surface.neighbour
    border = np.isin(row, done) & ~np.isin(neighbour, done)
    assert (patches[neighbour[border]] != patches[face]).all()


def test_parts_are_hidden_and_shown_by_keys(painting, qtbot):
    table = painting.window.actions_table
    assert table.verdict("show_all_parts") == (False, "All parts are shown.")
    painting.session.tool = "piece"
    painting.click(int(painting.visible()[0]))
    count = len(painting.view.shown.views[0].layers[0].triangles)
    before = painting.view.picture().astype(int)
    painting.key(Qt.Key.Key_H, SHIFT)
    assert painting.painter.hidden == {0}
    assert len(painting.view.shown.views[0].layers[0].triangles) < count
    qtbot.waitUntil(lambda: painting.view.at_rest, timeout=20000)
    qtbot.wait(200)
    assert (np.abs(painting.view.picture().astype(int) - before).sum(axis=2) > 60).any()
    painting.key(Qt.Key.Key_H, SHIFT | Qt.KeyboardModifier.ControlModifier)
    assert painting.painter.hidden == frozenset()
    assert len(painting.view.shown.views[0].layers[0].triangles) == count


def test_a_large_painting_is_completed_beside_the_hand(painting, qtbot, monkeypatch):
    from shapeforge.viewer import completing

    monkeypatch.setattr(completing, "AT_ONCE", 0)
    seen = painting.visible()
    height = painting.painter.surface.centres[seen, 1]
    painting.session.tool = "scribble"
    painting.click(int(seen[height.argmax()]))
    assert (painting.labels < 0).any()
    painting.session.part = 2
    painting.click(int(seen[height.argmin()]))
    assert painting.place.completion.busy and "filling" in painting.place.tool_hint.text()
    # A further stroke before it is there: that one counts, too.
    painting.session.part = 1
    third = int(seen[np.argsort(height)[len(seen) // 2]])
    painting.click(third)
    qtbot.waitUntil(lambda: not painting.place.completion.busy, timeout=60000)
    assert set(np.unique(painting.labels).tolist()) == {0, 1, 2} and painting.labels[third] == 1
    assert painting.painter.state.strokes[-1].tool == "complete"
    wanted = painting.painter.strokes_only()
    assert np.array_equal(painting.labels, spreading.complete(painting.painter.ground, wanted))
    painting.session.undo()
    assert (painting.labels < 0).any()


def test_parts_are_made_and_renamed_by_keys(painting, qtbot):
    painting.key(Qt.Key.Key_N, SHIFT)
    assert painting.painter.part_names[-1] == "part 1" and painting.session.part == 3
    editor = painting.place.parts.rows[-1].editor
    qtbot.waitUntil(editor.hasFocus)
    qtbot.keyClicks(editor, "foot")
    qtbot.keyClick(editor, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: painting.painter.part_names[-1] == "foot")
    qtbot.wait(30)
    painting.key(Qt.Key.Key_1)
    painting.key(Qt.Key.Key_F2)
    editor = painting.place.parts.rows[0].editor
    qtbot.waitUntil(editor.hasFocus)
    qtbot.keyClicks(editor, "lean")
    qtbot.keyClick(editor, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: painting.painter.part_names[0] == "lean")
