"""What the model believes about one shape: the mean-field distribution Q restricted to it."""

from __future__ import annotations

from dataclasses import dataclass

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
    ``lent`` the parts that this template lacks and another exemplar's beliefs bring: (part, those beliefs).
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
