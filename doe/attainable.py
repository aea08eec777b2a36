"""How many directions a number of experiments can show at most, before any plan is searched for.

Each experiment adds the rank of its rows at most, so that too few of them are refused without a search.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from doe.local_search import Limits, fill, make_pool
from doe.problem import Problem
from doe.smooth_criteria import Volume
from identify.arrays import Ints

__all__ = ["most_experiments", "most_rank", "needed_rank", "richest"]

MANY = 2500  # candidates that a rich plan is chosen from


def most_rank(problem: Problem, limits: Limits) -> int:
    """The rank that no plan exceeds: of the prior, and of all rows of as many experiments as the limits allow."""
    size = np.sqrt(np.diag(problem.prior))
    unit = problem.prior / np.outer(*[np.where(size > 0.0, size, 1.0)] * 2)
    known = int(np.linalg.matrix_rank(unit, hermitian=True))
    return known + problem.blocks.k * most_experiments(limits)


def most_experiments(limits: Limits) -> int:
    """How many experiments number and budget allow."""
    count = len(limits.costs) if limits.count is None else limits.count
    if not np.isfinite(limits.budget):
        return count
    if limits.repeats:
        affordable = int(min(limits.budget / limits.costs.min() * (1.0 + 1e-12), 1e9))  # small costs overflow
        return affordable if limits.count is None else min(affordable, count)
    total = np.cumsum(np.sort(limits.costs))
    return min(count, int(np.sum(total <= limits.budget * (1.0 + 1e-12))))


def needed_rank(problem: Problem, target: Any, criterion: str) -> int:
    """The rank without which the criterion is infinite; directions of a target within 1e-6 count as one."""
    if criterion not in {"test_pose", "G"}:
        return len(problem.prior)
    rows = np.asarray(target, dtype=np.float64).reshape(-1, problem.blocks.p)
    unit = rows / np.where(problem.space.norms > 0.0, problem.space.norms, np.inf)
    return int(np.linalg.matrix_rank(unit, tol=1e-6 * float(np.linalg.norm(unit, 2))))


def richest(problem: Problem, limits: Limits) -> Ints:
    """Counts (N,) of a plan that sees as many directions as a greedy choice finds."""
    d = problem.sensitivities(np.eye(len(problem.prior)))  # their information in all
    index = np.sort(np.argsort(-d, kind="stable")[: max(MANY, 0 if limits.repeats else limits.count or 0)])
    unit = np.eye(len(problem.prior))
    pool = replace(make_pool(problem, problem.prior + 1e-6 * unit, index, limits), criterion=Volume(unit))
    plan = fill(pool, pool.plan([]))
    return np.bincount(index[list(plan.members)], minlength=len(problem.blocks))
