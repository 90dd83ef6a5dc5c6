"""Where the pictures of the map lie: near means similar, no two overlap, and the groups keep apart.  Pure numpy.

Lengths are in tiles: a picture is about one tile wide and high.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, cKDTree

SPACING = 1.0
HULL_MARGIN = 0.72
GAP = 0.6
"""Free space between the hulls of two groups."""
TURNS = 6
PAIRS_TRIED = 60
"""Pairs of groups kept apart in all turns together: many groups are turned less often, not at all above eleven."""


def place_by_likeness(
    embedding: Float[np.ndarray, "T 2"], group: Int[np.ndarray, " T"], *, aspect: float = 1.45
) -> Float[np.ndarray, "T 2"]:
    """Centres of the pictures (T, 2), x right and y down, about the origin.

    Shapes of one group stay together, placed as in ``embedding`` and pushed apart to one tile; groups lie as their
    means do, and are moved apart as convex shapes.  ``aspect`` is the wanted width to height.  Shapes left out
    (group -1) stand in rows below.
    """
    place = np.zeros((len(embedding), 2))
    groups = [g for g in np.unique(group) if g >= 0]
    members = [np.flatnonzero(group == g) for g in groups]
    local = [_spread(embedding[m]) for m in members]
    if groups:
        kept = np.concatenate(members)
        means = np.stack([embedding[m].mean(axis=0) for m in members])
        best = np.inf
        # Likeness knows no left and right: of several turns, the one that fills the view best.
        pairs = len(groups) * (len(groups) - 1) // 2
        turns = int(np.clip(PAIRS_TRIED // max(pairs, 1), 1, TURNS))
        for angle in np.linspace(0, np.pi, turns, endpoint=False):
            turn = np.array([[np.cos(angle), np.sin(angle)], [np.sin(angle), -np.cos(angle)]])
            turned = [points @ turn for points in local]
            centres = _keep_apart(means @ turn, turned, aspect)
            tried = np.concatenate([points + centre for points, centre in zip(turned, centres, strict=True)])
            low, high = tried.min(axis=0) - HULL_MARGIN, tried.max(axis=0) + HULL_MARGIN
            size = max(high[0] - low[0], aspect * (high[1] - low[1]))
            if size < best:
                best = size
                place[kept] = tried - (low + high) / 2
    out = np.flatnonzero(group < 0)
    if len(out):
        top = place[group >= 0, 1].max(initial=-1.0) + 2.2 * HULL_MARGIN + GAP
        columns = max(int(np.ceil(np.sqrt(len(out) * 2 * aspect))), 1)
        index = np.arange(len(out))
        place[out, 0] = (index % columns - (min(columns, len(out)) - 1) / 2) * SPACING
        place[out, 1] = top + index // columns * SPACING
    return place


def _spread(points: np.ndarray) -> np.ndarray:
    """Points (m, 2) about their mean, scaled so that neighbours are a tile apart, then pushed apart until all are."""
    local = np.asarray(points, float) - points.mean(axis=0)
    m = len(local)
    if m == 1:
        return np.zeros((1, 2))
    index = np.arange(m)
    angle = index * 2.399963  # the golden angle: points that coincide leave in different directions
    local = local + 1e-6 * np.stack([np.cos(angle), np.sin(angle)], axis=1) * (1 + index[:, None])
    nearest = cKDTree(local).query(local, k=2)[0][:, 1]
    local *= SPACING * 1.1 / max(float(np.median(nearest)), 1e-9)
    # An outlier must not blow the group up: radii are bent to what the number of shapes needs.
    limit = SPACING * (0.54 * np.sqrt(m) + 0.35)
    radius = np.linalg.norm(local, axis=1, keepdims=True)
    local *= limit * np.tanh(radius / limit) / np.maximum(radius, 1e-9)
    for _ in range(400):
        pairs = cKDTree(local).query_pairs(SPACING * 0.999, output_type="ndarray")
        if not len(pairs):
            break
        away = local[pairs[:, 0]] - local[pairs[:, 1]]
        length = np.linalg.norm(away, axis=1, keepdims=True)
        away = np.where(length > 1e-9, away / np.maximum(length, 1e-9), (1.0, 0.0))
        push = 0.5 * (SPACING - length) * away
        np.add.at(local, pairs[:, 0], push)
        np.add.at(local, pairs[:, 1], -push)
    return local - local.mean(axis=0)


def hull(points: Float[np.ndarray, "m 2"], margin: float = HULL_MARGIN, corners: int = 24) -> Float[np.ndarray, "h 2"]:
    """Corners (h, 2), in order, of the convex hull of discs of radius ``margin`` about the points: a rounded hull."""
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    ring = margin * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around = (np.asarray(points, float)[:, None, :] + ring).reshape(-1, 2)
    return around[ConvexHull(around).vertices]


def _keep_apart(means: np.ndarray, local: list[np.ndarray], aspect: float) -> np.ndarray:
    """Centres (G, 2) of the groups: drawn together towards the middle, and apart wherever their hulls touch."""
    hulls = [hull(points, HULL_MARGIN + GAP / 2, 10) for points in local]
    size = sum(float(np.ptp(h[:, 0]) * np.ptp(h[:, 1])) for h in hulls)
    spread = means - means.mean(axis=0)
    reach = float(np.abs(spread).max())
    index = np.arange(len(means))
    jitter = 1e-3 * np.stack([np.cos(2.4 * index), np.sin(2.4 * index)], axis=1)
    centres = spread * (np.sqrt(size) / max(reach, 1e-9)) + jitter
    pull = np.array([0.92, 0.92**aspect])
    for step in range(70):
        if step < 45:
            centres *= pull
        moved = False
        for _ in range(6):
            moved = False
            for a in range(len(hulls)):
                for b in range(a + 1, len(hulls)):
                    apart = _overlap(hulls[a] + centres[a], hulls[b] + centres[b])
                    if apart is not None:
                        # The smaller group gives way more.
                        share = len(local[a]) / (len(local[a]) + len(local[b]))
                        centres[a] -= (1 - share) * apart
                        centres[b] += share * apart
                        moved = True
            if not moved:
                break
        if step >= 45 and not moved:
            break
    return centres


def _overlap(first: np.ndarray, second: np.ndarray) -> np.ndarray | None:
    """The shortest move (2,) of ``second`` that separates two convex polygons; None when they are apart."""
    if (first.max(axis=0) <= second.min(axis=0)).any() or (second.max(axis=0) <= first.min(axis=0)).any():
        return None
    edges = np.concatenate([np.roll(first, -1, axis=0) - first, np.roll(second, -1, axis=0) - second])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals = np.concatenate([normals, -normals])
    depth = (first @ normals.T).max(axis=0) - (second @ normals.T).min(axis=0)
    best = int(depth.argmin())
    return None if depth[best] <= 1e-9 else (depth[best] + 1e-6) * normals[best]


def place_in_rows(
    group: Int[np.ndarray, " T"], columns: int, *, header: float = 0.38
) -> tuple[Float[np.ndarray, "T 2"], list[tuple[int, float]]]:
    """Centres (T, 2) in rows of ``columns`` tiles, group by group, and (group, y) of each group's heading.

    The first tile's centre is at (0.5, header + 0.5); shapes left out come last, as group -1.
    """
    place = np.zeros((len(group), 2))
    headings: list[tuple[int, float]] = []
    y = 0.0
    for g in [*(g for g in np.unique(group) if g >= 0), *([-1] if (group < 0).any() else [])]:
        members = np.flatnonzero(group == g)
        headings.append((int(g), y))
        y += header
        index = np.arange(len(members))
        place[members] = np.stack([index % columns + 0.5, y + index // columns + 0.5], axis=1)
        y += -(-len(members) // columns) + 0.25
    return place, headings
