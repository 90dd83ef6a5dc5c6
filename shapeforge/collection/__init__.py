"""What is known of the shapes before any model: §3 and the clustering of §4.

A mesh file becomes a ``Mesh`` (``meshes``: face k is its k-th face record), the mesh a ``Shape`` (``prepare``: turned y
up by ``orient``, bounding-box diagonal 1, sampled by ``points``, described by ``descriptors``, cut into ``patches``).
``labels`` reads and writes which part each face belongs to.

>>> mesh = read_mesh("chair.obj")                                            # doctest: +SKIP
>>> shape = prepare_shape("chair", mesh, rng=np.random.default_rng(0))       # doctest: +SKIP
>>> labels = read_seg("chair.seg", mesh.n_faces, find_part_names("chairs"))  # doctest: +SKIP
"""

from shapeforge.collection.descriptors import DESCRIPTOR_NAMES, describe
from shapeforge.collection.iterate import last
from shapeforge.collection.labels import (
    UNLABELLED,
    FaceLabels,
    LabelError,
    PartNames,
    find_part_names,
    read_part_names,
    read_seg,
    write_part_names,
    write_seg,
)
from shapeforge.collection.meshes import MeshError, find_meshes, read_mesh, repair_notes, write_mesh
from shapeforge.collection.patches import find_patches, patch_neighbours
from shapeforge.collection.points import nearest_neighbours, sample_points
from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Frame, Mesh, Shape, Shapes

__all__ = [
    "DESCRIPTOR_NAMES",
    "UNLABELLED",
    "FaceLabels",
    "Frame",
    "LabelError",
    "Mesh",
    "MeshError",
    "PartNames",
    "Shape",
    "Shapes",
    "describe",
    "find_meshes",
    "find_part_names",
    "find_patches",
    "last",
    "nearest_neighbours",
    "patch_neighbours",
    "prepare_shape",
    "read_mesh",
    "read_part_names",
    "read_seg",
    "repair_notes",
    "sample_points",
    "write_mesh",
    "write_part_names",
    "write_seg",
]
