"""Part templates: the points that the whole family is explained with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class PartTemplates:
    """The K template points of all parts together (Y in the paper).

    ``label`` is the part of each point, ``component`` the symmetric copy it belongs to (left or right leg; counted
    within its part), ``neighbours`` indices within the same part (symmetric pairs, -1 padded).
    """

    points: Float[np.ndarray, "K 3"]
    normals: Float[np.ndarray, "K 3"]
    label: Int[np.ndarray, " K"]
    component: Int[np.ndarray, " K"]
    neighbours: Int[np.ndarray, "K n"]
    descriptors: Float[np.ndarray, "K 10"]
    part_names: tuple[str, ...]
    source: str = ""

    @property
    def n_points(self) -> int:
        """Number of template points K."""
        return len(self.points)

    @property
    def n_parts(self) -> int:
        """Number of part labels L."""
        return len(self.part_names)
