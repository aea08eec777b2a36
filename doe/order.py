"""Visits in some order: crane operations, reading times, and what a drifting instrument does to the result.

Drift is linear in the times of the readings: with H the effect of one reading on the result per hour (`doe.drift`),

    drift = sum_readings t H,   t from the first reading on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.lifts import NOTHING, carried_between, hung_states, lifts_between
from doe.travel import Travel
from identify.arrays import Floats, Ints, frozen
from identify.units import HOUR

__all__ = ["Order", "Pace", "Visits", "as_found", "measured", "passage"]


@dataclass(frozen=True)
class Pace:
    """Times of measuring, s; see `identify.study.Times`."""

    pose: float = 60.0
    reading: float = 60.0
    load_change: float = 0.0
    start: float = 0.0


@dataclass(frozen=True, eq=False)
class Visits:
    """Visits to be put in order.

    Attributes:
        loads: (V, S) loads of their readings.
        unloaded: (loads,) True where nothing hangs.
        travel: Moves between their poses.
        pace: Times of measuring.
        drift: (V, S, K) effect of a typical drift on the result for each hour that a reading is late, in any unit.
        own: Error of the result without drift, in that unit.
        taken_off: The weight of the last reading is taken off in any case, so it may be before a last reading.
    """

    loads: Ints
    unloaded: np.ndarray
    travel: Travel
    pace: Pace
    drift: Floats
    own: float = 1.0
    taken_off: bool = False

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "loads", frozen(self.loads, np.int64))
        object.__setattr__(self, "unloaded", frozen(self.unloaded, bool))
        object.__setattr__(self, "drift", frozen(self.drift))


@dataclass(frozen=True, eq=False)
class Order:
    """Visits in the order of measuring.

    Attributes:
        visit: (V,) which visit comes first, second, ...
        reading: (V, S) which of its readings is taken first, second, ...
        lifts: Crane operations from nothing hung to the last reading.
        carried: (V,) what hangs on the way to each visit, a load or `doe.lifts.NOTHING`.
        times: (V, S) time of each reading, s.
        drift: (K,) effect of a typical drift on the result.
    """

    visit: Ints
    reading: Ints
    lifts: int
    carried: Ints
    times: Floats
    drift: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("visit", "reading", "carried"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))
        object.__setattr__(self, "times", frozen(self.times))
        object.__setattr__(self, "drift", frozen(self.drift))


def passage(travel: Travel, left: Ints, entry: Ints, before: Ints, after: Ints) -> tuple[Ints, Ints]:
    """What hangs on the way between two readings, and the operations from one to the other.

    A weight that cannot go along is taken off, and hung again where the bare arm arrives.

    Args:
        travel: Moves between the poses.
        left: What hangs at the reading before, any shape.
        entry: What hangs at the next one.
        before: Pose of the reading before.
        after: Pose of the next one.
    """
    carried, lifts = carried_between(left, entry), lifts_between(left, entry)
    if travel.alone is None:
        return carried, lifts
    alone = travel.alone[travel.move(carried, before, after)]
    return np.where(alone, NOTHING, carried), np.where(alone, 2, lifts)


def as_found(visits: Visits) -> Order:
    """The visits and their readings as they stand."""
    count, readings = visits.loads.shape
    return measured(visits, np.arange(count), np.tile(np.arange(readings), (count, 1)))


def measured(visits: Visits, visit: Ints, reading: Ints) -> Order:
    """Operations, times and drift of any order.

    Args:
        visits: What is visited.
        visit: (V,) which visit comes first, second, ...
        reading: (V, S) which of its readings is taken first, second, ...
    """
    pace, loads = visits.pace, np.take_along_axis(visits.loads[visit], reading, axis=1)
    states = hung_states(loads, visits.unloaded)
    before, left = np.append(len(visits.loads), visit[:-1]), np.append(NOTHING, states[:-1, -1])
    carried, changes = passage(visits.travel, left, states[:, 0], before, visit)
    lifts = np.column_stack([changes, lifts_between(states[:, :-1], states[:, 1:])])
    step = np.asarray(pace.load_change * lifts + pace.reading, dtype=np.float64)
    seconds = visits.travel.seconds[visits.travel.move(carried, before, visit)]
    step[:, 0] += pace.pose - pace.reading + np.where(np.isfinite(seconds), seconds, 0.0)
    times = pace.start + np.cumsum(step.ravel()).reshape(step.shape)
    late = (times - times.flat[0]) / HOUR
    drift = np.take_along_axis(visits.drift[visit], reading[:, :, None], axis=1)
    total = np.einsum("vs,vsk->k", late, drift)
    return Order(visit, reading, int(lifts.sum()), carried, times, total)
