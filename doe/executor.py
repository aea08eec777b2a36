"""Where independent pieces of work are done: in this process, in processes of this machine, on a Dask cluster.

The pieces and their order are the caller's and do not depend on who does them. Each is done on one thread, so that
its numbers do not depend on it either: the same input gives the same bytes everywhere.
"""

from __future__ import annotations

import copyreg
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from itertools import repeat
from socket import create_connection
from time import perf_counter
from types import MappingProxyType
from typing import Any, Protocol, TypeVar, cast
from urllib.parse import urlsplit

from identify.errors import InputError
from identify.threads import one_thread

__all__ = ["HERE", "Executor", "executor_of"]

T = TypeVar("T")
U = TypeVar("U")

_WAIT = 10  # s until a scheduler must have answered
_START = 2.0  # s of one kind of work, done and left, that are worth starting processes for
_SEND = 0.02  # s of work of one piece that are worth sending it to a process that runs


def _read_only(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


# read-only views of dictionaries stand in frozen records, and pickle does not know them
copyreg.pickle(MappingProxyType, lambda view: (_read_only, (dict(view),)))


class Executor(Protocol):
    """Does the same work on many items."""

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """``work`` of each item, in the order of the items, as they are asked for.

        ``work`` is a function of a module or a `functools.partial` of one; it and the items can be pickled.
        """
        ...


class _Here:
    """One after another, in this process."""

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """See `Executor.map`."""
        for item in items:
            yield _alone(work, item)


#: The executor that needs nothing.
HERE: Executor = _Here()


class _Processes:
    """Processes of this machine, for work that is worth it; short work is done here.

    The first pieces of each kind of work are done here, and show how long one takes. Where a piece is done changes
    nothing but the time.

    Attributes:
        seconds: Of the last piece of each kind of work that was done here.
        spent: Seconds of all of them; work that has taken long so far is expected to go on.
    """

    def __init__(self, start: Callable[[], Any]) -> None:
        """Take what starts the processes."""
        self._start = start
        self._pool: Any = None
        self.seconds: dict[str, float] = {}
        self.spent: dict[str, float] = {}

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """See `Executor.map`."""
        kind = _kind(work)
        for place, item in enumerate(items):
            if self._worth(kind, len(items) - place):
                yield from self._sent(work, items[place:])
                return
            began = perf_counter()
            result = _alone(work, item)
            self.seconds[kind] = perf_counter() - began
            self.spent[kind] = self.spent.get(kind, 0.0) + self.seconds[kind]
            yield result

    def _worth(self, kind: str, pieces: int) -> bool:
        """True if pieces are to be sent away."""
        piece = self.seconds.get(kind)
        if piece is None or pieces < 2:
            return False
        return piece > _SEND if self._pool is not None else self.spent.get(kind, 0.0) + piece * pieces > _START

    def _sent(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """The pieces of the processes, which are started with the first ones."""
        from concurrent.futures.process import BrokenProcessPool

        self._pool = self._pool or self._start()
        try:
            yield from self._pool.map(_alone, repeat(work, len(items)), items)
        except BrokenProcessPool as error:
            raise InputError(
                "--workers: a process ended before its work was done, most likely for want of memory; give fewer "
                "workers, or --workers 1"
            ) from error


class _Cluster:
    """The workers of a Dask scheduler."""

    def __init__(self, client: Any) -> None:
        """Take over a connected client."""
        self._client = client

    def map(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """See `Executor.map`."""
        from distributed import KilledWorker

        try:
            for future in self._client.map(partial(_alone, work), list(items), pure=False):
                yield future.result()
                future.release()
        except KilledWorker as error:
            raise InputError(
                f"--scheduler: workers were lost before their work was done, most likely for want of memory: {error}"
            ) from error


def _kind(work: Callable[..., Any]) -> str:
    """A name for the same work on other items."""
    inner = work.func if isinstance(work, partial) else work
    return f"{inner.__module__}.{inner.__qualname__}"


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

    with ExitStack() as stack:
        make = partial(ProcessPoolExecutor, count, mp_context=get_context("spawn"))
        yield _Processes(lambda: stack.enter_context(make()))


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
