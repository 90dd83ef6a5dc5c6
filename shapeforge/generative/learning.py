"""Learning a Beta Shape Machine: pre-training layer by layer, then fine-tuning everything together (§5)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from threadpoolctl import threadpool_limits

from shapeforge.generative._kernels import adam_step
from shapeforge.generative.finetuning import Batch, TopPrior, loss_and_gradient
from shapeforge.generative.inference import Latents, decode, first_layer_input, infer, sigmoid
from shapeforge.generative.machine import BetaShapeMachine, Sizes, project, recentre, start_machine
from shapeforge.generative.observations import LIMIT, Observations
from shapeforge.generative.pretraining import BATCH, pretrain_pair, pretrain_points
from shapeforge.generative.priors import EVERY, Strengths, apply_priors, near_points
from shapeforge.generative.structure import fit_structure

STEPS = 1600
"""Fine-tuning steps when no number of epochs is asked for: small families need many epochs, large ones few."""

RATE = 3e-3
DEFAULT_STRENGTHS = Strengths()

FURTHEST, WIDER = 3.0, 5.0
"""Of the variations that a family is enriched with: see ``vary``."""

FEWEST_TO_VALIDATE = 10
RAREST_SHARE = 0.1
"""A part seen on a smaller share of the shapes than this is weighted as if it were this frequent."""


@dataclass(frozen=True, eq=False)
class LearnState:
    """Where learning stands after one epoch.  Errors are mean |D - D'| over the existing points, in diagonals, through
    a sampled top (in pre-training: of the layer under way, in its own units); ``held_out_error`` is NaN without a
    validation split.  ``dead_units`` is the share of units per layer that hardly move over the shapes."""

    epoch: int
    of: int
    phase: str
    machine: BetaShapeMachine
    train_error: float
    held_out_error: float
    dead_units: tuple[float, ...]
    stop_reason: str | None


def learn_machine(
    observations: Observations,
    *,
    rng: np.random.Generator,
    epochs: int | None = None,
    pretraining: int | None = None,
    executor: Executor | None = None,
    validation: float = 0.1,
    sizes: Sizes | None = None,
    start: BetaShapeMachine | None = None,
    patience: float = 0.35,
    held_out: Int[np.ndarray, " n"] | None = None,
    strengths: Strengths = DEFAULT_STRENGTHS,
) -> Iterator[LearnState]:
    """Learn a machine; one state per epoch.  The last state holds the best machine by held-out error (see ``_score``).

    ``epochs`` of fine-tuning (default: enough for about 1600 steps) and ``pretraining`` epochs per layer; a share
    ``validation`` of the shapes is held out unless there are fewer than 10, or just the shapes ``held_out``, by index.
    ``strengths`` are those of the priors on the weights.  ``start`` continues from a machine (its pre-training is
    skipped).  With threads as ``executor`` the parts are worked on side by side (a cluster is left alone: see ``joint``
    and the fit for what is worth one); the result is the same bytes.
    Learning stops early when the held-out error has not fallen for a share ``patience`` of all epochs.

    Raises ValueError with fewer than two shapes to learn from.
    """
    if observations.n_shapes - (0 if held_out is None else len(np.unique(held_out))) < 2:
        raise ValueError(
            f"observations: wanted at least 2 shapes to learn from, got {observations.n_shapes}"
            f"{'' if held_out is None else f' of which {len(np.unique(held_out))} are held out'}; "
            "usually most shapes of the family were left out before learning"
        )
    # steps on a part take milliseconds: threads gain by them, another process would only wait for its data
    run = executor.map if isinstance(executor, ThreadPoolExecutor) else map
    train, judges = split(observations, validation, rng=rng, held_out=held_out)
    schedule = _Schedule.of(train.n_shapes, epochs, pretraining, continued=start is not None)
    done, total = 0, schedule.epochs
    if start is not None:
        machine = _continued(start, observations, rng)
    else:
        with threadpool_limits(1, "blas"):
            machine = start_machine(train, rng=rng, sizes=sizes)
        total += machine.n_layers * schedule.pretraining
        for phase, pretrained, error in _pretrain(machine, train, rng, schedule.pretraining, run):
            machine, done = pretrained, done + 1
            yield LearnState(done, total, phase, machine, error, np.nan, (np.nan,) * machine.n_layers, None)

    tuner, best = _Tuner.start(machine, train, strengths, schedule.epochs * schedule.steps), _Best(schedule, judges)
    for epoch in range(1, schedule.epochs + 1):
        with threadpool_limits(1, "blas"):
            tuner.epoch(train, schedule.batch, rng, run)
            if epoch % schedule.between_checks and epoch < schedule.epochs:
                continue
            state = _measure(tuner.machine, train, judges, done + epoch, total)
        stop = best.told(state, patience) or ("All epochs are done." if epoch == schedule.epochs else None)
        if stop is None:
            yield state
            continue
        with threadpool_limits(1, "blas"):
            finished = _calibrate(best.state.machine, observations, judges)
        yield replace(best.state, epoch=state.epoch, machine=finished, stop_reason=stop)
        return


@dataclass(frozen=True)
class _Schedule:
    """How long is learned: shapes in a ``batch``, ``steps`` in an epoch, ``epochs`` of fine-tuning, and of
    ``pretraining`` for each layer; the held-out shapes are looked at every ``between_checks`` epochs."""

    batch: int
    steps: int
    epochs: int
    pretraining: int

    @classmethod
    def of(cls, n_shapes: int, epochs: int | None, pretraining: int | None, *, continued: bool) -> _Schedule:
        batch = min(BATCH, n_shapes)
        steps = -(-n_shapes // batch)
        wanted = STEPS // 3 if continued else STEPS
        return cls(
            batch, steps, max(20, -(-wanted // steps)) if epochs is None else epochs,
            max(10, min(200, -(-150 // steps))) if pretraining is None else pretraining,
        )  # fmt: skip

    @property
    def between_checks(self) -> int:
        return max(1, round(25 / self.steps))


class _Best:
    """The best state so far, and how long none has been better."""

    def __init__(self, schedule: _Schedule, judges: Observations | None) -> None:
        self.state: LearnState | None = None
        self._schedule, self._judges, self._waited = schedule, 0 if judges is None else judges.n_shapes, 0

    def told(self, state: LearnState, patience: float) -> str | None:
        """Take notice of a state; why to stop, if it is time."""
        if self.state is None or _score(state, self._judges) < _score(self.state, self._judges):
            self.state, self._waited = state, 0
        else:
            self._waited += self._schedule.between_checks
        if not self._judges or self._waited < patience * self._schedule.epochs:
            return None
        return f"The error on held-out shapes has not fallen for {self._waited} epochs."


def reconstruction_error(
    machine: BetaShapeMachine, observations: Observations, values: Float[np.ndarray, "T K 3"]
) -> float:
    """Mean |D - D'| per coordinate over the points that exist, in diagonals."""
    counts = observations.exists[:, observations.part]
    residual = np.abs(values - observations.values).mean(axis=2)
    return float((residual * counts).sum() / max(counts.sum(), 1) * machine.diagonals_per_unit)


