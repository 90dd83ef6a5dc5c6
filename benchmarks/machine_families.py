"""Families that the machine's benchmarks learn from: generated ones with their true correspondences, and a real one."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.true_family import true_family
from shapeforge.collection.iterate import last
from shapeforge.generative.observations import Observations, observe
from shapeforge.stages import run
from shapeforge.stages_model import stacked_positions
from shapeforge.store import Project

CATALOGUES = ("ikea/chairs", "sweethome3d/chairs")
"""Folders of the real chairs, below the folder of the data; the first has labels and classes."""


@dataclass(frozen=True, eq=False)
class Family:
    """What the machine sees of T shapes, and the fine class of each ("" where nobody has said)."""

    observations: Observations
    classes: np.ndarray

    def subset(self, chosen: np.ndarray) -> Family:
        """Some of the shapes, by index."""
        return Family(self.observations.subset(chosen), self.classes[chosen])


def generated(family: str, count: int, *, seed: int, n_points: int) -> Family:
    """``count`` shapes of a generated family with about ``n_points`` true corresponding points."""
    made = true_family(family, count, seed=seed, n_points=n_points)
    return Family(observe(made.positions, made.part, made.part_names), np.array(made.classes))


def real_chairs(data: Path, folder: Path, *, n_points: int) -> Family:
    """Chairs of two catalogues with the correspondences that a fit finds from one painted exemplar of each class.

    The project in ``folder`` is made where it is missing and gone on with where it was stopped.
    """
    meshes = [data / catalogue for catalogue in CATALOGUES]
    with (meshes[0] / "classes.csv").open(newline="") as file:
        classes = {row["name"]: row["class"] for row in csv.DictReader(file)}
    exemplars = [min(name for name, own in classes.items() if own == one) for one in sorted(set(classes.values()))]
    project = Project.open_or_create(folder)
    last(run(project, "import", meshes=meshes, points=n_points, up="y"))
    last(run(project, "group", exemplars=exemplars))
    last(run(project, "label", labels=meshes[0], only="exemplars"))
    last(run(project, "fit"))
    names, top = project.fit_names, project.hierarchy().top
    seen = observe(stacked_positions(project, names), top.label, tuple(top.part_names))
    return Family(seen, np.array([classes.get(name, "") for name in names]))
