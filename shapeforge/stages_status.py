"""Which stages there are, what each is made from, and how far a project is with them.

What a stage came from is a key over its options and inputs; a stage whose key no longer matches is stale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal
from weakref import WeakKeyDictionary

from shapeforge.collection.counts import counted
from shapeforge.store import Project, ProjectError, key_of

STAGES: tuple[str, ...] = ("import", "group", "label", "cosegment", "fit", "learn", "refine", "synthesize")

DEFAULTS: dict[str, dict[str, Any]] = {
    "import": {"points": 5000, "up": "auto", "seed": 0},
    "group": {"exemplars": None, "seed": 0},
    "label": {},
    "cosegment": {"parts": None, "seed": 0, "edits": []},
    "fit": {"rounds": 10, "inner": 3, "seed": 0, "warm": False},
    "learn": {"epochs": None, "train": None, "test": None, "seed": 0},
    "refine": {"alternations": 3, "seed": 0},
    "synthesize": {
        "count": 20, "temperature": 1.0, "having": [], "lacking": [], "hold": [], "like": "", "between": [], "take": [],
        "route": "parts", "union": False, "colours": "parts", "format": "glb", "out": None, "seed": 0,
    },
}  # fmt: skip
"""Options of every stage.  An option that is not given keeps the value of the project's last run of the stage, but for
those in ``ONCE``."""

ONCE: dict[str, tuple[str, ...]] = {"synthesize": ("having", "lacking", "hold", "like", "between", "take")}
"""Wishes for one run, which say what the new shapes are to be like: where any option is given, those that are not are
back at their defaults.  A run without any options repeats the last one."""

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
REVISION = 11
"""Raised when stages mean something else by the same options: results of older revisions are then stale."""

RESULTS: dict[str, tuple[str, ...]] = {
    "cosegment": ("names", "proposal"),
    "fit": ("names", "fit", "hierarchy"),
    "learn": ("machine", "observations", "mixture", "directions", "descriptors"),
    "refine": ("names", "fit", "hierarchy", "machine", "observations", "mixture", "directions", "descriptors"),
    "synthesize": ("draws",),
}
"""Files without which the results of a finished stage are not complete."""

State = Literal["missing", "partial", "done", "stale", "locked"]

ALL_OVER = 0.9
"""Share of an exemplar's surface from which on it counts as painted all over: what is inside is hard to paint."""

LONGEST_VALUE = 60
"""Characters of an option's value in a message."""


@dataclass(frozen=True)
class Status:
    """State of a stage, and why in words."""

    state: State
    reason: str


def options_of(stage: str, record: Mapping[str, Any] | None, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options as given, else as the last run had them (see ``ONCE``), else the defaults; in JSON's types."""
    last = record["options"] if record else {}
    if given:
        last = {name: value for name, value in last.items() if name not in ONCE.get(stage, ())}
    if stage == "cosegment" and any(name in given and given[name] != last.get(name) for name in ("parts", "seed")):
        last = {name: value for name, value in last.items() if name != "edits"}  # they were about other parts
    options = {name: given.get(name, last.get(name, default)) for name, default in DEFAULTS[stage].items()}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in options.items()}


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
        start = {"labels": key_of(labels, parts)} if labels else {}
        if not labels or starts_from_proposal(project):
            start["first parts"] = result_of("cosegment")
        return {"shapes": shapes, "groups": project.groups_key, **start}
    if stage == "learn":
        return {"fit": result_of("fit")}
    if stage == "refine":
        return {"fit": result_of("fit"), "machine": result_of("learn")}
    return {"fit": project.fit_id, "machine": project.machine_id}


def starts_from_proposal(project: Project) -> bool:
    """Whether a fit starts from proposed parts: all labels are of these, and not every exemplar is painted all over.

    Such labels are corrections: evidence on their shapes, and an exemplar's parts are the proposed ones elsewhere.
    """
    record = project.stage_record("cosegment") or {}
    if not record.get("result"):
        return False
    labelled, groups = set(project.labelled), project.groups
    if not labelled or groups is None:
        return not labelled
    parts, proposed = project.part_names, (record.get("summary") or {}).get("part_names")
    if parts is None or list(parts.names) != proposed or parts.ids != tuple(range(len(proposed))):
        return False
    exemplars = [project.names[t] for t in groups.exemplars]
    return not labelled.issuperset(exemplars) or any(painted_share(project, name) < ALL_OVER for name in exemplars)


