"""Generated shapes with more or fewer copies of a part than their class has: a fifth leg, an engine less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shapeforge.collection.families.assemble import _kept
from shapeforge.collection.families.generated import Generated
from shapeforge.collection.families.solids import Vector
from shapeforge.collection.shape import Mesh


def with_copy(generated: Generated, components: Sequence[str], move: Vector) -> Generated:
    """The shape with its ``components`` once more, moved by ``move`` (metres), as further components "<name> again".

    Its component names are its own then: it does not correspond to the rest of its family any more.
    """
    mesh, address = generated.mesh, generated.address
    chosen = np.flatnonzero(np.isin(address[:, 0, 0].astype(int), _numbers(generated, components)))
    corners, place = np.unique(mesh.triangles[chosen], return_inverse=True)
    faces, face = np.unique(mesh.face_of_triangle[chosen], return_inverse=True)
    triangles = place.reshape(-1, 3) + len(mesh.vertices)
    again, first = address[chosen].copy(), len(generated.component_names)
    for n, number in enumerate(_numbers(generated, components)):
        again[..., 0][address[chosen][..., 0].astype(int) == number] = first + n
    bigger = Mesh(
        np.concatenate([mesh.vertices, mesh.vertices[corners] + np.asarray(move, float)]),
        np.concatenate([mesh.triangles, triangles]),
        np.concatenate([mesh.face_of_triangle, face.reshape(-1) + mesh.n_faces]), mesh.n_faces + len(faces),
    )  # fmt: skip
    return replace(
        generated, mesh=bigger, faces=np.concatenate([generated.faces, generated.faces[faces]]),
        address=np.concatenate([address, again]),
        component_names=(*generated.component_names, *(f"{name} again" for name in components)),
    )  # fmt: skip


def without_components(generated: Generated, components: Sequence[str]) -> Generated:
    """The shape with these components left out; landmarks on them stay."""
    mesh, address = generated.mesh, generated.address
    gone = np.zeros(mesh.n_faces, bool)
    gone[mesh.face_of_triangle[np.isin(address[:, 0, 0].astype(int), _numbers(generated, components))]] = True
    triangles, face, part, address = _kept(~gone, mesh.triangles, mesh.face_of_triangle, generated.faces, address)
    return replace(generated, mesh=Mesh(mesh.vertices, triangles, face, len(part)), faces=part, address=address)


def _numbers(generated: Generated, components: Sequence[str]) -> list[int]:
    missing = [name for name in components if name not in generated.components]
    if missing or not components:
        raise ValueError(
            f"components: wanted some of {', '.join(generated.components)}, got {', '.join(missing) or 'none'}"
        )
    return [generated.component_names.index(name) for name in components]
