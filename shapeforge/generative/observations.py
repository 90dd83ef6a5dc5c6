"""What the machine sees: corresponding points in the unit interval, and which parts exist (§5, "observed variables").

The print bounds every Beta by its coordinate's minimum and maximum without saying over what; here one cube holds the
family, so that an error of 1% means the same along x, y and z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

MARGIN = 0.1
"""The family's own extent is mapped to [MARGIN, 1 - MARGIN]: new shapes may be a little larger than any seen."""

LIMIT = 0.02
"""Values are clipped to [LIMIT, 1 - LIMIT], so that no logarithm runs away."""

PRESENT = 0.25
"""A part exists on a shape when at least this share of its points was found there."""


@dataclass(frozen=True, eq=False)
class Observations:
    """D and E of T shapes.  ``values`` lie in (0, 1); where a part is absent they hold the family's mean and count for
    nothing.  ``part`` is the part of each point; ``low`` and ``high`` (normal coordinates) are the corners of the cube
    that was mapped to [MARGIN, 1 - MARGIN]."""

    values: Float[np.ndarray, "T K 3"]
    exists: Bool[np.ndarray, "T L"]
    part: Int[np.ndarray, " K"]
    part_names: tuple[str, ...]
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]

    @property
    def n_shapes(self) -> int:
        """Number of shapes T."""
        return len(self.values)

    @property
    def diagonals_per_unit(self) -> float:
        """Length in bounding-box diagonals of a step of 1 in ``values``: errors are reported in diagonals."""
        return diagonals_per_unit(self.low, self.high)

    def subset(self, shapes: Int[np.ndarray, " n"]) -> Observations:
        """The same family restricted to some shapes, by index."""
        return Observations(self.values[shapes], self.exists[shapes], self.part, self.part_names, self.low, self.high)

    def positions(self) -> Float[np.ndarray, "T K 3"]:
        """Normal coordinates again (T, K, 3), NaN where the part is absent."""
        return to_positions(self.values, self.exists, self.part, self.low, self.high)


def diagonals_per_unit(low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]) -> float:
    """Length in diagonals of a step of 1 in the unit interval, for a cube from ``low`` to ``high``."""
    return float((high[0] - low[0]) / (1 - 2 * MARGIN))


def observe(
    positions: Float[np.ndarray, "T K 3"],
    part: Int[np.ndarray, " K"],
    part_names: tuple[str, ...],
    low: Float[np.ndarray, " 3"] | None = None,
    high: Float[np.ndarray, " 3"] | None = None,
) -> Observations:
    """Observations from corresponding points (T, K, 3) in normal coordinates, NaN where a point is absent.

    A part with too few points on a shape is taken as absent there; single points missing from a part that exists are
    filled with the family's mean part, mapped affinely onto the points that were found.  ``low`` and ``high`` keep
    the cube of an earlier family (to describe new shapes with a machine already learned).

    Raises ValueError when no point is present at all, or ``part`` names a part that does not exist.
    """
    n_parts = len(part_names)
    if part.min(initial=0) < 0 or part.max(initial=0) >= n_parts:
        raise ValueError(
            f"part: wanted values in 0..{n_parts - 1}, got {part.min()}..{part.max()}; "
            "usually the points and the part names come from different fits"
        )
    found = np.isfinite(positions).all(axis=2)
    if not found.any():
        raise ValueError("positions: wanted some finite points, got none; usually the family was never fitted")
    if low is None or high is None:
        low, high = _cube(positions[found])
    exists = np.zeros((len(positions), n_parts), dtype=bool)
    filled = np.zeros(positions.shape)
    for index in range(n_parts):
        members = np.flatnonzero(part == index)
        if len(members):
            exists[:, index] = found[:, members].mean(axis=1) >= PRESENT
            filled[:, members] = _fill(positions[:, members], found[:, members], exists[:, index], (low + high) / 2)
    return Observations(
        to_values(filled, low, high).astype(np.float32), exists, part.astype(np.int32), part_names, low, high
    )


def to_values(
    positions: Float[np.ndarray, "*n 3"], low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Normal coordinates in (0, 1), clipped to [LIMIT, 1 - LIMIT]."""
    return np.clip(MARGIN + (1 - 2 * MARGIN) * (positions - low) / (high - low), LIMIT, 1 - LIMIT)


def to_positions(
    values: Float[np.ndarray, "n K 3"],
    exists: Bool[np.ndarray, "n L"],
    part: Int[np.ndarray, " K"],
    low: Float[np.ndarray, " 3"],
    high: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "n K 3"]:
    """Values in (0, 1) back in normal coordinates, NaN where the part of a point is absent."""
    positions = low + (values - MARGIN) / (1 - 2 * MARGIN) * (high - low)
    positions[~exists[:, part]] = np.nan
    return positions


def _cube(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The smallest cube around all points, as its corners (3,), (3,)."""
    smallest, largest = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    centre, half = (smallest + largest) / 2, max(float((largest - smallest).max()) / 2, 1e-6)
    return centre - half, centre + half


def _fill(positions: np.ndarray, found: np.ndarray, exists: np.ndarray, nowhere: np.ndarray) -> np.ndarray:
    """One part (T, n, 3) without gaps: absent parts get the mean part, single holes an affine map of it."""
    if not exists.any():
        return np.broadcast_to(nowhere, positions.shape)
    counted = found & exists[:, None]
    total = np.where(counted[..., None], positions, 0).sum(axis=0)
    times = counted.sum(axis=0)[:, None]
    overall = total.sum(axis=0) / max(int(times.sum()), 1)
    mean = np.where(times > 0, total / np.maximum(times, 1), overall)
    filled = np.where(counted[..., None], positions, mean)
    design = np.column_stack([mean - overall, np.ones(len(mean))])
    # A ridge towards the mean part itself: a hole in a flat part must not be filled by a wild out-of-plane map.
    ridge = np.diag([*np.repeat(1e-2 * max(float(((mean - overall) ** 2).sum()), 1e-12) / 3, 3), 1e-9])
    for shape in np.flatnonzero(exists & ~found.all(axis=1)):
        have = found[shape]
        normal = design[have].T @ design[have] + ridge
        change = np.linalg.solve(normal, design[have].T @ (positions[shape, have] - mean[have]))
        filled[shape, ~have] = mean[~have] + design[~have] @ change
    return filled
