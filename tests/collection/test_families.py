"""The generated families: same seed same shape, closed and symmetric surfaces, truth that is true."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from shapeforge.collection.families import (
    FAMILIES,
    address_at,
    airplanes,
    chairs,
    corresponding_point,
    generate,
    generate_one,
    nearest_on_mesh,
    position_of,
    write_family,
)
from shapeforge.collection.families.assemble import DAMAGES, assemble, damaged, face_records
from shapeforge.collection.families.solids import signed_volume, square_ring, squircle, sweep, unsquircle


@pytest.fixture(scope="module")
def families():
    return {family: generate(family, 20, seed=5, broken=0.0) for family in FAMILIES}


def diagonal(shape):
    return float(np.linalg.norm(np.ptp(shape.mesh.vertices, axis=0)))


def edges(triangles):
    """Directed edges (3 N, 2)."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


@pytest.mark.parametrize("family", FAMILIES)
def test_a_shape_depends_on_family_seed_and_index_only(family):
    few, many = generate(family, 2, seed=9), generate(family, 4, seed=9)
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)
    other = generate_one(family, 0, seed=10).mesh.vertices
    assert other.shape != few[0].mesh.vertices.shape or not np.allclose(other, few[0].mesh.vertices)


@pytest.mark.parametrize("family", FAMILIES)
def test_damage_leaves_parameters_and_landmarks_alone(family):
    whole, broken = (generate(family, 6, seed=2, broken=share) for share in (0.0, 1.0))
    for a, b in zip(whole, broken, strict=True):
        assert not a.damage and b.damage
        assert a.landmarks.keys() == b.landmarks.keys()
        for name in a.landmarks:
            np.testing.assert_array_equal(a.landmarks[name], b.landmarks[name])


def test_share_of_broken_shapes():
    broken = sum(bool(shape.damage) for shape in generate("airplanes", 60, seed=1, broken=0.3))
    assert 8 <= broken <= 30


@pytest.mark.parametrize("family", FAMILIES)
def test_surfaces_are_closed_and_wind_outward(families, family):
    for shape in families[family]:
        directed = edges(shape.mesh.triangles)
        forth = {tuple(e) for e in directed.tolist()}
        assert len(forth) == len(directed), f"{shape.name}: an edge is used twice in the same direction"
        assert all((b, a) in forth for a, b in forth), f"{shape.name}: open edges"
        a, b, c = (shape.mesh.vertices[shape.mesh.triangles[:, i]] for i in range(3))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
        for component in np.unique(shape.address[:, 0, 0]):
            assert volume[shape.address[:, 0, 0] == component].sum() > 0, shape.component_names[int(component)]


@pytest.mark.parametrize("family", FAMILIES)
def test_left_mirrors_right(families, family):
    for shape in families[family]:
        tree = cKDTree(shape.mesh.vertices)
        off, _ = tree.query(shape.mesh.vertices * [-1, 1, 1])
        assert off.max() < 1e-6 * diagonal(shape), shape.name
        for name, at in shape.landmarks.items():
            if name.endswith("left"):
                twin = shape.landmarks[name[: -len("left")] + "right"]
                assert at[0] > 0
                np.testing.assert_allclose(at * [-1, 1, 1], twin, atol=2e-3 * diagonal(shape), err_msg=name)


@pytest.mark.parametrize("family", FAMILIES)
def test_size_and_faces(families, family):
    for shape in families[family]:
        assert 500 <= shape.mesh.n_faces <= 7500, (shape.name, shape.mesh.n_faces)
        assert np.isfinite(shape.mesh.vertices).all()
        assert np.median(shape.mesh.triangle_areas) > 0
        assert (shape.mesh.triangle_areas > 1e-12 * diagonal(shape) ** 2).mean() > 0.99


def test_classes_have_the_parts_that_make_them(families):
    wanted = {
        "side": ({"back", "seat", "leg"}, {"arm", "column", "base"}),
        "armchair": ({"back", "seat", "leg", "arm"}, {"column", "base"}),
        "bench": ({"seat", "leg"}, {"column", "base"}),
        "stool": ({"seat"}, {"back", "arm"}),
        "swivel": ({"back", "seat", "column", "base"}, {"leg"}),
        "airliner": ({"fuselage", "wing", "tailplane", "fin", "engine"}, set()),
        "fighter": ({"fuselage", "wing", "fin", "engine"}, set()),
        "propeller": ({"fuselage", "wing", "tailplane", "engine"}, set()),
        "glider": ({"fuselage", "wing", "tailplane"}, {"engine"}),
    }
    seen = set()
    for shape in [*families["chairs"], *families["airplanes"]]:
        present = {shape.part_names[i] for i in np.unique(shape.faces)}
        needed, forbidden = wanted[shape.fine_class]
        assert needed <= present and not forbidden & present, (shape.name, present)
        seen.add(shape.fine_class)
    assert seen == set(wanted)


