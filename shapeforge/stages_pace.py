"""How long a fit still takes: what its rounds cost beside each other, and how long those that are done have taken.

The figures are milliseconds of processor time a shape, on one machine; only what they are beside each other counts.
By fits of generated chairs and of scanned furniture with one and two exemplars, 700 and 5000 points a shape.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from shapeforge.deformation import family
from shapeforge.deformation.fit import EXEMPLARS_PER_SHAPE, HEARD_ROUNDS

START, START_POINTS = 70.0, 8.0
"""The affine start of a shape; and for every thousand of its points."""

ROUND, ROUND_POINTS = 4.0, 7.2
"""One candidate in an early round; and for every thousand points."""

LATE_SHARE, LATE = 0.5, 1.4
"""The last rounds of the exemplars, this share, cost so much more: σ1 is sharp, and parts are switched off on trial."""

LINKING_POINTS = 60.0
"""What the start of the family's templates costs: for every shape that is asked, and every thousand points."""

TRIAL, FAMILY = 2.4, 1.6
"""A round of the family's templates, as long as both starts are tried and afterwards, in rounds of one candidate."""

COPIES = 20.0
"""Looking for copies of components, after the last round."""

FACES, FACES_POINTS = 18.0, 5.2
"""Labels and corresponding points after the rounds, for every thousand faces, and every thousand points."""


@dataclass(frozen=True)
class FitCosts:
    """What a fit costs a shape: ``shapes`` of ``points`` samples and ``faces`` triangles each, in the mean.

    ``of`` rounds, of which the family's own templates have those after ``family_from``.  ``heard`` is how many
    exemplars are still tried on a shape, in the mean, once those that explain it worst were given up.
    """

    shapes: int
    points: float | int
    faces: float | int
    exemplars: int
    of: int
    family_from: int
    heard: float

    @property
    def steps(self) -> list[float]:
        """The affine start and rounds 1 to ``of``."""
        thousands = self.points / 1000
        one = ROUND + ROUND_POINTS * thousands
        first = self.of if self.exemplars < 2 else self.family_from
        found = [START + START_POINTS * thousands]
        for number in range(1, self.of + 1):
            if number <= first:
                tried = min(self.exemplars, EXEMPLARS_PER_SHAPE) if number <= HEARD_ROUNDS else self.heard
                found.append(one * tried * (LATE if number > (1 - LATE_SHARE) * first else 1.0))
                continue
            found.append(one * (TRIAL if number - first <= family.TRIAL_ROUNDS else FAMILY))
            if number == first + 1:
                found[-1] += LINKING_POINTS * thousands * min(family.ASKED, self.shapes) / max(self.shapes, 1)
        found[-1] += COPIES
        return found

    @property
    def after(self) -> float:
        """What comes after the rounds."""
        return (FACES * self.faces + FACES_POINTS * self.points) / 1000


class Pace:
    """Seconds left of a fit that goes on after ``begun`` steps, the affine start being the first; ``clock()`` in
    seconds."""

    def __init__(self, begun: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._begun, self._clock, self._start = begun, clock, clock()

    def left(self, costs: FitCosts, done: float) -> float | None:
        """Seconds left after ``done`` of the steps (3.5: half of the fourth); None: not known."""
        steps, whole = costs.steps, int(done)
        spent = sum(steps[self._begun : whole]) + (done - whole) * (steps[whole] if whole < len(steps) else 0.0)
        if spent <= 0:
            return None
        rest = sum(steps[self._begun :]) + costs.after - spent
        return (self._clock() - self._start) / spent * max(rest, 0.0)
