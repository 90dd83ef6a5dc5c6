"""The notebook's views: they follow the session, watch without disturbing, and the whole story can be told."""

from __future__ import annotations

import base64
import io
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from shapeforge.collection.iterate import last
from shapeforge.stages import run
from shapeforge.viewer.notebook import FamilyView, FitView, SliderView, encoded, legend, open_session, styled
from shapeforge.viewer.notebook_desk import NotebookDesk
from shapeforge.viewer.pictures import close_studio
from tests.viewer.learned_family import learned_family

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"


@pytest.fixture(scope="module", autouse=True)
def studio():
    yield
    close_studio()


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    return learned_family(tmp_path_factory, "chairs")


@pytest.fixture
def session(learned):
    return open_session(learned)


def pixels(image):
    """The picture of an ``ipywidgets.Image``, or of PNG bytes."""
    return np.asarray(Image.open(io.BytesIO(getattr(image, "value", image))).convert("RGB")).astype(int)


def test_family_view_follows_the_session_and_leads_it(session):
    view = FamilyView(session, size=64)
    before = view.image.value
    session.colour_by = "part"
    by_part = view.image.value
    assert by_part != before and view.colour.value == "part"
    assert np.ptp(pixels(view.image), axis=2).max() > 100, "parts are in colour"
    view.colour.value = "correspondence"
    assert session.colour_by == "correspondence" and view.image.value not in (before, by_part)
    name = session.project.names[1]
    view.select.value = name
    assert session.shape == name
    framed = view.image.value
    session.shape = None
    assert view.select.value is None and view.image.value != framed
    view.close()
    session.colour_by = "group"
    assert pixels(view.image).shape == pixels(framed).shape and view.image.value != framed, "closed views stand still"


def test_closed_view_does_not_draw(session, monkeypatch):
    view = FamilyView(session, size=48)
    view.close()
    monkeypatch.setattr(FamilyView, "refresh", lambda self: pytest.fail("a closed view was redrawn"))
    session.colour_by = "part" if session.colour_by != "part" else "group"
    session.touch("groups")


def test_views_share_a_session(session):
    first, second = FamilyView(session, size=48), FamilyView(session, size=48)
    first.colour.value = "part"
    assert second.colour.value == "part" and second.image.value == first.image.value


def test_watched_fit_equals_unwatched_fit_and_is_seen(tmp_path_factory):
    alone, watched = (learned_family(tmp_path_factory, name) for name in ("alone", "watched"))
    last(run(alone, "fit", rounds=2, inner=1, seed=5, jobs=1))
    view = FitView(watched, size=96)
    seen, messages = [], []
    view.image.observe(lambda change: seen.append(change.new), "value")
    view.words.observe(lambda change: messages.append(change.new), "value")
    view.run(rounds=2, inner=1, seed=5)
    assert view.session.running
    assert view.wait(seconds=200)
    assert not view.session.running
    for name in alone.names:
        np.testing.assert_array_equal(alone.positions(name), watched.positions(name))
        np.testing.assert_array_equal(alone.face_probabilities(name), watched.face_probabilities(name))
    assert len(seen) >= 1 and len({bytes(one) for one in seen}) == len(seen), "every round shows something new"
    assert "<svg" in view.plot.value and "nats" in view.plot.value
    assert any("round" in text for text in messages)
    assert view.bar.value == view.bar.max
    assert view.by.value == "part"
    by_part = view.image.value
    view.by.value = "movement"
    assert view.image.value != by_part


def test_fit_view_pauses_after_a_step_and_goes_on(tmp_path_factory):
    project = learned_family(tmp_path_factory, "steps")
    view = FitView(project, size=48)
    assert view.buttons["stop"].disabled and "Nothing is running" in view.buttons["stop"].tooltip
    view.run(rounds=2, inner=1, seed=8)
    view.desk.control("step")
    assert view.wait(seconds=200), "wait ends when the step is done"
    assert view.session.running and view.desk.runner.paused
    assert not view.buttons["stop"].disabled
    view.desk.control("resume")
    assert view.wait(seconds=200)
    assert not view.session.running and view.session.status_kind == "ok"


def test_failed_stage_becomes_a_sentence(tmp_path_factory):
    project = learned_family(tmp_path_factory, "failing")
    view = FitView(project, size=48)
    for name in project.labelled:
        project.set_labels(name, None)
    view.run(restart=True)
    assert view.wait(seconds=60)
    assert view.session.status_kind == "error" and "part" in view.session.status
    assert view.words.value.startswith("<span>fit needs")


