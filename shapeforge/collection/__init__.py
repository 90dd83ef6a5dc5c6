"""What is known of the shapes before any model: §3 and the clustering of §4.

A mesh file becomes a ``Mesh`` (``meshes``: face k is its k-th face record), the mesh a ``Shape`` (``prepare``: turned y
up by ``orient``, bounding-box diagonal 1, sampled by ``points``, described by ``descriptors``, cut into ``patches``).
``labels`` reads and writes which part each face belongs to, ``facecut`` cuts a surface into parts by costs of its
faces, ``align`` and ``symmetry`` compare shapes with each other and with their mirror image, ``groups`` finds groups
and exemplars, and ``families`` generates shapes whose truth is known.

>>> mesh = read_mesh("chair.obj")                                            # doctest: +SKIP
>>> shape = prepare_shape("chair", mesh, rng=np.random.default_rng(0))       # doctest: +SKIP
>>> labels = read_seg("chair.seg", mesh.n_faces, find_part_names("chairs"))  # doctest: +SKIP

Names are loaded when first used: the nouns alone need no compiler.
"""

from __future__ import annotations

import importlib
from typing import Any

_WHERE = {
    "Frame": "shape",
    "Mesh": "shape",
    "Shape": "shape",
    "Shapes": "shape",
    "last": "iterate",
    "MeshError": "meshes",
    "find_meshes": "meshes",
    "read_mesh": "meshes",
    "repair_notes": "meshes",
    "write_mesh": "meshes",
    "UNLABELLED": "labels",
    "LabelError": "labels",
    "PartNames": "labels",
    "find_part_names": "labels",
    "read_part_names": "labels",
    "read_seg": "labels",
    "write_part_names": "labels",
    "write_seg": "labels",
    "nearest_neighbours": "points",
    "sample_points": "points",
    "DESCRIPTOR_NAMES": "descriptors",
    "describe": "descriptors",
    "find_patches": "patches",
    "patch_neighbours": "patches",
    "prepare_shape": "prepare",
    "cut_faces": "facecut",
    "Alignment": "align",
    "affine_align": "align",
    "dissimilarity": "align",
    "symmetry_plane": "symmetry",
    "GroupState": "groups",
    "Groups": "groups",
    "group_shapes": "groups",
}

__all__ = [*_WHERE]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_WHERE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_WHERE})
