"""Automatic start: parts proposed from all shapes at once, without any labels (§2, "any co-segmentation").

In place of the box templates of Kim 2013, the patches of all shapes are clustered together.  Every shape is laid into
one frame by affine alignment to its group's exemplar; there, patches that are alike in place, extent, direction and
thickness are the same part.  Then the shapes vote: a point goes to the part that like points of the *other* shapes
belong to, which mends patches that were cut badly.  It is a start only: the fit then moves the borders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from shapeforge.collection.align import Alignment, affine_align, thinned
from shapeforge.collection.groups import Groups
from shapeforge.collection.shape import Shape
from shapeforge.collection.symmetry import symmetry_plane

SURE = 0.7  # share of the probability that goes to the proposed part; the rest is spread evenly (Q(S) at the start)
FEWEST, MOST = 2, 8  # parts that are tried when no number is given
TOLERANCE = 0.01  # of the silhouette: among numbers of parts that are about as good, the largest
STARTS = 10  # of the clustering; the best is kept
SILHOUETTE_ROWS = 3000  # patches on which numbers of parts are compared
VOTING_ROUNDS, VOTES = 2, 30
VOTERS, VOTED = 12_000, 1000  # points of all shapes that vote; points of a shape that are voted on
REACH = 0.12  # diagonals that count as much as turning the normal by a right angle
OWN_VOTE, NEIGHBOURS_VOTE, PATCH_VOTE = 0.4, 0.3, 0.3

# How much a feature of unit variance counts.  Where a patch ends in height tells more than where its middle is; the six
# PCA features and the three diameters say much the same, so they share one voice.
_WEIGHTS = np.array(
    [1.0, 0.6, 0.8]  # middle: distance from the mirror plane, height, depth
    + [1.2, 1.2]  # lowest and highest height
    + [0.5] * 3  # extents
    + [1.0] * 3  # squared normal
    + [3**-0.5] * 3  # shape diameter
    + [0.4]  # average geodesic distance
    + [0.25] * 6  # local PCA
)


@dataclass(frozen=True, eq=False)
class Proposal:
    """Proposed parts: label probabilities (P, L) of every shape's points, rows summing to 1, and the parts' names.

    ``energy`` is the mean squared distance of the patches to their parts' centres, relative to that to a single centre:
    0 to 1, less is tighter.
    """

    segmentation: tuple[Float[np.ndarray, "_ _"], ...]
    part_names: tuple[str, ...]
    energy: float


def propose_parts(shapes: Any, groups: Groups, *, n_parts: int | None = None, rng: np.random.Generator) -> Proposal:
    """Parts that the ``shapes`` (a sequence, lazy or not) share, told from nothing but their surfaces.

    ``n_parts`` is the number of parts; None chooses one from 2 to 8 by the silhouette of the clustering.  Parts are
    numbered from the largest.  Raises ValueError for no shapes or for ``n_parts`` below 1.
    """
    number = len(shapes)
    if number == 0:
        raise ValueError("shapes: wanted at least one, got none; was anything imported?")
    if n_parts is not None and n_parts < 1:
        raise ValueError(f"n_parts: wanted at least 1, got {n_parts}")
    frames = common_frame(shapes, groups)
    root = shapes[int(groups.exemplars[0])]
    normal, offset, _ = symmetry_plane(root.points)
    tables, patches = [], []
    for t in range(number):
        shape = shapes[t]
        tables.append(patch_features(shape, frames[t], normal, offset))
        patches.append(shape.patch.astype(np.int64))
    owner = np.repeat(np.arange(number), [len(table) for table in tables])
    # The weight of a patch is its share of the shape's points, 0 for numbers that no point has.
    weight = np.concatenate([np.bincount(patch) / len(patch) for patch in patches])
    # One BLAS thread: sums must not depend on how many there are.
    with threadpool_limits(1):
        features = standardized(np.concatenate(tables), weight) * _WEIGHTS
        if n_parts is None:
            n_parts = choose_number(features, weight, rng=rng)
        part, energy = cluster_patches(features, weight, n_parts, rng=rng)
    parts = [part[owner == t][patches[t]] for t in range(number)]
    for _ in range(VOTING_ROUNDS if number > 1 else 0):
        parts = vote(shapes, frames, normal, offset, parts, n_parts)
    segmentation = tuple(SURE * np.eye(n_parts)[of_point] + (1 - SURE) / n_parts for of_point in parts)
    return Proposal(segmentation, tuple(f"part {i + 1}" for i in range(n_parts)), energy)


def common_frame(shapes: Any, groups: Groups) -> list[Alignment]:
    """The map of every shape into the first (largest) group's exemplar: through the exemplar of its own group.

    Shapes of no group go straight there.
    """
    root = int(groups.exemplars[0])
    target = shapes[root].points
    same = Alignment(np.eye(3), np.zeros(3), 0.0)
    onwards = [same] + [affine_align(shapes[int(e)].points, target) for e in groups.exemplars[1:]]
    exemplar_points = [shapes[int(e)].points for e in groups.exemplars]
    frames = []
    for t in range(len(shapes)):
        g = int(groups.group[t])
        if g < 0:
            frames.append(affine_align(shapes[t].points, target))
        elif t == groups.exemplars[g]:
            frames.append(onwards[g])
        else:
            frames.append(_then(affine_align(shapes[t].points, exemplar_points[g]), onwards[g]))
    return frames


def _then(first: Alignment, second: Alignment) -> Alignment:
    return Alignment(
        second.matrix @ first.matrix, second(first.offset[None])[0], first.residual + second.residual, first.start
    )


def patch_features(
    shape: Shape, frame: Alignment, normal: Float[np.ndarray, " 3"], offset: float
) -> Float[np.ndarray, "n F"]:
    """What tells patches apart (n_patches, 21), in the common frame whose mirror plane is ``normal · x = offset``.

    Distance from the plane, height and depth of the middle; lowest and highest height; extents; mean squared normal;
    mean descriptors.  Folding at the mirror plane makes left and right one part.
    """
    places, normals = _placed(shape, frame, normal, offset)
    patch = shape.patch
    count = np.maximum(np.bincount(patch), 1)[:, None]
    folded = np.concatenate([np.abs(places[:, :1]), places[:, 1:], normals**2, shape.descriptors], axis=1)
    means = np.stack([np.bincount(patch, column) for column in folded.T], axis=1) / count
    low, high = np.zeros((len(count), 3)), np.zeros((len(count), 3))
    for p, members in enumerate(_members(patch)):
        if len(members):  # not the very ends: one stray point would move them
            low[p], high[p] = np.quantile(places[members], [0.05, 0.95], axis=0)
    return np.concatenate([means[:, :3], low[:, 1:2], high[:, 1:2], high - low, means[:, 3:]], axis=1)


def _placed(shape: Shape, frame: Alignment, normal: np.ndarray, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) and unit normals (P, 3) in the common frame: distance from the mirror plane, height, depth."""
    normals = shape.normals @ np.linalg.inv(frame.matrix)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    sideways = np.cross(normal, [0.0, 1.0, 0.0])
    axes = np.stack([normal, [0.0, 1.0, 0.0], sideways / np.linalg.norm(sideways)])
    return frame(shape.points) @ axes.T - [offset, 0, 0], normals @ axes.T


