"""The last stage: draw new shapes from the machine and make labelled meshes of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from shapeforge.collection.colours import inks_of
from shapeforge.collection.counts import counted
from shapeforge.collection.labels import PartNames, write_part_names, write_seg
from shapeforge.stages import Progress, StageError, Task
from shapeforge.store import Project
from shapeforge.store_arrays import clear_disk_errors, read_record, write_record, write_text

FORMATS = ("glb", "ply", "obj", "stl")
COLOURS = ("parts", "sources")
ROUTES = ("parts", "surface")
"""Parts of training shapes, bent and put together; or a new surface around the points (§7)."""
REDRAWS = 3
"""Other draws, at most, in place of one that no parts of the family make a whole of: ..."""
APART = 0.005
"""... parts stay farther (diagonals) from each other than on the training shapes, ..."""
UNLIKE = 0.08
"""... or are this far (diagonals, mean) from where the draw has them."""

TOLD = {
    "closed": "had open parts, which were closed first (how much: measures.json)",
    "redrawn": "in place of draws whose parts do not go together (of how many: measures.json)",
    "not_united": "in parts that cannot be united (why: measures.json)",
}
"""What is said of shapes that have one of these among their measures."""


def synthesize(task: Task) -> Iterator[Progress]:
    """``count`` new shapes: drawn, made of retrieved and bent parts, written as labelled meshes to ``out``."""
    from shapeforge.stages_draws import drawn_as_asked
    from shapeforge.stages_recipes import points_of, recipe_of, write_recipe

    project, folder, options = task.project, task.folder, task.options
    count = _checked(options)
    out = Path(options["out"] or project.path / "synthesized")
    machine = project.machine()
    drawn = drawn_as_asked(project, options, count, rng=np.random.default_rng(options["seed"]))
    sources = sources_of(project)
    make = mesh_maker(sources, options["route"], union=options["union"])
    taken = parts_taken(options["take"], sources, options["route"])
    finish = partial(completed, machine, sources=sources, with_parts=taken, without=options.get("lacking", ()))
    drawn = finish(drawn)
    names = [f"{project.name}_{i + 1:03d}" for i in range(count)]
    part_names = fitted_part_names(project)

    def made_of(latents: Any) -> Any:
        return make(points_of(machine, latents), latents.exists[0], **({"fixed": taken} if taken else {}))

    def again(i: int, turn: int) -> Any:
        rng = np.random.default_rng([options["seed"], i, turn])
        return finish(drawn_as_asked(project, options, 1, rng=rng)).latents

    def work(i: int) -> dict[str, Any]:
        path = folder / "shapes" / f"{names[i]}.zarr.zip"
        if path.is_file():
            made = read_record(path)[0]
        else:
            turns = 0 if options.get("between") else REDRAWS
            shape, latents = made_whole(made_of, drawn.latents[i], partial(again, i), turns)
            drawing = {"seed": options["seed"], "number": i + 1, "temperature": float(options["temperature"])}
            drawing |= {name: options[name] for name in ("route", "union", "colours")}
            made = as_record(shape) | {"points": points_of(machine, latents), "exists": latents.exists[0]}
            made |= {"recipe": recipe_of(project, latents, shape, **drawing)}
            write_record(path, made)
        write_recipe(out / f"{names[i]}.{options['format']}", made["recipe"])
        write_labelled(out, names[i], made, part_names, options["format"], options["colours"])
        return made

    measures, used = {}, []
    for i, made in enumerate(task.workers.map(work, range(count))):
        measures[names[i]] = {"sources": made["sources"], **made["measures"]}
        used.append((made["points"], made["exists"], made["recipe"]["hidden"]))
        yield task.progress("synthesize", i + 1, count, names[i])
    drawn = _as_used(drawn, used)
    write_record(folder / "draws.zarr.zip", {"points": drawn.points, "exists": drawn.exists, "names": names})
    with clear_disk_errors(out):
        write_part_names(out / "labels.json", part_names)
    write_text(out / "measures.json", json.dumps(measures, indent=1))
    task.summary |= {"text": (text := _told(measures, out)), "count": count, "out": str(out), "names": names}
    yield task.progress("synthesize", count, count, text, state=drawn)


def _checked(options: Mapping[str, Any]) -> int:
    """How many shapes are asked for.  Raises StageError for options that ask for what is not to be had."""
    if options["format"] not in FORMATS:
        raise StageError(f"format: wanted one of {', '.join(FORMATS)}, got {options['format']!r}")
    if options["colours"] not in COLOURS:
        raise StageError(f"colours: wanted one of {', '.join(COLOURS)}, got {options['colours']!r}")
    count = int(options["count"])
    if count < 1:
        raise StageError(f"count: wanted at least 1, got {count}")
    if not np.isfinite(options["temperature"]):
        raise StageError(f"temperature: wanted a positive number, got {options['temperature']}")
    return count


def _as_used(drawn: Any, used: Sequence[tuple[np.ndarray, np.ndarray, list]]) -> Any:
    """The draws with the points, parts and hidden units that meshes were made of, other draws among them."""
    points, exists, hidden = zip(*used, strict=True)
    layers = tuple(np.array(layer, drawn.points.dtype) for layer in zip(*hidden, strict=True))
    latents = replace(drawn.latents, layers=layers, exists=np.stack(exists))
    return replace(drawn, points=np.stack(points), exists=np.stack(exists), latents=latents)


def _told(measures: Mapping[str, Mapping[str, Any]], out: Path) -> str:
    """What was made, in a sentence, from the ``measures`` of every shape."""
    text = f"{counted(len(measures), 'shape')} in {out}"
    for key, words in TOLD.items():
        number = sum(key in found for found in measures.values())
        if number:
            text += f"; {number} of them {words}"
    return text


def made_whole(
    make: Callable[[Any], Any], latents: Any, again: Callable[[int], Any], turns: int = REDRAWS
) -> tuple[Any, Any]:
    """The shape that ``make`` makes of ``latents``, and these; where it is not whole, of others: ``again(turn)``.

    A fit that takes a side panel for a backrest is drawn like any shape, and no part of the family goes there.  After
    ``turns`` the best is kept; ``measures["redrawn"]`` of the shape tells how many draws were put aside for it.
    """
    shape, kept, turn = make(latents), latents, 0
    fault = fault_of(shape)
    while fault > 1 and turn < turns:
        turn += 1
        other = again(turn)
        made = make(other)
        if fault_of(made) < fault:
            fault, shape, kept = fault_of(made), made, other
    return (replace(shape, measures={**shape.measures, "redrawn": turn}) if turn else shape), kept


def fault_of(shape: Any) -> float:
    """How far from whole a shape is: at most 1 if it need not be drawn anew.  A new surface is in one piece anyway."""
    measures = shape.measures
    if "largest_gap" not in measures:
        return 0.0
    return max(measures["largest_gap"] / APART, (measures["distance_from_draw"] or 0.0) / UNLIKE)


def mesh_maker(sources: Any, route: str, *, union: bool = False) -> Callable[..., Any]:
    """What makes a ``SynthesizedShape`` of points (K, 3) and parts (L,): of retrieved parts, or a new surface.

    With ``union`` parts become one watertight solid; where they cannot, its measures say why.
    Keyword arguments go on to the route.  Raises StageError for an unknown route or a missing package.
    """
    from shapeforge.synthesis.assemble import synthesize as from_parts
    from shapeforge.synthesis.surface import synthesize_surface
    from shapeforge.synthesis.union import solid_modeller, unite

    if route not in ROUTES:
        raise StageError(f"route: wanted one of {', '.join(ROUTES)}, got {route!r}")
    if route == "surface":
        return partial(synthesize_surface, sources=sources)
    if not union:
        return partial(from_parts, sources=sources)
    try:
        solid_modeller()
    except ValueError as error:
        raise StageError(str(error)) from None

    def united(points: np.ndarray, exists: np.ndarray, **more: Any) -> Any:
        shape = from_parts(points, exists, sources, **more)
        try:
            return unite(shape)
        except ValueError as error:
            return replace(shape, measures={**shape.measures, "not_united": str(error)})

    return united


def parts_taken(asked: Sequence[str], sources: Any, route: str) -> dict[int, int]:
    """{part: training shape} of ``PART=SHAPE`` words.  Raises StageError for other words, naming those known."""
    taken = {}
    for text in asked:
        part, _, name = (word.strip() for word in text.partition("="))
        for word, known in ((part, sources.part_names), (name, sources.names)):
            if word not in known:
                raise StageError(f"take: {text!r} is no PART=SHAPE; {word!r} is none of {', '.join(known)}")
        taken[sources.part_names.index(part)] = sources.names.index(name)
        if sources.part_of(sources.names.index(name), sources.part_names.index(part)) is None:
            raise StageError(f"take: {name} has no {part} that could be taken")
    if taken and route == "surface":
        raise StageError("take: a new surface is made of no shape's parts. Use --route parts")
    return taken


def completed(
    machine: Any, drawn: Any, sources: Any, *, with_parts: Iterable[int] = (), without: Collection[str] = ()
) -> Any:
    """The draws with the parts that they cannot do without (see ``synthesis.complete``), and those asked for."""
    from shapeforge.generative.draw import Draw
    from shapeforge.generative.inference import decode
    from shapeforge.synthesis.complete import completed_parts

    having = np.where(np.isin(sources.part_names, list(without)), 0.0, sources.exists.mean(axis=0))
    exists = np.stack([completed_parts(one, sources.touching, having) for one in drawn.exists])
    exists[:, list(with_parts)] = True
    if np.array_equal(exists, drawn.exists):
        return drawn
    latents = replace(drawn.latents, exists=exists)
    return Draw(machine.to_positions(decode(machine, latents), exists), exists, latents)


def as_record(shape: Any) -> dict[str, Any]:
    """A ``SynthesizedShape`` as plain arrays and numbers, triangles sorted by part as some formats have them."""
    order = np.argsort(shape.part, kind="stable")
    colours = {} if shape.colours is None else {"colours": np.asarray(shape.colours, np.uint8)[order]}
    return colours | {
        "vertices": np.asarray(shape.vertices, np.float64), "triangles": np.asarray(shape.triangles, np.int32)[order],
        "part": np.asarray(shape.part, np.int32)[order], "part_names": list(shape.part_names),
        "sources": list(shape.sources), "measures": json.loads(json.dumps(shape.measures, default=float)),
    }  # fmt: skip


def write_labelled(
    out: Path, name: str, made: dict[str, Any], part_names: PartNames, ending: str, colours: str = "parts"
) -> None:
    """Write a mesh and its ``.seg`` (one label id per triangle, in the order the file is read in) into ``out``.

    ``colours`` are those of the parts or of the sources (of the parts, where no source has any).
    """
    from shapeforge.collection.meshes import read_mesh, write_mesh

    path = out / f"{name}.{ending}"
    own = made.get("colours") if colours == "sources" else None
    palette = inks_of(made["part_names"], part_names.colours)
    with clear_disk_errors(path):
        out.mkdir(parents=True, exist_ok=True)
        write_mesh(
            path, made["vertices"], made["triangles"], made["part"], tuple(made["part_names"]), palette, own
        )  # fmt: skip
        part = made["part"]
        if ending == "glb":  # its nodes are read in an order of the reader's own: look which triangle came where
            centres = made["vertices"][made["triangles"]].mean(axis=1)
            part = part[cKDTree(centres).query(read_mesh(path).face_centres)[1]]
        write_seg(out / f"{name}.seg", part, part_names)


def sources_of(project: Project) -> Any:
    """The fitted shapes as a store of parts, read from the project on demand."""
    from shapeforge.synthesis.sources import make_sources

    names = project.fit_names
    hierarchy = project.hierarchy()
    # Shapes that were explained after a turn lend their parts turned, as draws lie the way the family does.
    positions = np.stack([
        project.beliefs(name).to_family(np.asarray(project.positions(name), np.float64)) for name in names
    ])  # fmt: skip

    def turned(t: int) -> Any:
        shape, beliefs = project.shapes.named(names[t]), project.beliefs(names[t])
        if beliefs.lies_as_the_family:
            return shape
        return replace(shape, mesh=shape.mesh.moved(beliefs.to_family(np.asarray(shape.mesh.vertices, np.float64))))

    return make_sources(
        names, turned, FittedLabels(project, names), positions,
        hierarchy.top.label, tuple(hierarchy.top.part_names), project.labelled,
    )  # fmt: skip


class FittedLabels(Sequence):
    """Fitted face labels of the shapes, read one at a time."""

    def __init__(self, project: Project, names: Sequence[str]) -> None:
        self._project, self._names = project, names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: int) -> np.ndarray:
        return self._project.face_labels(self._names[index])


def fitted_part_names(project: Project) -> PartNames:
    """Names and ids of the parts of the fit (proposed parts have ids from 0)."""
    part_names, fitted = project.part_names, project.hierarchy().top.part_names
    if part_names is not None and part_names.names == tuple(fitted):
        return part_names
    return PartNames(tuple(range(len(fitted))), tuple(fitted), part_names.colours if part_names else {})
