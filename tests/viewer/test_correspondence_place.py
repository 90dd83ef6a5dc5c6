"""The lightbox in the real window: a point picked on one shape is the same template point on all."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QFrame, QLabel, QPushButton, QWidget
from scipy.sparse import csr_matrix

from shapeforge.store import Project
from shapeforge.viewer.fine_mesh import fine_mesh
from shapeforge.viewer.fuzzy import Fuzzy, fuzzy_correspondence, part_bits, where_it_may_lie
from shapeforge.viewer.lightbox import CLOSE, FARTHEST, Lightbox, confidence_of, describe_point
from shapeforge.viewer.palette import heat, part_colours
from shapeforge.viewer.qt.overlay import whole_percent
from shapeforge.viewer.session import Session
from tests.viewer.turned import turn_shape

LEFT, NONE = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
CONTROL = Qt.KeyboardModifier.ControlModifier


def spot(place, cell: int, point: int) -> QPoint | None:
    """Where template point ``point`` is seen in a cell: None when something is in front of it."""
    shape = place.box.shape(place.names[cell])
    if not np.isfinite(shape.positions[point]).all():
        return None
    x, y = place.view.place_of(shape.positions[point], cell)
    at = QPoint(round(x), round(y))
    pick = place.view.pick(at.x(), at.y())
    if pick is None or pick.view != cell or np.linalg.norm(pick.position - shape.positions[point]) > 0.03:
        return None
    return at


def seen_points(place, cell: int) -> list[int]:
    return [k for k in range(0, place.box.n_points, 3) if spot(place, cell, k) is not None]


def button_of(place, widget: QWidget, action: str) -> QPushButton:
    """The button of an action within a widget."""
    wanted = place.actions[action].label
    return next(one for one in widget.findChildren(QPushButton) if one.accessibleName() == wanted)


def click(qtbot, place, at: QPoint, modifiers=NONE) -> None:
    qtbot.mouseClick(place.view.plotter, LEFT, modifiers, at)


def test_the_family_lies_side_by_side_with_names_and_confidence(lightbox):
    assert set(lightbox.names) == set(lightbox.session.project.fit_names)
    shown = lightbox.view.shown
    assert [view.name for view in shown.views] == list(lightbox.names)
    assert all(0 <= view.confidence <= 1 for view in shown.views)
    values = [view.confidence for view in shown.views]
    assert values == sorted(values, reverse=True)
    cameras = {id(cell.renderer.GetActiveCamera()) for cell in lightbox.view.scene.cells}
    assert len(cameras) == 1, "the same camera for the whole family"


def test_a_click_lights_the_same_template_point_on_all(lightbox, qtbot):
    at = spot(lightbox, 0, seen_points(lightbox, 0)[2])
    click(qtbot, lightbox, at)
    picked = lightbox.session.picked
    pick = lightbox.view.pick(at.x(), at.y())
    positions = lightbox.box.shape(lightbox.names[0]).positions
    assert picked == int(np.nanargmin(np.linalg.norm(positions - pick.position, axis=1)))
    for name, view in zip(lightbox.names, lightbox.view.shown.views, strict=True):
        shape = lightbox.box.shape(name)
        dots = [mark for mark in view.marks if mark.kind == "dot"]
        if shape.existence[picked]:
            assert np.allclose(dots[0].at, lightbox.session.project.positions(name)[picked])
        else:
            assert not dots and "has no" in view.captions[0].lines[1][0]
    assert lightbox.session.shape == lightbox.names[0]
    assert lightbox.inspector.first_name.full_text() == lightbox.box.describe(picked)


def test_a_second_click_measures_on_every_shape(lightbox, qtbot):
    points = seen_points(lightbox, 0)
    click(qtbot, lightbox, spot(lightbox, 0, points[0]))
    click(qtbot, lightbox, spot(lightbox, 0, points[-1]))
    first, second = lightbox.session.picked, lightbox.second
    assert second is not None and lightbox.inspector.distance_box.isVisibleTo(lightbox.inspector)
    lengths = lightbox.box.distances(first, second)
    for name, view in zip(lightbox.names, lightbox.view.shown.views, strict=True):
        positions = lightbox.session.project.positions(name)
        length = np.linalg.norm(positions[first] - positions[second])
        if np.isfinite(length):
            assert lengths[name] == pytest.approx(length)
            assert (f"{100 * length:.1f}% of size", "plain") in view.captions[0].lines
            assert any(mark.kind == "line" for mark in view.marks)
    assert lightbox.inspector.median.text() == f"{100 * np.median(list(lengths.values())):.1f}%"
    click(qtbot, lightbox, spot(lightbox, 0, points[1]))
    assert lightbox.second is None, "a third click starts anew"
    assert lightbox.actions.run("clear_points") and lightbox.session.picked is None


def test_hovering_lights_up_without_drawing_the_shapes_again(lightbox, qtbot):
    qtbot.waitUntil(lambda: lightbox.view.at_rest, timeout=20000)
    qtbot.wait(100)
    frames, points = lightbox.view.frames, seen_points(lightbox, 1)
    for point in points[:5]:
        qtbot.mouseMove(lightbox.view.plotter, spot(lightbox, 1, point))
        qtbot.wait(80)
    assert lightbox.hovered is not None
    halos = [sum(mark.kind == "halo" for mark in view.marks) for view in lightbox.view.shown.views]
    present = [lightbox.box.shape(name).existence[lightbox.hovered] for name in lightbox.names]
    assert halos == [int(here) for here in present]
    assert lightbox.view.frames == frames


def test_heat_lies_around_the_point_and_only_there(lightbox, qtbot):
    click(qtbot, lightbox, spot(lightbox, 0, seen_points(lightbox, 0)[0]))
    layer = lightbox.view.shown.views[0].layers[0]
    shape, picked = lightbox.box.shape(lightbox.names[0]), lightbox.session.picked
    grey = layer.colours[np.linalg.norm(shape.vertices - shape.positions[picked], axis=1).argmax()].astype(int)
    warm = np.abs(layer.colours.astype(int) - grey).sum(axis=1) > 30
    away = np.linalg.norm(shape.vertices - shape.positions[picked], axis=1)
    assert warm.any() and away[warm].max() < 0.25 and warm.mean() < 0.3


def test_colours_by_part_and_by_coordinate(lightbox):
    lightbox._colour_chosen("part")
    labels = lightbox.session.project.face_labels(lightbox.names[0])
    shape, layer = lightbox.box.shape(lightbox.names[0]), lightbox.view.shown.views[0].layers[0]
    names = lightbox.box.top.part_names
    assert np.array_equal(layer.colours, part_colours(len(names))[labels[shape.face]])
    lightbox._colour_chosen("coordinate")
    layer = lightbox.view.shown.views[0].layers[0]
    assert np.array_equal(layer.colours, lightbox.box.coordinate[shape.nearest])
    lightbox._colour_chosen("spread")


def test_sorting_and_counting(lightbox):
    assert lightbox.actions.run("show_worst")
    values = [view.confidence for view in lightbox.view.shown.views]
    assert values == sorted(values) and lightbox.sorting.value_text() == "least sure first"
    lightbox._count_chosen("4")
    assert len(lightbox.names) == len(lightbox.view.shown.views) == 4
    lightbox._sort_chosen("name")
    assert list(lightbox.names) == sorted(lightbox.names)


def test_turning_pages_shows_every_shape_once_whatever_is_picked(lightbox, qtbot):
    lightbox._count_chosen("4")
    first, order = lightbox.names, lightbox.order
    click(qtbot, lightbox, spot(lightbox, 0, seen_points(lightbox, 0)[0]))
    assert lightbox.session.picked is not None and lightbox.names == first, "a pick moves no shape"
    qtbot.mouseClick(lightbox.after, LEFT)
    assert lightbox.order == order and not set(first) & set(lightbox.names)
    lightbox.actions.run("show_worst")
    sure = [lightbox.box.confidence(name, lightbox.session.picked) for name in lightbox.order]
    assert sure == sorted(sure), "chosen anew, the order is that of the point"


def test_two_shapes_are_overlaid_and_it_says_why_not(lightbox, qtbot):
    table = lightbox.actions
    assert table.verdict("overlay") == (False, "Select exactly two shapes first (Ctrl-click).")
    for cell in (0, 1):
        click(qtbot, lightbox, spot(lightbox, cell, seen_points(lightbox, cell)[0]), CONTROL)
    assert set(lightbox.session.selected) == set(lightbox.names[:2]) and lightbox.session.picked is None
    qtbot.mouseClick(button_of(lightbox, lightbox.inspector, "overlay"), LEFT)
    shown = lightbox.view.shown
    assert len(shown.views) == 1 and [layer.key for layer in shown.views[0].layers] == ["shape", "other", "moves"]
    assert table.run("overlay") and len(lightbox.view.shown.views) == len(lightbox.names)


def test_landmarks_are_kept_with_the_project_and_exported(lightbox, qtbot, tmp_path, open_window, monkeypatch):
    keep = button_of(lightbox, lightbox.inspector, "keep_landmark")
    export = button_of(lightbox, lightbox.strip, "export_points")
    assert not export.isEnabled() and export.toolTip()
    click(qtbot, lightbox, spot(lightbox, 0, seen_points(lightbox, 0)[4]))
    picked, project = lightbox.session.picked, lightbox.session.project
    qtbot.mouseClick(keep, LEFT)
    qtbot.mouseClick(keep, LEFT)
    assert [mark["point"] for mark in lightbox.strip.marks] == [picked], "kept once"
    out = tmp_path / "marks.csv"
    monkeypatch.setattr(lightbox.actions.desk, "choose_save", lambda title, name: out)
    qtbot.mouseClick(export, LEFT)
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["shape"] for row in rows} == set(lightbox.box.present_on(picked))
    row = rows[0]
    frame = project.shapes[list(project.names).index(row["shape"])].frame
    expected = frame.to_input(project.positions(row["shape"])[picked])
    assert np.allclose([float(row[axis]) for axis in "xyz"], expected, rtol=1e-4, atol=1e-4)
    again = open_window(Project.open(project.path), "correspondence").places["correspondence"]
    assert [mark["point"] for mark in again.strip.marks] == [picked]
    (project.path / "landmarks_kept.json").write_text(
        json.dumps({"fit": project.fit_id, "landmarks": [{"point": 10**9, "name": "x"}]})
    )
    assert again.strip.read() == []


def test_a_correction_goes_to_paint_with_the_shape(lightbox, qtbot):
    click(qtbot, lightbox, spot(lightbox, 2, seen_points(lightbox, 2)[0]))
    name = lightbox.names[2]
    assert lightbox.actions.run("correct_here")
    assert lightbox.session.place == "paint" and lightbox.session.shape == name


def test_without_a_window_the_lightbox_makes_the_same_display(fitted):
    session = Session()
    session.open(fitted)
    box = Lightbox(session)
    assert box.reload() and not box.reload()
    names = box.names[:3]
    first = box.display(names, colour_by="part")
    second = box.display(names, colour_by="part", picked=0)
    assert all(a.layers[0] is b.layers[0] for a, b in zip(first.views, second.views, strict=True))


def test_fine_meshes_have_short_edges_the_same_area_and_no_cracks():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    triangles, record = np.array([[0, 1, 2], [0, 2, 3]]), np.array([4, 7])
    fine, split, owner = fine_mesh(vertices, triangles, record, longest=0.2)
    a, b, c = (fine[split[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert area.sum() == pytest.approx(1) and (area > 0).all()
    assert area[owner == 4].sum() == pytest.approx(0.5)
    assert max(np.linalg.norm(b - a, axis=1).max(), np.linalg.norm(c - b, axis=1).max()) <= 0.2
    edges = np.sort(split[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2 and (count == 1).sum() >= 4 * 5
    assert len(np.unique(np.round(fine, 9), axis=0)) == len(fine)
    assert fine_mesh(vertices, triangles, record, longest=0.001, most=100)[1].shape[0] <= 100


def test_confidence_falls_with_spread_and_gap():
    spread = np.array([0.005, 0.02, 0.05, 0.2])
    sure = confidence_of(spread, np.zeros(4))
    assert (np.diff(sure) < 0).all() and sure[0] > 0.99 and sure[-1] < 0.05
    rng = np.random.default_rng(0)
    hits = np.linalg.norm(rng.normal(0, 0.03, (200_000, 3)), axis=1) < CLOSE
    assert confidence_of(np.array([0.03]), np.zeros(1))[0] == pytest.approx(hits.mean(), abs=0.005)
    assert confidence_of(np.array([0.01]), np.array([0.1]))[0] < 0.1


def test_points_are_described_by_part_and_place():
    grid = np.stack(np.meshgrid([-1.0, 0, 1], [0.0, 1, 2], [-0.5, 0, 0.5], indexing="ij"), axis=-1).reshape(-1, 3)
    part = np.zeros(27, int)
    at = {tuple(p): i for i, p in enumerate(grid)}
    assert describe_point(grid, part, ["back"], at[(1.0, 2.0, 0.0)]) == "Back, top right"
    assert describe_point(grid, part, ["back"], at[(0.0, 1.0, 0.0)]) == "Back, middle"
    assert describe_point(grid, part, ["back"], at[(-1.0, 0.0, 0.0)]) == "Back, bottom left"


def test_a_click_just_beside_a_thin_piece_still_means_it(lightbox, qtbot):
    view = lightbox.view
    left, top, width, height = view.rectangles()[0]
    middle = range(round(left) + 20, round(left + width) - 20)
    for y in range(round(top + 0.3 * height), round(top + 0.9 * height), 3):
        hits = [view.pick(x, y) is not None for x in middle]
        edges = [i for i in range(8, len(hits) - 8) if hits[i] and not any(hits[i - 8 : i])]
        if edges:
            break
    beside = QPoint(middle[edges[0]] - 5, y)
    assert view.pick(beside.x(), beside.y()) is None
    click(qtbot, lightbox, beside)
    assert lightbox.session.picked is not None and lightbox.session.shape == lightbox.names[0]
    assert view.pick_near(left + 3, top + 3) is None, "the ground is no shape"


# -- turned shapes ---------------------------------------------------------------------------------------------------

QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""A quarter turn about the vertical."""


