"""The one driver of every stage: check what it needs, iterate, checkpoint, write down what it came from.

``for progress in run(project, "fit"): …`` is all that the command line, the window and a notebook do.  A stage that is
done and still true is not run again; one that was killed goes on; one whose inputs or options changed is redone, and
so are the stages before it that went stale.  What a stage came from is a key over its options and inputs.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from shapeforge.stages_status import (
    ARGUMENTS,
    DEFAULTS,
    NEEDS,
    REVISION,
    STAGES,
    Status,
    changed_words,
    difference,
    inputs_of,
    lost_results,
    next_step,
    options_of,
    remedy,
    starts_from_proposal,
    status,
)
from shapeforge.store import Problem, Project, ProjectError, key_of
from shapeforge.workers import Workers

__all__ = [
    "ARGUMENTS", "DEFAULTS", "NEEDS", "STAGES", "Progress", "StageError", "Status", "Task", "inputs_of", "next_step",
    "refresh", "run", "status",
]  # fmt: skip


class StageError(ValueError):
    """A stage cannot be run; ``str`` is one sentence: what is wrong, and what to do."""


@dataclass(frozen=True, eq=False)
class Progress:
    """Where a stage is: ``step`` of ``of`` in a phase, what it just did, seconds left (None: unknown).

    ``state`` is the algorithm's own last state (FitState, GroupState, LearnState, …) where there is one; ``problem``
    a file that was skipped or is doubtful; ``within`` (0..1) how much is done of the next step.
    """

    stage: str
    phase: str
    step: int
    of: int
    message: str = ""
    seconds_left: float | None = None
    state: Any = None
    problem: Problem | None = None
    within: float = 0.0

    @property
    def share(self) -> float:
        """How much of the phase is done (0..1)."""
        return min((self.step + self.within) / self.of, 1.0) if self.of > 0 else 0.0


@dataclass
class Task:
    """What the function of a stage is given: the project, options, workers, and the id its results are filed under.

    ``given`` are the options that this run was given; the others are those of the last run.
    """

    project: Project
    stage: str
    options: dict[str, Any]
    arguments: dict[str, Any]
    inputs: dict[str, Any]
    workers: Workers
    restart: bool
    result: str
    summary: dict[str, Any]
    origin: dict[str, Any] = field(default_factory=dict)
    given: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._started, self._phase, self._first = time.monotonic(), "", 0

    def progress(self, phase: str, step: int, of: int, message: str = "", **more: Any) -> Progress:
        """A progress report with the time left, judged from the steps of this phase so far."""
        now = time.monotonic()
        if phase != self._phase:
            self._started, self._phase, self._first = now, phase, step
        done = step - self._first
        left = (now - self._started) / done * (of - step) if done > 0 else None
        return Progress(self.stage, phase, step, of, message, more.pop("seconds_left", left), **more)

    @property
    def folder(self) -> Any:
        """Folder of this run's results."""
        return self.project.result_folder(self.stage, self.result)


def run(
    project: Project, stage: str, *, jobs: int | None = None, restart: bool = False, **options: Any
) -> Iterator[Progress]:
    """Run a stage, as an iterator of :class:`Progress`; stages before it that went stale are redone first.

    ``jobs`` workers (default: one per processor) give the same result as one.  ``restart`` redoes even what is done.
    ``options`` are those of ``DEFAULTS[stage]`` and ``ARGUMENTS[stage]``; None means not given.

    Raises :class:`StageError` at once for unknown names, and on iteration when something needed is missing;
    ``ProjectError`` when the project cannot be written.
    """
    if stage not in STAGES:
        raise StageError(f"stage: wanted one of {', '.join(STAGES)}, got {stage!r}")
    allowed = (*DEFAULTS[stage], *ARGUMENTS.get(stage, ()))
    for name in options:
        if name not in allowed:
            raise StageError(f"option {name!r}: {stage} has {', '.join(allowed) or 'no options'}")
    return _run(project, stage, jobs, restart, {k: v for k, v in options.items() if v is not None})


def _run(project: Project, stage: str, jobs: int | None, restart: bool, given: dict[str, Any]) -> Iterator[Progress]:
    with project.writing(), threadpool_limits(1, "blas"), contextlib.closing(Workers(jobs)) as workers:
        if stage != "import":
            yield from _say_changed(project)
        for before in NEEDS[stage]:
            yield from _refresh(project, before, workers, stage)
        yield from _run_one(project, stage, workers, restart, given)


def _say_changed(project: Project) -> Iterator[Progress]:
    """A warning where files of shapes changed since they were read: no other stage than the import reads files."""
    changed = changed_words(project)
    if changed:
        remedy = f"The shapes are as they were read; to read the changes: shapeforge import {project.path}"
        problem = Problem(str(project.path), "warning", changed, remedy)
        yield Progress("import", "stale", 0, 1, str(problem), problem=problem)


def refresh(
    project: Project, stages: Sequence[str], *, wanted_by: str, jobs: int | None = None, optional: Sequence[str] = ()
) -> Iterator[Progress]:
    """Bring stages up to date that some output is made of: what is stale or was stopped is redone.

    Raises :class:`StageError` when one that is not ``optional`` was never run.
    """
    yield from _say_changed(project)
    states = status(project)
    if all(states[stage].state == "done" for stage in stages):
        return
    with project.writing(), threadpool_limits(1, "blas"), contextlib.closing(Workers(jobs)) as workers:
        for stage in stages:
            if stage not in optional or status(project)[stage].state not in ("missing", "locked"):
                yield from _refresh(project, stage, workers, wanted_by)


