"""Calls on executors: results in order, input taken as needed, errors in their turn."""

from __future__ import annotations

import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from itertools import count

import pytest

from shapeforge.collection.parallel import CALLS_PER_WORKER, in_order, kept, shared


def slow_first(number: int) -> int:
    if number == 0:
        threading.Event().wait(0.05)
    return number * number


def refuse_three(number: int) -> int:
    if number == 3:
        raise FloatingPointError(f"number {number}")
    return number


def test_results_are_in_the_order_of_the_input_whoever_calls():
    wanted = [number * number for number in range(12)]
    assert list(in_order(None, slow_first, range(12))) == wanted
    with ThreadPoolExecutor(3) as executor:
        assert list(in_order(executor, slow_first, range(12))) == wanted
    with ProcessPoolExecutor(2) as executor:
        assert list(in_order(executor, slow_first, range(12))) == wanted


def test_input_is_taken_as_it_is_needed():
    taken = []

    def shapes():
        for number in count():
            taken.append(number)
            yield number

    with ThreadPoolExecutor(2) as executor:
        results = in_order(executor, slow_first, shapes())
        assert [next(results) for _ in range(3)] == [0, 1, 4]
        assert len(taken) <= 3 + 2 * CALLS_PER_WORKER
        results.close()
    assert len(taken) <= 3 + 2 * CALLS_PER_WORKER


def test_an_error_comes_in_its_turn():
    with ThreadPoolExecutor(3) as executor:
        results = in_order(executor, refuse_three, range(10))
        assert [next(results) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(FloatingPointError, match="number 3"):
            next(results)


def test_without_a_cluster_nothing_is_held_or_wrapped():
    reads = []

    class Lazy(list):
        def __getitem__(self, index):
            reads.append(index)
            return super().__getitem__(index)

    each = kept(None, Lazy("abc"))
    assert list(each()) == list(each()) == ["a", "b", "c"]
    assert reads == [0, 1, 2, 0, 1, 2]
    value = object()
    assert shared(None, value) is value
