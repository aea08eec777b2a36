"""Branch and bound for exact designs on the few candidates that a better plan could hold.

Every node limits the counts to a box and solves the relaxation there; its certificate bounds all plans in
the box. Candidates that no better plan can hold are left out first: a plan with candidate j has, by the
certificate of the whole relaxation, at least a value that grows as d_j falls below the largest d
(Harman and Rosa 2025 use the same idea for D).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from doe.column_generation import Found
from doe.interior_point import Restricted, solve
from doe.local_search import Plan, Pool, fits
from doe.polytope import inner_point, largest_sum
from doe.problem import Problem
from identify.arrays import Floats, Ints

__all__ = ["branch_and_bound", "possible"]

CLOSED = 1e-6  # relative gap at which a node needs no more work


@dataclass(frozen=True, eq=False)
class Node:
    """Plans with ``low <= counts <= high`` (m,), and the centre of their relaxation."""

    low: Ints
    high: Ints
    weights: Floats
    bound: float


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
        self.blocks = np.ascontiguousarray(pool.rows.swapaxes(0, 1))
        self.open: list[tuple[float, int, Node]] = []
        self.left = np.inf  # least bound of nodes that could neither be closed nor split
        self.made = 0
        most = np.floor((1.0 + 1e-9) / shares).astype(np.int64)
        self._add(np.zeros(len(shares), np.int64), most if pool.limits.repeats else np.minimum(most, 1))

    def grow(self, nodes: int) -> None:
        """Split nodes until all are closed or ``nodes`` have been solved."""
        while self.open and self.made < nodes:
            bound, _, node = heapq.heappop(self.open)
            if bound >= self._goal():
                continue
            split = np.abs(node.weights - np.round(node.weights))
            j = int(np.argmax(np.where(node.high > node.low, split, -1.0)))
            if split[j] < 1e-5:
                self.left = min(self.left, bound)
                continue
            down, up = node.high.copy(), node.low.copy()
            down[j] = int(np.floor(node.weights[j]))
            up[j] = down[j] + 1
            self._add(node.low, down)
            self._add(up, node.high)

    def bound(self) -> float:
        """No plan on these candidates has a smaller value."""
        return min(self._goal(), self.left, self.open[0][0] if self.open else np.inf)

    def _goal(self) -> float:
        """A node with this bound is closed."""
        return self.plan.value * (1.0 - CLOSED)

    def _add(self, low: Ints, high: Ints) -> None:
        """Solve a node and keep it if it may hold a better plan."""
        self.made += 1
        total = 1.0 - float(self.shares @ low)
        if total < -1e-9:
            return
        high = np.minimum(high, low + np.floor(max(total, 0.0) * (1.0 + 1e-9) / self.shares + 1e-9).astype(np.int64))
        weights, bound = self._relaxed(low, high, total)
        self._try(low, high, weights)
        if bound < self._goal():
            heapq.heappush(self.open, (bound, self.made, Node(low, high, weights, bound)))

    def _relaxed(self, low: Ints, high: Ints, total: float) -> tuple[Floats, float]:
        """Best fractional counts of a node and their bound."""
        base = self.pool.base + np.tensordot(low.astype(np.float64), self.grams, axes=1)
        free = np.flatnonzero(high > low)
        upper = (high - low)[free] * self.shares[free]
        if upper.sum() <= total + 1e-9:
            whole = base + np.tensordot((high - low).astype(np.float64), self.grams, axes=1)
            return high.astype(np.float64), self.pool.criterion.value(whole)
        blocks = self.blocks[free] / np.sqrt(self.shares[free])[:, None, None]
        problem = Restricted(self.pool.criterion, blocks, base, np.where(upper < total, upper, np.inf), total)
        centre = solve(problem, inner_point(upper, total), None, self._enough)
        weights = low.astype(np.float64)
        weights[free] += centre.weights / self.shares[free]
        return weights, centre.bound

    def _enough(self, value: float, bound: float) -> bool:
        """Stop solving a node: it is closed, or it certainly has to be split."""
        goal = self._goal()
        return bound >= goal or bound >= value * (1.0 - 0.1 * CLOSED) or (value < goal and bound >= value * (1 - 1e-3))

    def _try(self, low: Ints, high: Ints, weights: Floats) -> None:
        """Round the weights of a node to a plan."""
        counts = np.clip(np.floor(weights + 1e-6).astype(np.int64), low, high)
        members = [int(j) for j in np.repeat(np.arange(len(counts)), counts)]
        for j in np.argsort(counts - weights, kind="stable"):
            if counts[j] < high[j] and fits(self.pool, [*members, int(j)]):
                members.append(int(j))
        if fits(self.pool, members, complete=True):
            found = self.pool.plan(members)
            if found.value < self.plan.value * (1.0 - 1e-9):
                self.plan = found
