"""Pieces: convex components stay whole, tall posts and lumps fall apart into patches, crumbs follow their patch."""

from __future__ import annotations

import numpy as np
import trimesh

from shapeforge.collection.prepare import prepare_shape
from shapeforge.collection.shape import Mesh, Shape
from shapeforge.deformation.pieces import box_frame, convexity, face_components, find_pieces, piece_looks
from shapeforge.deformation.voting import exposure


def mesh_of(*boxes: trimesh.Trimesh) -> Mesh:
    """The boxes side by side in one mesh, each its own component."""
    vertices, triangles, start = [], [], 0
    for box in boxes:
        vertices.append(np.asarray(box.vertices))
        triangles.append(np.asarray(box.faces) + start)
        start += len(box.vertices)
    faces = np.concatenate(triangles).astype(np.int64)
    return Mesh(np.concatenate(vertices).astype(np.float64), faces, np.arange(len(faces)), len(faces))


def box(size: tuple[float, float, float], centre: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre))


def shape_of(*boxes: trimesh.Trimesh) -> Shape:
    return prepare_shape("thing", mesh_of(*boxes), n_points=1500, up="y", rng=np.random.default_rng(0))


def test_components_of_faces_follow_the_edges():
    found = face_components(mesh_of(box((1, 1, 1), (0, 0, 0)), box((1, 1, 1), (3, 0, 0))))
    assert len(set(found[:12].tolist())) == 1 and len(set(found[12:].tolist())) == 1 and found[0] != found[12]


def test_components_stay_two_beside_vertices_that_no_face_uses():
    boxes = mesh_of(box((1, 1, 1), (0, 0, 0)), box((1, 1, 1), (3, 0, 0)))
    stray = Mesh(np.concatenate([boxes.vertices, [[1e6, 0, 0]]]), boxes.triangles, boxes.face_of_triangle, 24)
    np.testing.assert_array_equal(face_components(stray), face_components(boxes))


def test_a_board_is_one_piece_and_a_floor_to_top_post_is_not():
    seat, post = box((1, 0.1, 1), (0, 0.5, 0)), box((0.2, 1.4, 0.2), (0, 0.6, -0.4))
    shape = shape_of(seat, post)
    piece, whole = find_pieces(shape)
    on_seat = shape.face_of_point < 12
    assert len(np.unique(piece[on_seat])) == 1 and whole[piece[on_seat][0]]
    assert not whole[np.unique(piece[~on_seat])].any()
    assert len(whole) == piece.max() + 1 and (np.bincount(piece) > 0).all()


def test_a_lump_falls_into_its_patches():
    """Seat and back that share an edge are one component, but no convex thing."""
    shape = shape_of(box((1, 0.1, 1), (0, 0, 0)), box((1, 0.6, 0.1), (0, 0.35, -0.45)), box((1, 0.1, 1), (0, -2, 0)))
    assert len(set(face_components(shape.mesh).tolist())) == 2
    piece, whole = find_pieces(shape)
    lump = shape.face_of_point < 24
    assert len(np.unique(piece[lump])) >= 2 and not whole[piece[lump]].any()
    assert whole[piece[~lump]].all()


def test_convexity_tells_a_ball_from_a_corner():
    ball = trimesh.creation.icosphere(2)
    points, face = trimesh.sample.sample_surface(ball, 300, seed=0)
    assert convexity(np.asarray(points), np.asarray(ball.face_normals[face])) == 1.0
    # two walls that face each other's front: half of the pairs see each other across the corner
    rng = np.random.default_rng(0)
    floor, wall = rng.random((100, 3)) * [1, 0, 1], rng.random((100, 3)) * [0, 1, 1]
    normals = np.repeat([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], 100, axis=0)
    assert convexity(np.concatenate([floor, wall]), normals) < 0.6


def test_box_frame_maps_box_onto_box():
    rng = np.random.default_rng(1)
    points, target = rng.random((50, 3)) * [1, 2, 1], rng.random((60, 3)) * [2, 2, 1] + 5
    moved = box_frame(points, target)(points)
    assert np.allclose(moved.min(axis=0), target.min(axis=0)) and np.allclose(moved.max(axis=0), target.max(axis=0))


def test_legs_are_four_and_long_and_a_top_is_alone_flat_and_open_above():
    """By itself a leg is told from a top, a beam and a fifth, thicker leg."""
    legs = [box((0.06, 0.5, 0.06), (x, 0.25, z)) for x in (-0.5, 0.5) for z in (-0.5, 0.5)]
    top, beam, thick = (
        box((1.4, 0.05, 1.4), (0, 0.6, 0)),
        box((0.8, 0.06, 0.06), (0, 0.3, 0)),
        box((0.15, 0.5, 0.15), (0, 0.25, 0.3)),
    )
    shape = shape_of(*legs, top, beam, thick)
    thing = shape.face_of_point // 12
    copies, long, flat, above, below = piece_looks(shape, thing, exposure(shape)).T
    assert np.array_equal(copies, [2, 2, 2, 2, 0, 0, 0])
    assert (long[[0, 1, 2, 3, 5]] > 0.8).all() and 0.5 < long[6] < long[5] and long[4] < 0.1
    assert flat[4] > 0.9 and (np.delete(flat, 4) < 0.1).all()
    assert above[4] == 1 and (np.delete(above, 4) == 0).all()  # though the top's underside sees nothing above
    assert (below > 0.3).all() and (below < 0.7).all()


def test_a_leg_that_lies_is_a_copy_of_one_that_stands():
    """Blades of a propeller, spokes of a foot: copies may be turned."""
    shape = shape_of(*(box(tuple(np.roll([0.6, 0.06, 0.1], turn)), (turn, 0, 0)) for turn in range(3)))
    copies = piece_looks(shape, shape.face_of_point // 12, exposure(shape))[:, 0]
    assert np.allclose(copies, np.log2(3))
