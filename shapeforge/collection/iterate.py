"""Algorithms are iterators of states; this is their one-call form."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import TypeVar

State = TypeVar("State")


def last(states: Iterable[State]) -> State:
    """The last state of an algorithm.  Raises ValueError where there is none."""
    kept = deque(states, maxlen=1)
    if not kept:
        raise ValueError("states: wanted at least one, got none (was the iterator used up before?)")
    return kept[0]
