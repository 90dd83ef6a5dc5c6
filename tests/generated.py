"""Generated shapes as the fit takes them: prepared, with the true part of every face."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shapeforge.collection.families import Generated
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Shape


def prepared(made: Sequence[Generated], n_points: int) -> list[Shape]:
    """Shapes in the poses they were generated in, sampled by their numbers as seeds."""
    return [
        prepare_shape(f"{i}_{one.name}", one.mesh, n_points=n_points, up="keep", rng=np.random.default_rng(i))
        for i, one in enumerate(made)
    ]


def true_parts(made: Sequence[Generated], names: Sequence[str]) -> list[np.ndarray]:
    """For every shape the part of each face (F,), as an index into ``names``."""
    return [np.array([list(names).index(one.part_names[part]) for part in one.faces], np.int32) for one in made]
