"""Plans in a box ``low <= counts <= high``: their relaxation, what its certificate rules out, where to split.

The certificate of a box bounds all its plans, and with one count more or less that bound rises by what the sensitivity
of that candidate lacks or exceeds; counts for which it rises above the best plan known leave the box (reduced cost
fixing, Dantzig, Fulkerson and Johnson 1954). A box is split where a count is fractional and stiff: where it can only
change at the cost of the criterion, not by handing its weight over to a candidate that is much the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from doe.interior_point import Centre, Restricted, solve
from doe.local_search import Pool
from doe.polytope import inner_point, marginal_value
from identify.arrays import Floats, Ints

__all__ = ["Box", "Relaxed", "relax"]

WHOLE = 1e-5  # a count this close to a whole number is one


@dataclass(frozen=True, eq=False)
class Box:
    """Limits (m,) of the counts."""

    low: Ints
    high: Ints

    def split(self, j: int, below: int) -> tuple[Box, Box]:
        """Plans with at most ``below`` of candidate ``j``, and those with more."""
        down, up = self.high.copy(), self.low.copy()
        down[j], up[j] = below, below + 1
        return Box(self.low, down), Box(up, self.high)


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The best fractional counts of a box.

    Attributes:
        box: The box, already without counts that cannot sum up to a plan.
        counts: (m,) fractional.
        bound: No plan in the box has a smaller value.
        shares: (m,) part of the effort that one count takes.
        free: Candidates whose counts are not fixed; none where all of them are at their highest.
        problem: Of the free candidates.
        centre: Its solution.
    """

    box: Box
    counts: Floats
    bound: float
    shares: Floats
    free: Ints
    problem: Restricted | None = None
    centre: Centre | None = None

    def tightened(self, goal: float) -> Box:
        """The part of the box that holds its plans with a value below ``goal``."""
        low, high = self.box.low.copy(), self.box.high.copy()
        if self.problem is None or self.centre is None:
            return Box(low, high)
        d, factor, share = self.centre.d, self.centre.certificate.factor, self.shares[self.free]
        level = marginal_value(d, self.problem.upper, self.problem.total)
        fixed = float(np.sum((self.problem.base @ factor) * factor))
        most = level * self.problem.total + float(np.maximum(d - level, 0.0) @ ((high - low)[self.free] * share))
        spare = max((most + fixed) * (1.0 + 1e-12) - self.centre.certificate.numerator / goal, 0.0)
        each, width = np.abs(d - level) * share, (high - low)[self.free]
        whole = np.floor(spare / np.maximum(each, max(spare, 1e-300) / width) + 1e-9).astype(np.int64)
        reached, left = low[self.free] + whole, high[self.free] - whole
        high[self.free] = np.where(d < level, reached, high[self.free])
        low[self.free] = np.where(d > level, left, low[self.free])
        return Box(low, high)

    def fork(self, box: Box) -> tuple[int, int] | None:
        """Candidate and count at which to split a part of the box; None if there is nothing to split."""
        below = np.clip(np.floor(self.counts + WHOLE), box.low, box.high - 1)
        away = np.minimum(np.abs(self.counts - below), np.abs(self.counts - below - 1.0))
        open_ = box.high > box.low
        score = np.where(open_, box.high - box.low, 0.0)  # whole counts that are no plan: wherever there is a choice
        fractional = open_ & (away >= WHOLE)
        if fractional.any() and self.problem is not None and self.centre is not None:
            score = np.zeros(len(away))
            score[self.free] = (self.shares[self.free] * away[self.free]) ** 2 * _stiffness(self.problem, self.centre)
            score = np.where(fractional, score, 0.0)
        best = int(np.argmax(score))
        return (best, int(below[best])) if open_[best] else None


def relax(pool: Pool, grams: Floats, shares: Floats, box: Box, done: Callable[[float, float], bool]) -> Relaxed | None:
    """Relaxation of a box; None where it holds no plan.

    Args:
        pool: The candidates.
        grams: (m, p, p) their information.
        shares: (m,) part of the effort that one count takes; those of a plan sum to at most 1.
        box: Of the counts.
        done: Called with value and bound: whether the relaxation is solved well enough.
    """
    total = 1.0 - float(shares @ box.low)
    if total < -1e-9 or np.any(box.high < box.low):
        return None
    room = np.floor(max(total, 0.0) * (1.0 + 1e-9) / shares + 1e-9).astype(np.int64)
    low, high = box.low, np.minimum(box.high, box.low + room)
    base = pool.base + np.tensordot(low.astype(np.float64), grams, axes=1)
    free = np.flatnonzero(high > low)
    upper = (high - low)[free] * shares[free]
    if upper.sum() <= total + 1e-9:
        whole = base + np.tensordot((high - low).astype(np.float64), grams, axes=1)
        return Relaxed(Box(low, high), high.astype(np.float64), pool.criterion.value(whole), shares, free[:0])
    blocks = np.ascontiguousarray(pool.rows[:, free].swapaxes(0, 1)) / np.sqrt(shares[free])[:, None, None]
    problem = Restricted(pool.criterion, blocks, base, np.where(upper < total, upper, np.inf), total)
    centre = solve(problem, inner_point(upper, total), None, done)
    counts = low.astype(np.float64)
    counts[free] += centre.weights / shares[free]
    return Relaxed(Box(low, high), counts, centre.bound, shares, free, problem, centre)


def _stiffness(problem: Restricted, centre: Centre) -> Floats:
    """What it costs to second order to move each weight (m,) by one unit while the others give way."""
    information = problem.base + np.einsum("m,mki,mkj->ij", centre.weights, problem.blocks, problem.blocks)
    room = problem.upper - centre.weights
    scale = np.minimum(centre.weights, room)
    rows = problem.criterion.local(information, centre.mu, None).curvature(problem.blocks) * scale[:, None]
    system = rows @ rows.T
    barrier = centre.mu * ((scale / centre.weights) ** 2 + (scale / room) ** 2)
    system[np.diag_indices(len(scale))] += barrier + 1e-14 * np.trace(system)
    inverse = np.linalg.inv(system)
    along = inverse @ scale
    play = (np.diag(inverse) - along**2 / (scale @ along)) * scale**2
    stiffness: Floats = 1.0 / np.maximum(play, 1e-14 * scale**2 * np.diag(inverse))
    return stiffness
