"""Which way may be up: directions worth considering, what speaks for each, and how likely that makes it.

After "Upright orientation of man-made objects" (Fu 2008), whose candidates are the supports of the convex hull; ours
also come from the surface's normals and mirror planes, so that what flies or hangs has a chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull

from shapeforge.collection.align import thinned
from shapeforge.collection.directions import angle_between, convex_hull, facing_frames, supports
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.collection.symmetry import Mirror, Reflections, mirror_planes

ONE_DIRECTION = 2.0  # degrees: candidates nearer than this are one
SNAP = 10.0  # degrees: an axis that the surface faces gives way to a mirror plane this near
GOOD_MIRROR = 0.02  # mean gap (radii) of a mirror plane that may correct an axis
BARELY_TOUCHING = 0.024  # height (radii) of what counts as touching the ground
_N_SAMPLES, _N_COMPARED, _N_HULL = 1800, 700, 20000

FEATURES = (
    "stability", "base", "level", "flat", "steep", "uprightness", "centre", "feet", "tallness", "faced", "supported",
    "support", "level height", "bottom spread", "top spread",
)  # fmt: skip
"""What speaks for a direction being up, in this order in ``up_features``; see there."""


@dataclass(frozen=True, eq=False)
class Surface:
    """What is asked of a shape: points (n, 3) spread evenly over the area, centred, with a mean square radius of 1.

    ``normals`` (n, 3) are unsigned; ``corners`` (m, 3) the vertices of the convex hull; ``mirrors`` the best mirror
    planes; ``frames`` the axes along which the surface faces, with the share of it that does.
    """

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    hull: ConvexHull | None
    corners: Float[np.ndarray, "m 3"]
    reflections: Reflections
    frames: tuple[tuple[np.ndarray, float], ...]
    mirrors: tuple[Mirror, ...]


@dataclass(frozen=True, eq=False)
class Up:
    """A direction (3,) that may be up: the ``faced`` share of the frame it is an axis of, the hull's ``support``."""

    direction: Float[np.ndarray, " 3"]
    faced: float = 0.0
    support: float = 0.0


def surface_of_mesh(mesh: Mesh) -> Surface | None:
    """The surface of a mesh in its own axes; None where it has no area."""
    points, normals = spread_samples(mesh, _N_SAMPLES)
    if len(points) == 0:
        return None
    return make_surface(points, normals, mesh.vertices[np.unique(mesh.triangles)])


def surface_of_shape(shape: Shape) -> Surface | None:
    """The surface of a prepared shape in its file's axes (not its units)."""
    back = shape.frame.rotation
    vertices = shape.mesh.vertices[np.unique(shape.mesh.triangles)]
    return make_surface(shape.points @ back, shape.normals @ back, vertices @ back)


def make_surface(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "v 3"]
) -> Surface | None:
    """The surface that points (n, 3), their normals and the vertices (v, 3) of the mesh stand for; None if a point."""
    points, normals = thinned(points, _N_SAMPLES), thinned(normals, _N_SAMPLES)
    centre = points.mean(axis=0)
    radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
    if not np.isfinite(radius) or radius <= 0 or len(points) < 10:
        return None
    points = (points - centre) / radius
    hull = convex_hull((thinned(vertices, _N_HULL) - centre) / radius)
    corners = points if hull is None else hull.points[hull.vertices]
    _, axes = np.linalg.eigh(points.T @ points)
    frames = facing_frames(thinned(normals, _N_COMPARED), np.stack([np.eye(3), axes.T]))
    reflections = Reflections(points)
    mirrors = mirror_planes(reflections, np.concatenate([frame for frame, _ in frames[:1]] or [np.eye(3)]))
    return Surface(points, normals, hull, corners, reflections, tuple(frames), tuple(mirrors))


def up_candidates(surface: Surface, given: Float[np.ndarray, "g 3"]) -> list[Up]:
    """Directions that may be up, no two within 2 degrees: ``given`` ones (g, 3), supports of the hull, faced axes."""
    found: list[Up] = []

    def add(direction: np.ndarray, faced: float = 0.0, support: float = 0.0) -> None:
        for i, up in enumerate(found):
            if angle_between(direction, up.direction) < ONE_DIRECTION:
                found[i] = Up(up.direction, max(faced, up.faced), max(support, up.support))
                return
        found.append(Up(direction, faced, support))

    for direction in given:
        add(direction)
    for direction, area in supports(surface.hull):
        add(direction, support=area)
    for frame, share in surface.frames:
        for axis in frame:
            straight = _straightened(axis, surface.mirrors)
            add(straight, faced=share)
            add(-straight, faced=share)
    return found


def _straightened(axis: np.ndarray, mirrors: tuple[Mirror, ...]) -> np.ndarray:
    """The axis (3,), turned into the mirror plane that it nearly lies in, or onto the normal that it nearly is."""
    for mirror in mirrors[:3]:
        across = float(mirror.normal @ axis)
        if mirror.error < GOOD_MIRROR and abs(across) < np.sin(np.radians(SNAP)):
            within = axis - across * mirror.normal
            return within / np.linalg.norm(within)
        if mirror.error < GOOD_MIRROR and abs(across) > np.cos(np.radians(SNAP)):
            return mirror.normal * np.sign(across)
    return axis


