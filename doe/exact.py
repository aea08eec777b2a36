"""Exact design: how often to measure at each candidate, with a proven bound.

The relaxation (`doe.column_generation`) gives the bound and the candidates worth looking at; rounding,
exchange and iterated local search (`doe.local_search`) give the plan; branch and bound (`doe.branch`)
closes the gap where the problem is small enough.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from doe.attainable import most_experiments, most_rank, needed_rank, richest
from doe.closing import close_gap
from doe.column_generation import Found, best_weights
from doe.executor import HERE, Executor
from doe.local_search import Limits, Plan, Pool, exchange, fill, fits, improve_from_all, iterate, make_pool
from doe.problem import Problem, checked_costs, make_problem
from identify.arrays import Ints, frozen
from identify.errors import Infeasible, InputError, NotIdentifiable
from identify.threads import one_thread

__all__ = ["ExactDesign", "exact_design", "kept_regular", "proven_bound"]


@dataclass(frozen=True)
class Effort:
    """How hard to search.

    Attributes:
        rounds: Of the iterated local search.
        nodes: Of branch and bound.
        sweep: Whether to try every exchange with every candidate at the end.
        restarts: Iterated local searches from the same plan, each with random moves of its own.
    """

    rounds: int
    nodes: int
    sweep: bool
    restarts: int = 1


EFFORTS = {"low": Effort(0, 0, False), "normal": Effort(60, 300, True), "high": Effort(300, 5000, True)}
NARROW, BROAD = 250, 2500  # candidates in the pools of the iterated search and of the exchange
LONG = 30  # experiments; longer plans get fewer rounds of search
SWEEPS = 5  # over all candidates at the end; one or two are usual


@dataclass(frozen=True, eq=False)
class ExactDesign:
    """Numbers of measurements and the proof of their quality.

    Attributes:
        counts: (N,) how often each candidate is measured.
        value: The criterion with ``M = sum_i counts_i A_i'A_i + prior``, minimised.
        bound: No allowed counts have a smaller value.
        efficiency: ``bound/value``.
        bound_source: "relaxation" or "branch_and_bound".
    """

    counts: Ints
    value: float
    bound: float
    efficiency: float
    bound_source: str


def exact_design(
    blocks: Any,
    target: Any,
    n: int | None,
    *,
    criterion: str = "test_pose",
    repeats: bool = True,
    costs: Any = None,
    budget: float | None = None,
    prior: Any = None,
    effort: str = "normal",
    seed: int = 0,
    restarts: int = 1,
    prove: bool = True,
    executor: Executor = HERE,
) -> ExactDesign:
    """Best plan of n experiments for ``M = sum_i counts_i A_i'A_i + prior``.

    Args:
        blocks: (N, k, p) whitened observation rows, any float dtype; never changed, never copied whole.
        target: (r, p) rows of the test poses; (t, r, p) for G; ignored by A, D and E.
        n: Number of experiments; None if only the budget limits it.
        criterion: test_pose, A, D, E or G, as in `doe.criteria`.
        repeats: Whether a candidate may be measured more than once.
        costs: (N,) positive, together with ``budget``.
        budget: Largest sum of costs.
        prior: (p, p) information that is there already, in full.
        effort: low, normal or high: how many rounds of search and nodes of branch and bound.
        seed: Of the random moves; same seed, same plan.
        restarts: Iterated local searches, of which the best counts; the first one is the only one of ``restarts=1``.
        prove: Close a small gap by branch and bound, which sometimes finds a better plan too.
        executor: Who does the restarts.

    Returns:
        The plan with its value and a proven bound.

    Raises:
        InputError: A wrong shape or value, or more experiments than candidates without repeats.
        Infeasible: The budget is too small.
        NotIdentifiable: Too few experiments, or candidates that cannot show what the criterion needs.
    """
    if effort not in EFFORTS:
        raise InputError(f"effort is {effort!r}, allowed: {', '.join(EFFORTS)}")
    if isinstance(restarts, bool) or not isinstance(restarts, (int, np.integer)) or restarts < 1:
        raise InputError(f"restarts is {restarts!r}, needed: a whole number of at least 1")
    nodes = EFFORTS[effort].nodes if prove else 0
    asked = replace(EFFORTS[effort], restarts=int(restarts), nodes=nodes)
    with one_thread():
        problem = make_problem(blocks, target, criterion, None, prior, None)
        limits = _checked_limits(n, repeats, costs, budget, len(problem.blocks))
        if most_rank(problem, limits) < needed_rank(problem, target, criterion):
            _value(problem, target, criterion, prior, richest(problem, limits))  # says what is missing
        problem = kept_regular(problem, limits)
        problem, found = _relaxed(problem, limits)
        counts, bound, source = _search(problem, found, limits, asked, np.random.default_rng(seed), executor)
        value = _value(problem, target, criterion, prior, counts)
    bound = min(bound, value)
    return ExactDesign(frozen(counts, np.int64), value, bound, bound / value, source)


def proven_bound(
    blocks: Any, target: Any, members: Ints, *, criterion: str, repeats: bool, nodes: int
) -> tuple[float, str]:
    """Lower bound of all plans of as many experiments as a given one, by branch and bound where that is in reach.

    Args:
        blocks: (N, k, p) whitened observation rows.
        target: As for `exact_design`.
        members: (n,) candidates of the plan, repeats listed repeatedly.
        criterion: test_pose, A, D, E or G.
        repeats: Whether a candidate may be measured more than once.
        nodes: Most nodes of branch and bound; 0 for the relaxation alone.

    Returns:
        The bound and where it comes from: relaxation or branch_and_bound.

    Raises:
        InputError: A wrong shape or value.
        NotIdentifiable: The candidates cannot show what the criterion needs.
    """
    with one_thread():
        problem = make_problem(blocks, target, criterion, None, None, None)
        limits = _checked_limits(len(members), repeats, None, None, len(problem.blocks))
        problem, found = _relaxed(kept_regular(problem, limits), limits)
        own, place = np.unique(members, return_inverse=True)
        pool = make_pool(problem, problem.prior, own, limits)
        _, bound, source = close_gap(problem, found, limits, pool.plan([int(j) for j in place]), members, nodes)
    return bound, source


def _checked_limits(n: Any, repeats: bool, costs: Any, budget: Any, count: int) -> Limits:
    """Limits of the plan, checked.

    Raises:
        InputError: A wrong value, costs without budget or the reverse, or nothing that limits the plan.
        Infeasible: The budget does not pay for any plan.
    """
    if (costs is None) != (budget is None):
        raise InputError("costs and budget belong together: one of them is missing")
    if n is None and budget is None:
        raise InputError("n is None and there is no budget: nothing limits the plan")
    price = checked_costs(costs, count)
    experiments = None if n is None else _checked_count(n)
    if experiments is not None and experiments > count and not repeats:
        raise InputError(f"n = {experiments} experiments without repeats, but only {count} candidates")
    if budget is None:
        return Limits(experiments, np.inf, price, repeats)
    if isinstance(budget, bool) or not isinstance(budget, (int, float, np.number)) or not 0.0 < budget < np.inf:
        raise InputError(f"budget is {budget!r}, needed: a positive finite number")
    least = price.min() if repeats else np.sort(price)[: experiments or 1].mean()
    needed = float(least * (experiments or 1))
    if needed > budget * (1.0 + 1e-12):
        raise Infeasible(f"budget {budget:g} is too small: {experiments or 1} experiments cost at least {needed:g}")
    return Limits(experiments, float(budget), price, repeats)


def _checked_count(n: Any) -> int:
    """Number of experiments as an int.

    Raises:
        InputError: Not a whole number of at least 1.
    """
    try:
        value = -1 if isinstance(n, bool) else operator.index(n)
    except TypeError:
        value = -1
    if value < 1:
        raise InputError(f"n is {n!r}, needed: a whole number of at least 1, or None with a budget")
    return value


def kept_regular(problem: Problem, limits: Limits) -> Problem:
    """Add a trace of the average information, so that small plans have a value; bounds stay bounds.

    A plan of candidates that far outweigh the average needs more, so that its information stays positive definite
    in spite of rounding.
    """
    rank = len(problem.prior)
    count = min(most_experiments(limits), len(problem.blocks))
    largest = float(problem.sensitivities(np.eye(rank)).max()) * count + float(np.trace(problem.prior))
    trace = max(1e-9, 16.0 * np.finfo(np.float64).eps * largest)
    return replace(problem, prior=problem.prior + trace * np.eye(rank))


def _relaxed(problem: Problem, limits: Limits) -> tuple[Problem, Found]:
    """The problem with the share of the effort that each experiment takes as cost, and its best weights.

    With a number and a budget every mixture of the two limits gives a bound; the best of some is taken.
    """
    if limits.count is None or not np.isfinite(limits.budget):
        problem = _with_shares(problem, limits, 0.0 if limits.count is None else 1.0)
        return problem, best_weights(problem, 1e-6)
    tried: dict[float, float] = {}
    centre, width = 0.5, 0.5
    for _ in range(4):
        for mix in (centre - width, centre, centre + width):
            if 0.0 <= mix <= 1.0 and mix not in tried:
                tried[mix] = best_weights(_with_shares(problem, limits, mix), 1e-4).bound
        centre, width = max(tried, key=lambda mix: tried[mix]), 0.5 * width
    problem = _with_shares(problem, limits, centre)
    return problem, best_weights(problem, 1e-6)


def _with_shares(problem: Problem, limits: Limits, mix: float) -> Problem:
    """Shares ``mix/n + (1 - mix) cost/budget``, and caps by what a plan can hold of one candidate."""
    shares = np.zeros(len(problem.blocks))
    most = np.full(len(shares), np.inf if limits.repeats else 1.0)
    if limits.count is not None:
        shares += mix / limits.count
        most = np.minimum(most, limits.count)
    if np.isfinite(limits.budget):
        shares += (1.0 - mix) * limits.costs / limits.budget
        most = np.minimum(most, np.floor(limits.budget / limits.costs * (1.0 + 1e-12)))
    upper = most * shares
    return replace(problem, costs=shares, upper=np.where(upper >= 1.0, np.inf, upper))


def _search(
    problem: Problem, found: Found, limits: Limits, effort: Effort, rng: np.random.Generator, executor: Executor
) -> tuple[Ints, float, str]:
    """Counts (N,), lower bound and its source."""
    weights = found.u / problem.costs
    wide = make_pool(problem, problem.prior, _worth_scoring(problem, found, limits, BROAD), limits)
    rounded = np.flatnonzero(weights >= 1.0 - 1e-6)
    members = np.repeat(rounded, np.floor(weights[rounded] + 1e-6).astype(np.int64))
    plan = fill(wide, wide.plan(wide.find(members)))
    if not fits(wide, list(plan.members), complete=True):  # what was rounded leaves no money for the others
        plan = fill(wide, wide.plan([]))
    plan = exchange(wide, plan)
    plan = _iterated(problem, found, wide, plan, effort, rng, executor)
    for _ in range(SWEEPS if effort.sweep else 0):
        wide, plan, better = improve_from_all(problem, wide, plan)
        if not better:
            break
    chosen = np.asarray(wide.index[list(plan.members)])
    chosen, bound, source = close_gap(problem, found, limits, plan, chosen, effort.nodes)
    return np.bincount(chosen, minlength=len(problem.blocks)), bound, source


def _iterated(
    problem: Problem,
    found: Found,
    wide: Pool,
    plan: Plan,
    effort: Effort,
    rng: np.random.Generator,
    executor: Executor,
) -> Plan:
    """Iterated local searches on the most promising candidates, then an exchange with the wider pool."""
    if not effort.rounds or found.bound >= plan.value * (1.0 - 1e-6):
        return plan
    chosen = wide.index[list(plan.members)]
    index = np.union1d(_worth_scoring(problem, found, wide.limits, NARROW), chosen)
    narrow = make_pool(problem, wide.base, index, wide.limits)
    rounds = -(-effort.rounds * LONG // max(LONG, len(chosen)))  # long plans: dearer rounds, less to gain
    start = narrow.plan(narrow.find(chosen))
    moves = [rng, *rng.spawn(effort.restarts - 1)]
    best = min(executor.map(partial(iterate, narrow, start, rounds), moves), key=lambda each: each.value)
    better = narrow.index[list(best.members)]
    return exchange(wide, wide.plan(wide.find(better)))


def _worth_scoring(problem: Problem, found: Found, limits: Limits, most: int) -> Ints:
    """Candidates with the largest sensitivities, those of the relaxed plan and, with a budget, the cheapest."""
    count = limits.count or 1
    size = min(len(found.d), max(most, 0 if limits.repeats else 2 * count))
    best = np.argsort(-found.d, kind="stable")[:size]
    cheapest = np.argsort(limits.costs, kind="stable")[: count if np.isfinite(limits.budget) else 0]
    used = np.flatnonzero(found.u > 0.0)
    return np.unique(np.concatenate([best, used, cheapest]))


def _value(problem: Problem, target: Any, criterion: str, prior: Any, counts: Ints) -> float:
    """The criterion of the plan itself, in the plan's own row space.

    Raises:
        NotIdentifiable: The plan does not see what the criterion needs.
    """
    chosen = np.repeat(np.flatnonzero(counts), counts[counts > 0])
    try:
        own = make_problem(problem.blocks.array[chosen], target, criterion, None, prior, None)
    except NotIdentifiable as error:
        raise NotIdentifiable(
            f"no plan of {len(chosen)} experiments was found that sees what criterion {criterion} needs "
            f"({error}); allow more experiments",
            error.missing,
        ) from error
    information = own.information(np.arange(len(chosen)), np.ones(len(chosen))) + own.prior
    return own.criterion.value(information)