def test_a_shape_explained_after_a_turn_is_shown_as_the_family_lies(fitted, open_window, qtbot):
    name = fitted.names[-1]
    position = fitted.positions(name)
    turn_shape(fitted, name, QUARTER)
    fitted = Project.open(fitted.path)
    box = open_window(fitted, "correspondence").places["correspondence"].box
    assert not np.allclose(fitted.positions(name), position, equal_nan=True), "in its file it lies otherwise"
    np.testing.assert_allclose(box.known(name).positions, position, atol=1e-6)
    np.testing.assert_allclose(np.asarray(box.known(name).turn), QUARTER)
    shape = box.shape(name)
    apart = np.linalg.norm(shape.vertices[:, None] - position[fitted.existence(name)][None, :40], axis=2)
    assert apart.min(axis=0).max() < 0.06, "the mesh lies as its points do"
    other = fitted.names[0]
    away = box.distance_to(name, other)
    back = box.distance_to(other, name)
    assert away.max() < 0.6 and back.max() < 0.6


def test_landmarks_of_a_turned_shape_are_exported_as_it_lies_in_its_file(fitted, open_window, tmp_path):
    name = fitted.names[-1]
    turn_shape(fitted, name, QUARTER)
    fitted = Project.open(fitted.path)
    place = open_window(fitted, "correspondence").places["correspondence"]
    point = int(np.flatnonzero(fitted.existence(name))[0])
    place.strip.keep(point)
    place.strip.export(tmp_path / "marks.csv")
    with (tmp_path / "marks.csv").open(newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["shape"] == name)
    expected = fitted.shapes.named(name).frame.to_input(fitted.positions(name)[point])
    assert np.allclose([float(row[axis]) for axis in "xyz"], expected, rtol=1e-4, atol=1e-4)


