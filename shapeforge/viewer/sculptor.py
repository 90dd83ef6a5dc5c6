"""New shapes by hand: a base shape, sliders on what the machine learned, parts on and off; points now, meshes later.

No Qt here.  Points come at once (milliseconds), meshes from a worker that always works on the newest wish.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree

from shapeforge.generative.draw import draw
from shapeforge.generative.evidence import between
from shapeforge.generative.inference import Latents, infer, logit, sigmoid
from shapeforge.generative.units import Direction, bundles, drive, drive_latents
from shapeforge.stages_recipes import recipe_of, write_recipe
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.synthesis.complete import completed_parts
from shapeforge.synthesis.sources import touching_shares
from shapeforge.viewer.display import Caption, Display, Mark, MeshLayer, PointLayer, View
from shapeforge.viewer.mesh_worker import Made
from shapeforge.viewer.palette import heat, label_colours
from shapeforge.viewer.readiness import group_of
from shapeforge.viewer.session import Session
from shapeforge.viewer.slider_names import changes, choose_names, what_moves

PERCENTILES = 3.29
"""Standard deviations between the 5th and the 95th percentile of a normal distribution."""
FINER = 8
PULL_STEP, PULL_COST, FARTHEST = 0.25, 0.01, 3.0  # standard deviations, diagonals, standard deviations


@dataclass(frozen=True, eq=False)
class Recipe:
    """How a shape was made: the base, slider values (standard deviations) and which parts, and from which shapes
    the user wants some of them (``taken``); enough to make it again."""

    label: str
    base: Latents
    sliders: Mapping[int, float] = field(default_factory=dict)
    parts_on: Mapping[int, bool] = field(default_factory=dict)
    origin: str = ""
    taken: Mapping[int, str] = field(default_factory=dict)


class Sculptor:
    """The learnt family of the session's project and the shape in hand.

    ``session.sliders`` and ``session.parts_on`` are the truth about sliders and parts; ``recipes`` is the history, of
    which the first ``done`` + 1 were made and the rest undone.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._key: Any = None
        self.recipes: list[Recipe] = []
        self.done = -1
        self._draws = 0
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
        if self.machine is None:
            return True
        self.mixture, self.observations = project.mixture(), project.observations()
        self.coarse = len(project.directions())
        self.directions = [*project.directions(), *bundles(self.machine, self.observations, FINER)]
        self.latents = infer(self.machine, self.observations.values, self.observations.exists)
        self.part, self.part_names = self.observations.part, tuple(self.observations.part_names)
        self.shape_names = tuple(project.fit_names)
        self.positions = self.observations.positions()
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

    def random_base(self) -> Latents:
        """A draw from the learnt distribution; the n-th draw of a project is always the same."""
        self._draws += 1
        found = draw(self.machine, self.mixture, 1, rng=np.random.default_rng([7, self._draws])).latents
        having = self.latents.exists.mean(axis=0)
        return replace(found, exists=completed_parts(found.exists[0], self.touching, having)[None])

    def base_of(self, name: str) -> Latents:
        """The latents of a shape of the family."""
        return self.latents[self.shape_names.index(name)]

    def between(self, first: Latents, second: Latents, share: float) -> Latents:
        """``share`` of the way from one shape to another, in the logits of every layer; parts of the nearer one."""
        return between(first, second, [share])

    # ---- the shape in hand ---------------------------------------------------------------------------------------

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

    def keep(self, label: str) -> None:
        """Keep the shape in hand (sliders and parts as they are now) as a new item of the history."""
        sliders, parts_on = dict(self.session.sliders), dict(self.session.parts_on)
        self.start(replace(self.recipe, label=label, sliders=sliders, parts_on=parts_on))

    def take_part(self, part: int, name: str) -> None:
        """Ask for a part from the shape ``name`` ("": from the one that suits best again), as a new item."""
        taken = {l: n for l, n in self.recipe.taken.items() if l != part} | ({part: name} if name else {})
        self.keep(f"{self.part_names[part]} of {name or 'the nearest'}")
        self.recipes[self.done] = replace(self.recipe, taken=taken)

    def go_to(self, index: int) -> None:
        """Back (or forth) to an item of the history."""
        index = min(max(index, 0), len(self.recipes) - 1)
        if index != self.done:
            self.done = index
            self._take_over(self.recipe)

    def _take_over(self, recipe: Recipe) -> None:
        self.session.parts_on = dict(recipe.parts_on)
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

    def unit(self, index: int) -> float:
        """One standard deviation of a slider, in the direction's own units."""
        direction = self.directions[index]
        return max((direction.high - direction.low) / PERCENTILES, 1e-9)

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
        sliders = self.session.sliders if recipe is None else recipe.sliders
        base = self.recipe.base if recipe is None else recipe.base
        settings = {index: value * self.unit(index) for index, value in sliders.items() if value}
        found = drive(self.machine, base, settings, self.exists(recipe), directions=self.directions)
        return np.asarray(found, np.float64)

    def always(self) -> Bool[np.ndarray, " L"]:
        """Parts that every shape of the family has (L,): they cannot be switched off."""
        return self.observations.exists.all(axis=0)

    def seen(self) -> Bool[np.ndarray, " L"]:
        """Parts that any shape of the family has (L,)."""
        return self.observations.exists.any(axis=0)

    def nearest(self, points: Float[np.ndarray, "K 3"]) -> tuple[str, float]:
        """The shape of the family nearest to these points and the mean distance (diagonals) over the points of both."""
        away = np.linalg.norm(self.positions - points, axis=2)
        both = np.isfinite(away)
        share = both.sum(axis=1) / max(int(np.isfinite(points).all(axis=1).sum()), 1)
        mean = np.where(both, away, 0).sum(axis=1) / np.maximum(both.sum(axis=1), 1)
        mean = np.where(share > 0.5, mean, np.inf)
        best = int(mean.argmin())
        return self.shape_names[best], float(mean[best])

    def other_end(self, name: str) -> str:
        """A shape to go to from ``name``: the one least like it in its group with the same parts, else among all.

        On the way between shapes that have different parts, a part has to come or go at some point.
        """
        index = self.shape_names.index(name)
        others = np.arange(len(self.shape_names)) != index
        alike = others & (self.observations.exists == self.observations.exists[index]).all(axis=1)
        groups = [group_of(self.session, one) for one in self.shape_names]
        alike &= np.array(groups) == groups[index]
        among = np.flatnonzero(alike if alike.any() else others)
        if not len(among):
            return name
        away = np.nanmean(np.linalg.norm(self.positions[among] - self.positions[index], axis=2), axis=1)
        return self.shape_names[int(among[np.nanargmax(away)])]

    def place_on_map(
        self, embedding: Float[np.ndarray, "T 2"], points: Float[np.ndarray, "K 3"]
    ) -> tuple[float, float]:
        """Where the shape in hand lies on a map of the family: among the shapes it resembles most."""
        away = np.nan_to_num(np.linalg.norm(self.positions - points, axis=2), nan=0.15).mean(axis=1)
        weight = np.exp(-((away - away.min()) / max(0.25 * float(away.min()), 0.004)))
        x, y = (weight[:, None] * embedding).sum(axis=0) / weight.sum()
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

    # ---- pulling at the shape ------------------------------------------------------------------------------------

    def handles(self, points: Float[np.ndarray, "K 3"], count: int = 9) -> Int[np.ndarray, " h"]:
        """Points to pull at: far apart from each other, the outermost first."""
        there = np.flatnonzero(np.isfinite(points).all(axis=1))
        if not len(there):
            return there
        own = points[there]
        chosen = [int(np.linalg.norm(own - own.mean(axis=0), axis=1).argmax())]
        away = np.linalg.norm(own - own[chosen[0]], axis=1)
        while len(chosen) < min(count, len(there)):
            chosen.append(int(away.argmax()))
            away = np.minimum(away, np.linalg.norm(own - own[chosen[-1]], axis=1))
        return there[chosen]

    def pull(
        self, point: int, locked: frozenset[int] = frozenset()
    ) -> Callable[[Float[np.ndarray, " 3"]], dict[int, float]]:
        """Take hold of template point ``point``: the result maps a wanted displacement (diagonals) to slider values.

        The most likely change that moves the point there: least squares with one standard deviation of any slider
        costing as much as PULL_COST diagonals of miss, about the present state.
        """
        start = dict(self.session.sliders)
        free = [i for i in range(self.coarse) if i not in locked]
        before = self.points()[point]
        jacobian = np.zeros((3, len(free)))
        for column, index in enumerate(free):
            settings = {i: v * self.unit(i) for i, v in start.items()}
            settings[index] = settings.get(index, 0.0) + PULL_STEP * self.unit(index)
            moved = drive(self.machine, self.recipe.base, settings, self.exists(), directions=self.directions)[point]
            jacobian[:, column] = (moved - before) / PULL_STEP
        matrix = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + PULL_COST**2 * np.eye(3))

        def wanted(displacement: np.ndarray) -> dict[int, float]:
            step = matrix @ displacement
            values = {i: start.get(i, 0.0) + float(d) for i, d in zip(free, step, strict=True)}
            return {**start, **{i: float(np.clip(v, -FARTHEST, FARTHEST)) for i, v in values.items()}}

        return wanted

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

    def heated(
        self, layer: MeshLayer | PointLayer, points: Float[np.ndarray, "K 3"], index: int
    ) -> MeshLayer | PointLayer:
        """The layer, each place as hot as a slider moves the nearest of the shape's ``points``."""
        there = np.isfinite(points).all(axis=1)
        moves = self.moves(index)[there]
        share = moves / max(float(np.quantile(moves, 0.98)) if len(moves) else 0.0, 1e-9)
        if isinstance(layer, PointLayer):
            return replace(layer, colours=heat(share))
        nearest = cKDTree(points[there]).query(layer.vertices[layer.triangles].mean(axis=1))[1]
        return replace(layer, colours=heat(share[nearest]))

    def mesh_layer(self, shape: SynthesizedShape) -> MeshLayer:
        """A made mesh in its parts' colours."""
        return MeshLayer(
            "mesh", np.asarray(shape.vertices, float), shape.triangles,
            label_colours(np.asarray(shape.part, np.int64), self.inks),
        )  # fmt: skip

    def display(
        self, layers: tuple[MeshLayer | PointLayer, ...], made: Made | None, label: str, busy: bool,
        marks: tuple[Mark, ...] = (),
    ) -> Display:  # fmt: skip
        """The shape with what is known about it in the corners."""
        captions = [Caption("top left", ((label, "strong"), *self._size_words(made)))]
        if made is not None:
            used = sorted({name for name in made.shape.sources if name})
            few = ", ".join(used[:3]) + (f" and {len(used) - 3} more" if len(used) > 3 else "")
            nearest = f"nearest real shape: {made.nearest}, {100 * made.nearest_distance:.1f}% of size"
            captions.append(Caption("top right", ((f"parts from {few}", "plain"), (nearest, "plain"))))
            captions.append(Caption("bottom right", ((measure_words(made.shape.measures), "plain"),)))
        if busy:
            captions.append(Caption("bottom left", (("making the mesh…", "faint"),)))
        else:
            captions.append(Caption("bottom left", (("Drag a handle on the shape, the rest follows", "faint"),)))
        return Display((View(layers, marks, tuple(captions)),))

    @staticmethod
    def _size_words(made: Made | None) -> tuple[tuple[str, str], ...]:
        if made is None:
            return ()
        kind = "preview, " if made.preview else ""
        return ((f"{kind}{len(made.shape.triangles):,} faces".replace(",", "\u202f"), "plain"),)


