"""What the Paint place says: how the tool in hand is used, what is still blank, and why the family cannot be fitted."""

from __future__ import annotations

from shapeforge.viewer.actions import YES, unpainted_exemplars
from shapeforge.viewer.painter import Painter
from shapeforge.viewer.qt.paint_parts import percent
from shapeforge.viewer.qt.widgets import shortened
from shapeforge.viewer.readiness import Verdict, groups_of, starts_from_proposal
from shapeforge.viewer.session import Session


def how_to_use(session: Session, names: tuple[str, ...], completing: bool) -> str:
    """How the tool in hand works on the parts called ``names``; ``completing``: scribbles are being filled in."""
    part = shortened(names[session.part], 18) if session.part < len(names) else "the first part"
    stop = "the creases" if session.fill_to == "creases" else "the edge of its patch"
    depth = "seen only" if session.reach == "surface" else "through and through"
    return {
        "brush": f"drag paints {part} · Ctrl erases · wheel changes the size · Alt turns the view",
        "eraser": "drag takes paint away · wheel changes the size · Alt turns the view",
        "fill": f"click paints {part} up to {stop} · Ctrl erases · Alt turns the view",
        "piece": f"click paints the whole loose piece {part} · Ctrl erases · Alt turns the view",
        "lasso": f"drag around what is {part}, {depth} · Ctrl erases · T changes · Alt turns the view",
        "scribble": "filling in the rest…"
        if completing
        else f"one stroke on each part, now {part}; the rest is filled in",
        "eyedropper": "click takes the part under the pointer",
    }[session.tool]


def blank_words(proposed: bool, blank: float, pieces: int) -> tuple[str, str]:
    """How much of the area is unpainted, or that parts are proposed, in two pieces: the first is set strong."""
    if proposed:
        return "Proposed", "parts, nothing is painted"
    if not pieces:
        return "All painted", ""
    return percent(blank), f"unpainted, {pieces} piece{'s' * (pieces != 1)}"


def has_paint(painter: Painter) -> bool:
    """The shape that is being painted has some paint."""
    return painter.name is not None and bool((painter.state.labels >= 0).any())


def can_fit(session: Session, painter: Painter) -> Verdict:
    """Whether the family can be fitted with what is painted and, when not, why not."""
    if session.project is None:
        return False, "Open a project first."
    if starts_from_proposal(session):
        return YES if not session.running else (False, f"Wait until {session.stage or 'the stage'} is done.")
    left = [name for name in unpainted_exemplars(session) if name != painter.name or not has_paint(painter)]
    if left:
        few = len(left) == 1
        what, them = (shortened(left[0]), "it") if few else (f"{len(left)} exemplars", "them")
        ways = [f"Paint {them}"]
        if not session.project.labelled and not has_paint(painter):
            ways.append("let parts be proposed")
        if len(groups_of(session) or ()) > len(left):
            ways.append(f"leave {'its group' if few else 'their groups'} out in Collection (Shift+L)")
        said = f"{', '.join(ways[:-1])}, or {ways[-1]}" if len(ways) > 1 else ways[0]
        return False, f"{what} {'is' if few else 'are'} still unpainted. {said}."
    if not session.project.labelled and not has_paint(painter):
        return False, "Paint at least one shape first."
    return YES if not session.running else (False, f"Wait until {session.stage or 'the present stage'} is done.")
