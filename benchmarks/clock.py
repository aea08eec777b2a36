"""Timing of one call: wall and CPU seconds, best of several, and peak memory of the process."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def timed(call: Callable[[], T], *, repeats: int = 3) -> tuple[T, float, float]:
    """Result, wall and CPU seconds of the quickest of ``repeats`` calls."""
    best: tuple[float, float] = (float("inf"), float("inf"))
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        result = call()
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    return result, *best


def peak_mb() -> float:
    """Largest memory that this process has held so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def line(what: str, measured: str, wanted: str) -> None:
    """Print one row."""
    print(f"{what:<58} {measured:>24}   wanted: {wanted}", flush=True)
