"""The shape in hand without a window: pins, locks and the history, and another machine."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.viewer.pulling import as_place, handles_of


@pytest.fixture
def pinned(sculptor):
    """Two points are held a little beside where the mean has them, in the history, too."""
    points = sculptor.points()
    sculptor.session.pins = {int(k): as_place(points[k] + 0.03) for k in handles_of(points)[:2]}
    sculptor.keep("pinned")
    return sculptor


def test_another_machine_knows_no_pins_and_no_locked_sliders(pinned):
    """Points and sliders of the old one may not be there any more, and nobody is told before the new one is."""
    session, heard = pinned.session, []
    session.parts_on = {0: True}
    pinned.lock(3, True)
    pinned.keep("locked")
    for name in ("pins", "parts_on", "sliders"):
        getattr(session.events, name).connect(lambda *_: heard.append(pinned.points()), check_nargs=False)
    pinned.part = np.zeros(0, int)  # as if the new templates had fewer points
    pinned._key = None
    assert pinned.reload()
    assert session.locked == frozenset() and session.pins == session.sliders == session.parts_on == {}
    assert len(pinned.recipes) == 1 and heard and all(points.shape == heard[0].shape for points in heard)


def test_what_follows_pins_is_another_shape_when_a_slider_is_let_go(pinned):
    pinned.lock(0, True)
    pinned.keep("locked")
    assert pinned.as_kept
    before = pinned.points()
    pinned.lock(0, False)
    assert np.nanmax(np.abs(pinned.points() - before)) > 1e-4 and not pinned.as_kept
    pinned.session.pins = {}
    pinned.keep("free")
    pinned.lock(0, True)
    assert pinned.as_kept, "without pins a lock changes nothing"


def test_a_draw_has_locked_sliders_where_they_are_with_pins_and_without(pinned):
    pinned.slide(1, float(pinned.home()[1]) + 1.0)
    pinned.lock(1, True)
    for pins, within in ((dict(pinned.session.pins), 0.1), ({}, 1e-6)):
        pinned.session.pins = pins
        value, before = pinned.values()[1], pinned.home()[1]
        pinned.start(pinned.drawn())
        assert pinned.session.locked == {1} and pinned.session.pins == pins
        assert pinned.values()[1] == pytest.approx(value, abs=within) and abs(pinned.home()[1] - before) > 2 * within


def test_a_pulled_point_and_its_twin_go_as_far_as_each_other_and_the_mesh_with_them(sculptor):
    """Points that move on one side only would be halved by the symmetry of the mesh."""
    before, mirror, part = sculptor.points(), sculptor.mirror, sculptor.part
    assert mirror.symmetric[part].any()
    there = np.isfinite(before).all(axis=1) & mirror.symmetric[part]
    off = np.where(there, np.abs(before @ mirror.normal - mirror.place(before, part)), 0.0)
    k = int(off.argmax())
    twin = int(mirror.partner[k])
    inwards = -0.04 * np.sign(before[k] @ mirror.normal - mirror.place(before, part)) * mirror.normal
    sculptor.session.pins = {k: as_place(before[k] + inwards)}
    points = sculptor.points()
    made = mirror.made_symmetric(points, part)
    went = [float((at[k] - before[k]) @ inwards) / 0.04**2 for at in (points, made)]
    assert went[0] > 0.5 and went[1] > 0.9 * went[0]
    assert float((points[twin] - before[twin]) @ -inwards) / 0.04**2 > 0.7 * went[0]
