"""The learnt descriptors as a transformer of scikit-learn: corresponding points in, numbers out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from shapeforge.collection.iterate import last
from shapeforge.generative.descriptors import describe_shapes
from shapeforge.generative.learning import learn_machine
from shapeforge.generative.machine import layer_sizes
from shapeforge.generative.observations import Observations, observe


class ShapeDescriptors(TransformerMixin, BaseEstimator):
    """``fit`` learns a machine, ``transform`` describes shapes by its top layer and their parts (see ``descriptors``).

    Shapes are rows: corresponding points (T, K, 3) or (T, 3K) in normal coordinates, NaN where a point is absent.
    ``part`` (K,) is the part of every point (one part if None), ``part_names`` its names.  ``layers``, ``epochs`` and
    ``existence_weight`` are those of ``learn_machine`` and ``describe_shapes``; ``random_state`` seeds the learning.
    After ``fit``: ``machine_``, and ``state_``, the last state of learning.
    """

    def __init__(
        self,
        part: Int[np.ndarray, " K"] | None = None,
        part_names: Sequence[str] | None = None,
        *,
        layers: int | None = None,
        epochs: int | None = None,
        existence_weight: float = 0.25,
        random_state: int = 0,
    ) -> None:
        self.part, self.part_names = part, part_names
        self.layers, self.epochs = layers, epochs
        self.existence_weight, self.random_state = existence_weight, random_state

    def fit(self, X: Float[np.ndarray, "T *A"], y: object = None) -> ShapeDescriptors:
        """Learn from the shapes ``X``; ``y`` is not used.  Raises ValueError as ``learn_machine`` does."""
        points = _points(X)
        part = np.zeros(points.shape[1], np.int64) if self.part is None else np.asarray(self.part)
        if len(part) != points.shape[1]:
            raise ValueError(
                f"part: wanted one number for each of {points.shape[1]} points, got {len(part)}; "
                "usually the shapes and the parts come from different fits"
            )
        names = tuple(f"part {i}" for i in range(int(part.max()) + 1)) if self.part_names is None else self.part_names
        observations = observe(points, part, tuple(names))
        sizes = layer_sizes(np.bincount(part, minlength=len(names)).tolist(), len(points), self.layers)
        states = learn_machine(
            observations, rng=np.random.default_rng(self.random_state), epochs=self.epochs, sizes=sizes
        )
        self.state_ = last(states)
        self.machine_ = self.state_.machine
        self.n_features_in_ = points[0].size
        return self

    def transform(self, X: Float[np.ndarray, "T *A"]) -> Float[np.ndarray, "T F"]:
        """Descriptors (T, F): near means similar, by the L1 distance."""
        check_is_fitted(self)
        return describe_shapes(self.machine_, self._observed(X), self.existence_weight)

    def get_feature_names_out(self, input_features: object = None) -> np.ndarray:
        """Names of the F numbers: units of the top layer, then the parts."""
        check_is_fitted(self)
        top = [f"unit {index}" for index in range(self.machine_.sizes[-1])]
        return np.array([*top, *(f"has {name}" for name in self.machine_.part_names)], dtype=object)

    def _observed(self, X: np.ndarray) -> Observations:
        points, machine = _points(X), self.machine_
        if points.shape[1] != machine.n_points:
            raise ValueError(
                f"X: wanted shapes of {machine.n_points} points, got {points.shape[1]}; "
                "usually they correspond to another family"
            )
        return observe(points, machine.part, machine.part_names, machine.low, machine.high)


def _points(shapes: np.ndarray) -> np.ndarray:
    """Shapes (T, K, 3) or (T, 3K) as (T, K, 3)."""
    shapes = np.asarray(shapes, float)
    if shapes.ndim not in (2, 3) or shapes[0].size % 3 or (shapes.ndim == 3 and shapes.shape[2] != 3):
        raise ValueError(f"X: wanted (shapes, points, 3) or (shapes, 3 x points), got {shapes.shape}")
    return shapes.reshape(len(shapes), -1, 3)
