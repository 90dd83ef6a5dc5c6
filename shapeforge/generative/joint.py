"""Joint analysis and synthesis (§5): the machine as a prior on the deformed points of each shape.

The product of a Gaussian and a Beta is neither (the print is silent here).  The machine's reconstruction of a shape,
with the precision of what the machine leaves unexplained on shapes it never saw, is a Gaussian that the fit can take.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from shapeforge.generative.inference import decode, infer
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import Observations, observe


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """A Gaussian on every point of every shape: ``mean`` (T, K, 3) in normal coordinates, NaN where the point's part
    is absent, and ``precision`` (T, K, 3) in 1/diagonals^2, 0 there.  ``prior[t]`` is the pair of shape t."""

    mean: Float[np.ndarray, "T K 3"]
    precision: Float[np.ndarray, "T K 3"]

    def __len__(self) -> int:
        return len(self.mean)

    def __getitem__(self, shape: int) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]]:
        return self.mean[shape], self.precision[shape]


def family_prior(machine: BetaShapeMachine, observations: Observations, strength: float = 1.0) -> GaussianPrior:
    """The prior of every shape: the machine's reconstruction from the top, with precision ``strength`` / spread^2."""
    latents = infer(machine, observations.values, observations.exists)
    mean = machine.to_positions(decode(machine, latents.top), observations.exists)
    precision = np.broadcast_to(strength / machine.spread.astype(float) ** 2, mean.shape)
    return GaussianPrior(mean, np.where(np.isfinite(mean), precision, 0))


def shape_prior(
    machine: BetaShapeMachine, positions: Float[np.ndarray, "K 3"], strength: float = 1.0
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]]:
    """(mean, precision) for one shape's corresponding points (K, 3) in normal coordinates, NaN where absent."""
    seen = observe(positions[None], machine.part, machine.part_names, machine.low, machine.high)
    return family_prior(machine, seen, strength)[0]


def reconstruct(
    machine: BetaShapeMachine, positions: Float[np.ndarray, "T K 3"], from_top: bool = True
) -> tuple[Float[np.ndarray, "T K 3"], Bool[np.ndarray, "T L"]]:
    """Shapes as the machine gives them back (from the top, or from H1), and the parts it took them to have."""
    seen = observe(positions, machine.part, machine.part_names, machine.low, machine.high)
    latents = infer(machine, seen.values, seen.exists)
    return machine.to_positions(decode(machine, latents.top if from_top else latents), seen.exists), seen.exists


def held_out_errors(
    machine: BetaShapeMachine, positions: Float[np.ndarray, "n K 3"], surfaces: Sequence[np.ndarray]
) -> Float[np.ndarray, " n"]:
    """How far the machine's idea of shapes that it did not learn from is from their surfaces, in diagonals.

    ``surfaces`` holds points (P, 3) on every shape, in the frame of the corresponding ``positions``: what the shapes
    are, whatever corresponds to what.  Mean distance to the nearest point, from the points that the machine gives back
    (from the top) to the surface and the other way, averaged over both ways.
    """
    found = []
    for points, surface in zip(reconstruct(machine, positions)[0], surfaces, strict=True):
        again = points[np.isfinite(points).all(axis=1)]
        found.append((cKDTree(surface).query(again)[0].mean() + cKDTree(again).query(surface)[0].mean()) / 2)
    return np.array(found)


def is_worse(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"]) -> bool:
    """Whether errors of the same shapes rose by more than the standard error of their mean rise: less is chance."""
    rise = after - before
    return bool(rise.mean() > rise.std() / np.sqrt(max(len(rise) - 1, 1)))


def mostly_falls(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"]) -> bool:
    """Whether more shapes' errors fall than rise, by more than the standard deviation of the number that would rise if
    either were as likely: a few shapes that change much don't decide."""
    n = len(before)
    return bool((after > before).sum() <= (n - np.sqrt(n)) / 2)