def test_chairs_stand_on_the_floor_and_face_forward(families):
    for shape in families["chairs"]:
        marks = shape.landmarks
        assert -1e-3 < shape.mesh.vertices[:, 1].min() < 1e-3
        if shape.fine_class != "swivel" and "leg_tip_front_left" in marks:
            assert abs(marks["leg_tip_front_left"][1]) < 1e-6
        assert marks["seat_front_left"][2] > 0 > marks["seat_rear_left"][2]
        if "back_top_middle" in marks:
            assert marks["back_top_middle"][2] < marks["seat_centre"][2]
            assert marks["back_top_middle"][1] > marks["seat_centre"][1] + 0.2


def test_airplanes_fly_forward(families):
    for shape in families["airplanes"]:
        marks, vertices = shape.landmarks, shape.mesh.vertices
        assert marks["nose"][2] > 0.8 * vertices[:, 2].max() and marks["tail"][2] < 0
        assert marks["wing_tip_left"][0] > 0.95 * vertices[:, 0].max()
        assert "fin_tip" not in marks or marks["fin_tip"][1] > 0.5 * vertices[:, 1].max()


@pytest.mark.parametrize("family", FAMILIES)
def test_addresses_are_in_the_cube_and_parts_agree_with_components(families, family):
    part_of = {}
    for shape in families[family]:
        assert shape.address.shape == (len(shape.mesh.triangles), 3, 5)
        assert shape.address[..., 1:4].min() >= 0 and shape.address[..., 1:4].max() <= 1
        part = shape.faces[shape.mesh.face_of_triangle]
        for component in np.unique(shape.address[:, 0, 0]):
            parts = np.unique(part[shape.address[:, 0, 0] == component])
            assert len(parts) == 1
            assert part_of.setdefault(component, parts[0]) == parts[0]


@pytest.mark.parametrize("family", FAMILIES)
def test_a_shape_corresponds_to_itself(families, family):
    rng = np.random.default_rng(0)
    for shape in families[family][:5]:
        share = shape.mesh.triangle_areas / shape.mesh.triangle_areas.sum()
        triangle = rng.choice(len(shape.mesh.triangles), 300, p=share)
        weights = rng.dirichlet(np.ones(3), 300)
        component, address = address_at(shape, triangle, weights)
        points = np.einsum("nc,ncd->nd", weights, shape.mesh.vertices[shape.mesh.triangles[triangle]])
        off = np.full(300, np.nan)
        for one in np.unique(component):
            chosen = component == one
            found, distance = position_of(shape, int(one), address[chosen])
            off[chosen] = np.linalg.norm(found - points[chosen], axis=1)
            assert distance.max() < 0.05
        # slats and spindles overlap their rails: there one address is two places a plank's thickness apart
        assert np.median(off) < 0.004 * diagonal(shape)
        assert np.quantile(off, 0.97) < 0.02 * diagonal(shape)


@pytest.mark.parametrize("family", FAMILIES)
def test_landmarks_correspond_across_shapes(families, family):
    off, missing, compared = [], 0, 0
    for a in families[family][:8]:
        for b in families[family][:8]:
            common = sorted(set(a.landmarks) & set(b.landmarks))
            found = corresponding_point(a, np.stack([a.landmarks[k] for k in common]), b)
            apart = np.linalg.norm(found - np.stack([b.landmarks[k] for k in common]), axis=1) / diagonal(b)
            missing += int(np.isnan(apart).sum())
            compared += len(apart)
            off.append(apart[~np.isnan(apart)])
    off = np.concatenate(off)
    assert missing < 0.05 * compared
    assert np.median(off) < 0.01
    assert (off < 0.05).mean() > 0.9


def test_absent_components_have_no_corresponding_point(families):
    with_arms = next(s for s in families["chairs"] if s.fine_class == "armchair")
    without = next(s for s in families["chairs"] if s.fine_class == "side")
    points = np.stack([with_arms.landmarks["arm_front_left"], with_arms.landmarks["seat_centre"]])
    found = corresponding_point(with_arms, points, without)
    assert np.isnan(found[0]).all() and np.isfinite(found[1]).all()
    with pytest.raises(ValueError, match="chairs do not correspond to airplanes"):
        corresponding_point(with_arms, points, families["airplanes"][0])


def test_nearest_on_mesh_gives_back_points_of_the_surface(families):
    shape = families["chairs"][0]
    centres = shape.mesh.vertices[shape.mesh.triangles].mean(axis=1)[::50]
    triangle, weights = nearest_on_mesh(shape.mesh, centres)
    again = np.einsum("nc,ncd->nd", weights, shape.mesh.vertices[shape.mesh.triangles[triangle]])
    np.testing.assert_allclose(again, centres, atol=1e-8)


