"""A plan as it is measured: visits and readings in order, crane operations, times, travel and what drift leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from doe.drift import Leftover, Yardstick, drift_of_readings, leftover, typical_drift
from doe.lifts import NOTHING, Fewest, lifts_of
from doe.moves import free_moves
from doe.observations import Observer
from doe.order import Order, Pace, Visits, as_found, measured
from doe.order_search import best_order
from doe.travel import Free, travel_between
from identify.arrays import Floats, Ints, frozen
from identify.experiment import Experiment, full_experiment
from identify.study import Study, Times
from identify.units import HOUR

__all__ = ["STEP", "Schedule", "pace_of", "schedule", "time_as_given"]

STEP = 60.0  # s between readings where the study does not say how long they take
_SEED = 1  # beside the seed of the plan


@dataclass(frozen=True, eq=False)
class Schedule:
    """Visits in the order of measuring.

    Attributes:
        q: (V, n) joint values, rad or m.
        visit_loads: (V, S) loads of the readings, in the order of reading.
        experiment: (V,) which experiment of the plan each visit belongs to.
        times: (V, S) time of each reading, s.
        stated: The study says how long readings take; else they are in equal steps.
        time: From the start to the last reading, s; None where the study has no ``[times]``.
        lifts: Crane operations from nothing hung to the last reading.
        fewest: The fewest there can be.
        travel_s: Time of all moves, s.
        travel_deg: Sum over the moves of the largest turn of a joint, deg.
        detours: Moves that go over the home pose.
        blocked: Visits, from 0 in this order, to which the straight move from the one before is not free and no home
            pose leads around; counted as if it were driven.
        unit: Of what drift leaves: mm at the test poses, or standard deviations.
        left: What drift leaves.
        as_found: What it would leave with the visits as they were chosen, the unloaded state always first.
        lifts_as_found: Crane operations of that.
    """

    q: Floats
    visit_loads: Ints
    experiment: Ints
    times: Floats
    stated: bool
    time: float | None
    lifts: int
    fewest: Fewest
    travel_s: float
    travel_deg: float
    detours: int
    blocked: Ints
    unit: str
    left: Leftover
    as_found: Leftover
    lifts_as_found: int

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("q", "times"):
            object.__setattr__(self, key, frozen(getattr(self, key)))
        for key in ("visit_loads", "experiment", "blocked"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))

    @property
    def first_visited(self) -> Ints:
        """(n,) experiments in the order of their first visits."""
        first = np.unique(self.experiment, return_index=True)[1]
        return self.experiment[np.sort(first)]

    def conditions(self, study: Study, names: tuple[str, ...] | None = None) -> Experiment:
        """The visits as an experiment, with approaches and times where the study states them; ``names`` (V,)."""
        experiment = full_experiment(self.q, self.visit_loads, study.loads, study.markers, names)
        shot = experiment.row_shot
        return replace(
            experiment,
            approach=np.ones_like(self.q) if study.plan.approach == "same" else None,
            time=self.times.ravel()[shot] if self.stated else None,
        )


def schedule(
    observer: Observer,
    q: Floats,
    visit_loads: Ints,
    kept: Ints,
    gain: Floats,
    measure: Yardstick,
    *,
    seed: int,
    home: Floats | None = None,
    free: Free | None = None,
) -> Schedule:
    """Put the experiments of a plan in the order of measuring.

    Args:
        observer: How the poses of this arm are read.
        q: (n, joints) joint values, rad or m.
        visit_loads: (n, L) loads of the readings of each experiment.
        kept: (p_a,) kept columns of the observer's model.
        gain: (r, p_a) of `doe.drift.drift_of_readings`.
        measure: What a drift is measured by.
        seed: Seed of the search.
        home: (joints,) where the robot comes from and goes around obstacles; None: the home of the constraints.
        free: Which moves between poses are free; None: what the constraints say (`doe.moves.free_moves`). Without
            any home pose the moves that are not, and that no order avoids, are then told in ``blocked``.

    Raises:
        Infeasible: A home pose or ``free`` is given, and no order avoids moves that are not free.
    """
    study, times = observer.study, observer.study.times
    home = study.constraints.home if home is None else home
    refused = home is not None or free is not None
    drift = drift_of_readings(observer, q, visit_loads, kept, gain)
    experiment = np.arange(len(q))
    if observer.own_visits:
        experiment = np.repeat(experiment, visit_loads.shape[1])
        q, visit_loads = q[experiment], visit_loads.reshape(-1, 1)
        drift = drift.reshape(-1, 1, *drift.shape[2:])
    unloaded = np.array([load.unloaded for load in study.loads])
    speed, speed_slide = (np.inf, np.inf) if times is None else (times.speed, times.speed_slide)
    straight = partial(travel_between, q, study.robot.prismatic, speed=speed, speed_slide=speed_slide)
    travel = straight(
        home=home,
        free=partial(free_moves, study) if free is None else free,
        hung=np.isin(np.arange(len(unloaded)), visit_loads) & ~unloaded,
    )
    visits = Visits(
        visit_loads,
        unloaded,
        travel,
        pace_of(times),
        (drift * typical_drift(observer)).reshape(*visit_loads.shape, -1),
        own=measure.own,
        taken_off=observer.own_visits,
    )
    order, fewest = best_order(visits, np.random.default_rng([_SEED, seed]))
    naive = as_found(visits)
    blocked = travel.blocked(order.visit, order.carried)
    if refused:
        names = full_experiment(q[order.visit], visit_loads, study.loads, study.markers).visits
        travel.check(order.visit, order.carried, names, str(study.path))
    elif len(blocked):
        travel = straight()
        order = measured(replace(visits, travel=travel), order.visit, order.reading)
    seconds, degrees, detours = travel.along(order.visit, order.carried)
    return Schedule(
        q=q[order.visit],
        visit_loads=np.take_along_axis(visit_loads[order.visit], order.reading, axis=1),
        experiment=experiment[order.visit],
        times=order.times,
        stated=_tells(times),
        time=None if times is None else float(order.times.max()) if _tells(times) else times.start + seconds,
        lifts=order.lifts,
        fewest=fewest,
        travel_s=seconds,
        travel_deg=degrees,
        detours=detours,
        blocked=blocked,
        unit=measure.unit,
        left=leftover(_effect(drift, order)),
        as_found=leftover(_effect(drift, naive)),
        lifts_as_found=naive.lifts,
    )


def pace_of(times: Times | None) -> Pace:
    """Times of measuring as stated, or equal steps."""
    if times is None or not _tells(times):
        return Pace(STEP, STEP)
    return Pace(times.pose, times.reading, times.load_change, times.start)


def time_as_given(study: Study, experiment: Experiment) -> float | None:
    """Time to measure visits in the order in which they stand, s; None where the study has no ``[times]``."""
    times = study.times
    if times is None:
        return None
    visit = experiment.shot_visit
    first = np.diff(visit, prepend=-1) != 0
    poses = experiment.q[experiment.shot_pose[first]]
    travel = travel_between(poses, study.robot.prismatic, speed=times.speed, speed_slide=times.speed_slide)
    states = np.where(experiment.shot_unloaded, NOTHING, experiment.shot_load)
    reading = np.where(first, times.pose, times.reading).sum()
    moves = travel.along(np.arange(len(poses)), np.full(len(poses), NOTHING))[0]
    return float(times.start + reading + moves + times.load_change * lifts_of(states))


def _tells(times: Times | None) -> bool:
    """True if the study says how long readings take."""
    return times is not None and times.pose + times.reading + times.load_change > 0.0


def _effect(drift: Floats, order: Order) -> Floats:
    """(r, 6) effect of a drift (V, S, r, 6 per hour) on the result with the times of an order."""
    late = (order.times - order.times.flat[0]) / HOUR
    read = np.take_along_axis(drift[order.visit], order.reading[:, :, None, None], axis=1)
    return np.asarray(np.einsum("vs,vsrk->rk", late, read))
