"""Groups of similar shapes and the exemplar of each (§4, clustering)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from shapeforge.collection.align import dissimilarity, thinned
from shapeforge.collection.parallel import in_order

ALL_PAIRS_UP_TO = 100  # shapes (§2); above, distances on the edges of a graph only
POINTS_COMPARED = 256
GRAPH_NEIGHBOURS = 12
ISOMAP_DIMENSIONS = 20  # §2
PROPAGATED_AT_MOST = 1000  # shapes among which exemplars are sought; the time grows with the square
_PAIRS_A_BLOCK = 128


@dataclass(frozen=True, eq=False)
class Groups:
    """``group[t]`` is the group of shape t (0..n-1), ``exemplars[g]`` the shape index that stands for group g.

    ``embedding`` places the shapes in the plane by similarity (near means similar); ``excluded`` shapes have group -1.
    """

    names: tuple[str, ...]
    group: Int[np.ndarray, " T"]
    exemplars: Int[np.ndarray, " G"]
    embedding: Float[np.ndarray, "T 2"]
    dissimilarity: Float[np.ndarray, "T T"] | None = None

    def members(self, g: int) -> Int[np.ndarray, " m"]:
        """Indices of the shapes of group g."""
        return np.flatnonzero(self.group == g)

    def __len__(self) -> int:
        return len(self.exemplars)


@dataclass(frozen=True, eq=False)
class GroupState:
    """Progress of ``group_shapes``: ``step`` of ``of`` within ``phase``; ``groups`` and ``stop_reason`` at the end."""

    step: int
    of: int
    phase: str
    groups: Groups | None = None
    stop_reason: str | None = None


def group_shapes(
    shapes: Any,
    *,
    rng: np.random.Generator,
    executor: Executor | Any | None = None,
    exemplars: Sequence[int] | None = None,
) -> Iterator[GroupState]:
    """Groups of similar ``shapes`` (a sequence, lazy or not), by how much deformation maps one to another (§2, §4).

    Up to 100 shapes every pair is compared; above, the edges of a graph of similar shapes only, whose path lengths are
    embedded in 20 dimensions (Isomap).  Affinity propagation finds groups and exemplars, one for some 6 to 25 shapes.
    ``exemplars``: shape indices that the user chose instead; every shape joins the nearest.  ``executor`` has the
    interface of ``concurrent.futures``; the result does not depend on it.  Yields progress, then a state with
    ``groups``: largest first, "Group 1" and so on.

    Raises ValueError for no shapes at all and for exemplars that are repeated or no index of a shape.
    """
    n = len(shapes)
    if n == 0:
        raise ValueError("shapes: wanted at least one, got none; was anything imported?")
    chosen = _checked_exemplars(exemplars, n)
    points, features = [], []
    for t in range(n):
        sample = thinned(shapes[t].points, 2 * POINTS_COMPARED)
        points.append(np.asarray(thinned(sample, POINTS_COMPARED), np.float64))
        features.append(shape_descriptor(sample))
        if t % 16 == 15 or t == n - 1:
            yield GroupState(t + 1, n, "reading shapes")
    everything = n <= ALL_PAIRS_UP_TO
    feature_distance = None if everything else cdist(np.array(features), np.array(features))
    pairs = np.stack(np.triu_indices(n, 1), axis=1) if everything else similarity_graph(feature_distance)
    if chosen is not None and not everything:
        to_chosen = np.stack([np.repeat(chosen, n), np.tile(np.arange(n), len(chosen))], axis=1)
        to_chosen = np.sort(to_chosen[to_chosen[:, 0] != to_chosen[:, 1]], axis=1)
        pairs = np.unique(np.concatenate([pairs, to_chosen]), axis=0)
    values = np.zeros(len(pairs))
    for done, block, found in _compared(points, pairs, executor):
        values[block] = found
        yield GroupState(done, len(pairs), "comparing shapes")
    yield GroupState(0, 1, "grouping")
    # One BLAS thread: sums must not depend on how many there are.
    with threadpool_limits(1):
        if everything:
            distance = _symmetric(n, pairs, values)
            plane = classical_scaling(distance, 2)
        else:
            network = coo_matrix((np.maximum(values, 1e-9), (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
            place = classical_scaling(dijkstra(network, directed=False), ISOMAP_DIMENSIONS)
            distance, plane = cdist(place, place), place[:, :2]
        if chosen is not None:
            centres, reason = chosen, f"{len(chosen)} exemplar{'s' * (len(chosen) > 1)} chosen by hand"
            nearest = distance[:, centres]
            if not everything:  # the direct comparisons are at hand: rather those than paths
                nearest = _symmetric(n, pairs, values)[:, centres]
        else:
            centres, reason = find_exemplars(distance, rng=rng)
            nearest = distance[:, centres]
    group = nearest.argmin(axis=1)
    group[centres] = np.arange(len(centres))
    order = np.lexsort((centres, -np.bincount(group, minlength=len(centres))))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    names = tuple(f"Group {g + 1}" for g in range(len(order)))
    groups = Groups(names, rank[group], centres[order], plane, distance if everything else None)
    yield GroupState(1, 1, "grouping", groups, reason)


def join_groups(groups: Groups, shapes: Any, new: Sequence[int], *, executor: Any | None = None) -> Groups:
    """The same groups and exemplars; the shapes ``new`` (indices, of no group yet) join that of the nearest exemplar.

    On the map they lie between the exemplars, nearest to their own.
    """

    def sample(t: int) -> np.ndarray:
        return np.asarray(thinned(thinned(shapes[t].points, 2 * POINTS_COMPARED), POINTS_COMPARED), np.float64)

    exemplars = [sample(int(t)) for t in groups.exemplars]
    couples = ([(sample(t), exemplar) for exemplar in exemplars] for t in new)
    group, embedding = groups.group.copy(), groups.embedding.copy()
    for t, distance in zip(new, in_order(executor, _compare_block, couples), strict=True):
        group[t] = int(distance.argmin())
        weight = np.maximum(distance, 1e-9) ** -2
        embedding[t] = weight @ groups.embedding[groups.exemplars] / weight.sum()
    return Groups(groups.names, group, groups.exemplars, embedding)


def find_exemplars(
    distance: Float[np.ndarray, "T T"], *, rng: np.random.Generator
) -> tuple[Int[np.ndarray, " G"], str]:
    """Indices of exemplars (G,), ascending, from dissimilarities (T, T), and a sentence saying how they were found.

    Affinity propagation on minus the squared distance (Frey & Dueck 2007) with the preference lowered from the median
    until there are few enough groups; where it does not converge, k-medoids.  Fewer than a dozen shapes stay together
    unless they fall apart clearly.
    """
    n = len(distance)
    fewest, most = min(max(1, -(-n // 25)), 6), min(max(2, n // 6), 24)
    if n <= 3:
        return medoids(distance, 1), "too few shapes for more than one group"
    picked = np.arange(n)
    if n > PROPAGATED_AT_MOST:
        picked = np.sort(rng.choice(n, PROPAGATED_AT_MOST, replace=False))
    among = distance[np.ix_(picked, picked)]
    centres = _propagated(-(among**2), fewest, most, seed=int(rng.integers(2**31)))
    reason = "affinity propagation"
    if centres is None:
        centres = medoids(among, int(np.clip(round(n / 12), fewest, most)))
        reason = "k-medoids, because affinity propagation did not converge to a useful number of groups"
    # An exemplar is the member nearest to all others of its group.
    group = among[:, centres].argmin(axis=1)
    group[centres] = np.arange(len(centres))
    members = [np.flatnonzero(group == g) for g in range(len(centres))]
    centres = np.array([m[among[np.ix_(m, m)].sum(axis=1).argmin()] for m in members])
    if n < 12 and len(centres) > 1 and separation(among, centres) < 0.45:
        return medoids(distance, 1), "the shapes are few and alike: one group"
    return np.sort(picked[centres]), f"{reason}: {len(centres)} group{'s' * (len(centres) > 1)}"


def separation(distance: Float[np.ndarray, "T T"], centres: Int[np.ndarray, " G"]) -> float:
    """Mean of 1 - (distance to the own exemplar) / (to the second nearest): 0 not separate, towards 1 clear."""
    nearest = np.sort(distance[:, centres], axis=1)
    others = np.setdiff1d(np.arange(len(distance)), centres)
    if len(centres) < 2 or len(others) == 0:
        return 0.0
    return float((1 - nearest[others, 0] / np.maximum(nearest[others, 1], 1e-12)).mean())


def medoids(distance: Float[np.ndarray, "T T"], k: int) -> Int[np.ndarray, " k"]:
    """``k`` medoids (ascending indices) of dissimilarities (T, T): farthest-first start, then alternation."""
    centres = [int(distance.sum(axis=1).argmin())]
    while len(centres) < k:
        centres.append(int(distance[:, centres].min(axis=1).argmax()))
    found = np.array(centres)
    for _ in range(50):
        group = distance[:, found].argmin(axis=1)
        group[found] = np.arange(k)
        members = [np.flatnonzero(group == g) for g in range(k)]
        better = np.array([m[distance[np.ix_(m, m)].sum(axis=1).argmin()] for m in members])
        if np.array_equal(better, found):
            break
        found = better
    return np.sort(found)


def _propagated(similarity: np.ndarray, fewest: int, most: int, *, seed: int) -> np.ndarray | None:
    """Exemplars by affinity propagation: the most groups within [fewest, most] as the preference falls, or None."""
    off = similarity[~np.eye(len(similarity), dtype=bool)]
    median, least = float(np.median(off)), float(off.min())
    if least >= 0:  # all shapes equal
        return medoids(-similarity, 1)
    # Here and not above: with it comes all of scipy.stats, and whoever only opens a project would wait for both.
    from sklearn.cluster import AffinityPropagation
    from sklearn.exceptions import ConvergenceWarning

    levels = [median + share * (least - median) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    for preference in levels + [least * 2**power for power in range(1, 8)]:
        model = AffinityPropagation(
            affinity="precomputed", preference=preference, damping=0.9, max_iter=1000, convergence_iter=30,
            random_state=seed,
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            warnings.filterwarnings("ignore", message="All samples have mutually equal similarities")
            centres = np.asarray(model.fit(similarity).cluster_centers_indices_, np.int64)
        converged = len(centres) > 0 and model.n_iter_ < model.max_iter and (model.labels_ >= 0).all()
        if converged and fewest <= len(centres) <= most:
            return centres
    return None


def _compared(points: list[np.ndarray], pairs: np.ndarray, executor: Any) -> Iterator[tuple[int, slice, np.ndarray]]:
    """Blocks of dissimilarities, in order: (pairs done, rows of the block, values)."""
    blocks = [slice(start, min(start + _PAIRS_A_BLOCK, len(pairs))) for start in range(0, len(pairs), _PAIRS_A_BLOCK)]
    # A worker in another process is sent the shapes of its block only.
    work = ([(points[a], points[b]) for a, b in pairs[block]] for block in blocks)
    for block, found in zip(blocks, in_order(executor, _compare_block, work), strict=True):
        yield block.stop, block, found


def _compare_block(couples: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    return np.array([dissimilarity(a, b, n_points=POINTS_COMPARED) for a, b in couples])


def shape_descriptor(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " F"]:
    """A cheap description of a whole shape (F,) from its points in normal coordinates; near means perhaps similar.

    Roots of histograms (so that Euclidean is Hellinger distance): distances of pairs of points (Osada 2002), heights,
    occupancy of a coarse grid folded at x = 0; and the extents of the box.  It screens pairs for the real comparison.
    """
    n = len(points)
    partner = (np.arange(n) * 7 + n // 3) % n
    spans = np.linalg.norm(points - points[partner], axis=1)
    pair_distances = np.histogram(spans, 24, (0, 1))[0]
    heights = np.histogram(points[:, 1], 16, (-0.5, 0.5))[0]
    cell = np.clip(((points * [2, 1, 1] + [0, 0.5, 0.5]) * 8).astype(np.int64), 0, 7)
    cell[:, 0] = np.clip((np.abs(points[:, 0]) * 8).astype(np.int64), 0, 3)
    occupied = np.bincount((cell[:, 0] * 8 + cell[:, 1]) * 8 + cell[:, 2], minlength=256)
    roots = [np.sqrt(counts / n) for counts in (pair_distances, heights, occupied)]
    return np.concatenate([*roots, 2.0 * np.ptp(points, axis=0)])


def similarity_graph(feature_distance: Float[np.ndarray, "T T"], k: int = GRAPH_NEIGHBOURS) -> Int[np.ndarray, "E 2"]:
    """Edges (E, 2), each once, first < second, to the ``k`` nearest of every shape; components are joined."""
    n = len(feature_distance)
    near = np.argsort(feature_distance, axis=1, kind="stable")[:, : k + 1]
    edges = np.stack([np.repeat(np.arange(n), near.shape[1]), near.ravel()], axis=1)
    while True:
        count, label = connected_components(
            coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(n, n)), directed=False
        )
        if count == 1:
            break
        inside, outside = np.flatnonzero(label == 0), np.flatnonzero(label != 0)
        across = feature_distance[np.ix_(inside, outside)]
        a, b = np.unravel_index(across.argmin(), across.shape)
        edges = np.concatenate([edges, [[inside[a], outside[b]]]])
    return np.unique(np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1), axis=0)


def classical_scaling(distance: Float[np.ndarray, "T T"], dimensions: int) -> Float[np.ndarray, "T d"]:
    """Places (T, dimensions) whose mutual distances are near to ``distance`` (classical multidimensional scaling)."""
    n = len(distance)
    squared = distance**2
    gram = -0.5 * (squared - squared.mean(axis=0) - squared.mean(axis=1)[:, None] + squared.mean())
    values, vectors = np.linalg.eigh(gram)
    order = np.argsort(values)[::-1][:dimensions]
    axes = vectors[:, order]
    # Either sign is right: the one whose largest entry is positive.
    axes = axes * np.where(axes[np.abs(axes).argmax(axis=0), np.arange(len(order))] < 0, -1.0, 1.0)
    place = np.zeros((n, dimensions))
    place[:, : len(order)] = axes * np.sqrt(np.maximum(values[order], 0))
    return place


def _checked_exemplars(exemplars: Sequence[int] | None, n: int) -> np.ndarray | None:
    if exemplars is None or len(exemplars) == 0:
        return None
    chosen = np.asarray(exemplars, np.int64)
    if chosen.min() < 0 or chosen.max() >= n or len(np.unique(chosen)) < len(chosen):
        raise ValueError(f"exemplars: wanted different indices from 0 to {n - 1}, got {list(map(int, exemplars))}")
    return np.sort(chosen)


def _symmetric(n: int, pairs: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of pairs as a matrix (n, n): 0 on the diagonal, infinite where a pair was not compared."""
    matrix = np.full((n, n), np.inf)
    matrix[pairs[:, 0], pairs[:, 1]] = matrix[pairs[:, 1], pairs[:, 0]] = values
    np.fill_diagonal(matrix, 0.0)
    return matrix
