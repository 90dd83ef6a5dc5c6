"""The paper's Figure 7 on generated airplanes: a bundle that turns straight wings and tailplanes into swept ones.

    python -m benchmarks.figure_seven [--count 200] [--points 500] [--seed 0] [--out FIGURE.png] [--json]

A machine is learned; every bundle (a unit of H2 with those of H1 that it drives) is set at 0, ½ and 1, which is where
the family's shapes have its unit most off, half-way, and most on, from the middle of the family.  The table tells how
far the leading edges of wing and tailplane are swept back (degrees), and the chord near the tip relative to that near
the root; the bundle that changes the sweep of both most comes first, and is drawn from above with ``--out``.  Beside
them: what the airplanes of the family have.  The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.machine_families import generated
from shapeforge.collection.colours import part_colours
from shapeforge.collection.iterate import last
from shapeforge.generative.learning import learn_machine
from shapeforge.generative.units import bundles, drive, middle_shape
from shapeforge.validation.statistics import format_table

SURFACES = ("wing", "tailplane")
STRIPS = (0.1, 0.3, 0.5, 0.7, 0.9, 0.98)
"""Shares of the points, from the root to the tip, between which the leading edge is looked for."""

SIZE = 480


def swept(points: np.ndarray) -> tuple[float, float]:
    """(sweep of the leading edge in degrees, chord near the tip / near the root) of a pair of wings: x is across, z
    ahead."""
    points = points[np.isfinite(points[:, 0])]
    across, ahead = np.abs(points[:, 0]), points[:, 2]
    bounds = np.quantile(across, STRIPS)
    strips = [(across >= a) & (across <= b) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
    front, back = (np.array([np.quantile(ahead[strip], q) for strip in strips]) for q in (0.97, 0.03))
    slope = np.polyfit([across[strip].mean() for strip in strips], front, 1)[0]
    chord = front - back
    return float(np.degrees(np.arctan(-slope))), float(chord[-1] / chord[0])


def from_above(shapes: list[np.ndarray], part: np.ndarray, n_parts: int):
    """The shapes side by side, seen from above, nose up."""
    from PIL import Image, ImageDraw

    colours = part_colours(n_parts)[part]
    image = Image.new("RGB", (SIZE * len(shapes), SIZE), "white")
    pen = ImageDraw.Draw(image)
    for index, points in enumerate(shapes):
        for (x, _, z), colour in zip(points, colours, strict=True):
            if np.isfinite(x):
                at = SIZE * np.array([index + 0.5 + 0.9 * x, 0.5 - 0.9 * z])
                pen.ellipse([*(at - 2), *(at + 2)], fill=tuple(int(c) for c in colour[:3]))
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", action="store_true", help="only the last line")
    options = parser.parse_args()
    family = generated("airplanes", options.count, seed=options.seed, n_points=options.points).observations
    machine = last(learn_machine(family, rng=np.random.default_rng([options.seed, 1]))).machine
    found, middle = bundles(machine, family), middle_shape(machine, family)
    members = [np.flatnonzero(family.part == family.part_names.index(name)) for name in SURFACES]
    measured = []
    for index, bundle in enumerate(found):
        ends = bundle.edges[0], bundle.edges[-1]
        shapes = [
            drive(machine, middle, {index: float(v)}, directions=found) for v in (ends[0], sum(ends) / 2, ends[1])
        ]
        table = np.array([[swept(points[own]) for points in shapes] for own in members])
        turns = table[:, -1, 0] - table[:, 0, 0]
        both = min(abs(turns)) if np.prod(turns) > 0 else 0.0
        measured.append((both, bundle, shapes, table))
    measured.sort(key=lambda item: -item[0])
    own = [
        [swept(points[rows]) for points in family.positions() if np.isfinite(points[rows, 0]).any()] for rows in members
    ]
    usual = [np.percentile(np.array(one)[:, 0], (5, 50, 95)).tolist() for one in own]
    if not options.json:
        head = ["", *(f"{name} {what} at {at}" for name in SURFACES for what in ("sweep", "taper") for at in "0½1")]
        rows = [[b.name, *(float(v) for one in table for v in one.T.ravel())] for _, b, _, table in measured]
        print(format_table(head, rows))
        for name, (low, middle_, high) in zip(SURFACES, usual, strict=True):
            print(f"sweep of the family's {name}s: 5th percentile {low:.0f}°, median {middle_:.0f}°, 95th {high:.0f}°")
    _, bundle, shapes, table = measured[0]
    if options.out is not None:
        from_above(shapes, family.part, len(family.part_names)).save(options.out)
    print(
        json.dumps({"bundle": bundle.name, "caption": bundle.caption, "sweep_taper": table.tolist(), "family": usual})
    )


if __name__ == "__main__":
    main()
