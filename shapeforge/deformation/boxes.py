"""Automatic start: parts proposed from all shapes at once, without any labels (§2, "any co-segmentation").

The surfaces fall into pieces (``pieces``), and two kinds of co-segmentation look for the parts they belong to: part
boxes with an offset on every shape, after Kim 2013 (``box_model``), and k-means on the looks of pieces and patches.
No figure was found that tells which of them is right on a new family (the fitted model's energy does not), but where
many fits agree they are mostly right, so they vote.  Then the shapes vote on every point (``voting``), which mends
pieces that were cut badly.  It is a start only: the fit moves the borders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from shapeforge.collection.align import Alignment
from shapeforge.collection.groups import Groups
from shapeforge.collection.symmetry import symmetry_plane
from shapeforge.deformation.box_model import agreed_parts, split_most_distinct
from shapeforge.deformation.pieces import (
    box_frame,
    common_frame,
    find_pieces,
    piece_features,
    piece_looks,
    point_components,
)
from shapeforge.deformation.voting import exposure, vote

SURE = 0.7  # share of the probability that goes to the proposed part; the rest is spread evenly (Q(S) at the start)
FEWEST, MOST = 2, 8  # parts that are tried when no number is given
PART_COST = 0.006  # of the silhouette, for every part: among numbers that are about as good, rather the smaller
TWO_LEAD = 0.08  # of the silhouette: two parts only if so much clearer; merging two is one step, missing one costs more
STARTS = 10  # of the clustering; the best is kept
SILHOUETTE_ROWS = 3000  # patches on which numbers of parts are compared
TAUGHT = 60  # shapes that the boxes are learnt from; the pieces of the others follow like pieces of these
ALIKE = 7  # pieces that a piece of another shape follows
PRESENT = 0.01  # of its points: a shape with less of a part does not have it
COMMON = 0.2  # of the shapes: a part that fewer have makes no exemplar (it may be one odd back)

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
_SAME_IN_BOTH = [3**-0.5] * 3 + [0.4] + [0.25] * 6  # shape diameter, average geodesic distance, local PCA
# Boxes look at how level a piece is, not at where its sides face, and besides at what it is by itself: how many there
# are of its kind, how long, how flat, how open above, and what it sees below.  Height is half said by the ends.
_BOX_WEIGHTS = np.array([1, 0.5, 1, 1, 1, 1, 0, 1, 0, 1.4, 0, *_SAME_IN_BOTH])
_LOOKS_WEIGHTS = np.array([1, 0.5, 0.4, 1, 0.6])
# What is one part but for a last split differs by where it lies and how large it is, not by how many there are of it.
SPLIT_WEIGHTS = np.array([1.0] * 11 + _SAME_IN_BOTH)


@dataclass(frozen=True, eq=False)
class Proposal:
    """Proposed parts: label probabilities (P, L) of every shape's points, rows summing to 1, and the parts' names.

    ``energy`` is the mean squared distance of the pieces to their parts' centres, relative to that to a single centre:
    0 to 1, less is tighter.  ``exemplars`` (G,) stands for each group: one of its shapes with the most parts.
    """

    segmentation: tuple[Float[np.ndarray, "_ _"], ...]
    part_names: tuple[str, ...]
    energy: float
    exemplars: Int[np.ndarray, " G"]

    def shapes_with(self) -> Int[np.ndarray, " L"]:
        """How many shapes have each part (L,): where it is the likeliest one of a hundredth of the points."""
        return _present([one.argmax(axis=1) for one in self.segmentation], len(self.part_names)).sum(axis=0)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of all shapes: ``of_point[t]`` (P,), ``whole[t]`` as in ``find_pieces``, and per piece its shape, its
    share of the shape's points and, in every frame, its features."""

    of_point: list[np.ndarray]
    whole: list[np.ndarray]
    owner: np.ndarray
    weight: np.ndarray
    views: list[np.ndarray]


