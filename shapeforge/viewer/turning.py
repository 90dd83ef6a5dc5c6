"""Turning shapes by hand: the rotation under way in the Session, rings to take hold of, and keeping what was turned."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from shapeforge.collection.counts import counted
from shapeforge.stages_pose import Before, put_back, turn_by_hand
from shapeforge.viewer.display import LineLayer, Mark, MeshLayer, PointLayer, View
from shapeforge.viewer.readiness import YES, Verdict, group_of, groups_of, needs_rest
from shapeforge.viewer.regroup import chosen_shapes
from shapeforge.viewer.session import Session

RING_RADIUS = 0.58  # diagonals
RING_CORNERS = 96
AXES: tuple[str, ...] = ("x", "y", "z")
# Not the colours of parts: an axis must not be taken for a part.
RING_COLOURS: tuple[tuple[int, int, int], ...] = ((240, 120, 122), (122, 200, 120), (110, 150, 255))


def about(axis: int, degrees: float | int) -> Float[np.ndarray, "3 3"]:
    """The rotation by an angle about an axis (0 x, 1 y, 2 z), counter-clockwise seen from its positive end."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    if degrees % 90 == 0:
        c, s = np.round(c), np.round(s)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    result = np.eye(3)
    result[a, a], result[a, b], result[b, a], result[b, b] = c, -s, s, c
    return result


def rotation_of(session: Session) -> Float[np.ndarray, "3 3"]:
    """The rotation under way; the identity when none is."""
    return np.eye(3) if session.turn is None else np.array(session.turn, float)


def set_rotation(session: Session, rotation: Float[np.ndarray, "3 3"]) -> None:
    """Turn the selected shapes to ``rotation`` of how they stand in the project."""
    # Products of many small turns drift: the nearest proper rotation.
    left, _, right = np.linalg.svd(rotation)
    session.turn = tuple(tuple(float(x) for x in row) for row in left @ right)


# -- actions ---------------------------------------------------------------------------------------------------------


def can_turn(session: Session) -> Verdict:
    """Shapes are selected and nothing runs."""
    can, why = needs_rest(session)
    if not can:
        return can, why
    return YES if chosen_shapes(session) else (False, "Select a shape first.")


def is_turning(session: Session) -> Verdict:
    """A turn is under way."""
    return YES if session.turn is not None else (False, "Nothing is being turned: press O first.")


def begin(session: Session) -> None:
    """Start to turn the selected shapes, seen large."""
    session.arrangement = "large"
    set_rotation(session, np.eye(3))


def turn_quarter(session: Session, axis: int) -> None:
    """A quarter turn about the axis through the middle."""
    set_rotation(session, about(axis, 90) @ rotation_of(session))


def as_in_file(session: Session) -> None:
    """Turn back to how the current shape's file has it."""
    name = session.shape or chosen_shapes(session)[0]
    set_rotation(session, session.project.shapes.named(name).frame.rotation.T)


def cancel(session: Session) -> None:
    """Leave the shapes as they were."""
    session.turn = None


def keep(session: Session) -> None:
    """Write the turn into the project; it can be undone.  Labels stay, what was fitted goes stale."""
    project, names, turn = session.project, chosen_shapes(session), rotation_of(session)
    session.turn = None
    if np.abs(turn - np.eye(3)).max() < 1e-6:
        session.say("Nothing was turned.")
        return
    wanted = {name: turn @ project.shapes.named(name).frame.rotation for name in names}
    before: dict[str, Before] = {}

    def put(shapes: Mapping[str, Before]) -> None:
        put_back(project, shapes)
        session.touch("shapes")

    def redo() -> None:
        before.update(turn_by_hand(project, wanted))
        session.touch("shapes")

    some = names[0] if len(names) == 1 else counted(len(names), "shape")
    session.do(f"turn {some}", redo, lambda: put(before))
    stale = " The fit is stale: run it again." if project.fit_id is not None else ""
    session.say(f"{some} turned.{stale}", "ok")


# -- what is shown ---------------------------------------------------------------------------------------------------


def reference_of(session: Session, name: str) -> str | None:
    """A shape that shows how the others of its group stand: the exemplar, else another member; None when alone."""
    groups, names = groups_of(session), session.project.names
    g = group_of(session, name)
    if g < 0:
        others = [other for other in names if other not in chosen_shapes(session)]
    else:
        members = [names[t] for t in groups.members(g)]
        others = [names[groups.exemplars[g]], *members]
        others = [other for other in others if other not in chosen_shapes(session)]
    return others[0] if others else None


def turned_view(view: View, rotation: Float[np.ndarray, "3 3"]) -> View:
    """A view of the same shape, its vertices turned about the middle."""
    layers = []
    for layer in view.layers:
        if isinstance(layer, MeshLayer):
            vertices = layer.vertices @ rotation.T
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            layer = MeshLayer(layer.key, vertices - (low + high) / 2, layer.triangles, layer.colours)
        layers.append(layer)
    return View(tuple(layers), view.marks, view.captions, name=view.name, selected=view.selected)


def room_for_rings() -> PointLayer:
    """Nothing that is seen: it keeps the camera far enough for the rings."""
    places = np.concatenate([ring(axis)[::8] for axis in range(3)]) * 1.12
    return PointLayer("room", places, np.zeros((len(places), 3), np.uint8), 1.0, 0.0)


def front_arrow(reach: float = 0.66) -> LineLayer:
    """An arrow on the floor that points to the front (+z)."""
    tip, back, low = (0.0, -0.45, reach), 0.06, -0.45
    segments = [
        [(0.0, low, reach - 0.2), tip],
        [tip, (-back, low, reach - back)],
        [tip, (back, low, reach - back)],
    ]
    return LineLayer("front", np.array(segments), (150, 155, 165), 2.0)


def ring(axis: int) -> Float[np.ndarray, "n 3"]:
    """Places (n, 3) on the ring about an axis."""
    angle = np.linspace(0, 2 * np.pi, RING_CORNERS, endpoint=False)
    places = np.zeros((RING_CORNERS, 3))
    places[:, (axis + 1) % 3], places[:, (axis + 2) % 3] = RING_RADIUS * np.cos(angle), RING_RADIUS * np.sin(angle)
    return places


def ring_marks(held: int | None) -> tuple[Mark, ...]:
    """The three rings, the one in hand marked."""
    return tuple(
        Mark("circle", (0.0, 0.0, 0.0), to=tuple(np.eye(3)[axis].tolist()), radius=RING_RADIUS, colour=colour,
             text="held" if axis == held else "")
        for axis, colour in enumerate(RING_COLOURS)
    )  # fmt: skip


def nearest_on_ring(
    places: Float[np.ndarray, "n 2"], towards: Float[np.ndarray, " n"], at: tuple[float | int, float | int]
) -> tuple[float, float]:
    """Distance in pixels from ``at`` to a ring seen at ``places`` (n, 2), and the angle (degrees) of the nearest place.

    ``towards`` (n,) is how near each place is to the viewer: of two places as near to ``at``, the front one counts.
    """
    away = np.hypot(*(places - at).T)
    best = int((away - 2.0 * np.sign(towards)).argmin())
    return float(away[best]), 360.0 * best / len(places)
