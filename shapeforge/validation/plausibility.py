"""Is a set of new shapes like the real ones?  Minimum matching distance, coverage, 1-NN two-sample accuracy (Chamfer).

MMD alone hides clumping: a generator that repeats one good shape scores well.  Coverage and 1-NNA tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import closest_points
from shapeforge.synthesis.measures import open_edges
from shapeforge.synthesis.surfaces import sides_of, weld


@dataclass(frozen=True)
class Plausibility:
    """``mmd``: mean distance from a real shape to the nearest new one (units of the clouds; small is good).

    ``coverage``: share of real shapes that are the nearest of some new one (1 is best; sets from one source reach
    about .6).  ``one_nn``: leave-one-out accuracy of telling real from new by the nearest neighbour (.5 is best).
    """

    mmd: float
    coverage: float
    one_nn: float
    n_real: int
    n_new: int


def chamfer(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"]) -> float:
    """Mean distance to the nearest point of the other cloud, averaged over both ways (units of the clouds)."""
    return 0.5 * float(cKDTree(b).query(a)[0].mean() + cKDTree(a).query(b)[0].mean())


def chamfer_table(rows: Sequence[np.ndarray], columns: Sequence[np.ndarray] | None = None) -> Float[np.ndarray, "n m"]:
    """Chamfer distances of every cloud of ``rows`` to every one of ``columns`` (to each other if None)."""
    trees = [cKDTree(cloud) for cloud in rows]
    others = trees if columns is None else [cKDTree(cloud) for cloud in columns]
    table = np.zeros((len(trees), len(others)))
    for i, tree in enumerate(trees):
        for j in range(i + 1 if columns is None else 0, len(others)):
            table[i, j] = 0.5 * (others[j].query(tree.data)[0].mean() + tree.query(others[j].data)[0].mean())
    return table + table.T if columns is None else table


def plausibility(real: Sequence[np.ndarray], new: Sequence[np.ndarray]) -> Plausibility:
    """Compare clouds (any number of points each, same units and frame) of real and new shapes; at least 2 of each."""
    if len(real) < 2 or len(new) < 2:
        raise ValueError(f"real, new: wanted at least 2 shapes of each, got {len(real)} and {len(new)}.")
    return plausibility_of_table(chamfer_table([*real, *new]), len(real))


def plausibility_of_table(table: Float[np.ndarray, "n n"], n_real: int) -> Plausibility:
    """The same from a table of distances of all shapes, the real ones first."""
    between = table[:n_real, n_real:]
    alone = table + np.diag(np.full(len(table), np.inf))
    is_real = np.arange(len(table)) < n_real
    return Plausibility(
        float(between.min(axis=1).mean()),
        len(np.unique(between.argmin(axis=0))) / n_real,
        float((is_real[alone.argmin(axis=1)] == is_real).mean()),
        n_real,
        len(table) - n_real,
    )


def thin_cloud(points: Float[np.ndarray, "n 3"], count: int, *, rng: np.random.Generator) -> Float[np.ndarray, "m 3"]:
    """``count`` of the finite points at random (all, where there are fewer): clouds of a size to compare."""
    points = points[np.isfinite(points).all(axis=1)]
    return points if len(points) <= count else points[rng.choice(len(points), count, replace=False)]


@dataclass(frozen=True)
class Novelty:
    """``new``: median distance from a new shape to the nearest real one; ``real``: the same among the real shapes.

    Chamfer distances in the units of the clouds.  Copies have ``new`` near 0.
    """

    new: float
    real: float

    @property
    def ratio(self) -> float:
        """How far new shapes are from real ones, measured by how far those are from each other."""
        return self.new / max(self.real, 1e-12)


def novelty(real: Sequence[np.ndarray], new: Sequence[np.ndarray]) -> Novelty:
    """Whether new shapes are more than copies; at least 2 real clouds and 1 new one, of about as many points each."""
    if len(real) < 2 or not len(new):
        raise ValueError(f"real, new: wanted at least 2 and 1 shapes, got {len(real)} and {len(new)}.")
    own = chamfer_table(real) + np.diag(np.full(len(real), np.inf))
    return Novelty(float(np.median(chamfer_table(new, real).min(axis=1))), float(np.median(own.min(axis=1))))


def open_share(mesh: Mesh) -> float:
    """Share of a mesh's edges that keep it from being watertight, once coinciding vertices are one; 0: it is."""
    triangles = weld(np.asarray(mesh.vertices, float), mesh.triangles)[1]
    return open_edges(triangles) / max(len(sides_of(triangles)[0]), 1)


def contact_distance(
    mesh: Mesh, label: Int[np.ndarray, " N"], touching: Float[np.ndarray, "L L"], least: float = 0.5
) -> float | None:
    """Mean distance between parts that touch on at least a share ``least`` of the shapes; None where there are none.

    ``label`` (N,) is the part of every triangle.  Made and real shapes are measured alike: it knows of no sources.
    """
    pieces = {
        int(l): Mesh(mesh.vertices, mesh.triangles[label == l], np.arange((label == l).sum()), int((label == l).sum()))
        for l in np.unique(label) if l >= 0
    }  # fmt: skip
    found = []
    for l in pieces:
        for other in pieces:
            if l < other and touching[l, other] >= least:
                ways = ((l, other), (other, l))
                away = [_nearest(pieces[a], pieces[b]) for a, b in ways]
                found.append(min(away))
    return float(np.mean(found)) if found else None


def _nearest(one: Mesh, other: Mesh) -> float:
    """Least distance from corners and middles of one mesh's triangles to the surface of another."""
    corners = one.vertices[one.triangles]
    queries = np.concatenate([one.vertices[np.unique(one.triangles)], corners.mean(axis=1)])
    return float(closest_points(other, np.asarray(queries, float))[2].min())