def propose_parts(shapes: Any, groups: Groups, *, n_parts: int | None = None, rng: np.random.Generator) -> Proposal:
    """Parts that the ``shapes`` (a sequence, lazy or not) share, told from nothing but their surfaces.

    ``n_parts`` is the number of parts; None chooses one from 2 to 8 by the silhouette of a clustering of the patches,
    but no more than there are pieces.  More parts than are clearest are split off one by one, the most distinct first;
    what cannot be split leaves the last parts empty.  Parts are numbered from the largest.

    Raises ValueError for no shapes or for ``n_parts`` below 1.
    """
    if len(shapes) == 0:
        raise ValueError("shapes: wanted at least one, got none; was anything imported?")
    if n_parts is not None and n_parts < 1:
        raise ValueError(f"n_parts: wanted at least 1, got {n_parts}")
    frames = common_frame(shapes, groups)
    root = shapes[int(groups.exemplars[0])].points
    normal, offset, _ = symmetry_plane(root)
    patches, pieces = gathered(shapes, groups, frames, normal, offset)
    boxes, traits, components, looks = _seen(shapes, root, pieces)
    # One BLAS thread: sums must not depend on how many there are.
    with threadpool_limits(1):
        features = standardized(patches.views[0], patches.weight) * _WEIGHTS
        number = choose_number(features, patches.weight, rng=rng)
        part, energy, n_parts = _parts_of_pieces(pieces, looks, patches, features, number, n_parts, rng)
    parts = [part[pieces.owner == t][of_point] for t, of_point in enumerate(pieces.of_point)]
    if len(shapes) > 1:
        parts = vote(
            shapes, (frames, boxes), traits, normal, offset, parts, n_parts, pieces.of_point, pieces.whole,
            components,
        )  # fmt: skip
    segmentation = tuple(SURE * np.eye(n_parts)[of_point] + (1 - SURE) / n_parts for of_point in parts)
    exemplars = richest_exemplars(groups, parts, n_parts)
    return Proposal(segmentation, tuple(f"part {i + 1}" for i in range(n_parts)), energy, exemplars)


def gathered(
    shapes: Any, groups: Groups, frames: list[Alignment], normal: np.ndarray, offset: float
) -> tuple[_Pieces, _Pieces]:
    """Patches (in the affine frame only) and pieces of all shapes (in the affine, the box's and the shape's own)."""
    root = shapes[int(groups.exemplars[0])].points
    own = Alignment(np.eye(3), np.zeros(3), 0.0)
    kinds: list[list[np.ndarray]] = [[], []]
    tables: list[list[np.ndarray]] = [[], [], [], []]
    whole: list[np.ndarray] = []
    for t in range(len(shapes)):
        shape = shapes[t]
        piece, is_whole = find_pieces(shape)
        kinds[0].append(shape.patch.astype(np.int64))
        kinds[1].append(piece)
        whole.append(is_whole)
        tables[0].append(piece_features(shape, kinds[0][t], frames[t], normal, offset))
        for table, frame in zip(tables[1:], (frames[t], box_frame(shape.points, root), own), strict=True):
            table.append(piece_features(shape, kinds[1][t], frame, normal, offset))
    gathered = []
    for of_point, views in zip(kinds, (tables[:1], tables[1:]), strict=True):
        owner = np.repeat(np.arange(len(shapes)), [len(table) for table in views[0]])
        # The weight of a piece is its share of the shape's points, 0 for numbers that no point has.
        weight = np.concatenate([np.bincount(piece) / len(piece) for piece in of_point])
        gathered.append(_Pieces(of_point, whole, owner, weight, [np.concatenate(table) for table in views]))
    return gathered[0], gathered[1]


