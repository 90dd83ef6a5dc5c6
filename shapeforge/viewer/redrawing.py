"""Other draws in place of one whose parts do not go together, as the command line has them; here a mesh at a time.

No Qt here, and nothing waits: whoever has asked for a mesh tells when it has come.
"""

from __future__ import annotations

from dataclasses import replace

from shapeforge.viewer.mesh_worker import Made
from shapeforge.viewer.recipe import Recipe


def is_whole(made: Made) -> bool:
    """The parts of a mesh go together (see ``stages_synthesis.fault_of``)."""
    from shapeforge.stages_synthesis import fault_of

    return fault_of(made.shape) <= 1


class Redrawing:
    """The draw ``number`` of a project, and those tried in its place.

    ``recipe`` is the one whose mesh is being made, ``turn`` how many were put aside for it; ``tried`` are all of them.
    """

    def __init__(self, number: int, recipe: Recipe) -> None:
        self.number, self.turn = number, 0
        self.tried = [recipe]
        self._best: tuple[float, Recipe, Made] | None = None

    @property
    def recipe(self) -> Recipe:
        """The one whose mesh is being made."""
        return self.tried[-1]

    def take(self, made: Made) -> bool:
        """Take the mesh of ``recipe``; True when another draw is to be tried (``turn`` says which one)."""
        from shapeforge.stages_synthesis import REDRAWS, fault_of

        fault = fault_of(made.shape)
        if self._best is None or fault < self._best[0]:
            self._best = (fault, self.recipe, made)
        if self._best[0] <= 1 or self.turn >= REDRAWS:
            return False
        self.turn += 1
        return True

    def result(self) -> tuple[Recipe, Made]:
        """The best of those tried and its mesh, whose measures tell how many were put aside (``redrawn``)."""
        if self._best is None:
            raise RuntimeError("no mesh of a draw has been taken so far")
        _, recipe, made = self._best
        if not self.turn:
            return recipe, made
        return recipe, replace(made, shape=replace(made.shape, measures={**made.shape.measures, "redrawn": self.turn}))
