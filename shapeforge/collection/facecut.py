"""Labels of faces from noisy costs: a graph cut over the faces of a mesh by alpha-expansion.

Energy of labels ``l`` (Boykov, Veksler & Zabih 2001, Potts model), without a unit of length:

    E(l) = sum_f area_f / A * cost[f, l_f]  +  weight / 1000 * sum_{f,g adjacent, l_f != l_g} border_fg / sqrt(A)

with ``A`` the whole area and ``border_fg`` the length of the common edge, times a factor below 1 where the surface
bends.  So ``weight`` is a width, in thousandths of sqrt(A): a border is worth one nat over a strip that wide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh

WELD = 1e-5  # diagonals: corners nearer than this are one
BENT = 0.1  # what is left of a border's cost where the surface turns by a right angle or more
LINK_REACH, LINK_SHARE, LINK_COUNT = 0.02, 0.1, 3  # between components: reach (diagonals), strength, links per face
LARGEST_COST = 100.0  # nats above the best label: more is as good as forbidden, and would cost precision
_LARGEST_TOTAL = 2**30  # scipy's maximum flow counts in int32
_MANY_FACES_ON_AN_EDGE = 6


@dataclass(frozen=True, eq=False)
class FaceGraph:
    """Adjacent face records: ``pairs`` (E, 2) with first < second, each once, and what separating them costs.

    ``border`` (E,) is in units of the mesh: the length of the common edge, less where the surface bends.
    """

    pairs: Int[np.ndarray, "E 2"]
    border: Float[np.ndarray, " E"]


def cut_faces(
    mesh: Mesh, cost: Float[np.ndarray, "F L"], *, weight: float = 20.0, graph: FaceGraph | None = None,
    sure: float = np.inf,
) -> Int[np.ndarray, " F"]:  # fmt: skip
    """Part index per face record (n_faces,) int32 that minimises cost plus the length of the borders (see above).

    ``cost`` (n_faces, L) in nats, as minus the log probability of each part on each face, finite; ``weight`` in
    thousandths of the root of the area (0: every face its cheapest part).  ``graph`` may be passed when one mesh is cut
    more than once.  Exact for two parts, within a factor of two for more.  Faces without area take their neighbours'
    label, or their cheapest part when they have no neighbours.  Faces whose cheapest part is more than ``sure`` nats
    ahead of the next keep it unasked, which makes the cut faster and no longer exact.

    Raises ValueError when ``cost`` does not fit the mesh or isn't finite, or ``weight`` is negative.
    """
    if cost.ndim != 2 or len(cost) != mesh.n_faces or cost.shape[1] == 0:
        raise ValueError(f"cost: wanted ({mesh.n_faces}, L) for this mesh, got {cost.shape}; one row per face record")
    if not np.isfinite(cost).all():
        raise ValueError("cost: wanted finite nats, got NaN or infinity; floor the probabilities before the logarithm")
    if not weight >= 0:
        raise ValueError(f"weight: wanted a number >= 0, got {weight}")
    cheapest = cost.argmin(axis=1)
    total = float(mesh.face_areas.sum())
    if not total > 0 or weight == 0 or cost.shape[1] == 1:
        return cheapest.astype(np.int32)
    graph = face_graph(mesh) if graph is None else graph
    excess = np.minimum(cost - cost.min(axis=1, keepdims=True), LARGEST_COST).astype(np.float64)
    # A face without area has no opinion that counts, but one to break ties with.
    unary = excess * np.maximum(mesh.face_areas / total, 1e-9)[:, None]
    pairwise = weight / 1000 * graph.border / np.sqrt(total)
    scale = _LARGEST_TOTAL / max(float(unary.max(axis=1).sum() + 2 * pairwise.sum()), 1e-300)
    unary, pairwise = np.rint(unary * scale).astype(np.int64), np.rint(pairwise * scale).astype(np.int64)
    asked = np.partition(excess, 1, axis=1)[:, 1] <= sure
    return minimize_some(asked, cheapest, unary, graph.pairs, pairwise).astype(np.int32)


def minimize_some(
    asked: Bool[np.ndarray, " F"], labels: Int[np.ndarray, " F"], unary: Int[np.ndarray, "F L"],
    pairs: Int[np.ndarray, "E 2"], pairwise: Int[np.ndarray, " E"],
) -> Int[np.ndarray, " F"]:  # fmt: skip
    """Labels (F,) of small Potts energy (`minimize_potts`) of the nodes ``asked``, the others keeping theirs."""
    if not asked.any():
        return labels
    faces = np.flatnonzero(asked)
    place = np.cumsum(asked) - 1
    unary = unary[faces]
    for here, there in (pairs.T, pairs.T[::-1]):
        edge = np.flatnonzero(asked[here] & ~asked[there])
        row, other, border = place[here[edge]], labels[there[edge]], pairwise[edge]
        unary += np.bincount(row, border, len(faces)).astype(np.int64)[:, None]
        np.subtract.at(unary, (row, other), border)
    both = asked[pairs].all(axis=1)
    labels = labels.copy()
    labels[faces] = minimize_potts(unary, place[pairs[both]], pairwise[both])
    return labels


def potts_energy(
    labels: Int[np.ndarray, " F"], unary: Int[np.ndarray, "F L"], pairs: Int[np.ndarray, "E 2"],
    pairwise: Int[np.ndarray, " E"],
) -> int:  # fmt: skip
    """Sum of unary[f, labels[f]] and of pairwise over the pairs whose labels differ; integers, so exactly."""
    apart = labels[pairs[:, 0]] != labels[pairs[:, 1]]
    return int(unary[np.arange(len(labels)), labels].sum() + pairwise[apart].sum())


def minimize_potts(
    unary: Int[np.ndarray, "F L"],
    pairs: Int[np.ndarray, "E 2"],
    pairwise: Int[np.ndarray, " E"],
    *,
    max_sweeps: int = 8,
) -> Int[np.ndarray, " F"]:
    """Labels (F,) of small Potts energy by alpha-expansion, from every node's cheapest label.

    All costs are integers >= 0 whose sum is at most 2**30.  With two labels one cut is the exact minimum.
    """
    n_labels = unary.shape[1]
    if n_labels == 2:
        return expand(np.zeros(len(unary), np.int64), 1, unary, pairs, pairwise)
    labels = unary.argmin(axis=1)
    energy = potts_energy(labels, unary, pairs, pairwise)
    since_change = 0
    for step in range(max_sweeps * n_labels):
        proposal = expand(labels, step % n_labels, unary, pairs, pairwise)
        proposed = potts_energy(proposal, unary, pairs, pairwise)
        since_change += 1
        if proposed < energy:
            labels, energy, since_change = proposal, proposed, 0
        if since_change >= n_labels:
            break
    return labels


def expand(
    labels: Int[np.ndarray, " F"], alpha: int, unary: Int[np.ndarray, "F L"], pairs: Int[np.ndarray, "E 2"],
    pairwise: Int[np.ndarray, " E"],
) -> Int[np.ndarray, " F"]:  # fmt: skip
    """The best labels (F,) within one expansion move: every node keeps its label or takes ``alpha``.

    A minimum cut; x = 1 ("takes alpha") is the sink's side.  Pairwise terms are split as Kolmogorov & Zabih (2004) do.
    """
    n = len(labels)
    i, j = pairs[:, 0], pairs[:, 1]
    keep_both = pairwise * (labels[i] != labels[j])
    only_j = pairwise * (labels[i] != alpha)
    only_i = pairwise * (labels[j] != alpha)
    # keep_both + (only_i - keep_both) x_i - only_i x_j + (only_j + only_i - keep_both) (1 - x_i) x_j
    gain = unary[:, alpha] - unary[np.arange(n), labels]
    gain = gain + np.bincount(i, only_i - keep_both, n).astype(np.int64) - np.bincount(j, only_i, n).astype(np.int64)
    capacity = only_j + only_i - keep_both
    source, sink = n, n + 1
    nodes = np.arange(n)
    rows = np.concatenate([i, np.where(gain >= 0, source, nodes)])
    columns = np.concatenate([j, np.where(gain >= 0, nodes, sink)])
    values = np.concatenate([capacity, np.abs(gain)])
    used = values > 0
    network = coo_matrix((values[used].astype(np.int32), (rows[used], columns[used])), shape=(n + 2, n + 2)).tocsr()
    flow = maximum_flow(network, source, sink).flow
    residual = network - flow
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    # Who can still reach the sink takes alpha: of all minimum cuts the one that changes least, so ties stay put.
    takes = breadth_first_order(residual.T.tocsr(), sink, return_predecessors=False)
    changed = labels.copy()
    changed[takes[takes < n]] = alpha
    return changed


def face_graph(mesh: Mesh) -> FaceGraph:
    """Which faces are adjacent: by a common edge, of the same or of coincident corners, manifold or not; and, between
    components that share no edge but nearly touch (polygon soup, screws, cushions), by weak links to the nearest faces.
    """
    diagonal = surface_diagonal(mesh)
    if diagonal == 0:
        return FaceGraph(np.zeros((0, 2), np.int64), np.zeros(0))
    pairs, border = edge_neighbours(mesh, diagonal)
    links, strength = _component_links(mesh, pairs, diagonal)
    pairs, border = np.concatenate([pairs, links]), np.concatenate([border, strength])
    code, place = np.unique(pairs[:, 0] * mesh.n_faces + pairs[:, 1], return_inverse=True)
    summed = np.bincount(place, border, len(code))
    return FaceGraph(np.stack([code // mesh.n_faces, code % mesh.n_faces], axis=1), summed)


def surface_diagonal(mesh: Mesh) -> float:
    """Diagonal of the box of all triangles; 0 without any.  Vertices that no triangle uses may lie anywhere."""
    return float(np.linalg.norm(np.ptp(mesh.vertices[_used(mesh)], axis=0))) if len(mesh.triangles) else 0.0


def _used(mesh: Mesh) -> Bool[np.ndarray, " V"]:
    """Which vertices (V,) triangles use."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.triangles] = True
    return used