# -- fuzzy -----------------------------------------------------------------------------------------------------------


def test_the_fuzzy_correspondence_is_the_fits_own(fitted):
    name, state = fitted.names[1], fitted.fit()
    beliefs, shape = fitted.beliefs(name), fitted.shapes.named(fitted.names[1])
    fuzzy = fuzzy_correspondence(shape, beliefs, state.templates, state.covariances, shape.points)
    q = fuzzy.q[beliefs.template]
    sums = np.asarray(q.sum(axis=1)).ravel()
    np.testing.assert_allclose(sums[sums > 0], 1, atol=1e-5)
    dense = q.toarray()
    literal = np.array([-sum(p * np.log2(p) for p in row if p > 0) for row in dense])
    np.testing.assert_allclose(fuzzy.bits, literal, atol=1e-6)
    hierarchy = fitted.hierarchy()
    point = int(np.flatnonzero(fitted.existence(name))[3])
    share = where_it_may_lie(fuzzy, hierarchy, state.templates, point)
    assert share.min() >= 0 and share.max() <= 1 + 1e-6
    nearest = np.linalg.norm(shape.points - fitted.positions(name)[point], axis=1)
    assert nearest[share.argmax()] < 0.1 < nearest[share < 0.01].max()


@pytest.mark.parametrize("number", [400, 5000])
def test_places_that_may_be_a_hundredth_of_the_template_are_the_hottest_however_dense_it_is(number):
    alike = np.tile(np.arange(number) < number // 100, (2, 1)) / (number // 100)
    nowhere = np.zeros((0, 3))
    bits = -(alike * np.log2(np.maximum(alike, 1e-300))).sum(axis=1)
    fuzzy = Fuzzy({0: csr_matrix(alike)}, {}, 0, bits, nowhere.astype(int), nowhere)
    np.testing.assert_allclose(fuzzy.unsure, 1.0)


def test_entropy_of_parts_is_one_bit_for_a_coin_toss():
    np.testing.assert_allclose(
        part_bits(np.array([[0.5, 0.5, 0], [1, 0, 0], [0.25, 0.25, 0.5]])), [1, 0, 1.5], atol=1e-9
    )


def test_colours_by_uncertainty_are_the_entropy_and_say_so(lightbox, qtbot):
    lightbox._colour_chosen("entropy")
    name, layer = lightbox.names[0], lightbox.view.shown.views[0].layers[0]
    fuzzy = lightbox.box.fuzzy(name)
    assert np.array_equal(layer.colours, heat(fuzzy.at_vertices(fuzzy.unsure)))
    assert lightbox.inspector.legend[1].text() == "entropy"
    lightbox._colour_chosen("part_entropy")
    shape, layer = lightbox.box.shape(name), lightbox.view.shown.views[0].layers[0]
    bits = part_bits(lightbox.session.project.face_probabilities(name))
    assert np.array_equal(layer.colours, heat(bits)[shape.face])
    qtbot.waitUntil(lambda: lightbox.view.at_rest, timeout=20000)
    warm = lightbox.view.picture().astype(int)
    assert (warm[..., 0] - warm[..., 2] > 60).mean() > 1e-4, "what is unsure is warm on the screen"


# -- by keyboard -----------------------------------------------------------------------------------------------------


def press(qtbot, place, key, modifiers=NONE) -> None:
    qtbot.keyClick(place.centre, key, modifiers)


def test_everything_by_keyboard(lightbox, qtbot):
    session, shift = lightbox.session, Qt.KeyboardModifier.ShiftModifier
    session.shape = None
    press(qtbot, lightbox, Qt.Key.Key_Right)
    assert session.shape == lightbox.names[0]
    press(qtbot, lightbox, Qt.Key.Key_Right)
    assert session.shape == lightbox.names[1] and lightbox.view.shown.views[1].selected
    press(qtbot, lightbox, Qt.Key.Key_Right, shift)
    first = session.picked
    assert first is not None
    press(qtbot, lightbox, Qt.Key.Key_M)
    assert lightbox.second == first
    for _ in range(3):
        press(qtbot, lightbox, Qt.Key.Key_Down, shift)
    assert session.picked == first and lightbox.second != first
    at = [lightbox.view.place_of(lightbox.box.known(session.shape).positions[k], 1) for k in (first, lightbox.second)]
    assert at[1][1] > at[0][1] + 2, "it went down"
    press(qtbot, lightbox, Qt.Key.Key_S)
    press(qtbot, lightbox, Qt.Key.Key_Left)
    press(qtbot, lightbox, Qt.Key.Key_S)
    assert session.selected == (lightbox.names[1], lightbox.names[0])
    press(qtbot, lightbox, Qt.Key.Key_Escape)
    assert session.picked is None and lightbox.second is None


def test_pages_and_the_search_reach_every_shape(lightbox, qtbot):
    lightbox._count_chosen("4")
    first = lightbox.names
    assert lightbox.actions.verdict("previous_page")[0] is False
    press(qtbot, lightbox, Qt.Key.Key_PageDown)
    assert len(lightbox.names) == 4 and not set(lightbox.names) & set(first)
    assert [view.name for view in lightbox.view.shown.views] == list(lightbox.names)
    assert lightbox.actions.verdict("next_page")[0] is False
    lightbox.session.shape = first[2]  # as the search does
    assert lightbox.names == first and lightbox.view.shown.views[2].selected
    qtbot.mouseClick(lightbox.after, LEFT)
    assert lightbox.page == 1


# -- overlay ---------------------------------------------------------------------------------------------------------


def test_the_overlay_is_coloured_by_distance(lightbox, qtbot):
    a, b = lightbox.names[:2]
    lightbox.session.selected = (a, b)
    press(qtbot, lightbox, Qt.Key.Key_O)
    layer = lightbox.view.shown.views[0].layers[0]
    away = lightbox.box.distance_to(a, b)
    assert np.array_equal(layer.colours, heat(away / FARTHEST))
    vertices, other = lightbox.box.shape(a).vertices, lightbox.box.shape(b)
    to_vertices = np.linalg.norm(vertices[::50, None] - other.vertices[None], axis=2).min(axis=1)
    assert (away[::50] <= to_vertices + 1e-9).all() and away.max() > 0.005
    assert "at most" in lightbox.view.shown.views[0].captions[0].lines[1][0]
    assert lightbox.inspector.legend_title.text() == "Distance of the surfaces"
    press(qtbot, lightbox, Qt.Key.Key_O, Qt.KeyboardModifier.ShiftModifier)
    assert lightbox.session.selected == (b, a) and lightbox.view.shown.views[0].name == b
    qtbot.waitUntil(lambda: lightbox.view.at_rest, timeout=20000)
    picture = lightbox.view.picture().astype(int)
    assert (picture[..., 0] - picture[..., 2] > 60).mean() > 1e-4, "what is far is warm on the screen"


# -- landmarks -------------------------------------------------------------------------------------------------------


def test_landmarks_are_undone_redone_renamed_and_all_of_them_shown(lightbox, qtbot):
    session, strip = lightbox.session, lightbox.strip
    points = lightbox.box.known(lightbox.names[0]).existence.nonzero()[0][:9].tolist()
    for point in points:
        session.picked = int(point)
        press(qtbot, lightbox, Qt.Key.Key_K)
    assert len(strip.marks) == len(strip.shown) == 9
    card = strip.shown[0]
    qtbot.mouseDClick(card, LEFT)
    card.name.editor.setText("top")
    qtbot.keyClick(card.name.editor, Qt.Key.Key_Return)
    assert strip.marks[0]["name"] == "top" == strip.read()[0]["name"]
    qtbot.keyClick(strip.shown[-1], Qt.Key.Key_Delete)
    assert len(strip.marks) == 8
    session.undo()
    assert len(strip.read()) == 9
    session.undo()
    assert strip.read()[0]["name"] != "top"
    session.redo()
    assert strip.read()[0]["name"] == "top" == strip.shown[0].name.text()
    strip.rename(strip.marks[1], "top")
    assert session.status_kind == "warning" and strip.marks[1]["name"] != "top"


def test_landmarks_are_found_again_on_another_fit(lightbox, qtbot):
    click(qtbot, lightbox, spot(lightbox, 0, seen_points(lightbox, 0)[4]))
    assert lightbox.actions.run("keep_landmark")
    mark = lightbox.strip.marks[0]
    path = lightbox.session.project.path / "landmarks_kept.json"
    kept = json.loads(path.read_text())
    kept["fit"] = "another"
    kept["landmarks"][0]["point"] = 0
    path.write_text(json.dumps(kept))
    assert [one["point"] for one in lightbox.strip.read()] == [mark["point"]], "by its place on the shape"


def test_results_that_became_stale_say_so(lightbox, qtbot, fitted):
    note = next(one for one in lightbox.inspector.findChildren(QFrame) if one.objectName() == "stale")
    assert not note.isVisible()
    project = lightbox.session.project
    name = project.labelled[0]
    labels = project.labels(name).copy()
    labels[:5] = -1
    project.set_labels(name, labels)
    lightbox.session.touch("labels")
    assert note.isVisible()
    words = " ".join(one.text() for one in note.findChildren(QLabel))
    assert "labels" in words and "old fit" in words
    link = next(one for one in note.findChildren(QPushButton))
    qtbot.mouseClick(link, LEFT)
    assert lightbox.session.place == "fit"


def test_a_large_family_is_read_little_by_little(fitted, open_window, qtbot, monkeypatch):
    monkeypatch.setattr("shapeforge.viewer.qt.correspondence_panel.AT_ONCE", 2)
    monkeypatch.setattr("shapeforge.viewer.qt.correspondence_panel.SLICE", 0.0)
    window = open_window(fitted)
    place = window.place("correspondence")
    monkeypatch.setattr(place._idle, "start", lambda *_: None)
    place.count = 4
    window.session.place = "correspondence"
    assert place.box.in_slices and list(place.names) == sorted(place.names), "there at once, by name"
    unread = len(place.box.unread)
    assert 0 < unread and f"of {len(fitted.names)}" in place.hint.full_text()
    point = int(place.box.known(place.names[0]).existence.argmax())
    assert len(place.box.present_on(point)) <= len(fitted.names) - len(place.box.unread)
    while place.box.unread:
        place._work_ahead()
    assert place.hint.full_text() == "Click one point, or two"
    values = [view.confidence for view in place.view.shown.views]
    assert values == sorted(values, reverse=True), "then in order"
    assert not place.box.is_ready(place.names[0])
    for _ in place.names:
        place._work_ahead()
    assert all(place.box.is_ready(name) for name in place.names), "the first click finds all computed"


@pytest.mark.parametrize(("value", "words"), [(0.497, "49%"), (0.5, "50%"), (1.0, "100%"), (0.0, "0%")])
def test_what_counts_as_below_half_is_not_rounded_up_to_it(value, words):
    assert whole_percent(value) == words
