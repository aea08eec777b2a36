"""The fewest experiments that keep a stated tolerance at the test poses."""

from __future__ import annotations

import functools
import math
from bisect import bisect_left
from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

from doe.accuracy import jitter_covariance
from doe.choice import Choice, choose
from doe.guard import search
from doe.information import covariance_of, information_of
from doe.observations import target_rows
from doe.pool import AnyPool, Pool
from doe.reach import Reach
from identify.arrays import Floats
from identify.error_radius import radius
from identify.errors import Infeasible, NotIdentifiable
from identify.units import MM

__all__ = ["fewest", "sufficient"]

_MOST = 2000  # experiments


class Chosen(Protocol):
    """A plan of some number of experiments."""

    @property
    def own(self) -> Floats:
        """(n, k, p) blocks of the plan."""


_C = TypeVar("_C", bound=Chosen)


def sufficient(pool: Pool, seed: int, reach: Reach | None) -> Choice:
    """The plan with the fewest experiments whose total error keeps the tolerance at every test pose.

    Args:
        pool: The candidates.
        seed: Of the search.
        reach: All poses, or None to stay on the candidates.

    Raises:
        Infeasible: The robot's own repeatability forbids it, or more experiments are needed than may be made.
    """
    jitter = functools.partial(jitter_covariance, pool.observer.study)
    return fewest(pool, seed, jitter, lambda count: choose(pool, count, seed, reach))


def fewest(pool: AnyPool, seed: int, jitter: Callable[[], Floats], choice_of: Callable[[int], _C]) -> _C:
    """The same for the candidates of one arm or of two.

    Args:
        pool: The candidates.
        seed: Seed of the search.
        jitter: ``() -> (t, 3, 3)`` covariance of the test poses from the robots' own jitter, mm^2.
        choice_of: ``(n) -> plan`` of n experiments.

    Raises:
        Infeasible: Repeatability forbids it, or more experiments are needed than may be made.
    """
    aim, settings = pool.objective, pool.observer.settings
    least = math.ceil(aim.size / pool.blocks.shape[1])
    most = _MOST if settings.repeats else min(_MOST, len(pool.blocks))
    keeps = _tolerance_test(pool, jitter)

    def keeps_on_the_grid(count: int) -> bool:
        try:
            chosen = search(pool, aim.target(), count, seed, aim.criterion, effort="low")
        except NotIdentifiable:  # too few
            return False
        return keeps(information_of(pool.blocks[chosen]))

    def chosen(count: int) -> _C | None:
        try:
            return choice_of(count)
        except (NotIdentifiable, Infeasible):  # too few
            return None

    low, high = least, min(least, most)
    while not keeps_on_the_grid(high):
        if high == most:
            raise _too_many(pool, most)
        low, high = high + 1, min(2 * high, most)
    count = bisect_left(range(high), True, lo=low, key=keeps_on_the_grid)
    found = chosen(count)
    if found is not None:  # refinement may take fewer, a guard more: the first plan tells about how many
        each = information_of(found.own) / count
        count = min(bisect_left(range(most), True, lo=least, key=lambda n: keeps(n * each)), most)
        found = chosen(count)
    while found is None or not keeps(information_of(found.own)):
        count += 1
        if count > most:
            raise _too_many(pool, most)
        found = chosen(count)
    while count > least:
        count -= 1
        fewer = chosen(count)
        if fewer is None or not keeps(information_of(fewer.own)):
            break
        found = fewer
    return found


def _too_many(pool: AnyPool, most: int) -> Infeasible:
    """The error for a tolerance that no allowed number of experiments keeps."""
    asked = pool.observer
    tolerance = (asked.settings.tolerance or 0.0) / MM
    return Infeasible(
        f"{asked.path}: [plan] tolerance_mm = {tolerance:g} needs more than {most} experiments; "
        "allow a larger tolerance, heavier loads or a better instrument"
    )


def _tolerance_test(pool: AnyPool, jitter: Callable[[], Floats]) -> Callable[[Floats], bool]:
    """``information (p, p) -> bool``: is the tolerance kept at every test pose?

    Raises:
        Infeasible: The robot's own repeatability forbids it.
    """
    asked, aim = pool.observer, pool.objective
    rows = target_rows(asked, pool.known) / MM
    tolerance, confidence = (asked.settings.tolerance or 0.0) / MM, asked.settings.confidence
    repeatability = jitter()
    own = max(radius(scatter, confidence) for scatter in repeatability)
    if own >= tolerance:
        raise Infeasible(
            f"{asked.path}: [plan] tolerance_mm = {tolerance:g}: the robot's own pose jitter alone gives {own:.3g} mm "
            f"at a test pose with confidence {confidence:g}; no number of experiments removes it"
        )

    def keeps(information: Floats) -> bool:
        if not np.isfinite(aim.value(information, "test_pose")):
            return False
        reached = rows @ covariance_of(information) @ rows.swapaxes(1, 2)
        return max(radius(total, confidence) for total in reached + repeatability) <= tolerance

    return keeps
