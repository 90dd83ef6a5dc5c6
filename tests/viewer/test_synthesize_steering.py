"""Everything that steers a new shape, reached in the real window with mouse and keys: sliders, draws, routes, files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QEnterEvent
from PySide6.QtWidgets import QApplication

from shapeforge.generative.inference import logit
from shapeforge.stages import StageError
from shapeforge.stages_recipes import read_recipe, remake
from shapeforge.synthesis import surface as from_scratch
from shapeforge.viewer.display import MeshLayer, PointLayer
from shapeforge.viewer.sculptor import Recipe
from shapeforge.viewer.sculptor_files import recipe_from
from tests.viewer.synthesize_hands import LEFT, LONG, NONE, layer_kinds, wait_for_mesh


def drag(qtbot, slider, value: float, *, let_go: bool = True) -> None:
    """Drag a slider's handle to a value."""
    y, start, end = slider.height() - 10, round(slider.x_of(slider.value)), round(slider.x_of(value))
    qtbot.mousePress(slider, LEFT, NONE, QPoint(start, y))
    for i in range(1, 4):
        qtbot.mouseMove(slider, QPoint(start + (end - start) * i // 3, y))
    if let_go:
        qtbot.mouseRelease(slider, LEFT, NONE, QPoint(end, y))


def first_of(sculptor, kind: str) -> int:
    """The first slider of a kind."""
    return next(i for i, direction in enumerate(sculptor.directions) if direction.kind == kind)


def switchable(place) -> int:
    """A part that can be switched."""
    always = place.sculptor.always()
    return next(part for part in place.inspector.switches if not always[part])


# ---- where shapes stand on the sliders -----------------------------------------------------------------------------


def test_the_bars_of_every_slider_are_the_places_of_the_family_s_shapes(sculptor):
    """Directions, bundles and single units: put each shape on each slider and count."""
    homes = np.array([sculptor.home(sculptor.base_of(name)) for name in sculptor.shape_names])
    assert {direction.kind for direction in sculptor.directions} == {"direction", "bundle", "unit"}
    for index, direction in enumerate(sculptor.directions):
        values = homes[:, index] * sculptor.unit(index)
        if direction.kind == "unit":
            part = next(l for l, s in enumerate(sculptor.machine.units_of_part) if s.start <= direction.unit < s.stop)
            values = values[sculptor.observations.exists[:, part]]
        edges = direction.edges + 1e-5 * np.ptp(direction.edges) * np.linspace(-1, 1, len(direction.edges))
        assert np.array_equal(np.histogram(values, edges)[0], direction.histogram), direction.name


def test_a_single_unit_moves_its_own_part_only(sculptor):
    index = first_of(sculptor, "unit")
    unit = sculptor.directions[index].unit
    own = next(l for l, slot in enumerate(sculptor.machine.units_of_part) if slot.start <= unit < slot.stop)
    sculptor.session.parts_on = {own: True}
    before = sculptor.points()
    sculptor.session.sliders = {index: 1.5}
    moved = np.linalg.norm(np.nan_to_num(sculptor.points() - before), axis=1)
    assert moved[sculptor.part == own].max() > 1e-4 and moved[sculptor.part != own].max() < 1e-9


def test_a_slider_shows_where_the_shape_stands_and_resets_to_there(place, qtbot):
    place.take_up(Recipe("one", place.sculptor.base_of(place.sculptor.shape_names[2]), origin="one"))
    slider, home = place.inspector.rows[0].slider, float(place.sculptor.home()[0])
    assert slider.value == pytest.approx(np.clip(home, slider.low, slider.high), abs=1e-6)
    drag(qtbot, slider, slider.inner[0])
    drag(qtbot, place.inspector.rows[1].slider, place.inspector.rows[1].slider.inner[1])
    values = place.sculptor.values()
    assert set(place.session.sliders) == {0, 1}, "several at once"
    assert values[0] == pytest.approx(slider.inner[0], abs=0.1)
    assert place.inspector.rows[0].value.text() == f"{values[0]:+.1f}".replace("-", "−")
    qtbot.mouseDClick(slider, LEFT, NONE, QPoint(round(slider.x_of(slider.value)), slider.height() - 10))
    assert place.session.sliders[0] == 0.0 and place.session.sliders[1] != 0.0
    assert slider.value == pytest.approx(np.clip(home, slider.low, slider.high), abs=1e-6)


def test_bundles_and_single_units_are_a_click_away(place, qtbot):
    inspector, sculptor = place.inspector, place.sculptor
    index = first_of(sculptor, "unit")
    assert not inspector.rows[index].isVisible()
    qtbot.mouseClick(inspector.finer, LEFT)
    assert inspector.rows[index].isVisible() and inspector.rows[first_of(sculptor, "bundle")].isVisible()
    before, slider = place.points.copy(), inspector.rows[index].slider
    drag(qtbot, slider, slider.inner[1] if slider.value < np.mean(slider.inner) else slider.inner[0])
    assert np.nanmax(np.abs(place.points - before)) > 1e-4 and list(place.session.sliders) == [index]


def test_pointing_at_a_row_shows_heat(place, qtbot):
    wait_for_mesh(place, qtbot)
    plain = place.view.shown.views[0].layers[0].colours
    enter = QEnterEvent(QPointF(5, 5), QPointF(5, 5), QPointF(5, 5))
    QApplication.sendEvent(place.inspector.rows[0], enter)
    hot = place.view.shown.views[0].layers[0].colours
    assert not np.array_equal(hot, plain)
    drag(qtbot, place.inspector.rows[0].slider, place.inspector.rows[0].slider.inner[1], let_go=False)
    assert np.array_equal(np.unique(place.view.shown.views[0].layers[-1].colours, axis=0),
                          np.unique(plain, axis=0)), "the parts' own colours while it moves"  # fmt: skip
    qtbot.mouseRelease(place.inspector.rows[0].slider, LEFT)
    QApplication.sendEvent(place.inspector.rows[0], QEvent(QEvent.Type.Leave))
    assert place.shows.heated is None


def test_a_mesh_follows_while_a_slider_is_held_and_the_final_one_comes_when_it_is_let_go(place, qtbot):
    wait_for_mesh(place, qtbot)
    row = place.inspector.rows[0]
    drag(qtbot, row.slider, row.slider.inner[1], let_go=False)
    qtbot.waitUntil(lambda: layer_kinds(place) == [MeshLayer, PointLayer], timeout=LONG)
    assert place.made is None and not place.actions.verdict("export_mesh")[0]
    there = np.isfinite(place.points).all(axis=1)
    assert np.array_equal(place.view.shown.views[0].layers[1].positions, place.points[there]), "the newest points"
    qtbot.mouseRelease(row.slider, LEFT)
    assert layer_kinds(place)[0] is MeshLayer, "no flicker on release"
    wait_for_mesh(place, qtbot)
    assert layer_kinds(place) == [MeshLayer] and len(place.sculptor.recipes) == 2


def test_handles_sit_on_the_mesh(place, qtbot):
    wait_for_mesh(place, qtbot)
    vertices = np.asarray(place.made.shape.vertices)
    away = [np.linalg.norm(vertices - at, axis=1).min() for at in place.handles.places]
    assert len(away) == len(place.handles.shown) > 3 and max(away) < 1e-9


def test_undo_shows_a_mesh_that_was_made_before_at_once(place, qtbot):
    wait_for_mesh(place, qtbot)
    mesh = place.made.shape
    drag(qtbot, place.inspector.rows[0].slider, place.inspector.rows[0].slider.inner[1])
    wait_for_mesh(place, qtbot)
    assert place.made.shape is not mesh
    qtbot.mouseClick(place.strip.cards[0], LEFT, NONE, QPoint(10, 10))
    assert place.sculptor.done == 0 and place.made is not None and place.made.shape is mesh


# ---- random draws --------------------------------------------------------------------------------------------------


def test_draws_keep_what_is_locked(place, qtbot):
    sculptor = place.sculptor
    qtbot.mouseClick(place.inspector.finer, LEFT)
    chosen = [first_of(sculptor, kind) for kind in ("direction", "bundle", "unit")]
    for index in chosen:
        slider = place.inspector.rows[index].slider
        drag(qtbot, slider, slider.inner[1])
        qtbot.keyClick(slider, Qt.Key.Key_L)
        assert place.inspector.rows[index].lock.isChecked()
    assert place.inspector.draws.kept.text() == "They keep: 3 locked sliders."
    kept = sculptor.values()[chosen]
    seen = []
    for _ in range(3):
        assert place.actions.run("random_shape")
        np.testing.assert_allclose(sculptor.values()[chosen], kept, atol=1e-3)
        seen.append(sculptor.recipe.base.top.copy())
    assert not np.array_equal(seen[0], seen[1])
    unit = sculptor.directions[chosen[2]].unit
    held = sculptor.latents_in_hand().first[0, unit]
    base = sculptor.recipe.base.first[0, unit]
    others = [sculptor.base_of(name).first[0, unit] for name in sculptor.shape_names]
    assert abs(base - held) < 0.25 * np.ptp(others), "the unit is held in the draw, not only set right afterwards"


def test_draws_have_the_parts_that_are_switched(place, qtbot):
    part = switchable(place)
    qtbot.mouseClick(place.inspector.switches[part], LEFT)
    wanted = bool(place.sculptor.exists()[part])
    for _ in range(4):
        place.actions.run("random_shape")
        assert bool(place.sculptor.exists()[part]) == wanted
    name = f"{place.sculptor.part_names[part]} {'on' if wanted else 'off'}"
    assert name in place.inspector.draws.kept.text()
    qtbot.mouseClick(place.inspector.switches[part], LEFT)
    seen = set()
    for _ in range(4):
        place.actions.run("random_shape")
        seen.add(bool(place.sculptor.exists()[part]))
    assert seen == {not wanted}
    assert place.actions.run("reset_parts") and place.session.parts_on == {}
    assert place.actions.verdict("reset_parts") == (False, "No part has been switched.")


def test_draws_near_the_shape_in_hand_are_nearer_and_less_variety_means_less(place, qtbot):
    sculptor, draws = place.sculptor, place.inspector.draws

    def drawn() -> tuple[float, float]:
        """How far draws are from the shape in hand, and how much they differ among themselves, in log odds."""
        found = np.stack([logit(place.sculptor.drawn().base.first) for _ in range(8)])
        return float(np.abs(found - logit(sculptor.latents_in_hand().first)).mean()), float(found.std(axis=0).mean())

    usual, _ = drawn()
    qtbot.mouseClick(draws.near, LEFT)
    assert place.session.near
    near, varied = drawn()
    qtbot.mouseClick(draws.temperature.button("0.6"), LEFT)
    assert place.session.temperature == 0.6
    assert near < usual and drawn()[1] < 0.95 * varied


# ---- how the mesh is made ------------------------------------------------------------------------------------------


def test_a_new_surface_is_chosen_exported_and_taken_up_again(place, qtbot, tmp_path, monkeypatch, sources):
    monkeypatch.setattr(from_scratch, "LATTICE", 60_000)
    monkeypatch.setattr(from_scratch, "COARSEST", 0.03)
    inspector = place.inspector
    qtbot.mouseClick(inspector.mesh.route.button("surface"), LEFT)
    assert place.sculptor.recipe.route == "surface" and place.sculptor.recipe.label == "new surface"
    wait_for_mesh(place, qtbot)
    assert not any(place.made.shape.sources) and place.made.shape.measures["open_edges"] == 0
    corners = {caption.corner: caption.lines for caption in place.view.shown.views[0].captions}
    assert corners["top left"][1][0].endswith("watertight") and "new surface" in corners["top right"][0][0]
    assert "gaps" not in corners["bottom right"][0][0], "it has no parts that could be apart"
    assert not inspector.take_from.isEnabled() and "no shape's parts" in inspector.take_from.toolTip()
    assert not inspector.mesh.union.isEnabled() and "always" in inspector.mesh.union.toolTip()
    assert not inspector.mesh.colours.button("sources").isEnabled()
    monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name: tmp_path / "new.ply")
    assert place.actions.run("export_mesh")
    recipe = json.loads((tmp_path / "new.ply.recipe.json").read_text("utf-8"))
    assert (recipe["route"], recipe["union"], recipe["colours"]) == ("surface", False, "parts")
    again = remake(place.session.project, read_recipe(tmp_path / "new.ply.recipe.json"), sources)
    np.testing.assert_array_equal(again.vertices, place.made.shape.vertices)
    points = place.points.copy()
    place.actions.run("undo")
    assert place.sculptor.recipe.route == "parts" and inspector.take_from.isEnabled()
    place.actions.run("mean_shape")
    monkeypatch.setattr(place.actions.desk, "choose_files", lambda title, endings: (tmp_path / "new.ply.recipe.json",))
    assert place.actions.run("open_recipe")
    np.testing.assert_allclose(place.points, points, atol=1e-6)
    assert place.sculptor.recipe.route == "surface" and place.sculptor.recipe.label == "new surface"


def test_a_recipe_of_parts_brings_the_parts_sources_along(place, qtbot, tmp_path, monkeypatch):
    drag(qtbot, place.inspector.rows[0].slider, place.inspector.rows[0].slider.inner[1])
    wait_for_mesh(place, qtbot)
    monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, name: tmp_path / "chair.obj")
    assert place.actions.run("export_mesh")
    path = tmp_path / "chair.obj.recipe.json"
    found = recipe_from(path, place.sculptor)
    used = [place.sculptor.shape_names.index(name) for name in found.taken.values()]
    assert len(used) == sum(bool(name) for name in place.made.shape.sources)
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {"machine": "another"}), "utf-8")
    with pytest.raises(StageError, match="another"):
        recipe_from(path, place.sculptor)


