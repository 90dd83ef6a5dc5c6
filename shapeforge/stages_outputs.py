"""What leaves a project: exports, and labels and correspondences for shapes that are not part of it."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.collection.counts import counted
from shapeforge.collection.labels import PartNames, write_part_names, write_seg
from shapeforge.collection.shape import Shape
from shapeforge.stages import Progress, StageError, refresh
from shapeforge.stages_synthesis import fitted_part_names
from shapeforge.store import Problem, Project
from shapeforge.store_arrays import clear_disk_errors, replacing, write_text
from shapeforge.workers import Workers

# -- export ----------------------------------------------------------------------------------------------------------


def export(
    project: Project, out: str | Path, *, probabilities: bool = False, jobs: int | None = None
) -> Iterator[Progress]:
    """Write labels, corresponding points, groups and (once learned) descriptors of every shape into the folder ``out``.

    Files: ``labels/<name>.seg``, ``labels/labels.json``, ``points/<name>.npz`` (positions (K, 3) in the input mesh's
    coordinates, NaN where absent; part (K,) label ids; existence (K,); component (K,), counted from 0 within the part,
    -1 of parts that are one; copies (n, 3), samples of components that no template has, and part_of_copies (n,)),
    ``parts.csv`` (how many components of every part each shape has, and copies beside them), ``groups.csv``,
    ``descriptors.csv`` and, when asked, ``probabilities/<name>.npz``.  A stale fit is redone first.
    """
    yield from refresh(project, ("fit", "learn"), jobs=jobs, wanted_by="export", optional=("learn",))
    out = Path(out)
    names, part_names = project.fit_names, fitted_part_names(project)
    top = project.hierarchy().top
    of_points = part_and_component(top, part_names)
    state = project.fit() if probabilities else None  # of all shapes: read once
    with clear_disk_errors(out):
        for folder in ("labels", "points"):
            (out / folder).mkdir(parents=True, exist_ok=True)
        write_part_names(out / "labels" / "labels.json", part_names)
    for step, name in enumerate(names):
        shape = project.shapes.named(name)
        write_result(
            out, shape, project.face_labels(name), project.positions(name), project.existence(name),
            project.beliefs(name).copies, of_points, part_names,
        )  # fmt: skip
        if probabilities:
            found = face_and_point_probabilities(project, shape, part_names, state)
            write_npz(out / "probabilities" / f"{name}.npz", found)
        yield Progress("export", "write", step + 1, len(names), name)
    write_groups(out / "groups.csv", project)
    write_part_counts(out / "parts.csv", top, {name: project.part_counts(name) for name in names})
    described = project.descriptors()
    if described is not None:
        write_descriptors(out / "descriptors.csv", *described)
    asked = names if probabilities else ()
    yield from _left_in(out, "export", {"labels": names, "points": names, "probabilities": asked})
    yield Progress("export", "write", len(names), len(names), f"{counted(len(names), 'shape')} exported to {out}")


def write_result(
    out: Path, shape: Shape, labels: np.ndarray, positions: np.ndarray, existence: np.ndarray, copies: np.ndarray,
    of_points: Mapping[str, np.ndarray], part_names: PartNames,
) -> None:  # fmt: skip
    """``labels/<name>.seg`` and ``points/<name>.npz`` of one shape; ``of_points`` is the same for every shape."""
    on_copy = np.flatnonzero(copies >= 0)
    with clear_disk_errors(out / "labels" / f"{shape.name}.seg"):
        write_seg(out / "labels" / f"{shape.name}.seg", labels, part_names)
    arrays = {"positions": shape.frame.to_input(positions), **of_points, "existence": existence}
    arrays["copies"] = shape.frame.to_input(np.asarray(shape.points[on_copy], np.float64))
    arrays["part_of_copies"] = np.array(part_names.ids, np.int64)[copies[on_copy]]
    write_npz(out / "points" / f"{shape.name}.npz", arrays)


def part_and_component(top: Any, part_names: PartNames) -> dict[str, np.ndarray]:
    """What is said of the top-level template points on every shape: label id of the part, number of the component."""
    number = top.components.number.astype(np.int64)
    first = np.array([number[top.label == part].min(initial=len(number)) for part in range(top.n_parts)])
    return {
        "part": np.array(part_names.ids, np.int64)[top.label],
        "component": np.where(number >= 0, number - first[top.label], -1),
    }


def write_part_counts(path: Path, top: Any, counts: Mapping[str, Any]) -> None:
    """``parts.csv``: shape, part, components of it that the shape has, of how many of the templates, and copies."""
    known = [len(np.unique(top.components.number[top.label == part])) for part in range(top.n_parts)]
    rows = [
        (name, part_name, int(one.components[part]), known[part], int(one.copies[part]))
        for name, one in counts.items()
        for part, part_name in enumerate(top.part_names)
    ]
    write_csv(path, ("shape", "part", "components", "of", "copies"), rows)


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write plain arrays atomically."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)


def face_and_point_probabilities(
    project: Project, shape: Shape, part_names: PartNames, state: Any
) -> dict[str, np.ndarray]:
    """Label probabilities per face (F, L) with the ids (L,), and the sparse correspondence of surface samples.

    Row ``point[i]`` of ``samples`` (P, 3, input coordinates) corresponds to point ``template_point[i]`` of template
    set ``template`` of the fit's ``state`` with probability ``correspondence[i]``.
    """
    from shapeforge.deformation.updates import find_candidates, make_problem, update_correspondences

    beliefs = project.beliefs(shape.name)
    templates, covariances = state.templates[beliefs.template], state.covariances
    problem = make_problem(shape, project.labels(shape.name))
    candidates = find_candidates(problem, templates, beliefs, covariances.descriptor)
    sparse = update_correspondences(problem, templates, candidates, beliefs, covariances.unary)
    return {
        "labels": project.face_probabilities(shape.name), "ids": np.array(part_names.ids, np.int64),
        "samples": shape.frame.to_input(shape.points), "template": np.array(beliefs.template, np.int64),
        "point": np.repeat(np.arange(shape.n_points), np.diff(candidates.offsets)),
        "template_point": candidates.template_index, "correspondence": np.asarray(sparse.q, np.float32),
    }  # fmt: skip


def write_groups(path: Path, project: Project) -> None:
    """``groups.csv``: shape, group (number from 0, -1: none), exemplar (true or false)."""
    groups = project.groups
    exemplars = set() if groups is None else {int(t) for t in groups.exemplars}
    rows = [
        (name, -1 if groups is None else int(groups.group[t]), "true" if t in exemplars else "false")
        for t, name in enumerate(project.names)
    ]
    write_csv(path, ("shape", "group", "exemplar"), rows)


def write_descriptors(path: Path, names: Sequence[str], values: np.ndarray) -> None:
    """``descriptors.csv``: shape, then the numbers that nearest-neighbour search should use."""
    header = ("shape", *(f"d{i}" for i in range(values.shape[1])))
    write_csv(path, header, [(name, *(f"{v:.6g}" for v in row)) for name, row in zip(names, values, strict=True)])


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """A comma-separated table, atomically; decimals have dots in every locale."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(path, text.getvalue())


