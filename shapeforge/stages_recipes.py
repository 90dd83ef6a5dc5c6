"""Recipes: what it takes to make a new shape again, as JSON beside its mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from shapeforge.stages import StageError
from shapeforge.store import Project
from shapeforge.store_arrays import write_text

ENDING = ".recipe.json"
UNIT = "1 is the diagonal of a shape of the family; y is up"


def recipe_of(project: Project, latents: Any, shape: Any, **more: Any) -> dict[str, Any]:
    """What is written: the latents (of one shape, sliders included), its parts, where each comes from, and ``more``.

    ``shape`` is the ``SynthesizedShape``.  Numbers keep all their digits: the mesh comes out the same to the bit.
    """
    names = tuple(shape.part_names)
    return {
        "format": "shapeforge recipe", "version": 1, "project": project.name, "machine": project.machine_id,
        "fit": project.fit_id, **more, "unit": UNIT,
        "parts": [n for n, on in zip(names, latents.exists[0], strict=True) if on],
        "sources": {n: s for n, s in zip(names, shape.sources, strict=True) if s},
        "measures": json.loads(json.dumps(dict(shape.measures), default=float)),
        "hidden": [[float(x) for x in layer[0]] for layer in latents.layers],
    }  # fmt: skip


def write_recipe(mesh: Path, recipe: Mapping[str, Any]) -> Path:
    """Write a recipe beside the mesh file ``mesh``; its path."""
    path = mesh.with_name(mesh.name + ENDING)
    write_text(path, json.dumps(dict(recipe), indent=1))
    return path


def read_recipe(path: str | Path) -> dict[str, Any]:
    """A recipe from its file.  StageError names the file and what is wrong with it."""
    try:
        found = json.loads(Path(path).read_text("utf-8"))
    except OSError as error:
        reason = (error.strerror or "cannot be read").lower()
        raise StageError(f"{path}: {reason}. Name a MESH{ENDING} that `shapeforge synthesize` wrote.") from error
    except ValueError as error:  # no JSON, or no text
        reason = f"wanted a MESH{ENDING} that `shapeforge synthesize` wrote, got a file that is no JSON"
        raise StageError(f"{path}: {reason}. Name the one beside the mesh, or make the shape anew.") from error
    if not isinstance(found, dict) or found.get("format") != "shapeforge recipe" or found.get("version") != 1:
        raise StageError(
            f"{path}: wanted a recipe of version 1, as `shapeforge synthesize` writes it beside each mesh."
        )
    if found.get("bend") and not _is_bend(found["bend"]):
        raise StageError(
            f"{path}: wanted a bend of centres and heights (n × 3 numbers each) and a width above 0, got something "
            "else. Take it out of the file, or make the shape anew."
        )
    return found


def _is_bend(bend: Any) -> bool:
    try:
        centres, heights, width = (np.array(bend[key], np.float64) for key in ("centres", "heights", "width"))
    except (KeyError, TypeError, ValueError):
        return False
    right = centres.ndim == 2 and centres.shape[1] == 3 and heights.shape == centres.shape and width.ndim == 0
    return bool(right and np.isfinite(centres).all() and np.isfinite(heights).all() and 0 < width < np.inf)


def remake(project: Project, recipe: Mapping[str, Any], sources: Any = None) -> Any:
    """The ``SynthesizedShape`` of a recipe.  ``sources`` of the project may be given if they are at hand.

    Raises StageError if the project has another machine than the recipe's, or lacks its parts or shapes.
    """
    from shapeforge.generative.inference import Latents
    from shapeforge.stages_synthesis import mesh_maker, sources_of
    from shapeforge.synthesis.mirror import Bend

    machine = project.machine()
    if machine is None or project.machine_id != recipe["machine"] or project.fit_id != recipe["fit"]:
        raise StageError(
            f"{recipe['project']}: the recipe is of the machine {recipe['machine']} of the fit {recipe['fit']}, but "
            f"{project.path} has {project.machine_id} of {project.fit_id}. Open the project that it was made with."
        )
    sources = sources_of(project) if sources is None else sources
    exists = np.array([name in recipe["parts"] for name in sources.part_names])
    hidden = tuple(np.array([layer], machine.dtype) for layer in recipe["hidden"])
    taken = [recipe["sources"].get(name, "") for name in sources.part_names]
    unknown = sorted({name for name in taken if name and name not in sources.names})
    if unknown:
        raise StageError(f"sources: the project has no fitted shape {', '.join(unknown)}")
    shapes = np.array([sources.names.index(name) if name else -1 for name in taken])
    with threadpool_limits(1, "blas"):  # as the stage does it: sums on several threads round otherwise
        points = points_of(machine, Latents(hidden, exists[None]))
        if bent := recipe.get("bend"):
            points = Bend(np.array(bent["centres"]), np.array(bent["heights"]), bent["width"]).moved(points)
        route = recipe.get("route", "parts")
        make = partial(mesh_maker(sources, route, union=recipe.get("union", False)), points, exists)
        symmetric = np.array([name not in recipe.get("unsymmetric", []) for name in sources.part_names])
        return make(symmetric=symmetric) if route == "surface" else make(shapes=shapes, symmetric=symmetric)


def points_of(machine: Any, latents: Any) -> Float[np.ndarray, "K 3"]:
    """Points (K, 3) of one shape's latents in normal coordinates, NaN where a part is absent.

    Always of one shape by itself, in arrays of its own: a product of many rows, or of rows with other strides, may
    round otherwise.
    """
    from shapeforge.generative.inference import Latents, decode

    alone = Latents(tuple(np.array(layer[0], machine.dtype)[None] for layer in latents.layers), latents.exists)
    return np.asarray(machine.to_positions(decode(machine, alone), latents.exists)[0], np.float64)


def remake_files(project: Project, recipes: Sequence[str | Path], out: str | Path, ending: str) -> list[Path]:
    """Meshes, labels and recipes of all recipe files, written into ``out``; the paths of the meshes."""
    from shapeforge.stages_synthesis import FORMATS, as_record, fitted_part_names, sources_of, write_labelled

    if ending not in FORMATS:
        raise StageError(f"format: wanted one of {', '.join(FORMATS)}, got {ending!r}")
    read = [(Path(path), read_recipe(path)) for path in recipes]
    sources, written = sources_of(project), []
    for path, recipe in read:
        name = path.name.removesuffix(ENDING).rpartition(".")[0] or path.stem
        made, colours = as_record(remake(project, recipe, sources)), recipe.get("colours", "parts")
        write_labelled(Path(out), name, made, fitted_part_names(project), ending, colours)
        written.append(Path(out) / f"{name}.{ending}")
        write_recipe(written[-1], recipe)
    return written
