"""The stages of the model: fit, learn, and refine, which alternates the two."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.stages import Progress, StageError, Task
from shapeforge.stages_collection import read_proposal
from shapeforge.store import Project
from shapeforge.store_arrays import read_record, write_record
from shapeforge.store_results import write_names, write_round

SECONDS_BETWEEN_CHECKPOINTS = 20.0
ROUNDS_PER_ALTERNATION = 2
"""Outer rounds of the fit under the machine's prior in each alternation of ``refine``."""


# -- fit -------------------------------------------------------------------------------------------------------------


def fit(task: Task) -> Iterator[Progress]:
    """Templates, correspondences, segmentations (a checkpoint a round), then the high-level templates and faces."""
    from shapeforge.deformation.fit import fit_templates

    project, folder = task.project, task.folder
    labels, part_names, seeds = starting_parts(project)
    write_names(folder / "names.zarr.zip", project.names)
    checkpoint = folder / "checkpoint.zarr.zip"
    state = read_record(checkpoint)[0] if checkpoint.is_file() else None
    if state is None or state.stop_reason is None:
        options, rng = task.options, np.random.default_rng(task.options["seed"])
        states = fit_templates(
            project.shapes, starting_groups(project), labels, part_names, rounds=options["rounds"],
            inner=options["inner"], rng=rng, executor=task.workers, seeds=seeds, resume=state,
        )  # fmt: skip
        if state is not None:
            yield task.progress("fit", state.round, state.of, f"goes on after round {state.round}", state=state)
        for state in states:
            write_record(checkpoint, state)
            write_round(folder / "rounds" / f"{state.round:03d}.zarr.zip", state)
            yield task.progress("fit", state.round, state.of, _round_text(state), state=state)
    if state is None:
        raise StageError("the fit made no round; wanted rounds of at least 1")
    yield task.progress("hierarchy", 0, 1, "linking the groups' templates", state=state)
    hierarchy = state.hierarchy()
    write_record(folder / "hierarchy.zarr.zip", hierarchy)
    yield from write_shapes(task, folder, state, hierarchy)
    write_record(folder / "fit.zarr.zip", state)
    checkpoint.unlink(missing_ok=True)
    text = f"{state.round} rounds, {len(hierarchy.top.label)} corresponding points"
    task.summary |= {
        "text": text, "rounds": state.round, "energy": _number(state.energy), "stop_reason": state.stop_reason,
        "points": len(hierarchy.top.label), "parts": list(part_names),
    }  # fmt: skip
    yield task.progress("faces", len(project.names), len(project.names), text, state=state)


def starting_parts(project: Project) -> tuple[dict[int, np.ndarray], tuple[str, ...], Sequence[np.ndarray] | None]:
    """Labels by shape index, part names, and proposed label probabilities per point where no labels were given."""
    labels = {t: project.labels(name) for t, name in enumerate(project.names) if project.label_key(name)}
    seeds = None
    proposal = read_proposal(project)
    if not labels and proposal is not None:
        return {}, tuple(proposal.part_names), proposal.segmentation
    names = project.part_names.names if project.part_names else ()
    groups = project.groups
    if groups is not None and not any(int(t) in labels for t in groups.exemplars):
        wanted = ", ".join(project.names[t] for t in groups.exemplars)
        raise StageError(
            f"no exemplar has labels: label at least one of {wanted}, or make a labelled shape an exemplar: "
            f"shapeforge group {project.path} --exemplars NAME"
        )
    return labels, tuple(names), seeds


def starting_groups(project: Project) -> Any:
    """The groups that the fit starts from: without labels, the exemplars are those that came with the first parts."""
    proposal = None if project.labelled else read_proposal(project)
    if proposal is None or project.groups is None:
        return project.groups
    return replace(project.groups, exemplars=proposal.exemplars)


def write_shapes(task: Task, folder: Path, state: Any, hierarchy: Any) -> Iterator[Progress]:
    """Faces and corresponding points of every shape, one file each; those of an interrupted run are kept."""
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
        write_record(path, {**found, "probabilities": np.asarray(probabilities, np.float32), "existence": existence})

    for t, _ in enumerate(task.workers.map(work, range(len(names)))):
        yield task.progress("faces", t + 1, len(names), names[t])


def _round_text(state: Any) -> str:
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
    project, folder = task.project, task.folder
    names = project.fit_names
    yield from learn_into(task, folder, names, stacked_positions(project, names), epochs=task.options["epochs"])
    yield task.progress("describe", 1, 1, task.summary["text"])


def stacked_positions(project: Project, names: Sequence[str]) -> np.ndarray:
    """Corresponding points of all shapes (T, K, 3), normal coordinates as the family lies, NaN where absent."""
    found = [project.positions(name) for name in names]
    missing = [name for name, positions in zip(names, found, strict=True) if positions is None]
    if missing:
        raise StageError(f"{missing[0]} was not fitted. Fit again: shapeforge fit {project.path} --restart")
    beliefs = [project.beliefs(name) for name in names]
    return np.stack([one.to_family(positions) for one, positions in zip(beliefs, found, strict=True)])


