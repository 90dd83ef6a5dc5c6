"""Which way is up: turning a mesh so that y is up (candidates among the axis rotations, scored)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError, cKDTree

from shapeforge.collection.shape import Mesh

# The rotation that takes each signed axis to +y.  Among the four that do, the one that turns least (and, for z up,
# keeps x to the right), because only the vertical is decided here, never which way a shape faces.
TURNS: dict[str, np.ndarray] = {
    "+y": np.eye(3),
    "+z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "+x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "-y": np.diag([1.0, -1, -1]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-x": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
}
CHOICES = ("auto", "x", "y", "z", "keep")

# Files are y up mostly, z up quite often, anything else hardly ever; a wrong turn is worse than none.
_PRIOR = {"+y": 1.9, "+z": 1.5, "+x": 0.0, "-y": 0.0, "-z": 0.0, "-x": 0.0}
_WEIGHT = {"stability": 0.6, "horizontal": 4.0, "upright": 2.0, "round": 8.0, "feet": 1.5}
_N_SAMPLES = 1500


def orient(mesh: Mesh, up: str) -> tuple[Float[np.ndarray, "3 3"], str]:
    """The proper rotation (3, 3) that makes y the vertical of ``mesh``, and a sentence saying what was done.

    ``up``: "x", "y" or "z" name the axis that is up in the file; "keep" leaves the file as it is; "auto" scores the
    six signed axes by stability on the ground, horizontal surfaces, mirror symmetry and where the mass is, and turns
    only when another axis is clearly better than y (then z).  Rotation about the vertical is left alone.

    Raises ValueError when ``up`` is none of these.
    """
    if up not in CHOICES:
        raise ValueError(f"up: wanted one of {', '.join(CHOICES)}, got {up!r}; name the axis that is up in the file")
    if up == "keep":
        return np.eye(3), "orientation kept as in the file"
    if up != "auto":
        return TURNS["+" + up].copy(), "y is up in the file" if up == "y" else f"turned: {up} was up in the file"
    scores = up_scores(mesh)
    best = max(scores, key=lambda axis: scores[axis])
    if best == "+y":
        return np.eye(3), "y is up"
    return TURNS[best].copy(), f"turned: {best} seems to be up in the file"


def up_scores(mesh: Mesh) -> dict[str, float]:
    """Score of each signed axis ("+y", "+z", …) for being the vertical of ``mesh``; the largest is the guess."""
    points, normals = _spread_samples(mesh, _N_SAMPLES)
    if len(points) < 10:
        return dict(_PRIOR)
    low, high = points.min(axis=0), points.max(axis=0)
    points = (points - (low + high) / 2) / max(float(np.linalg.norm(high - low)), 1e-300)
    asymmetry = [_mirror_error(points, axis) for axis in range(3)]
    scores = {}
    for name, turn in TURNS.items():
        axis = "xyz".index(name[1])
        sideways = (asymmetry[(axis + 1) % 3], asymmetry[(axis + 2) % 3])
        features = up_features(points @ turn.T, normals @ turn.T, asymmetry[axis], sideways)
        scores[name] = _PRIOR[name] + float(sum(_WEIGHT[key] * value for key, value in features.items()))
    return scores


def up_features(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    asymmetry_vertical: float,
    asymmetry_sideways: tuple[float, float],
) -> dict[str, float]:
    """What speaks for y being up, each roughly in [0, 1], from samples (n, 3) in diagonals and their normals.

    stability: how far inside its support polygon the centroid stands; horizontal: share of the area that is level;
    upright: top and bottom differ more than left and right do; round: more than front and back do, too; feet: little
    surface near the ground.  The asymmetries are mean mirror distances (diagonals).
    """
    height = points[:, 1] - points[:, 1].min()
    tall = max(float(height.max()), 1e-9)
    plan = points[:, [0, 2]]
    ground = plan[height < 0.03 * tall + 0.005]
    return {
        "stability": _stability(ground, plan),
        "horizontal": float((np.abs(normals[:, 1]) > 0.95).mean()),
        "upright": float(np.clip(asymmetry_vertical - min(asymmetry_sideways), -0.1, 0.1)),
        "round": float(np.clip(asymmetry_vertical - max(asymmetry_sideways), 0.0, 0.1)),
        "feet": 1.0 - min(1.0, len(ground) / (0.25 * len(points))),
    }


def _stability(ground: np.ndarray, plan: np.ndarray) -> float:
    """Distance of the centroid from the rim of the support polygon, relative to the plan's radius; 0 outside."""
    if len(ground) < 4:
        return 0.0
    try:
        hull = ConvexHull(ground)
    except QhullError:  # a line: nothing stands on that
        return 0.0
    centre = plan.mean(axis=0)
    inside = -(hull.equations[:, :2] @ centre + hull.equations[:, 2]).max()
    radius = max(float(np.ptp(plan, axis=0).min()) / 2, 1e-9)
    return float(np.clip(inside / radius, 0.0, 1.0))


def _mirror_error(points: np.ndarray, axis: int) -> float:
    """Mean distance (diagonals) between the points and their mirror image along ``axis`` through the box's centre."""
    mirrored = points.copy()
    mirrored[:, axis] *= -1
    distance, _ = cKDTree(points).query(mirrored)
    return float(distance.mean())


def _spread_samples(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
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
