"""Where independent pieces of work are done: in this process, in processes of this machine, on a Dask cluster.

The pieces and their order are the caller's and do not depend on who does them. Each is done on one thread, so that
its numbers do not depend on it either: the same input gives the same bytes everywhere.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from socket import create_connection
from typing import Any, Protocol, TypeVar, cast
from urllib.parse import urlsplit

from identify.errors import InputError
from identify.threads import one_thread

__all__ = ["HERE", "Executor", "executor_of"]

T = TypeVar("T")
U = TypeVar("U")

_WAIT = 10  # s until a scheduler must have answered


class Executor(Protocol):
    """Does the same work on many items."""

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """``work`` of each item, in the order of the items; both must be picklable unless the work is done here."""
        ...


class _Here:
    """One after another, in this process."""

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """See `Executor.map`."""
        return [_alone(work, item) for item in items]


#: The executor that needs nothing.
HERE: Executor = _Here()


class _Processes:
    """Processes of this machine; they are started with the first work that has more than one piece."""

    def __init__(self, pool: Any) -> None:
        """Take over a pool that has not started yet."""
        self._pool = pool

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """See `Executor.map`."""
        if len(items) < 2:
            return HERE.map(work, items)
        return list(self._pool.map(_alone, [work] * len(items), items))


class _Cluster:
    """The workers of a Dask scheduler."""

    def __init__(self, client: Any) -> None:
        """Take over a connected client."""
        self._client = client

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """See `Executor.map`."""
        futures = self._client.map(_alone, [work] * len(items), list(items), pure=False)
        return list(self._client.gather(futures))


def _alone(work: Callable[[T], U], item: T) -> U:
    """One piece on one thread."""
    with one_thread():
        return work(item)


def executor_of(workers: int | None = None, scheduler: str | None = None) -> AbstractContextManager[Executor]:
    """The executor that a command was asked for, to be used in a ``with`` block.

    Args:
        workers: Processes of this machine; 1: this process alone; None: one a core that this process may use.
        scheduler: Address of a Dask scheduler (``tcp://host:8786``), which is used instead.

    Raises:
        InputError: No workers, no such address, nobody answers there within 10 s, or `distributed` is not installed.
    """
    if scheduler is not None:
        return _cluster(scheduler)
    count = _cores() if workers is None else workers
    if count < 1:
        raise InputError(f"--workers {count}: at least 1 expected")
    return nullcontext(HERE) if count == 1 else _processes(count)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        yield _Processes(pool)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            f"--scheduler {address}: the package distributed is missing; install it with pip install distributed"
        ) from None
    try:
        place = urlsplit(address)
        if place.hostname is None or place.port is None:
            raise ValueError("a protocol, a host and a port are expected")
        with create_connection((place.hostname, place.port), timeout=_WAIT):
            pass  # a client that finds nobody would go on trying
        client: Any = cast(Any, Client)(address, timeout=_WAIT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({error}); give the address that "
            "dask scheduler prints, for example tcp://127.0.0.1:8786"
        ) from None
    with client:
        yield _Cluster(client)
