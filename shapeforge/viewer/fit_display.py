"""What the window remembers of a fit, and what it shows of it.  Numpy only.

A state of the fit holds beliefs about every shape; the window keeps of each round only its numbers and, of the shapes
watched, where the template points were: memory does not grow with the collection.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from shapeforge.collection.shape import Shape
from shapeforge.viewer.display import Caption, Display, LineLayer, MeshLayer, PointLayer, View, probability_colours
from shapeforge.viewer.palette import SWITCHED_OFF, heat, rgb

POINT_SIZE, OFF_SIZE = 4.2, 2.4
SMALLEST_MOVE = 2e-3
"""Diagonals a point must have moved for its line to be drawn."""
FULL_HEAT = 0.05
"""Movement (diagonals) shown as the hottest colour."""


@dataclass(frozen=True, eq=False)
class FittedPoints:
    """Template points of one shape in one round: positions (K, 3) in diagonals, and which template they are.

    ``turn`` (3, 3) turns the shape as the family lies; positions are so turned, the mesh has to be (see ``turned``).
    ``active`` (L,) are the parts of this template that the shape has; ``lent`` the points (n, 3) of parts that another
    exemplar's template brings: (part, points, index of that template); ``spare`` (K,) marks points of components that
    the shape lacks (empty: none).
    """

    positions: Float[np.ndarray, "K 3"]
    template: int
    active: Bool[np.ndarray, " L"]
    turn: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    lent: tuple[tuple[int, Float[np.ndarray, "_ 3"], int], ...] = ()
    spare: Bool[np.ndarray, " S"] = field(default_factory=lambda: np.zeros(0, bool))

    def alive(self, label: Int[np.ndarray, " K"]) -> Bool[np.ndarray, " K"]:
        """Which of the points (K,), whose parts are ``label``, the shape has."""
        there = self.active[label]
        return there & ~self.spare if len(self.spare) == len(label) else there

    @property
    def parts(self) -> Bool[np.ndarray, " L"]:
        """The parts (L,) that the shape has, its own template's and those lent to it."""
        found = self.active.copy()
        found[[part for part, _, _ in self.lent]] = True
        return found


@dataclass(frozen=True, eq=False)
class Round:
    """One round of a fit.  ``energy`` is nats per surface point; ``sigma`` (L,), ``change`` and ``moved`` diagonals.

    ``moved`` has every shape's mean movement since the round before; ``points`` the watched shapes only.
    """

    number: int
    of: int
    energy: float
    change: float
    sigma: Float[np.ndarray, " L"]
    points: dict[str, FittedPoints] = field(default_factory=dict)
    moved: dict[str, float] = field(default_factory=dict)
    stop_reason: str | None = None
    family_from: int = -1
    """The round with which the exemplars were done, -1 as long as they are not (see ``deformation.fit.FitState``)."""


@dataclass(frozen=True, eq=False)
class TemplateLook:
    """What the window needs of one exemplar's templates: the part of each point (K,), the parts' names and colours
    (L, 3), and whose they are."""

    label: Int[np.ndarray, " K"]
    part_names: tuple[str, ...]
    source: str
    inks: UInt8[np.ndarray, "L 3"]


def best_beliefs(state: Any, index: int) -> Any:
    """The beliefs about shape ``index`` of a fit's state, without blending the others in (positions are the same)."""
    if hasattr(state, "candidates"):
        from shapeforge.deformation.exemplars import leading

        return leading(state.candidates[index]).beliefs
    return state.beliefs[index]


def all_beliefs(state: Any, index: int) -> Any:
    """The beliefs about shape ``index`` with the label probabilities of all explanations tried."""
    if hasattr(state, "candidates"):
        from shapeforge.deformation.exemplars import blend

        return blend(state.candidates[index])
    return state.beliefs[index]


def looks_of(state: Any, inks_of: Callable[[Sequence[str]], UInt8[np.ndarray, "L 3"]]) -> tuple[TemplateLook, ...]:
    """The parts of every template of a state, their colours by ``inks_of(names)``, and whose it is."""
    return tuple(
        TemplateLook(t.label, tuple(t.part_names), t.source or "the whole family", inks_of(t.part_names))
        for t in state.templates
    )


