"""The Paint place by keyboard: tools, parts by number, mirror, brush, and when each can be used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from shapeforge.viewer.actions import YES, Action, Verdict
from shapeforge.viewer.painter import TOOL_NAMES, Painter
from shapeforge.viewer.qt.paint_parts import TOOL_HINTS, TOOL_KEYS
from shapeforge.viewer.session import Session


def paint_actions(place: Any) -> list[Action]:
    """The actions of a `PaintPlace`, for the table (those of its parts are the palette's)."""
    session, painter, found = place.session, place.painter, []

    def add(
        name: str, text: str, run: Callable[[], None], key: str, tooltip: str = "", icon: str = "",
        enabled: Callable[[Session], Verdict] = lambda _session: YES,
    ) -> None:  # fmt: skip
        found.append(Action(name, text, lambda _session: run(), enabled, key, tooltip, icon, "paint"))

    def take_part(part: int) -> None:
        if part < len(painter.part_names):
            session.part = part

    def toggle(field: str, first: str, second: str) -> None:
        setattr(session, field, second if getattr(session, field) == first else first)

    for tool, key in TOOL_KEYS.items():
        add(f"tool_{tool}", TOOL_NAMES[tool], lambda tool=tool: setattr(session, "tool", tool), key, TOOL_HINTS[tool],
            tool)  # fmt: skip
    for number in range(1, 10):
        add(f"part_{number}", f"Part {number}", lambda n=number: take_part(n - 1), str(number))
    add("mirror", "Mirror", lambda: setattr(session, "mirror", not session.mirror), "M", "Paint the opposite side too",
        "mirror", lambda _session: _can_mirror(painter))  # fmt: skip
    add("isolate", "Isolate", place.toggle_isolate, "H", "Show only the current part and what is unpainted", "eye")
    add("reach", "Surface or through", lambda: toggle("reach", "surface", "through"), "T",
        "Brush and lasso take what is seen, or what lies behind, too")  # fmt: skip
    add("fill_to", "Fill to creases or patch", lambda: toggle("fill_to", "creases", "patch"), "Shift+F",
        "Where the fill stops")  # fmt: skip
    add("smaller", "Smaller brush", lambda: place.resize(-1), "[")
    add("larger", "Larger brush", lambda: place.resize(1), "]")
    add("next_piece", "Next piece", place.go_next, "N", "Turn to the next unpainted piece", "",
        lambda _session: YES if place.has_unpainted else (False, "Everything is painted."))  # fmt: skip
    add("complete", "Complete the rest", place.complete, "Shift+S", "Fill in what is unpainted from what is painted",
        "scribble", lambda _session: _can_complete(painter))  # fmt: skip
    add("home_view", "Look from the front", lambda: place.view.fit(), "Home", "The usual view", "home")
    found.append(
        Action("fit_family", "Fit the family", place.fit_family, place.can_fit, "",
               "Explain every shape with these parts", "fit")
    )  # fmt: skip
    return found


def _can_mirror(painter: Painter) -> Verdict:
    if painter.name is None:
        return False, "Choose a shape first."
    return YES if painter.mirror_plane is not None else (False, f"{painter.name} is not symmetric enough.")


def _can_complete(painter: Painter) -> Verdict:
    labels = painter.state.labels
    if not (labels >= 0).any():
        return False, "Paint a stroke on each part first."
    return YES if (labels < 0).any() else (False, "Everything is painted.")