def measure_words(measures: Mapping[str, Any]) -> str:
    """What was measured on a made mesh, in one line."""
    words = [f"gaps {100 * measures.get('largest_gap', 0.0):.1f}%"]
    if measures.get("symmetry_error") is not None:
        words.append(f"symmetry {100 * measures['symmetry_error']:.1f}% of size")
    folded = int(measures.get("folded_triangles", 0))
    words.append(f"{folded} folded triangle{'s' * (folded != 1)}")
    return " · ".join(words)


def export_mesh(path: Path, sculptor: Sculptor, shape: SynthesizedShape, recipe: Recipe) -> Path:
    """Write a made mesh (glb, ply, obj or stl by the ending) and, beside it, the recipe to remake it; its path."""
    from shapeforge.collection.meshes import write_mesh

    order = np.argsort(shape.part, kind="stable")
    write_mesh(
        path, shape.vertices, np.asarray(shape.triangles)[order], np.asarray(shape.part)[order], shape.part_names,
        sculptor.session.project.part_inks(shape.part_names),
    )  # fmt: skip
    settings = {i: value * sculptor.unit(i) for i, value in recipe.sliders.items() if value}
    _, latents = drive_latents(
        sculptor.machine, recipe.base, settings, sculptor.exists(recipe), directions=sculptor.directions
    )
    words = {"label": recipe.label, "origin": recipe.origin}
    sliders = {sculptor.names[i]: value for i, value in recipe.sliders.items()}
    return write_recipe(path, recipe_of(sculptor.session.project, latents, shape, **words, sliders=sliders))
