"""A small family with known correspondences: side chairs, armchairs, benches, swivel chairs of boxes and tubes."""

from __future__ import annotations

import numpy as np

PART_NAMES = ("seat", "back", "legs", "arms", "column", "base")


def _box_points(n: int) -> np.ndarray:
    """n points on the surface of the cube [-1, 1]^3, always the same."""
    rng = np.random.default_rng(7)
    points = rng.uniform(-1, 1, (n, 3))
    axis = np.arange(n) % 3
    points[np.arange(n), axis] = np.where((np.arange(n) // 3) % 2, 1.0, -1.0)
    return points


def _tube_points(n: int) -> np.ndarray:
    rng = np.random.default_rng(8)
    angle = rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([np.cos(angle), rng.uniform(-1, 1, n), np.sin(angle)])


def chair_family(
    n_shapes: int, *, rng: np.random.Generator, density: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (T, K, 3) with diagonal 1 and NaN where absent, part (K,), class (T,): side, arm, bench, swivel."""
    counts = {name: max(6, round(density * n)) for name, n in zip(PART_NAMES, (260, 260, 70, 90, 90, 100), strict=True)}
    shapes, classes = [], []
    for _ in range(n_shapes):
        kind = int(rng.integers(4))
        width = rng.uniform(0.8, 1.3) if kind == 2 else rng.uniform(0.4, 0.6)
        depth, thick = rng.uniform(0.4, 0.6), rng.uniform(0.02, 0.06)
        height, back_height = rng.uniform(0.35, 0.55), rng.uniform(0.3, 0.7)
        tilt, curve = rng.uniform(0, 0.3), rng.uniform(-0.1, 0.1)
        leg, splay = rng.uniform(0.02, 0.05), rng.uniform(0, 0.12)
        arm_height, arm_length = rng.uniform(0.15, 0.3), rng.uniform(0.5, 0.9)
        base_radius = rng.uniform(0.2, 0.32)
        parts = {}
        parts["seat"] = _box_points(counts["seat"]) * [width / 2, thick, depth / 2] + [0, height, 0]
        back = _box_points(counts["back"]) * [width / 2, back_height / 2, thick] + [0, back_height / 2, -depth / 2]
        back[:, 2] -= tilt * back[:, 1] + curve * (back[:, 0] / width) ** 2
        parts["back"] = back + [0, height, 0]
        one = _box_points(counts["legs"]) * [leg, height / 2, leg]
        legs = []
        for x in (-1, 1):
            for z in (-1, 1):
                away = splay * (0.5 - one[:, 1] / height)
                centre = np.array([x * (width / 2 - leg), height / 2, z * (depth / 2 - leg)])
                legs.append(one + centre + np.outer(away, [x, 0, z]))
        parts["legs"] = np.concatenate(legs)
        bar = _box_points(counts["arms"]) * [0.025, 0.02, arm_length * depth / 2]
        arms = [bar + [x * width / 2, height + arm_height, -depth / 2 * (1 - arm_length)] for x in (-1, 1)]
        parts["arms"] = np.concatenate(arms)
        column = _tube_points(counts["column"]) * [leg, height / 2, leg] + [0, height / 2, 0]
        parts["column"] = column
        base = _tube_points(counts["base"]) * [base_radius, 0.02, base_radius]
        parts["base"] = base + [0, 0.02, 0]
        present = {"seat", "back"} | ({"column", "base"} if kind == 3 else {"legs"})
        if kind == 1 or (kind == 3 and rng.random() < 0.3):
            present.add("arms")
        for name in set(PART_NAMES) - present:
            parts[name] = np.full_like(parts[name], np.nan)
        whole = np.concatenate([parts[name] for name in PART_NAMES])
        low, high = np.nanmin(whole, axis=0), np.nanmax(whole, axis=0)
        shapes.append((whole - (low + high) / 2) / np.linalg.norm(high - low))
        classes.append(kind)
    sizes = [len(parts[name]) for name in PART_NAMES]
    return np.array(shapes), np.repeat(np.arange(len(PART_NAMES)), sizes), np.array(classes)
