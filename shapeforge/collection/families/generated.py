"""A generated shape with its truth: parts, landmarks and a canonical address for every place on its surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from shapeforge.collection.families.solids import Vector
from shapeforge.collection.shape import Mesh

# a leg's length says more about a place than where around it one is; so u weighs more than v and w
AXIS_WEIGHT = np.array([1.0, 1.0, 0.5])


@dataclass(frozen=True, eq=False)
class Generated:
    """One generated shape; ``mesh`` is in metres, y up.

    ``faces`` (n_faces,) is the part index of every face record; ``address`` (N, 3, 5) holds for the corners of every
    triangle (component index, u, v, w, valid 0 or 1); ``component_names`` are the family's, the same for every shape.
    """

    name: str
    mesh: Mesh
    faces: Int[np.ndarray, " F"]
    part_names: tuple[str, ...]
    fine_class: str
    landmarks: dict[str, np.ndarray]
    address: Float[np.ndarray, "N 3 5"]
    component_names: tuple[str, ...]
    damage: tuple[str, ...] = ()

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components that this shape has."""
        present = np.unique(self.address[:, 0, 0].astype(int))
        return tuple(self.component_names[i] for i in present)

    @cached_property
    def _searchers(self) -> dict[int, tuple[cKDTree, np.ndarray] | None]:
        return {}

    def _searcher(self, component: int) -> tuple[cKDTree, np.ndarray] | None:
        """Tree of the addresses sampled inside a component's triangles, and their positions; None without any."""
        if component not in self._searchers:
            chosen = np.flatnonzero(self.address[:, 0, 0].astype(int) == component)
            weights = _lattice(8)
            address = np.einsum("sc,ncd->nsd", weights, self.address[chosen, :, 1:4]).reshape(-1, 3)
            corners = self.mesh.vertices[self.mesh.triangles[chosen]]
            positions = np.einsum("sc,ncd->nsd", weights, corners).reshape(-1, 3)
            self._searchers[component] = (cKDTree(address * AXIS_WEIGHT), positions) if len(chosen) else None
        return self._searchers[component]


def _lattice(n: int) -> np.ndarray:
    """Barycentric weights (S, 3) of a regular lattice inside a triangle, corners included."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    keep = i + j <= n
    return np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n


def corner_at(generated: Generated, component: int, address: Vector) -> Float[np.ndarray, " 3"]:
    """The vertex of a component whose address is nearest: where landmarks are put."""
    triangle, corner = np.nonzero(generated.address[:, :, 0].astype(int) == component)
    off = (generated.address[triangle, corner, 1:4] - np.asarray(address)) * AXIS_WEIGHT
    nearest = np.argmin((off**2).sum(axis=1))
    return generated.mesh.vertices[generated.mesh.triangles[triangle[nearest], corner[nearest]]]


def address_at(
    generated: Generated, triangle: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Component index (n,) and address (n, 3) in [0, 1] at places given by triangle and barycentric weights."""
    corners = generated.address[triangle]
    return corners[:, 0, 0].astype(int), np.einsum("nc,ncd->nd", barycentric, corners[:, :, 1:4])


def position_of(
    generated: Generated, component: int, address: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Surface points (n, 3) of the component whose addresses are nearest, and how far off the addresses are (n,).

    A slatted back has no surface at the address of a gap: the distance says so.  NaN and infinity where the shape
    does not have the component.
    """
    searcher = generated._searcher(component)
    if searcher is None:
        return np.full((len(address), 3), np.nan), np.full(len(address), np.inf)
    tree, positions = searcher
    distance, nearest = tree.query(address * AXIS_WEIGHT)
    return positions[nearest], distance


def corresponding_point(
    generated_a: Generated,
    points: Float[np.ndarray, "n 3"],
    generated_b: Generated,
    *,
    tolerance: Number = 0.15,
) -> Float[np.ndarray, "n 3"]:
    """The points (n, 3) of shape B that mean the same place as ``points`` (n, 3) of shape A, both in file coordinates.

    NaN where B lacks the component, or has no surface within ``tolerance`` (address units: 1 is the whole component).
    """
    if generated_a.component_names != generated_b.component_names:
        raise ValueError(
            "generated_b: wanted a shape of the same family as generated_a, got one with other components "
            f"({generated_a.name} and {generated_b.name}); chairs do not correspond to airplanes"
        )
    triangle, barycentric = nearest_on_mesh(generated_a.mesh, points)
    component, address = address_at(generated_a, triangle, barycentric)
    found = np.full((len(points), 3), np.nan)
    for one in np.unique(component):
        chosen = component == one
        positions, distance = position_of(generated_b, int(one), address[chosen])
        found[chosen] = np.where((distance <= tolerance)[:, None], positions, np.nan)
    return found


def nearest_on_mesh(
    mesh: Mesh, points: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Triangle (n,) and barycentric weights (n, 3) of the surface points nearest to ``points``."""
    import trimesh

    surface = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False, validate=False)
    on, _, triangle = trimesh.proximity.closest_point(surface, points)
    weights = trimesh.triangles.points_to_barycentric(mesh.vertices[mesh.triangles[triangle]], on, method="cross")
    weights = np.clip(np.nan_to_num(weights, nan=1 / 3), 0, None)
    return triangle.astype(int), weights / weights.sum(axis=1, keepdims=True)
