"""Tables: a top and four legs of boxes, with exactly corresponding points, for tests without any fitted family."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from shapeforge.collection.shape import Frame, Mesh, Shape
from shapeforge.synthesis.sources import Sources, make_sources

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
PART_NAMES = ("top", "legs")


def box_points(low: np.ndarray, high: np.ndarray, n: int) -> np.ndarray:
    """A lattice of points on each of a box's six sides: the same for every box, so they correspond."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.05, 0.95, n), np.linspace(0.05, 0.95, n)))
    sides = []
    for axis in range(3):
        for end in (0.0, 1.0):
            side = np.empty((n * n, 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = end, u, v
            sides.append(low + side * (high - low))
    return np.concatenate(sides)


@dataclass(frozen=True)
class Table:
    shape: Shape
    faces: np.ndarray
    points: np.ndarray


def make_table(width: float, depth: float, height: float, *, inset: float = 0.0, thick: float = 0.05) -> Table:
    """A table of given size before it is scaled to diagonal 1; the legs end exactly under the top."""
    boxes = [(np.array([-width / 2, height - thick, -depth / 2]), np.array([width / 2, height, depth / 2]))]
    leg = 0.08
    for x in (-width / 2 + inset, width / 2 - leg - inset):
        for z in (-depth / 2 + inset, depth / 2 - leg - inset):
            boxes.append((np.array([x, 0, z]), np.array([x + leg, height - thick, z + leg])))
    centre = np.array([0, height / 2, 0])
    scale = 1 / np.linalg.norm([width, height, depth])
    vertices = scale * (np.concatenate([low + CORNERS * (high - low) for low, high in boxes]) - centre)
    quads = np.concatenate([QUADS + 8 * i for i in range(5)])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = Mesh(vertices, triangles, np.tile(np.arange(30), 2), 30)
    points = scale * (np.concatenate([box_points(low, high, 8) for low, high in boxes]) - centre)
    frame = Frame(scale, np.eye(3), centre)
    n = len(points)
    shape = Shape(
        f"table{width:g}x{depth:g}x{height:g}", mesh, frame, points, np.zeros((n, 3)), np.zeros(n, np.int32),
        np.zeros(n, np.int32), np.zeros((n, 10)), np.zeros(n, np.int32), np.zeros((n, 1), np.int32),
    )  # fmt: skip
    return Table(shape, np.repeat([0, 1, 1, 1, 1], 6).astype(np.int32), points)


@pytest.fixture
def tables() -> list[Table]:
    sizes = [(1.0, 1.0, 1.0), (1.6, 0.8, 0.7), (0.7, 0.7, 1.4), (1.2, 1.1, 0.5)]
    return [make_table(*size) for size in sizes] + [make_table(1.3, 1.3, 0.9, inset=0.25)]


@pytest.fixture
def table_part() -> np.ndarray:
    return np.repeat([0, 1], [6 * 64, 4 * 6 * 64]).astype(np.int32)


@pytest.fixture
def sources(tables: list[Table], table_part: np.ndarray) -> Sources:
    return make_sources(
        [t.shape.name for t in tables], lambda i: tables[i].shape, [t.faces for t in tables],
        np.stack([t.points for t in tables]), table_part, PART_NAMES,
    )  # fmt: skip
