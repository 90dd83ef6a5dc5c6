"""Where rays first meet a mesh: by Embree where ``embreex`` is installed (x86-64), else by our own tree of boxes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from shapeforge.collection import _kernels_rays as kernels
from shapeforge.collection.shape import Mesh
from shapeforge.collection.surface import SearchedMesh, boxes_of

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except ImportError:  # no wheel for this machine
    EmbreeScene = None


def first_hits(
    mesh: Mesh, origins: Float[np.ndarray, "R 3"], directions: Float[np.ndarray, "R 3"], *, embree: bool | None = None
) -> Float[np.ndarray, " R"]:
    """Distance (R,) from each origin along its unit direction to the first triangle, either side of it; inf for none.

    In the mesh's units, to single precision.  ``embree`` chooses the engine; None takes Embree where it is there, and
    the tree of a :class:`SearchedMesh`, which Embree would have to make anew.
    """
    if not len(mesh.triangles):
        return np.full(len(origins), np.inf)
    if embree is None:
        embree = EmbreeScene is not None and not isinstance(mesh, SearchedMesh)
    if not embree:
        corners, tree = boxes_of(mesh)
        return kernels.first_hits(corners, *tree, origins, directions)
    if EmbreeScene is None:
        raise ValueError("embree: wanted the package embreex, but it is not installed")
    corners = mesh.vertices[mesh.triangles[mesh.triangle_areas > 0]].astype(np.float32)
    scene = EmbreeScene()
    TriangleMesh(scene, corners)
    far = scene.run(origins.astype(np.float32), directions.astype(np.float32), query="DISTANCE")
    far = far.astype(np.float64)
    far[far > 1e20] = np.inf  # Embree's own mark of a miss
    return far
