"""Off the grid: move the visits of a plan and its loads, and exchange them with what the columns off the grid offer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from doe.candidates import rounded
from doe.earlier import NOTHING, Earlier
from doe.feasible import joint_range, screen
from doe.guard import guarded_search
from doe.information import information_of, standard_deviations
from doe.moved_loads import fewer_settings, most_settings, move_loads
from doe.objective import Objective
from doe.observations import Observer
from doe.polish import polish
from doe.pool import Pool
from doe.reach import Reach, joined_pool
from doe.refine import Others, Refinement, can_refine, refine
from identify.arrays import Floats, Ints

__all__ = ["OffGrid", "Visits", "off_grid", "others_of", "search_off_grid"]

_EXCHANGES = 3  # with the columns off the grid; one or two are usual
_TURNS = 4  # of loads and joint angles
_HARDLY = 1e-3  # loss that a plan with fewer different poses or settings is worth, and gain that ends the search
_DIFFERENCES = "L-BFGS-B on differences"


@dataclass(frozen=True, eq=False)
class Visits:
    """A plan: joint values (n, joints), loads (n, L) and blocks (n, k, p)."""

    q: Floats
    loads: Ints
    blocks: Floats


@dataclass(frozen=True, eq=False)
class OffGrid:
    """What a search off the grid is made with; ``best`` and ``most`` are standard deviations (p,) or None."""

    pool: Pool
    reach: Reach
    count: int
    seed: int
    best: Floats | None
    most: Floats | None

    def value(self, plan: Visits) -> float:
        """The criterion; infinite for a plan that the study does not allow."""
        information, repeats = self.pool.information(plan.blocks), self.pool.observer.settings.repeats
        blind = self.most is not None and (standard_deviations(information) > self.most * (1.0 + 1e-6)).any()
        twice = not repeats and len(np.unique(plan.q, axis=0)) < len(plan.q)
        return float("inf") if blind or twice else self.pool.objective.value(information)


def search_off_grid(search: OffGrid, chosen: Ints, start: Visits) -> tuple[Visits, Refinement, Pool]:
    """Move a plan off the grid, exchange it with columns off the grid, move it again, and keep the best.

    Args:
        search: What to search with.
        chosen: (n,) candidates of the plan.
        start: The same as visits.

    Returns:
        A plan that is not worse, ``start`` itself if nothing better was found, what moving did, and the pool whose
        study holds the loads of the plan.
    """
    found, refinement = _moved(search, chosen, start)
    best = min((start, found), key=search.value)
    search, best, refinement = _loads_moved(search, chosen, best, refinement)
    first = best, refinement, search.pool
    for _ in range(_EXCHANGES):
        pool = joined_pool(search.pool, search.reach, best.q, best.loads, keep=chosen)
        again, _, _ = guarded_search(pool, search.count, search.seed, search.best, prove=False)
        exchanged = Visits(pool.candidates.visit_q[again], pool.candidates.visit_loads[again], pool.blocks[again])
        further = replace(search, pool=replace(search.pool, observer=pool.observer))
        found, other = _moved(further, again, exchanged)
        better = min((exchanged, found), key=search.value)
        further, better, other = _loads_moved(further, again, better, other)
        if search.value(better) >= search.value(best) * (1.0 - _HARDLY):
            break
        search, best, refinement = further, better, _joined(refinement, other)
    if search.reach.space.open:
        best = _fewer_settings(search, best, search.value(first[0]))
        settings = most_settings(search.pool.observer.study, best.loads)
        if settings > search.pool.observer.settings.settings_per_load or search.value(best) > search.value(first[0]):
            return first
    return best, refinement, search.pool


def _fewer_settings(search: OffGrid, plan: Visits, most: float) -> Visits:
    """The plan with fewer different settings of loads to hang; ``most``: what the criterion may become for that."""
    found = fewer_settings(
        search.pool,
        plan.q,
        plan.loads,
        lambda loads, blocks: search.value(Visits(plan.q, loads, blocks)),
        min(search.value(plan) * (1.0 + _HARDLY), most),
    )
    return plan if found is None else Visits(plan.q, *found)


def _loads_moved(
    search: OffGrid, chosen: Ints, plan: Visits, refinement: Refinement
) -> tuple[OffGrid, Visits, Refinement]:
    """Move the loads of a plan within their ranges and its joint angles in turn, while that gains."""
    for _ in range(_TURNS if search.reach.space.open else 0):
        moved = move_loads(search.pool, search.reach, plan.q, plan.loads)
        if moved is None:
            break
        further, before = replace(search, pool=moved.pool), search.value(plan)
        start = Visits(moved.q, moved.visit_loads, moved.blocks)
        found, other = _moved(further, chosen, start)
        better = min((start, found), key=search.value)
        gained = 1.0 - search.value(better) / before
        if gained > 0.0:
            steps = refinement.iterations + moved.iterations + other.iterations
            search, plan, after = further, better, search.value(better)
            refinement = replace(refinement, q=plan.q, value_after=after, iterations=steps, reason=None)
        if gained <= _HARDLY:
            break
    return search, plan, refinement


def _joined(first: Refinement, second: Refinement) -> Refinement:
    """Two refinements, one after the other; a reason against the first one counts no more if the second gained."""
    return replace(second, value_before=first.value_before, iterations=first.iterations + second.iterations)


def _moved(search: OffGrid, chosen: Ints, plan: Visits) -> tuple[Visits, Refinement]:
    """Move the visits of a plan; it may be no better."""
    pool = search.pool
    watching, kept, aim = pool.observer, pool.known.kept, pool.objective
    if can_refine(watching, aim.criterion) is None:
        q, blocks, refinement = off_grid(
            watching, kept, aim, chosen, plan.q, plan.loads, search.most, others_of(pool.prior), pool.earlier
        )
        return Visits(q, plan.loads, blocks), refinement
    return _polished(search, chosen, plan)


def _polished(search: OffGrid, chosen: Ints, plan: Visits) -> tuple[Visits, Refinement]:
    """Move the visits by differences of their blocks, for effects and criteria without symbolic derivatives."""
    pool, reach = search.pool, search.reach
    watching, kept, aim = pool.observer, pool.known.kept, pool.objective
    x, which = reach.points(watching.study, plan.q, plan.loads)
    ended, steps = polish(reach.held, x, which, aim.target(), aim.criterion, pool.prior)
    ended = ended[:, : watching.study.robot.n]

    def at(q: Floats) -> Visits:
        return Visits(q, plan.loads, watching.blocks(q, plan.loads)[:, :, kept])

    before, tests = search.value(plan), screen(watching.study)
    for share in (1.0, 0.5, 0.25):  # a limit of a standard deviation may end the way early
        q = rounded(watching.study, plan.q + share * (ended - plan.q))
        q = _together(lambda values: aim.value(pool.information(at(values).blocks)), chosen, q)
        moved = at(q)
        allowed = tests.check(q, plan.loads).ok & pool.earlier.clear(watching.study, q)
        if search.value(moved) < before and allowed.all():
            return moved, Refinement(q, before, search.value(moved), steps, _DIFFERENCES)
    reason = "no better plan that keeps all limits was found near this one"
    return plan, Refinement(plan.q, before, before, steps, _DIFFERENCES, reason)


def off_grid(
    observer: Observer,
    kept: Ints,
    aim: Objective,
    chosen: Ints,
    q: Floats,
    loads: Ints,
    most: Floats | None,
    others: Others | None = None,
    earlier: Earlier = NOTHING,
) -> tuple[Floats, Floats, Refinement]:
    """Move the visits of one arm off the grid.

    Args:
        observer: What turns poses of this arm into blocks.
        kept: Kept columns of its model.
        aim: The criterion on all p kept parameters of the plan.
        chosen: (n,) candidate of each visit; repeats of one may end at one pose.
        q: (n, dof) joint values, rad or m.
        loads: (n, L) loads.
        most: (p,) standard deviations that must not be exceeded, or None.
        others: What else belongs to the plan.
        earlier: What it keeps clear of.

    Returns:
        Joint values (n, dof) as a plan file holds them, the blocks (n, k, p) and what was done. They may be no better.
    """

    def blocks(values: Floats) -> Floats:
        own = observer.blocks(values, loads)[:, :, kept]
        return own if others is None else others.spread(own)

    def information(values: Floats) -> Floats:
        own = information_of(blocks(values))
        return own if others is None else own + others.rows.T @ others.rows

    for limit in (None, most):  # most plans keep the limit without being told
        refinement = _refine(observer, kept, aim, q, loads, limit, others, earlier)
        refined = rounded(observer.study, refinement.q)
        refined = _together(lambda values: aim.value(information(values)), chosen, refined)
        if most is None or (standard_deviations(information(refined)) <= most * (1.0 + 1e-6)).all():
            break
    return refined, blocks(refined), refinement


def _refine(
    observer: Observer,
    kept: Ints,
    aim: Objective,
    q: Floats,
    loads: Ints,
    limits: Floats | None,
    others: Others | None,
    earlier: Earlier,
) -> Refinement:
    """Move the joint angles within limits, floor and the parameters' limits; all else is checked on arrival."""
    study = observer.study
    (lower, upper), tests = joint_range(study), screen(study)

    def allowed(moved: Floats) -> np.ndarray:
        arrived = rounded(study, moved)
        return np.asarray(tests.check(arrived, loads).ok & earlier.clear(study, arrived))

    return refine(
        observer,
        q,
        loads,
        kept,
        aim.target(),
        criterion=aim.criterion,
        lower=lower,
        upper=upper,
        floor=study.constraints.floor,
        max_std=limits,
        allowed=allowed,
        others=others,
    )


def _together(value: Callable[[Floats], float], chosen: Ints, q: Floats) -> Floats:
    """Joint values in which repeats of one candidate that hardly parted stand at one pose again."""
    reached = value(q)
    for candidate in np.unique(chosen):
        visits = np.flatnonzero(chosen == candidate)
        tidy = q.copy()
        tidy[visits] = q[visits[0]]
        if len(visits) > 1 and value(tidy) <= reached * (1.0 + _HARDLY):
            q = tidy
    return q


def others_of(prior: Floats | None) -> Others | None:
    """Rows (p, p) that carry the information ``prior``, as what stays beside the moved visits; None without one."""
    if prior is None:
        return None
    scale = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    values, vectors = np.linalg.eigh(prior / scale / scale[:, None])
    rows = (vectors * np.sqrt(np.maximum(values, 0.0))).T * scale
    return Others(rows, np.arange(len(prior)))
