"""Part labels of faces: reading and writing ``.seg`` files and ``labels.json``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

UNLABELLED = -1


@dataclass(frozen=True)
class PartNames:
    """The parts of a family, in order: part ``l`` is called ``names[l]`` and has id ``ids[l]`` in ``.seg`` files."""

    ids: tuple[int, ...]
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class FaceLabels:
    """Labels painted on one shape: part index (0..L-1) per face record, -1 where nothing is said."""

    faces: Int[np.ndarray, " F"]
