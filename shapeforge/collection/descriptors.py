"""The 10 geometric numbers of a surface point (§3): shape diameter, average geodesic distance, local PCA.

They come from rays, graph distances and eigenvalues alone, so turning or moving a sampled shape changes none of them,
and they must work on polygon soup: faces wound either way, sheets without thickness, pieces that do not touch.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int

from shapeforge.collection import _kernels as kernels
from shapeforge.collection.points import nearest_neighbours, neighbour_pairs
from shapeforge.collection.rays import first_hits
from shapeforge.collection.shape import Mesh

DESCRIPTOR_NAMES = (
    "shape diameter, alpha 1",
    "shape diameter, alpha 2",
    "shape diameter, alpha 4",
    "average geodesic distance",
    "width to length within .05",
    "thickness to length within .05",
    "width to length within .1",
    "thickness to length within .1",
    "width to length within .2",
    "thickness to length within .2",
)
RAYS_PER_SIDE = 32
CONE = np.deg2rad(60.0)  # half the opening angle, Shapira 2008, 3.1
START = 1e-4  # rays begin this far (diagonals) off the surface, past faces drawn twice
PCA_RADII = (0.05, 0.1, 0.2)  # shares of the diagonal
GEODESIC_SOURCES = 100
GEODESIC_NEIGHBOURS = 8


def describe(
    mesh: Mesh,
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    triangle_of_point: Int[np.ndarray, " P"],
    neighbours20: Int[np.ndarray, "P n"] | None = None,
) -> Float32[np.ndarray, "P 10"]:
    """Descriptors (P, 10), each about 0..1, in the order of ``DESCRIPTOR_NAMES``.

    Everything is in normal coordinates (diagonals): the radii of the local PCA are shares of the diagonal.  ``normals``
    may point to either side.  ``neighbours20``: the nearest points of each point where known (``nearest_neighbours``).
    """
    extent = float(np.ptp(points, axis=0).max())
    if extent > 2:
        raise ValueError(f"points: wanted normal coordinates (a diagonal of 1), got an extent of {extent:.4g}")
    if neighbours20 is None:
        neighbours20 = nearest_neighbours(points, 20)
    diameter, _ = shape_diameter(mesh, points, normals, triangle_of_point, neighbours20)
    return descriptors_from_diameter(points, diameter, neighbours20)


def descriptors_from_diameter(
    points: Float[np.ndarray, "P 3"], diameter: Float[np.ndarray, " P"], neighbours20: Int[np.ndarray, "P n"]
) -> Float32[np.ndarray, "P 10"]:
    """As ``describe`` for points whose shape diameter (P,) is known."""
    columns = [
        *normalised_diameters(diameter).T,
        average_geodesic_distance(points, neighbours20),
        *local_shape(points).T,
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def shape_diameter(
    mesh: Mesh,
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    triangle_of_point: Int[np.ndarray, " P"],
    neighbours: Int[np.ndarray, "P n"],
    *,
    embree: bool | None = None,
) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, "P 3"]]:
    """Local thickness (P,) in diagonals (Shapira 2008), and the normals (P, 3) turned outward.

    Cones of rays go to *both* sides, since soup is wound at random.  Inside is the side where more of the cone meets
    the mesh again, by the point's own vote and half a voice of its neighbours that face the same way; where both sides
    are equal, the side that is inside for most of the shape.  Where less than half of the inner cone meets anything
    the surface is a sheet, and its thickness fades to 0.
    """
    rays, weights = _cone()
    # the frame turns with the mesh: its first axis is the longest edge of the point's triangle
    corners = mesh.vertices[mesh.triangles[triangle_of_point]]
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.take_along_axis(edges, np.argmax((edges**2).sum(axis=2), axis=1)[:, None, None], axis=1)[:, 0]
    side = longest - (longest * normals).sum(axis=1, keepdims=True) * normals
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
    across = np.cross(normals, side)
    flat = rays[:, 0, None] * side[:, None] + rays[:, 1, None] * across[:, None]
    steep = rays[:, 2, None] * normals[:, None]
    directions = np.stack([flat - steep, flat + steep], axis=1)  # (P, 2 sides: against and along the normal, R, 3)
    origins = points[:, None, None] + START * directions
    reach = first_hits(mesh, origins.reshape(-1, 3), directions.reshape(-1, 3), embree=embree)
    lengths = reach.reshape(2 * len(points), len(weights)) + START
    mean, share = (x.reshape(-1, 2) for x in _cone_averages(lengths, weights))

    vote = share[:, 0] - share[:, 1]
    vote = vote + 0.05 * (np.sign(vote.sum()) or 1.0)
    # half a voice for the neighbours: in soup, those that face the same way may be the far side of a thin part
    same = _agreement(normals, neighbours) > 0.5
    vote = vote + 0.5 * (same * vote[neighbours]).sum(axis=1) / np.maximum(same.sum(axis=1), 1)
    inside = np.where(vote >= 0, 0, 1)
    outward = np.where(vote >= 0, 1.0, -1.0)[:, None] * normals
    every = np.arange(len(points))
    diameter = mean[every, inside] * np.minimum(1.0, 2 * share[every, inside])

    weight = np.maximum(_agreement(outward, neighbours), 0.0) ** 2
    smooth = diameter + (weight * diameter[neighbours]).sum(axis=1)
    return smooth / (1.0 + weight.sum(axis=1)), outward


def normalised_diameters(diameter: Float[np.ndarray, " P"]) -> Float[np.ndarray, "P 3"]:
    """log(alpha s + 1) / log(alpha + 1) for alpha 1, 2, 4 (Shapira 2008, 4.1), s scaled to 0..1 over the shape.

    The 1st and 99th percentile stand for the least and the largest, so that no single point sets the scale.
    """
    low, high = np.quantile(diameter, [0.01, 0.99])
    # a shape of one thickness everywhere has no thin and no thick places: rounding must not invent them
    span = max(high - low, 1e-3 * max(high, 1e-300))
    scaled = np.clip((diameter - low) / span, 0.0, 1.0)
    alpha = np.array([1.0, 2.0, 4.0])
    return np.log1p(alpha * scaled[:, None]) / np.log1p(alpha)


def average_geodesic_distance(
    points: Float[np.ndarray, "P 3"], neighbours: Int[np.ndarray, "P n"], n_sources: int = GEODESIC_SOURCES
) -> Float[np.ndarray, " P"]:
    """(mean distance to the whole surface - its minimum) / its maximum (Hilaga 2001, Eq. 3).

    Distances run along the graph of nearest neighbours; pieces of it are joined by the shortest gaps.
    """
    if len(points) < 2:
        return np.zeros(len(points))
    tails, heads = neighbour_pairs(neighbours[:, :GEODESIC_NEIGHBOURS])
    gaps = kernels.bridges(points, tails, heads)
    tails, heads = np.concatenate([tails, gaps[:, 0]]), np.concatenate([heads, gaps[:, 1]])
    lengths = np.linalg.norm(points[tails] - points[heads], axis=1)
    graph = kernels.compressed(len(points), tails, heads, lengths)
    start = int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))
    mean = kernels.mean_distances(*graph, min(n_sources, len(points)), start)
    return (mean - mean.min()) / max(mean.max(), 1e-300)


def local_shape(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 6"]:
    """Width/length and thickness/length of the neighbourhood at each of ``PCA_RADII``: roots of the eigenvalue ratios.

    Columns: both at the first radius, then both at the next.  A rod has (0, 0), a plate (1, 0), a ball (1, 1).
    """
    points = np.ascontiguousarray(points, np.float64)
    columns = []
    for radius in PCA_RADII:
        # neighbourhoods grow with the square of the radius: every fourth point tells as much about twice the radius
        thinned = np.ascontiguousarray(points[:: max(1, round((radius / PCA_RADII[0]) ** 2 / 1.6))])
        six = kernels.local_covariances(points, thinned, radius)
        values = np.maximum(np.linalg.eigvalsh(six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)), 0.0)
        columns.append(np.sqrt(values[:, 1::-1] / np.maximum(values[:, 2:], 1e-300)))
    return np.concatenate(columns, axis=1)


def _cone() -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (R, 3) about +z spread evenly over the cone, and weights 1/angle (R,).

    A golden spiral over one quarter, mirrored into the others: so the rays are the same whichever way x, y and the
    triangle's winding run.
    """
    n = RAYS_PER_SIDE // 4
    step = (np.arange(n) + 0.5) / n
    height = 1 - step * (1 - np.cos(CONE))
    turn = np.pi / 2 * ((np.arange(n) + 0.5) * (np.sqrt(5) - 1) / 2 % 1)
    radius = np.sqrt(1 - height**2)
    quarter = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
    mirrors = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]])
    return (mirrors[:, None] * quarter).reshape(-1, 3), np.tile(1 / np.arccos(height), 4)


def _cone_averages(lengths: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Robust mean of the finite ``lengths`` (n, R): (mean (n,), share of the rays' weight that hit (n,)).

    Lengths farther than one standard deviation from the median are left out (Shapira 2008, 3.1).
    """
    hit = np.isfinite(lengths)
    count = np.maximum(hit.sum(axis=1), 1)
    ordered = np.sort(lengths, axis=1)  # misses last
    rows = np.arange(len(lengths))
    median = ((ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]) / 2)[:, None]
    known = np.where(hit, lengths, 0.0)
    mean = known.sum(axis=1) / count
    variance = (np.where(hit, known - mean[:, None], 0.0) ** 2).sum(axis=1) / count
    near = hit & (np.abs(known - np.where(np.isfinite(median), median, 0.0)) <= np.sqrt(variance)[:, None] + 1e-12)
    kept = near @ weights
    return (near * known) @ weights / np.maximum(kept, 1e-300), hit @ weights / weights.sum()


def _agreement(normals: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Cosine (P, n) between each point's normal and its neighbours'."""
    return np.einsum("pd,pnd->pn", normals, normals[neighbours])
