"""The public verb `plan`: from a study to poses and loads, with a proof of how good they are."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from doe.bounds import NODES, Bound, Efficiencies, bound_of, efficiencies
from doe.budget import Bought, within_budget
from doe.choice import Choice, all_poses_count, choose
from doe.design_choices import Decision, decide
from doe.drift import yardstick
from doe.earlier import NOTHING, Earlier
from doe.executor import HERE, Executor
from doe.guard import Guard
from doe.information import covariance_of
from doe.load_settings import with_settings, with_used_first
from doe.moves import free_moves
from doe.pool import Pool, build_pool
from doe.purse import prices
from doe.reach import Reach, reach_of
from doe.refine import Refinement
from doe.robustness import Robustness, robustness, value_that_counts
from doe.schedule import Schedule, schedule
from doe.tolerance import sufficient
from doe.travel import Blocked, Free
from identify.arrays import Floats, Ints
from identify.errors import Infeasible, NotIdentifiable
from identify.study import Study

__all__ = ["Plan", "plan", "scheduled_choice"]

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses and loads to measure.

    Attributes:
        pool: What it was chosen from.
        q: (n, joints) joint values of the experiments, rad or m.
        visit_loads: (n, L) loads of their shots.
        grid: Value and bound before refinement.
        final: Value and bound of this plan, on the candidates and its own poses.
        information: (p, p) of the identifiable parameters.
        refinement: What the refinement did, or None.
        guard: What was weighed into the search.
        robust: What it is worth after losses and at other nominal values; None if not asked for.
        compared: How good the plan is by every criterion; None for no plan at all.
        notes: What the user should know.
        schedule: The visits in the order of measuring; ``q`` and ``visit_loads`` follow it. None without visits.
        bought: What it cost of the budget, or None without one.
        decision: How station and markers were chosen; None where there was no choice.
    """

    pool: Pool
    q: Floats
    visit_loads: Ints
    grid: Bound
    final: Bound
    information: Floats
    refinement: Refinement | None
    guard: Guard
    robust: Robustness | None
    compared: Efficiencies | None
    notes: tuple[str, ...]
    schedule: Schedule | None
    bought: Bought | None = None
    decision: Decision | None = None

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def plan(
    study: Study,
    *,
    seed: int = 0,
    earlier: Earlier = NOTHING,
    home: Floats | None = None,
    free: Free | None = None,
    executor: Executor = HERE,
) -> Plan:
    """Pick the poses and loads that minimise the criterion of the study.

    Candidates are drawn over the joint limits; column generation gives the best relaxed design and its
    proven bound; exchange and local search make it a plan of n experiments. Off the grid, column generation over
    all poses gives further candidates and an estimate of what is best anywhere; the plan is exchanged with them
    and all its joint angles are moved; the visits are put in the order of measuring. Where the study leaves the
    tracker's station or the markers open, they are chosen first. Loads with ranges stand among the candidates in some
    settings, which are moved together with the joint angles.

    Args:
        study: The study; its ``[plan]`` says what is wanted.
        seed: Seed of candidates and search.
        earlier: What was measured, which counts in full beside the ``poses`` that are picked, and poses to keep clear
            of. With a tolerance none may be left to pick.
        home: (joints,) where the robot comes from and goes around obstacles; None: the home of the constraints.
        free: Which straight moves between poses are free; None: what the constraints say, see `doe.schedule`.
        executor: Who does independent pieces of work; the plan does not depend on it.

    Raises:
        NotIdentifiable: The criterion needs what no candidate shows, or n is too small.
        Infeasible: No candidate keeps to the constraints, or no plan meets the tolerance or fits into the budget.
    """
    study, decision = decide(with_settings(study, seed), seed=seed, executor=executor)
    made = partial(_planned, seed=seed, earlier=earlier, home=home, free=free, executor=executor)
    return replace(_better(study, made) if study.plan.references == "auto" else made(study), decision=decision)


def _planned(
    study: Study, *, seed: int, earlier: Earlier, home: Floats | None, free: Free | None, executor: Executor
) -> Plan:
    """The plan of a study that leaves nothing open; of poses in reach from home alone if others are in no order."""
    start = study.constraints.home if home is None else home
    made = partial(_searched, study, seed=seed, home=home, free=free, executor=executor)
    try:
        return made(earlier=earlier)
    except Blocked as error:
        if start is None:
            raise
        log.info("%s. Searching again, among the poses that can be reached from home", error)
        first = error
    moves = partial(free_moves, study) if free is None else free
    again = made(earlier=replace(earlier, reached=partial(_in_reach, moves, start)))
    return replace(again, notes=(*again.notes, _cost_of_reach(again, first)))


def _cost_of_reach(again: Plan, first: Blocked) -> str:
    """What it costs that all poses of a plan can be reached from home, in words."""
    told = (
        "the visits of the best plan are in no order without collisions; this one was searched again among the most "
        "promising poses that the bare arm reaches straight from home"
    )
    if first.value is None or not np.isfinite(first.value):
        return told
    cost = 100.0 * (_reached(again) / first.value - 1.0)
    numbers = "" if len(again.q) == first.count else f", with {len(again.q)} experiments instead of {first.count}"
    return f"{told}, which costs {max(cost, 0.0):.2g} % of the criterion{numbers}"


