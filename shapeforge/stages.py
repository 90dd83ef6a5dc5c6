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
from typing import Any, Literal

from threadpoolctl import threadpool_limits

from shapeforge.store import Problem, Project, key_of
from shapeforge.workers import Workers

STAGES: tuple[str, ...] = ("import", "group", "label", "cosegment", "fit", "learn", "refine", "synthesize")

DEFAULTS: dict[str, dict[str, Any]] = {
    "import": {"points": 5000, "up": "auto", "seed": 0},
    "group": {"exemplars": None, "seed": 0},
    "label": {},
    "cosegment": {"parts": None, "seed": 0},
    "fit": {"rounds": 10, "inner": 3, "seed": 0},
    "learn": {"epochs": None, "seed": 0},
    "refine": {"alternations": 3, "seed": 0},
    "synthesize": {"count": 20, "temperature": 1.0, "format": "glb", "out": None, "seed": 0},
}
"""Options of every stage.  An option that is not given keeps the value of the project's last run of the stage."""

ARGUMENTS: dict[str, tuple[str, ...]] = {"import": ("meshes",), "label": ("labels", "only")}
"""What a stage is given besides options: files that are read now and need not be there later."""

NEEDS: dict[str, tuple[str, ...]] = {
    "import": (),
    "group": ("import",),
    "label": ("import",),
    "cosegment": ("import", "group"),
    "fit": ("import", "group", "label"),
    "learn": ("fit",),
    "refine": ("fit", "learn"),
    "synthesize": ("fit", "learn"),
}
REVISION = 1
"""Raised when stages mean something else by the same options: results of older revisions are then stale."""

State = Literal["missing", "partial", "done", "stale", "locked"]


class StageError(ValueError):
    """A stage cannot be run; ``str`` is one sentence: what is wrong, and what to do."""


@dataclass(frozen=True, eq=False)
class Progress:
    """Where a stage is: ``step`` of ``of`` in a phase, what it just did, seconds left (None: unknown).

    ``state`` is the algorithm's own last state (FitState, GroupState, LearnState, …) where there is one; ``problem``
    a file that was skipped or is doubtful.
    """

    stage: str
    phase: str
    step: int
    of: int
    message: str = ""
    seconds_left: float | None = None
    state: Any = None
    problem: Problem | None = None


@dataclass(frozen=True)
class Status:
    """State of a stage, and why in words."""

    state: State
    reason: str


@dataclass
class Task:
    """What the function of a stage is given: the project, options, workers, and the id its results are filed under."""

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

    def __post_init__(self) -> None:
        self._started, self._phase, self._first = time.monotonic(), "", 0

    def progress(self, phase: str, step: int, of: int, message: str = "", **more: Any) -> Progress:
        """A progress report with the time left, judged from the steps of this phase so far."""
        now = time.monotonic()
        if phase != self._phase:
            self._started, self._phase, self._first = now, phase, step
        done = step - self._first
        left = (now - self._started) / done * (of - step) if done > 0 else None
        return Progress(self.stage, phase, step, of, message, left, **more)

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
        for before in NEEDS[stage]:
            yield from _refresh(project, before, workers, stage)
        yield from _run_one(project, stage, workers, restart, given)