def vote(
    shapes: Any, frames: list[Alignment], normal: np.ndarray, offset: float, parts: list[np.ndarray], n_parts: int
) -> list[np.ndarray]:
    """New part of every point of every shape, from the parts (P,) of like points of the other shapes.

    Alike in place (folded at the mirror plane), direction and thickness.  A point's vote is averaged with those of its
    neighbours and of its patch, so borders stay short.
    """
    number = len(shapes)
    share = max(2, VOTERS // number)
    voters = [thinned(_likeness(shapes[t], frames[t], normal, offset), share) for t in range(number)]
    tree = cKDTree(np.concatenate(voters))
    said = np.concatenate([thinned(part, share) for part in parts])
    of_shape = np.repeat(np.arange(number), [len(rows) for rows in voters])
    # The own points are found, too, but have no vote: enough others must be among the nearest.
    k = min(VOTES + VOTES // max(number - 1, 1), len(said))
    voted = []
    for t in range(number):
        shape = shapes[t]
        rows = _likeness(shape, frames[t], normal, offset)
        asked = thinned(rows, VOTED)
        distance, near = tree.query(asked, k=k)
        width = np.maximum(distance[:, : k // 2 + 1].mean(axis=1, keepdims=True), 1e-9)
        weight = np.exp(-0.5 * (distance / width) ** 2) * (of_shape[near] != t)
        votes = np.stack([(weight * (said[near] == part)).sum(axis=1) for part in range(n_parts)], axis=1) + 1e-9
        votes /= votes.sum(axis=1, keepdims=True)
        own = votes[cKDTree(asked).query(rows)[1]]
        present = shape.neighbours >= 0
        around = (own[shape.neighbours] * present[:, :, None]).sum(axis=1)
        around = around / np.maximum(present.sum(axis=1, keepdims=True), 1)
        patch = shape.patch
        sums = np.stack([np.bincount(patch, column) for column in own.T], axis=1)
        of_patch = (sums / np.maximum(np.bincount(patch), 1)[:, None])[patch]
        voted.append((OWN_VOTE * own + NEIGHBOURS_VOTE * around + PATCH_VOTE * of_patch).argmax(axis=1))
    return voted


def _likeness(shape: Shape, frame: Alignment, normal: np.ndarray, offset: float) -> np.ndarray:
    """Rows (P, 8), near for like points: place folded at the mirror plane, squared normal, thickness, geodesics."""
    places, normals = _placed(shape, frame, normal, offset)
    places = np.concatenate([np.abs(places[:, :1]), places[:, 1:]], axis=1)
    described = shape.descriptors[:, [0, 3]] * [2, 1]
    return np.concatenate([places / REACH, normals**2, described], axis=1)


def standardized(features: Float[np.ndarray, "n F"], weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n F"]:
    """Features (n, F) with weighted mean 0 and variance 1; a constant column becomes 0."""
    mean = np.average(features, axis=0, weights=weight)
    spread = np.sqrt(np.average((features - mean) ** 2, axis=0, weights=weight))
    return np.divide(features - mean, spread, out=np.zeros_like(features), where=spread > 1e-9)


def cluster_patches(
    features: Float[np.ndarray, "n F"], weight: Float[np.ndarray, " n"], n_parts: int, *, rng: np.random.Generator
) -> tuple[Int[np.ndarray, " n"], float]:
    """Part of every patch (n,), numbered by falling weight, and the relative energy (see ``Proposal``).

    Weighted k-means.  With fewer patches than parts the last parts stay empty.
    """
    used = weight > 0
    k = min(n_parts, len(np.unique(features[used], axis=0)))
    model = KMeans(k, n_init=STARTS, random_state=int(rng.integers(2**31)))
    model.fit(features[used], sample_weight=weight[used])
    rank = np.empty(k, np.int64)
    rank[np.argsort(-np.bincount(model.labels_, weight[used], k), kind="stable")] = np.arange(k)
    part = np.zeros(len(features), np.int64)
    part[used] = rank[model.labels_]
    centre = np.average(features, axis=0, weights=weight)
    whole = float(weight @ ((features - centre) ** 2).sum(axis=1))
    return part, float(model.inertia_) / max(whole, 1e-12)


def choose_number(
    features: Float[np.ndarray, "n F"], weight: Float[np.ndarray, " n"], *, rng: np.random.Generator
) -> int:
    """The number of parts from 2 to 8 with the best weighted silhouette, the largest among about equals."""
    used = np.flatnonzero(weight > 0)
    if len(used) > SILHOUETTE_ROWS:
        used = np.sort(rng.choice(used, SILHOUETTE_ROWS, replace=False))
    features, weight = features[used], weight[used]
    tried = range(FEWEST, min(MOST, len(np.unique(features, axis=0)) - 1) + 1)
    if len(tried) == 0:
        return 1
    distance = cdist(features, features)
    scores = [silhouette(distance, cluster_patches(features, weight, k, rng=rng)[0], weight) for k in tried]
    return max(k for k, score in zip(tried, scores, strict=True) if score >= max(scores) - TOLERANCE)


def silhouette(
    distance: Float[np.ndarray, "n n"], part: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"]
) -> float:
    """Weighted mean silhouette (Rousseeuw 1987) of clusters, from distances (n, n): -1 to 1, 0 for a single cluster.

    The rows' weights count in the mean distance to a cluster, too.
    """
    masks = np.eye(part.max() + 1)[part]
    if masks.shape[1] < 2:
        return 0.0
    masses = weight @ masks
    sums = (distance * weight) @ masks
    rows = np.arange(len(part))
    # A patch does not count among its own neighbours.
    inside = sums[rows, part] / np.maximum(masses[part] - weight, 1e-12)
    alone = masses[part] - weight < 1e-12
    between = sums / np.maximum(masses, 1e-12)
    between[:, masses <= 0] = np.inf
    between[rows, part] = np.inf
    other = between.min(axis=1)
    value = np.where(alone, 0.0, (other - inside) / np.maximum(np.maximum(inside, other), 1e-12))
    return float(np.average(value, weights=weight))


def _members(patch: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(patch, kind="stable")
    return np.split(order, np.cumsum(np.bincount(patch))[:-1])
