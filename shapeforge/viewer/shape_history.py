"""The shapes that were made one after the other: what undo and redo go through in the Synthesize place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from shapeforge.viewer.recipe import Recipe
from shapeforge.viewer.session import Session


class ShapeHistory:
    """Recipes of which the first ``done`` + 1 were made and the rest undone.

    The shape in hand is the last of them that is in effect, with ``session.sliders``, ``parts_on``, ``pins`` and
    ``locked`` as they are now.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.recipes: list[Recipe] = []
        self.done = -1

    @property
    def recipe(self) -> Recipe:
        """The last recipe of the history that is in effect (its sliders as they were when it was kept)."""
        return self.recipes[self.done]

    def start(self, recipe: Recipe) -> None:
        """Make another shape, as a new item of the history; what had been undone is forgotten."""
        del self.recipes[self.done + 1 :]
        self.recipes.append(recipe)
        self.done = len(self.recipes) - 1
        self._take_over(recipe)

    def exchange(self, recipe: Recipe) -> None:
        """Make another shape of the present item of the history."""
        self.recipes[self.done] = recipe
        self._take_over(recipe)

    def keep(self, label: str) -> None:
        """Keep the shape in hand (sliders, parts and pins as they are now) as a new item of the history."""
        self.start(replace(self.recipe, label=label, **self._now()))

    def _now(self) -> dict[str, Any]:
        session = self.session
        return {
            "sliders": dict(session.sliders), "parts_on": dict(session.parts_on), "pins": dict(session.pins),
            "locked": session.locked,
        }  # fmt: skip

    def make_by(self, route: str, union: bool) -> None:
        """Make the mesh of the shape in hand in another way (see :class:`Recipe`), as a new item."""
        if (route, union) == (self.recipe.route, self.recipe.union):
            return
        self.keep("new surface" if route == "surface" else "one solid" if union else "of parts")
        self.recipes[self.done] = replace(self.recipe, route=route, union=union)

    def go_to(self, index: int) -> None:
        """Back (or forth) to an item of the history."""
        index = min(max(index, 0), len(self.recipes) - 1)
        if index != self.done:
            self.done = index
            self._take_over(self.recipe)

    def _take_over(self, recipe: Recipe) -> None:
        if recipe.pins:  # with other sliders locked it would be another shape
            self.session.locked = recipe.locked
        self.session.parts_on = dict(recipe.parts_on)
        self.session.pins = dict(recipe.pins)
        self.session.sliders = dict(recipe.sliders)

    @property
    def undo_label(self) -> str | None:
        """What Undo would take back, None when nothing."""
        return self.recipe.label if self.done > 0 else None

    @property
    def redo_label(self) -> str | None:
        """What Redo would do again, None when nothing."""
        return self.recipes[self.done + 1].label if self.done + 1 < len(self.recipes) else None

    def undo(self) -> None:
        """Back to the item before."""
        self.go_to(self.done - 1)

    def redo(self) -> None:
        """Forth to the next item."""
        self.go_to(self.done + 1)