def refresh(
    project: Project, stages: Sequence[str], *, wanted_by: str, jobs: int | None = None, optional: Sequence[str] = ()
) -> Iterator[Progress]:
    """Bring stages up to date that some output is made of: what is stale or was stopped is redone.

    Raises :class:`StageError` when one that is not ``optional`` was never run.
    """
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
        if not project.labelled:
            state = status(project)["cosegment"]
            if state.state in ("missing", "locked"):
                raise StageError(f"{wanted_by} needs parts. {_remedy(project, 'label')}")
            yield from _refresh(project, "cosegment", workers, wanted_by)
        return
    if status_now.state in ("missing", "locked"):
        raise StageError(f"{wanted_by} needs {stage} first. {_remedy(project, stage)}")
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
    options = _options(stage, record, given)
    inputs = inputs_of(project, stage)
    key = key_of(stage, REVISION, options, inputs)
    always = stage in ARGUMENTS  # these look at files outside the project, so they always look
    if record and record["key"] == key and record["state"] == "done" and not restart and not always:
        yield Progress(stage, "done", 1, 1, f"{stage} is up to date: nothing to do")
        return
    if record and record["key"] != key and not always:
        yield Progress(stage, "stale", 0, 1, f"{stage} is redone: {_difference(record, options, inputs)}")
    going_on = bool(record) and record["key"] == key and record["state"] == "partial" and not restart
    result = record["working"] if going_on and record else _fresh_id(project, stage, key)
    old = {"result": record.get("result"), "of": record.get("of"), "from": record.get("from")} if record else {}
    running = {"key": key, "options": options, "inputs": inputs, "state": "partial", "working": result}
    if arguments.get("meshes"):
        running["arguments"] = {"meshes": _absolute(arguments["meshes"])}
    project.set_stage_record(stage, {**old, **running})
    project.log(f"{stage}: {'goes on' if going_on else 'starts'} with {options}")
    if not going_on and stage not in ARGUMENTS:
        project.clear_result(stage, result)
    task = Task(project, stage, options, arguments, inputs, workers, restart, result, {})
    started = time.monotonic()
    yield from _function(stage)(task)
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
    from shapeforge import stages_collection, stages_model, stages_synthesis

    return {
        "import": stages_collection.import_meshes,
        "group": stages_collection.group,
        "label": stages_collection.label,
        "cosegment": stages_collection.cosegment,
        "fit": stages_model.fit,
        "learn": stages_model.learn,
        "refine": stages_model.refine,
        "synthesize": stages_synthesis.synthesize,
    }[stage]


def _options(stage: str, record: Mapping[str, Any] | None, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options as given, else as the last run had them, else the defaults; in JSON's types."""
    last = record["options"] if record else {}
    options = {name: given.get(name, last.get(name, default)) for name, default in DEFAULTS[stage].items()}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in options.items()}


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


def inputs_of(project: Project, stage: str) -> dict[str, Any]:
    """Keys of all that a stage computes from, by a word for each."""

    def result_of(stage: str) -> str | None:
        record = project.stage_record(stage) or {}
        return record.get("result")

    shapes = key_of([[name, project.shape_record(name)["key"]] for name in project.names])
    labels = [[name, project.label_key(name)] for name in project.labelled]
    parts = list(project.part_names.names) if project.part_names else []
    if stage == "import":
        return {"shapes": shapes}
    if stage == "group":
        return {"shapes": shapes}
    if stage == "label":
        return {"labels": key_of(labels, parts)}
    if stage == "cosegment":
        return {"shapes": shapes, "groups": project.groups_key}
    if stage == "fit":
        start = {"labels": key_of(labels, parts)} if labels else {"first parts": result_of("cosegment")}
        return {"shapes": shapes, "groups": project.groups_key, **start}
    if stage == "learn":
        return {"fit": result_of("fit")}
    if stage == "refine":
        return {"fit": result_of("fit"), "machine": result_of("learn")}
    return {"fit": project.fit_id, "machine": project.machine_id}


def _difference(record: Mapping[str, Any], options: Mapping[str, Any], inputs: Mapping[str, Any]) -> str:
    """What changed since a stage was run, in words."""
    old_inputs, old_options = record.get("inputs", {}), record.get("options", {})
    changed = [f"the {name} changed" for name, value in inputs.items() if old_inputs.get(name) != value]
    for name, value in options.items():
        if old_options.get(name) != value:
            changed.append(f"{name} {value} instead of {old_options.get(name)}")
    return ", ".join(changed) or "it was made by another version of shapeforge"


def status(project: Project) -> dict[str, Status]:
    """State of every stage, in order, each with a reason that can be shown."""
    found: dict[str, Status] = {}
    for stage in STAGES:
        found[stage] = _status(project, stage, found)
    return found