@pytest.mark.parametrize("kind", DAMAGES)
def test_every_damage_does_what_it_says(kind):
    pieces = chairs.build_chair("armchair", np.random.default_rng(4))
    whole = assemble(pieces, chairs.PARTS, chairs.COMPONENTS, polygons=kind == "polygons")
    mesh, part, address = damaged(*whole, (kind,), rng=np.random.default_rng(1))
    assert len(part) == mesh.n_faces and len(address) == len(mesh.triangles)
    assert mesh.face_of_triangle.max() == mesh.n_faces - 1
    np.testing.assert_array_equal(part[mesh.face_of_triangle], _part_of(address))
    directed = edges(mesh.triangles)
    forth = {tuple(e) for e in directed.tolist()}
    open_edges = sum((b, a) not in forth for a, b in forth)
    if kind == "open":
        assert open_edges > 20 and mesh.n_faces < whole[0].n_faces
    elif kind == "duplicated":
        assert len(np.unique(np.sort(mesh.triangles, axis=1), axis=0)) < len(mesh.triangles)
    elif kind == "flipped":
        assert len(forth) < len(directed)
    elif kind == "soup":
        assert open_edges == len(directed)
    else:
        sizes = {len(record) for record in face_records(mesh)}
        assert sizes == {3, 4} and mesh.n_faces < len(mesh.triangles)


def _part_of(address):
    parts = dict(back=0, seat=1, leg=2, stretcher=2, apron=2, foot=2, arm=3, column=4, base=5, castor=5)
    return np.array([parts[chairs.COMPONENTS[int(c)].split()[0]] for c in address[:, 0, 0]])


def test_written_family_reads_back(tmp_path):
    made = write_family(tmp_path, "chairs", 8, seed=3, broken=0.8)
    assert any("polygons" in shape.damage for shape in made)
    names = json.loads((tmp_path / "labels.json").read_text())
    assert list(names.values()) == list(chairs.PARTS)
    with open(tmp_path / "classes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["name"], r["class"]) for r in rows] == [(s.name, s.fine_class) for s in made]
    marks = json.loads((tmp_path / "landmarks.json").read_text())
    for shape in made:
        lines = (tmp_path / f"{shape.name}.obj").read_text().splitlines()
        records = [line.split()[1:] for line in lines if line[:2] == "f "]
        labels = [int(line) for line in (tmp_path / f"{shape.name}.seg").read_text().split()]
        assert len(records) == len(labels) == shape.mesh.n_faces
        assert set(labels) <= {int(k) for k in names}
        corners = np.bincount(shape.mesh.face_of_triangle, minlength=shape.mesh.n_faces) + 2
        assert [len(r) for r in records] == corners.tolist()
        assert marks[shape.name].keys() == shape.landmarks.keys()
    again = tmp_path / "again"
    write_family(again, "chairs", 8, seed=3, broken=0.8)
    for file in sorted(tmp_path.glob("*.*")):
        assert file.read_bytes() == (again / file.name).read_bytes(), file.name


def test_face_records_follow_fans_both_ways():
    pieces = airplanes.build_airplane("glider", np.random.default_rng(0))
    mesh, part, address = assemble(pieces, airplanes.PARTS, airplanes.COMPONENTS, polygons=True)
    turned = damaged(mesh, part, address, ("flipped",), rng=np.random.default_rng(0))[0]
    for before, after in zip(face_records(mesh), face_records(turned), strict=True):
        assert sorted(before) == sorted(after)
        circle = before.tolist() * 2
        backwards = before.tolist()[::-1] * 2
        n, after = len(before), after.tolist()
        assert any(circle[i : i + n] == after or backwards[i : i + n] == after for i in range(n))


def test_squircle_and_its_inverse():
    square = np.random.default_rng(0).uniform(-1, 1, (200, 2))
    for exponent in (2.0, 3.3, 9.0):
        np.testing.assert_allclose(unsquircle(squircle(square, exponent), exponent), square, atol=1e-12)
        ring = squircle(square_ring(24, exponent), exponent)
        np.testing.assert_allclose((np.abs(ring) ** exponent).sum(axis=1), 1, atol=1e-12)


def test_sweep_of_a_round_rod_has_the_volume_of_a_rod():
    path = np.array([[0.0, 0, 0], [0, 0.5, 0], [0, 2.0, 0]])
    rod = sweep(path, np.full((3, 2), 0.1), (1, 0, 0), "leg", "leg", n_around=64)
    assert signed_volume(rod) == pytest.approx(np.pi * 0.01 * 2, rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(family="sofas", count=1), "family: wanted one of chairs, airplanes"),
        (dict(family="chairs", count=-1), "count: wanted"),
        (dict(family="chairs", count=1, classes=["throne"]), "classes: wanted some of"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        generate(**arguments, seed=0)
