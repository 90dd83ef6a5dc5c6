"""Smooth borders between the parts of a connected surface: labels become a field, and triangles are cut where it ties.

Faces are labelled whole, so a border follows their edges, zigzag where the mesh has no edge along it.  Here the labels
are spread over the surface by a little heat, which creases hold back, and every triangle is cut along the line on which
two labels are equally warm.  Borders that follow a crease or a row of edges stay where they are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix, csr_array, diags_array
from scipy.sparse.linalg import splu

from shapeforge.synthesis.cleaning import areas, components, neighbours
from shapeforge.synthesis.surfaces import Triangles, Vertices, sides_of

SPREAD = 0.02
"""How far (diagonals) heat spreads: teeth of a border narrower than about three times this are gone."""
CREASE = 0.85
"""Cosine of the angle of neighbours below which their common edge holds heat back ..."""
HELD_BACK = 0.05
"""... to this share."""
ON_VERTEX = 0.2
"""A border that comes this near to a vertex (share of every edge that it crosses there) runs through it."""
SLIVER = 0.06
"""A border crosses an edge at least this far (share) from its ends."""
LOST = 0.3
"""Where a label would lose more than this share of a component's area to smoothing, the old border stays."""


def smooth_borders(
    vertices: Vertices, triangles: Triangles, label: Int[np.ndarray, " N"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and labels (any integers) of a welded mesh, cut anew along smooth borders.

    The surface stays as it is: vertices are only added, on edges and inside triangles at which three parts meet.
    Lengths in diagonals.
    """
    first, second, _ = neighbours(vertices, triangles)
    border = label[first] != label[second]
    if not border.any():
        return vertices, triangles, label
    component = components(len(triangles), first, second)
    mixed = np.flatnonzero(np.isin(component, component[first[border]]))
    names, index = np.unique(label[mixed], return_inverse=True)
    used, corners = np.unique(triangles[mixed], return_inverse=True)
    own, corners = vertices[used], corners.reshape(-1, 3)
    field = _spread(own, corners, index.reshape(-1), len(names))
    at, pieces, origin, new = _cut(own, corners, index.reshape(-1), field)
    new = _keep_what_would_vanish(own, corners, index.reshape(-1), component[mixed], at, pieces, origin, new)
    place = np.concatenate([used, len(vertices) + np.arange(len(at) - len(own))])
    rest = np.ones(len(triangles), bool)
    rest[mixed] = False
    kept, pieces, origin, new = new
    return (
        np.concatenate([vertices, at[len(own) :]]),
        np.concatenate([triangles[rest], triangles[mixed[kept]], place[pieces]]).astype(np.int32),
        np.concatenate([label[rest], label[mixed[kept]], names[new]]).astype(label.dtype),
    )


def _spread(vertices: np.ndarray, triangles: np.ndarray, label: np.ndarray, n_labels: int) -> Float[np.ndarray, "V L"]:
    """Warmth of every label at every vertex: one implicit step of the heat equation over SPREAD squared."""
    area = np.maximum(areas(vertices, triangles), 1e-12)
    n = len(vertices)
    mass = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), n)
    start = np.zeros((n, n_labels))
    np.add.at(start, (triangles.ravel(), np.repeat(label, 3)), np.repeat(area / 3, 3))
    normal = np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    edges, edge_of_side = sides_of(triangles)
    weight = np.zeros(len(edges))
    for side in range(3):  # side i is opposite to corner i + 2
        a, b, c = (vertices[triangles[:, (side + k) % 3]] for k in range(3))
        cotangent = ((a - c) * (b - c)).sum(axis=1) / (2 * area)
        weight += np.bincount(edge_of_side[side::3], np.clip(cotangent, 0.02, 10.0) / 2, len(edges))
    order = np.argsort(edge_of_side, kind="stable")
    same = np.flatnonzero(np.diff(edge_of_side[order]) == 0)
    flat = np.abs((normal[order[same] // 3] * normal[order[same + 1] // 3]).sum(axis=1)) >= CREASE
    crease = np.zeros(len(edges), bool)
    crease[edge_of_side[order[same[~flat]]]] = True
    # Heat crosses a crease along the edges that leave its vertices, so those are what has to resist.
    on_crease = np.zeros(n, bool)
    on_crease[edges[crease]] = True
    weight *= np.where(~crease & on_crease[edges].any(axis=1), HELD_BACK, 1.0)
    i, j = edges.T
    stiff = coo_matrix((np.concatenate([-weight, -weight]), (np.r_[i, j], np.r_[j, i])), shape=(n, n)).tocsr()
    laplacian = csr_array(stiff) + diags_array(-np.asarray(stiff.sum(axis=1)).ravel())
    matrix = (diags_array(mass) + SPREAD**2 * laplacian).tocsc()
    return splu(matrix).solve(start)


def _cut(
    vertices: np.ndarray, triangles: np.ndarray, label: np.ndarray, field: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All vertices, the triangles cut along the ties of ``field``, which triangle each comes from, and its label."""
    winner = field.argmax(axis=1)
    edges, edge_of_side = sides_of(triangles)
    split, share, tied = _crossings(edges, winner, field)
    middle = np.full(len(edges), -1)
    middle[split] = len(vertices) + np.arange(split.sum())
    at = np.concatenate([vertices, ((1 - share) * vertices[edges[:, 0]] + share * vertices[edges[:, 1]])[split]])
    cuts = middle[edge_of_side].reshape(-1, 3)
    count = (cuts >= 0).sum(axis=1)
    pieces, origin, new = [], [], []

    def add(row: np.ndarray, corners: list[np.ndarray], part: np.ndarray) -> None:
        pieces.append(np.stack(corners, axis=1))
        origin.append(row)
        new.append(part)

    row = np.flatnonzero(count == 0)
    free = np.where(tied[triangles[row]], -1, winner[triangles[row]]).max(axis=1)
    # A triangle whose corners all lie on borders is of the label warmest in it.
    warmest = field[triangles[row]].sum(axis=1).argmax(axis=1) if len(row) else free
    add(row, list(triangles[row].T), np.where(free >= 0, free, warmest))
    for n in (1, 2):
        row = np.flatnonzero(count == n)
        # Turn: with one cut it is on side 0; with two they are on sides 0 and 2, so that corner 0 is alone.
        turn = (cuts[row] >= 0).argmax(axis=1) if n == 1 else ((cuts[row] < 0).argmax(axis=1) + 2) % 3
        columns = (turn[:, None] + np.arange(3)) % 3
        t, m = np.take_along_axis(triangles[row], columns, axis=1), np.take_along_axis(cuts[row], columns, axis=1)
        if n == 1:
            add(row, [t[:, 0], m[:, 0], t[:, 2]], winner[t[:, 0]])
            add(row, [m[:, 0], t[:, 1], t[:, 2]], winner[t[:, 1]])
        else:
            add(row, [t[:, 0], m[:, 0], m[:, 2]], winner[t[:, 0]])
            add(row, [m[:, 0], t[:, 1], t[:, 2]], winner[t[:, 1]])
            add(row, [m[:, 0], t[:, 2], m[:, 2]], winner[t[:, 2]])
    row = np.flatnonzero(count == 3)
    t, m = triangles[row], cuts[row]
    centre = len(at) + np.arange(len(row))
    at = np.concatenate([at, vertices[t].mean(axis=1)])
    for i in range(3):
        add(row, [t[:, i], m[:, i], centre], winner[t[:, i]])
        add(row, [t[:, i], centre, m[:, i - 1]], winner[t[:, i]])
    return at, np.concatenate(pieces), np.concatenate(origin), np.concatenate(new)


def _crossings(
    edges: Int[np.ndarray, "E 2"], winner: Int[np.ndarray, " V"], field: Float[np.ndarray, "V L"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which edges a border crosses (E,), at what share of their length (E, 1), and which vertices are on it (V,)."""
    a, b = edges.T
    lead_a = field[a, winner[a]] - field[a, winner[b]]
    lead_b = field[b, winner[b]] - field[b, winner[a]]
    crossed = winner[a] != winner[b]
    share = np.where(crossed, lead_a / np.maximum(lead_a + lead_b, 1e-300), 0.5)
    # A vertex very near to every crossing of its edges lies on the border itself.
    farthest = np.zeros(len(field))
    np.maximum.at(farthest, a[crossed], share[crossed])
    np.maximum.at(farthest, b[crossed], 1 - share[crossed])
    tied = (farthest > 0) & (farthest < ON_VERTEX)
    return crossed & ~tied[a] & ~tied[b], np.clip(share, SLIVER, 1 - SLIVER)[:, None], tied


def _keep_what_would_vanish(
    vertices: np.ndarray, triangles: np.ndarray, label: np.ndarray, component: np.ndarray, at: np.ndarray,
    pieces: np.ndarray, origin: np.ndarray, new: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Old triangles of the components to leave as they were, and the pieces, origins and labels of all others."""
    n_labels, n = int(label.max()) + 1, int(component.max()) + 1
    before = np.bincount(component * n_labels + label, areas(vertices, triangles), n * n_labels)
    after = np.bincount(component[origin] * n_labels + new, areas(at, pieces), n * n_labels)
    worse = (after < (1 - LOST) * before).reshape(n, n_labels).any(axis=1)
    good = ~worse[component[origin]]
    return np.flatnonzero(worse[component]), pieces[good], origin[good], new[good]