def up_features(surface: Surface, ups: list[Up]) -> Float[np.ndarray, "u f"]:
    """What speaks for each direction (u, f), in the order of ``FEATURES``; turning the shape changes none of it.

    stability: how far inside its support polygon the centroid stands, and base: how wide that polygon is, both of the
    plan's; level, flat, steep: shares of the area; uprightness: top and bottom differ more than a mirror plane's sides;
    centre: height of the centroid; feet: area near the ground; tallness: log of the height; faced, supported, support:
    of the ``Up``; level height: where level surfaces are; bottom and top spread: how far out the ends reach.
    """
    points, normals = thinned(surface.points, _N_COMPARED), thinned(surface.normals, _N_COMPARED)
    return np.array([_features_of(up, points, normals, surface) for up in ups])


def _features_of(up: Up, points: np.ndarray, normals: np.ndarray, surface: Surface) -> list[float]:
    direction = up.direction
    heights = surface.corners @ direction
    low, high = float(heights.min()), float(heights.max())
    tall = max(high - low, 1e-9)
    across = plan_axes(direction)
    stability, base = _standing(surface.corners @ across.T, heights < low + BARELY_TOUCHING)
    steepness = np.abs(normals @ direction)
    level = steepness > 0.95
    height = (points @ direction - low) / tall
    out = ((points @ across.T) ** 2).sum(axis=1)
    mean_out = max(float(out.mean()), 1e-12)
    bottom, top = out[height <= 0.12], out[height >= 0.88]
    mirror = min(surface.reflections.error(direction, at) for at in (0.0, (low + high) / 2))
    sides = [plane.error for plane in surface.mirrors if abs(plane.normal @ direction) < np.sin(np.radians(4.0))]
    return [
        stability,
        base,
        float(level.mean()),
        float((steepness > 0.996).mean()),
        float((steepness < 0.2).mean()),
        10 * (min(mirror, 0.15) - min([*sides, 0.15])),
        float(height.mean()),
        float((height < 0.05).mean()),
        float(np.log(tall)),
        up.faced,
        float(up.support > 0),
        float(np.sqrt(up.support)),
        float(height[level].mean()) if level.sum() > 5 else 0.5,
        float(np.sqrt(bottom.mean() / mean_out)) if len(bottom) > 2 else 0.0,
        float(np.sqrt(top.mean() / mean_out)) if len(top) > 2 else 0.0,
    ]


def plan_axes(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "2 3"]:
    """Two unit vectors at right angles to a direction (3,) and to each other."""
    first = np.cross(np.eye(3)[np.abs(direction).argmin()], direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def _standing(plan: Float[np.ndarray, "m 2"], touching: Bool[np.ndarray, " m"]) -> tuple[float, float]:
    """Stability and base of the corners' plan (m, 2): depth of the origin (the centroid) in the support, its width."""
    whole, ground = convex_hull(plan), convex_hull(plan[touching])
    if whole is None or ground is None:  # a line: nothing stands on that
        return 0.0, 0.0
    inside = -float(ground.equations[:, 2].max())
    radius = np.sqrt(whole.volume / np.pi)
    return 2 * float(np.clip(inside / radius, 0.0, 0.5)), float(np.sqrt(ground.volume / whole.volume))


def log_likelihoods(features: Float[np.ndarray, "u f"]) -> Float[np.ndarray, " u"]:
    """Log-probabilities (u,) of directions with these features, the file's axes left out of account.

    Two voices, one for what stands and one for what flies or lies; whichever is surer is heard.  Their weights are
    maximum likelihood on generated chairs and airplanes (``python -m benchmarks.orientation --learn``).
    """
    voices = features @ WEIGHTS.T + BIAS
    score = np.logaddexp.reduce(voices, axis=1)
    return score - np.logaddexp.reduce(score)


WEIGHTS = np.array([
    [0.627, -0.585, 3.79, 4.08, -2.49, 0.298, -12.5, 0.905, -1.78, 2.48, -1.8, -4.61, 4.12, -2.19, 0.617],
    [3.22, 2.92, 0.898, 11.9, 0.235, 0.393, 6.62, -1.56, 1.7, -0.0296, 0.709, 3.16, 2.7, 0.473, 0.154],
])  # fmt: skip
BIAS = np.array([16.7, 0])


def spread_samples(mesh: Mesh, count: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """About ``count`` points (n, 3) and unit normals, evenly over the area, without randomness (golden-ratio steps)."""
    areas = mesh.triangle_areas
    total = float(areas.sum())
    if not np.isfinite(total) or total <= 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    cumulative = np.cumsum(areas)
    at = (np.arange(count) + 0.5) / count * cumulative[-1]
    triangle = np.minimum(np.searchsorted(cumulative, at), len(areas) - 1)
    first, second = np.arange(count) * 0.7548776662466927 % 1, np.arange(count) * 0.5698402909980532 % 1
    over = first + second > 1
    first[over], second[over] = 1 - first[over], 1 - second[over]
    a, b, c = (mesh.vertices[mesh.triangles[triangle, i]] for i in range(3))
    return a + first[:, None] * (b - a) + second[:, None] * (c - a), mesh.triangle_normals[triangle]