def _in_reach(moves: Free, start: Floats, q: Floats) -> np.ndarray:
    """(N,) True for poses (N, n) to which the bare arm can go straight."""
    return np.asarray(moves(np.broadcast_to(start, q.shape), q, None), dtype=bool)


def _searched(
    study: Study, *, seed: int, earlier: Earlier, home: Floats | None, free: Free | None, executor: Executor
) -> Plan:
    """The plan of a study that leaves nothing open.

    Raises:
        Blocked: No order of its visits avoids moves that are not free.
    """
    pool = build_pool(study, seed, earlier, executor)

    def scheduled(choice: Choice) -> Schedule | None:
        return scheduled_choice(choice, seed, home=home, free=free) if len(choice.q) else None

    bought = None
    reach = reach_of(pool, seed) if study.plan.refine and all_poses_count(pool) else None
    if study.plan.budgeted:
        bought = within_budget(pool, seed, scheduled)
        choice = bought.choice
    elif study.plan.poses is None:
        choice = sufficient(pool, seed, reach)
    else:
        choice = choose(pool, study.plan.poses, seed, reach)
    choice = replace(choice, pool=_renumbered(choice.pool, choice.visit_loads))
    return _proven(choice, scheduled(choice) if bought is None else bought.schedule, bought, reach)


def _renumbered(pool: Pool, visit_loads: Ints) -> Pool:
    """The pool with settings of loads numbered from 1 for those that a plan uses."""
    watching = pool.observer
    return replace(pool, observer=replace(watching, study=with_used_first(watching.study, np.unique(visit_loads))))


def scheduled_choice(choice: Choice, seed: int, *, home: Floats | None = None, free: Free | None = None) -> Schedule:
    """Put the experiments of a choice in the order of measuring.

    Args:
        choice: The experiments, at least one.
        seed: Seed of the search.
        home: (joints,) where the robot comes from and goes around obstacles; None: the home of the constraints.
        free: Which moves between poses are free; None: what the constraints say.

    Raises:
        Infeasible: No order avoids moves that are not free.
    """
    pool = choice.pool
    covariance = covariance_of(pool.information(choice.own))
    measure = yardstick(pool.objective, covariance)
    try:
        return schedule(
            pool.observer,
            choice.q,
            choice.visit_loads,
            pool.known.kept,
            measure.rows @ covariance,
            measure,
            seed=seed,
            home=home,
            free=free,
        )
    except Blocked as error:
        error.count, error.value = len(choice.q), value_that_counts(pool, choice.q, choice.visit_loads, choice.own)
        raise


def _proven(choice: Choice, ordered: Schedule | None, bought: Bought | None, reach: Reach | None) -> Plan:
    """The finished plan, with what is proven about it; its experiments stand as they are first visited."""
    pool = choice.pool
    study, count = pool.observer.study, len(choice.q)
    purse = None if bought is None else bought.purse
    paid = np.zeros(count)
    if purse is not None:
        paid = prices(study, choice.visit_loads, own_visits=pool.observer.own_visits)

    def bound(own: Floats) -> Bound:
        proven = bound_of(
            pool.objective,
            count,
            pool.blocks,
            own,
            pool.objective.value(pool.information(own)),
            repeats=study.plan.repeats,
            prior=pool.prior,
            costs=None if purse is None else (purse.costs, paid),
            budget=None if purse is None else purse.budget,
            nodes=NODES,
        )
        if reach is None:
            return proven
        return replace(proven, estimate=min(reach.columns.bound / count, proven.bound))

    grid = bound(choice.grid)
    final = grid if choice.own is choice.grid else bound(choice.own)
    place = np.arange(count) if ordered is None else ordered.first_visited
    q, visit_loads, own = choice.q[place], choice.visit_loads[place], choice.own[place]
    return Plan(
        pool,
        q,
        visit_loads,
        grid,
        final,
        pool.information(choice.own),
        choice.refinement,
        choice.guard,
        robustness(pool, q, visit_loads, own),
        efficiencies(pool.objective, pool.blocks, own, repeats=study.plan.repeats) if count else None,
        choice.notes,
        ordered,
        bought,
    )


def _better(study: Study, planned: Callable[[Study], Plan]) -> Plan:
    """Unloaded readings in the visits of the loaded ones, or in visits of their own: the better of both plans."""
    within = planned(replace(study, plan=replace(study.plan, references="same_visit")))
    if within.pool.observer.reference == "differences" or not study.plan.reference_rows:
        return within
    try:
        apart = planned(replace(study, plan=replace(study.plan, references="own_visits")))
    except (Infeasible, NotIdentifiable):  # they do not fit into the budget
        return within
    by_size = study.plan.poses is None and not study.plan.budgeted
    worth = [len(made.q) if by_size else _reached(made) for made in (within, apart)]
    better = apart if worth[1] < worth[0] else within
    told = "own_visits" if better is apart else "same_visit"
    what = f"{max(worth)} experiments" if by_size else f"{max(worth):.5g}"
    note = f'references = "auto" took {told}: the other way {"needs" if by_size else "reaches"} {what}'
    return replace(better, notes=(*better.notes, note))


def _reached(made: Plan) -> float:
    """What the plan was searched for: its value, on average over draws where there are some."""
    return made.final.value if made.robust is None else made.robust.reached.value
