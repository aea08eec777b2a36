"""Branch and bound for exact designs on the few candidates that a better plan could hold.

Every node limits the counts to a box (`doe.boxes`) and solves the relaxation there; its certificate bounds all plans
in the box. Candidates that no better plan can hold are left out first: a plan with candidate j has, by the
certificate of the whole relaxation, at least a value that grows as d_j falls below the largest d
(Harman and Rosa 2025 use the same idea for D).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from doe.boxes import Box, Relaxed, relax
from doe.column_generation import Found
from doe.local_search import Plan, Pool, fits
from doe.polytope import largest_sum
from doe.problem import Problem
from identify.arrays import Floats, Ints

__all__ = ["branch_and_bound", "possible"]

CLOSED = 1e-6  # relative gap at which a node needs no more work
NEAR = 1e-4  # gap to which a node is solved that has to be split anyway
TRIAL, HOPE, MANY = 50, 0.15, 300  # after so many nodes this share of the gap must be closed; less with more nodes


@dataclass(frozen=True, eq=False)
class Node:
    """A box that may hold a better plan, and the candidate and count at which to split it."""

    box: Box
    fork: tuple[int, int]


def possible(problem: Problem, found: Found, value: float) -> Ints:
    """Numbers of the candidates that a plan better than ``value`` could hold."""
    certificate, q = found.certificate, problem.costs
    fixed = float(np.sum((problem.prior @ certificate.factor) * certificate.factor))
    # one count of j takes the share q_j, and the rest gains no more than the best use of what is left
    shares, which = np.unique(q, return_inverse=True)
    if len(shares) > 1000:
        shares, which = shares[:1], np.zeros(len(q), dtype=np.int64)
    rest = np.array([largest_sum(found.d, problem.upper, max(1.0 - share, 0.0)) for share in shares])
    top = rest[which] + q * found.d + fixed
    return np.flatnonzero(certificate.numerator < (1.0 - 1e-7) * value * top)


def branch_and_bound(pool: Pool, shares: Floats, plan: Plan, bound: float, nodes: int) -> tuple[Plan, float]:
    """Search the plans on the candidates of a pool.

    Args:
        pool: The candidates that a better plan could hold.
        shares: (m,) part of the effort that one count takes; the counts' shares sum to at most 1.
        plan: The best plan known, on the same pool or any other.
        bound: Lower bound known.
        nodes: Most nodes to solve.

    Returns:
        The best plan (``plan`` itself if none better was found) and a lower bound of all plans.
    """
    tree = _Tree(pool, shares, plan)
    tree.grow(nodes)
    return tree.plan, max(bound, tree.bound())


class _Tree:
    """Open nodes, best bound first, and the best plan."""

    def __init__(self, pool: Pool, shares: Floats, plan: Plan) -> None:
        self.pool, self.shares, self.plan = pool, shares, plan
        self.grams = np.einsum("kmi,kmj->mij", pool.rows, pool.rows, optimize=True)
        self.open: list[tuple[float, int, Node]] = []
        self.made = 0
        most = np.floor((1.0 + 1e-9) / shares).astype(np.int64)
        self._add(Box(np.zeros(len(shares), np.int64), most if pool.limits.repeats else np.minimum(most, 1)))

    def grow(self, nodes: int) -> None:
        """Split nodes until all are closed, ``nodes`` have been solved, or the first ones hardly raise the bound."""
        start, hope = self._gap(), min(HOPE, HOPE * MANY / nodes)
        while self.open and self.made < nodes:
            if TRIAL <= self.made < TRIAL + 2 and self._gap() > (1.0 - hope) * start:
                break
            bound, _, node = heapq.heappop(self.open)
            if bound >= self._goal():
                continue
            for part in node.box.split(*node.fork):
                self._add(part)

    def _gap(self) -> float:
        """Relative gap between the best plan and the bound."""
        return 1.0 - self.bound() / self.plan.value

    def bound(self) -> float:
        """No plan on these candidates has a smaller value."""
        return min(self._goal(), self.open[0][0] if self.open else np.inf)

    def _goal(self) -> float:
        """A node with this bound is closed."""
        return self.plan.value * (1.0 - CLOSED)

    def _add(self, box: Box) -> None:
        """Solve a node and keep it if it may hold a better plan."""
        self.made += 1
        relaxed = relax(self.pool, self.grams, self.shares, box, self._enough)
        if relaxed is None:
            return
        self._try(relaxed)
        if relaxed.bound >= self._goal() or not np.any(box.high > box.low):
            return
        rest = relaxed.tightened(self._goal())
        fork = relaxed.fork(rest)
        if fork is None:
            self._add(rest)  # one plan at most is left
        else:
            heapq.heappush(self.open, (relaxed.bound, self.made, Node(rest, fork)))

    def _enough(self, value: float, bound: float) -> bool:
        """Stop solving a node: it is closed, or it certainly has to be split."""
        goal = self._goal()
        near = value < goal and bound >= value * (1.0 - NEAR)
        return near or bound >= goal or bound >= value * (1.0 - 0.1 * CLOSED)

    def _try(self, relaxed: Relaxed) -> None:
        """Round the counts of a node to a plan."""
        weights, low, high = relaxed.counts, relaxed.box.low, relaxed.box.high
        counts = np.clip(np.floor(weights + 1e-6).astype(np.int64), low, high)
        members = [int(j) for j in np.repeat(np.arange(len(counts)), counts)]
        for j in np.argsort(counts - weights, kind="stable"):
            if counts[j] < high[j] and fits(self.pool, [*members, int(j)]):
                members.append(int(j))
        if fits(self.pool, members, complete=True):
            found = self.pool.plan(members)
            if found.value < self.plan.value * (1.0 - 1e-9):
                self.plan = found
