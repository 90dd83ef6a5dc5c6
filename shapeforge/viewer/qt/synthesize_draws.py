"""*Random* in the Synthesize place: a draw, and others in its place as long as its parts do not go together."""

from __future__ import annotations

from typing import Any

from shapeforge.viewer.mesh_worker import Made
from shapeforge.viewer.redrawing import Redrawing


class Draws:
    """Ties *Random* to the Synthesize place; the item of the history stays the same one whatever is tried for it."""

    def __init__(self, place: Any) -> None:
        self.place = place
        self.trial: Redrawing | None = None

    def take(self) -> None:
        """A draw, with what it has to keep to."""
        sculptor = self.place.sculptor
        self.place.begin(sculptor.drawn())
        self.trial = Redrawing(sculptor.draws, sculptor.recipe)

    @property
    def turn(self) -> int:
        """Which draw is being tried in place of the one in hand; 0 for the first, or when none is."""
        return self.trial.turn if self.trial is not None and self._is_in_hand() else 0

    def settled(self, made: Made) -> Made | None:
        """The mesh in hand has come: what is to be shown, None while another draw is tried in its place."""
        place, trial = self.place, self.trial
        if trial is None or not self._is_in_hand():
            return made
        sculptor = place.sculptor
        if trial.take(made):
            place.begin(sculptor.drawn(trial.number, trial.turn), instead=True)
            trial.tried.append(sculptor.recipe)
            return None
        self.trial = None
        recipe, best = trial.result()
        place.remember_mesh(recipe, best)
        if recipe is not sculptor.recipe:
            sculptor.exchange(recipe)
            place.wanted()
            place.after_step()
        return best

    def _is_in_hand(self) -> bool:
        """The draw is in hand as it was drawn, and seen: what was changed since is nobody's to exchange."""
        place = self.place
        seen = not place.shows.gallery.isVisibleTo(place.centre)
        return seen and place.sculptor.as_kept and self.trial.recipe is place.sculptor.recipe