def _status(project: Project, stage: str, before: Mapping[str, Status]) -> Status:
    record = project.stage_record(stage)
    if stage == "import":
        return _import_status(project, record)
    if stage == "label":
        return _label_status(project)
    needs = NEEDS[stage]
    if stage == "fit":  # parts may come from labels or be proposed
        has_parts = bool(project.labelled) or before["cosegment"].state not in ("missing", "locked")
        needs = ("import", "group")
        if record is None and before["group"].state == "done" and not has_parts:
            return Status("locked", "needs labels on the exemplars, or proposed parts")
    for name in needs:
        if before[name].state in ("missing", "locked"):
            return Status("locked", f"needs {name} first")
    if record is None:
        if stage == "group" and project.groups_key is not None:
            return Status("done", "grouped by hand")
        return Status("missing", "not done yet")
    options = _options(stage, record, {})
    inputs = inputs_of(project, stage)
    if record["key"] != key_of(stage, REVISION, options, inputs):
        return Status("stale", _difference(record, options, inputs))
    used = (*needs, "cosegment") if stage == "fit" and not project.labelled else needs
    for name in used:
        if before[name].state in ("stale", "partial") and name != "import":
            return Status("stale", f"{name} is {before[name].state}: {before[name].reason}")
    if record["state"] == "partial":
        return Status("partial", "was stopped; it goes on where it was")
    summary = record.get("summary") or {}
    return Status("done", str(summary.get("text", "done")))


def _import_status(project: Project, record: Mapping[str, Any] | None) -> Status:
    number = len(project.names)
    if not number:
        return Status("missing", "no shapes yet")
    if record and record["state"] == "partial":
        return Status("partial", f"was stopped after {number} shapes; it goes on with the rest")
    changed = project.changed_sources()
    if changed:
        some = ", ".join(changed[:3]) + (", …" if len(changed) > 3 else "")
        return Status("stale", f"{len(changed)} files changed since they were read ({some})")
    return Status("done", f"{number} shapes")


def _label_status(project: Project) -> Status:
    if not project.names:
        return Status("locked", "needs import first")
    labelled, groups = set(project.labelled), project.groups
    if not labelled:
        return Status("missing", "no shape has labels")
    if groups is not None:
        exemplars = [project.names[t] for t in groups.exemplars]
        without = [name for name in exemplars if name not in labelled]
        if len(without) == len(exemplars):
            return Status("partial", f"no exemplar has labels: label {', '.join(without)}")
        if without:
            return Status("done", f"{len(labelled)} shapes; exemplars without labels: {', '.join(without)}")
    return Status("done", f"{len(labelled)} shapes")


def next_step(project: Project) -> str:
    """One sentence: the command that is most worth running next."""
    states = status(project)
    required = ("import", "group", "label", "fit", "learn", "synthesize")
    for stage in required:
        state = states[stage].state
        if stage == "label" and not project.labelled and states["cosegment"].state == "done":
            continue
        if state != "done" and not (stage == "import" and state == "stale"):
            return _remedy(project, stage)
    return f"Export the results: shapeforge export {project.path} --out DIR"


def _remedy(project: Project, stage: str) -> str:
    path = project.path
    groups = project.groups
    exemplars = [project.names[t] for t in groups.exemplars] if groups is not None else []
    which = f" ({', '.join(exemplars[:4])}{', …' if len(exemplars) > 4 else ''})" if exemplars else ""
    return {
        "import": f"Import meshes: shapeforge import {path} MESHES",
        "group": f"Group the shapes: shapeforge group {path}",
        "label": f"Label the exemplars{which}: shapeforge label {path} LABELS --only exemplars, paint them in "
        f"shapeforge view {path}, or let parts be proposed: shapeforge cosegment {path}",
        "cosegment": f"Propose parts: shapeforge cosegment {path}",
        "fit": f"Fit the templates: shapeforge fit {path}",
        "learn": f"Learn the Beta Shape Machine: shapeforge learn {path}",
        "refine": f"Refine the fit: shapeforge refine {path}",
        "synthesize": f"Make new shapes: shapeforge synthesize {path} --count 20 --out DIR",
    }[stage]