_shares_read: WeakKeyDictionary[Project, dict[tuple[str, ...], float]] = WeakKeyDictionary()


def painted_share(project: Project, name: str) -> float:
    """Share of a labelled shape's surface points that are painted; 1 where that cannot be read.

    It is asked for at every turn, so what was read is kept until the paint or the shape is another.
    """
    asked = (name, str(project.label_key(name)), project.shape_record(name)["key"])
    known = _shares_read.setdefault(project, {})
    if asked not in known:
        try:
            known[asked] = float((project.labels(name)[project.shapes.named(name).face_of_point] >= 0).mean())
        except ProjectError:  # the fit, which needs both, says what is wrong
            return 1.0
    return known[asked]


@dataclass(frozen=True)
class Corrections:
    """Names of the shapes that a fit is to be taken up again with, and ``why`` it cannot be ("": it can).

    ``painted`` otherwise than when it was fitted, ``exemplars`` among them; ``new``: imported, read or turned since.
    """

    painted: tuple[str, ...] = ()
    exemplars: tuple[str, ...] = ()
    new: tuple[str, ...] = ()
    why: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.painted, *(name for name in self.new if name not in self.painted))


def first_parts(project: Project) -> str:
    """Which proposal of parts a fit starts from, as an id that changes with it; "" where it starts from labels."""
    record = project.stage_record("cosegment") or {}
    return str(record["result"]) if starts_from_proposal(project) else ""


def unchanged_shapes(project: Project) -> frozenset[str]:
    """Names of the shapes that are as the present fit read them (one of an earlier version tells their names only)."""
    keys = project.fitted_keys
    return frozenset(
        name for name in project.names if name in keys and keys[name] in ("", project.shape_record(name)["key"])
    )


def corrections(project: Project) -> Corrections:
    """The shapes that changed since the fit, and whether it can be taken up again with them.

    By what is written down of the fit and of the exemplars in it; ``stages_warm.warm_start`` looks at all of it.
    """
    summary = (project.stage_record("fit") or {}).get("summary") or {}
    if project.current_folder("fit") is None or "painted" not in summary:
        return Corrections(why="There is no finished fit.")
    before, same = summary["painted"], unchanged_shapes(project)
    painted = tuple(name for name in project.names if before.get(name) != project.label_key(name))
    exemplars = tuple(name for name in painted if name in summary["exemplars"])
    new = tuple(name for name in project.names if name not in same)
    found = Corrections(painted, exemplars, new)
    if not found.names:
        return Corrections(why="Nothing was painted since the fit.")
    return replace(found, why=_why_not_warm(project, summary, found))


def _why_not_warm(project: Project, summary: Mapping[str, Any], found: Corrections) -> str:
    names, groups = project.part_names.names if project.part_names is not None else (), project.groups
    if list(names) != summary["parts"]:
        return "The parts are others than in the fit."
    exemplars = [project.names[t] for t in groups.exemplars] if groups is not None else []
    if starts_from_proposal(project):
        if found.new:
            return "The parts were proposed before the new shapes came."
        if _fitted_parts(project) != first_parts(project):
            return "The proposed parts are others than in the fit."
    else:
        if not set(summary["exemplars"]) <= set(exemplars):
            return "The exemplars are others than in the fit."
        fresh = [name for name in exemplars if name not in summary["exemplars"] and project.label_key(name)]
        if fresh:
            return f"{fresh[0]} is an exemplar, and the fit had no templates of it."
    anew = [name for name in summary["exemplars"] if name in found.new]
    if anew:
        return f"{anew[0]} is an exemplar, and was read anew since the fit."
    bare = [name for name in found.exemplars if project.label_key(name) is None]
    if bare:
        return f"{bare[0]} is an exemplar, and is no longer painted."
    return next(filter(None, (_why_unseen(project, name) for name in found.exemplars)), "")


def _fitted_parts(project: Project) -> str:
    """Which proposal of parts the present fit started from; "" where it started from labels."""
    inputs = (project.stage_record("fit") or {}).get("inputs") or {}
    return str(inputs.get("first parts") or "")


