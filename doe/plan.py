"""The public verb `plan`: from a study to poses and loads, with a proof of how good they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from doe.bounds import Bound, bound_of
from doe.budget import Bought, within_budget
from doe.choice import Choice, choose
from doe.drift import yardstick
from doe.information import covariance_of, information_of
from doe.pool import Pool, build_pool
from doe.purse import prices
from doe.refine import Refinement
from doe.schedule import Schedule, schedule
from doe.tolerance import sufficient
from doe.travel import Free
from identify.arrays import Floats, Ints
from identify.errors import Infeasible, NotIdentifiable
from identify.study import Study

__all__ = ["Plan", "plan", "scheduled_choice"]


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
        notes: What the user should know.
        schedule: The visits in the order of measuring; ``q`` and ``visit_loads`` follow it.
        bought: What it cost of the budget, or None without one.
    """

    pool: Pool
    q: Floats
    visit_loads: Ints
    grid: Bound
    final: Bound
    information: Floats
    refinement: Refinement | None
    notes: tuple[str, ...]
    schedule: Schedule
    bought: Bought | None = None

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def plan(study: Study, *, seed: int = 0, home: Floats | None = None, free: Free | None = None) -> Plan:
    """Pick the poses and loads that minimise the criterion of the study.

    Candidates are drawn over the joint limits; column generation gives the best relaxed design and its
    proven bound; exchange and local search make it a plan of n experiments; the joint angles are then
    moved off the grid, and the visits are put in the order of measuring.

    Args:
        study: The study; its ``[plan]`` says what is wanted.
        seed: Seed of candidates and search.
        home: (joints,) where the robot comes from and goes around obstacles, or None.
        free: Which straight moves between poses are free, or None.

    Raises:
        NotIdentifiable: The criterion needs what no candidate shows, or n is too small.
        Infeasible: No candidate keeps to the constraints, or no plan meets the tolerance or fits into the budget.
    """
    if study.plan.references == "auto":
        return _better(study, partial(plan, seed=seed, home=home, free=free))
    pool = build_pool(study, seed)

    def scheduled(choice: Choice) -> Schedule:
        return scheduled_choice(pool, choice, seed, home=home, free=free)

    bought = None
    if study.plan.budgeted:
        bought = within_budget(pool, seed, scheduled)
        choice = bought.choice
    else:
        choice = sufficient(pool, seed) if study.plan.poses is None else choose(pool, study.plan.poses, seed)
    return _proven(pool, choice, scheduled(choice) if bought is None else bought.schedule, bought)


def scheduled_choice(
    pool: Pool, choice: Choice, seed: int, *, home: Floats | None = None, free: Free | None = None
) -> Schedule:
    """Put the experiments of a choice in the order of measuring.

    Args:
        pool: What it was chosen from.
        choice: The experiments.
        seed: Seed of the search.
        home: (joints,) where the robot comes from and goes around obstacles, or None.
        free: Which moves between poses are free, or None.

    Raises:
        Infeasible: No order avoids moves that are not free.
    """
    covariance = covariance_of(information_of(choice.own))
    measure = yardstick(pool.objective, covariance)
    gain = measure.rows @ covariance
    kept = pool.known.kept
    return schedule(pool.observer, choice.q, choice.visit_loads, kept, gain, measure, seed=seed, home=home, free=free)


def _proven(pool: Pool, choice: Choice, ordered: Schedule, bought: Bought | None) -> Plan:
    """The finished plan, with what is proven about it."""
    aim, plan_of = pool.objective, pool.observer.study.plan
    count, none = len(choice.q), np.zeros(0)
    purse = None if bought is None else bought.purse
    budget = None if purse is None else purse.budget
    price = (
        np.zeros(count)
        if purse is None
        else prices(pool.observer.study, choice.visit_loads, own_visits=pool.observer.own_visits)
    )

    def bound(own: Floats, paid: Floats, value: float) -> Bound:
        costs = None if purse is None else (purse.costs, paid)
        return bound_of(aim, count, pool.blocks, own, value, repeats=plan_of.repeats, costs=costs, budget=budget)

    first = np.unique(ordered.experiment, return_index=True)[1]
    place = ordered.experiment[np.sort(first)]
    grid = bound(pool.blocks[:0], none, aim.value(information_of(choice.grid)))
    information = information_of(choice.own)
    final = grid if choice.own is choice.grid else bound(choice.own[place], price[place], aim.value(information))
    return Plan(
        pool,
        choice.q[place],
        choice.visit_loads[place],
        grid,
        final,
        information,
        choice.refinement,
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
    worth = [len(made.q) if by_size else made.final.value for made in (within, apart)]
    better = apart if worth[1] < worth[0] else within
    told = "own_visits" if better is apart else "same_visit"
    what = f"{max(worth)} experiments" if by_size else f"{max(worth):.5g}"
    note = (
        f'references = "auto" took {told}: the other way needs {what}'
        if by_size
        else (f'references = "auto" took {told}: the other way reaches {what}')
    )
    return replace(better, notes=(*better.notes, note))
