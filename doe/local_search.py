"""Local search for exact designs: greedy filling, exchange, and iterated local search.

One step of the exchange takes one experiment out and puts the best candidate in, scored for all candidates
of a pool at once by low-rank updates (Fedorov 1972; Cook and Nachtsheim, Technometrics 22, 1980). The iterated
search spoils a few experiments at random and exchanges again (Lourenco, Martin and Stuetzle 2003).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.criteria import Criterion
from doe.problem import Problem
from identify.arrays import Floats, Ints

__all__ = ["Limits", "Plan", "Pool", "exchange", "fill", "fits", "improve_from_all", "iterate", "make_pool"]

BETTER = 1.0 - 1e-9  # a smaller relative gain is rounding
WIDE = 200  # experiments tried per round; more are tried weakest first
LONGEST = 50  # exchanges per experiment of a plan; usual are one or two


@dataclass(frozen=True, eq=False)
class Limits:
    """What a plan may hold.

    Attributes:
        count: Number of experiments, or None if only the budget limits it.
        budget: Sum of costs, infinite if there is none.
        costs: (N,) costs.
        repeats: Whether a candidate may be measured more than once.
    """

    count: int | None
    budget: float
    costs: Floats
    repeats: bool


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates held in memory for scoring.

    Attributes:
        criterion: What to minimise.
        base: (p, p) prior and a trace of the average information, which keeps small plans regular.
        index: (m,) numbers of the candidates, increasing.
        rows: (k, m, p) their blocks in row-space coordinates, row by row.
        costs: (m,) of the candidates.
        limits: Of the plan.
    """

    criterion: Criterion
    base: Floats
    index: Ints
    rows: Floats
    costs: Floats
    limits: Limits

    def gram(self, j: int) -> Floats:
        """Information of the candidate at position ``j``."""
        rows = self.rows[:, j]
        result: Floats = rows.T @ rows
        return result

    def find(self, candidates: Ints) -> list[int]:
        """Positions of candidates that are in the pool."""
        return [int(j) for j in np.searchsorted(self.index, candidates)]

    def plan(self, members: list[int]) -> Plan:
        """A plan of pool members, with its information and value; both depend on the members alone, to the last bit.

        Information that a search carries along collects rounding errors instead. Where it is nearly singular they
        decide the value: an exchange would gain from them again and again, without end.
        """
        distinct, counts = np.unique(np.array(members, dtype=np.int64), return_counts=True)
        flat = (self.rows[:, distinct] * np.sqrt(counts)[:, None]).reshape(-1, len(self.base))
        information = self.base + flat.T @ flat
        return Plan(tuple(members), information, self.criterion.value(information))


@dataclass(frozen=True, eq=False)
class Plan:
    """Experiments of a plan, repeats listed repeatedly.

    Attributes:
        members: Positions in the pool.
        information: (p, p) of the experiments and the pool's base.
        value: The criterion.
    """

    members: tuple[int, ...]
    information: Floats
    value: float


def make_pool(problem: Problem, base: Floats, index: Ints, limits: Limits) -> Pool:
    """Hold the candidates ``index`` in memory with as few rows as they need."""
    rows = _compressed(problem.blocks.take(index, problem.space.basis))
    return Pool(problem.criterion, base, index, rows, limits.costs[index], limits)


def fill(pool: Pool, plan: Plan, per_cost: bool = False) -> Plan:
    """Add the best candidate again and again until nothing more may be added."""
    while (best := _additions(pool, plan)) is not None:
        plan = pool.plan([*plan.members, best[1] if per_cost else best[0]])
    return plan


def _additions(pool: Pool, plan: Plan) -> tuple[int, int] | None:
    """The candidate that gains most, and the one that gains most for its cost; None where nothing may be added."""
    allowed = _allowed(pool, plan.members)
    if not allowed.any():
        return None
    open_ = np.flatnonzero(allowed)
    rows = pool.rows if len(open_) == len(allowed) else pool.rows[:, open_]
    values = pool.criterion.after_adding(plan.information, rows)
    best = int(np.argmin(values))
    if not np.isfinite(pool.limits.budget):
        return int(open_[best]), int(open_[best])
    score = np.log(np.maximum(values, 1e-300) / plan.value) / pool.costs[open_]
    return int(open_[best]), int(open_[np.argmin(score)])


def exchange(pool: Pool, plan: Plan) -> Plan:
    """Exchange single experiments until none can be improved, `LONGEST` times their number at most."""
    waiting, left = _order(pool, plan), LONGEST * (len(plan.members) + 1)
    while waiting and left:
        out = waiting.pop(0)
        if out not in plan.members:
            continue
        better = _replaced(pool, plan, out)
        if better.value < plan.value * BETTER:
            plan, left = better, left - 1
            waiting = [*waiting, *(j for j in _order(pool, plan) if j not in waiting)]
    return plan


def iterate(pool: Pool, plan: Plan, rounds: int, rng: np.random.Generator) -> Plan:
    """Spoil a few experiments, exchange, keep the better plan; ``rounds`` times."""
    best = current = plan
    for _ in range(rounds):
        spoilt = _spoilt(pool, current, rng)
        if spoilt is None:
            return best
        found = exchange(pool, spoilt)
        if found.value < current.value * (1.0 + 2e-3):
            current = found
        if found.value < best.value * BETTER:
            best = current = found
    return best


