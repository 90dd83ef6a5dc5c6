"""The five factors of the deformation model: their covariances and constants (§4, φ1 to φ5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from shapeforge.deformation import _kernels

LOG_EPSILON = float(np.log(1e-3))
"""φ4: log probability that a point bears another label than the template point it corresponds to."""

PHI_RANGE = (0.5, 0.6)
"""φ5 is clamped here: below one half neighbours would repel each other, which no segmentation means."""

DESCRIPTOR_WEIGHT = 0.5
"""φ3's exponent: shape diameters under three normalisations correlate at .99, a diagonal Σ3 counts them thrice."""

NORMAL_WEIGHT = 6.0
"""Nats that φ3 charges for surfaces at right angles. Unsigned: polygon soup has no orientation. Not in the print."""

FLOORS = {"unary": 0.008, "smooth": 0.02, "descriptor": 0.02, "segment": 0.02}
"""Smallest standard deviations (diagonals; descriptor units). Without them Σ2 collapses and templates go rigid."""


@dataclass(frozen=True, eq=False)
class Covariances:
    """Diagonal covariances (variances): Σ1 and Σ2 (3,) in squared diagonals, Σ3 and Σ5 (10,) in descriptor units."""

    unary: Float[np.ndarray, " 3"]
    smooth: Float[np.ndarray, " 3"]
    descriptor: Float[np.ndarray, " d"]
    segment: Float[np.ndarray, " d"]

    def sigmas(self) -> dict[str, np.ndarray]:
        """Standard deviations by factor name, for curves and reports."""
        return {name: np.sqrt(getattr(self, name)) for name in FLOORS}


def floored(name: str, variance: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """The variance with this factor's floor applied."""
    return np.maximum(variance, FLOORS[name] ** 2)


def initial_covariances(n_descriptors: int = 10) -> Covariances:
    """Wide enough for the affine start: 5% of the diagonal for φ1, 2% for φ2, .2 for descriptors."""
    return Covariances(
        np.full(3, 0.05**2), np.full(3, FLOORS["smooth"] ** 2), np.full(n_descriptors, 0.2**2),
        np.full(n_descriptors, 0.1**2),
    )  # fmt: skip


def attraction(
    descriptors: Float[np.ndarray, "P d"],
    offsets: Int[np.ndarray, " P1"],
    neighbour: Int[np.ndarray, " M"],
    segment: Float[np.ndarray, " d"],
) -> Float[np.ndarray, " M"]:
    """logit Φ of every neighbour pair (φ5), with the exponent divided by the descriptor's dimension and Φ clamped."""
    return _kernels.pair_attraction(offsets, neighbour, descriptors, 1.0 / segment, *PHI_RANGE)
