"""Drawing new shapes: kernels on the codes of the family's shapes, all layers at once, then Betas' means (§5).

Independent units, or Gibbs sampling between H2 and H3, draw clumps; so does a mixture of Bernoullis over the top alone,
and what the top leaves unexplained is then missing from every draw.  Here a draw starts from the logits of all layers
of one shape and goes part of the way towards a random combination of the shapes with the same parts: as far as makes
draws differ from the family's shapes as much as these do from each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.distance import cdist

from shapeforge.generative.inference import Latents, decode, infer, logit, sigmoid
from shapeforge.generative.machine import BetaShapeMachine
from shapeforge.generative.observations import Observations
from shapeforge.generative.structure import StructureMachine

WIDTH = 0.5
"""Standard deviation of a kernel, as a share of that of the shapes with the same parts, where no two shapes are there
to tell (see ``fit_mixture``)."""

WIDTHS = (0.05, 0.5**0.5)
"""Between these the width is looked for.  At the widest a draw owes half to the shape that it starts from; where shapes
have so much of their own that no width makes draws as new as they are, still wider ones are merely unlike them."""

WIDTH_STEPS = 6
TRIED, COMPARED = 200, 400
"""Draws by which the width is found, and points of each that are compared."""

LARGEST_LOGIT = 8.0
FEW = 4.0
"""A combination of parts with as many shapes as this varies half as it did itself, half as the others did."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """One kernel for each of T shapes: ``codes`` (T, A) are the logits of all layers side by side, ``sizes`` the number
    of units of each; ``patterns`` (S, L) are the combinations of parts seen, ``which`` (T,) that of every shape.
    ``width`` is the standard deviation of a kernel, as a share of that of the shapes with the same parts."""

    codes: Float[np.ndarray, "T A"]
    sizes: Int[np.ndarray, " l"]
    patterns: Bool[np.ndarray, "S L"]
    which: Int[np.ndarray, " T"]
    width: float = WIDTH

    def layers(self, codes: Float[np.ndarray, "n A"]) -> tuple[Float[np.ndarray, "n _"], ...]:
        """Probabilities of the units of every layer from rows of codes."""
        return tuple(sigmoid(part) for part in np.split(codes, np.cumsum(self.sizes)[:-1], axis=1))


@dataclass(frozen=True, eq=False)
class Draw:
    """n new shapes: ``points`` in normal coordinates (NaN where a part is absent), their parts and their latents."""

    points: Float[np.ndarray, "n K 3"]
    exists: Bool[np.ndarray, "n L"]
    latents: Latents


def fit_mixture(machine: BetaShapeMachine, observations: Observations) -> Mixture:
    """The kernels of a family: what the machine takes each of its shapes to be.

    They are as wide as makes draws as new as a new shape would be: on average a draw is as far from the nearest shape
    with the same parts as these are from the nearest other one (root mean square over corresponding points).
    """
    latents = infer(machine, observations.values, observations.exists)
    codes = _kept(np.concatenate([logit(layer) for layer in latents.layers], axis=1))
    patterns, which = np.unique(observations.exists, axis=0, return_inverse=True)
    mixture = Mixture(codes.astype(np.float32), np.array(machine.sizes), patterns, which.reshape(-1))
    return replace(mixture, width=_fitting_width(machine, mixture, observations))


def _fitting_width(machine: BetaShapeMachine, mixture: Mixture, observations: Observations) -> float:
    """The width by bisection; always with the same noise, so that it is a function of the family."""
    with_others = np.flatnonzero(np.bincount(mixture.which)[mixture.which] > 1)
    if not len(with_others):
        return WIDTH
    rng = np.random.default_rng(0)
    start = rng.choice(with_others, TRIED)
    which = mixture.which[start]
    noise, middle = _variation(mixture, which, rng), _means(mixture)[which]
    points = np.unique(np.linspace(0, machine.n_points - 1, COMPARED).astype(int))
    known, there = observations.values[:, points], mixture.patterns[:, machine.part[points]]

    def away(rows: np.ndarray, rank: int) -> float:
        """Mean distance (root mean square) of ``rows`` to the nearest shapes with the same parts, bar ``rank``."""
        found = []
        for index in np.unique(which):
            own, others = (
                one[:, there[index]].reshape(len(one), -1)
                for one in (rows[which == index], known[mixture.which == index])
            )
            found.append(np.partition(cdist(own, others), rank, axis=1)[:, rank] / np.sqrt(max(own.shape[1], 1)))
        return float(np.concatenate(found).mean())

    usual, (low, high) = away(known[start], 1), WIDTHS
    for _ in range(WIDTH_STEPS):
        width = (low + high) / 2
        codes = _kernel(mixture.codes[start], middle, noise, width).astype(machine.dtype)
        drawn = decode(machine, Latents(mixture.layers(codes), mixture.patterns[which]))
        low, high = (width, high) if away(drawn[:, points], 0) < usual else (low, width)
    return (low + high) / 2


def draw(
    machine: BetaShapeMachine,
    mixture: Mixture,
    n: int,
    *,
    rng: np.random.Generator,
    exists: Bool[np.ndarray, " L"] | None = None,
    temperature: float = 1.0,
) -> Draw:
    """n new shapes: the parts and roughly the code of a shape of the family, then the mean of every Beta.

    ``exists`` asks for these parts (any combination): shapes that have most nearly these are then started from.
    ``temperature`` below 1 draws more typical shapes, above 1 more unusual ones.
    """
    if n < 1:
        raise ValueError(f"n: wanted at least 1 shape, got {n}; usually a count of 0 was asked for")
    codes, states = draw_codes(mixture, n, rng=rng, exists=exists, temperature=temperature)
    latents = Latents(mixture.layers(codes.astype(machine.dtype)), states)
    return Draw(machine.to_positions(decode(machine, latents), states), states, latents)


def draw_codes(
    mixture: Mixture,
    n: int,
    *,
    rng: np.random.Generator,
    exists: Bool[np.ndarray, " L"] | None = None,
    temperature: float = 1.0,
    prefer: Float[np.ndarray, " T"] | None = None,
    needed: Int[np.ndarray, " m"] | None = None,
    unwanted: Int[np.ndarray, " m2"] | None = None,
    structure: StructureMachine | None = None,
) -> tuple[Float[np.ndarray, "n A"], Bool[np.ndarray, "n L"]]:
    """Codes (n, A) and parts (n, L) of n draws.

    ``prefer`` (nats) says which shapes to start from rather than others; parts ``needed`` (by index) are there, those
    ``unwanted`` are not, and the rest as on the shapes that come nearest to this.  Where no shape has parts like that,
    ``structure`` says which of these are then likely together with the rest.
    """
    _check(temperature)
    of_shape = mixture.patterns[mixture.which]
    on, off = (np.zeros(0, int) if some is None else some for some in (needed, unwanted))
    if exists is not None:
        lacking = (of_shape != exists).sum(axis=1)
        states = np.broadcast_to(exists, of_shape.shape).copy()
    else:
        lacking = (~of_shape[:, on]).sum(axis=1) + of_shape[:, off].sum(axis=1)
        states = of_shape.copy()
    states[:, on], states[:, off] = True, False
    weight = np.zeros(len(states)) if prefer is None else prefer
    if structure is not None and lacking.min() > 0:
        weight = weight + structure.log_unnormalized(states)
    weight = np.where(lacking == lacking.min(), weight, -np.inf)
    chosen = _spread_choice(np.exp(weight - weight.max()), n, rng, mixture.which)
    which = mixture.which[chosen]
    middle = _means(mixture)[which]
    noise = _variation(mixture, which, rng)
    return _kernel(mixture.codes[chosen], middle, noise, mixture.width, temperature), states[chosen]


def _spread_choice(weight: np.ndarray, n: int, rng: np.random.Generator, kind: np.ndarray | None = None) -> np.ndarray:
    """n indices, each drawn in proportion to its weight, together as evenly as n allows (systematic sampling): draws
    made at once start from different shapes as long as there are enough, and every ``kind`` of them gets its share."""
    order = rng.permutation(len(weight))
    if kind is not None:
        order = order[np.argsort(kind[order], kind="stable")]
    upto = np.cumsum(weight[order])
    chosen = np.searchsorted(upto, (np.arange(n) + rng.random()) * (upto[-1] / n), side="right")
    return rng.permutation(order[np.minimum(chosen, len(order) - 1)])


def _kernel(
    codes: np.ndarray, middle: np.ndarray, noise: np.ndarray, width: float, temperature: float = 1.0
) -> np.ndarray:
    """Codes moved by ``noise``, and towards the ``middle`` of their kind so that these vary no more than before."""
    away = np.sqrt(1 - width**2) * (codes - middle) + width * noise
    return _kept(middle + temperature * away)


def codes_near(
    mixture: Mixture, start: Latents, n: int, *, rng: np.random.Generator, temperature: float = 1.0
) -> Float[np.ndarray, "n A"]:
    """Codes (n, A) near that of one shape: the lower the temperature the nearer."""
    _check(temperature)
    own = _kept(np.concatenate([logit(layer[:1]) for layer in start.layers], axis=1))
    alike = int((mixture.patterns != start.exists[:1]).sum(axis=1).argmin())
    return _kept(own + temperature * mixture.width * _variation(mixture, np.full(n, alike), rng))


def _check(temperature: float) -> None:
    if temperature <= 0:
        raise ValueError(f"temperature: wanted a positive number, got {temperature}; use e.g. 0.1 for typical shapes")


def _kept(codes: np.ndarray) -> np.ndarray:
    return np.clip(codes, -LARGEST_LOGIT, LARGEST_LOGIT)


def _means(mixture: Mixture) -> np.ndarray:
    """Mean code (S, A) of the shapes with each combination of parts."""
    return np.stack([mixture.codes[mixture.which == index].mean(axis=0) for index in range(len(mixture.patterns))])


def _variation(mixture: Mixture, which: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random moves (n, A) of the size and kind that shapes with the same parts (S index ``which`` (n,)) differ by."""
    counts = np.bincount(mixture.which)
    moved = mixture.codes - _means(mixture)[mixture.which]
    free = len(moved) - len(counts)
    # Where no two shapes have the same parts, all are taken as one crowd.
    everybody, free = (
        (moved, free) if free > 0 else (mixture.codes - mixture.codes.mean(axis=0), max(len(moved) - 1, 1))
    )
    noise = np.empty((len(which), moved.shape[1]))
    for index in np.unique(which):
        rows, own = which == index, moved[mixture.which == index]
        trust = 0.0 if len(own) < 2 else len(own) / (len(own) + FEW)
        alike = rng.standard_normal((rows.sum(), len(own))) @ own / np.sqrt(max(len(own) - 1, 1))
        others = rng.standard_normal((rows.sum(), len(moved))) @ everybody / np.sqrt(free)
        noise[rows] = np.sqrt(trust) * alike + np.sqrt(1 - trust) * others
    return noise
