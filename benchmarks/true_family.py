"""Generated families with true corresponding points, as a perfect fit would find them: for what comes after a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapeforge.collection.families import Generated, address_at, generate, position_of
from shapeforge.collection.points import sample_points
from shapeforge.collection.prepare import normal_frame
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.synthesis.sources import FEWEST_POINTS, Sources, make_sources

ADDRESS_TOLERANCE = 0.15
"""How far, as addresses go, the nearest surface of a shape may be from where another shape has a point."""


@dataclass(frozen=True, eq=False)
class TrueFamily:
    """Shapes of a generated family, their labels and classes, and true corresponding points (T, K, 3), NaN where
    absent."""

    shapes: tuple[Shape, ...]
    faces: tuple[np.ndarray, ...]
    positions: np.ndarray
    part: np.ndarray
    part_names: tuple[str, ...]
    classes: tuple[str, ...]

    def sources(self, chosen: np.ndarray) -> Sources:
        """Sources of the chosen shapes."""
        return make_sources(
            [self.shapes[i].name for i in chosen], lambda i: self.shapes[chosen[i]],
            [self.faces[i] for i in chosen], self.positions[chosen], self.part, self.part_names,
        )  # fmt: skip

    def exists(self, index: int) -> np.ndarray:
        """Which parts a shape has."""
        present = np.isfinite(self.positions[index, :, 0])
        return np.array([present[self.part == l].sum() >= FEWEST_POINTS for l in range(len(self.part_names))])


def bare_shape(generated: Generated) -> Shape:
    """A shape in normal coordinates with mesh and name only: synthesis asks for nothing else."""
    frame = normal_frame(generated.mesh, np.eye(3))
    mesh = generated.mesh.moved(frame.to_normal(generated.mesh.vertices))
    none, nothing, unknown = np.zeros((0, 3)), np.zeros(0, np.int32), np.zeros((0, 10))
    return Shape(
        generated.name, mesh, frame, none, none, nothing, nothing, unknown, nothing, np.zeros((0, 20), np.int32)
    )


def true_family(family: str, count: int, *, seed: int, n_points: int = 1500) -> TrueFamily:
    """``count`` generated shapes with about ``n_points`` corresponding points, spread by area over their components."""
    made = generate(family, count, seed=seed, broken=0.0)
    shapes = tuple(bare_shape(g) for g in made)
    rng = np.random.default_rng(seed)
    n_components = len(made[0].component_names)
    component = [g.address[:, 0, 0].astype(int) for g in made]
    area = np.stack([np.bincount(c, s.mesh.triangle_areas, n_components)
                     for c, s in zip(component, shapes, strict=True)])  # fmt: skip
    total = np.array([area[area[:, c] > 0, c].mean() if area[:, c].any() else 0.0 for c in range(n_components)])
    positions, part = [], []
    for c in np.flatnonzero(total):
        n = max(16, round(n_points * float(total[c]) / total.sum()))
        model = int(area[:, c].argmax())  # the largest specimen shows the most addresses
        mesh, triangles = shapes[model].mesh, np.flatnonzero(component[model] == c)
        piece = Mesh(mesh.vertices, mesh.triangles[triangles], np.arange(len(triangles)), len(triangles))
        points, _, triangle = sample_points(piece, n, rng=rng)
        address = address_at(made[model], triangles[triangle], _weights(piece, points, triangle))[1]
        found = np.full((count, n, 3), np.nan)
        for t, (g, shape) in enumerate(zip(made, shapes, strict=True)):
            places, away = position_of(g, int(c), address)
            near = away <= ADDRESS_TOLERANCE
            found[t, near] = shape.frame.to_normal(places[near])
        positions.append(found)
        part += [int(made[model].faces[mesh.face_of_triangle[triangles[0]]])] * n
    return TrueFamily(
        shapes, tuple(g.faces for g in made), np.concatenate(positions, axis=1), np.array(part), made[0].part_names,
        tuple(g.fine_class for g in made),
    )  # fmt: skip


def _weights(mesh: Mesh, points: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Barycentric weights of points that lie on the given triangles."""
    a, b, c = (mesh.vertices[mesh.triangles[triangle, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    square = np.maximum((normal**2).sum(axis=1), 1e-300)
    v = (np.cross(points - a, c - a) * normal).sum(axis=1) / square
    w = (np.cross(b - a, points - a) * normal).sum(axis=1) / square
    return np.stack([1 - v - w, v, w], axis=1)
