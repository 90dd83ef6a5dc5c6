"""Where shapes stand on the sliders: their values along directions, bundles and single units, as histograms count them.

A slider's setting is a change; its histogram shows where the shapes of the family are.  These scales tie the two: the
value of a shape as it is, to which a setting is added.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from shapeforge.generative.inference import Latents, sigmoid, slider_logit
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.units import Direction, layer_of


class Scales:
    """The scales of some sliders over a family.  ``family`` are the latents of its shapes, as many as were learnt from.

    Values are those of ``Direction``: logits less the mean of the shapes with the same parts, relative to the median.
    """

    def __init__(self, machine: BetaShapeMachine, family: Latents, directions: Sequence[Direction]) -> None:
        self._layers = [layer_of(machine, direction) for direction in directions]
        self._directions = list(directions)
        self._exists = family.exists
        self._logits = {layer: slider_logit(family.layers[layer]) for layer in sorted(set(self._layers))}
        self._means: dict[tuple[int, bytes], np.ndarray] = {}
        patterns = {row.tobytes(): row for row in family.exists}
        middles = np.zeros((len(family.exists), len(directions)))
        for key, row in patterns.items():
            members = np.flatnonzero((family.exists == row).all(axis=1))
            for layer, logits in self._logits.items():
                self._means[layer, key] = logits[members].mean(axis=0)
            middles[members] = self._along(family[members], row)
        has = np.stack([self._has(machine, direction) for direction in directions], axis=1) if directions else None
        self._medians = np.array([np.median(middles[has[:, i], i]) for i in range(len(directions))])

    def _has(self, machine: BetaShapeMachine, direction: Direction) -> Bool[np.ndarray, " T"]:
        """The shapes that are counted: for a single unit those that have its part."""
        if direction.kind != "unit":
            return np.ones(len(self._exists), bool)
        part = next(l for l, slot in enumerate(machine.units_of_part) if slot.start <= direction.unit < slot.stop)
        return self._exists[:, part] if self._exists[:, part].any() else np.ones(len(self._exists), bool)

    def _mean(self, layer: int, exists: Bool[np.ndarray, " L"]) -> np.ndarray:
        """Mean logits of the shapes with these parts; of all, where no shape has just these."""
        known = self._means.get((layer, np.asarray(exists, bool).tobytes()))
        return self._logits[layer].mean(axis=0) if known is None else known

    def _along(self, shapes: Latents, exists: Bool[np.ndarray, " L"]) -> Float[np.ndarray, "n D"]:
        found = np.zeros((len(shapes.exists), len(self._directions)))
        for i, (layer, direction) in enumerate(zip(self._layers, self._directions, strict=True)):
            if direction.unit is None:
                away = slider_logit(shapes.layers[layer]) - self._mean(layer, exists)
                found[:, i] = away @ direction.vector
            else:
                own = slider_logit(shapes.layers[layer][:, direction.unit])
                found[:, i] = own - self._mean(layer, exists)[direction.unit]
        return found

    def values(self, shape: Latents) -> Float[np.ndarray, " D"]:
        """Where one shape stands on every slider (D,), in the directions' own units."""
        return self._along(shape[:1], shape.exists[0])[0] - self._medians

    def rows(self, sizes: tuple[int, ...]) -> Float[np.ndarray, "D A"]:
        """What to multiply the logits of all layers with, side by side (A,), for the values (D,), up to constants.

        ``sizes`` are those of the layers.
        """
        starts = np.cumsum([0, *sizes])
        found = np.zeros((len(self._directions), int(starts[-1])))
        for i, (layer, direction) in enumerate(zip(self._layers, self._directions, strict=True)):
            if direction.unit is None:
                found[i, starts[layer] : starts[layer + 1]] = direction.vector
            else:
                found[i, starts[layer] + direction.unit] = 1.0
        return found

    def level(self, index: int, value: float, exists: Bool[np.ndarray, " L"]) -> tuple[tuple[int, int], float] | None:
        """((layer, unit), activation in 0..1) at which a unit holds its slider at ``value``; None for a direction."""
        layer, unit = self._layers[index], self._directions[index].unit
        if unit is None:
            return None
        logit_there = value + self._medians[index] + self._mean(layer, exists)[unit]
        return (layer, unit), float(sigmoid(np.array([logit_there]))[0])
