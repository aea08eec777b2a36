"""Branch and bound on what a better plan could hold: closes a small gap between a plan and its bound."""

from __future__ import annotations

import numpy as np

from doe.branch import branch_and_bound, possible
from doe.column_generation import Found
from doe.local_search import Limits, Plan, make_pool
from doe.problem import Problem
from identify.arrays import Ints

__all__ = ["BRANCHED", "RELAXED", "close_gap"]

USUAL = 150  # candidates up to which all nodes are solved; of more, so many fewer that the work stays the same
FEWEST = 150  # nodes; fewer of them raise no bound worth the time
CLOSED = 1e-6  # relative gap that needs no more work
RELAXED, BRANCHED = "relaxation", "branch_and_bound"  # where a bound comes from


def close_gap(
    problem: Problem, found: Found, limits: Limits, plan: Plan, members: Ints, nodes: int
) -> tuple[Ints, float, str]:
    """Raise the bound of a plan, or find a better plan.

    Args:
        problem: The candidates.
        found: Their relaxed design.
        limits: Of the plan.
        plan: The best plan known.
        members: (n,) its candidates.
        nodes: Most nodes to solve.

    Returns:
        Candidates of the best plan, its lower bound and where that comes from.
    """
    if not nodes or found.bound >= plan.value * (1.0 - CLOSED):
        return members, found.bound, RELAXED
    kept = possible(problem, found, plan.value)
    if not len(kept):
        return members, plan.value * (1.0 - CLOSED), BRANCHED
    nodes = min(nodes, nodes * USUAL**2 // len(kept) ** 2)
    if nodes < FEWEST:
        return members, found.bound, RELAXED
    pool = make_pool(problem, problem.prior, kept, limits)
    closed, bound = branch_and_bound(pool, problem.costs[kept], plan, found.bound, nodes)
    if closed is not plan:
        members = np.asarray(pool.index[list(closed.members)])
    return members, bound, BRANCHED if bound > found.bound else RELAXED
