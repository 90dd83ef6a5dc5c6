"""Weakly convex patches of the surface: the bounds of the smoothness neighbourhood N(p) (§4)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection import _kernels as kernels
from shapeforge.collection.points import nearest_neighbours, neighbour_pairs

GRAPH_NEIGHBOURS = 10
SCALE = 0.5  # k of Felzenszwalb and Huttenlocher: larger makes larger patches
SMALLEST = 0.012  # of the points
DIAMETER_WEIGHT = 1.0  # of a step in log shape diameter against a fold, which is at most 2
CONVEX_WEIGHT = 0.1  # an outward fold separates a little: two patches of one convex part do no harm
LENGTH_WEIGHT = 0.05  # where nothing else tells, near points join first


def find_patches(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    descriptors: Float[np.ndarray, "P 10"],
    neighbours: Int[np.ndarray, "P n"] | None = None,
) -> Int[np.ndarray, " P"]:
    """Patch number (P,) of each point, from 0; typically 10 to 30 patches.

    A graph segmentation (Felzenszwalb and Huttenlocher 2004) in place of the paper's lines of sight (Asafi 2013): an
    edge is heavy where the surface folds inward (``normals`` point outward) or its thickness changes.
    """
    if neighbours is None:
        neighbours = nearest_neighbours(points, GRAPH_NEIGHBOURS)
    tails, heads = neighbour_pairs(neighbours[:, :GRAPH_NEIGHBOURS])
    along = points[heads] - points[tails]
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
    # positive where the normals lean towards each other: a concave fold
    fold = ((normals[tails] - normals[heads]) * along).sum(axis=1) / length
    # column 0 is log2(1 + s); .1 keeps the noise of the thinnest places from counting as steps
    log_diameter = np.log(np.exp2(descriptors[:, 0].astype(np.float64)) - 0.9)
    weight = np.where(fold > 0, fold, -CONVEX_WEIGHT * fold)
    weight += DIAMETER_WEIGHT * np.abs(log_diameter[heads] - log_diameter[tails])
    weight += LENGTH_WEIGHT * length / np.median(length) if len(length) else 0.0
    order = np.lexsort((heads, tails, weight))
    return kernels.merge_regions(len(points), tails, heads, weight, order, SCALE, int(SMALLEST * len(points)))


def patch_neighbours(
    points: Float[np.ndarray, "P 3"], patch: Int[np.ndarray, " P"], k: int = 20
) -> Int[np.ndarray, "P k"]:
    """The ``k`` nearest points (P, k) within the own patch, nearest first, -1 where the patch has fewer."""
    out = np.full((len(points), k), -1, np.int32)
    order = np.argsort(patch, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(patch[order])) + 1):
        found = nearest_neighbours(points[members], k)
        out[members, : found.shape[1]] = members[found]
    return out
