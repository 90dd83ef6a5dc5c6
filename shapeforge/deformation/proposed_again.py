"""Parts proposed again, for other shapes or groups: numbered as they were, so that paint still means what it did.

A proposal numbers its parts by their size, and with a few shapes more the second may become the third.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from shapeforge.deformation.boxes import Proposal

FOUND_AGAIN = 0.5
"""Share of the surface of a part, then or now, that has to be in it both times: above a half it can be but one part."""


def shared_surface(
    before: Proposal, now: Proposal, same: Sequence[tuple[int, int]]
) -> Float[np.ndarray, "parts_before parts_now"]:
    """Surface that a part before (rows) and one now have in common, over what either has; 0 where neither has any.

    ``same`` are the shapes, by their numbers before and now, that were sampled alike both times; each counts the same.
    """
    table = np.zeros((len(before.part_names), len(now.part_names)))
    for then, t in same:
        one, other = before.segmentation[then].argmax(axis=1), now.segmentation[t].argmax(axis=1)
        np.add.at(table, (one, other), 1.0 / len(one))
    either = table.sum(axis=1, keepdims=True) + table.sum(axis=0, keepdims=True) - table
    return np.divide(table, either, out=np.zeros_like(table), where=either > 0)


def numbered_as(before: Proposal, now: Proposal, same: Sequence[tuple[int, int]]) -> Proposal:
    """The proposal ``now``, its parts in the order of those ``before`` that they share most with (``same`` as above).

    Parts beyond the number before come last, in their own order.  Raises ValueError when there are fewer than before.
    """
    if len(now.part_names) < len(before.part_names):
        raise ValueError(f"now: wanted at least {len(before.part_names)} parts, got {len(now.part_names)}")
    order = linear_sum_assignment(-shared_surface(before, now, same))[1]
    order = np.concatenate([order, np.setdiff1d(np.arange(len(now.part_names)), order)])
    return replace(now, segmentation=tuple(one[:, order] for one in now.segmentation))
