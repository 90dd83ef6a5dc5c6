"""How good a part is to make meshes from, and how good a made mesh is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import closest_points
from shapeforge.collection.symmetry import mirrored, symmetry_plane
from shapeforge.synthesis.cleaning import neighbours
from shapeforge.synthesis.surfaces import WELD

RAGGED = 0.006
UNEXPLAINED = 0.2
FAR = 0.05
MISPLACED = 0.03
MENDED = 0.4
HOLES = 4.0
ONE_SIDED = 0.3
FEWEST_TRIANGLES = 8
THINNEST = 1e-5
"""Height (diagonals) of the flattest triangle whose side is worth looking at."""
CONTACT_REACH = 0.06
"""A part holds on if it touches within this distance (diagonals) of its anchors."""


@dataclass(frozen=True)
class PartQuality:
    """What makes a training part unfit: few triangles, a jagged border, surface without or points far from surface.

    ``raggedness`` is the length (diagonals) that smoothing takes from a border edge (see :func:`raggedness`), of the
    part as it was cut; ``unexplained`` the share of the part's vertices farther than .05 diagonals plus three spacings
    from all its points; ``misplaced`` the mean distance (diagonals) from those points to the part's surface;
    ``mended`` the share of the part's area, before or after, that cleaning took away or added (specks, islands);
    ``holes`` the length (diagonals) of cuts through closed surface that no lid closes; ``one_sided`` the share of the
    part's area whose mirror image on the shape belongs to other parts (one armrest of two).
    """

    n_triangles: int
    raggedness: float
    unexplained: float
    misplaced: float
    mended: float = 0.0
    holes: float = 0.0
    one_sided: float = 0.0

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the part should not be used; empty if it may."""
        found = []
        if self.n_triangles < FEWEST_TRIANGLES:
            found.append(f"only {self.n_triangles} faces")
        if self.raggedness > RAGGED:
            found.append(f"ragged border ({self.raggedness:.3f})")
        if self.unexplained > UNEXPLAINED:
            found.append(f"surface without corresponding points ({self.unexplained:.0%})")
        if self.misplaced > MISPLACED:
            found.append(f"corresponding points off the part ({self.misplaced:.3f})")
        if self.mended > MENDED:
            found.append(f"uncertain faces ({self.mended:.0%} reassigned)")
        if self.holes > HOLES:
            found.append(f"cut open ({self.holes:.2f})")
        if self.one_sided > ONE_SIDED:
            found.append(f"on one side only ({self.one_sided:.0%} without its mirror image)")
        return tuple(found)

    @property
    def badness(self) -> float:
        """0 for a part without problems, more the worse it is: to choose among bad ones."""
        few = max(0.0, FEWEST_TRIANGLES - self.n_triangles) / FEWEST_TRIANGLES
        return few + sum(max(0.0, share - 1) for share in self._shares)

    @property
    def blemish(self) -> float:
        """0 for a flawless part, about 1 per problem: to choose among good ones."""
        return float(sum(min(share, 1.0) for share in self._shares))

    @property
    def _shares(self) -> tuple[float, ...]:
        """Each measure as a share of what is bearable."""
        return (
            self.raggedness / RAGGED, self.unexplained / UNEXPLAINED, self.misplaced / MISPLACED,
            self.mended / MENDED, self.holes / HOLES, self.one_sided / ONE_SIDED,
        )  # fmt: skip


def far_from(handles: Float[np.ndarray, "C 3"], points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
    """Which points lie so far from all handles that those say nothing about them."""
    tree = cKDTree(handles)
    nearest = tree.query(handles, k=min(2, len(handles)))[0].reshape(len(handles), -1)[:, -1]
    return tree.query(points)[0] > FAR + 3 * float(np.median(nearest))


def raggedness(mesh: Mesh, label: Int[np.ndarray, " N"], part: int, *, rounds: int = 12) -> float:
    """Length that the border between ``part`` and the rest loses when smoothed, per border edge; 0 without a border.

    In the units of the mesh: a zigzag of edges e has about .4 e, longer teeth have more.  What a circle of as many
    edges would lose is not counted, nor loops of under 12 edges.
    """
    _, weld = np.unique(np.round(mesh.vertices / WELD).astype(np.int64), axis=0, return_inverse=True)
    weld = weld.reshape(-1)
    corners = weld[mesh.triangles]
    sides = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, edge_of_side = np.unique(sides, axis=0, return_inverse=True)
    inside = np.repeat(label == part, 3)
    has = np.bincount(edge_of_side.reshape(-1), inside, len(edges)) > 0
    lacks = np.bincount(edge_of_side.reshape(-1), ~inside, len(edges)) > 0
    border = edges[has & lacks & (edges[:, 0] != edges[:, 1])]
    if len(border) == 0:
        return 0.0
    used, ends = np.unique(border, return_inverse=True)
    ends = ends.reshape(-1, 2)
    position = np.zeros((weld.max() + 1, 3))
    position[weld] = mesh.vertices
    position = position[used]
    degree = np.bincount(ends.ravel(), minlength=len(used))
    loop = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used)))
    loop = connected_components(loop, directed=False)[1][ends[:, 0]]
    n_edges = np.bincount(loop)
    before = np.bincount(loop, _lengths(position, ends))
    for _ in range(rounds):
        total = np.zeros_like(position)
        np.add.at(total, ends[:, 0], position[ends[:, 1]])
        np.add.at(total, ends[:, 1], position[ends[:, 0]])
        position = np.where((degree == 2)[:, None], (position + total / 2) / 2, position)
    circle = (0.5 + 0.5 * np.cos(2 * np.pi / np.maximum(n_edges, 3))) ** rounds
    lost = np.maximum(0.0, before - np.bincount(loop, _lengths(position, ends)) / circle)
    return float(lost[n_edges >= 12].sum() / len(ends))


