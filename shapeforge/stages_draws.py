"""What ``synthesize`` draws: parts on or off, units held, near a shape, between two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from shapeforge.stages import StageError
from shapeforge.store import Project


def drawn_as_asked(project: Project, options: Mapping[str, Any], count: int, *, rng: np.random.Generator) -> Any:
    """``count`` draws of the project's machine as the options of ``synthesize`` ask for.

    ``having`` and ``lacking`` name parts, ``hold`` (["2:14=0.9", …]) units by layer and number, both from 1 for H1's
    first; ``like`` names a shape to stay near; ``between`` two, from the one to the other.  Raises StageError.
    """
    from shapeforge.generative.draw import Draw
    from shapeforge.generative.evidence import between, draw_given, held
    from shapeforge.generative.inference import decode

    machine, mixture = project.machine(), project.mixture()
    names = machine.part_names
    needed, unwanted = (_indices(options.get(side), names, side) for side in ("having", "lacking"))
    both = np.intersect1d(needed, unwanted)
    if len(both):
        raise StageError(f"{names[both[0]]} is asked for and not wanted at the same time")
    clamped = dict(_held_unit(text, machine.sizes) for text in options.get("hold") or ())
    like, ends = options.get("like"), options.get("between")
    if ends:
        if like or len(ends) != 2:
            raise StageError(f"between: wanted two shapes (and no like), got {', '.join(ends)}")
        way = between(*(latents_of(project, machine, name) for name in ends), np.linspace(0, 1, count))
        exists = way.exists.copy()
        exists[:, needed], exists[:, unwanted] = True, False
        latents = replace(way, layers=held(machine, way.layers, clamped), exists=exists)
        return Draw(machine.to_positions(decode(machine, latents), exists), exists, latents)
    return draw_given(
        machine, mixture, count, rng=rng, clamped=clamped, needed=needed, unwanted=unwanted,
        start=latents_of(project, machine, like) if like else None, temperature=float(options["temperature"]),
    )  # fmt: skip


def _indices(wanted: Sequence[str] | None, names: Sequence[str], side: str) -> np.ndarray:
    unknown = [name for name in wanted or () if name not in names]
    if unknown:
        raise StageError(f"{side}: no part is called {unknown[0]!r}; the family has {', '.join(names)}")
    return np.array(sorted({list(names).index(name) for name in wanted or ()}), np.int64)


def _held_unit(text: str, sizes: tuple[int, ...]) -> tuple[tuple[int, int], float]:
    """((layer, unit) from 0, value) of "layer:unit=value"."""
    try:
        place, value = text.split("=")
        layer, unit = (int(number) - 1 for number in place.split(":"))
        if 0 <= layer < len(sizes) and 0 <= unit < sizes[layer] and 0 <= float(value) <= 1:
            return (layer, unit), float(value)
    except ValueError:
        pass
    raise StageError(f"hold: wanted layer:unit=value with layers of {', '.join(map(str, sizes))} units, got {text!r}")


def latents_of(project: Project, machine: Any, name: str) -> Any:
    """What the machine takes a fitted shape to be; raises StageError for an unknown name."""
    from shapeforge.generative.inference import infer
    from shapeforge.generative.observations import observe

    positions = project.positions(name) if name in project.fit_names else None
    if positions is None:
        raise StageError(f"no fitted shape is called {name!r}; the family has {', '.join(project.fit_names[:4])}, …")
    places = project.beliefs(name).to_family(np.asarray(positions, np.float64))
    seen = observe(places[None], machine.part, machine.part_names, machine.low, machine.high)
    return infer(machine, seen.values, seen.exists)