def sampled_reconstruction(
    machine: BetaShapeMachine, observations: Observations, *, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "T K 3"], Latents]:
    """Every shape back through one binary sample of its top layer, and its latents."""
    latents = infer(machine, observations.values, observations.exists)
    sample = (rng.random(latents.top.shape) < latents.top).astype(latents.top.dtype)
    return decode(machine, sample), latents


def _continued(start: BetaShapeMachine, observations: Observations, rng: np.random.Generator) -> BetaShapeMachine:
    """The machine to go on with.  A refined fit moves the family's cube a little: the machine takes the new one over
    (fine-tuning makes good the difference), and the structure part is fitted anew, exactly."""
    if not np.array_equal(start.part, observations.part) or start.part_names != observations.part_names:
        raise ValueError(
            f"start: wanted a machine of the same points and parts ({len(observations.part)} points, "
            f"{observations.part_names}), got {start.n_points} points, {start.part_names}; usually the templates were "
            "fitted anew since it was learned: learn without start"
        )
    structure = fit_structure(observations.exists, rng=rng)
    return replace(start.copy(), low=observations.low, high=observations.high, structure=structure)


def split(
    observations: Observations,
    share: float = 0.1,
    *,
    rng: np.random.Generator,
    held_out: Int[np.ndarray, " n"] | None = None,
) -> tuple[Observations, Observations | None]:
    """(training shapes, held-out shapes or None): those named by index in ``held_out``, or a random share.

    At least 2 and at most 200 are drawn, none from fewer than 10 shapes.  Raises ValueError for an index out of range.
    """
    n = observations.n_shapes
    if held_out is not None:
        if len(held_out) and not (0 <= held_out.min() and held_out.max() < n):
            raise ValueError(
                f"held_out: wanted indices of shapes in 0..{n - 1}, got {held_out.min()}..{held_out.max()}; "
                "usually the list was made for another collection"
            )
        rest = np.setdiff1d(np.arange(n), held_out)
        return observations.subset(rest), observations.subset(np.unique(held_out)) if len(held_out) else None
    if n < FEWEST_TO_VALIDATE or share <= 0:
        return observations, None
    order = rng.permutation(n)
    held = min(max(2, round(share * n)), 200)
    return observations.subset(np.sort(order[held:])), observations.subset(np.sort(order[:held]))


