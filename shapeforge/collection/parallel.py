"""Work on many shapes at once: on threads of this machine, or on the processes of a ``dask.distributed`` cluster.

An executor is anything with the interface of ``concurrent.futures``.  ``executor.map`` would take all its input before
the first result is there, and so read every shape of a lazy collection; ``in_order`` takes it as it goes.  On a cluster
(``Client.get_executor()``) what many calls need is sent once, not with every call.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

CALLS_PER_WORKER = 2
"""Calls handed over at a time: one to work on and one to go on with."""


def in_order(executor: Executor | None, function: Callable[..., Any], *iterables: Iterable[Any]) -> Iterator[Any]:
    """Results of ``function`` over the zipped ``iterables``, in their order; the input is taken as it is needed.

    Without an executor calls are made one by one, here.  An error of a call is raised when its turn comes; the calls
    that have not begun by then are cancelled.
    """
    calls = zip(*iterables)  # noqa: B905 - lazily endless inputs are allowed
    if executor is None:
        for call in calls:
            yield function(*call)
        return
    # a cluster would hash the arguments to find out whether it has seen them before
    options = {"pure": False} if _cluster(executor) is not None else {}
    most = CALLS_PER_WORKER * _workers(executor)
    pending: deque[Future[Any]] = deque()
    try:
        for call in calls:
            pending.append(executor.submit(function, *call, **options))
            if len(pending) >= most:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        for future in pending:
            future.cancel()


def shared(executor: Executor | None, value: Any) -> Any:
    """``value`` as an argument of many calls of ``in_order``: on a cluster it is sent to every worker, once."""
    client = _cluster(executor)
    return value if client is None else client.scatter(value, broadcast=True, hash=False)


def kept(executor: Executor | None, items: Any) -> Callable[[], Iterator[Any]]:
    """A function that goes through ``items`` (a sequence, lazy or not), as often as wanted, for ``in_order``.

    A lazy collection is read anew every time and never held.  On a cluster each item is read and sent when it is first
    needed, and stays with a worker as long as the function lives.
    """
    client = _cluster(executor)
    there: dict[int, Any] = {}

    def each() -> Iterator[Any]:
        for index in range(len(items)):
            if client is None:
                yield items[index]
                continue
            if index not in there:
                there[index] = client.scatter(items[index], hash=False)
            yield there[index]

    return each


def _cluster(executor: Executor | None) -> Any | None:
    """The dask client behind an executor of ``Client.get_executor()``; None for threads and processes."""
    return getattr(executor, "_client", None)


def _workers(executor: Executor) -> int:
    client = _cluster(executor)
    if client is not None:
        return max(1, sum(client.nthreads().values()))
    return getattr(executor, "_max_workers", None) or os.cpu_count() or 1
