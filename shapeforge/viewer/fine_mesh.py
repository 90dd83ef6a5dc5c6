"""A mesh fine enough to be coloured smoothly."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

FINEST_EDGE = 0.045  # diagonals: longer edges are halved for display, so that heat can vary over large faces
MOST_TRIANGLES = 60_000


def fine_mesh(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"], record: Int[np.ndarray, " N"],
    longest: float = FINEST_EDGE, most: int = MOST_TRIANGLES,
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "M 3"], Int[np.ndarray, " M"]]:  # fmt: skip
    """The same surface with edges longer than ``longest`` halved until none is, or there are ``most`` triangles.

    Each split edge gets one new vertex that its neighbours share, so there are no cracks.
    """
    vertices, triangles, record = np.asarray(vertices, float), np.asarray(triangles), np.asarray(record)
    for _ in range(8):
        ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        long = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1) > longest
        if not long.any() or len(triangles) + 2 * long.sum() > most:
            break
        edges, which = np.unique(ends[long], axis=0, return_inverse=True)
        middle = np.full(len(ends), -1)
        middle[long] = len(vertices) + which
        vertices = np.vstack([vertices, vertices[edges].mean(axis=1)])
        triangles, record = _split(triangles, middle.reshape(-1, 3), record)
    return vertices, triangles, record


def _split(triangles: np.ndarray, middle: np.ndarray, record: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles with some edges' middles given (N, 3), -1 where an edge stays; into one to four triangles each."""
    count = (middle >= 0).sum(axis=1)
    parts, owners = [triangles[count == 0]], [record[count == 0]]
    one = np.flatnonzero(count == 1)
    turn = middle[one].argmax(axis=1)[:, None]
    a, b, c = (np.take_along_axis(triangles[one], (turn + i) % 3, axis=1)[:, 0] for i in range(3))
    m = middle[one].max(axis=1)
    parts += [np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
    owners += [record[one]] * 2
    two = np.flatnonzero(count == 2)
    whole = (middle[two] < 0).argmax(axis=1)[:, None]  # the edge that stays: a to b; c is opposite
    a, b, c = (np.take_along_axis(triangles[two], (whole + i) % 3, axis=1)[:, 0] for i in range(3))
    bc, ca = (np.take_along_axis(middle[two], (whole + i) % 3, axis=1)[:, 0] for i in (1, 2))
    parts += [np.stack([a, b, bc], axis=1), np.stack([a, bc, ca], axis=1), np.stack([ca, bc, c], axis=1)]
    owners += [record[two]] * 3
    three = np.flatnonzero(count == 3)
    (a, b, c), (ab, bc, ca) = triangles[three].T, middle[three].T
    parts += [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    owners += [record[three]] * 4
    return np.concatenate(parts), np.concatenate(owners)