def _pretrain(machine, train, rng, epochs, run):
    """Yield (phase, machine, error) per epoch of each layer."""
    layers = pretrain_points(machine, train, rng=rng, epochs=epochs, run=run)
    for machine, error in _one_thread(layers):
        yield "layer1", machine, error * machine.diagonals_per_unit
    # The lower bias of a pair belongs to a machine without the layers below it.  It is used to learn the pair and then
    # dropped: H1 keeps the bias it learned with the points, H2 the one it learned with H1, and so on.
    lower = first_layer_input(machine, train.values, train.exists)
    for index in range(machine.n_layers - 1):
        lower = sigmoid(machine.biases[index] * (index > 0) + lower)
        centres = list(machine.centres)
        centres[index] = np.clip(lower.mean(axis=0), 0.02, 0.98)
        start = recentre(machine, centres)
        pair = pretrain_pair(lower, machine.sizes[index + 1], rng=rng, epochs=epochs)
        for arrays, error in _one_thread(pair):
            machine = replace(
                start,
                couplings=_changed(start.couplings, index, arrays["weights"]),
                biases=_changed(start.biases, index + 1, arrays["upper_bias"]),
                centres=_changed(start.centres, index + 1, arrays["upper_centre"]),
            )
            yield f"layer{index + 2}", machine, error
        lower = (lower - machine.centres[index]) @ machine.couplings[index]


def _changed(items: tuple, index: int, item: np.ndarray) -> tuple:
    return (*items[:index], item, *items[index + 1 :])


def _one_thread(steps: Iterator) -> Iterator:
    """The same iterator with one BLAS thread inside each step (and none of its settings outside)."""
    while True:
        with threadpool_limits(1, "blas"):
            item = next(steps, None)
        if item is None:
            return
        yield item


class _Tuner:
    """Parameters and Adam moments of fine-tuning, changed in place."""

    def __init__(self, machine: BetaShapeMachine, prior: TopPrior, strengths: Strengths, near, n_steps: int):
        self.machine, self.prior, self.n_steps, self.step = machine, prior, n_steps, 0
        self.strengths, self.near = strengths, near
        self.moments: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    @classmethod
    def start(cls, machine: BetaShapeMachine, train: Observations, strengths: Strengths, n_steps: int) -> _Tuner:
        latents = infer(machine, train.values, train.exists)
        machine = recentre(machine, [np.clip(layer.mean(axis=0), 0.05, 0.95) for layer in latents.layers])
        prior = TopPrior(np.zeros_like(machine.biases[-1]), np.zeros_like(machine.existence_top))
        near = near_points(train) if strengths.smooth else None
        return cls(project(machine).copy(), prior, strengths, near, n_steps)

    def epoch(self, train: Observations, batch_size: int, rng: np.random.Generator, run: Callable) -> None:
        """One pass over the shapes, then the projection to positive parameters."""
        share = np.maximum(train.exists.mean(axis=0), RAREST_SHARE)
        _, which, counts = np.unique(train.exists, axis=0, return_inverse=True, return_counts=True)
        population = counts[which]
        order = rng.permutation(train.n_shapes)
        for first in range(0, train.n_shapes, batch_size):
            chosen = order[first : first + batch_size]
            values = vary(train.values[chosen], train.exists[chosen], population[chosen], rng=rng)
            uniform = rng.random((len(chosen), self.machine.sizes[-1]), dtype=np.float32)
            batch = Batch(values, train.exists[chosen], 1 / share, uniform=uniform)
            _, gradient = loss_and_gradient(self.machine, self.prior, batch, run)
            self._update(gradient)
        positive = project(self.machine)
        for name in ("weights", "rest"):
            for mine, new in zip(getattr(self.machine, name), getattr(positive, name), strict=True):
                mine[...] = new

    def _update(self, gradient: dict) -> None:
        self.step += 1
        # Warm up over the first steps (the moments know nothing yet), then fall to zero along a cosine.
        rate = RATE * min(1, self.step / 20) * 0.5 * (1 + np.cos(np.pi * min(self.step / self.n_steps, 1)))
        for name, value in gradient.items():
            owner, field = (self.prior, name[6:]) if name.startswith("prior_") else (self.machine, name)
            target = getattr(owner, field)
            pairs = zip(target, value, strict=True) if isinstance(target, tuple) else [(target, value)]
            for index, (array, slope) in enumerate(pairs):
                key = f"{name}.{index}"
                if key not in self.moments:
                    self.moments[key] = (np.zeros(array.size, np.float32), np.zeros(array.size, np.float32))
                decay = self.strengths.decay if name in ("weights", "couplings") else 0.0
                # Ā is of the order of the concentration, weights and biases of 1: its steps must be larger.
                scale = 5.0 if name == "rest" else 1.0
                adam_step(
                    array.reshape(-1), np.ascontiguousarray(slope, np.float32).reshape(-1), *self.moments[key],
                    scale * rate, decay, self.step,
                )  # fmt: skip
        if self.step % EVERY == 0 and (self.strengths.smooth or self.strengths.sparse):
            apply_priors(self.machine, self.near, self.strengths, EVERY * rate)


