"""Algorithms are iterators of states; this is their one-call form."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

State = TypeVar("State")


def last(states: Iterable[State]) -> State:
    """The last state of an algorithm.  Raises ValueError where there is none."""
    found = False
    for state in states:
        found = True
    if not found:
        raise ValueError("states: wanted at least one, got none (was the iterator used up before?)")
    return state
