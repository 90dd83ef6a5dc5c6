"""How long a fit still takes: what its rounds cost beside each other, and how long those that are done have taken."""

from __future__ import annotations

import time
from collections.abc import Callable

from shapeforge.deformation import family
from shapeforge.deformation.fit import EXEMPLARS_PER_SHAPE

LATE_SHARE, LATE = 0.3, 1.7
"""The last rounds of a phase, its share, cost so much more: σ1 is sharp, and parts are switched off on trial."""

LINKING, LINKED = 18.0, 1.0
"""What the start of the family's templates costs: per shape that is asked, and per shape that gets its start."""

FACES = 4.0
"""What faces and corresponding points cost after the rounds.  The unit of all: one candidate in one early round on one
shape; measured (processor time) on generated chairs with one, two and three exemplars."""


def round_costs(of: int, exemplars: int, family_from: int, shapes: int) -> list[float]:
    """What rounds 1 to ``of`` cost per shape; the family's own templates take over after round ``family_from``."""
    costs = []
    first = of if exemplars < 2 else family_from
    for number in range(1, of + 1):
        late = LATE if number > (1 - LATE_SHARE) * first else 1.0
        if number <= first:
            costs.append(min(exemplars, EXEMPLARS_PER_SHAPE) * late)
            continue
        start = LINKED + LINKING * min(family.ASKED, shapes) / max(shapes, 1) if number == first + 1 else 0.0
        costs.append(start + (2.0 if number - first <= family.TRIAL_ROUNDS else LATE))
    return costs


class Pace:
    """Seconds left of a fit that goes on after round ``begun``; ``clock()`` in seconds."""

    def __init__(self, begun: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._begun, self._clock, self._start = begun, clock, clock()

    def left(self, costs: list[float], done: float) -> float | None:
        """Seconds left after ``done`` of the rounds that cost ``costs`` (3.5: half of the fourth); None: not known."""
        whole = int(done)
        spent = sum(costs[self._begun : whole]) + (done - whole) * (costs[whole] if whole < len(costs) else 0.0)
        if spent <= 0:
            return None
        rest = sum(costs[self._begun :]) + FACES - spent
        return (self._clock() - self._start) / spent * max(rest, 0.0)
