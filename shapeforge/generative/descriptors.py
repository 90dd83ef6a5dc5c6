"""What the machine says of a shape as a whole: numbers in which near means similar (§6, fine-grained classes)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from shapeforge.generative.inference import infer
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import Observations


def describe_shapes(
    machine: BetaShapeMachine, observations: Observations, existence_weight: float = 0.25
) -> Float[np.ndarray, "T F"]:
    """q of the top layer beside weighted E (T, O + L), for 1-nearest-neighbour with the L1 distance.

    The top alone knows the parts only through their shape; one part more or less counts as ``existence_weight`` x O
    units turned over (O the size of the top).
    """
    latents = infer(machine, observations.values, observations.exists)
    weight = existence_weight * latents.top.shape[1]
    return np.concatenate([latents.top, weight * observations.exists], axis=1).astype(np.float32)
