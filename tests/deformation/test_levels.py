"""Groups linked over templates in between: limbs turned further and further, which a direct registration mistakes."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from shapeforge.deformation.hierarchy import Hierarchy, link_templates
from shapeforge.deformation.levels import FEWEST_GROUPS, link_part
from shapeforge.deformation.registration import Registrations
from shapeforge.deformation.templates import PartTemplates, template_from_points

POINTS = 250


def limb(turn: float, seed: int) -> tuple[PartTemplates, np.ndarray]:
    """A flat limb that tapers and curves, turned by so many degrees, and where along it (0 to 1) each point is."""
    rng = np.random.default_rng(seed)
    along, across, side = rng.random(POINTS), rng.uniform(-1, 1, POINTS), rng.choice([-1, 1], POINTS)
    flat = np.stack([along, across * (0.22 - 0.16 * along) + 0.1 * along**2, side * (0.05 - 0.03 * along)], axis=1)
    flat /= np.linalg.norm(np.ptp(flat, axis=0))
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    points = flat @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    normals = np.outer(side, [0.0, 0.0, 1.0])
    label = np.zeros(POINTS, np.int32)
    return template_from_points(points, normals, np.zeros((POINTS, 10)), label, ("limb",)), along


def linked(turns, seeds) -> tuple[Hierarchy, np.ndarray]:
    """Limbs linked with the first as the top; how far along each limb its points are from where they belong."""
    made = [limb(turn, seed) for turn, seed in zip(turns, seeds, strict=True)]
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
def turned():
    """Seven limbs, the last turned by a right angle, linked with levels in between and with two levels."""
    turns = np.linspace(0, 90, 7)
    with two_levels():
        direct = linked(turns, range(7))
    return linked(turns, range(7)), direct


def test_templates_far_from_the_top_are_linked_over_those_in_between(turned):
    (hierarchy, off), (_, off_directly) = turned
    assert off_directly[-1] > 0.25, "a registration of the first limb with the last goes astray"
    assert off[-1] < 0.4 * off_directly[-1] and off.mean() < 0.75 * off_directly.mean()
    assert hierarchy.levels > 3 and hierarchy.over[-1, 0] > 0
    assert hierarchy.over[0, 0] == -1, "nothing is between the top and itself"


def test_what_is_linked_over_others_is_still_linked_to_the_top(turned):
    (hierarchy, _), (direct, _) = turned
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

    near = [limb(turn, 0)[0] for turn in np.linspace(0, 8, FEWEST_GROUPS)]
    found = link_part(Watched(near), 0, 0)
    assert not found.over and list(found.places) == list(range(1, len(near)))
    assert Watched.made == {(0, g) for g in found.places} | {(g, 0) for g in found.places}


def test_few_groups_are_linked_directly_however_far_apart_they_are():
    turns = np.linspace(0, 90, FEWEST_GROUPS - 1)
    made = Registrations([limb(turn, seed)[0] for seed, turn in enumerate(turns)])
    found = link_part(made, 0, 0)
    assert not found.over and list(found.places) == list(range(1, len(turns)))
    assert all(found.places[g] is made.of_part(0, g, 0) for g in found.places)


def test_levels_are_counted_along_the_longest_chain_of_links():
    templates = limb(0, 0)[0]
    over = np.array([[-1, -1], [-1, 0], [1, -1], [2, 1]])
    for rows, levels in ((over, 4), (over[:2], 3), (np.full_like(over, -1), 2), (None, 2)):
        assert Hierarchy(templates, (), rows).levels == levels