def edge_neighbours(mesh: Mesh, diagonal: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces (E, 2) along every edge, and the weighted length of it; ``diagonal`` is that of the surface."""
    used = _used(mesh)
    vertices = mesh.vertices[used]
    cells = np.rint((vertices - vertices.min(axis=0)) / (WELD * diagonal)).astype(np.int64)
    _, corner = np.unique(cells, axis=0, return_inverse=True)
    triangles = corner.reshape(-1)[(np.cumsum(used) - 1)[mesh.triangles]]
    ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    face = np.tile(mesh.face_of_triangle, 3)
    start = np.concatenate([mesh.vertices[mesh.triangles[:, c]] for c in (0, 1, 2)])
    stop = np.concatenate([mesh.vertices[mesh.triangles[:, c]] for c in (1, 2, 0)])
    length = np.linalg.norm(stop - start, axis=1)
    real = ends[:, 0] != ends[:, 1]
    code = (ends[:, 0] * (triangles.max() + 1) + ends[:, 1])[real]
    face, length = face[real].astype(np.int64), length[real]
    order = np.lexsort((face, code))
    code, face, length = code[order], face[order], length[order]
    found = []
    # Records sorted by edge: those that lie ``step`` apart and name the same edge are neighbours.  An edge of very many
    # faces (a fan of degenerate soup) becomes a chain with a few rungs instead of a clique.
    for step in range(1, _MANY_FACES_ON_AN_EDGE):
        same = (code[step:] == code[:-step]) & (face[step:] != face[:-step])
        found.append((face[:-step][same], face[step:][same], length[step:][same]))
    first, second, length = (np.concatenate(column) for column in zip(*found, strict=True))
    pairs = np.sort(np.stack([first, second], axis=1), axis=1)
    # Winding cannot be trusted in soup, so a fold is read from the angle between the planes alone.
    cosine = np.abs((mesh.face_normals[pairs[:, 0]] * mesh.face_normals[pairs[:, 1]]).sum(axis=1))
    return pairs, length * (BENT + (1 - BENT) * np.clip(cosine, 0, 1) ** 2)


def _component_links(mesh: Mesh, pairs: np.ndarray, diagonal: float) -> tuple[np.ndarray, np.ndarray]:
    """Weak links (E, 2) between faces of different components whose centres are among the nearest, with strengths."""
    n = mesh.n_faces
    _, component = connected_components(
        coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n)), directed=False
    )
    here = np.unique(mesh.face_of_triangle)
    if len(np.unique(component[here])) == 1:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    # Centres of triangles stand for large faces better than one centre each; the links are between their faces.
    at, face = mesh.vertices[mesh.triangles].mean(axis=1), mesh.face_of_triangle
    distance, near = cKDTree(at).query(mesh.face_centres[here], k=min(16, len(at)), workers=1)
    distance, near = distance.reshape(len(here), -1), face[near.reshape(len(here), -1)]
    apart = component[near] != component[here][:, None]
    close = apart & (np.cumsum(apart, axis=1) <= LINK_COUNT)
    # Faces without area have no size to reach by; they may link over the reach alone.
    width = np.sqrt(mesh.face_areas)
    reach = LINK_REACH * diagonal + 0.5 * (width[here][:, None] + width[near])
    row, column = np.nonzero(close & (distance < reach))
    first, second = here[row], near[row, column]
    strength = LINK_SHARE / LINK_COUNT * np.maximum(np.minimum(width[first], width[second]), 1e-6 * diagonal)
    return np.sort(np.stack([first, second], axis=1), axis=1).astype(np.int64), strength
