"""Shapes in hand as files: a mesh with its recipe beside it, and a recipe taken up again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shapeforge.generative.inference import Latents
from shapeforge.stages import StageError
from shapeforge.stages_recipes import read_recipe, recipe_of, write_recipe
from shapeforge.synthesis.assemble import SynthesizedShape
from shapeforge.viewer.pulling import as_place, off_by
from shapeforge.viewer.sculptor import Recipe, Sculptor


def export_mesh(path: Path, sculptor: Sculptor, shape: SynthesizedShape, recipe: Recipe) -> Path:
    """Write a made mesh (glb, ply, obj or stl by the ending) and, beside it, the recipe to remake it; its path.

    Its colours are those on show: of the parts, or of the sources' materials where there are any.
    """
    from shapeforge.collection.meshes import write_mesh

    order = np.argsort(shape.part, kind="stable")
    own = shape.colours if sculptor.session.mesh_colours == "sources" else None
    write_mesh(
        path, shape.vertices, np.asarray(shape.triangles)[order], np.asarray(shape.part)[order], shape.part_names,
        sculptor.session.project.part_inks(shape.part_names), None if own is None else own[order],
    )  # fmt: skip
    latents = sculptor.latents_in_hand(recipe)
    words = {"label": recipe.label, "origin": recipe.origin, "route": recipe.route, "union": recipe.union}
    words |= {
        "colours": sculptor.session.mesh_colours,
        "sliders": {sculptor.names[i]: value for i, value in recipe.sliders.items()},
        "taken": {sculptor.part_names[part]: name for part, name in recipe.taken.items()},
    }
    if sculptor.pinned(recipe):
        words |= _pins_of(sculptor, recipe)
    return write_recipe(path, recipe_of(sculptor.session.project, latents, shape, **words))


def _pins_of(sculptor: Sculptor, recipe: Recipe) -> dict[str, Any]:
    """What is written of pins: where points are held and how far off they are, and the shape that follows them."""
    points, free = sculptor.points(recipe), sculptor.latents_in_hand(replace(recipe, pins={}))
    symmetric, bend = sculptor.symmetric(recipe), sculptor.bend(recipe)
    pins = [
        {
            "part": sculptor.part_names[sculptor.part[point]], "point": point, "at": list(place),
            "off_by": round(off_by(points, point, place), 6),
        }
        for point, place in sculptor.pinned(recipe).items()
    ]  # fmt: skip
    bent = {} if bend is None else {
        "bend": {"centres": bend.centres.tolist(), "heights": bend.heights.tolist(), "width": bend.width},
        "unsymmetric": [name for name, on in zip(sculptor.part_names, symmetric, strict=True) if not on],
    }  # fmt: skip
    return bent | {
        "pins": pins, "unpinned": [[float(x) for x in layer[0]] for layer in free.layers],
        "locked": [sculptor.names[index] for index in sorted(recipe.locked)],
    }  # fmt: skip


def recipe_from(path: Path, sculptor: Sculptor) -> Recipe:
    """The shape of a recipe file, to go on with.  StageError for another file, and for another machine's recipe.

    Its sliders are in the latents already, so all stand in their middle.
    """
    found, project = read_recipe(path), sculptor.session.project
    if (found["machine"], found["fit"]) != (project.machine_id, project.fit_id):
        raise StageError(
            f"{path.name}: is of the machine {found['machine']} of the fit {found['fit']}, and this project has "
            f"{project.machine_id} of {project.fit_id}. Open the project that it was made with."
        )
    exists = np.array([name in found["parts"] for name in sculptor.part_names])
    pins = {int(pin["point"]): as_place(np.array(pin["at"], float)) for pin in found.get("pins", [])}
    layers = tuple(np.array([layer], sculptor.machine.dtype) for layer in found["unpinned" if pins else "hidden"])
    route = found.get("route", "parts")
    # Each part from where the recipe has it: otherwise a wish for one part would move the others.
    taken = {} if route == "surface" else {
        sculptor.part_names.index(part): shape for part, shape in found["sources"].items()
        if shape in sculptor.shape_names
    }  # fmt: skip
    label = found.get("label") or path.name.partition(".")[0]
    return Recipe(
        label, Latents(layers, exists[None]), origin=path.name, taken=taken, route=route,
        union=bool(found.get("union", False)), pins=pins,
        locked=frozenset(i for i, name in enumerate(sculptor.names) if name in found.get("locked", [])),
    )  # fmt: skip
