"""The stages of the model: fit and learn (``stages_refine`` alternates the two)."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from shapeforge.collection.counts import counted
from shapeforge.stages import Progress, StageError, Task
from shapeforge.stages_collection import read_proposal
from shapeforge.stages_status import first_parts, starts_from_proposal
from shapeforge.store import Project
from shapeforge.store_arrays import read_record, write_record, write_text
from shapeforge.store_results import write_names, write_round
from shapeforge.workers import Workers

SECONDS_BETWEEN_CHECKPOINTS = 20.0

# -- fit -------------------------------------------------------------------------------------------------------------


def fit(task: Task) -> Iterator[Progress]:
    """Templates, correspondences, segmentations (a checkpoint a round), then the high-level templates and faces."""
    from shapeforge.deformation.fit import Within, fit_templates
    from shapeforge.deformation.warm import refit_templates
    from shapeforge.stages_pace import Pace
    from shapeforge.stages_warm import keep_rounds, warm_start

    project, folder = task.project, task.folder
    checkpoint, went_warm = folder / "checkpoint.zarr.zip", folder / "warm.json"
    # a fit that was finished and lost some of its files is not fitted again, and one that lost itself begins anew
    reached = next((file for file in (checkpoint, folder / "fit.zarr.zip") if file.is_file()), None)
    state = None if reached is None else read_record(reached)[0]
    start, reason = None, ""
    if state is not None:
        start = state if went_warm.is_file() else None
    else:
        for left in (folder / "shapes", folder / "rounds"):
            shutil.rmtree(left, ignore_errors=True)
        went_warm.unlink(missing_ok=True)
    if state is None and task.options["warm"]:
        start, reason = warm_start(project)
        if start is None:
            yield task.progress("fit", 0, 1, f"starts anew: {reason}")
    labels, part_names, seeds = starting_parts(project)
    keys = {name: project.shape_record(name)["key"] for name in project.names}
    write_names(folder / "names.zarr.zip", project.names, keys=keys, first_parts=first_parts(project))
    if state is None or state.stop_reason is None:
        options, rng = task.options, np.random.default_rng(task.options["seed"])
        known = (project.shapes, starting_groups(project), labels, part_names)
        more = {"inner": options["inner"], "rng": rng, "executor": task.workers, "seeds": seeds}
        if state is not None:
            yield task.progress("fit", state.round, state.of, f"goes on after round {state.round}", state=state)
        elif start is not None:
            write_text(went_warm, "{}")
            yield task.progress("corrected", 0, 1, "finding the corrected shapes anew")
        steps = (
            fit_templates(*known, rounds=options["rounds"], resume=state, within=True, **more)
            if start is None
            else refit_templates(start, *known, within=True, **more)
        )
        pace = Pace(0) if state is None and start is None else Pace(state.round + 1) if state is not None else None
        planned = planned_costs(project, known[1], labels, seeds, options)
        for step in steps:
            if isinstance(step, Within):
                which, share = f"shape {step.shape} of {step.of_shapes}", step.shape / step.of_shapes
                if pace is None:
                    yield task.progress("corrected", step.shape, step.of_shapes, f"found anew, {which}")
                    continue
                left = pace.left(costs_at(planned, state, step.of), step.round + share)
                if step.round == 0:
                    message = f"affine start, {which}"
                    yield task.progress("start", step.shape, step.of_shapes, message, seconds_left=left)
                    continue
                message = f"round {step.round}, {which}"
                yield task.progress("fit", step.round - 1, step.of, message, within=share, seconds_left=left)
                continue
            if state is None and start is not None:
                keep_rounds(project, folder, step)
            state = step
            pace = pace or Pace(state.round + 1)
            write_record(checkpoint, state)
            write_round(folder / "rounds" / f"{state.round:03d}.zarr.zip", state)
            left = pace.left(costs_at(planned, state, state.of), state.round + 1.0)
            yield task.progress("fit", state.round, state.of, round_text(state), state=state, seconds_left=left)
    if state is None:
        raise StageError("the fit made no round; wanted rounds of at least 1")
    yield task.progress("hierarchy", 0, 1, "linking the groups' templates", state=state)
    hierarchy = state.hierarchy()
    write_record(folder / "hierarchy.zarr.zip", hierarchy)
    yield from write_shapes(task, folder, state, hierarchy)
    write_record(folder / "fit.zarr.zip", state)
    checkpoint.unlink(missing_ok=True)
    text = f"{state.round} rounds, {counted(len(hierarchy.top.label), 'corresponding point')}"
    text += f", {hierarchy.levels} levels of templates" if hierarchy.levels > 2 else ""
    task.summary |= {
        "text": text, "rounds": state.round, "energy": _number(state.energy), "stop_reason": state.stop_reason,
        "points": len(hierarchy.top.label), "parts": list(part_names), "shapes": list(project.names),
        "levels": hierarchy.levels,
        "painted": {name: project.label_key(name) for name in project.labelled},
        "exemplars": [template.source for template in state.templates if template.source],
    }  # fmt: skip
    yield task.progress("faces", len(project.names), len(project.names), text, state=state)


def planned_costs(
    project: Project, groups: Any, labels: Mapping[int, Any], seeds: Any, options: Mapping[str, Any]
) -> Any:
    """What a fit that begins is going to cost (``stages_pace.FitCosts``)."""
    from shapeforge.deformation.fit import EXEMPLARS_PER_SHAPE, exemplar_rounds, planned_rounds
    from shapeforge.stages_pace import FitCosts

    exemplars = max(1, sum(seeds is not None or int(t) in labels for t in groups.exemplars))
    faces = float(np.mean([project.shape_record(name)["n_triangles"] for name in project.names]))
    return FitCosts(
        len(project.names), project.shapes[0].n_points, faces, exemplars, planned_rounds(options["rounds"], exemplars),
        exemplar_rounds(options["rounds"]), float(min(exemplars, EXEMPLARS_PER_SHAPE)),
    )  # fmt: skip


def costs_at(planned: Any, state: Any | None, of: int) -> Any:
    """What a fit costs that is at ``state`` (None: at its start) and will have ``of`` rounds."""
    if state is None:
        return replace(planned, of=of)
    heard = sum(not one.family for found in state.candidates for one in found) / len(state.candidates)
    return replace(
        planned, of=of, heard=heard, exemplars=len(state.templates) - (state.family is not None),
        family_from=state.family_from if state.family_from >= 0 else planned.family_from,
    )  # fmt: skip


def starting_parts(project: Project) -> tuple[dict[int, np.ndarray], tuple[str, ...], Sequence[np.ndarray] | None]:
    """Labels by shape index, part names, and label probabilities per point where the fit starts from proposed parts."""
    labels = {t: project.labels(name) for t, name in enumerate(project.names) if project.label_key(name)}
    proposal = read_proposal(project) if starts_from_proposal(project) else None
    if proposal is not None:
        return labels, tuple(proposal.part_names), proposal.segmentation
    names = project.part_names.names if project.part_names else ()
    groups = project.groups
    if groups is not None and not any(int(t) in labels for t in groups.exemplars):
        wanted = ", ".join(project.names[t] for t in groups.exemplars)
        raise StageError(
            f"no exemplar has labels: label at least one of {wanted}, or make a labelled shape an exemplar: "
            f"shapeforge group {project.path} --exemplars NAME"
        )
    return labels, tuple(names), None


def starting_groups(project: Project) -> Any:
    """The groups that the fit starts from: those of proposed parts have the exemplars that came with them."""
    proposal = read_proposal(project) if starts_from_proposal(project) else None
    if proposal is None or project.groups is None:
        return project.groups
    return replace(project.groups, exemplars=proposal.exemplars)


def write_shapes(task: Task, folder: Path, state: Any, hierarchy: Any) -> Iterator[Progress]:
    """Faces, corresponding points and part counts of every shape, one file each; those of an interrupted run stay."""
    from shapeforge.deformation.components import count_parts
    from shapeforge.deformation.exemplars import blend
    from shapeforge.deformation.faces import explanations, label_faces
    from shapeforge.deformation.hierarchy import corresponding_points

    project, names = task.project, task.project.names

    def work(t: int) -> None:
        path = folder / "shapes" / f"{names[t]}.zarr.zip"
        if path.is_file():
            return
        shape, beliefs = project.shapes[t], blend(state.candidates[t])
        labels, probabilities = label_faces(shape, beliefs, project.labels(names[t]), explained=explanations(state, t))
        positions, existence = corresponding_points(shape, beliefs, hierarchy)
        found = {"beliefs": beliefs, "labels": np.asarray(labels, np.int32), "positions": positions}
        found |= {"existence": existence, "counts": count_parts(shape, hierarchy.top, existence, beliefs)}
        write_record(path, found | {"probabilities": np.asarray(probabilities, np.float32)})

    for t, _ in enumerate(task.workers.map(work, range(len(names)))):
        yield task.progress("faces", t + 1, len(names), names[t])


def round_text(state: Any) -> str:
    """What a round of the fit came to, in words."""
    if state.round == 0:
        return "affine start"
    text = f"round {state.round}: energy {state.energy:.3f} nats a point, moved {state.change:.4f} diagonals"
    return f"{text}; {state.stop_reason}" if state.stop_reason else text


def _number(value: Any) -> float | None:
    """A JSON number: None instead of NaN."""
    return float(value) if value is not None and np.isfinite(value) else None


# -- learn -----------------------------------------------------------------------------------------------------------


def learn(task: Task) -> Iterator[Progress]:
    """The Beta Shape Machine of the fitted family, what new shapes are drawn from, sliders and descriptors."""
    project, options = task.project, task.options
    names = project.fit_names
    split = named_split(names, options["train"], options["test"])
    positions = stacked_positions(project, names)
    yield from learn_into(task, task.folder, names, positions, epochs=options["epochs"], split=split)
    yield task.progress("describe", 1, 1, task.summary["text"])


Split = tuple[np.ndarray, np.ndarray]
"""Indices of the shapes to learn from, and of those that judge."""


def named_split(names: Sequence[str], train: Sequence[str] | None, test: Sequence[str] | None) -> Split | None:
    """The shapes that were named to learn from and to judge; None where none were, or ["auto"] (a random tenth judges).

    With one of the two the others are all the rest.  Raises StageError for an unknown name or one on both sides.
    """
    train, test = (None if given == ["auto"] else given for given in (train, test))
    if not train and not test:
        return None
    unknown = sorted({*(train or ()), *(test or ())} - set(names))
    if unknown:
        raise StageError(f"--train, --test: no fitted shape is called {unknown[0]!r}; the family has {names[0]}, …")
    both = sorted(set(train or ()) & set(test or ()))
    if both:
        raise StageError(f"--train, --test: {both[0]} is named in both; a shape learned from cannot judge")
    chosen = [np.array([t for t, name in enumerate(names) if name in set(some or ())], int) for some in (train, test)]
    for side, given in enumerate((train, test)):
        if not given:
            chosen[side] = np.setdiff1d(np.arange(len(names)), chosen[1 - side])
    if len(chosen[0]) < 2:
        raise StageError(f"--train, --test: wanted at least 2 shapes to learn from, got {len(chosen[0])}")
    return chosen[0], chosen[1]


def stacked_positions(project: Project, names: Sequence[str]) -> np.ndarray:
    """Corresponding points of all shapes (T, K, 3), normal coordinates as the family lies, NaN where absent."""
    found = [project.positions(name) for name in names]
    missing = [name for name, positions in zip(names, found, strict=True) if positions is None]
    if missing:
        raise StageError(f"{missing[0]} was not fitted. Fit again: shapeforge fit {project.path} --restart")
    beliefs = [project.beliefs(name) for name in names]
    return np.stack([one.to_family(positions) for one, positions in zip(beliefs, found, strict=True)])


def learn_into(
    task: Task, folder: Path, names: Sequence[str], positions: np.ndarray, *, epochs: int | None, start: Any = None,
    split: Split | None = None,
) -> Iterator[Progress]:  # fmt: skip
    """Learn from corresponding points (T, K, 3) and write everything the machine brings into ``folder``.

    With a ``split`` draws start from the shapes learned from, too, and from no others; all shapes are described.
    """
    from shapeforge.generative.descriptors import describe_shapes
    from shapeforge.generative.draw import fit_mixture
    from shapeforge.generative.learning import learn_machine
    from shapeforge.generative.observations import observe
    from shapeforge.generative.units import directions

    project, rng = task.project, np.random.default_rng(task.options["seed"])
    hierarchy = project.hierarchy()
    observations = observe(positions, hierarchy.top.label, tuple(hierarchy.top.part_names))
    checkpoint = folder / "checkpoint.zarr.zip"
    if checkpoint.is_file():
        saved = read_record(checkpoint)[0]
        start, epochs = saved["machine"], max(1, saved["left"])
        yield task.progress("learn", saved["epoch"], saved["epoch"] + saved["left"], "goes on from the last checkpoint")
    state, saved_at = None, time.monotonic()
    seen, held_out = observations, None
    if split is not None:
        seen = observations.subset(np.concatenate(split))
        held_out = np.arange(len(split[0]), seen.n_shapes)
    settings = {"epochs": epochs, "executor": task.workers, "start": start, "held_out": held_out}
    for state in learn_machine(seen, rng=rng, **settings):
        if state.phase == "fine-tune" and time.monotonic() - saved_at > SECONDS_BETWEEN_CHECKPOINTS:
            left = state.of - state.epoch
            write_record(checkpoint, {"machine": state.machine, "epoch": state.epoch, "left": left})
            saved_at = time.monotonic()
        yield task.progress(state.phase, state.epoch, state.of, _epoch_text(state), state=state)
    if state is None:
        raise StageError("learning made no epoch; wanted epochs of at least 1")
    yield task.progress("describe", 0, 1, "describing the family")
    machine = state.machine
    mixture = fit_mixture(machine, observations if split is None else observations.subset(split[0]))
    write_record(folder / "observations.zarr.zip", observations)
    write_record(folder / "mixture.zarr.zip", mixture)
    write_record(folder / "directions.zarr.zip", tuple(directions(machine, observations)))
    values = np.asarray(describe_shapes(machine, observations))
    write_record(folder / "descriptors.zarr.zip", {"names": list(names), "values": values})
    write_record(folder / "machine.zarr.zip", machine)
    checkpoint.unlink(missing_ok=True)
    error = _number(state.held_out_error)
    which, error = ("held-out", error) if error is not None else ("training", _number(state.train_error))
    number = len(names) if split is None else len(split[0])
    text = counted(number, "shape") + (f", {which} error {error:.4f} diagonals" if error is not None else "")
    task.summary |= {
        "text": text, "shapes": number, "points": positions.shape[1], "epochs": state.epoch,
        "train_error": _number(state.train_error), "held_out_error": _number(state.held_out_error),
        "stop_reason": state.stop_reason,
    }  # fmt: skip


def _epoch_text(state: Any) -> str:
    error = state.held_out_error if np.isfinite(state.held_out_error) else state.train_error
    return f"epoch {state.epoch}: error {error:.4f}"


def curve(project: Project, *, seed: int = 0, jobs: int | None = None) -> Iterator[Progress]:
    """The learning curve of the fitted family: learning anew from a quarter, half and all of the shapes.

    The state of every progress is the list of ``CurvePoint`` so far, the last message says whether more shapes would
    help.  Judged by the shapes that ``learn --test`` named, else by a fifth.  Raises StageError for too few shapes.
    """
    from shapeforge.generative.curve import SHARES, learning_curve, more_shapes
    from shapeforge.generative.observations import observe

    names, hierarchy = project.fit_names, project.hierarchy()
    options = (project.stage_record("learn") or {}).get("options") or {}
    split = named_split(names, options.get("train"), options.get("test"))
    observations = observe(stacked_positions(project, names), hierarchy.top.label, tuple(hierarchy.top.part_names))
    held_out = None
    if split is not None:
        observations = observations.subset(np.concatenate(split))
        held_out = np.arange(len(split[0]), observations.n_shapes)
    found: list[Any] = []
    with threadpool_limits(1, "blas"), contextlib.closing(Workers(jobs)) as workers:
        rng = np.random.default_rng(seed)
        for point in learning_curve(observations, rng=rng, held_out=held_out, executor=workers):
            found.append(point)
            error = f"{100 * point.held_out_error:.2f}% of their size on those held out"
            text = f"from {counted(point.shapes, 'shape')}: {error}"
            yield Progress("learn", "curve", len(found), len(SHARES), text, state=list(found))
    yield Progress("learn", "curve", len(found), len(found), more_shapes(found)[1], state=found)