def fitted_points(beliefs: Any, looks: Sequence[TemplateLook]) -> FittedPoints:
    """Where a shape's template points lie by its beliefs, turned as the family lies, with the parts lent to it."""
    lent = []
    for part, theirs in beliefs.lent:
        own = theirs.deformed[looks[theirs.template].label == part]
        lent.append((int(part), np.asarray(beliefs.to_family(own), np.float32), int(theirs.template)))
    return FittedPoints(
        np.asarray(beliefs.to_family(beliefs.deformed), np.float32), int(beliefs.template), beliefs.active,
        np.asarray(beliefs.pose, float), tuple(lent), beliefs.spare,
    )  # fmt: skip


def turned(vertices: Float[np.ndarray, "V 3"], turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "V 3"]:
    """A shape's vertices (V, 3), turned as the family lies."""
    vertices = np.asarray(vertices, float)
    return vertices if np.array_equal(turn, np.eye(3)) else np.ascontiguousarray(vertices @ turn.T)


def record_round(
    state: Any, names: Sequence[str], watched: Sequence[str], before: Any | None, looks: Sequence[TemplateLook]
) -> Round:
    """What to remember of a state; ``before`` is the state of the round before, for the movement."""
    points: dict[str, FittedPoints] = {}
    moved: dict[str, float] = {}
    for index, name in enumerate(names):
        beliefs = best_beliefs(state, index)
        if before is not None:
            old = best_beliefs(before, index)
            if old.template == beliefs.template and len(old.deformed) == len(beliefs.deformed):
                moved[name] = float(np.linalg.norm(beliefs.deformed - old.deformed, axis=1).mean())
        if name in watched:
            points[name] = fitted_points(all_beliefs(state, index), looks)
    sigma = np.asarray(state.sigma_by_part, float)
    return Round(
        int(state.round), int(state.of), float(state.energy), float(state.change), sigma, points, moved,
        state.stop_reason, int(getattr(state, "family_from", -1)),
    )  # fmt: skip


def point_colours(
    look: TemplateLook, fitted: FittedPoints, by: str, moved: Float[np.ndarray, " K"] | None = None
) -> UInt8[np.ndarray, "K 3"]:
    """Colours (K, 3) of template points: by "part" (switched-off parts grey) or by "movement" (heat)."""
    if by == "movement":
        values = np.zeros(len(look.label)) if moved is None else np.asarray(moved, float) / FULL_HEAT
        return heat(values)
    colours = look.inks[look.label]
    colours[~fitted.alive(look.label)] = rgb(SWITCHED_OFF)
    return colours


def all_points(look: TemplateLook, fitted: FittedPoints) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Points (n, 3) and colours (n, 3) of a small picture: the template's own, and those of parts lent to the shape."""
    lent = [part for part, _, _ in fitted.lent]
    own = ~np.isin(look.label, lent)  # what is lent stands in the place of what is switched off
    colours = [point_colours(look, fitted, "part")[own]]
    colours += [np.tile(look.inks[part], (len(there), 1)) for part, there, _ in fitted.lent]
    places = [fitted.positions[own], *(there for _, there, _ in fitted.lent)]
    return np.concatenate(places), np.concatenate(colours).astype(np.uint8)


def movement(now: FittedPoints, before: FittedPoints | None) -> Float[np.ndarray, " K"] | None:
    """How far each template point moved (K,) in diagonals; None when another template explained the shape before, or
    the same one after another turn."""
    if before is None or before.template != now.template or len(before.positions) != len(now.positions):
        return None
    if not np.array_equal(before.turn, now.turn):
        return None
    return np.linalg.norm(now.positions - before.positions, axis=1).astype(float)


UNTURNED = np.eye(3)


