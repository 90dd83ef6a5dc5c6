"""Weakly convex patches of the surface: the bounds of the smoothness neighbourhood N(p) (§4)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from shapeforge.collection import _kernels as kernels
from shapeforge.collection.points import nearest_neighbours

GRAPH_NEIGHBOURS = 10
SCALE = 2.0  # k of Felzenszwalb and Huttenlocher: larger makes larger patches
SMALLEST = 0.008  # of the points
DIAMETER_WEIGHT = 0.35


def find_patches(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    descriptors: Float[np.ndarray, "P 10"],
    neighbours: Int[np.ndarray, "P n"] | None = None,
) -> Int[np.ndarray, " P"]:
    """Patch number (P,) of each point, from 0; typically 9 to 26 patches.

    A graph segmentation (Felzenszwalb and Huttenlocher 2004) in place of the paper's lines of sight (Asafi 2013): an
    edge is heavy where the surface folds inward (``normals`` point outward) or its thickness changes.
    """
    if neighbours is None:
        neighbours = nearest_neighbours(points, GRAPH_NEIGHBOURS)
    heads = neighbours[:, :GRAPH_NEIGHBOURS].reshape(-1).astype(np.int64)
    tails = np.repeat(np.arange(len(points)), min(GRAPH_NEIGHBOURS, neighbours.shape[1]))
    once = tails < heads
    extra = ~once & ~(neighbours[heads, :GRAPH_NEIGHBOURS] == tails[:, None]).any(axis=1)  # not found from the other end
    tails, heads = tails[once | extra], heads[once | extra]
    along = points[heads] - points[tails]
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
    # positive where the normals lean towards each other: a concave fold
    fold = ((normals[tails] - normals[heads]) * along).sum(axis=1) / length
    thickness = descriptors[:, 0].astype(np.float64)
    step = np.abs(thickness[heads] - thickness[tails])
    weight = np.maximum(fold, 0.0) + 0.1 * np.maximum(-fold, 0.0) + DIAMETER_WEIGHT * step
    weight = weight + 0.05 * length / np.median(length)
    order = np.lexsort((heads, tails, weight))
    return kernels.merge_regions(
        len(points), tails, heads, weight, order, SCALE, max(1, int(SMALLEST * len(points)))
    )


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
