"""Threads that work on one shape each, never holding more shapes in memory than they work on."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class Workers(ThreadPoolExecutor):
    """A thread pool whose ``map`` takes its input as it goes: a lazy collection stays lazy.

    The standard ``map`` submits all its input at once, which would read every shape of a collection.  Results come
    in the order of the input, whatever the number of workers.
    """

    def __init__(self, jobs: int | None = None) -> None:
        if jobs is not None and jobs < 1:
            raise ValueError(f"jobs: wanted at least 1, got {jobs}")
        self.jobs = jobs or os.cpu_count() or 1
        super().__init__(self.jobs, thread_name_prefix="shapeforge")

    def map(
        self, function: Callable[..., Any], *iterables: Iterable[Any], timeout: float | None = None, chunksize: int = 1
    ) -> Iterator[Any]:
        """Results of ``function`` over the zipped input, in order; at most twice as many pending as workers."""
        return self._map(function, zip(*iterables), timeout)  # noqa: B905 - lazily endless inputs are allowed

    def _map(
        self, function: Callable[..., Any], calls: Iterator[tuple[Any, ...]], timeout: float | None
    ) -> Iterator[Any]:
        pending: deque[Future[Any]] = deque()
        try:
            for call in calls:
                pending.append(self.submit(function, *call))
                if len(pending) >= 2 * self.jobs:
                    yield pending.popleft().result(timeout)
            while pending:
                yield pending.popleft().result(timeout)
        finally:
            for future in pending:
                future.cancel()

    def close(self) -> None:
        """Cancel what has not begun and wait for the rest."""
        self.shutdown(wait=True, cancel_futures=True)