def _left_in(out: Path, stage: str, written: Mapping[str, Sequence[str]]) -> Iterator[Progress]:
    """A warning if the folders of ``out`` hold other shapes' files than those ``written``: they may go by other ids.

    They are not deleted: they may be all that is left of another project's results.
    """
    others = [
        file
        for folder, own in ((folder, set(names)) for folder, names in written.items())
        for file in sorted((out / folder).glob("*.seg" if folder == "labels" else "*.npz"))
        if file.stem not in own
    ]
    if others:
        which = f"{others[0].relative_to(out)}{', …' if len(others) > 1 else ''}"
        text = f"holds {counted(len(others), 'file')} written earlier ({which}), whose label ids may be others"
        problem = Problem(str(out), "warning", text, "Write into an empty folder, or delete them")
        yield Progress(stage, "write", 1, 1, str(problem), problem=problem)


# -- apply -----------------------------------------------------------------------------------------------------------


def apply(
    project: Project, meshes: Sequence[str | Path], out: str | Path, *, jobs: int | None = None
) -> Iterator[Progress]:
    """Label, correspond and (once learned) describe new shapes with the fitted family; the project is not changed.

    Files in ``out`` as :func:`export` writes them.  A file that cannot be read is reported and skipped; then, after
    all the others, :class:`StageError` says how many.
    """
    from shapeforge.collection.meshes import MeshError, find_meshes
    from shapeforge.deformation.components import count_parts

    yield from refresh(project, ("fit",), jobs=jobs, wanted_by="apply")
    try:
        found = find_meshes([Path(path) for path in meshes])
    except MeshError as error:
        raise StageError(str(error)) from error
    out, part_names, hierarchy, state = Path(out), fitted_part_names(project), project.hierarchy(), project.fit()
    of_points, counts = part_and_component(hierarchy.top, part_names), {}
    options = (project.stage_record("import") or {})["options"]
    with clear_disk_errors(out):
        for folder in ("labels", "points"):
            (out / folder).mkdir(parents=True, exist_ok=True)
        write_part_names(out / "labels" / "labels.json", part_names)

    def work(name: str, path: Path) -> tuple[Any, Problem | None]:
        try:
            return apply_one(name, path, options, state, hierarchy), None
        except MeshError as error:
            return None, Problem(str(path), "error", error.problem, error.remedy)
        except OSError as error:
            return None, Problem(
                str(path), "error", f"cannot be read ({error.strerror or error})", "See who may read it"
            )
        except (ValueError, ArithmeticError, MemoryError, IndexError) as error:
            project.log(f"apply: {path}", error)
            why = str(error) or type(error).__name__
            if isinstance(error, FloatingPointError):  # it says the shape's name only
                why = "its fit produced numbers that are not finite"
            return None, Problem(str(path), "error", f"cannot be fitted ({why})", "The project's log has the details")

    done: list[tuple[str, np.ndarray, int]] = []
    failed: list[Problem] = []
    workers = Workers(jobs)
    try:
        results = workers.map(work, [name for name, _ in found], [path for _, path in found])
        for step, ((name, _), (result, problem)) in enumerate(zip(found, results, strict=True)):
            if problem is not None:
                failed.append(problem)
                yield Progress("apply", "fit", step + 1, len(found), str(problem), problem=problem)
                continue
            shape, labels, positions, existence, beliefs, nearest = result
            write_result(out, shape, labels, positions, existence, beliefs.copies, of_points, part_names)
            counts[name] = count_parts(shape, hierarchy.top, existence, beliefs)
            done.append((name, beliefs.to_family(positions), nearest))
            yield Progress("apply", "fit", step + 1, len(found), name)
    finally:
        workers.close()
    source_group = _group_of_template(project, state)
    write_part_counts(out / "parts.csv", hierarchy.top, counts)
    write_csv(out / "groups.csv", ("shape", "group", "exemplar"), [(n, source_group[g], "false") for n, _, g in done])
    machine = project.machine()
    if machine is not None and done:
        write_descriptors(out / "descriptors.csv", [n for n, _, _ in done], describe(machine, [p for _, p, _ in done]))
    names = [name for name, _, _ in done]
    yield from _left_in(out, "apply", {"labels": names, "points": names})
    if failed:
        raise StageError(f"{len(failed)} of {len(found)} files were not labelled: {failed[0]}")
    yield Progress("apply", "fit", len(found), len(found), f"{counted(len(done), 'shape')} labelled in {out}")


