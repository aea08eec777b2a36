"""What one robot can be measured at beyond its candidates: any joint values and loads that the constraints allow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from doe.ascent import Region
from doe.candidates import Candidates, load_choices, rounded, sampled_range, stops_of
from doe.column_settings import nearest_settings, with_column_settings
from doe.continuous import Columns, Sample, continuous_columns
from doe.earlier import NOTHING, Earlier
from doe.feasible import FEASIBLE, REASONS, Screen, screen
from doe.hung_frames import Hung, placed
from doe.observations import Observer
from doe.open_loads import LoadSpace, load_space
from doe.pool import Pool
from identify.arrays import Floats, Ints
from identify.study import Study

__all__ = ["Reach", "joined_pool", "reach_of", "region_of"]

_GAP = 1e-3  # relative, of the estimate: a tenth of what plans differ by
_BESIDE = 2000  # candidates that an exchange looks at beside the columns
_SHARE = 0.3  # size of a usual step of what a load leaves open, in parts of its range


@dataclass(frozen=True, eq=False)
class Reach:
    """All visits of a study.

    Attributes:
        region: Blocks on the identifiable parameters and constraints; a point is joint values and shares of what loads
            leave open, a choice one of ``space``.
        space: The loads of visits.
        columns: The best relaxed design over them, with the estimated bound.
    """

    region: Region
    space: LoadSpace
    columns: Columns

    def points(self, study: Study, q: Floats, visit_loads: Ints) -> tuple[Floats, Ints]:
        """Points (n, d) and choices (n,) of visits: joint values (n, joints), rad or m, and loads (n, S) of a study."""
        return _points(self.space, study, q, visit_loads)

    @property
    def held(self) -> Region:
        """The region with loads that stay as they are."""
        joints = np.arange(len(self.region.scale)) < self.space.study.robot.n
        return replace(self.region, scale=np.where(joints, self.region.scale, 0.0))


def reach_of(pool: Pool, seed: int) -> Reach:
    """Search all poses, and all values of loads with ranges, for what the candidates of a pool miss.

    Joint values and loads are searched together: an estimate over the joint values of a few settings would claim too
    much, and settings that follow the joint values in turn get stuck where only both together gain.

    Args:
        pool: The candidates, their parameters and the criterion.
        seed: Of the starts.
    """
    study = pool.observer.study
    space = load_space(study, load_choices(study))
    region = region_of(pool.observer, pool.known.kept, space, pool.earlier)
    grid = Sample(*_points(space, study, pool.candidates.visit_q, pool.candidates.visit_loads), pool.blocks)
    aim = pool.objective
    rng = np.random.default_rng(seed)
    prior = None if pool.prior is None or not study.plan.poses else pool.prior / study.plan.poses
    columns = continuous_columns(
        region, grid, aim.target(), aim.criterion, rng, prior=prior, tol=_GAP, executor=pool.executor
    )
    return Reach(region, space, columns)


def _points(space: LoadSpace, study: Study, q: Floats, visit_loads: Ints) -> tuple[Floats, Ints]:
    """Points (n, d) and choices (n,) of visits."""
    return np.hstack([q, space.shares(study, visit_loads)]), space.choice_of(study, visit_loads)


def region_of(observer: Observer, kept: Ints, space: LoadSpace, earlier: Earlier = NOTHING) -> Region:
    """Blocks and constraints of a study over all joint values and what loads leave open.

    Args:
        observer: What turns poses into blocks.
        kept: (p,) kept columns of its model.
        space: The loads of visits.
        earlier: Poses that could not be measured are kept clear of.
    """
    study, tests = space.study, screen(space.study)
    lower, upper = sampled_range(study)
    scale = np.where(study.robot.prismatic, (upper - lower) / 3.0, 1.0)
    scale[list(stops_of(study))] = 0.0
    shares = np.ones(len(space.shots))

    ends = (np.append(lower, 0.0 * shares), np.append(upper, shares), np.append(scale, _SHARE * shares))
    return Region(
        partial(_blocks, observer, kept, space), partial(_excess, tests, space, Earlier(refused=earlier.refused)), *ends
    )


def _blocks(observer: Observer, kept: Ints, space: LoadSpace, x: Floats, choice: Ints) -> Floats:
    """Blocks (m, k, p) of points."""
    n = space.study.robot.n
    if not space.open:
        return observer.blocks(x, space.choices[choice])[:, :, kept]
    visit_loads, loads = space.loads(x[:, n:], choice)
    return observer.blocks(x[:, :n], visit_loads, loads=loads)[:, :, kept]


def _excess(tests: Screen, space: LoadSpace, earlier: Earlier, x: Floats, choice: Ints) -> Floats:
    """How far points are beyond what is allowed, (m,), see `_overshoot`; infinite beside poses that were refused."""
    n, visit_loads = space.study.robot.n, space.choices[choice]
    groups = space.hung(x[:, n:], choice) if space.open else [(slice(None), None)]
    parts = [_overshoot(tests, x[:, :n], visit_loads[:, shots], hung) for shots, hung in groups]
    return np.where(earlier.clear(space.study, x[:, :n]), np.max(parts, axis=0), np.inf)


def _overshoot(tests: Screen, q: Floats, visit_loads: Ints, hung: Hung | None) -> Floats:
    """How far visits are inside of what they must keep clear of, m, or beyond what may be carried, by share.

    Infinite where all else forbids them, or 0.
    """
    codes = np.take_along_axis(tests.codes(q, hung), visit_loads, axis=1).min(axis=1, initial=FEASIBLE)
    excess = np.where(codes == FEASIBLE, 0.0, np.inf)
    for reason, gap in tests.overshoots.items():
        rows = np.flatnonzero(codes == REASONS.index(reason))
        if len(rows):
            beyond = gap(placed(tests.study.robot, q[rows], None if hung is None else hung.taken(rows)))
            beyond = np.broadcast_to(beyond, (len(rows), len(tests.study.loads)))
            excess[rows] = np.take_along_axis(beyond, visit_loads[rows], axis=1).max(axis=1)
    return np.asarray(excess)


def joined_pool(pool: Pool, reach: Reach, q: Floats, visit_loads: Ints, *, keep: Ints) -> Pool:
    """The columns, some candidates and the visits of a plan as one pool for an exchange.

    A column takes that setting of its load which comes nearest, out of those of the plan and a few that the best
    columns ask for; these stand in the study of the new pool.

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
    moved = np.concatenate([rounded(study, columns.found.x[:, : study.robot.n]), q])
    hung = reach.space.choices[columns.found.choice]
    if reach.space.open:
        study, asked = with_column_settings(study, reach.space, columns)
        hung = nearest_settings(study, reach.space, columns, np.union1d(asked, visit_loads))
        pool = replace(pool, observer=replace(pool.observer, study=study))
    moved, loads = _allowed(reach, study, moved, np.concatenate([hung, visit_loads]))
    return _together(pool, best, moved, loads)


def _allowed(reach: Reach, study: Study, q: Floats, loads: Ints) -> tuple[Floats, Ints]:
    """Visits that may be measured after rounding, each once, and none that reads a load twice."""
    first = np.sort(np.unique(np.hstack([q, loads]), axis=0, return_index=True)[1])
    q, loads = q[first], loads[first]
    good = reach.region.excess(*reach.points(study, q, loads)) <= 0.0
    good &= (np.diff(np.sort(loads, axis=1), axis=1) > 0).all(axis=1)
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
