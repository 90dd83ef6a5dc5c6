"""New shapes by hand: a base shape, sliders on what the machine learned, parts on and off; points now, meshes later.

No Qt here.  Points come at once (milliseconds), meshes from a worker that always works on the newest wish.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from shapeforge.generative.draw import draw
from shapeforge.generative.evidence import between, draw_given
from shapeforge.generative.inference import Latents, decode, infer, logit, sigmoid
from shapeforge.generative.landmarks import follow
from shapeforge.generative.scales import Scales
from shapeforge.generative.units import Direction, bundles, drive, drive_latents, single_units
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.complete import completed_parts
from shapeforge.synthesis.mirror import Bend, find_mirror
from shapeforge.synthesis.sources import touching_shares
from shapeforge.viewer.display import MeshLayer, PointLayer
from shapeforge.viewer.palette import label_colours
from shapeforge.viewer.pulling import FoundOnce
from shapeforge.viewer.readiness import group_of
from shapeforge.viewer.recipe import Place
from shapeforge.viewer.recipe import Recipe as Recipe
from shapeforge.viewer.resemblance import blend, least_like, nearest_shape
from shapeforge.viewer.session import Session
from shapeforge.viewer.shape_history import ShapeHistory
from shapeforge.viewer.slider_names import changes, choose_names, what_moves

PERCENTILES = 3.29
"""Standard deviations between the 5th and the 95th percentile of a normal distribution."""
FARTHEST = 9.0
"""Standard deviations by which a slider may be set away from where the shape stands."""
FOLLOWING = 11
BENT = 0.005
"""Diagonals that a part has to be bent somewhere to count as such."""
FINER, UNITS = 8, 8
"""How many bundles and single units there are sliders for, below the project's directions."""


