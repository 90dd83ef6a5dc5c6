"""Proposed parts put right by hand: renamed, merged, split, and what cannot be is said."""

from __future__ import annotations

import numpy as np
import pytest

from shapeforge.deformation.box_model import halves
from shapeforge.deformation.boxes import SURE, Proposal, propose_parts
from shapeforge.deformation.proposed_edits import edit_parts
from tests.deformation.test_boxes import chair, matched, one_group


@pytest.fixture(scope="module")
def proposed() -> tuple[list, list[np.ndarray], Proposal]:
    made = [chair(seed) for seed in range(6)]
    shapes = [shape for shape, _ in made]
    proposal = propose_parts(shapes, one_group(6), n_parts=3, rng=np.random.default_rng(0))
    return shapes, [truth for _, truth in made], proposal


def edited(proposed, *edits: tuple[str, ...]) -> Proposal:
    shapes, _, proposal = proposed
    return edit_parts(proposal, edits, shapes, one_group(6), rng=np.random.default_rng(0))


def labels(proposal: Proposal) -> np.ndarray:
    return np.concatenate([one.argmax(axis=1) for one in proposal.segmentation])


def test_a_part_gets_another_name_and_nothing_else_changes(proposed):
    named = edited(proposed, ("rename", "part 2", "  seat  of it "))
    assert named.part_names == ("part 1", "seat of it", "part 3")
    assert np.array_equal(labels(named), labels(proposed[2]))


def test_merged_parts_are_one_and_rows_stay_probabilities(proposed):
    merged = edited(proposed, ("merge", "part 3", "part 1"))
    before, after = labels(proposed[2]), labels(merged)
    assert merged.part_names == ("part 2", "part 3")
    assert np.array_equal(after, np.where(before == 1, 0, 1))
    for one in merged.segmentation:
        assert np.allclose(one.sum(axis=1), 1) and np.allclose(one.max(axis=1), SURE + (1 - SURE) / 2)


def test_what_was_merged_is_split_as_people_would(proposed):
    """Legs (0) and back (2) lumped into one part fall apart again; the seat is left as it was."""
    shapes, truths, proposal = proposed
    names = {int(np.bincount(truth, minlength=3).argmax()): part for part, truth in enumerate_truth(proposal, truths)}
    legs, back = proposal.part_names[names[0]], proposal.part_names[names[2]]
    lumped = edited(proposed, ("merge", legs, back))
    assert matched(lumped.segmentation, truths) < 0.9
    both = edited(proposed, ("merge", legs, back), ("split", legs))
    assert len(both.part_names) == 3 and len(set(both.part_names)) == 3
    assert matched(both.segmentation, truths) > 0.98


def enumerate_truth(proposal: Proposal, truths: list[np.ndarray]):
    said, truth = labels(proposal), np.concatenate(truths)
    return [(part, truth[said == part]) for part in range(len(proposal.part_names))]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (("rename", "part 9", "x"), "wanted one of the parts part 1, part 2, part 3; got 'part 9'"),
        (("rename", "part 1", "part 2"), "'part 2' is taken"),
        (("rename", "part 1", " "), "'' is empty"),
        (("merge", "part 1", "part 1"), "wanted two parts to merge"),
        (("merge", "part 1"), "wanted rename and 2 names; merge and 2 names; split and 1 name; got"),
        (("paint", "part 1"), "wanted rename and 2 names"),
    ],
)
def test_errors_say_what_was_wanted(proposed, edit, message):
    with pytest.raises(ValueError, match=message):
        edited(proposed, edit)


def test_what_is_all_alike_cannot_be_split(proposed):
    assert halves(np.ones((6, 2)), np.ones(6), rng=np.random.default_rng(0)) is None
    shapes, _, proposal = proposed
    one = propose_parts(shapes[:1], one_group(1), n_parts=3, rng=np.random.default_rng(0))
    said = labels(one)
    number = next(part for part in range(3) if len(np.unique(shapes[0].patch[said == part])) == 1)
    with pytest.raises(ValueError, match="cannot be split"):
        edit_parts(one, [("split", f"part {number + 1}")], shapes[:1], one_group(1), rng=np.random.default_rng(0))
