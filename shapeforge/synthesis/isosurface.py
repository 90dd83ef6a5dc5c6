"""The surface on which a field on a lattice takes a value, as a closed mesh: a dual method with one vertex per sheet.

Every cell that the surface passes has a vertex in the middle of its crossings, and every lattice edge that the surface
crosses has a quad between the four cells around it (surface nets: Gibson 1998).  Where two sheets pass one cell, each
has a vertex of its own (dual marching cubes: Nielson 2004), so that they are not welded where they come close.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

CORNERS = np.array([[b & 1, b >> 1 & 1, b >> 2 & 1] for b in range(8)])
EDGES = [(b, b | 1 << axis) for axis in range(3) for b in range(8) if not b >> axis & 1]
"""Twelve pairs of corners of a cell; the four along each axis lie together."""


def _sheets() -> tuple[np.ndarray, np.ndarray]:
    """Sheet of each of the twelve edges (256, 12; -1 not crossed) and number of sheets (256,), by inside corners."""
    sheet, count = np.full((256, 12), -1), np.zeros(256, int)
    for inside in range(256):
        joined = {e: e for e, (a, b) in enumerate(EDGES) if (inside >> a & 1) != (inside >> b & 1)}

        def root(e: int, joined: dict[int, int] = joined) -> int:
            return e if joined[e] == e else root(joined[e])

        for axis in range(3):
            for end in (0, 1):
                face = [e for e, (a, b) in enumerate(EDGES) if a >> axis & 1 == end and b >> axis & 1 == end]
                crossed = [e for e in face if e in joined]
                # Four crossings: corners inside that face each other are cut apart, by the cells on both sides alike.
                groups = [crossed] if len(crossed) == 2 else [
                    [e for e in crossed if corner in EDGES[e]] for corner in range(8) if inside >> corner & 1
                ]  # fmt: skip
                for one in groups:
                    for other in one[1:]:
                        joined[root(other)] = root(one[0])
        roots = sorted({root(e) for e in joined})
        for e in joined:
            sheet[inside, e] = roots.index(root(e))
        count[inside] = len(roots)
    return sheet, count


SHEET, N_SHEETS = _sheets()


def isosurface(
    field: Float[np.ndarray, "X Y Z"], level: float
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "N 3"]]:
    """Vertices, in lattice steps, and triangles around where ``field`` is above ``level``, wound outwards.

    Closed, since the outermost layer of the lattice counts as below the level, whatever it holds.
    """
    above = np.zeros(field.shape, bool)
    above[1:-1, 1:-1, 1:-1] = field[1:-1, 1:-1, 1:-1] > level
    cells = tuple(max(n - 1, 0) for n in field.shape)
    inside = np.zeros(cells, np.uint8)
    for b, (x, y, z) in enumerate(CORNERS):
        inside |= above[x : x + cells[0], y : y + cells[1], z : z + cells[2]].astype(np.uint8) << b
    passed = np.flatnonzero(N_SHEETS[inside.ravel()])
    first = np.full(inside.size, -1)
    total = N_SHEETS[inside.ravel()[passed]]
    first[passed] = np.cumsum(total) - total
    sums, hits, quads = np.zeros((int(total.sum()), 3)), np.zeros(int(total.sum())), [np.zeros((0, 4), np.int64)]
    for axis in range(3):
        ahead = np.zeros(3, int)
        ahead[axis] = 1
        a = np.argwhere(np.diff(above, axis=axis))
        b = a + ahead
        values = field[tuple(a.T)] - level, field[tuple(b.T)] - level
        out = above[tuple(a.T)]
        share = np.clip(values[0] / np.where(values[0] == values[1], 1.0, values[0] - values[1]), 0.02, 0.98)
        crossing = a + share[:, None] * ahead
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ring = []
        for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):  # how far the cell lies behind the edge, counter-clockwise
            cell = a.copy()
            cell[:, u] -= du
            cell[:, v] -= dv
            row = np.ravel_multi_index(tuple(cell.T), cells)
            edge = EDGES.index((du << u | dv << v, du << u | dv << v | 1 << axis))
            vertex = first[row] + SHEET[inside.ravel()[row], edge]
            np.add.at(sums, vertex, crossing)
            np.add.at(hits, vertex, 1)
            ring.append(vertex)
        quad = np.stack(ring, axis=1)
        quads.append(np.where(out[:, None], quad, quad[:, ::-1]))
    vertices = sums / np.maximum(hits, 1)[:, None]
    quad = np.concatenate(quads)
    # Cut along the shorter diagonal.
    p = vertices[quad]
    turn = ((p[:, 0] - p[:, 2]) ** 2).sum(axis=1) > ((p[:, 1] - p[:, 3]) ** 2).sum(axis=1)
    quad = np.where(turn[:, None], np.roll(quad, -1, axis=1), quad)
    return vertices, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)
