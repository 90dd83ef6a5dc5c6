"""What a hand does in the window, by mouse and keys alone, and what the eye sees of it."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
from PySide6.QtCore import QPoint, Qt

from shapeforge.collection.colours import PARTS
from shapeforge.viewer.qt import choose_platform
from tests.viewer.test_correspondence_place import click, seen_points, spot
from tests.viewer.test_part_edits import share_of

LEFT, RIGHT = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton


def pixels(widget) -> np.ndarray:
    """What is seen of a widget (height, width, 3)."""
    image = widget.grab().toImage().convertToFormat(widget.grab().toImage().Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


def settled(view, qtbot) -> np.ndarray:
    """The picture of a 3-D view once it is drawn in full."""
    qtbot.waitUntil(lambda: view.at_rest, timeout=20000)
    qtbot.wait(100)
    return view.picture().astype(int)


def test_strokes_of_the_scribble_tool_are_completed_live(painting, qtbot):
    painting.key(Qt.Key.Key_S)
    assert painting.session.tool == "scribble"
    seen = painting.visible()
    seen = seen[np.argsort(painting.painter.surface.centres[seen, 1])]
    for key, faces in ((Qt.Key.Key_1, seen[-6:]), (Qt.Key.Key_3, seen[:6])):
        painting.key(key)
        painting.drag(*(painting.at(int(face)) for face in faces))
    qtbot.waitUntil(lambda: (painting.labels >= 0).all(), timeout=20000)
    assert set(np.unique(painting.labels)) == {0, 2}
    assert painting.labels[seen[-1]] == 0 and painting.labels[seen[0]] == 2
    assert painting.place.blank.text() == "All painted"
    qtbot.waitUntil(lambda: min(share_of(painting, PARTS[0]), share_of(painting, PARTS[2])) > 300, timeout=10000)


def test_the_eraser_takes_away_what_it_is_dragged_over_and_nothing_else(painting):
    painting.session.tool, painting.session.part = "piece", 1
    face = int(painting.visible()[0])
    painting.click(face)
    before = painting.labels.copy()
    painting.key(Qt.Key.Key_E)
    assert painting.session.tool == "eraser"
    painting.drag(painting.at(face), painting.at(face) + QPoint(2, 0))
    erased = (before == 1) & (painting.labels < 0)
    assert erased[face] and np.array_equal(painting.labels[~erased], before[~erased])


def test_isolate_leaves_the_part_in_hand_and_what_is_unpainted(painting, qtbot):
    painting.session.tool = "piece"
    pieces = painting.painter.surface.piece
    one, other = (int(face) for face in painting.visible()[[0, -1]])
    other = next(int(face) for face in painting.visible() if pieces[face] != pieces[one])
    for part, face in enumerate((one, other)):
        painting.session.part = part
        painting.click(face)
    whole, count = settled(painting.view, qtbot), len(painting.view.shown.views[0].layers[0].triangles)
    qtbot.mouseClick(painting.place.isolate, LEFT)
    hidden = (painting.labels == 0)[painting.painter.mesh.face_of_triangle].sum()
    assert hidden and len(painting.view.shown.views[0].layers[0].triangles) == count - hidden
    assert (np.abs(settled(painting.view, qtbot) - whole).sum(axis=2) > 60).mean() > 1e-3
    qtbot.mouseClick(painting.place.isolate, LEFT)
    assert np.abs(settled(painting.view, qtbot) - whole).max() < 30


def test_where_nothing_is_painted_parts_are_proposed_by_a_click_and_their_shares_shown(open_window, grouped, qtbot):
    window = open_window(grouped, "paint")
    place = window.places["paint"]
    assert "let parts be proposed" in place.next.fit_why.text()
    grey = settled(place.view, qtbot)
    qtbot.mouseClick(place.parts.propose, LEFT)
    qtbot.waitUntil(lambda: not window.session.running and len(place.parts.rows) > 1, timeout=60000)
    assert window.session.status_kind == "ok", window.session.status
    assert not place.parts.propose.isVisible() and place.blank.text() == "Proposed"
    shares = [int(one.share.text().strip("<%")) for one in place.parts.rows]
    assert 97 <= sum(shares) <= 103
    assert "part 1" in place.tool_hint.text() and place.next.fit.isEnabled()
    assert (np.abs(settled(place.view, qtbot) - grey).sum(axis=2) > 60).mean() > 0.01, "they are seen"
    assert (place.painter.state.labels < 0).all(), "and nothing is painted"


def test_turning_one_shape_turns_all_of_them(lightbox, qtbot):
    view, target = lightbox.view, lightbox.view.plotter
    before = settled(view, qtbot)
    start = QPoint(view.width() // 8, view.height() // 6)
    qtbot.mousePress(target, RIGHT, pos=start)
    for step in range(1, 6):
        qtbot.mouseMove(target, start + QPoint(14 * step, 0))
    qtbot.mouseRelease(target, RIGHT, pos=start + QPoint(70, 0))
    moved = np.abs(settled(view, qtbot) - before).sum(axis=2) > 60
    rows, columns = view.shown.rows, view.shown.columns
    cells = [cell for band in np.array_split(moved, rows, axis=0) for cell in np.array_split(band, columns, axis=1)]
    assert all(cell.mean() > 1e-3 for cell in cells[: len(view.shown.views)])


def test_the_distances_of_a_second_click_are_plotted(lightbox, qtbot):
    histogram = lightbox.inspector.histogram
    points = seen_points(lightbox, 0)
    shape = lightbox.box.shape(lightbox.names[0])
    far = max(points, key=lambda k: np.linalg.norm(shape.positions[k] - shape.positions[points[0]]))
    click(qtbot, lightbox, spot(lightbox, 0, points[0]))
    assert not histogram.isVisible()
    click(qtbot, lightbox, spot(lightbox, 0, far))
    qtbot.waitUntil(histogram.isVisible)
    seen = pixels(histogram)
    ground = seen[0, 0]
    assert (np.abs(seen - ground).sum(axis=2) > 60).mean() > 0.02, "bars"


def test_before_a_point_is_picked_the_parts_are_shown(lightbox, qtbot):
    layer = lightbox.view.shown.views[0].layers[0]
    assert len(np.unique(layer.colours.reshape(-1, 3), axis=0)) > 1
    assert lightbox.inspector.legend_text.text().startswith("Until a point is picked")
    click(qtbot, lightbox, spot(lightbox, 0, seen_points(lightbox, 0)[0]))
    after = lightbox.view.shown.views[0].layers[0]
    assert not lightbox.inspector.legend_text.isVisible()
    assert len(after.colours) != len(layer.colours) or not np.array_equal(after.colours, layer.colours)


def test_exemplars_are_marked_on_the_map(open_window, grouped, qtbot):
    window = open_window(grouped)
    shown = window.places["collection"].map
    names = [grouped.names[int(t)] for t in grouped.groups.exemplars]
    other = next(name for name in grouped.names if name not in names)

    def ring(name: str) -> int:
        """Pixels on the circle around a picture that are no ground."""
        at, angle = shown.at(shown.content.names.index(name)), np.linspace(0, 2 * np.pi, 90)
        seen, ratio = pixels(shown), shown.devicePixelRatio()
        x, y = (
            ratio * (at.x() + 0.56 * shown.tile * np.cos(angle)),
            ratio * (at.y() + 0.56 * shown.tile * np.sin(angle)),
        )
        x, y = x.round().astype(int).clip(0, seen.shape[1] - 1), y.round().astype(int).clip(0, seen.shape[0] - 1)
        return int((seen[y, x].max(axis=1) > 110).sum())

    assert min(ring(name) for name in names) > 60 > ring(other)


def test_under_wayland_the_window_goes_through_x11_where_that_is():
    both = {"WAYLAND_DISPLAY": "wayland-0", "DISPLAY": ":0"}
    choose_platform(both)
    assert both["QT_QPA_PLATFORM"] == "xcb" and both["QT_XCB_GL_INTEGRATION"] == "xcb_glx"
    alone = {"WAYLAND_DISPLAY": "wayland-0"}
    choose_platform(alone)
    assert "QT_QPA_PLATFORM" not in alone
    chosen = {"DISPLAY": ":0", "QT_QPA_PLATFORM": "wayland"}
    choose_platform(chosen)
    assert chosen["QT_QPA_PLATFORM"] == "wayland", "what the user has set stays"


FINE_SCREEN = """
    import sys
    import numpy as np
    from pathlib import Path
    from PySide6.QtCore import QLocale, QPoint, Qt
    from PySide6.QtTest import QTest
    from PySide6.QtWidgets import QApplication

    QLocale.setDefault(QLocale(QLocale.Language.German))
    application = QApplication([])
    from shapeforge.store import Project
    from shapeforge.viewer.qt.window import Window

    window = Window()
    window.session.open(Project.open(Path(sys.argv[1])))
    window.session.place = "paint"
    window.show()
    place = window.places["paint"]
    for _ in range(400):
        QTest.qWait(25)
        if place.view.frames and place.view.at_rest:
            break
    painter, view = place.painter, place.view
    ratio = window.devicePixelRatio()
    window.session.tool = "piece"
    painted = 0
    for face in range(0, painter.mesh.n_faces, 7):
        x, y = view.place_of(painter.surface.centres[face])
        hit = view.pick(round(x), round(y))
        if hit is not None and painter.face_of(hit.triangle) == face:
            QTest.mouseClick(view.plotter, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier,
                             QPoint(round(x), round(y)))
            painted = int(painter.state.labels[face] >= 0)
            break
    picture = view.picture()
    print(ratio, painted, picture.shape[1] / view.width(), place.brush.size_value.text())
    window.close()
"""


def test_on_a_fine_screen_and_in_a_comma_locale_a_click_hits_and_numbers_have_dots(grouped, monkeypatch):
    monkeypatch.setenv("QT_SCALE_FACTOR", "2")
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    command = [sys.executable, "-c", textwrap.dedent(FINE_SCREEN), str(grouped.path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode == 0, run.stderr
    ratio, painted, finer, size = run.stdout.split()
    assert float(ratio) == 2 and painted == "1" and float(finer) == 2, "the picture is as fine as the screen"
    assert size == "3.4%"
