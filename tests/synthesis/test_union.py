"""Parts become one solid where they are closed, and words say what to do where that cannot be."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from shapeforge.synthesis.assemble import synthesize
from shapeforge.synthesis.measures import open_edges
from shapeforge.synthesis.union import _wound_outwards, unite

BOTH = np.array([True, True])


def test_faces_wound_at_random_are_turned_outwards(tables) -> None:
    mesh = tables[0].shape.mesh
    box = mesh.triangles[np.isin(mesh.triangles, np.arange(8)).all(axis=1)]
    shuffled = np.where(np.random.default_rng(0).random(len(box))[:, None] < 0.5, box, box[:, ::-1])
    turned = _wound_outwards(mesh.vertices, shuffled)
    assert open_edges(shuffled) > 0 and open_edges(turned) == 0
    a, b, c = (mesh.vertices[turned[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_without_the_package_the_remedy_is_named(tables, sources, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(ValueError, match=r"shapeforge\[union\]"):
        unite(synthesize(tables[0].points, BOTH, sources))


def test_parts_become_one_closed_solid(tables, sources) -> None:
    pytest.importorskip("manifold3d", reason="the extra `union` is not installed")
    draw = tables[0].points.copy()
    draw[384:, 1] += 0.02  # legs go into the top
    made = synthesize(draw, BOTH, sources)
    united = unite(made)
    assert united.measures["open_edges"] == open_edges(united.triangles) == 0
    assert set(united.part.tolist()) == {0, 1}
    # What was inside of the top is gone.
    low = united.vertices[united.triangles[united.part == 1]].reshape(-1, 3)
    assert low[:, 1].max() < united.vertices[:, 1].max() - 0.005


def test_open_parts_are_named(tables, sources) -> None:
    pytest.importorskip("manifold3d", reason="the extra `union` is not installed")
    made = synthesize(tables[0].points, BOTH, sources)
    legs = np.flatnonzero(made.part == 1)
    keep = np.ones(len(made.part), bool)
    keep[legs[:3]] = False
    holed = replace(made, triangles=made.triangles[keep], part=made.part[keep])
    with pytest.raises(ValueError, match="legs is not a closed solid.*surface"):
        unite(holed)
