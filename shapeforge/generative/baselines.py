"""What the machine is compared with: principal components per combination of parts, and kernels on their scores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from shapeforge.generative.observations import LIMIT, Observations


@dataclass(frozen=True, eq=False)
class PatternComponents:
    """PCA of one combination of parts: ``mean`` (A,), ``axes`` (c, A), ``scores`` (n, c) of the training shapes."""

    exists: Bool[np.ndarray, " L"]
    mean: Float[np.ndarray, " A"]
    axes: Float[np.ndarray, "c A"]
    scores: Float[np.ndarray, "n c"]


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """One PCA per combination of parts seen in training, with how often each was seen."""

    patterns: tuple[PatternComponents, ...]
    weight: Float[np.ndarray, " S"]


def fit_principal_components(observations: Observations, components: int = 10) -> PrincipalComponents:
    """PCA of the values of the shapes with the same parts, at most ``components`` each (fewer with few shapes)."""
    states, which = np.unique(observations.exists, axis=0, return_inverse=True)
    patterns = []
    for index, state in enumerate(states):
        flat = observations.values[which == index].reshape((which == index).sum(), -1).astype(float)
        mean = flat.mean(axis=0)
        left, strength, right = np.linalg.svd(flat - mean, full_matrices=False)
        keep = min(components, max(len(flat) - 1, 0))
        patterns.append(PatternComponents(state, mean, right[:keep], left[:, :keep] * strength[:keep]))
    return PrincipalComponents(tuple(patterns), np.bincount(which) / len(which))


def reconstruct_by_components(model: PrincipalComponents, observations: Observations) -> Float[np.ndarray, "T K 3"]:
    """Every shape projected onto the components of its combination of parts (or of the most similar one seen)."""
    values = np.empty(observations.values.shape)
    states = np.stack([pattern.exists for pattern in model.patterns])
    for shape, state in enumerate(observations.exists):
        pattern = model.patterns[int((states != state).sum(axis=1).argmin())]
        moved = observations.values[shape].reshape(-1) - pattern.mean
        values[shape] = (pattern.mean + (moved @ pattern.axes.T) @ pattern.axes).reshape(-1, 3)
    return values


def draw_from_components(
    model: PrincipalComponents, n: int, *, rng: np.random.Generator, kernel: bool = False
) -> tuple[Float[np.ndarray, "n K 3"], Bool[np.ndarray, "n L"]]:
    """n new shapes (values in (0, 1), parts): Gaussian scores, or with ``kernel`` a Gaussian kernel on a shape's own.

    The kernel's width is Silverman's for the number of components.
    """
    chosen: Int[np.ndarray, " n"] = rng.choice(len(model.weight), n, p=model.weight)
    rows, states = [], []
    for index in chosen:
        pattern = model.patterns[index]
        count, width = pattern.scores.shape
        deviation = pattern.scores.std(axis=0)
        noise = deviation * rng.standard_normal(width)
        if kernel:
            bandwidth = (4 / ((width + 2) * count)) ** (1 / (width + 4))
            noise = pattern.scores[rng.integers(count)] + bandwidth * noise
        rows.append(np.clip(pattern.mean + noise @ pattern.axes, LIMIT, 1 - LIMIT).reshape(-1, 3))
        states.append(pattern.exists)
    return np.stack(rows), np.stack(states)