def test_desk_without_a_loop_delivers_in_wait(session):
    desk = NotebookDesk(session)
    assert desk.choose_folder("") is None and desk.choose_files("", ()) == () and desk.choose_save("", "") is None
    steps = iter(range(3))
    desk.start("group", lambda: steps)
    assert desk.wait(seconds=20) and session.progress == 2 and not session.running


# -- sliders ----------------------------------------------------------------------------------------------------------


def test_sliders_move_the_shape_and_follow_the_session(session):
    view = SliderView(session, size=96, sliders=3)
    assert len(view.sliders) == 3
    start, points = view.image.value, view.sculptor.points()
    view.sliders[0].value = view.sliders[0].max
    assert view.sculptor.values()[0] == pytest.approx(view.sliders[0].max, abs=1e-6)
    moved = view.sculptor.points()
    assert np.nanmax(np.linalg.norm(moved - points, axis=1)) > 1e-4 and view.image.value != start
    session.sliders = {}
    home = float(np.clip(view.sculptor.home()[0], view.sliders[0].min, view.sliders[0].max))
    assert view.sliders[0].value == pytest.approx(home, abs=0.01) and view.image.value == start
    np.testing.assert_array_equal(view.sculptor.points(), points)


def test_parts_are_switched_by_boxes_that_can_be(session):
    view = SliderView(session, size=96, sliders=2)
    names = view.sculptor.part_names
    always = view.sculptor.always()
    assert view.boxes[names.index("seat")].disabled and always[names.index("seat")]
    arm = names.index("arm")
    if arm not in view.boxes or view.boxes[arm].disabled:
        pytest.skip("the two rounds of this fit found arms on all chairs or on none")
    own = np.asarray(view.sculptor.part) == arm
    for on in (True, False):
        view.boxes[arm].value = on
        assert np.isfinite(view.sculptor.points()[own]).all(axis=1).any() == on


def test_mean_random_and_mesh(session):
    view = SliderView(session, size=96, sliders=1)
    by_words = {button.description: button for button in view.children[0].children[0].children[0].children}
    mean = view.image.value
    by_words["Random"].click()
    assert view.image.value != mean
    by_words["Mean"].click()
    assert view.image.value == mean
    by_words["Make the mesh"].click()
    assert view.made is not None and len(view.made.triangles) > 100 and view.image.value != mean
    assert "gaps" in view.words.value
    view.sliders[0].value = view.sliders[0].min
    assert view.made is None, "a mesh of another shape is no longer shown"


def test_sliders_need_a_learned_family(grouped):
    with pytest.raises(ValueError, match="run the stage learn first"):
        SliderView(grouped)


def test_fit_view_before_labels_says_why(grouped):
    view = FitView(grouped, size=48)
    assert view.buttons["fit"].disabled and view.buttons["fit"].tooltip
    assert len(view.session.watched) == 3


def test_small_things(learned):
    picture = np.random.default_rng(0).integers(0, 255, (5, 7, 3)).astype(np.uint8)
    np.testing.assert_array_equal(pixels(encoded(picture)), picture)
    assert "arm" in legend(learned).value and "#D55E00" in legend(learned).value
    assert "--accent:" in styled("<svg></svg>", "dark")


# -- the story --------------------------------------------------------------------------------------------------------


@pytest.mark.timeout(600)
def test_whole_story(tmp_path):
    """The notebook runs from top to bottom, shows pictures while it does, and leaves shapes and a report."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOKS / "01_whole_story.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "the notebook is kept without outputs"
    surroundings = {
        **os.environ, "SHAPEFORGE_STORY": str(tmp_path), "SHAPEFORGE_STORY_SHAPES": "5", "OMP_NUM_THREADS": "1",
        "SHAPEFORGE_STORY_POINTS": "400",
    }  # fmt: skip
    surroundings.pop("DISPLAY", None)  # off screen as on a server
    place = {"metadata": {"path": str(tmp_path)}}
    client = NotebookClient(notebook, timeout=500, kernel_name="python3", resources=place, store_widget_state=True)
    client.execute(env=surroundings)
    assert (tmp_path / "report.html").stat().st_size > 100_000
    assert len(list((tmp_path / "new").glob("*.glb"))) == 3
    states = notebook.metadata.widgets["application/vnd.jupyter.widget-state+json"]["state"].values()
    shown = [
        base64.b64decode(buffer["data"])
        for state in states
        if state["model_name"] == "ImageModel"
        for buffer in state.get("buffers", [])
    ]
    assert len(shown) >= 4, "the family twice, the fit, the sliders"
    for one in shown:
        assert pixels(one).std() > 5, "a picture is blank"
    energies = [s for s in states if s["model_name"] == "HTMLModel" and "energy" in s["state"].get("value", "")]
    assert energies, "the energy was plotted while the fit ran"