def _seen(
    shapes: Any, root: np.ndarray, pieces: _Pieces
) -> tuple[list[Alignment], list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Of every shape the frame of its box, its points' traits (see ``vote``) and their components; and the looks of all
    pieces (n, 5)."""
    boxes, traits, components, looks = [], [], [], []
    for t in range(len(shapes)):
        shape = shapes[t]  # a lazy sequence reads it from disk
        boxes.append(box_frame(shape.points, root))
        components.append(point_components(shape))
        seen = exposure(shape)
        looks.append(piece_looks(shape, pieces.of_point[t], seen))
        traits.append(np.concatenate([seen, looks[t][pieces.of_point[t], 1:2].astype(np.float32)], axis=1))
    return boxes, traits, components, np.concatenate(looks)


def _parts_of_pieces(
    pieces: _Pieces, looks: np.ndarray, patches: _Pieces, features: np.ndarray, number: int, n_parts: int | None,
    rng: np.random.Generator,
) -> tuple[np.ndarray, float, int]:  # fmt: skip
    """Part (n,) of every piece, numbered by falling weight, the relative energy (see ``Proposal``) and the number of
    parts: ``n_parts``, else ``number``, which the ``features`` of the patches told, or one for each piece if these are
    fewer."""
    owner, weight = pieces.owner, pieces.weight
    plain = [standardized(view, weight) for view in pieces.views]
    looks = standardized(looks, weight) * _LOOKS_WEIGHTS
    views = [np.concatenate([view * _BOX_WEIGHTS, looks], axis=1) for view in plain]
    every, apart = (
        np.concatenate(rows, axis=1) / np.sqrt(len(rows)) for rows in (views, [view * SPLIT_WEIGHTS for view in plain])
    )
    n_shapes = int(owner.max()) + 1
    taught = np.isin(owner, np.unique(np.linspace(0, n_shapes - 1, min(n_shapes, TAUGHT)).round().astype(np.int64)))
    # Two boxes of six sides each have more kinds of patches than pieces that could be parts.
    number = min(number, len(np.unique(every[taught], axis=0)))
    n_parts = number if n_parts is None else n_parts
    first = min(number, n_parts)
    of_patch = cluster_patches(features, patches.weight, first, rng=rng)[0]
    others = [
        cluster_patches(plain[0] * _WEIGHTS, weight, first, rng=rng)[0],
        _from_patches(pieces, patches, of_patch, first),
    ]
    shape_of = np.unique(owner[taught], return_inverse=True)[1].reshape(-1)
    part = agreed_parts(
        [view[taught] for view in (*views, every)], shape_of, weight[taught], first, rng=rng,
        others=[other[taught] for other in others],
    )  # fmt: skip
    for _ in range(n_parts - first):
        part = split_most_distinct(apart[taught], shape_of, weight[taught], part, rng=rng)
    if not taught.all():
        near = cKDTree(every[taught]).query(every[~taught], k=min(ALIKE, len(part)))[1].reshape((~taught).sum(), -1)
        votes = np.stack([(part[near] == one).sum(axis=1) for one in range(n_parts)], axis=1)
        told = np.empty(len(owner), np.int64)
        told[taught], told[~taught] = part, votes.argmax(axis=1)
        part = told
    mass = np.bincount(part, weight, n_parts)
    rank = np.empty(n_parts, np.int64)
    rank[np.argsort(-mass, kind="stable")] = np.arange(n_parts)
    part = rank[part]
    centres = np.stack([np.bincount(part, weight * column, n_parts) for column in every.T], axis=1)
    centres /= np.maximum(np.bincount(part, weight, n_parts), 1e-12)[:, None]
    whole = float(weight @ ((every - np.average(every, axis=0, weights=weight)) ** 2).sum(axis=1))
    return part, float(weight @ ((every - centres[part]) ** 2).sum(axis=1)) / max(whole, 1e-12), n_parts


def _from_patches(pieces: _Pieces, patches: _Pieces, of_patch: np.ndarray, n_parts: int) -> np.ndarray:
    """The part of every piece that most of its points have by their patches."""
    found = []
    for t, of_point in enumerate(pieces.of_point):
        part = of_patch[patches.owner == t][patches.of_point[t]]
        table = np.zeros((int(of_point.max()) + 1, n_parts))
        np.add.at(table, (of_point, part), 1.0)
        found.append(table.argmax(axis=1))
    return np.concatenate(found)


def richest_exemplars(groups: Groups, parts: list[np.ndarray], n_parts: int) -> Int[np.ndarray, " G"]:
    """An exemplar (G,) for every group among its shapes with the most parts (§2): its own if that is one of them, else
    the one nearest to the whole group.  Only parts that are common in the collection count."""
    has = _present(parts, n_parts)
    has = has[:, has.mean(axis=0) >= COMMON]
    distance = groups.dissimilarity if groups.dissimilarity is not None else cdist(groups.embedding, groups.embedding)
    exemplars = groups.exemplars.copy()
    for g in range(len(groups)):
        members = groups.members(g)
        count = has[members].sum(axis=1)
        richest = members[count == count.max()]
        if exemplars[g] not in richest:
            exemplars[g] = richest[distance[np.ix_(richest, members)].mean(axis=1).argmin()]
    return exemplars


def _present(parts: list[np.ndarray], n_parts: int) -> Bool[np.ndarray, "T L"]:
    return np.stack([np.bincount(part, minlength=n_parts) >= PRESENT * len(part) for part in parts])


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
    """The number of parts from 2 to 8 with the best weighted silhouette, less a small cost of every part.

    Two have to lead by ``TWO_LEAD``: one half against the other is nearly always clear, and seldom all there is.
    """
    used = np.flatnonzero(weight > 0)
    if len(used) > SILHOUETTE_ROWS:
        used = np.sort(rng.choice(used, SILHOUETTE_ROWS, replace=False))
    features, weight = features[used], weight[used]
    tried = range(FEWEST, min(MOST, len(np.unique(features, axis=0)) - 1) + 1)
    if len(tried) == 0:
        return 1
    distance = cdist(features, features)
    scores = [silhouette(distance, cluster_patches(features, weight, k, rng=rng)[0], weight) for k in tried]
    number = np.array(tried)
    worth = np.array(scores) - PART_COST * number - TWO_LEAD * (number == FEWEST)
    return tried[int(worth.argmax())]


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