def improve_from_all(problem: Problem, pool: Pool, plan: Plan) -> tuple[Pool, Plan, bool]:
    """Try every exchange with every candidate there is, not only those of the pool.

    Returns:
        The pool with the candidates found, the plan after them, and whether anything was found. If nothing
        was, the plan is proven to be optimal against all exchanges of the experiments tried.
    """
    found: list[int] = []
    for out in _order(pool, plan):
        rest = _without(pool, plan, out).information
        factor, threshold = problem.criterion.prospect(rest, plan.value * BETTER)
        d = problem.blocks.sensitivities(problem.space.basis @ factor)
        d[pool.index] = 0.0
        hopeful = np.flatnonzero(d > threshold)
        for start in range(0, len(hopeful), 2048):
            part = hopeful[start : start + 2048]
            rows = _compressed(problem.blocks.take(part, problem.space.basis))
            values = problem.criterion.after_adding(rest, rows)
            if values.min() < plan.value * BETTER:
                found.append(int(part[int(np.argmin(values))]))
    if not found:
        return pool, plan, False
    larger = make_pool(problem, pool.base, np.union1d(pool.index, found), pool.limits)
    return larger, exchange(larger, larger.plan(larger.find(pool.index[list(plan.members)]))), True


def fits(pool: Pool, members: list[int], complete: bool = False) -> bool:
    """True if the plan keeps the limits; ``complete``: also the number of experiments."""
    limits = pool.limits
    count_fits = limits.count is None or (len(members) == limits.count if complete else len(members) <= limits.count)
    within = float(pool.costs[members].sum()) <= limits.budget * (1.0 + 1e-12)
    return count_fits and within and (limits.repeats or len(set(members)) == len(members))


def _without(pool: Pool, plan: Plan, out: int) -> Plan:
    """A plan after taking out one experiment."""
    members = list(plan.members)
    members.remove(out)
    return pool.plan(members)


def _order(pool: Pool, plan: Plan) -> list[int]:
    """Distinct experiments, least useful first; only the first ones of a very long plan."""
    distinct = np.unique(plan.members)
    if len(distinct) <= WIDE:
        return [int(j) for j in distinct]
    factor, _ = pool.criterion.prospect(plan.information, plan.value)
    d = np.einsum("kmq,kmq->m", pool.rows[:, distinct] @ factor, pool.rows[:, distinct] @ factor)
    return [int(j) for j in distinct[np.argsort(d, kind="stable")[:WIDE]]]


def _replaced(pool: Pool, plan: Plan, out: int) -> Plan:
    """The best plan after taking out one experiment and filling up again."""
    rest = _without(pool, plan, out)
    first = _additions(pool, rest)  # both ways begin with the same scores, and often with the same candidate
    if first is None:
        return rest
    best = fill(pool, pool.plan([*rest.members, first[0]]))
    more = len(best.members) > len(rest.members) + 1 and np.ptp(pool.costs) > 0.0
    if first[1] != first[0] or (np.isfinite(pool.limits.budget) and more):
        other = fill(pool, pool.plan([*rest.members, first[1]]), per_cost=True)
        best = other if other.value < best.value else best
    return best


def _spoilt(pool: Pool, plan: Plan, rng: np.random.Generator) -> Plan | None:
    """Take a few random experiments out and put random ones in; None for an empty plan."""
    if not plan.members:
        return None
    some = min(len(plan.members), int(rng.integers(2, 5)))
    out = set(rng.choice(len(plan.members), some, replace=False).tolist())
    members = [j for i, j in enumerate(plan.members) if i not in out]
    for _ in range(some):
        allowed = np.flatnonzero(_allowed(pool, tuple(members)))
        if len(allowed):
            members.append(int(rng.choice(allowed)))
    return fill(pool, pool.plan(members))


def _allowed(pool: Pool, members: tuple[int, ...]) -> np.ndarray:
    """Which candidates may be added to the plan so that it can still be completed."""
    limits = pool.limits
    allowed = np.ones(len(pool.index), dtype=bool)
    if not limits.repeats:
        allowed[list(members)] = False
    left = None if limits.count is None else limits.count - len(members)
    if left is not None and left <= 0:
        return np.zeros(len(pool.index), dtype=bool)
    if np.isfinite(limits.budget):
        money = limits.budget * (1.0 + 1e-12) - float(pool.costs[list(members)].sum())
        if left is not None and left > 1:
            cheapest = np.sort(pool.costs[allowed])
            money -= (left - 1) * cheapest[0] if limits.repeats else float(cheapest[: left - 1].sum())
        allowed &= pool.costs <= money
    return allowed


def _compressed(blocks: Floats) -> Floats:
    """The same information in as few rows as possible: (m, k, p) -> (k', m, p).

    The rows are turned by the eigenvectors of ``A A'``, which is exact; rows without information fall away.
    """
    if blocks.shape[1] == 1 or not len(blocks):
        return np.ascontiguousarray(blocks.swapaxes(0, 1))
    values, vectors = np.linalg.eigh(blocks @ blocks.swapaxes(1, 2))
    count = int(np.sum(values > 1e-14 * np.maximum(values[:, -1:], 1e-300), axis=1).max())
    count = max(1, min(count, blocks.shape[2]))
    turned = vectors[:, :, -count:].swapaxes(1, 2) @ blocks
    return np.ascontiguousarray(turned.swapaxes(0, 1))
