"""Draws whose parts do not go together give way to others in the window, too: no more of them than elsewhere."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from shapeforge import stages_synthesis
from shapeforge.generative.inference import Latents
from shapeforge.stages_synthesis import APART, UNLIKE, made_whole
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.viewer.mesh_worker import Made, MeshWorker, Wish
from shapeforge.viewer.qt import synthesize_shows
from shapeforge.viewer.recipe import Recipe
from shapeforge.viewer.redrawing import Redrawing, is_whole
from shapeforge.viewer.sculpture import apart_words, measure_words
from tests.viewer.synthesize_hands import LONG, wait_for_mesh

BASE = Latents((np.zeros((1, 2)), np.zeros((1, 2))), np.ones((1, 2), bool))


def shape_with(gap: float) -> SynthesizedShape:
    measures = {"largest_gap": gap, "distance_from_draw": 0.01}
    return SynthesizedShape(
        np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32), (), (), measures
    )  # fmt: skip


def mesh(gap: float, *, preview: bool = False) -> Made:
    return Made(1, shape_with(gap), preview, "chair", 0.1)


@pytest.mark.parametrize(
    "gaps", [(0.001,), (0.1, 0.2, 0.002), (0.1, 0.2, 0.05, 0.3), (0.1, 0.01, 0.02, 0.03), (0.1, 0.0)]
)
def test_the_window_keeps_the_draw_that_the_command_line_keeps(gaps):
    recipes = [Recipe(f"{gap}", BASE) for gap in gaps]
    trial = Redrawing(1, recipes[0])
    while trial.take(mesh(gaps[trial.turn])):
        trial.tried.append(recipes[trial.turn])
    recipe, made = trial.result()
    shape, kept = made_whole(lambda turn: shape_with(gaps[turn]), 0, lambda turn: turn)
    assert recipe is recipes[kept] and made.shape.measures == shape.measures and len(trial.tried) == len(gaps)


def test_what_stays_apart_is_said():
    assert is_whole(mesh(APART)) and not is_whole(mesh(1.01 * APART))
    assert apart_words({"largest_gap": APART, "distance_from_draw": UNLIKE}) == ""
    assert apart_words({"largest_gap": 0.012, "distance_from_draw": 0.0}) == "parts stay 1.2% of size apart"
    assert apart_words({"largest_gap": 0.0, "distance_from_draw": 0.15}).startswith("no parts go there: 15%")
    assert apart_words({"distance_from_draw": 0.15}) == "", "a new surface is in one piece"
    assert measure_words({"redrawn": 1}) == "1 other draw put aside"


def captions(place) -> str:
    return " ".join(text for caption in place.view.shown.views[0].captions for text, _ in caption.lines)


def test_random_tries_other_draws_and_keeps_the_best_in_one_item_of_the_history(place, qtbot, monkeypatch):
    wait_for_mesh(place, qtbot)
    faults, said = [4.0, 2.0, 5.0], []
    monkeypatch.setattr(stages_synthesis, "REDRAWS", 2)
    monkeypatch.setattr(stages_synthesis, "fault_of", lambda shape: (said.append(captions(place)), faults.pop(0))[1])
    assert place.actions.run("random_shape")
    wait_for_mesh(place, qtbot)
    qtbot.waitUntil(lambda: not faults and place.made is not None, timeout=LONG)
    sculptor, best = place.sculptor, place.sculptor.random_base(1, 1)
    assert [recipe.label for recipe in sculptor.recipes] == ["mean", "random"] and sculptor.draws == 1
    assert np.array_equal(sculptor.recipe.base.first, best.first)
    assert np.array_equal(np.nan_to_num(place.points), np.nan_to_num(sculptor.points()))
    assert place.made.shape.measures["redrawn"] == 2 and "2 other draws put aside" in captions(place)
    assert "another draw (3)…" in said[2] and "another draw" not in said[0] + captions(place)
    place.actions.run("undo")
    assert sculptor.recipe.label == "mean"


def test_a_draw_that_was_changed_meanwhile_is_left_alone(place, qtbot, monkeypatch):
    monkeypatch.setattr(stages_synthesis, "fault_of", lambda shape: 9.0)
    place.actions.run("random_shape")
    place.session.sliders = {0: 1.0}
    place._remember("pulled")
    wait_for_mesh(place, qtbot)
    assert place.sculptor.recipe.label == "pulled" and "redrawn" not in place.made.shape.measures


def test_the_gallery_tries_other_draws_too(place, qtbot, monkeypatch):
    wait_for_mesh(place, qtbot)
    ever_better, make = count(1000, -1), MeshWorker._made

    def made_by(worker: MeshWorker, wish: Wish, shapes: np.ndarray | None) -> Made:
        made = make(worker, wish, shapes)
        return replace(made, shape=replace(made.shape, measures={**made.shape.measures, "card": wish.number}))

    def fault_of(shape: SynthesizedShape) -> float:
        return float(next(ever_better)) if shape.measures["card"] < 2 else 0.5

    monkeypatch.setattr(MeshWorker, "_made", made_by)
    monkeypatch.setattr(stages_synthesis, "fault_of", fault_of)
    monkeypatch.setattr(stages_synthesis, "REDRAWS", 1)
    monkeypatch.setattr(synthesize_shows, "CARDS", 6)
    place.actions.run("gallery")
    gallery = place.shows.gallery
    first = list(gallery.recipes)
    qtbot.waitUntil(lambda: len(gallery.made) == 6, timeout=LONG)
    assert gallery.recipes[2:] == first[2:] and all(
        "redrawn" not in gallery.made[i].shape.measures for i in range(2, 6)
    )
    for card in range(2):
        recipe, made = gallery.recipes[card], gallery.made[card]
        assert recipe is not first[card] and recipe.origin == f"draw {card + 1}"
        assert np.array_equal(recipe.base.first, place.sculptor.random_base(card + 1, 1).first)
        assert made.shape.measures["redrawn"] == 1 and not made.preview, "judged as it would be taken"
    place.shows.show_gallery(False)
