"""What the model believes about one shape: the mean-field distribution Q restricted to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Q of one shape: deformed template points, label probabilities, which parts exist.

    The P x K correspondence is a function of these and is recomputed, never stored.
    ``template`` is the index (into the family's list of templates) that ``deformed`` refers to;
    ``maps`` and ``offsets`` are the linear map of each part (y -> maps[l] @ y + offsets[l]);
    ``evidence`` is the part painted by the user per point, -1 where nothing was painted;
    ``misfit`` the log odds of each part's existence, by which it was kept or switched off (NaN: not asked);
    ``lent`` the parts that this template lacks and another exemplar's beliefs bring: (part, those beliefs);
    ``copies`` is the part (C = P) of surface points on a copy of a component that φ1 took for another part, -1
    elsewhere, empty where there is none (see ``deformation.copies``): it has a label, and no template point of its own;
    ``spare`` (S = K) marks template points of components that the shape lacks though it has their part, as the outer
    ones of an exemplar's four engines on a shape with two; empty where there are none (see ``deformation.components``);
    ``pose`` turns the shape as the family lies (§7): positions here are the shape's own, ``x @ pose.T`` the family's.
    """

    template: int
    deformed: Float[np.ndarray, "K 3"]
    variance: Float[np.ndarray, "K 3"]
    maps: Float[np.ndarray, "L 3 3"]
    offsets: Float[np.ndarray, "L 3"]
    segmentation: Float[np.ndarray, "P L"]
    active: Bool[np.ndarray, " L"]
    evidence: Int[np.ndarray, " P"]
    misfit: Float[np.ndarray, " L"]
    lent: tuple[tuple[int, Beliefs], ...] = ()
    copies: Int[np.ndarray, " C"] = field(default_factory=lambda: np.zeros(0, np.int32))
    spare: Bool[np.ndarray, " S"] = field(default_factory=lambda: np.zeros(0, bool))
    pose: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))

    def alive(self, label: Int[np.ndarray, " K"]) -> Bool[np.ndarray, " K"]:
        """Which template points (K,), whose parts are ``label``, the shape has: active parts', and no spare ones."""
        there = self.active[label]
        return there & ~self.spare if len(self.spare) else there

    def to_family(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Positions (n, 3) on the shape, turned as the family lies: what shapes are compared in, and learnt from."""
        return positions if self.lies_as_the_family else positions @ self.pose.T

    def from_family(
        self, mean: Float[np.ndarray, "n 3"], precision: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """A Gaussian on points as the family lies, turned as the shape does (``pose`` takes axes to axes)."""
        if self.lies_as_the_family:
            return mean, precision
        return mean @ self.pose, precision @ np.abs(self.pose)

    @property
    def lies_as_the_family(self) -> bool:
        """Whether the shape needs no turning."""
        return bool(np.array_equal(self.pose, np.eye(3)))
