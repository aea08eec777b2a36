"""Visits that could be measured after a series of readings: the same loads at new poses, later in time."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from doe.candidates import candidates
from identify.arrays import Floats, Ints
from identify.diagnosis.library import Hypothesis
from identify.diagnosis.search import with_causes
from identify.experiment import Experiment, full_experiment
from identify.kinematics import forward
from identify.study import Study

__all__ = ["following_names", "named_visits", "possible_visits", "usual_loads"]


def possible_visits(
    study: Study, measured: Experiment, asked: tuple[Hypothesis, ...], *, most: int, seed: int
) -> Experiment:
    """Feasible visits, all read as most visits of a series were.

    Every visit takes the loads that most measured ones took. Where wrenches were measured, it is pulled in the base
    frame as one of the measured visits was. Where it was recorded from where poses were approached, that is drawn
    anew. All stand at the same time, in the middle of a few visits that follow the measured ones at their usual pace.

    Args:
        study: The study with the causes found in its model.
        measured: The visits that were measured.
        asked: Hypotheses, some of which may be defined at certain joint values only.
        most: Number of visits.
        seed: Seed of poses and approaches.

    Raises:
        InputError: A joint has no limits.
        Infeasible: No pose was found.
    """
    loads = usual_loads(measured)
    names = tuple(measured.loads[load].name for load in loads)
    settings = replace(study.plan, loads=names, loads_per_pose=len(names), reference_rows=False, candidates=most)
    stopping = with_causes(study, tuple(h for h in asked if h.effect.stops))
    chosen = candidates(replace(stopping, plan=settings), seed=seed)
    q = chosen.visit_q
    new = full_experiment(q, np.tile(loads, (len(q), 1)), measured.loads, measured.markers)
    rng = np.random.default_rng(seed)
    return replace(
        new,
        wrench=None if measured.wrench is None else _pulled(study, measured, measured.wrench, q, loads),
        approach=None if measured.approach is None else rng.choice([-1.0, 1.0], q.shape),
        start=measured.start,
        time=None if measured.time is None else _later(measured, measured.time, new),
        temperature=None
        if measured.temperature is None
        else np.full(len(new.row_shot), _last(measured, measured.temperature)),
    )


def usual_loads(measured: Experiment) -> Ints:
    """(L,) the loads that most visits were read with, the unloaded state first."""
    taken = _taken(measured)
    sets, count = np.unique(taken[taken.any(axis=1)], axis=0, return_counts=True)
    loads = np.flatnonzero(sets[np.argmax(count)])
    loaded = np.array([not measured.loads[load].unloaded for load in loads])
    ordered: Ints = loads[np.argsort(loaded, kind="stable")]
    return ordered


def _taken(measured: Experiment) -> np.ndarray:
    """(V, loads) True where a visit has rows of a load."""
    taken = np.zeros((len(measured.visits), len(measured.loads)), dtype=bool)
    taken[measured.row_visit, measured.shot_load[measured.row_shot]] = True
    return taken


def _pulled(study: Study, measured: Experiment, wrench: Floats, q: Floats, loads: Ints) -> Floats:
    """(N L, 6) wrenches of measured visits, one after the other, turned into the flange frame of new poses."""
    full = np.flatnonzero(_taken(measured)[:, loads].all(axis=1))
    shot_of = np.zeros((len(measured.visits), len(measured.loads)), dtype=np.int64)
    shot_of[measured.shot_visit, measured.shot_load] = np.arange(len(measured.shot_visit))
    shots = shot_of[full[np.arange(len(q)) % len(full)]][:, loads].ravel()
    there = forward(study.robot, measured.q).flange_rotation[measured.shot_pose[shots]]
    here = np.repeat(forward(study.robot, q).flange_rotation, len(loads), axis=0)
    turn = here.swapaxes(1, 2) @ there
    parts = wrench[shots].reshape(-1, 2, 3)
    turned: Floats = np.einsum("sij,skj->ski", turn, parts).reshape(-1, 6)
    return turned


def _later(measured: Experiment, time: Floats, new: Experiment) -> Floats:
    """(R,) time of new rows: two usual intervals after the last measured visit, shots spread over one."""
    first = np.full(len(measured.visits), np.inf)
    np.minimum.at(first, measured.row_visit, time)
    first = np.sort(first[np.isfinite(first)])
    pace = float(np.median(np.diff(first))) if len(first) > 1 else 0.0
    shots = len(new.shot_visit) // len(new.visits)
    later: Floats = float(time.max()) + pace * (2 + new.row_shot % shots / shots)
    return later


def _last(measured: Experiment, read: Floats) -> float:
    """What was read last: by time where it was noted, else in the last row."""
    return float(read[-1 if measured.time is None else int(np.argmax(measured.time))])


def following_names(letter: str, taken: Iterable[str], count: int) -> tuple[str, ...]:
    """Names of ``count`` new visits: the letter and numbers that follow those of the names that are taken."""
    pattern = re.compile(rf"{letter}(\d{{1,9}})")
    begin = 1 + max((int(found[1]) for name in taken if (found := pattern.fullmatch(name))), default=0)
    return tuple(f"{letter}{begin + i:03d}" for i in range(count))


def named_visits(possible: Experiment, index: Ints, measured: Experiment) -> Experiment:
    """Some of the possible visits with names that are not yet taken: N001, N002, ... or what follows."""
    names = following_names("N", measured.visits, len(index))
    shots = len(possible.shot_visit) // len(possible.visits)
    loads = possible.shot_load.reshape(-1, shots)[index]
    new = full_experiment(possible.q[index], loads, possible.loads, possible.markers, names)
    wrench, approach = possible.wrench, possible.approach
    return replace(
        new,
        wrench=None if wrench is None else wrench.reshape(-1, shots, 6)[index].reshape(-1, 6),
        approach=None if approach is None else approach[index],
    )
