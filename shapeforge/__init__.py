"""shapeforge: understand a family of 3D shapes.

From meshes and a few labels: groups, parts, point-to-point correspondences, a generative model, new labelled meshes
(Huang, Kalogerakis, Marlin: "Analysis and Synthesis of 3D Shape Families via Deep-Learned Generative Models of
Surfaces", 2015).  The whole pipeline, with ``from shapeforge import last, run``::

    project = shapeforge.Project.create("chairs")
    last(run(project, "import", meshes="meshes"))
    last(run(project, "group"))
    last(run(project, "label", labels="labels", only="exemplars"))
    for stage in ("fit", "learn"): last(run(project, stage))
    last(run(project, "synthesize", count=20, out="new"))

Every stage is an iterator of :class:`Progress`; ``last`` runs it to its end.  The rooms hold the algorithms themselves:
``shapeforge.collection``, ``deformation``, ``generative``, ``synthesis``, ``validation``; the window is
``shapeforge.viewer``, which nothing here loads.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_WHERE = {
    "Project": "shapeforge.store",
    "ProjectError": "shapeforge.store",
    "STAGES": "shapeforge.stages",
    "Progress": "shapeforge.stages",
    "StageError": "shapeforge.stages",
    "run": "shapeforge.stages",
    "status": "shapeforge.stages",
    "next_step": "shapeforge.stages",
    "export": "shapeforge.stages_outputs",
    "apply": "shapeforge.stages_outputs",
    "validate": "shapeforge.stages_validation",
    "last": "shapeforge.collection.iterate",
    "read_mesh": "shapeforge.collection.meshes",
    "prepare_shape": "shapeforge.collection.prepare",
    "fit_templates": "shapeforge.deformation.fit",
    "learn_machine": "shapeforge.generative.learning",
}

__all__ = [*_WHERE, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'shapeforge' has no attribute {name!r}")
    value = getattr(importlib.import_module(_WHERE[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_WHERE})
