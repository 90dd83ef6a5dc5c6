"""The Fit place by keyboard: from round to round and from shape to shape, and which shapes are watched."""

from __future__ import annotations

from typing import Any

from shapeforge.viewer.actions import YES, Action, Verdict
from shapeforge.viewer.fit_record import WATCHED_AT_MOST
from shapeforge.viewer.session import Session


def fit_actions(place: Any) -> list[Action]:
    """The actions of a `FitPlace`, for the table."""

    def can_step(by: int) -> Any:
        def verdict(_session: Session) -> Verdict:
            newest = place.record.newest if place.record is not None else -1
            wanted = place.number() + by
            if 0 <= wanted <= newest:
                return YES
            return False, "This is the newest round." if by > 0 else "There is no earlier round."

        return verdict

    def look(by: int) -> Any:
        return lambda _session: place.look_back(place.number() + by)

    def go(by: int) -> Any:
        def run(session: Session) -> None:
            shown = [one.name for one in place.also_watching.pictures] or list(session.watched)
            if shown:
                at = shown.index(session.shape) + by if session.shape in shown else 0
                session.shape = shown[at % len(shown)]

        return run

    return [
        Action("round_back", "Round before", look(-1), can_step(-1), "Left", "Look back one round", "left", "fit"),
        Action("round_forth", "Round after", look(1), can_step(1), "Right", "Look forward one round", "right", "fit"),
        Action("watched_before", "Watched shape before", go(-1), lambda _s: YES, "PgUp",
               "Look at the watched shape before this one", "up", "fit"),
        Action("watched_after", "Next watched shape", go(1), lambda _s: YES, "PgDown",
               "Look at the next watched shape", "down", "fit"),
        Action("watch_it", "Watch it too", toggle_watched, can_watch, "A",
               f"Keep the shape in the row below, or take it out; at most {WATCHED_AT_MOST} are watched", "eye", "fit"),
    ]  # fmt: skip


def toggle_watched(session: Session) -> None:
    """Watch the selected shape besides the others (of too many, the one watched longest goes), or no more."""
    name, watched = session.shape, session.watched
    if name in watched:
        session.watched = tuple(one for one in watched if one != name)
    else:
        session.watched = (*watched, name)[-WATCHED_AT_MOST:]


def can_watch(session: Session) -> Verdict:
    """Whether the selected shape can be watched, or no longer."""
    if session.shape is None:
        return False, "Select a shape first."
    if session.watched == (session.shape,):
        return False, "One shape has to be watched."
    return YES