def vary(
    values: Float[np.ndarray, "n K 3"],
    exists: Bool[np.ndarray, "n L"],
    population: Int[np.ndarray, " n"],
    *,
    rng: np.random.Generator,
) -> Float[np.ndarray, "n K 3"]:
    """Shapes like these: each moved some way towards a random combination of those with the same parts.

    A family of some tens of shapes leaves its own space nearly empty, and a machine this size learns it by heart.  The
    combinations are Gaussian with the covariance of the shapes at hand.  ``population`` (n,) is how many shapes of the
    family have the same parts: the fewer, the further each is moved, and the wider than the sample's own covariance
    (which underestimates) the combinations reach.
    """
    varied = values.copy()
    patterns, which = np.unique(exists[:, ::-1], axis=0, return_inverse=True)  # the first part changes fastest
    for index in range(len(patterns)):
        members = np.flatnonzero(which == index)
        n = len(members)
        if n < 2:
            continue
        known = float(population[members[0]])
        flat = values[members].reshape(n, -1)
        mean = flat.mean(axis=0)
        share = rng.uniform(0, min(1.0, FURTHEST / known**0.35), (n, 1))
        mix = share * rng.standard_normal((n, n)) * ((1 + WIDER / known) / np.sqrt(n - 1))
        mix[np.diag_indices(n)] += np.sqrt(1 - share[:, 0] ** 2)
        varied[members] = (mean + mix.astype(values.dtype) @ (flat - mean)).reshape(n, *values.shape[1:])
    return np.clip(varied, LIMIT, 1 - LIMIT)


def _measure(
    machine: BetaShapeMachine, train: Observations, held_out: Observations | None, epoch: int, of: int
) -> LearnState:
    some = train.subset(np.arange(min(train.n_shapes, 200)))
    # The same draws at every check, so that checks can be compared.
    again, latents = sampled_reconstruction(machine, some, rng=np.random.default_rng(0))
    train_error, held_error = reconstruction_error(machine, some, again), float("nan")
    if held_out is not None:
        again, _ = sampled_reconstruction(machine, held_out, rng=np.random.default_rng(0))
        held_error = reconstruction_error(machine, held_out, again)
    return LearnState(
        epoch, of, "fine-tune", machine.copy(), train_error, held_error, dead_units(machine, latents), None
    )


def dead_units(machine: BetaShapeMachine, latents: Latents) -> tuple[float, ...]:
    """Share of units per layer whose probability varies by less than .01 (standard deviation) over the shapes.

    Units of parts that a shape lacks are not counted for that shape.
    """
    first = []
    for index, slot in enumerate(machine.units_of_part):
        present = latents.first[latents.exists[:, index], slot]
        if len(present) > 1:
            first.append(present.std(axis=0))
    spreads = [np.concatenate(first) if first else np.ones(1), *(layer.std(axis=0) for layer in latents.layers[1:])]
    return tuple(float((spread < 0.01).mean()) for spread in spreads)


def _score(state: LearnState, n_held_out: int) -> float:
    """What the best machine is chosen by: the held-out error, leaning on the training error when few shapes judge.

    Four held-out shapes alone pick an early machine by chance.
    """
    if n_held_out == 0:
        return state.train_error
    trust = n_held_out / (n_held_out + 10)
    return trust * state.held_out_error + (1 - trust) * state.train_error


def _calibrate(
    machine: BetaShapeMachine, observations: Observations, held_out: Observations | None
) -> BetaShapeMachine:
    """The machine with ``spread`` measured: what the top leaves unexplained, on held-out shapes if there are any."""
    judged = observations if held_out is None else held_out
    latents = infer(machine, judged.values, judged.exists)
    residual = (decode(machine, latents.top) - judged.values) * machine.diagonals_per_unit
    counts = judged.exists[:, judged.part][..., None].astype(float)
    # Few shapes judge each point: lean on the part's own mean square as if on four more shapes.
    square = (residual.astype(float) ** 2 * counts).sum(axis=0)
    seen = counts.sum(axis=0)
    spread = np.full(machine.spread.shape, 0.02)
    everywhere = float(square.sum() / max(3 * seen.sum(), 1))
    for members in machine.points_of_part:
        own = float(square[members].sum() / (3 * seen[members].sum())) if seen[members].sum() else everywhere
        spread[members] = np.sqrt((square[members] + 4 * own) / (seen[members] + 4))
    return replace(machine, spread=np.maximum(spread, 1e-3).astype(np.float32))