def _lengths(position: np.ndarray, ends: np.ndarray) -> np.ndarray:
    return np.linalg.norm(position[ends[:, 0]] - position[ends[:, 1]], axis=1)


def gap(
    vertices: Float[np.ndarray, "V 3"],
    piece: Int[np.ndarray, " V"],
    anchors: Int[np.ndarray, " A"],
    before: Float[np.ndarray, " A"],
    other: Mesh,
) -> tuple[float, float]:
    """Widest distance (diagonals) from a piece of a part, about its anchors, to the part it should touch; and the
    widest new one, less the distance ``before`` that the piece's nearest anchor had on the training shape.

    Measured for each ``piece`` that holds an anchor: one leg of four in the air is a gap, though three stand fast.
    What touches within the part (a rail between legs, which held a shelf that is elsewhere now) hangs together.
    """
    around = cKDTree(vertices[anchors]).query(vertices, distance_upper_bound=CONTACT_REACH)[0] < np.inf
    holds = np.flatnonzero(around & np.isin(piece, piece[anchors]))
    distance, allowed = np.full((2, piece.max() + 1), np.inf)
    np.minimum.at(distance, piece[holds], closest_points(other, vertices[holds])[2])
    np.minimum.at(allowed, piece[anchors], before)
    held = np.unique(piece[anchors])
    return float(distance[held].max()), float(np.maximum(distance[held] - allowed[held], 0).max())


def symmetry_error(
    points: Float[np.ndarray, "P 3"], plane: tuple[Float[np.ndarray, " 3"], float] | None = None
) -> float:
    """Mean distance from the mirrored points to the points (same units).

    ``plane`` is the mirror (unit normal, place along it); without one the best near-vertical plane is found (y is up).
    """
    normal, place = symmetry_plane(points)[:2] if plane is None else plane
    return float(cKDTree(points).query(mirrored(points, normal, place))[0].mean())


def open_edges(triangles: Int[np.ndarray, "N 3"]) -> int:
    """Edges that keep a mesh from being watertight: not run through as often one way as the other."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    base = int(sides.max()) + 1 if len(sides) else 1
    low, high = sides.min(axis=1), sides.max(axis=1)
    _, edge = np.unique(low * base + high, return_inverse=True)
    balance = np.bincount(edge.reshape(-1), np.where(sides[:, 0] == low, 1, -1))
    return int((balance != 0).sum())


def inverted_triangles(
    rest: Float[np.ndarray, "V 3"], bent: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"],
    pairs: tuple[np.ndarray, np.ndarray] | None = None,
) -> int:  # fmt: skip
    """Number of :func:`inverted_pairs`."""
    return int(inverted_pairs(rest, bent, triangles, pairs)[0].size)


def inverted_pairs(
    rest: Float[np.ndarray, "V 3"], bent: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "N 3"],
    pairs: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[Int[np.ndarray, " F"], Int[np.ndarray, " F"]]:  # fmt: skip
    """Folds that bending made: pairs of neighbours that faced alike at rest (within 60 degrees) and now are opposed.

    ``rest`` should hold the vertices after the affine part of the deformation, which folds nothing;
    ``pairs`` are the pairs of triangles with a common edge, where they are known already.  Triangles that are thinner
    than THINNEST at rest don't count: they have no side to speak of, and a rounding error turns them.
    """
    first, second = neighbours(rest, triangles)[:2] if pairs is None else pairs
    turn, thick = [], np.ones(len(triangles), bool)
    for vertices in (rest, bent):
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        if vertices is rest:
            longest = np.maximum.reduce([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))])
            thick = (normal**2).sum(axis=1) > THINNEST**2 * longest
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        turn.append((normal[first] * normal[second]).sum(axis=1))
    # Files often wind neighbours against each other: compare with how they stood at rest.
    opposed = ((turn[0] > 0.5) & (turn[1] < -0.5)) | ((turn[0] < -0.5) & (turn[1] > 0.5))
    opposed &= thick[first] & thick[second]
    return first[opposed], second[opposed]
