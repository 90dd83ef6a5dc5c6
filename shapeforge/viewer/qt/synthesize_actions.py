"""What can be done in the Synthesize place: its rows of the table of actions, and the files it writes and reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from shapeforge.viewer.actions import YES, Action, Verdict
from shapeforge.viewer.display import View
from shapeforge.viewer.pictures import take_picture
from shapeforge.viewer.sculptor_files import export_mesh, recipe_from

PICTURE_HEIGHT = 1200  # pixels


def add_actions(place: Any) -> None:
    """Add the place's actions to the window's table."""

    def add(
        name: str, text: str, run: Callable[[], None], key: str, tooltip: str, icon: str, enabled: Any = None
    ) -> None:
        verdict = enabled or (lambda session: ready(place))
        place.actions.add(Action(name, text, lambda _s: run(), verdict, key, tooltip, icon, "synthesize"))

    def made(session: Any) -> Verdict:
        return can_export(place)

    add("mean_shape", "Mean", place.take_mean, "", "The middle of the family", "fit")
    add("random_shape", "Random", place.draws.take, "R", "A shape drawn from what was learned", "dice")
    add("from_shape", "From shape…", place.choose_shape, "", "Start from a shape of the family, or from a recipe",
        "cube")  # fmt: skip
    add("between", "Between A and B", place.between.toggle, "B", "A shape on the way from one to another", "between")
    add("reset_sliders", "Reset", place.reset, "",
        "All sliders that are not locked back to the shape by itself; all pins away", "",
        lambda session: can_reset(place))  # fmt: skip
    add("unpin", "Take a pin away", place.handles.unpin_newest, "Del", "The pin under the pointer, else the newest",
        "pin", lambda session: can_unpin(place))  # fmt: skip
    add("unpin_all", "Take all away", place.handles.unpin_all, "Shift+Del", "The shape as the sliders make it", "",
        lambda session: can_unpin(place))  # fmt: skip
    add("reset_parts", "Reset", place.reset_parts, "", "The parts that the shape has by itself", "",
        lambda session: can_reset_parts(place))  # fmt: skip
    add("export_mesh", "Export mesh…", lambda: save_mesh(place), "Ctrl+E",
        "glb, ply, obj or stl, with part names and a recipe", "export", made)  # fmt: skip
    add("gallery", "Gallery", lambda: place.shows.show_gallery(True), "G", "A dozen draws to choose from", "grid")
    add("spin", "Turn around", place.shows.toggle_spin, "T", "Turns by itself; again to stop", "rotate")
    add("export_movie", "Export movie…", place.shows.export_movie, "", "One turn: gif, webp or png", "play", made)
    add("export_picture", "Save picture of the shape…", lambda: save_picture(place), "",
        "A picture of the shape as it is seen now: png, jpg or webp", "camera")  # fmt: skip
    add("open_recipe", "From a recipe…", lambda: open_recipe(place), "",
        "A shape that was exported from this project: .recipe.json", "folder")  # fmt: skip
    add("home_synthesize", "Look from the front", lambda: place.view.fit(), "Home", "The usual view", "home")


def ready(place: Any) -> Verdict:
    """A machine has been learnt."""
    return YES if place.sculptor.has_machine else (False, "Learn the family first.")


def can_export(place: Any) -> Verdict:
    """The final mesh is there."""
    if not place.sculptor.has_machine:
        return ready(place)
    return YES if place.made is not None else (False, place.problem or "The mesh is being made.")


def can_reset_parts(place: Any) -> Verdict:
    """A part has been switched."""
    if not place.sculptor.has_machine:
        return ready(place)
    return YES if place.session.parts_on else (False, "No part has been switched.")


def can_reset(place: Any) -> Verdict:
    """A slider that is not locked has been moved, or a point pinned."""
    if not place.sculptor.has_machine:
        return ready(place)
    moved = any(value for index, value in place.session.sliders.items() if index not in place.session.locked)
    return YES if moved or place.session.pins else (False, "No free slider has been moved, and nothing is pinned.")


def can_unpin(place: Any) -> Verdict:
    """A point is pinned."""
    if not place.sculptor.has_machine:
        return ready(place)
    return YES if place.session.pins else (False, "Nothing is pinned.")


def save_mesh(place: Any) -> None:
    """Ask where, and write the mesh and its recipe."""
    path = place.actions.desk.choose_save("Export the mesh (glb, ply, obj or stl)", f"{file_name(place)}.glb")
    if path is None or place.made is None:
        return
    if not path.suffix:
        path = path.with_suffix(".glb")
    export_mesh(path, place.sculptor, place.made.shape, place.sculptor.recipe)
    place.session.say(f"Saved {path.name} and its recipe", "ok")


def save_picture(place: Any) -> None:
    """Ask where, and write a picture of what is shown, from where it is looked at, without marks and words."""
    from shapeforge.collection.mesh_files import write_atomically
    from shapeforge.viewer.qt.thumbnails import beside_qt

    path = place.actions.desk.choose_save("Save a picture (png, jpg or webp)", f"{file_name(place)}.png")
    if path is None:
        return
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg", ".webp"):
        path = path.with_suffix(".png")
    camera, (_, _, width, height) = place.view.scene.camera, place.view.rectangles()[0]
    focus = tuple(float(x) for x in camera.GetFocalPoint())
    away = tuple(float(x) for x in np.array(camera.GetPosition()) - focus)
    shown, theme, scale = place.view.shown.views[0], place.session.theme, float(camera.GetParallelScale())
    size = round(PICTURE_HEIGHT * width / height), PICTURE_HEIGHT
    view = View(shown.layers, ground=shown.ground)
    picture = beside_qt(lambda: take_picture(view, size, theme, camera=(focus, scale, away)))
    write_atomically(path, encoded(picture, path))
    place.session.say(f"Saved {path.name}", "ok")


def encoded(picture: np.ndarray, path: Path) -> bytes:
    """A picture as the bytes of a file with this ending."""
    import io

    buffer = io.BytesIO()
    kind = {".png": "PNG", ".webp": "WEBP"}.get(path.suffix.lower(), "JPEG")
    Image.fromarray(picture).save(buffer, kind, quality=92)
    return buffer.getvalue()


def open_recipe(place: Any) -> None:
    """Ask which, and take up the shape of a recipe."""
    found = place.actions.desk.choose_files("Open a recipe", ("recipe.json", "json"))
    if found:
        place.take_up(recipe_from(found[0], place.sculptor))


def file_name(place: Any) -> str:
    """The label of the shape in hand as the name of a file."""
    label = place.sculptor.recipe.label
    return "".join(letter if letter.isalnum() or letter in " -–_.+−%" else "_" for letter in label).strip() or "shape"
