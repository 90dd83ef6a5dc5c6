"""A generated family as files: meshes, part labels, landmarks and classes."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path

import numpy as np

from shapeforge.collection.families.assemble import face_records
from shapeforge.collection.families.generated import Generated


def write_family(
    folder: Path | str, family: str, count: int, *, seed: int, broken: float = 0.1, classes: list[str] | None = None
) -> list[Generated]:
    """Generate and write ``<name>.obj``, ``<name>.seg``, labels.json, landmarks.json and classes.csv into ``folder``.

    Label ids count from 1 in the order of the family's part names; labels.json names those that occur.  Returns what
    was written.
    """
    from shapeforge.collection.families import generate

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    made = generate(family, count, seed=seed, broken=broken, classes=classes)
    for one in made:
        _write(folder / f"{one.name}.obj", obj_text(one))
        _write(folder / f"{one.name}.seg", "".join(f"{part + 1}\n" for part in one.faces))
    present = np.unique(np.concatenate([one.faces for one in made])) if made else []
    names = {str(part + 1): made[0].part_names[part] for part in present}
    _write(folder / "labels.json", json.dumps(names, indent=1) + "\n")
    marks = {one.name: {k: [round(float(c), 6) for c in at] for k, at in one.landmarks.items()} for one in made}
    _write(folder / "landmarks.json", json.dumps(marks, indent=1) + "\n")
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(["name", "class"])
    rows.writerows((one.name, one.fine_class) for one in made)
    _write(folder / "classes.csv", table.getvalue())
    return made


def obj_text(generated: Generated) -> str:
    """The shape as Wavefront OBJ; face records in the order of ``generated.faces``."""
    lines = [f"# {generated.name}, metres, y up"]
    lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in generated.mesh.vertices]
    for record in face_records(generated.mesh):
        lines.append("f " + " ".join(str(i) for i in np.asarray(record) + 1))
    return "\n".join(lines) + "\n"


def _write(path: Path, text: str) -> None:
    partial = path.with_name(path.name + ".tmp")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)
