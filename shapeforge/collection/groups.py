"""Groups of similar shapes and the exemplar of each (§4, clustering)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Groups:
    """``group[t]`` is the group of shape t (0..n-1), ``exemplars[g]`` the shape index that stands for group g.

    ``embedding`` places the shapes in the plane by similarity (near means similar); ``excluded`` shapes have group -1.
    """

    names: tuple[str, ...]
    group: Int[np.ndarray, " T"]
    exemplars: Int[np.ndarray, " G"]
    embedding: Float[np.ndarray, "T 2"]
    dissimilarity: Float[np.ndarray, "T T"] | None = None

    def members(self, g: int) -> Int[np.ndarray, " m"]:
        """Indices of the shapes of group g."""
        return np.flatnonzero(self.group == g)

    def __len__(self) -> int:
        return len(self.exemplars)