def apply_one(name: str, path: Path, options: dict[str, Any], state: Any, hierarchy: Any) -> tuple[Any, ...]:
    """One new shape: (shape, face labels, positions (K, 3), existence (K,), beliefs, template set of the exemplar that
    explains it best)."""
    from shapeforge.collection.meshes import read_mesh
    from shapeforge.collection.prepare import prepare_shape
    from shapeforge.deformation.apply import fit_candidates
    from shapeforge.deformation.exemplars import best_of, blend
    from shapeforge.deformation.faces import Explanations, label_faces
    from shapeforge.deformation.hierarchy import corresponding_points

    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    rng = np.random.default_rng([int(options["seed"]), int(sha256[:15], 16)])
    shape = prepare_shape(name, read_mesh(path), n_points=int(options["points"]), up=options["up"], rng=rng)
    candidates = fit_candidates(shape, state.templates, state.covariances, hierarchy, annealed_from=state.annealed_from)
    beliefs, explained = blend(candidates), Explanations(candidates, state.templates, state.covariances.unary)
    labels, _ = label_faces(shape, beliefs, explained=explained)
    positions, existence = corresponding_points(shape, beliefs, hierarchy)
    # the family's own templates lead, but are of no group
    nearest = best_of([one for one in candidates if not one.family]).beliefs.template
    return shape, labels, positions, existence, beliefs, nearest


def describe(machine: Any, positions: Sequence[np.ndarray]) -> np.ndarray:
    """Learnt descriptors (T, F) of shapes given by their corresponding points (K, 3), NaN where absent."""
    from shapeforge.generative.descriptors import describe_shapes
    from shapeforge.generative.observations import observe

    seen = observe(np.stack(positions), machine.part, machine.part_names, machine.low, machine.high)
    return np.asarray(describe_shapes(machine, seen))


def _group_of_template(project: Project, state: Any) -> list[int]:
    """Number of the group of the shape that each template set came from, -1 where that is in none (any more).

    Of proposed parts that need not be the group's exemplar (see ``starting_groups``).
    """
    groups, names = project.groups, set(project.names)
    return [
        int(groups.group[project.index(one.source)]) if groups is not None and one.source in names else -1
        for one in state.templates
    ]
