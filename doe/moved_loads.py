"""Move the loads of a plan within their ranges, together with its joint values.

Visits that use one setting of a load share its values, so a plan never needs more different settings for it. Values
are rounded to what can be hung before the plan is judged, and joint values go back on their way as far as the rounded
loads need it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from doe.candidates import rounded
from doe.earlier import Earlier
from doe.feasible import screen
from doe.load_settings import as_hung, with_setting
from doe.polish import descend
from doe.pool import Pool
from doe.reach import Reach
from identify.arrays import Floats, Ints
from identify.study import Study

__all__ = ["MovedLoads", "fewer_settings", "most_settings", "move_loads"]

_PARTS = 0.5 ** np.arange(5)  # of the way of the loads that are tried
_BACK = np.linspace(1.0, 0.0, 17)  # of the way of the joint values


@dataclass(frozen=True, eq=False)
class MovedLoads:
    """A plan with other values of its loads, all of which may be hung and measured.

    Attributes:
        pool: The candidates as they are, and the study with the new settings.
        q: (n, joints) joint values as a plan file holds them, rad or m.
        visit_loads: (n, L) loads of that study.
        blocks: (n, k, p).
        iterations: Of the search.
    """

    pool: Pool
    q: Floats
    visit_loads: Ints
    blocks: Floats
    iterations: int


def move_loads(pool: Pool, reach: Reach, q: Floats, visit_loads: Ints) -> MovedLoads | None:
    """Search better values of the loads of a plan.

    Args:
        pool: The candidates, their parameters and the criterion.
        reach: All visits.
        q: (n, joints) joint values, rad or m.
        visit_loads: (n, L) loads of the pool's study.

    Returns:
        The part of the way with the smallest criterion that may be measured, which need not be below that of the given
        plan; None where no part may be.
    """
    study, aim = pool.observer.study, pool.objective
    x, choice = reach.points(study, q, visit_loads)
    shared = _shared(reach, x, visit_loads)
    ended, steps = descend(reach.region, x, choice, aim.target(), aim.criterion, shared, pool.prior)
    best, least = None, np.inf
    for part in _PARTS:
        shares = (x + part * (ended - x))[:, study.robot.n :]
        further, loads = _as_hung(study, reach, shares, choice, visit_loads)
        back = _back(further, pool.earlier, ended[:, : study.robot.n], q, loads)
        if back is None or np.array_equal(loads, visit_loads):
            continue
        blocks = pool.observer.blocks(back, loads, loads=further.loads)[:, :, pool.known.kept]
        value = aim.value(pool.information(blocks))
        if value < least:
            watching = replace(pool.observer, study=further)
            best, least = MovedLoads(replace(pool, observer=watching), back, loads, blocks, steps), value
    return best


def fewer_settings(
    pool: Pool, q: Floats, visit_loads: Ints, value: Callable[[Ints, Floats], float], most: float
) -> tuple[Ints, Floats] | None:
    """Let visits take settings that hang elsewhere in a plan already: where that costs little, or there are too many.

    Too many are more than ``settings_per_load`` of one load.

    Args:
        pool: The candidates; its study holds the loads of the plan.
        q: (n, joints) joint values, rad or m; they stay.
        visit_loads: (n, L).
        value: ``(loads (n, L), blocks (n, k, p)) -> criterion``.
        most: What the criterion may become where there are not too many.

    Returns:
        Loads (n, L) of fewer different settings and their blocks (n, k, p); None where each is needed.
    """
    study, tests, found = pool.observer.study, screen(pool.observer.study), None
    used, visits = np.unique(visit_loads, return_counts=True)
    for old in used[np.argsort(visits, kind="stable")].tolist():
        trials, others = [], _others(study, visit_loads, old)
        for new in others:
            loads = np.where(visit_loads == old, new, visit_loads)
            twice = (np.diff(np.sort(loads, axis=1), axis=1) == 0).any()
            if not twice and tests.check(q, loads).ok.all():
                blocks = pool.observer.blocks(q, loads)[:, :, pool.known.kept]
                trials.append((value(loads, blocks), loads, blocks))
        best = min(trials, key=lambda trial: trial[0], default=None)
        if best is not None and (best[0] <= most or len(others) >= study.plan.settings_per_load):
            visit_loads, found = best[1], best[1:]
    return found


def most_settings(study: Study, visit_loads: Ints) -> int:
    """The largest number of different settings of one load among visits (n, L)."""
    return max((len(_others(study, visit_loads, index)) + 1 for index in np.unique(visit_loads).tolist()), default=0)


def _others(study: Study, visit_loads: Ints, old: int) -> list[int]:
    """Further settings in a plan of the load that ``old`` is a setting of."""
    ranges, used = study.load_ranges, np.unique(visit_loads).tolist()
    span = ranges.get(study.loads[old].name)
    if span is None or old not in used:
        return []
    same = {name for name, other in ranges.items() if other.of == span.of}
    return [index for index in used if index != old and study.loads[index].name in same]


def _shared(reach: Reach, x: Floats, visit_loads: Ints) -> Ints:
    """(n, d) numbers of the variables of a plan: the joint values are its own, visits share those of one setting."""
    space, joints = reach.space, np.arange(x.shape[1]) < reach.space.study.robot.n
    numbers = np.arange(x.size).reshape(x.shape)
    numbers[:, ~joints] = x.size + 4 * visit_loads[:, space.shots] + space.entries
    return numbers


def _as_hung(study: Study, reach: Reach, shares: Floats, choice: Ints, visit_loads: Ints) -> tuple[Study, Ints]:
    """The study with settings at shares (n, v) of visits, rounded, and the loads (n, L) of the visits in it."""
    values, loads, further = reach.space.values(shares, choice), visit_loads.copy(), study
    for old in np.unique(visit_loads[:, np.unique(reach.space.shots)]).tolist():
        span = study.load_ranges.get(study.loads[old].name)
        if span is not None:
            visit, shot = np.argwhere(visit_loads == old)[0]
            further, new = with_setting(further, old, as_hung(study, span, values[visit, shot][None])[0])
            loads[visit_loads == old] = new
    return further, loads


def _back(study: Study, earlier: Earlier, ended: Floats, q: Floats, loads: Ints) -> Floats | None:
    """Joint values (n, joints) on the way from where the search ended to the given ones that may be measured first.

    None where a visit may be measured nowhere on its way.
    """
    tried = rounded(study, q + _BACK[:, None, None] * (ended - q))
    parts, count, joints = tried.shape
    flat = tried.reshape(-1, joints)
    allowed = screen(study).check(flat, np.tile(loads, (parts, 1))).ok & earlier.clear(study, flat)
    good = allowed.reshape(parts, count)
    if not good.any(axis=0).all():
        return None
    back: Floats = tried[good.argmax(axis=0), np.arange(count)]
    return back
