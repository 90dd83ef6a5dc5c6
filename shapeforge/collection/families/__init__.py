"""Generated families with known truth: chairs and airplanes as meshes, parts, landmarks and dense correspondence.

The same (family, seed, index) gives the same shape, whatever the count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shapeforge.collection.families import airplanes, chairs
from shapeforge.collection.families.assemble import DAMAGES, assemble, damaged
from shapeforge.collection.families.generated import (
    Generated,
    address_at,
    corner_at,
    corresponding_point,
    nearest_on_mesh,
    position_of,
)

__all__ = [
    "FAMILIES",
    "Generated",
    "address_at",
    "corresponding_point",
    "generate",
    "generate_one",
    "nearest_on_mesh",
    "position_of",
    "write_family",
]

FAMILIES = ("chairs", "airplanes")

_BUILD = {"chairs": (chairs, chairs.build_chair, "chair"), "airplanes": (airplanes, airplanes.build_airplane, "plane")}


def generate(
    family: str, count: int, *, seed: int, broken: float = 0.1, classes: Sequence[str] | None = None
) -> list[Generated]:
    """``count`` shapes of "chairs" or "airplanes", the fine classes taking turns.

    ``broken`` is the share of shapes damaged the way real models are; the parameters of a shape do not depend on it.
    ``classes`` restricts the fine classes (see ``chairs.CLASSES``, ``airplanes.CLASSES``).
    """
    if count < 0:
        raise ValueError(f"count: wanted how many shapes (0 or more), got {count}")
    return [generate_one(family, i, seed=seed, broken=broken, classes=classes) for i in range(count)]


def generate_one(
    family: str, index: int, *, seed: int, broken: float = 0.1, classes: Sequence[str] | None = None
) -> Generated:
    """Shape number ``index`` of the family that ``seed`` stands for."""
    if family not in _BUILD:
        raise ValueError(f"family: wanted one of {', '.join(FAMILIES)}, got {family!r}")
    module, build, stem = _BUILD[family]
    classes = tuple(module.CLASSES if classes is None else classes)
    unknown = [c for c in classes if c not in module.CLASSES]
    if unknown or not classes:
        raise ValueError(f"classes: wanted some of {', '.join(module.CLASSES)}, got {', '.join(unknown) or 'none'}")
    fine_class = classes[index % len(classes)]
    key = [FAMILIES.index(family), seed, index]
    pieces = build(fine_class, np.random.default_rng([*key, 0]))
    rng = np.random.default_rng([*key, 1])
    kinds = ()
    if rng.random() < broken:
        kinds = tuple(str(k) for k in rng.choice(DAMAGES, size=rng.integers(1, 4), replace=False))
    name = f"{stem}_{index:04d}"
    whole = _generated(name, module, fine_class, *assemble(pieces, module.PARTS, module.COMPONENTS))
    landmarks = {}
    for landmark, (component, address) in module.LANDMARKS.items():
        if component in whole.components:
            landmarks[landmark] = corner_at(whole, module.COMPONENTS.index(component), address)
    mesh, part, address = assemble(pieces, module.PARTS, module.COMPONENTS, polygons="polygons" in kinds)
    mesh, part, address = damaged(mesh, part, address, kinds, rng=rng)
    return _generated(name, module, fine_class, mesh, part, address, landmarks, kinds)


def _generated(name, module, fine_class, mesh, part, address, landmarks=None, damage=()) -> Generated:
    return Generated(
        name, mesh, part, module.PARTS, fine_class, landmarks or {}, address, module.COMPONENTS, tuple(damage)
    )


from shapeforge.collection.families.write import write_family  # noqa: E402  (it needs generate)
