"""Groups linked over templates in between: rods bent more and more, whose ends a direct registration mistakes."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from shapeforge.deformation.hierarchy import Hierarchy, link_templates
from shapeforge.deformation.levels import FEWEST_GROUPS, link_part
from shapeforge.deformation.registration import Registrations
from shapeforge.deformation.templates import PartTemplates, template_from_points

POINTS = 250


def rod(bend: float, seed: int) -> tuple[PartTemplates, np.ndarray]:
    """A rod that tapers, bent by so many degrees in all, and where along it (0 to 1) each template point is."""
    rng = np.random.default_rng(seed)
    along, around = rng.random(POINTS), rng.random(POINTS) * 2 * np.pi
    turn = np.radians(bend) * np.linspace(0, 1, 400)
    axis = [np.interp(along, np.linspace(0, 1, 400), np.cumsum(curve(turn)) / 400) for curve in (np.sin, np.cos)]
    across = np.stack([np.cos(np.radians(bend) * along), -np.sin(np.radians(bend) * along), np.zeros(POINTS)], axis=1)
    normals = across * np.cos(around)[:, None] + np.array([0, 0, 1]) * np.sin(around)[:, None]
    points = np.stack([*axis, np.zeros(POINTS)], axis=1) + (0.05 - 0.02 * along[:, None]) * normals
    points /= np.linalg.norm(np.ptp(points, axis=0))
    label = np.zeros(POINTS, np.int32)
    return template_from_points(points, normals, np.zeros((POINTS, 10)), label, ("rod",)), along


def linked(bends, seeds) -> tuple[Hierarchy, np.ndarray]:
    """Rods linked with the first as the top; how far along each rod its points are from where they belong."""
    made = [rod(bend, seed) for bend, seed in zip(bends, seeds, strict=True)]
    hierarchy = link_templates([template for template, _ in made], [99] + [1] * (len(made) - 1))
    off = [
        np.abs((link.weight * along[link.index]).sum(axis=1) - made[0][1]).mean()
        for link, (_, along) in zip(hierarchy.links, made, strict=True)
    ]
    return hierarchy, np.array(off)


def two_levels():
    """As if there never were enough groups for levels in between."""
    return patch("shapeforge.deformation.levels.FEWEST_GROUPS", 1000)


@pytest.fixture(scope="module")
def bent():
    """Seven rods from straight to bent by 200 degrees, linked with levels in between and with two levels."""
    bends = np.linspace(0, 200, 7)
    with two_levels():
        direct = linked(bends, range(7))
    return linked(bends, range(7)), direct


def test_templates_far_from_the_top_are_linked_over_those_in_between(bent):
    (hierarchy, off), (_, off_directly) = bent
    assert off_directly[-1] > 0.35, "a registration of the straight rod with the most bent one goes astray"
    assert off[-1] < 0.6 * off_directly[-1] and off.mean() < 0.75 * off_directly.mean()
    assert hierarchy.levels > 3 and hierarchy.over[-1, 0] > 0
    assert hierarchy.over[0, 0] == -1, "nothing is between the top and itself"


def test_what_is_linked_over_others_is_still_linked_to_the_top(bent):
    (hierarchy, _), (direct, _) = bent
    np.testing.assert_array_equal(hierarchy.top.points, direct.top.points)
    for link in hierarchy.links:
        assert link.index.shape == (POINTS, 3) and link.exists.all() and (link.weight >= 0).all()
        np.testing.assert_allclose(link.weight.sum(axis=1), 1)


def test_templates_near_each_other_are_linked_directly_and_nothing_else_is_registered():
    class Watched(Registrations):
        made: set[tuple[int, int]] = set()

        def of_part(self, source, target, part):
            self.made.add((source, target))
            return super().of_part(source, target, part)

    near = [rod(bend, 0)[0] for bend in np.linspace(100, 115, FEWEST_GROUPS)]
    found = link_part(Watched(near), 0, 0)
    assert not found.over and list(found.places) == list(range(1, len(near)))
    assert Watched.made == {(0, g) for g in found.places} | {(g, 0) for g in found.places}


def test_few_groups_are_linked_directly_however_far_apart_they_are():
    bends = np.linspace(0, 200, FEWEST_GROUPS - 1)
    made = Registrations([rod(bend, seed)[0] for seed, bend in enumerate(bends)])
    found = link_part(made, 0, 0)
    assert not found.over and list(found.places) == list(range(1, len(bends)))
    assert all(found.places[g] is made.of_part(0, g, 0) for g in found.places)


def test_levels_are_counted_along_the_longest_chain_of_links():
    templates = rod(0, 0)[0]
    over = np.array([[-1, -1], [-1, 0], [1, -1], [2, 1]])
    for rows, levels in ((over, 4), (over[:2], 3), (np.full_like(over, -1), 2), (None, 2)):
        assert Hierarchy(templates, (), rows).levels == levels
