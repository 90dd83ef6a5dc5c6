"""Strokes, their history, and the faces that tools touch."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shapeforge.collection.shape import Mesh
from shapeforge.viewer.brushes import (
    along,
    face_surface,
    mirrored,
    shares,
    through,
    unpainted_pieces,
    up_to_creases,
    whole_piece,
)  # fmt: skip
from shapeforge.viewer.painting import PaintState, paint_state
from shapeforge.viewer.part_table import plain_table

FOUR = plain_table(4)


def quads(vertices: np.ndarray, faces: list[tuple[int, ...]]) -> Mesh:
    """A mesh of polygon records, fanned into triangles."""
    triangles, record = [], []
    for k, face in enumerate(faces):
        for i in range(1, len(face) - 1):
            triangles.append((face[0], face[i], face[i + 1]))
            record.append(k)
    return Mesh(vertices.astype(float), np.array(triangles), np.array(record), len(faces))


def sheet(n: int, *, lift: float = 0.0, soup: bool = False) -> Mesh:
    """n x n quads over the unit square (x, z), the right half sloping by ``lift``; soup: no shared corners."""
    x, z = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    y = lift * np.maximum(x - 0.5, 0)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    corners = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=-1).reshape(-1, 4)
    if soup:
        vertices, corners = vertices[corners].reshape(-1, 3), np.arange(corners.size).reshape(-1, 4)
    triangles = np.stack([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    return Mesh(vertices, triangles, np.repeat(np.arange(len(corners)), 2), len(corners))


def joined(a: Mesh, b: Mesh) -> Mesh:
    return Mesh(
        np.vstack([a.vertices, b.vertices]),
        np.vstack([a.triangles, b.triangles + len(a.vertices)]),
        np.r_[a.face_of_triangle, b.face_of_triangle + a.n_faces],
        a.n_faces + b.n_faces,
    )


edits = st.lists(
    st.one_of(
        st.tuples(st.just("stroke"), st.lists(st.integers(0, 19), max_size=8), st.integers(-1, 3)),
        st.tuples(st.just("undo"), st.just([]), st.just(0)),
        st.tuples(st.just("redo"), st.just([]), st.just(0)),
    ),
    max_size=25,
)


@settings(deadline=None)
@given(start=st.lists(st.integers(-1, 3), min_size=20, max_size=20), steps=edits)
def test_undoing_everything_gives_back_the_start_and_redoing_everything_the_end(start, steps):
    state = PaintState(np.array(start, np.int32), FOUR)
    for kind, faces, part in steps:
        if kind == "stroke":
            state.begin("brush", "x")
            for face in faces:  # several dabs, one drag
                state.paint(np.array([face]), part)
            state.end()
        else:
            getattr(state, kind)()
    while state.redo_label is not None:
        state.redo()
    end = state.labels.copy()
    count = 0
    while state.undo_label is not None:
        state.undo()
        count += 1
    assert count == len(state.strokes)
    assert state.labels.tolist() == start
    state.go_to(count)
    assert np.array_equal(state.labels, end)


@settings(deadline=None)
@given(steps=edits, back=st.integers(0, 5))
def test_a_kept_history_comes_back_as_it_was(steps, back):
    state = PaintState(np.full(20, -1, np.int32), FOUR)
    for kind, faces, part in steps:
        if kind == "stroke":
            state.stroke("fill", "x", np.unique(faces).astype(int), part)
    state.go_to(state.done - back)
    again = paint_state(20, state.labels, state.to_record(), FOUR)
    assert again.done == state.done and len(again.strokes) == len(state.strokes)
    for count in range(len(state.strokes) + 1):
        assert np.array_equal(again.labels_after(count), state.labels_after(count))


def test_a_history_of_other_labels_is_left_out():
    state = PaintState(np.full(6, -1, np.int32), FOUR)
    state.stroke("brush", "back", np.array([1, 2]), 0)
    record = state.to_record()
    assert paint_state(6, np.full(6, 2, np.int32), record, FOUR).undo_label is None
    assert paint_state(6, state.labels, record, FOUR).undo_label == "back"
    damaged = {**record, "faces": record["faces"][:1]}
    assert paint_state(6, state.labels, damaged, FOUR).undo_label is None
    outside = {**record, "faces": record["faces"] + 100}
    assert paint_state(6, state.labels, outside, FOUR).undo_label is None


def test_one_drag_is_one_item_and_an_empty_one_none():
    state = PaintState(np.full(9, -1, np.int32), FOUR)
    state.begin("brush", "seat")
    assert state.paint(np.array([0, 1]), 1).tolist() == [0, 1]
    assert state.paint(np.array([1, 2]), 1).tolist() == [2]
    state.end()
    state.begin("brush", "seat")
    state.paint(np.array([0]), 1)
    assert state.end() is None
    assert [s.faces.tolist() for s in state.strokes] == [[0, 1, 2]]
    state.undo()
    state.stroke("brush", "leg", np.array([5]), 2)
    assert state.redo_label is None and len(state.strokes) == 1, "a new stroke forgets what had been undone"


def test_labels_cannot_be_written_behind_the_history():
    state = PaintState(np.zeros(3, np.int32), FOUR)
    with pytest.raises(ValueError, match="read-only"):
        state.labels[0] = 5


def test_parts_joined_and_removed_count_so_through_the_history():
    state = PaintState(np.array([-1, 0, 1, 2], np.int32), FOUR)
    state.stroke("brush", "x", np.array([0]), 2)
    state.set_table(FOUR.without(2, kept=0))
    assert state.labels.tolist() == [0, 0, 1, 0]
    state.undo()
    assert state.labels.tolist() == [-1, 0, 1, 0]
    state.redo()
    state.stroke("brush", "x", np.array([2]), 0)  # painted as the part that is left: that it stays
    state.set_table(FOUR)
    assert state.labels.tolist() == [2, 0, 0, 2]
    state.set_table(FOUR.without(0))
    assert state.labels.tolist() == [1, -1, -1, 1]
    assert state.labels_after(0).tolist() == [-1, -1, 0, 1]


def test_the_brush_goes_along_the_surface_and_through_goes_through():
    lower, upper = sheet(20), sheet(20)
    both = joined(lower, upper.moved(upper.vertices + [0, 0.02, 0]))
    surface = face_surface(both)
    position = np.array([0.525, 0.0, 0.525])
    face = 10 * 20 + 10
    near = along(surface, face, position, 0.11)
    assert (near < 400).all() and face in near
    distance = np.linalg.norm(surface.centres[near] - position, axis=1)
    assert distance.max() <= 0.11
    inside = np.flatnonzero(np.linalg.norm(surface.centres - position, axis=1) <= 0.05)
    assert np.isin(inside[inside < 400], near).all()
    assert (through(surface, face, position, 0.11) >= 400).any()


def test_soup_hangs_together_by_coincident_corners():
    whole, soup = face_surface(sheet(12)), face_surface(sheet(12, soup=True))
    assert whole.piece.max() == soup.piece.max() == 0
    position = whole.centres[70]
    assert set(along(whole, 70, position, 0.2)) == set(along(soup, 70, position, 0.2))


def test_a_brush_on_a_face_larger_than_itself_paints_that_face():
    surface = face_surface(sheet(2))
    assert along(surface, 3, np.array([0.9, 0, 0.9]), 0.01).tolist() == [3]


def test_fill_stops_at_creases_and_piece_at_gaps():
    bent = sheet(10, lift=1.2)
    surface = face_surface(bent)
    left = np.flatnonzero(surface.centres[:, 0] < 0.5)
    assert up_to_creases(surface, int(left[0])).tolist() == left.tolist()
    gentle = face_surface(sheet(10, lift=0.2))
    assert len(up_to_creases(gentle, 0)) == 100
    both = joined(sheet(4), sheet(4).moved(sheet(4).vertices + [3, 0, 0]))
    assert whole_piece(face_surface(both), 20).tolist() == list(range(16, 32))


def test_the_mirror_twin_lies_opposite_or_nowhere():
    surface = face_surface(sheet(10))
    normal, offset = np.array([1.0, 0, 0]), 0.5
    twin = mirrored(surface, surface.centres[12], normal, offset)
    assert twin is not None and twin[0] == 82 and np.allclose(twin[1], surface.centres[82])
    assert mirrored(surface, np.array([-2.0, 0, 0]), normal, offset) is None


def test_unpainted_regions_largest_first_and_shares_by_area():
    surface = face_surface(sheet(10))
    labels = np.full(100, -1, np.int32)
    labels[30:40] = 0
    pieces = unpainted_pieces(surface, labels)
    assert [len(p) for p in pieces] == [60, 30]
    assert pieces[1].tolist() == list(range(30))
    assert np.allclose(shares(surface, labels, 2), [0.1, 0])
    assert unpainted_pieces(surface, np.zeros(100, np.int32)) == []


def test_records_without_triangles_are_harmless():
    mesh = quads(np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]), [(0, 1, 2, 3)])
    mesh = Mesh(mesh.vertices, mesh.triangles, mesh.face_of_triangle, 3)
    surface = face_surface(mesh)
    assert surface.n_faces == 3 and along(surface, 0, np.zeros(3), 0.1).tolist() == [0]


def test_the_brush_is_fast_on_a_large_mesh():
    mesh = sheet(320, soup=True)
    surface = face_surface(mesh)
    position = surface.centres[51360]
    along(surface, 51360, position, 0.034)
    times = []
    for _ in range(9):
        begin = time.perf_counter()
        found = along(surface, 51360, position, 0.034)
        times.append(time.perf_counter() - begin)
    assert len(found) > 100
    assert min(times) < 0.005
