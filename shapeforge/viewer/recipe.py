"""What the Synthesize place remembers of a shape: how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from shapeforge.generative.inference import Latents

Place = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Recipe:
    """How a shape was made: the base, slider values (standard deviations) and which parts, and from which shapes
    the user wants some of them (``taken``); template points that are held somewhere (``pins``), and the sliders that
    stay when the shape follows these (``locked``); how its mesh is made: the ``route`` (a key of ``ROUTES``), and
    whether its parts are united into one solid (``union``).  Enough to make it again."""

    label: str
    base: Latents
    sliders: Mapping[int, float] = field(default_factory=dict)
    parts_on: Mapping[int, bool] = field(default_factory=dict)
    origin: str = ""
    taken: Mapping[int, str] = field(default_factory=dict)
    route: str = "parts"
    union: bool = False
    pins: Mapping[int, Place] = field(default_factory=dict)
    locked: frozenset[int] = frozenset()