class Sculptor(ShapeHistory):
    """The learnt family of the session's project and the shape in hand.

    ``session.sliders``, ``parts_on``, ``pins`` and ``locked`` are the truth about sliders, parts and points
    that are held; ``recipes`` is the history, of which the first ``done`` + 1 were made and the rest undone.
    """

    def __init__(self, session: Session) -> None:
        super().__init__(session)
        self._key: Any = None
        self.draws = 0
        self.directions: list[Direction] = []
        self.names: list[str] = []

    # ---- the learnt family ---------------------------------------------------------------------------------------

    def reload(self) -> bool:
        """Look at the project's present machine; True when it is another than before (the history starts anew)."""
        project = self.session.project
        key = None if project is None else (str(project.path), project.machine_id)
        if key == self._key:
            return False
        self._key = key
        self.machine = None if project is None else project.machine()
        with self.session.events.blocked():  # points and sliders of another machine mean nothing any more
            self.session.pins, self.session.locked = {}, frozenset()
        if self.machine is None:
            return True
        self.mixture, self.observations = project.mixture(), project.observations()
        self.coarse = len(project.directions())
        finer = bundles(self.machine, self.observations, FINER), single_units(self.machine, self.observations, UNITS)
        self.directions = [*project.directions(), *finer[0], *finer[1]]
        self.latents = infer(self.machine, self.observations.values, self.observations.exists)
        self.scales = Scales(self.machine, self.latents, self.directions)
        self._home: tuple[Any, np.ndarray] = (None, np.zeros(0))
        self._followed: tuple[Any, Any, Any] = (None, None, None)
        units = np.array([self.unit(index) for index in range(len(self.directions))])
        self.rows = self.scales.rows(self.machine.sizes) / units[:, None]
        self.part, self.part_names = self.observations.part, tuple(self.observations.part_names)
        self.shape_names = tuple(project.fit_names)
        self.positions = self.observations.positions()
        self.mirror = FoundOnce(partial(find_mirror, self.positions, self.observations.exists, self.part))
        self.touching = touching_shares(self.positions, self.part, len(self.part_names))
        self.names = self._names()
        self.recipes, self.done = [], -1
        self.start(Recipe("mean", self.mean_base(), origin="mean"))
        return True

    @property
    def has_machine(self) -> bool:
        """A machine has been learnt."""
        return getattr(self, "machine", None) is not None

    def mean_base(self) -> Latents:
        """The middle of the shapes with the family's most common parts."""
        patterns, which, counts = np.unique(self.latents.exists, axis=0, return_inverse=True, return_counts=True)
        members = np.flatnonzero(which.reshape(-1) == counts.argmax())
        hidden = [sigmoid(logit(layer[members]).mean(axis=0, keepdims=True)) for layer in self.latents.layers]
        return Latents(tuple(hidden), patterns[counts.argmax()][None])

    def random_base(self, number: int | None = None, turn: int = 0) -> Latents:
        """A draw from the learnt distribution; the n-th draw of a project is always the same for the same wishes.

        None is the next ``number``; ``turn`` counts other draws in place of that one, if its parts do not go together.

        The parts that ``session.parts_on`` asks for are there or not, as they are asked for; points stay where they are
        pinned, and units whose sliders are locked where they are; ``session.temperature`` says how unusual,
        ``session.near`` whether to stay near the shape in hand.
        """
        session = self.session
        if number is None:
            number = self.draws = self.draws + 1
        rng = np.random.default_rng([7, number, turn] if turn else [7, number])
        needed = np.array(sorted(part for part, on in session.parts_on.items() if on), np.int64)
        unwanted = np.array(sorted(part for part, on in session.parts_on.items() if not on), np.int64)
        values, present = self.values(), self.exists()
        levels = (self.scales.level(i, float(values[i]) * self.unit(i), present) for i in sorted(session.locked))
        clamped, pins = dict(level for level in levels if level is not None), self.pinned()
        if len(needed) or len(unwanted) or clamped or pins or session.near:
            found = draw_given(
                self.machine, self.mixture, 1, rng=rng, clamped=clamped, needed=needed, unwanted=unwanted,
                points=self.reached() if pins else None, start=self.latents_in_hand() if session.near else None,
                temperature=session.temperature,
            ).latents  # fmt: skip
        else:
            found = draw(self.machine, self.mixture, 1, rng=rng, temperature=session.temperature).latents
        having = np.where(np.isin(np.arange(len(self.part_names)), unwanted), 0.0, self.latents.exists.mean(axis=0))
        exists = completed_parts(found.exists[0], self.touching, having)
        exists[needed], exists[unwanted] = True, False
        return replace(found, exists=exists[None])

    def drawn(self, number: int | None = None, turn: int = 0) -> Recipe:
        """The recipe of a draw (see ``random_base``): pins, locked sliders and switched parts are kept to."""
        base = self.random_base(number, turn)
        origin = f"draw {number or self.draws}"
        return Recipe("random", base, origin=origin, **self._now() | {"sliders": self.kept(base)})

    def base_of(self, name: str) -> Latents:
        """The latents of a shape of the family."""
        return self.latents[self.shape_names.index(name)]

    def between(self, first: Latents, second: Latents, share: float) -> Latents:
        """``share`` of the way from one shape to another, in the logits of every layer; parts of the nearer one."""
        return between(first, second, [share])

    # ---- the shape in hand ---------------------------------------------------------------------------------------

    @property
    def as_kept(self) -> bool:
        """The shape in hand is as the history has it."""
        now, recipe = self._now(), self.recipe
        asked = ("sliders", "parts_on", "pins", *(["locked"] if self.pinned() else []))
        return all(now[name] == getattr(recipe, name) for name in asked)

    def take_part(self, part: int, name: str) -> None:
        """Ask for a part from the shape ``name`` ("": from the one that suits best again), as a new item."""
        taken = {l: n for l, n in self.recipe.taken.items() if l != part} | ({part: name} if name else {})
        self.keep(f"{self.part_names[part]} of {name or 'the nearest'}")
        self.recipes[self.done] = replace(self.recipe, taken=taken)

    def unit(self, index: int) -> float:
        """One standard deviation of a slider, in the direction's own units."""
        direction = self.directions[index]
        return max((direction.high - direction.low) / PERCENTILES, 1e-9)

    def home(self, base: Latents | None = None) -> Float[np.ndarray, " D"]:
        """Where a base (that of the shape in hand) stands on every slider by itself (D,), in standard deviations."""
        base = self.recipe.base if base is None else base
        if self._home[0] is not base:
            units = np.array([self.unit(index) for index in range(len(self.directions))])
            self._home = (base, self.scales.values(base) / units)
        return self._home[1]

    def slide(self, index: int, value: float) -> None:
        """Move a slider to ``value``.  Where points are pinned they may hold it back."""
        sliders = self.session.sliders
        setting = sliders.get(index, 0.0) + value - float(self.values()[index])
        at_home = abs(value - float(self.home()[index])) < 1e-9
        setting = 0.0 if at_home or abs(setting) < 1e-9 else float(np.clip(setting, -FARTHEST, FARTHEST))
        self.session.sliders = {**sliders, index: setting}

    def values(self) -> Float[np.ndarray, " D"]:
        """Where the shape in hand stands on every slider (D,): what its base has, and the sliders' settings; where
        points are pinned, what comes of that."""
        if self.pinned():
            return self.home(self.latents_in_hand())
        found = self.home().copy()
        for index, setting in self.session.sliders.items():
            found[index] += setting
        return found

    def kept(self, base: Latents) -> dict[int, float]:
        """Settings of the locked sliders with which a shape from another ``base`` stands where this one does."""
        values, there = self.values(), self.home(base)
        return {i: float(values[i] - there[i]) for i in sorted(self.session.locked)}

    def lock(self, index: int, on: bool) -> None:
        """Keep a slider's value, as it is now, or let it go."""
        session = self.session
        if on and self.pinned():  # what follows the pins begins with what is locked, and may not move it
            setting = float(self.values()[index] - self.home()[index])
            session.sliders = {**session.sliders, index: setting}
        session.locked = session.locked | {index} if on else session.locked - {index}

    def exists(self, recipe: Recipe | None = None) -> Bool[np.ndarray, " L"]:
        """Which parts the shape in hand (or of a recipe) has (L,)."""
        base = self.recipe.base if recipe is None else recipe.base
        wanted = self.session.parts_on if recipe is None else recipe.parts_on
        present = np.array(base.exists[0], bool)
        for part, on in wanted.items():
            present[part] = on
        return present

    def points(self, recipe: Recipe | None = None) -> Float[np.ndarray, "K 3"]:
        """Points (K, 3) of the shape in hand (or of a recipe), normal coordinates, NaN where a part is absent."""
        latents, bend = self._in_hand(recipe)
        points = self._positions(latents)
        return points if bend is None else bend.moved(points)

    def _positions(self, latents: Latents) -> Float[np.ndarray, "K 3"]:
        return np.asarray(self.machine.to_positions(decode(self.machine, latents), latents.exists)[0], np.float64)

    def latents_in_hand(self, recipe: Recipe | None = None) -> Latents:
        """The latents of the shape in hand (or of a recipe): sliders, switched parts and pins included."""
        return self._in_hand(recipe)[0]

    def symmetric(self, recipe: Recipe | None = None) -> Bool[np.ndarray, " L"]:
        """Which parts (L,) of the shape in hand (or of a recipe) are made symmetric where the family has them so.

        Not those that are bent, for points of one side that are pinned another way than those of the other.
        """
        latents, bend = self._in_hand(recipe)
        found = np.ones(len(self.part_names), bool)
        if bend is not None:
            points = self._positions(latents)
            found[self.part[np.linalg.norm(bend.moved(points) - points, axis=1) > BENT]] = False
        return found

    def bend(self, recipe: Recipe | None = None) -> Bend | None:
        """How the shape in hand (or of a recipe) is bent beyond what its latents make of it; None where it is not."""
        return self._in_hand(recipe)[1]

    def _in_hand(self, recipe: Recipe | None) -> tuple[Latents, Bend | None]:
        source = self.session if recipe is None else recipe
        base = self.recipe.base if recipe is None else recipe.base
        settings = {index: value * self.unit(index) for index, value in source.sliders.items() if value}
        exists, pins = self.exists(recipe), self.pinned(recipe)
        _, found = drive_latents(self.machine, base, settings, exists, directions=self.directions)
        if not pins:
            return found, None
        key = exists.tobytes(), *(tuple(sorted(one.items())) for one in (settings, pins)), source.locked
        if self._followed[0] is not base or self._followed[1] != key:
            rows = self.rows[sorted(source.locked)] if source.locked else None
            # The same numbers each time: what follows a hand must not tremble.
            rng = np.random.default_rng(FOLLOWING)
            at, mirror, known = self._positions(found), self.mirror(), self.known(pins)
            held = mirror.with_twins(known, at, self.part)
            followed = follow(self.machine, self.mixture, found, held, rng=rng, kept=rows)
            bend = mirror.bend_apart(known, at, self._positions(followed), self.part)
            self._followed = (base, key, (followed, bend))
        return self._followed[2]

    def pinned(self, recipe: Recipe | None = None) -> dict[int, Place]:
        """The pins of the shape in hand (or of a recipe) on parts that it has."""
        pins, exists = (self.session if recipe is None else recipe).pins, self.exists(recipe)
        return {point: place for point, place in pins.items() if exists[self.part[point]]}

    def reached(self) -> Float[np.ndarray, "K 3"]:
        """Where the shape in hand has its pinned points (K, 3), NaN for those that are free: as near as it gets."""
        points, found = self.points(), np.full((len(self.part), 3), np.nan)
        pinned = list(self.pinned())
        found[pinned] = points[pinned]
        return found

    def known(self, pins: Mapping[int, Place]) -> Float[np.ndarray, "K 3"]:
        """Where pins hold the points of a shape (K, 3), NaN for those that are free."""
        found = np.full((len(self.part), 3), np.nan)
        for point, place in pins.items():
            found[point] = place
        return found

    def always(self) -> Bool[np.ndarray, " L"]:
        """Parts that every shape of the family has (L,): they cannot be switched off."""
        return self.observations.exists.all(axis=0)

    def seen(self) -> Bool[np.ndarray, " L"]:
        """Parts that any shape of the family has (L,)."""
        return self.observations.exists.any(axis=0)

    def prepare(self) -> None:
        """Find what pulling needs, before anybody pulls: with thousands of points it takes a second."""
        if self.has_machine:
            self.mirror()

    def nearest(self, points: Float[np.ndarray, "K 3"]) -> tuple[str, float]:
        """The shape of the family nearest to these points and the mean distance (diagonals) over the points of both."""
        index, distance = nearest_shape(self.positions, points)
        return self.shape_names[index], distance

    def other_end(self, name: str) -> str:
        """A shape to go to from ``name``: the one least like it in its group with the same parts, else among all.

        On the way between shapes that have different parts, a part has to come or go at some point.
        """
        groups = np.array([group_of(self.session, one) for one in self.shape_names])
        index = self.shape_names.index(name)
        return self.shape_names[least_like(self.positions, self.observations.exists, groups, index)]

    def place_on_map(
        self, embedding: Float[np.ndarray, "T 2"], points: Float[np.ndarray, "K 3"]
    ) -> tuple[float, float]:
        """Where the shape in hand lies on a map of the family: among the shapes that it is a mean of."""
        x, y = np.clip(blend(self.positions, points) @ embedding, embedding.min(axis=0), embedding.max(axis=0))
        return float(x), float(y)

    # ---- words ---------------------------------------------------------------------------------------------------

    def _names(self) -> list[str]:
        """A name for every slider from what it does to the family's middle."""
        base = self.mean_base()
        exists = np.array(base.exists[0], bool)
        self._moves: dict[tuple[str, int], np.ndarray] = {}
        found = []
        for index in range(len(self.directions)):
            low, high = self._ends(base, index)
            found.append(changes(low, high, self.part, self.part_names, exists))
        return choose_names(found, [direction.name for direction in self.directions])

    def _ends(self, base: Latents, index: int) -> tuple[np.ndarray, np.ndarray]:
        """A shape's points (K, 3) with one slider at the low and at the high end of the data."""
        every, direction = np.ones(len(self.part_names), bool), self.directions[index]
        low, high = (
            np.asarray(drive(self.machine, base, {index: value}, every, directions=self.directions))
            for value in (direction.low, direction.high)
        )
        return low, high

    def caption(self, index: int) -> str:
        """What a slider moves on the shape in hand, in words."""
        return what_moves(self.moves(index), self.part, self.part_names, self.exists())

    def moves(self, index: int) -> Float[np.ndarray, " K"]:
        """How far (diagonals) a slider moves each point of the shape in hand, from the low to the high end.

        Measured once for its origin.
        """
        key = (self.recipe.origin, index)
        if key not in self._moves:
            if len(self._moves) > 40 * len(self.directions):
                self._moves.clear()
            low, high = self._ends(self.recipe.base, index)
            self._moves[key] = np.linalg.norm(high - low, axis=1)
        return self._moves[key]

    # ---- what is shown -------------------------------------------------------------------------------------------

    @property
    def inks(self) -> UInt8[np.ndarray, "L 3"]:
        """Colours (L, 3) of the parts."""
        return self.session.project.part_inks(self.part_names)

    def points_layer(self, points: Float[np.ndarray, "K 3"], size: float = 5.0) -> PointLayer:
        """The points of the shape in hand as dots in their parts' colours."""
        there = np.isfinite(points).all(axis=1)
        colours = label_colours(np.asarray(self.part, np.int64), self.inks)
        return PointLayer("points", points[there], colours[there], size)

    def mesh_layer(self, shape: SynthesizedShape) -> MeshLayer:
        """A made mesh in its parts' colours, or (``session.mesh_colours``) in those of its sources, if any has some."""
        own = shape.colours if self.session.mesh_colours == "sources" else None
        colours = label_colours(np.asarray(shape.part, np.int64), self.inks) if own is None else own
        return MeshLayer("mesh", np.asarray(shape.vertices, float), shape.triangles, colours)