def test_one_solid_is_asked_for_and_what_cannot_be_united_is_said(place, qtbot):
    mesh = place.inspector.mesh
    qtbot.mouseClick(mesh.union, LEFT)
    assert place.sculptor.recipe.union and place.sculptor.recipe.label == "one solid"
    wait_for_mesh(place, qtbot)
    measures = place.made.shape.measures
    words = dict(place.view.shown.views[0].captions[0].lines)
    if "not_united" in measures:
        assert mesh.note.isVisible() and "warning" in words.values()
    else:
        assert measures["open_edges"] == 0 and any("watertight" in text for text in words) and not mesh.note.isVisible()
    broken = {**measures, "not_united": "union: the part seat is not a closed solid (from sofa); try another"}
    place.made = replace(place.made, shape=replace(place.made.shape, measures=broken))
    place._show()
    assert mesh.note.text() == "The part seat is not a closed solid (from sofa); try another." and mesh.note.isVisible()
    lines = place.view.shown.views[0].captions[0].lines
    assert lines[2] == ("not one solid: the part seat is not a closed solid (from sofa)", "warning")


def test_colours_of_materials_are_offered_where_there_are_any(place, qtbot):
    wait_for_mesh(place, qtbot)
    materials = place.inspector.mesh.colours.button("sources")
    assert place.made.shape.colours is None and not materials.isEnabled() and "materials" in materials.toolTip()
    own = np.random.default_rng(0).integers(0, 255, (len(place.made.shape.triangles), 3)).astype(np.uint8)
    place.made = replace(place.made, shape=replace(place.made.shape, colours=own))
    place._show()
    assert materials.isEnabled()
    qtbot.mouseClick(materials, LEFT)
    assert place.session.mesh_colours == "sources"
    assert np.array_equal(place.view.shown.views[0].layers[0].colours, own)
    qtbot.mouseClick(place.inspector.mesh.colours.button("parts"), LEFT)
    assert not np.array_equal(place.view.shown.views[0].layers[0].colours, own)


def test_a_picture_of_the_shape_is_taken_from_where_one_looks(place, qtbot, tmp_path, monkeypatch):
    wait_for_mesh(place, qtbot)
    monkeypatch.setattr("shapeforge.viewer.qt.synthesize_actions.PICTURE_HEIGHT", 120)
    pictures = []
    for azimuth, name in ((10, "front.png"), (120, "side.jpg")):
        place.view.turn_to(azimuth, 20)
        monkeypatch.setattr(place.actions.desk, "choose_save", lambda title, _name, name=name: tmp_path / name)
        assert place.actions.run("export_picture")
        with Image.open(tmp_path / name) as image:
            pictures.append(np.asarray(image.convert("RGB")).astype(int))
    _, _, width, height = place.view.rectangles()[0]
    assert pictures[0].shape == (120, round(120 * width / height), 3)
    assert all(picture.std() > 5 for picture in pictures) and np.abs(pictures[0] - pictures[1]).max() > 60
