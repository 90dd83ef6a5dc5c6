"""Four generated chairs through all stages, as short as they go: made once, copied by every test module that asks."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from shapeforge.collection.families import write_family
from shapeforge.collection.iterate import last
from shapeforge.stages import run
from shapeforge.store import Project

_made: dict[str, Path] = {}


def learned_family(tmp_path_factory: pytest.TempPathFactory, name: str) -> Project:
    """A project of its own, called ``name``: imported, grouped, exemplars labelled, fitted, learned, two new shapes."""
    if "chairs" not in _made:
        folder = tmp_path_factory.mktemp("learned")
        write_family(folder / "truth", "chairs", 4, seed=3, classes=["side", "armchair"], broken=0.0)
        project = Project.create(folder / "chairs")
        last(run(project, "import", meshes=[folder / "truth"], points=300, jobs=1))
        last(run(project, "group", exemplars=["chair_0000", "chair_0001"], jobs=1))
        last(run(project, "label", labels=folder / "truth", only="exemplars", jobs=1))
        last(run(project, "fit", rounds=2, inner=1, jobs=1))
        last(run(project, "learn", epochs=2, jobs=1))
        last(run(project, "synthesize", count=2, jobs=1))
        _made["chairs"] = folder / "chairs"
    copy = tmp_path_factory.mktemp("copied") / "project"
    shutil.copytree(_made["chairs"], copy)
    metadata = copy / "project.json"
    metadata.write_text(metadata.read_text().replace('"name": "chairs"', f'"name": "{name}"'))
    return Project.open(copy)
