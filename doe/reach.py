"""What one robot can be measured at beyond its candidates: any joint values that the constraints allow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from doe.ascent import Region
from doe.candidates import Candidates, load_choices, rounded, sampled_range, stops_of
from doe.continuous import Columns, Sample, continuous_columns
from doe.feasible import FEASIBLE, REASONS, Screen, screen
from doe.observations import Observer
from doe.pool import Pool
from identify.arrays import Floats, Ints
from identify.kinematics import forward

__all__ = ["Reach", "joined_pool", "reach_of", "region_of"]

_GAP = 1e-3  # relative, of the estimate: a tenth of what plans differ by
_BESIDE = 2000  # candidates that an exchange looks at beside the columns


@dataclass(frozen=True, eq=False)
class Reach:
    """All poses of a study.

    Attributes:
        region: Blocks on the identifiable parameters and constraints; a choice is a row of ``loads``.
        loads: (C, L) choices of loads of one visit.
        columns: The best relaxed design over them, with the estimated bound.
    """

    region: Region
    loads: Ints
    columns: Columns


def reach_of(pool: Pool, seed: int) -> Reach:
    """Search all poses for what the candidates of a pool miss.

    Args:
        pool: The candidates, their parameters and the criterion.
        seed: Of the starts.
    """
    choices = load_choices(pool.observer.study)
    region = region_of(pool.observer, pool.known.kept, choices)
    which = (pool.candidates.visit_loads[:, None] == choices).all(axis=2).argmax(axis=1)
    grid = Sample(pool.candidates.visit_q, which, pool.blocks)
    aim = pool.objective
    rng = np.random.default_rng(seed)
    columns = continuous_columns(region, grid, aim.target(), aim.criterion, rng, tol=_GAP, executor=pool.executor)
    return Reach(region, choices, columns)


def region_of(observer: Observer, kept: Ints, choices: Ints) -> Region:
    """Blocks and constraints of a study over all joint values.

    Args:
        observer: What turns poses into blocks.
        kept: (p,) kept columns of its model.
        choices: (C, L) choices of loads.
    """
    study, tests = observer.study, screen(observer.study)
    lower, upper = sampled_range(study)
    scale = np.where(study.robot.prismatic, (upper - lower) / 3.0, 1.0)
    scale[list(stops_of(study))] = 0.0

    return Region(partial(_blocks, observer, kept, choices), partial(_excess, tests, choices), lower, upper, scale)


def _blocks(observer: Observer, kept: Ints, choices: Ints, q: Floats, choice: Ints) -> Floats:
    """Blocks (m, k, p) of visits with the loads ``choices[choice]``."""
    return observer.blocks(q, choices[choice])[:, :, kept]


def _excess(tests: Screen, choices: Ints, q: Floats, choice: Ints) -> Floats:
    """How far visits are inside of what they must keep clear of, m; infinite where all else forbids them, or 0."""
    visit_loads = choices[choice]
    codes = np.take_along_axis(tests.codes(q), visit_loads, axis=1).min(axis=1, initial=FEASIBLE)
    excess = np.where(codes == FEASIBLE, 0.0, np.inf)
    for reason, gap in tests.gaps.by_reason.items():
        rows = np.flatnonzero(codes == REASONS.index(reason))
        if len(rows):
            gaps = gap(forward(tests.study.robot, q[rows]))
            gaps = np.broadcast_to(gaps, (len(rows), len(tests.study.loads)))
            excess[rows] = -np.take_along_axis(gaps, visit_loads[rows], axis=1).min(axis=1)
    return np.asarray(excess)


def joined_pool(pool: Pool, reach: Reach, q: Floats, visit_loads: Ints, *, keep: Ints) -> Pool:
    """The columns, some candidates and the visits of a plan as one pool for an exchange.

    Args:
        pool: The candidates.
        reach: The columns; the candidates that tell most beside them are taken too.
        q: (n, joints) of the plan, rad or m.
        visit_loads: (n, L).
        keep: Candidates that are taken in any case.
    """
    study, columns = pool.observer.study, reach.columns
    d = columns.sensitivities(pool.blocks)
    best = np.union1d(np.argsort(-d, kind="stable")[:_BESIDE], keep)
    moved = np.concatenate([rounded(study, columns.found.x), q])
    loads = np.concatenate([reach.loads[columns.found.choice], visit_loads])
    moved, loads = _allowed(reach, moved, loads)
    return _together(pool, best, moved, loads)


def _allowed(reach: Reach, q: Floats, loads: Ints) -> tuple[Floats, Ints]:
    """Visits that may be measured after rounding, each once."""
    first = np.sort(np.unique(np.hstack([q, loads]), axis=0, return_index=True)[1])
    q, loads = q[first], loads[first]
    which = (loads[:, None] == reach.loads).all(axis=2).argmax(axis=1)
    good = reach.region.excess(q, which) <= 0.0
    return q[good], loads[good]


def _together(pool: Pool, best: Ints, q: Floats, loads: Ints) -> Pool:
    """Some candidates of a pool and further visits that are none of these."""
    drawn = pool.candidates
    own = np.hstack([drawn.visit_q[best], drawn.visit_loads[best]])
    further = np.hstack([q, loads])
    known = {row.tobytes() for row in np.ascontiguousarray(own)}
    new = np.array([row.tobytes() not in known for row in np.ascontiguousarray(further)], dtype=bool)
    q, loads = q[new], loads[new]
    blocks = pool.observer.blocks(q, loads)[:, :, pool.known.kept] if len(q) else pool.blocks[:0]
    candidates = Candidates(
        np.concatenate([drawn.visit_q[best], q]),
        np.arange(len(best) + len(q)),
        np.concatenate([drawn.visit_loads[best], loads]),
        drawn.drawn,
        drawn.rejected,
    )
    return replace(pool, candidates=candidates, blocks=np.concatenate([pool.blocks[best], blocks]))