def _why_unseen(project: Project, name: str) -> str:
    """Why a fit cannot be taken up with what an exemplar's paint covers now, by the paint that the fit kept of it.

    With proposed parts an exemplar's templates are not of its paint alone: what they cover only the fit itself tells.
    """
    from shapeforge.deformation.warm import why_other_surface

    if _fitted_parts(project):
        return ""
    fitted, faces = project.beliefs(name), project.labels(name)
    if fitted is None or faces is None or not (seen := fitted.evidence >= 0).any():
        return ""
    on = project.shapes.named(name).face_of_point
    if len(on) != len(seen) or len(faces) <= on.max():
        return ""
    return why_other_surface(name, seen, faces[on] >= 0)


def difference(record: Mapping[str, Any], options: Mapping[str, Any], inputs: Mapping[str, Any]) -> str:
    """What changed since a stage was run, in words."""
    old_inputs, old_options = record.get("inputs", {}), record.get("options", {})
    changed = [f"the {name} changed" for name, value in inputs.items() if old_inputs.get(name) != value]
    for name, value in options.items():
        if old_options.get(name) != value:
            changed.append(f"{name} {_short(value)} instead of {_short(old_options.get(name))}")
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
    options = options_of(stage, record, {})
    inputs = inputs_of(project, stage)
    if record["key"] != key_of(stage, REVISION, options, inputs):
        return Status("stale", difference(record, options, inputs))
    lost = lost_results(project, stage, record)
    if lost:
        return Status("stale", lost)
    proposed = stage == "fit" and (not project.labelled or starts_from_proposal(project))
    used = (*needs, "cosegment") if proposed else needs
    for name in used:
        if before[name].state in ("stale", "partial") and name != "import":
            return Status("stale", f"{name} is {before[name].state}: {before[name].reason}")
    if record["state"] == "partial":
        return Status("partial", "was stopped; it goes on where it was")
    summary = record.get("summary") or {}
    return Status("done", str(summary.get("text", "done")))


def _short(value: Any) -> str:
    """An option's value for a line of text: lists of shapes may be long."""
    text = str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 1]}…"


def lost_results(project: Project, stage: str, record: Mapping[str, Any] | None) -> str:
    """Which file of a finished stage's results is gone from the project, in words; empty when all are there."""
    if not record or record["state"] != "done":
        return ""
    if stage == "group":
        missing = [] if (project.path / "groups.zarr.zip").is_file() else ["groups.zarr.zip"]
    else:
        folder = project.result_folder(stage, record["result"])
        wanted = [f"{name}.zarr.zip" for name in RESULTS.get(stage, ())]
        if stage in ("fit", "refine"):
            wanted += [f"shapes/{name}.zarr.zip" for name in project.names]
        missing = [str((folder / name).relative_to(project.path)) for name in wanted if not (folder / name).is_file()]
    return f"{missing[0]} is gone" if missing else ""


def _import_status(project: Project, record: Mapping[str, Any] | None) -> Status:
    number = len(project.names)
    if not number:
        return Status("missing", "no shapes yet")
    if record and record["state"] == "partial":
        return Status("partial", f"was stopped after {counted(number, 'shape')}; it goes on with the rest")
    changed = changed_words(project)
    return Status("stale", changed) if changed else Status("done", counted(number, "shape"))


def changed_words(project: Project) -> str:
    """How many files of shapes changed since they were read, and some of them, in words; empty when none did."""
    changed = project.changed_sources()
    some = ", ".join(changed[:3]) + (", …" if len(changed) > 3 else "")
    return f"{counted(len(changed), 'file')} changed since being read ({some})" if changed else ""


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
            return Status("done", f"{counted(len(labelled), 'shape')}; exemplars without labels: {', '.join(without)}")
    return Status("done", counted(len(labelled), "shape"))


def next_step(project: Project) -> str:
    """One sentence: the command that is most worth running next."""
    states = status(project)
    if states["import"].state == "stale":
        unreadable = {problem.file for problem in project.problems if problem.kind == "error"}
        changed = [project.shape_record(name)["source"] for name in project.changed_sources()]
        if not unreadable.issuperset(changed):  # what could not be read is said beside it, and holds nothing up
            return f"Read the changed files again: shapeforge import {project.path}"
    required = ("import", "group", "label", "fit", "learn", "synthesize")
    for stage in required:
        state = states[stage].state
        if stage == "label" and starts_from_proposal(project) and states["cosegment"].state == "done":
            continue
        if state != "done" and not (stage == "import" and state == "stale"):
            return remedy(project, stage)
    return f"Export the results: shapeforge export {project.path} --out DIR"


def remedy(project: Project, stage: str) -> str:
    """One sentence: the command that runs a stage."""
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
