"""Parts become one solid, those with holes after these were closed; words say what to do where that cannot be."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from shapeforge.synthesis import union
from shapeforge.synthesis.assemble import synthesize
from shapeforge.synthesis.closing import closed_solids
from shapeforge.synthesis.measures import open_edges
from shapeforge.synthesis.union import unite
from tests.synthesis.conftest import CORNERS, QUADS

BOTH = np.array([True, True])


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


def test_open_parts_are_closed_and_told(tables, sources) -> None:
    pytest.importorskip("manifold3d", reason="the extra `union` is not installed")
    made = synthesize(tables[0].points, BOTH, sources)
    legs = np.flatnonzero(made.part == 1)
    keep = np.ones(len(made.part), bool)
    keep[legs[0]] = False
    united = unite(replace(made, triangles=made.triangles[keep], part=made.part[keep]))
    assert united.measures["open_edges"] == open_edges(united.triangles) == 0
    # One leg of four had a hole.
    assert list(united.measures["closed"]) == ["legs"] and 0.2 < united.measures["closed"]["legs"] < 0.3
    assert "closed" not in unite(made).measures


def test_what_cannot_be_a_solid_is_named(tables, sources, monkeypatch) -> None:
    pytest.importorskip("manifold3d", reason="the extra `union` is not installed")
    open_box = closed_solids(CORNERS, QUADS[:, :3])[0]
    broken = replace(open_box, triangles=open_box.triangles[1:])
    monkeypatch.setattr(union, "closed_solids", lambda vertices, triangles: [broken])
    with pytest.raises(ValueError, match="top cannot be closed.*surface"):
        unite(synthesize(tables[0].points, BOTH, sources))
