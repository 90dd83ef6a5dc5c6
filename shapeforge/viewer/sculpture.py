"""What the Synthesize place shows: the shape in hand with what is known about it, and how hot a slider makes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from shapeforge.collection.counts import counted
from shapeforge.viewer.display import Caption, Display, Mark, MeshLayer, PointLayer, View
from shapeforge.viewer.mesh_worker import Made
from shapeforge.viewer.palette import heat
from shapeforge.viewer.recipe import Recipe
from shapeforge.viewer.sculptor import Sculptor

Layer = MeshLayer | PointLayer


def heated(sculptor: Sculptor, layer: Layer, points: Float[np.ndarray, "K 3"], index: int) -> Layer:
    """The layer, each place as hot as a slider moves the nearest of the shape's ``points``."""
    there = np.isfinite(points).all(axis=1)
    moves = sculptor.moves(index)[there]
    share = moves / max(float(np.quantile(moves, 0.98)) if len(moves) else 0.0, 1e-9)
    if isinstance(layer, PointLayer):
        return replace(layer, colours=heat(share))
    nearest = cKDTree(points[there]).query(layer.vertices[layer.triangles].mean(axis=1))[1]
    return replace(layer, colours=heat(share[nearest]))


def display(
    layers: tuple[Layer, ...], made: Made | None, label: str, busy: bool, marks: tuple[Mark, ...] = (),
    moves: bool = False, *, failed: bool = False, n_pins: int = 0, turn: int = 0,
) -> Display:  # fmt: skip
    """The shape with what is known about it in the corners; it ``moves`` while something is dragged.

    ``turn`` counts the draws that were put aside for it so far, as their parts did not go together.
    """
    lines = (("points only: the mesh could not be made", "error"),) if failed else _size_words(made)
    captions = [Caption("top left", ((label, "strong"), *lines))]
    if made is not None:
        nearest = f"nearest real shape: {made.nearest}, {100 * made.nearest_distance:.1f}% of size"
        captions.append(Caption("top right", ((origin_words(made.shape.sources), "plain"), (nearest, "plain"))))
        captions.append(Caption("bottom right", ((measure_words(made.shape.measures), "plain"),)))
    if busy:
        words = f"the parts did not go together: another draw ({turn + 1})…" if turn else "making the mesh…"
        captions.append(Caption("bottom left", ((words, "faint"),)))
    else:
        pins = f"{counted(n_pins, 'point')} pinned; Ctrl+click or Delete takes a pin away"
        words = pins if n_pins else "Drag a handle on the shape, the rest follows"
        captions.append(Caption("bottom left", ((words, "faint"),)))
    return Display((View(layers, marks, tuple(captions), moves=moves),))


def small_view(sculptor: Sculptor, recipe: Recipe, made: Made | None) -> View:
    """A shape of the history for a small picture: its mesh, or its points while there is none."""
    if made is not None:
        return View((sculptor.mesh_layer(made.shape),))
    return View((sculptor.points_layer(sculptor.points(recipe), 2.0),))


def origin_words(sources: tuple[str, ...]) -> str:
    """Which training shapes lent parts; none did for a new surface."""
    used = sorted({name for name in sources if name})
    if not used:
        return "a new surface, of no shape's parts"
    return f"parts from {', '.join(used[:3])}" + (f" and {len(used) - 3} more" if len(used) > 3 else "")


def _size_words(made: Made | None) -> tuple[tuple[str, str], ...]:
    if made is None:
        return ()
    measures = made.shape.measures
    words = counted(len(made.shape.triangles), "face")
    if made.preview:
        words = f"preview, {words}"
    if not made.preview and measures.get("open_edges") == 0:
        words += ", watertight"
    lines = [(words, "plain")]
    if "not_united" in measures:
        why = str(measures["not_united"]).removeprefix("union: ").partition(";")[0]
        lines.append((f"not one solid: {why}", "warning"))
    apart = "" if made.preview else apart_words(measures)
    return (*lines, (apart, "warning")) if apart else tuple(lines)


def apart_words(measures: Mapping[str, Any]) -> str:
    """That the parts of a made mesh do not go together, "" where they do (see ``stages_synthesis.fault_of``)."""
    from shapeforge.stages_synthesis import APART, UNLIKE

    gap, unlike = measures.get("largest_gap"), measures.get("distance_from_draw") or 0.0
    if gap is None:
        return ""
    if gap > APART:
        return f"parts stay {100 * gap:.1f}% of size apart"
    return f"no parts go there: {100 * unlike:.0f}% of size off the points" if unlike > UNLIKE else ""


def measure_words(measures: Mapping[str, Any]) -> str:
    """What was measured on a made mesh, in one line."""
    words = []
    if "largest_gap" in measures:
        words.append(f"gaps {100 * measures['largest_gap']:.1f}%")
    elif measures.get("distance_from_draw") is not None:
        words.append(f"{100 * measures['distance_from_draw']:.1f}% off the points")
    if measures.get("symmetry_error") is not None:
        words.append(f"symmetry {100 * measures['symmetry_error']:.1f}% of size")
    if "folded_triangles" in measures:
        folded = int(measures["folded_triangles"])
        words.append(counted(folded, "folded triangle"))
    if measures.get("redrawn"):
        words.append(f"{measures['redrawn']} other draw{'s' * (measures['redrawn'] != 1)} put aside")
    return " · ".join(words)