def mesh_layer(
    shape: Shape, colour: str, opacity: float = 1.0, key: str = "mesh", turn: Float[np.ndarray, "3 3"] = UNTURNED
) -> MeshLayer:
    """The mesh of a shape in one colour, turned as the family lies."""
    mesh = shape.mesh
    colours = np.broadcast_to(np.array(rgb(colour), np.uint8), (len(mesh.triangles), 3))
    vertices = turned(mesh.vertices, turn)
    return MeshLayer(key, vertices, mesh.triangles, np.ascontiguousarray(colours), opacity=opacity)


def probable_layer(
    shape: Shape, probabilities: Float[np.ndarray, "F L"], inks: UInt8[np.ndarray, "L 3"],
    turn: Float[np.ndarray, "3 3"] = UNTURNED,
) -> MeshLayer:  # fmt: skip
    """The mesh of a shape in the colours of its probable parts, pale where it is unsure."""
    mesh = shape.mesh
    colours = probability_colours(np.asarray(probabilities, float), inks)[mesh.face_of_triangle]
    return MeshLayer("parts", turned(mesh.vertices, turn), mesh.triangles, np.ascontiguousarray(colours))


def template_view(
    ghost: MeshLayer, look: TemplateLook | None, now: FittedPoints | None, before: FittedPoints | None, by: str,
    captions: tuple[Caption, ...] = (), dot: float = POINT_SIZE,
) -> View:  # fmt: skip
    """Template points (``dot`` pixels) over the ghost of the shape; lines show what moved since the round before."""
    layers: list[MeshLayer | PointLayer | LineLayer] = [ghost]
    if look is not None and now is not None and len(now.positions) == len(look.label):
        moved = movement(now, before)
        colours = point_colours(look, now, by, moved)
        on = now.alive(look.label)
        positions = np.asarray(now.positions, float)
        layers.append(PointLayer("points", positions[on], colours[on], dot))
        off = ~on & ~np.isin(look.label, [part for part, _, _ in now.lent])
        if off.any():
            layers.append(PointLayer("off", positions[off], colours[off], OFF_SIZE))
        for part, there, _ in now.lent:
            ink = np.tile(look.inks[part], (len(there), 1)) if by == "part" else heat(np.zeros(len(there)))
            layers.append(PointLayer(f"lent {part}", np.asarray(there, float), ink.astype(np.uint8), dot))
        if moved is not None and before is not None:
            far = on & (moved > SMALLEST_MOVE)
            segments = np.stack([np.asarray(before.positions, float)[far], positions[far]], axis=1)
            if len(segments):
                layers.append(LineLayer("moved", segments, (200, 203, 210), 1.0, 0.7))
    return View(tuple(layers), captions=captions)


def three_views(
    plain: MeshLayer, ghost: MeshLayer, look: TemplateLook | None, now: FittedPoints | None,
    before: FittedPoints | None, parts: MeshLayer | None, by: str,
) -> Display:  # fmt: skip
    """Input, template points over its ghost, and probable parts (None: not yet), side by side under one camera."""
    last = View((parts if parts is not None else ghost,))
    return Display((View((plain,)), template_view(ghost, look, now, before, by), last), 1, 3)


def sureness(segmentation: Float[np.ndarray, "P L"]) -> Float[np.ndarray, " L"]:
    """How sure the points of each part are of it (L,): mean probability where it is the most probable; NaN nowhere."""
    best = segmentation.argmax(axis=1)
    count = np.bincount(best, minlength=segmentation.shape[1])
    total = np.bincount(best, segmentation.max(axis=1), segmentation.shape[1])
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)


def to_plane(
    points: Float[np.ndarray, "n 3"], direction: Sequence[float] = (1.0, 0.6, 1.5)
) -> Float[np.ndarray, "n 3"]:
    """Points seen from ``direction``, y up: right, down and depth (n, 3), the nearest with the greatest depth."""
    away = np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross((0.0, 1.0, 0.0), away)
    right /= np.linalg.norm(right)
    down = -np.cross(away, right)
    return np.asarray(points, float) @ np.stack([right, down, away], axis=1)
