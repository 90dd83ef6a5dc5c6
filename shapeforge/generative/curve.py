"""Would more shapes help?  The error on shapes held out while learning from more and more of the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from shapeforge.collection.iterate import last
from shapeforge.generative.inference import decode, infer
from shapeforge.generative.learning import learn_machine, reconstruction_error, split
from shapeforge.generative.machine import layer_sizes
from shapeforge.generative.observations import Observations

SHARES = (0.25, 0.5, 1.0)
WORTH = 0.07
"""Twice as many shapes are worth having when they are expected to lower the error by this share."""


@dataclass(frozen=True)
class CurvePoint:
    """Mean |D - D'| over the existing points, in diagonals, after learning from ``shapes`` shapes: of these, and of the
    shapes held out."""

    shapes: int
    train_error: float
    held_out_error: float


def learning_curve(
    observations: Observations,
    *,
    rng: np.random.Generator,
    shares: Sequence[float] | None = None,
    held_out: Int[np.ndarray, " n"] | None = None,
    epochs: int | None = None,
    executor: Executor | None = None,
) -> Iterator[CurvePoint]:
    """Learn from a growing share of the shapes, one point each; the same held-out shapes judge all (a fifth, or those
    named by index).  The smaller sets lie within the larger ones, and all machines have units for the largest.

    ``shares`` are by default SHARES.  Raises ValueError when a share leaves fewer than 2 shapes or nothing is held out.
    """
    shares = SHARES if shares is None else shares
    train, judges = split(observations, 0.2, rng=rng, held_out=held_out)
    counts = [round(share * train.n_shapes) for share in shares]
    if judges is None or min(counts) < 2 or max(counts) > train.n_shapes:
        raise ValueError(
            f"observations, shares: wanted held-out shapes and at least 2 to learn from, got {observations.n_shapes} "
            f"shapes of which shares {tuple(shares)} are learned from; fewer than 10 shapes tell nothing"
        )
    order = rng.permutation(train.n_shapes)
    sizes = layer_sizes(np.bincount(train.part, minlength=len(train.part_names)).tolist(), max(counts))
    for count in counts:
        some = train.subset(np.sort(order[:count]))
        machine = last(learn_machine(some, rng=rng.spawn(1)[0], epochs=epochs, executor=executor, sizes=sizes)).machine
        errors = []
        for shapes in (some, judges):
            latents = infer(machine, shapes.values, shapes.exists)
            errors.append(reconstruction_error(machine, shapes, decode(machine, latents.top)))
        yield CurvePoint(count, *errors)


def more_shapes(curve: Sequence[CurvePoint]) -> tuple[float, str]:
    """(expected held-out error with twice as many shapes, in diagonals; a sentence that says whether they would help).

    A power law through the points, the later ones counting more; errors are not expected below the training error.
    """
    if len(curve) < 2:
        raise ValueError(f"curve: wanted at least 2 points, got {len(curve)}; ask for more shares")
    shapes = np.log([point.shapes for point in curve])
    error = np.log([point.held_out_error for point in curve])
    slope, _ = np.polyfit(shapes, error, 1, w=np.sqrt([point.shapes for point in curve]))
    now = curve[-1]
    expected = min(now.held_out_error * 2.0 ** min(float(slope), 0.0), now.held_out_error)
    expected = max(expected, min(now.train_error, now.held_out_error))
    gain = 1 - expected / now.held_out_error
    verdict = "more shapes would help" if gain >= WORTH else "more shapes would hardly help"
    return expected, (
        f"From {now.shapes} shapes new ones come back to {100 * now.held_out_error:.2f}% of their size; "
        f"from {2 * now.shapes}, {100 * expected:.2f}% is expected: {verdict}."
    )
