"""Fine classes by the nearest neighbour among descriptors (§6: 10 training examples a class, L1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist


@dataclass(frozen=True)
class ClassificationScore:
    """Share of right classes, mean over random splits, with its standard deviation between splits.

    ``n_training`` and ``n_test`` shapes per split; ``chance`` is the share of the test shapes' largest class.
    """

    accuracy: float
    deviation: float
    chance: float
    n_training: int
    n_test: int
    n_classes: int
    n_splits: int


def nearest_neighbour_accuracy(
    descriptors: Float[np.ndarray, "T F"], classes: Sequence[str], per_class: int = 10, *, n_splits: int = 50,
    rng: np.random.Generator,
) -> ClassificationScore | None:  # fmt: skip
    """1-nearest-neighbour accuracy under the L1 distance with ``per_class`` random training shapes of every class.

    A class with too few shapes gives half of them (rounded down) to training; one with a single shape is left out.
    None when fewer than two classes remain.
    """
    if len(descriptors) != len(classes):
        raise ValueError(
            f"classes: wanted one per descriptor ({len(descriptors)}), got {len(classes)}. "
            "Match them by shape name first."
        )
    if per_class < 1:
        raise ValueError(f"per_class: wanted at least 1 training shape a class, got {per_class}.")
    names, member = np.unique(np.asarray(classes, str), return_inverse=True)
    members = [found for c in range(len(names)) if len(found := np.flatnonzero(member == c)) >= 2]
    if len(members) < 2:
        return None
    distance = cdist(descriptors, descriptors, "cityblock")
    accuracies, chance, n_training, n_test = [], 0.0, 0, 0
    for _ in range(n_splits):
        training, test = [], []
        for found in members:
            shuffled = rng.permutation(found)
            n = min(per_class, len(found) // 2) if len(found) <= per_class else per_class
            training.append(shuffled[:n])
            test.append(shuffled[n:])
        known, asked = np.concatenate(training), np.concatenate(test)
        nearest = known[distance[np.ix_(asked, known)].argmin(axis=1)]
        accuracies.append(float((member[nearest] == member[asked]).mean()))
        chance, n_training, n_test = max(len(t) for t in test) / len(asked), len(known), len(asked)
    return ClassificationScore(
        float(np.mean(accuracies)), float(np.std(accuracies)), chance, n_training, n_test, len(members), n_splits
    )
