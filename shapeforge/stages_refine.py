"""The stage that alternates fit and learning: joint analysis and synthesis (§5), while shapes set aside agree."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.collection.counts import counted, grouped
from shapeforge.stages import Progress, StageError, Task
from shapeforge.stages_model import (
    learn_into,
    named_split,
    round_text,
    stacked_positions,
    starting_groups,
    starting_parts,
    write_shapes,
)
from shapeforge.stages_status import RESULTS
from shapeforge.store import Project
from shapeforge.store_arrays import read_record, write_record
from shapeforge.store_results import write_names, write_round

ROUNDS_PER_ALTERNATION = 1
"""Outer rounds of the fit under the machine's prior in each alternation.  Rounds beyond the fit's own let points slide,
whatever the prior, and what each gains it gains at once (docs/machine.md)."""

PRIOR_STRENGTH = 0.4
"""Share of its own precision with which the machine counts: it learned from the very points that it speaks of."""

SET_ASIDE = 0.2
"""Share of the shapes that judge the alternations: no machine learns from them."""

LEAST_SHAPES = 4


def refine(task: Task) -> Iterator[Progress]:
    """Joint analysis and synthesis: the machine is a prior on the fit, the refined fit teaches the machine, 3 times.

    An alternation is undone, and was the last, if either of two judges refuses it, of which neither asks the machine
    that moved the points.  The templates must come to explain the surfaces of most shapes better; and some shapes are
    set aside, to whose surfaces a machine that learns from the refined shapes must come as near as one that learns as
    long from the shapes as they were.
    """
    from shapeforge.deformation.exemplars import blend, leading
    from shapeforge.deformation.family import ROUNDS as FAMILY_ROUNDS
    from shapeforge.deformation.fit import fit_templates
    from shapeforge.deformation.hierarchy import corresponding_points
    from shapeforge.generative.joint import held_out_errors, is_worse, mostly_falls
    from shapeforge.generative.learning import learn_machine
    from shapeforge.generative.observations import observe

    # not what it made of them the last time: the same options give the same result
    project, folder = task.project.unrefined(), task.folder
    names, hierarchy = project.names, project.hierarchy()
    labels, part_names, seeds = starting_parts(project)
    write_names(folder / "names.zarr.zip", names)
    judges = judging_shapes(project, names, rng=np.random.default_rng(task.options["seed"]))
    checkpoint = folder / "alternation.zarr.zip"
    number, of, kept = 0, int(task.options["alternations"]), 0
    errors: list[list[float]] = []
    refused = ""

    def learnt(positions: np.ndarray, start: Any, what: str) -> Iterator[Progress]:
        """Learning without the judges; the state of the last progress is its last one."""
        seen = observe(positions, hierarchy.top.label, tuple(hierarchy.top.part_names))
        rng = np.random.default_rng([task.options["seed"], number])
        for state in learn_machine(seen, rng=rng, executor=task.workers, start=start, held_out=judges):
            yield task.progress("learn", number, of, f"{what}, epoch {state.epoch}", state=state)

    def surfaces(state: Any) -> list[np.ndarray]:
        return [blend(state.candidates[t]).to_family(project.shapes[t].points) for t in judges.tolist()]

    def misfits(state: Any) -> np.ndarray:
        return np.array([leading(candidates).misfit for candidates in state.candidates])

    def save() -> None:
        saved = {"number": number, "kept": kept, "errors": errors, "refused": refused, "state": state}
        write_record(checkpoint, saved | {"machine": machine, "positions": positions})

    if checkpoint.is_file():
        saved = read_record(checkpoint)[0]
        number, kept, errors, refused, state, machine, positions = (
            saved[key] for key in ("number", "kept", "errors", "refused", "state", "machine", "positions")
        )
        yield task.progress("alternate", number, of, f"goes on after alternation {number}", state=state)
    else:
        state, positions = project.fit(), stacked_positions(project, names)
        for progress in learnt(positions, None, f"{counted(len(judges), 'shape')} set aside"):
            yield progress
        machine = progress.state.machine
        save()
    while number < of and kept == number:
        refined, rounds = state, state.round + ROUNDS_PER_ALTERNATION
        states = fit_templates(
            project.shapes, starting_groups(project), labels, part_names, rounds=rounds,
            family_rounds=min(FAMILY_ROUNDS, rounds - max(state.family_from, 0)),
            rng=np.random.default_rng(number), executor=task.workers, seeds=seeds, resume=state,
            prior=machine_prior(machine, positions, hierarchy, state.templates),
        )  # fmt: skip
        for refined in states:
            text = f"alternation {number + 1}, {round_text(refined)}"
            yield task.progress("alternate", number, of, text, state=refined)
        before, after = misfits(state), misfits(refined)
        if not mostly_falls(before, after):
            number += 1
            refused = f"templates lie worse on {grouped((after > before).sum())} of {counted(len(names), 'shape')}"
            save()
            break

        def corresponding(t: int, state: Any = refined) -> np.ndarray:
            beliefs = blend(state.candidates[t])
            return beliefs.to_family(corresponding_points(project.shapes[t], beliefs, hierarchy)[0])

        moved = np.stack(list(task.workers.map(corresponding, range(len(names)))))
        for as_was in learnt(positions, machine, f"alternation {number + 1}, as it was"):
            yield as_was
        for as_is in learnt(moved, machine, f"alternation {number + 1}, refined"):
            yield as_is
        before = held_out_errors(as_was.state.machine, positions[judges], surfaces(state))
        after = held_out_errors(as_is.state.machine, moved[judges], surfaces(refined))
        errors.append([float(before.mean()), float(after.mean())])
        number += 1
        if is_worse(before, after):
            refused = f"shapes set aside are missed by {percent(errors[-1])} of their size"
        else:
            # Points that a prior has moved agree with it: only as they were do they tell how far to trust it.
            machine = replace(as_is.state.machine, spread=machine.spread)
            kept, state, positions = number, refined, moved
            write_round(folder / "rounds" / f"{state.round:03d}.zarr.zip", state)
        save()
        yield task.progress("alternate", number, of, verdict(errors, kept, refused), state=state)
    if kept:
        for progress in learn_into(
            replace(task, project=project), folder, names, positions, epochs=None, start=machine
        ):
            yield task.progress("alternate", number - 1, of, progress.message)
        write_record(folder / "hierarchy.zarr.zip", hierarchy)
        yield from write_shapes(task, folder, state, hierarchy)
        write_record(folder / "fit.zarr.zip", state)
    else:
        _keep_former(project, folder)
    text = verdict(errors, kept, refused)
    task.summary |= {"text": text, "alternations": of, "kept": kept, "held_out_errors": errors, "judges": len(judges)}
    task.origin = {"of": _result(project, "fit"), "from": _result(project, "learn")}
    checkpoint.unlink(missing_ok=True)
    yield task.progress("faces", len(names), len(names), text, state=state)


def verdict(errors: Sequence[Sequence[float]], kept: int, refused: str) -> str:
    """What became of the alternations, in words; ``errors`` are [as it was, refined] of those that the shapes set aside
    judged, ``refused`` is why one was undone ("": none was)."""
    text = "nothing is refined"
    if kept:
        text = f"{kept} alternations, shapes set aside missed by {', '.join(map(percent, errors[:kept]))}"
    if refused:
        text += f"; alternation {kept + 1} made it worse ({refused}): the correspondences stay as they were before it"
    return text


def percent(change: Sequence[float]) -> str:
    """Two lengths in diagonals, in % of the size."""
    return " to ".join(f"{100 * length:.3f}%" for length in change)


def judging_shapes(project: Project, names: Sequence[str], *, rng: np.random.Generator) -> np.ndarray:
    """Indices of the shapes set aside: those that ``learn --test`` named, else a fifth (at least 2), no exemplars."""
    if len(names) < LEAST_SHAPES:
        raise StageError(f"refine sets shapes aside to judge by: wanted at least {LEAST_SHAPES}, got {len(names)}")
    options = (project.stage_record("learn") or {}).get("options") or {}
    split = named_split(names, options.get("train"), options.get("test"))
    if split is not None:
        return split[1]
    exemplars = set(starting_groups(project).exemplars.tolist()) if project.groups is not None else set()
    order = rng.permutation(len(names)).tolist()
    others = sorted(order, key=lambda t: t in exemplars)
    return np.sort(np.array(others[: max(2, round(SET_ASIDE * len(names)))]))


def _keep_former(project: Project, folder: Path) -> None:
    """The results of the fit and of the machine as the results of this stage."""
    fit, learnt = project.current_folder("fit"), project.current_folder("learn")
    for name in RESULTS["refine"]:
        source = learnt if name in RESULTS["learn"] else fit
        shutil.copy2(source / f"{name}.zarr.zip", folder / f"{name}.zarr.zip")
    shutil.copytree(fit / "shapes", folder / "shapes", dirs_exist_ok=True)


def _result(project: Project, stage: str) -> str | None:
    return (project.stage_record(stage) or {}).get("result")


def machine_prior(
    machine: Any, positions: np.ndarray, hierarchy: Any, templates: Sequence[Any]
) -> Callable[[int, int], tuple[np.ndarray, np.ndarray]]:
    """The machine's opinion on every shape's corresponding points, handed down to the templates of its group."""
    from shapeforge.generative.joint import shape_prior

    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def prior(t: int, g: int) -> tuple[np.ndarray, np.ndarray]:
        if t not in found:
            found.clear()  # asked shape by shape: the one at hand is enough
            found[t] = shape_prior(machine, positions[t], PRIOR_STRENGTH)
        return on_template(*found[t], hierarchy.links[g], templates[g].n_points)

    return prior


def on_template(mean: np.ndarray, precision: np.ndarray, link: Any, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """A Gaussian on top-level points (K, 3), handed to the template points that each is a convex mix of.

    A template point takes the precision-weighted mean of what is said about the top-level points it takes part in;
    where nothing is said its precision is 0.
    """
    mean, precision = np.asarray(mean, np.float64), np.asarray(precision, np.float64)
    said = np.isfinite(mean) & np.isfinite(precision) & link.exists[:, None]
    precision = np.where(said, precision, 0.0)
    weighted = np.where(said, mean, 0.0) * precision
    total, moment = np.zeros((n_points, 3)), np.zeros((n_points, 3))
    for j in range(link.index.shape[1]):
        share = link.weight[:, j, None]
        np.add.at(total, link.index[:, j], share * precision)
        np.add.at(moment, link.index[:, j], share * weighted)
    return np.divide(moment, total, out=np.zeros_like(moment), where=total > 0), total
