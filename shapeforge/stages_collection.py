"""The stages of the collection once it is read: group, label, cosegment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.collection.counts import counted
from shapeforge.collection.labels import LABELS_FILE, PartNames
from shapeforge.stages import Progress, StageError, Task
from shapeforge.stages_status import REVISION, options_of, starts_from_proposal
from shapeforge.store import Problem, Project, key_of
from shapeforge.store_arrays import read_record, write_record
from shapeforge.store_results import write_names

# -- group -----------------------------------------------------------------------------------------------------------


def group(task: Task) -> Iterator[Progress]:
    """Groups of similar shapes and an exemplar for each; ``exemplars`` (names, or "auto") sets them by hand.

    Groups that were changed by hand, or whose exemplars have labels, stay, and shapes that came since join the nearest:
    only ``restart``, or options that are given, find all groups anew.
    """
    from shapeforge.collection.groups import group_shapes, join_groups

    project = task.project
    kept = project.groups
    painted = kept is not None and any(project.label_key(project.names[t]) for t in kept.exemplars)
    by_hand = project.grouped_by_hand
    if (by_hand or (painted and project.ungrouped_names)) and not task.restart and not task.given:
        new, which = project.ungrouped_names, "made by hand" if by_hand else "of the painted exemplars"
        yield task.progress("groups", 0, 1, f"the groups {which} stay")
        if kept is not None and len(kept):
            joined = join_groups(kept, project.shapes, [project.index(name) for name in new], executor=task.workers)
            project.set_groups(joined, by_hand=by_hand)
            names = [project.names[t] for t in joined.exemplars]
            text = f"{len(new)} new shape{'s' * (len(new) != 1)} joined the groups {which}"
            task.summary |= {"text": text, "groups": len(names), "exemplars": names, "joined": list(new)}
            yield task.progress("groups", 1, 1, text)
            return
    chosen = task.options["exemplars"]
    if isinstance(chosen, str):
        chosen = [chosen]
    if chosen == ["auto"]:
        chosen = None
    unknown = [name for name in chosen or () if name not in project.names]
    if unknown:
        which = project.names_near(unknown[0])
        raise StageError(f"exemplars: {unknown[0]!r} is not a shape of {project.path}. {which}")
    exemplars = [project.index(name) for name in chosen] if chosen else None
    rng = np.random.default_rng(task.options["seed"])
    state = None
    for state in group_shapes(project.shapes, rng=rng, executor=task.workers, exemplars=exemplars):
        yield task.progress(state.phase, state.step, state.of, state.phase, state=state)
    if state is None or state.groups is None:
        raise StageError(f"the shapes of {project.path} could not be grouped; name exemplars: --exemplars NAME NAME")
    project.set_groups(state.groups)
    names = [project.names[t] for t in state.groups.exemplars]
    several = "s" * (len(names) > 1)
    text = f"{len(names)} group{several}, exemplar{several} {', '.join(names)}"
    task.summary |= {"text": text, "groups": len(names), "exemplars": names, "stop_reason": state.stop_reason}
    yield task.progress("groups", 1, 1, text, state=state)


# -- label -----------------------------------------------------------------------------------------------------------


def label(task: Task) -> Iterator[Progress]:
    """Take labels from a folder of ``.seg`` files (``labels``), for all shapes or ``only`` those named.

    ``only`` is "exemplars" or names.  A file that does not fit its mesh is reported and skipped.  Raises
    :class:`StageError` when a shape asked for by name gets no labels, or none at all does.
    """
    from shapeforge.collection.labels import LabelError, find_part_names

    project = task.project
    if task.arguments["labels"] is None:
        raise StageError("labels: wanted a folder with .seg files, got none")
    folder = Path(task.arguments["labels"])
    if not folder.is_dir():
        raise StageError(f"{folder}: is not a folder. Name the folder that holds the .seg files.")
    wanted, by_name = _wanted(project, task.arguments["only"])
    asked = bool(task.arguments["only"])
    try:
        given = find_part_names(folder)
    except LabelError as error:
        raise StageError(str(error)) from error
    kept = any(not _can_be_read(project, folder, name, wanted, given) for name in project.labelled)
    # known ids keep their names, but for those of proposed parts that no paint is left of: these only number the parts
    names_stay = kept or (bool(project.labelled) and not starts_from_proposal(project))
    if project.part_names is not None and names_stay and not (folder / LABELS_FILE).is_file():
        known = dict(zip(project.part_names.ids, project.part_names.names, strict=True))
        given = PartNames(given.ids, tuple(map(known.get, given.ids, given.names)))
    given = replace(given, colours=_chosen_colours(project))
    part_names = merged_part_names(project.part_names if kept else None, given)
    translate = np.array([part_names.ids.index(part) for part in given.ids] + [-1], np.int32)
    taken, problems, absent = [], [], []
    project.set_part_names(part_names)
    for step, name in enumerate(wanted):
        file = seg_file(folder, name)
        problem = None
        if not file.is_file():
            absent.append(name)
            message = f"{name}: no {file.name}"
            if asked:
                problem = Problem(str(file.resolve()), "warning", f"is not there, {name} gets no labels")
        else:
            try:
                faces, unknown = _read_known(file, project, name, given)
                project.set_labels(name, translate[faces])
                if unknown:
                    told = ", ".join(f"{i} ({counted(number, 'face')})" for i, number in unknown.items())
                    reason = f"has ids that {LABELS_FILE} does not have, which are unlabelled now: {told}"
                    problem = Problem(str(file.resolve()), "warning", reason, f"Name them in {LABELS_FILE}")
                elif (faces < 0).all():
                    problem = Problem(str(file.resolve()), "warning", f"has no label: all of {name} is unlabelled")
                taken.append(name)
                message = name
            except LabelError as error:
                problem = Problem(str(file.resolve()), "error", f"wanted {error.wanted}, got {error.got}", error.cause)
                problems.append(problem)
                message = str(error)
        yield task.progress("read", step + 1, len(wanted), message, problem=problem)
    over = {seg_file(folder, name).name for name in taken}  # what was wrong with other files for the same shape
    about = [problem.file for problem in project.problems if Path(problem.file).name in over]
    project.set_problems(problems, [*about, *(str(seg_file(folder, name).resolve()) for name in wanted)])
    text = f"{counted(len(taken), 'shape')} labelled with {counted(len(part_names), 'part')}"
    if asked and absent:
        text += f", {', '.join(absent)} without"
    if problems:
        text += f", {counted(len(problems), 'file')} not read"
    unseen = parts_without_exemplar(project)
    if unseen and not problems:
        which, gets = ", ".join(unseen), "it" if len(unseen) == 1 else "them"
        text += f"; no exemplar has {which}, so no shape gets {gets}: name one that has (group --exemplars)"
    task.summary |= {
        "text": text, "labelled": taken, "without": absent, "not_read": [p.file for p in problems], "unseen": unseen
    }  # fmt: skip
    if asked and (problems or (by_name and absent)):
        reason = str(problems[0]) if problems else f"{folder} has no {absent[0]}.seg"
        raise StageError(f"{reason} ({len(taken)} of {len(wanted)} shapes were labelled)")
    if not taken:
        reason = str(problems[0]) if problems else f"{folder}: has no .seg file named like a shape of the project"
        raise StageError(f"{reason.rstrip('.')}. A shape called chair needs chair.seg, one integer per face.")
    yield task.progress("read", len(wanted), len(wanted), text)


def parts_without_exemplar(project: Project) -> list[str]:
    """Names of parts that no exemplar shows, as templates come from exemplars alone; none while one is unlabelled."""
    groups = project.groups
    if groups is None or project.part_names is None:
        return []
    painted = [project.labels(project.names[t]) for t in groups.exemplars]
    if not painted or any(faces is None for faces in painted):
        return []
    shown = np.unique(np.concatenate(painted))
    return [name for part, name in enumerate(project.part_names.names) if part not in shown]


def seg_file(folder: Path, name: str) -> Path:
    """The labels of a shape in a folder: ``chair.seg``, and of ``a__chair`` also ``a/chair.seg``, as the meshes lay."""
    file, nested = folder / f"{name}.seg", folder / f"{name.replace('__', '/')}.seg"
    return nested if nested.is_file() and not file.is_file() else file


def _can_be_read(project: Project, folder: Path, name: str, wanted: Sequence[str], given: PartNames) -> bool:
    """Whether a shape will get new labels."""
    from shapeforge.collection.labels import LabelError

    try:
        return name in wanted and len(_read_known(seg_file(folder, name), project, name, given)[0]) > 0
    except LabelError:
        return False


def _read_known(file: Path, project: Project, name: str, given: PartNames) -> tuple[np.ndarray, dict[int, int]]:
    """Part index (n_faces,) of every face of a shape, and the ids that are not ``given`` with their numbers of faces.

    Raises ``LabelError`` where the file does not fit, also when it has other ids only: what was labelled stays so.
    """
    from shapeforge.collection.labels import LabelError, read_seg, unknown_ids

    faces, unknown = read_seg(file, project.shape_record(name)["n_faces"], given), unknown_ids(file, given)
    if unknown and (faces < 0).all():
        ids, others = (", ".join(map(str, some)) for some in (given.ids, unknown))
        raise LabelError(file, f"ids of {LABELS_FILE} ({ids})", f"others only ({others})", f"{name} stays as it was.")
    return faces, unknown


def _wanted(project: Project, only: Any) -> tuple[list[str], bool]:
    """Shapes to label, and whether each was asked for by name."""
    names = [only] if isinstance(only, str) else list(only or ())
    if not names:
        return list(project.names), False
    if names == ["exemplars"]:
        groups = project.groups
        if groups is None:
            raise StageError(f"there are no exemplars yet. Group the shapes: shapeforge group {project.path}")
        return [project.names[t] for t in groups.exemplars], False
    for name in names:
        project.shape_record(name)
    return names, True


def merged_part_names(present: PartNames | None, given: PartNames) -> PartNames:
    """Parts known already keep their index, new ids come after; a known id takes the name given now.

    Raises StageError where two ids would have one name.
    """
    names = {} if present is None else dict(zip(present.ids, present.names, strict=True))
    names |= dict(zip(given.ids, given.names, strict=True))
    twice = next((name for name in names.values() if list(names.values()).count(name) > 1), None)
    if twice is not None:
        which = " and ".join(str(identity) for identity, name in names.items() if name == twice)
        wrong = f"labels.json: {twice!r} would be the name of the ids {which}"
        if present is None:
            raise StageError(f"{wrong}. Give each id a name of its own in a {LABELS_FILE} beside the .seg files.")
        raise StageError(
            f"{wrong}, as other shapes of the project have labels by other ids. Use the same ids for all shapes, or "
            "label all of them again into a new project."
        )
    return PartNames(tuple(names), tuple(names.values()), given.colours)


def _chosen_colours(project: Project) -> Mapping[str, str]:
    """The colours that a user gave to parts: a part that keeps its name keeps its colour."""
    return project.part_names.colours if project.part_names else {}


# -- cosegment -------------------------------------------------------------------------------------------------------


def cosegment(task: Task) -> Iterator[Progress]:
    """Propose parts for every shape without labels: label probabilities per point that the fit starts from.

    ``edits`` put them right afterwards (see ``proposed_edits``); parts are not sought again for that.  The exemplar of
    a group is then one of its shapes with the most parts, unless exemplars were chosen or groups changed by hand.
    Where shapes are corrected by the parts of the last proposal, these keep their names: StageError when one is not
    found again.
    """
    from shapeforge.deformation.boxes import propose_parts
    from shapeforge.deformation.proposed_again import numbered_as
    from shapeforge.deformation.proposed_edits import edit_parts

    project, folder, options = task.project, task.folder, task.options
    yield task.progress("propose", 0, 1, "looking for parts that many shapes share")
    source = key_of(REVISION, options["parts"], options["seed"], task.inputs)
    before = project.current_folder("cosegment")
    painted = _painted_before(project, before)
    if options["edits"] and before is not None and (before / f"found-{source}.zarr.zip").is_file() and not task.restart:
        found = read_record(before / f"found-{source}.zarr.zip")[0]
    else:
        rng = np.random.default_rng(options["seed"])
        parts = options["parts"] or (painted and len(painted.found.part_names)) or None
        found = propose_parts(project.shapes, project.groups, n_parts=parts, rng=rng)
        if painted and len(found.part_names) >= len(painted.found.part_names):
            found = numbered_as(painted.found, found, painted.same)
    proposal = found
    if options["edits"]:
        rng = np.random.default_rng(options["seed"])
        proposal = edit_parts(found, options["edits"], project.shapes, project.groups, rng=rng)
    chosen = (project.stage_record("group") or {}).get("options", {}).get("exemplars")
    if project.grouped_by_hand or (chosen and chosen not in ("auto", ["auto"])):
        proposal = replace(proposal, exemplars=project.groups.exemplars)
    if painted:
        _check_paint(project, painted, proposal)
    write_record(folder / f"found-{source}.zarr.zip", found)
    write_record(folder / "proposal.zarr.zip", proposal)
    write_record(folder / "parts_of_points.zarr.zip", _parts_of_points(proposal))
    keys = {name: project.shape_record(name)["key"] for name in project.names}
    write_names(folder / "names.zarr.zip", project.names, keys=keys)
    number = len(proposal.part_names)
    if painted or not project.labelled:
        part_names = PartNames(tuple(range(number)), tuple(proposal.part_names), _chosen_colours(project))
        project.set_part_names(part_names)
    text = proposed_text(proposal, edited=bool(options["edits"]))
    task.summary |= {"text": text, "parts": number, "energy": float(getattr(proposal, "energy", np.nan))}
    task.summary["part_names"] = list(proposal.part_names)
    if set(proposal.exemplars.tolist()) != set(project.groups.exemplars.tolist()):
        names = ", ".join(project.names[t] for t in proposal.exemplars)
        text += f"; a fit starts from {names}, with more of them than the groups' exemplars"
    yield task.progress("propose", 1, 1, text, state=proposal)


@dataclass(frozen=True, eq=False)
class _Before:
    """The last proposal, whose parts some shapes are painted with: as it was ``found``, and ``edited`` since.

    ``same`` are the shapes, by their numbers then and now, that are still as they were.
    """

    found: Any
    edited: Any
    same: tuple[tuple[int, int], ...]


def _painted_before(project: Project, folder: Path | None) -> _Before | None:
    """The last proposal, in ``folder``; None where no paint depends on it."""
    if folder is None or not project.labelled or not starts_from_proposal(project):
        return None
    files = [next(folder.glob(f"{name}.zarr.zip"), None) for name in ("names", "found-*", "proposal")]
    if None in files:  # lost: the same parts are found again
        return None
    about, found, edited = (read_record(file)[0] for file in files if file is not None)
    now, keys = {name: t for t, name in enumerate(project.names)}, about.get("keys") or {}
    return _Before(found, edited, tuple(
        (then, now[name]) for then, name in enumerate(about["names"])
        if name in now and len(edited.segmentation[then]) == project.shapes.named(name).n_points
        and keys.get(name, "") in ("", project.shape_record(name)["key"])
    ))  # fmt: skip


def _check_paint(project: Project, before: _Before, proposal: Any) -> None:
    """Raises StageError where a part that shapes are painted with is not one of the ``proposal``."""
    from shapeforge.deformation.proposed_again import FOUND_AGAIN, shared_surface

    names = tuple(before.edited.part_names)
    named = tuple(proposal.part_names[: len(names)]) == names
    shared = shared_surface(before.edited, proposal, before.same)
    for name in project.labelled:
        for part in np.unique(project.labels(name)):
            if part >= 0 and not (named and shared[part, part] > FOUND_AGAIN):
                raise StageError(
                    f"{name} is painted with {names[part]}, and the parts proposed now have none that is the same. All "
                    f"stays as it was. Ask for {len(before.found.part_names)} parts (--parts), take the paint off "
                    f"{', '.join(project.labelled)}, or paint the exemplars all over"
                )


def proposed_text(proposal: Any, *, edited: bool) -> str:
    """What a proposal says of itself: how many parts, and which of them the shapes do not agree on."""
    names, found_on = proposal.part_names, proposal.shapes_with()
    text = f"{len(names)} parts: {', '.join(names)}" if edited else f"{len(names)} parts proposed"
    few = min(2, len(proposal.segmentation))
    lost = [name for name, count in zip(names, found_on.tolist(), strict=True) if count < few]
    if not lost:
        return text
    are = "is" if len(lost) == 1 else "are"
    agreed = len(names) - len(lost)
    return f"{text}; {', '.join(lost)} {are} found on hardly any shape: they agree on {agreed} (ask for {agreed})"


def edits_of(project: Project, *more: Sequence[str], **given: Any) -> list[list[str]]:
    """The edits of the proposed parts that hold under the options ``given``, and ``more``: for the option ``edits``."""
    kept = options_of("cosegment", project.stage_record("cosegment"), given)["edits"]
    return [*kept, *(list(edit) for edit in more)]


def _parts_of_points(proposal: Any) -> dict[str, np.ndarray]:
    """The likeliest part of every point, of all shapes in a row: what a window shows, without reading all chances."""
    found = [np.asarray(one).argmax(axis=1).astype(np.int16) for one in proposal.segmentation]
    return {"parts": np.concatenate(found), "lengths": np.array([len(one) for one in found])}


def proposed_points(project: Project) -> list[np.ndarray] | None:
    """The likeliest part (P,) of every point of each shape by the last ``cosegment``; None before it."""
    folder = project.current_folder("cosegment")
    if folder is None:
        return None
    file = folder / "parts_of_points.zarr.zip"
    found = read_record(file)[0] if file.is_file() else _parts_of_points(read_proposal(project))
    return np.split(found["parts"], np.cumsum(found["lengths"])[:-1])


def read_proposal(project: Project) -> Any | None:
    """The ``Proposal`` of the last ``cosegment``, None before it."""
    folder = project.current_folder("cosegment")
    return None if folder is None else read_record(folder / "proposal.zarr.zip")[0]