def _refresh(project: Project, stage: str, workers: Workers, wanted_by: str) -> Iterator[Progress]:
    """Bring a stage that another one needs up to date, if it was ever run."""
    status_now = status(project)[stage]
    if stage == "label":
        if not project.labelled or starts_from_proposal(project):
            state = status(project)["cosegment"]
            if state.state in ("missing", "locked"):
                raise StageError(f"{wanted_by} needs parts. {remedy(project, 'label')}")
            yield from _refresh(project, "cosegment", workers, wanted_by)
        return
    if status_now.state in ("missing", "locked"):
        raise StageError(f"{wanted_by} needs {stage} first. {remedy(project, stage)}")
    if status_now.state in ("stale", "partial") and not (stage == "import" and status_now.state == "stale"):
        yield Progress(stage, status_now.state, 0, 1, f"{stage} first: {status_now.reason}")
        for before in NEEDS[stage]:
            yield from _refresh(project, before, workers, stage)
        yield from _run_one(project, stage, workers, False, {})


def _run_one(
    project: Project, stage: str, workers: Workers, restart: bool, given: Mapping[str, Any]
) -> Iterator[Progress]:
    record = project.stage_record(stage)
    arguments = {name: given.get(name) for name in ARGUMENTS.get(stage, ())}
    if record and record["state"] == "partial" and not any(arguments.values()):
        arguments = record.get("arguments", arguments)  # go on with what the killed run was given
    options = options_of(stage, record, given)
    inputs = inputs_of(project, stage)
    if "warm" in options and "warm" not in given and record and record.get("inputs") != inputs:
        options["warm"] = False  # the last run was taken up again; whether this one is has to be said anew
    key = key_of(stage, REVISION, options, inputs)
    always = stage in ARGUMENTS  # these look at files outside the project, so they always look
    lost = _lost_output(stage, record) or lost_results(project, stage, record)
    if record and record["key"] == key and record["state"] == "done" and not (restart or always or lost):
        yield Progress(stage, "done", 1, 1, f"{stage} is up to date: nothing to do")
        return
    if record and record["key"] == key and lost:
        yield Progress(stage, "stale", 0, 1, f"{stage} is redone: {lost}")
    if record and record["key"] != key and not always:
        yield Progress(stage, "stale", 0, 1, f"{stage} is redone: {difference(record, options, inputs)}")
    going_on = bool(record) and record["key"] == key and (record["state"] == "partial" or bool(lost)) and not restart
    result = record["working"] if going_on and record else _fresh_id(project, stage, key)
    old = {"result": record.get("result"), "of": record.get("of"), "from": record.get("from")} if record else {}
    if record and stage == "cosegment":  # until the new parts are there, paint is of the old ones
        old["summary"] = record.get("summary")
    running = {"key": key, "options": options, "inputs": inputs, "state": "partial", "working": result}
    if arguments.get("meshes"):
        running["arguments"] = {"meshes": _absolute(arguments["meshes"])}
    project.set_stage_record(stage, {**old, **running})
    project.log(f"{stage}: {'goes on' if going_on else 'starts'} with {options}")
    if not going_on and stage not in ARGUMENTS:
        project.clear_result(stage, result)
    task = Task(project, stage, options, arguments, inputs, workers, restart, result, {}, given=given)
    started = time.monotonic()
    try:
        yield from _function(stage)(task)
    except ProjectError:
        raise  # the disk's fault: what is there already stays, and the next run goes on
    except ValueError:  # options or inputs that cannot be used must not be those of the next run
        project.set_stage_record(stage, record)
        raise
    if always or stage == "group":
        inputs = inputs_of(project, stage)
        key = key_of(stage, REVISION, options, inputs)
    seconds = round(time.monotonic() - started, 1)
    done = {**running, "key": key, "inputs": inputs, "state": "done", "result": result, "seconds": seconds}
    finished = time.strftime("%Y-%m-%dT%H:%M:%S")
    project.set_stage_record(stage, {**done, **task.origin, "finished": finished, "summary": task.summary})
    project.drop_results(stage, keep=result)
    project.log(f"{stage}: done in {seconds} s {task.summary}")


def _function(stage: str) -> Callable[[Task], Iterator[Progress]]:
    from shapeforge import stages_collection, stages_import, stages_model, stages_refine, stages_synthesis

    return {
        "import": stages_import.import_meshes,
        "group": stages_collection.group,
        "label": stages_collection.label,
        "cosegment": stages_collection.cosegment,
        "fit": stages_model.fit,
        "learn": stages_model.learn,
        "refine": stages_refine.refine,
        "synthesize": stages_synthesis.synthesize,
    }[stage]


def _lost_output(stage: str, record: Mapping[str, Any] | None) -> str:
    """Which of the files that ``synthesize`` wrote outside the project is gone, in words; empty when all are there."""
    if stage != "synthesize" or not record or record["state"] != "done":
        return ""
    summary = record.get("summary") or {}
    ending = record["options"]["format"]
    for name in summary.get("names", ()):
        for file in (Path(summary["out"]) / f"{name}.{ending}", Path(summary["out"]) / f"{name}.seg"):
            if not file.is_file():
                return f"{file} is gone"
    return ""


def _absolute(paths: str | Path | Sequence[str | Path]) -> list[str]:
    """Paths as absolute text, so that a run from another folder finds them."""
    return [str(Path(path).absolute()) for path in ([paths] if isinstance(paths, str | Path) else paths)]


def _fresh_id(project: Project, stage: str, key: str) -> str:
    """The key, or the key with a number when the present results already have it (``restart``)."""
    record = project.stage_record(stage) or {}
    taken, number = record.get("result"), 1
    name = key
    while name == taken:
        name, number = f"{key}-{number}", number + 1
    return name