def learn_into(
    task: Task, folder: Path, names: Sequence[str], positions: np.ndarray, *, epochs: int | None, start: Any = None
) -> Iterator[Progress]:
    """Learn from corresponding points (T, K, 3) and write everything the machine brings into ``folder``."""
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
    for state in learn_machine(observations, rng=rng, epochs=epochs, executor=task.workers, start=start):
        if state.phase == "fine-tune" and time.monotonic() - saved_at > SECONDS_BETWEEN_CHECKPOINTS:
            left = state.of - state.epoch
            write_record(checkpoint, {"machine": state.machine, "epoch": state.epoch, "left": left})
            saved_at = time.monotonic()
        yield task.progress(state.phase, state.epoch, state.of, _epoch_text(state), state=state)
    if state is None:
        raise StageError("learning made no epoch; wanted epochs of at least 1")
    yield task.progress("describe", 0, 1, "describing the family")
    machine = state.machine
    mixture = fit_mixture(machine, observations)
    write_record(folder / "observations.zarr.zip", observations)
    write_record(folder / "mixture.zarr.zip", mixture)
    write_record(folder / "directions.zarr.zip", tuple(directions(machine, mixture, observations)))
    values = np.asarray(describe_shapes(machine, observations))
    write_record(folder / "descriptors.zarr.zip", {"names": list(names), "values": values})
    write_record(folder / "machine.zarr.zip", machine)
    checkpoint.unlink(missing_ok=True)
    error = _number(state.held_out_error)
    which, error = ("held-out", error) if error is not None else ("training", _number(state.train_error))
    text = f"{len(names)} shapes, {which} error {error:.4f} diagonals" if error is not None else f"{len(names)} shapes"
    task.summary |= {
        "text": text, "shapes": len(names), "points": positions.shape[1], "epochs": state.epoch,
        "train_error": _number(state.train_error), "held_out_error": _number(state.held_out_error),
        "stop_reason": state.stop_reason,
    }  # fmt: skip


def _epoch_text(state: Any) -> str:
    error = state.held_out_error if np.isfinite(state.held_out_error) else state.train_error
    return f"epoch {state.epoch}: error {error:.4f}"


# -- refine ----------------------------------------------------------------------------------------------------------


def refine(task: Task) -> Iterator[Progress]:
    """Joint analysis and synthesis: the machine is a prior on the fit, the refined fit teaches the machine, 3 times."""
    from shapeforge.deformation.exemplars import blend
    from shapeforge.deformation.fit import fit_templates
    from shapeforge.deformation.hierarchy import corresponding_points

    project, folder = task.project, task.folder
    names, hierarchy = project.names, project.hierarchy()
    labels, part_names, seeds = starting_parts(project)
    write_names(folder / "names.zarr.zip", names)
    checkpoint = folder / "alternation.zarr.zip"
    number, of = 0, int(task.options["alternations"])
    if checkpoint.is_file():
        saved = read_record(checkpoint)[0]
        number, state, machine, positions = (saved[key] for key in ("number", "state", "machine", "positions"))
        yield task.progress("alternate", number, of, f"goes on after alternation {number}", state=state)
    else:
        state, machine = project.fit(), project.machine()
        positions = stacked_positions(project, names)
    while number < of:
        prior = _prior(machine, positions, hierarchy, state.templates)
        rounds = state.round + ROUNDS_PER_ALTERNATION
        states = fit_templates(
            project.shapes, starting_groups(project), labels, part_names, rounds=rounds,
            rng=np.random.default_rng(number),
            executor=task.workers, seeds=seeds, prior=prior, resume=state,
        )  # fmt: skip
        for state in states:
            yield task.progress("alternate", number, of, f"alternation {number + 1}, {_round_text(state)}", state=state)

        def corresponding(t: int, state: Any = state) -> np.ndarray:
            beliefs = blend(state.candidates[t])
            return beliefs.to_family(corresponding_points(project.shapes[t], beliefs, hierarchy)[0])

        positions = np.stack(list(task.workers.map(corresponding, range(len(names)))))
        number += 1
        last = number == of
        target = folder if last else folder / f"machine-{number}"
        for progress in learn_into(task, target, names, positions, epochs=None, start=machine):
            yield task.progress("alternate", number - 1, of, f"alternation {number}, {progress.message}")
        machine = read_record(target / "machine.zarr.zip")[0]
        saved = {"number": number, "state": state, "machine": machine, "positions": positions}
        write_record(checkpoint, saved)
        yield task.progress("alternate", number, of, f"alternation {number} of {of}", state=state)
    write_record(folder / "hierarchy.zarr.zip", hierarchy)
    yield from write_shapes(task, folder, state, hierarchy)
    write_record(folder / "fit.zarr.zip", state)
    task.summary |= {"text": f"{of} alternations, {task.summary.get('text', '')}", "alternations": of}
    task.origin = {"of": _result(project, "fit"), "from": _result(project, "learn")}
    checkpoint.unlink(missing_ok=True)
    yield task.progress("faces", len(names), len(names), task.summary["text"], state=state)


def _result(project: Project, stage: str) -> str | None:
    return (project.stage_record(stage) or {}).get("result")


def _prior(
    machine: Any, positions: np.ndarray, hierarchy: Any, templates: Sequence[Any]
) -> Callable[[int, int], tuple[np.ndarray, np.ndarray]]:
    """The machine's opinion on every shape's corresponding points, handed down to the templates of its group."""
    from shapeforge.generative.joint import shape_prior

    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def prior(t: int, g: int) -> tuple[np.ndarray, np.ndarray]:
        if t not in found:
            found.clear()  # asked shape by shape: the one at hand is enough
            found[t] = shape_prior(machine, positions[t])
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
