"""The real window: the frame stands still, marks tell, keys and mouse reach the Session, closing loses nothing."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from PySide6.QtGui import QDropEvent
from PySide6.QtWidgets import QToolTip, QWidget

from shapeforge.stages import Progress
from shapeforge.store import Project
from shapeforge.viewer import missing_graphics
from shapeforge.viewer.palette import DARK, LIGHT, rgb
from shapeforge.viewer.qt import icons
from shapeforge.viewer.qt.theme import HEADER, INSPECTOR, RAIL, STRIP, TOOL_ROW, family

LEFT = Qt.MouseButton.LeftButton


def pixel(window: QWidget, x: int, y: int) -> tuple[int, int, int]:
    """Colour of a pixel of the window as it is on the screen."""
    image = window.grab().toImage()
    ratio = image.devicePixelRatio()
    colour = image.pixelColor(round(x * ratio), round(y * ratio))
    return colour.red(), colour.green(), colour.blue()


def box(window: QWidget, widget: QWidget) -> tuple[int, int, int, int]:
    corner = widget.mapTo(window, QPoint(0, 0))
    return corner.x(), corner.y(), widget.width(), widget.height()


def test_without_a_project_there_is_a_way_to_begin(open_window, qtbot, monkeypatch, grouped):
    window = open_window()
    assert window.pages.currentWidget() is window.start_page
    assert set(window.start_page.ways) == {"import_folder", "open_project", "try_demo"}
    assert {button.mark for button in window.rail.places.values()} == {"locked"}
    monkeypatch.setattr(window, "choose_folder", lambda title: Path(grouped.path))
    qtbot.mouseClick(window.start_page.ways["open_project"], LEFT)
    assert window.session.project.names == grouped.names
    assert window.windowTitle() == "chairs – shapeforge"
    assert window.pages.currentWidget() is not window.start_page


def test_a_wrong_folder_is_said_on_the_start_page(open_window, qtbot, monkeypatch, tmp_path):
    window = open_window()
    monkeypatch.setattr(window, "choose_folder", lambda title: tmp_path)
    qtbot.mouseClick(window.start_page.ways["open_project"], LEFT)
    assert window.session.project is None
    assert "project" in window.start_page._status.text()


def drop(window: QWidget, path: Path) -> None:
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(path))])
    event = QDropEvent(QPointF(5, 5), Qt.DropAction.CopyAction, data, LEFT, Qt.KeyboardModifier.NoModifier)
    window.start_page.dropEvent(event)


def test_a_dropped_project_opens(open_window, grouped):
    window = open_window()
    drop(window, Path(grouped.path))
    assert window.session.project.names == grouped.names


def test_dropped_models_are_imported_and_grouped(open_window, qtbot, meshes, tmp_path):
    models = tmp_path / "models"
    models.mkdir()
    for number in range(4):
        (models / f"chair_{number}.obj").write_bytes((meshes / f"chair_000{number}.obj").read_bytes())
    window = open_window()
    drop(window, models)
    qtbot.waitUntil(window.import_dialog.start.isEnabled, timeout=60000)
    qtbot.mouseClick(window.import_dialog.start, LEFT)
    assert window.session.running and window.session.stage == "import"
    assert window.rail.places["collection"].mark == "running"
    qtbot.waitUntil(lambda: not window.session.running, timeout=120000)
    project = Project.open(tmp_path / "models-project")
    assert len(project.names) == 4 and project.groups is not None
    assert window.session.status_kind == "ok"
    assert window.rail.places["collection"].mark == "done"


def test_the_frame_has_the_sizes_of_the_house_in_every_place(open_window, fitted):
    window = open_window(fitted)
    stacks = window.stacks
    for place in ("collection", "fit"):
        window.session.place = place
        right, bottom = window.width() - INSPECTOR, window.height() - STRIP
        assert box(window, window.rail) == (0, 0, RAIL, window.height())
        assert box(window, window.header) == (RAIL, 0, window.width() - RAIL, HEADER)
        assert box(window, stacks["toolrow"]) == (RAIL, HEADER, right - RAIL, TOOL_ROW)
        assert box(window, stacks["centre"]) == (RAIL, HEADER + TOOL_ROW, right - RAIL, bottom - HEADER - TOOL_ROW)
        assert box(window, stacks["strip"]) == (RAIL, bottom, right - RAIL, STRIP)
        assert box(window, stacks["inspector"]) == (right, HEADER, INSPECTOR, window.height() - HEADER)


def test_the_smallest_window_cuts_nothing_off(open_window, fitted):
    window = open_window(fitted)
    for place in ("collection", "fit"):
        window.session.place = place
        window.resize(window.minimumSize())
        assert (window.width(), window.height()) == (1280, 800)
        piece = window.stacks["toolrow"].currentWidget()
        for child in piece.findChildren(QWidget):
            if child.isVisible() and child.parentWidget() is piece:
                assert child.geometry().right() <= piece.width(), f"{place}: {child} sticks out"


def test_a_locked_place_says_why_and_is_not_entered(open_window, qtbot, grouped):
    window = open_window(grouped)
    fit = window.rail.places["fit"]
    assert fit.mark == "locked"
    assert "labels" in fit.toolTip()
    qtbot.mouseClick(fit, LEFT)
    assert window.session.place == "collection"
    assert window.session.status_kind == "warning" and "labels" in window.session.status
    assert window.rail.places["collection"].isChecked() and not fit.isChecked()


def test_keys_go_to_places(open_window, qtbot, fitted):
    window = open_window(fitted)
    qtbot.keyClick(window, Qt.Key.Key_3, Qt.KeyboardModifier.ControlModifier)
    assert window.session.place == "fit"
    qtbot.keyClick(window, Qt.Key.Key_1, Qt.KeyboardModifier.ControlModifier)
    assert window.session.place == "collection"


def test_search_finds_a_shape_by_a_part_of_its_name(open_window, qtbot, grouped):
    window = open_window(grouped)
    window.activateWindow()
    qtbot.keyClick(window, Qt.Key.Key_K, Qt.KeyboardModifier.ControlModifier)
    search = window.header.search
    qtbot.keyClicks(search, "0005")
    qtbot.keyClick(search, Qt.Key.Key_Return)
    assert window.session.shape == "chair_0005"
    assert search.text() == ""
    qtbot.keyClicks(search, "sofa")
    qtbot.keyClick(search, Qt.Key.Key_Return)
    assert window.session.shape == "chair_0005"
    assert "sofa" in window.session.status and window.session.status_kind == "warning"


def test_undo_and_redo_are_named_and_do_it(open_window, qtbot, grouped):
    window = open_window(grouped)
    session, header = window.session, window.header
    assert not header.undo.isEnabled() and "Nothing to undo" in header.undo.toolTip()
    groups = grouped.groups
    g = int(np.argmax([len(groups.members(g)) for g in range(len(groups))]))
    session.shape = next(grouped.names[t] for t in groups.members(g) if t != groups.exemplars[g])
    window.actions_table.run("make_exemplar")
    assert header.undo.isEnabled() and session.shape in header.undo.toolTip()
    qtbot.mouseClick(header.undo, LEFT)
    assert (grouped.groups.exemplars == groups.exemplars).all()
    qtbot.mouseClick(header.redo, LEFT)
    assert grouped.names[grouped.groups.exemplars[g]] == session.shape


def test_the_theme_changes_every_pixel_of_the_ground(open_window, qtbot, grouped):
    window = open_window(grouped)
    spots = {"rail": (40, 600), "panel": (700, 8), "view": (90, 110)}
    for theme, tokens in (("dark", DARK), ("light", LIGHT)):
        window.session.theme = theme
        for role, (x, y) in spots.items():
            wanted = rgb(tokens["window" if role == "rail" else role])
            assert np.abs(np.subtract(pixel(window, x, y), wanted)).max() <= 8, (theme, role)  # 16-bit screens
    qtbot.mouseClick(window.rail.theme_button, LEFT)
    assert window.session.theme == "dark"


@pytest.mark.parametrize("first", ["collection", "fit"])
def test_pictures_and_views_do_not_draw_into_each_other(open_window, qtbot, fitted, first):
    """VTK's hidden window for pictures and Qt's GL share a thread: mixed up, pictures are empty or the screen black."""
    window = open_window(fitted, first)
    if first == "fit":
        qtbot.waitUntil(lambda: window.places["fit"].view.frames > 0)
        window.session.place = "collection"
    place = window.places["collection"]
    place.pictures._timer.stop()
    for name in fitted.names:  # the worst order: Qt draws the whole window before and after each picture
        place.pictures.shape(name, 123, colour=(200, 100, 50))
    while place.pictures.waiting:
        window.repaint()
        place.pictures._timer.stop()
        place.pictures._take_one()
    window.repaint()
    qtbot.wait(300)
    screen = window.screen().grabWindow(window.winId()).toImage()
    colour = screen.pixelColor(40, 450)  # the first screen of a test is 800 x 600
    seen = (colour.red(), colour.green(), colour.blue())
    assert np.abs(np.subtract(seen, rgb(DARK["window"]))).max() <= 8, "the screen shows the window"
    for key, pixmap in place.pictures._known.items():
        image = pixmap.toImage()
        corners = [(0, 0), (image.width() - 1, 0), (0, image.height() - 1), (image.width() - 1, image.height() - 1)]
        assert all(image.pixelColor(x, y).alpha() == 0 for x, y in corners), key
        alpha = [
            image.pixelColor(x, y).alpha() for x in range(0, image.width(), 4) for y in range(0, image.height(), 4)
        ]
        assert np.mean(np.array(alpha) > 200) > 0.03, f"{key}: hardly anything in the picture"


def test_every_icon_draws_something_and_no_two_are_alike():
    drawn = {}
    for name in icons.names():
        image = icons.pixmap(name, "#FFFFFF", 16, 2.0).toImage()
        ink = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
        assert 20 < (ink > 0).sum(), name
        drawn[name] = ink.tobytes()
    alike = {frozenset((a, b)) for a in drawn for b in drawn if a < b and drawn[a] == drawn[b]}
    assert alike <= {frozenset(("paint", "brush"))}


def test_an_unknown_icon_is_refused():
    with pytest.raises(ValueError, match="name must be one of"):
        icons.pixmap("unicorn", "#FFFFFF")


def test_the_bundled_font_is_used(qapp):
    assert family() == "Inter"


def test_every_button_has_words_or_a_tooltip(open_window, fitted):
    from PySide6.QtWidgets import QAbstractButton

    window = open_window(fitted)
    window.session.place = "fit"
    for one in window.findChildren(QAbstractButton):
        if one.isVisible():
            assert one.text() or one.toolTip() or one.layout() is not None, one
        if one.isVisible() and not one.isEnabled() and one.property("kind") != "crumb":
            assert one.toolTip(), f"{one.text()!r} is off and does not say why"


def test_the_help_lists_every_shortcut(open_window):
    window = open_window()
    dialog = window.help_dialog()
    from PySide6.QtWidgets import QLabel

    words = {one.text() for one in dialog.findChildren(QLabel)}
    for action in window.actions_table.values():
        if action.shortcut:
            assert action.label.rstrip("…") in words
    dialog.deleteLater()


def test_a_failing_stage_is_said_and_logged(open_window, qtbot, grouped):
    window = open_window(grouped)

    def broken():
        raise ValueError("shapes: wanted 2, got 0. Import some.")
        yield

    window.start("group", broken)
    qtbot.waitUntil(lambda: not window.session.running)
    assert window.session.status == "shapes: wanted 2, got 0. Import some."
    assert window.session.status_kind == "error"
    assert "ValueError" in (Path(grouped.path) / "shapeforge.log").read_text()


def test_closing_while_something_runs_stops_it_between_two_steps(open_window, qtbot, grouped):
    window = open_window(grouped)
    finished = []

    def long():
        try:
            for step in range(1000):
                yield Progress("group", "comparing", step, 1000)
                time.sleep(0.01)
        finally:
            finished.append(True)

    window.start("group", long)
    qtbot.waitUntil(lambda: window.session.progress is not None)
    begin = time.monotonic()
    window.close()
    assert finished == [True]
    assert time.monotonic() - begin < 3
    assert not window.runner.running


def test_a_closed_window_hears_nothing_more(open_window, grouped):
    window = open_window(grouped)
    session = window.session
    window.close()
    session.theme = "light"
    session.shape = grouped.names[0]
    session.touch("groups")
    assert window.property("theme") == "dark"


def test_missing_libraries_are_named_before_vtk_is_loaded(monkeypatch):
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    assert "libEGL" in missing_graphics() and "apt install" in missing_graphics()
    monkeypatch.undo()
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "no screen" in missing_graphics()


@pytest.fixture(autouse=True)
def _no_tooltips_left():
    yield
    QToolTip.hideText()
