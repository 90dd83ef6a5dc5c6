"""Part boxes fitted to the pieces of all shapes jointly, in the spirit of the box templates of Kim 2013.

A part is a box that is learnt: the mean and the spread of where its pieces lie, how far they reach and which way they
face.  On every shape the box may sit elsewhere, by an offset that all its pieces there share, so a bar stool's legs
are as much legs as a bench's:

    x[u] ~ N(mean[l] + offset[t, l], spread[l])     offset[t, l] ~ N(0, play[l])      for piece u of shape t and part l

Means, spreads and plays are found by expectation maximisation; a part without pieces on a shape is absent there.
No single start or frame is best for every family, so many fits are made and agree on the answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from sklearn.cluster import KMeans

ROUNDS = 40
SETTLED = 1e-4  # relative change of the bound that ends the rounds
LEAST_SPREAD, LEAST_PLAY, MOST_PLAY = 0.05, 0.02, 0.5  # variances, in units of the standardised features
SHARED = 20.0  # pieces' worth of belief that a part spreads as much as the others do
PLAY_BELIEF, USUAL_PLAY = 2.0, 0.1  # shapes' worth of belief in the usual play
TEMPERS = (0.25, 0.5, 1.0)  # power of its area with which a piece counts: small parts need a voice, too
STARTS = 6
BESIDE = 0.8  # share of its shapes on which a part split off lies beside the rest; else it is another kind of the same
NEARLY = 0.1  # halves that are less distinct by no larger a share are about as distinct
FEWEST_SPLIT, FEWEST_OFF, LEAST_SHARE = 8, 3, 0.003  # pieces to split, pieces split off, and their share of the area


@dataclass(frozen=True, eq=False)
class PartBoxes:
    """Boxes of L parts over F features of pieces, their offsets on T shapes, and the probability of each part.

    ``bound`` is the evidence lower bound in nats.
    """

    mean: Float[np.ndarray, "L F"]
    spread: Float[np.ndarray, "L F"]
    play: Float[np.ndarray, "L F"]
    offset: Float[np.ndarray, "T L F"]
    belongs: Float[np.ndarray, "n L"]
    bound: float

    @property
    def part(self) -> Int[np.ndarray, " n"]:
        """The most probable part of every piece."""
        return self.belongs.argmax(axis=1)


def fit_boxes(
    features: Float[np.ndarray, "n F"], owner: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"],
    n_parts: int, *, rng: np.random.Generator, starts: int = STARTS, least_spread: float = LEAST_SPREAD,
) -> PartBoxes:  # fmt: skip
    """Boxes of ``n_parts`` parts for pieces (n, F) of shapes ``owner`` (n,), the best of several k-means starts.

    ``features`` are standardised, ``weight`` says how much a piece counts (only ratios matter).  Raises ValueError for
    fewer pieces than parts.
    """
    if len(features) < n_parts:
        raise ValueError(f"n_parts: wanted at most the number of pieces ({len(features)}), got {n_parts}")
    weight = weight / weight.mean()
    best = None
    for _ in range(starts):
        model = KMeans(n_parts, n_init=1, random_state=int(rng.integers(2**31)))
        part = model.fit(features, sample_weight=weight).labels_
        found = _expectation_maximisation(features, owner, weight, np.eye(n_parts)[part], least_spread)
        if best is None or found.bound > best.bound:
            best = found
    assert best is not None
    return best


def _expectation_maximisation(
    x: np.ndarray, owner: np.ndarray, weight: np.ndarray, belongs: np.ndarray, least_spread: float
) -> PartBoxes:
    n_shapes, n_parts = int(owner.max()) + 1, belongs.shape[1]
    spread, play = np.full((n_parts, x.shape[1]), 0.3), np.full((n_parts, x.shape[1]), USUAL_PLAY)
    mass = weight[:, None] * belongs
    mean = (mass.T @ x) / np.maximum(mass.sum(axis=0)[:, None], 1e-9)
    shape_of = np.zeros((n_shapes, len(x)))
    shape_of[owner, np.arange(len(x))] = 1.0
    bound = -np.inf
    for step in range(ROUNDS):
        mass = weight[:, None] * belongs
        pieces = shape_of @ mass
        sums = np.stack([shape_of @ (mass[:, part, None] * x) for part in range(n_parts)], axis=1)
        precision = pieces[:, :, None] / spread + 1.0 / play
        offset = (sums - pieces[:, :, None] * mean) / spread / precision
        doubt = 1.0 / precision
        total = mass.sum(axis=0) + 1e-9
        mean = (sums - pieces[:, :, None] * offset).sum(axis=0) / total[:, None]
        present = np.minimum(pieces, 1.0)[:, :, None]
        wandering = (present * (offset**2 + doubt)).sum(axis=0)
        play = (wandering + PLAY_BELIEF * USUAL_PLAY) / (present.sum(axis=0) + PLAY_BELIEF)
        play = np.clip(play, LEAST_PLAY, MOST_PLAY)
        off = (x[:, None] - mean - offset[owner]) ** 2 + doubt[owner]
        own = (mass[:, :, None] * off).sum(axis=0)
        shared = own.sum(axis=0) / total.sum()
        spread = (own + SHARED * shared) / (total[:, None] + SHARED) + least_spread
        log = np.log(total / total.sum()) - 0.5 * np.log(spread).sum(axis=1) - 0.5 * (off / spread).sum(axis=2)
        top = log.max(axis=1, keepdims=True)
        evidence = top[:, 0] + np.log(np.exp(log - top).sum(axis=1))
        belongs = np.exp(log - evidence[:, None])
        moved = 0.5 * ((offset**2 + doubt) / play - 1.0 - np.log(doubt / play))
        last, bound = bound, float(weight @ evidence - (present * moved).sum())
        if step > 5 and abs(bound - last) < SETTLED * abs(bound):
            break
    return PartBoxes(mean, spread, play, offset, belongs, bound)


def agreed_parts(
    views: Sequence[Float[np.ndarray, "_ _"]], owner: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"],
    n_parts: int, *, rng: np.random.Generator, others: Sequence[Int[np.ndarray, " n"]] = (),
) -> Int[np.ndarray, " n"]:  # fmt: skip
    """The part (n,) of every piece that many fits agree on: of the same pieces in several ``views`` (n, F).

    Boxes are fitted to every view, with small pieces counting more or less, and ``others`` are answers found otherwise.
    Each answer is renamed to fit the one that agrees best with all (adjusted Rand index), and votes with the square of
    its own mean agreement.
    """
    answers = [
        fit_boxes(view, owner, np.maximum(weight, 1e-9) ** temper, n_parts, rng=rng).part
        for temper in TEMPERS
        for view in views
    ] + list(others)
    agreement = np.array([[adjusted_rand(a, b, weight) for b in answers] for a in answers]).mean(axis=1)
    model = answers[int(agreement.argmax())]
    votes = np.zeros((len(owner), n_parts))
    for answer, voice in zip(answers, agreement, strict=True):
        votes[np.arange(len(owner)), renamed(answer, model, weight, n_parts)] += max(float(voice), 0.0) ** 2
    return votes.argmax(axis=1)


def adjusted_rand(one: Int[np.ndarray, " n"], other: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    """Agreement of two clusterings of weighted things: 1 for the same, about 0 for unrelated ones (Hubert 1985)."""
    table = np.zeros((int(one.max()) + 1, int(other.max()) + 1))
    np.add.at(table, (one, other), weight / weight.sum())
    rows, columns = (table.sum(axis=1) ** 2).sum(), (table.sum(axis=0) ** 2).sum()
    chance, most = rows * columns, 0.5 * (rows + columns)
    return float(((table**2).sum() - chance) / (most - chance)) if most - chance > 1e-12 else 1.0


def renamed(
    part: Int[np.ndarray, " n"], model: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"], n_parts: int
) -> Int[np.ndarray, " n"]:
    """``part`` (n,) with its parts renamed one to one so that it agrees with ``model`` in as much weight as it can."""
    table = np.zeros((n_parts, n_parts))
    np.add.at(table, (part, model), weight)
    names = np.empty(n_parts, np.int64)
    row, column = linear_sum_assignment(-table)
    names[row] = column
    return names[part]


def split_most_distinct(
    features: Float[np.ndarray, "n F"], owner: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"],
    part: Int[np.ndarray, " n"], *, rng: np.random.Generator,
) -> Int[np.ndarray, " n"]:  # fmt: skip
    """``part`` (n,) with one part more: the smaller side of the most distinct halves that any part falls into.

    Halves are fits of two boxes; distinct is the Bhattacharyya distance of their Gaussians.  Of those that are about as
    distinct the smallest is split off: had it been large, it would have been found before.  What is split off must
    occur on two shapes at least.  Returns ``part`` where nothing can be split.
    """
    found: list[tuple[float, float, np.ndarray]] = []
    for one in range(int(part.max()) + 1):
        rows = np.flatnonzero(part == one)
        if len(rows) < FEWEST_SPLIT:
            continue
        for smaller in _two_halves(features[rows], weight[rows], rng):
            off, rest = rows[smaller], rows[~smaller]
            enough = len(off) >= FEWEST_OFF and weight[off].sum() >= LEAST_SHARE * weight.sum()
            where = np.unique(owner[off])
            if not enough or len(where) < min(2, len(np.unique(owner))):
                continue
            if np.isin(where, owner[rest]).mean() < BESIDE:
                continue
            found.append((bhattacharyya(features[off], features[rest]), float(weight[off].sum()), off))
    split = part.copy()
    if found:
        most = max(distance for distance, *_ in found)
        about_as_distinct = (one for one in found if one[0] >= (1 - NEARLY) * most)
        split[min(about_as_distinct, key=lambda one: one[1])[2]] = int(part.max()) + 1
    return split


def _two_halves(features: np.ndarray, weight: np.ndarray, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Which rows (n,) are the smaller of two halves, by fits of two boxes, with small pieces counting more or less."""
    for temper in (TEMPERS[0], TEMPERS[-1]):
        # As if all were one shape: boxes that move would share what should be told apart.
        still, counts = np.zeros(len(features), np.int64), np.maximum(weight, 1e-9) ** temper
        half = fit_boxes(features, still, counts, 2, rng=rng, least_spread=2 * LEAST_SPREAD).part
        yield half == (weight[half == 0].sum() > weight[half == 1].sum())


def halves(
    features: Float[np.ndarray, "n F"], weight: Float[np.ndarray, " n"], *, rng: np.random.Generator
) -> Bool[np.ndarray, " n"] | None:
    """Which pieces (n,) are the smaller of the most distinct halves; None where the pieces fall into no two."""
    most, chosen = 0.0, None
    if len(np.unique(features, axis=0)) < 2:
        return None
    for smaller in _two_halves(features, weight, rng):
        if smaller.any() and not smaller.all():
            distance = bhattacharyya(features[smaller], features[~smaller])
            if distance > most:
                most, chosen = distance, smaller
    return chosen


def bhattacharyya(one: Float[np.ndarray, "n F"], other: Float[np.ndarray, "m F"]) -> float:
    """Distance of the diagonal Gaussians of two sets of rows, nats, with a floor of .1 under their variances."""
    variances = one.var(axis=0) + 0.1, other.var(axis=0) + 0.1
    middle = 0.5 * (variances[0] + variances[1])
    apart = (one.mean(axis=0) - other.mean(axis=0)) ** 2 / middle
    return float(0.125 * apart.sum() + 0.5 * (np.log(middle) - 0.5 * np.log(variances[0] * variances[1])).sum())
