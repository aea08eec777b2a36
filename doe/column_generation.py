"""Column generation: an interior-point method on a few candidates, a pass over all of them, and again.

The few free candidates get their best weights (`doe.interior_point`), all others stay at zero or at their
cap. One pass over all candidates proves how far this is from the optimum of the whole problem and finds the
candidates that would improve it; these become free, and those that got no weight, or all of it, do not.

Very many candidates are first thinned out, then only the most promising few percent are searched until nothing is
left to do there; a pass over all candidates says which are promising then, and proves the bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.criteria import Certificate
from doe.interior_point import Centre, Restricted, solve
from doe.polytope import inner_point, marginal_value
from doe.problem import Problem
from identify.arrays import Floats, Ints

__all__ = ["Found", "best_weights"]

PASSES = 100  # over all candidates; ten are usual
MANY = 1 << 22  # numbers in all blocks from which the search is confined to a part of the candidates
SHARE = 31  # one in so many candidates makes the part; a prime, as candidates may come in turns
ROUGH = 0.01  # gap on the first part, which says little about the whole


@dataclass(frozen=True, eq=False)
class Found:
    """Weights and what proves them.

    Attributes:
        u: (N,) weights of the scaled problem.
        certificate: At these weights.
        d: (N,) sensitivities of the certificate.
        bound: Of the whole problem.
        passes: Over all candidates.
    """

    u: Floats
    certificate: Certificate
    d: Floats
    bound: float
    passes: int

    @property
    def gap(self) -> float:
        """``1 - bound/value``."""
        return 1.0 - self.bound / self.certificate.value


def best_weights(problem: Problem, tol: float, passes: int = PASSES) -> Found:
    """Solve a checked problem until the proven gap is at most ``tol`` or cannot be closed further in so many passes.

    Where the caps do not reach the sum 1, the best is to put every weight at its cap.
    """
    if problem.room <= 1.0 + 1e-9:
        return _only_point(problem)
    thin = np.arange(0, len(problem.costs), SHARE)
    if problem.blocks.array.size < MANY or not _stands_for_all(problem.part(thin)):
        return _Search(problem).run(tol, passes)
    return _by_parts(problem, thin, tol, passes)


def _stands_for_all(part: Problem) -> bool:
    """Whether a part of the candidates leaves a choice and sees about all that the whole sees."""
    count = len(part.costs)
    seen = part.information(np.arange(count), np.full(count, part.costs.mean() / count)) + part.prior
    return part.room > 2.0 and bool(np.linalg.eigvalsh(seen)[0] > 0.01)


def _by_parts(problem: Problem, thin: Ints, tol: float, passes: int) -> Found:
    """Search a part, pass over all, search the best of them, until the gap of the whole is at most ``tol``."""
    part, search = thin, _Search(problem.part(thin))
    found = search.run(max(ROUGH, tol), PASSES)
    best = whole = _on_all(problem, part, found, 1)
    for number in range(2, passes + 1):
        if best.gap <= tol or (number > 2 and found.gap > tol):  # not even the part can be solved better
            break
        used = np.union1d(part[search.u > 0.0], part[search.free])
        chosen = np.union1d(used, np.argpartition(-whole.d, len(thin))[: len(thin)])
        search.move(problem.part(chosen), part, chosen, whole)
        found = search.run(0.5 * tol, PASSES)
        part, whole = chosen, _on_all(problem, chosen, found, number)
        best = whole if whole.gap < best.gap else best
    return best


def _on_all(problem: Problem, part: Ints, found: Found, passes: int) -> Found:
    """What was found on a part, as weights and bound of the whole."""
    u = np.zeros(len(problem.costs))
    u[part] = found.u
    d = problem.sensitivities(found.certificate.factor)
    bound = min(problem.bound(found.certificate, d), found.certificate.value)
    return Found(u, found.certificate, d, bound, passes)


def _only_point(problem: Problem) -> Found:
    """All candidates at their caps: the caps leave no choice."""
    u = np.minimum(problem.upper, 1.0)
    information = problem.prior + problem.information(np.arange(len(u)), u)
    certificate = _certificate(problem, information, 1e-9)
    d = problem.sensitivities(certificate.factor)
    # the only feasible point has exactly this value, whatever the certificate of a nonsmooth criterion says
    return Found(u, certificate, d, certificate.value, 1)


def _certificate(problem: Problem, information: Floats, smoothing: float) -> Certificate:
    """Certificate at an M that does not come from the interior-point method."""
    mu = smoothing * problem.criterion.unit(information)
    return problem.criterion.local(information, mu, None).certificate


class _Search:
    """State of the column generation.

    Attributes:
        u: (N,) weights; those that are not free are 0 or at their cap.
        free: Candidates whose weights the interior-point method chooses.
        d: (N,) latest sensitivities.
        centre: Latest solution of the restricted problem.
        gap: Latest proven gap.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.rng = np.random.default_rng(0)
        self.batch = 20 + 2 * len(problem.prior)
        average = np.eye(len(problem.prior)) / problem.costs.mean() + problem.prior
        self.d = problem.sensitivities(_certificate(problem, average, 0.1).factor)
        self.u, self.free = self._first_weights()
        self.base = self._fixed_information()
        self._cover()
        self.centre: Centre | None = None
        self.gap = 1.0
        self.aim = 0.1

    def run(self, tol: float, passes: int) -> Found:
        """Free candidates until the gap is at most ``tol`` or nothing is left to do."""
        best: Found | None = None
        for number in range(1, passes + 1):
            if self.centre is not None and not self.enlarge(tol):
                break
            here = self.iterate(number)
            best = here if best is None or here.gap < best.gap else best
            if best.gap <= tol:
                return self.clear(best, tol)
        return best or self.iterate(1)

    def move(self, problem: Problem, old: Ints, new: Ints, whole: Found) -> None:
        """Go on with other candidates, among them all that are free or carry weight.

        Args:
            problem: On the other candidates.
            old: Numbers in the whole of the candidates so far, increasing.
            new: The same of the other candidates.
            whole: The weights so far, judged on all candidates.
        """
        u = np.zeros(len(whole.u))
        u[old] = self.u
        self.problem, self.u, self.free = problem, u[new], np.searchsorted(new, old[self.free])
        self.d, self.gap = whole.d[new], whole.gap

    def iterate(self, passes: int) -> Found:
        """Best weights on the free candidates, then one pass over all candidates."""
        self.base = self._fixed_information()
        certificate = self._solve_free()
        self.d = self.problem.sensitivities(certificate.factor)
        bound = min(self.problem.bound(certificate, self.d), certificate.value)
        found = Found(self.u.copy(), certificate, self.d, bound, passes)
        self.gap = found.gap
        return found

    def enlarge(self, tol: float) -> bool:
        """Free the candidates that would improve the weights most; False if nothing is left to do."""
        self._shrink()
        level = marginal_value(self.d[self.free], self.problem.upper[self.free], float(self.u[self.free].sum()))
        gain = np.where(self.u > 0.0, level - self.d, self.d - level)
        gain[self.free] = 0.0
        wanting = np.flatnonzero(gain > 0.0)
        last_aim, self.aim = self.aim, max(0.1 * self.gap, 0.3 * tol)
        if not len(wanting):
            self.aim = min(self.aim, 0.1 * last_aim)
            return self.aim > 1e-3 * tol
        if len(wanting) > self.batch:
            best = np.argpartition(-gain[wanting], self.batch // 2)[: self.batch // 2]
            others = self.rng.choice(len(wanting), self.batch // 2, replace=False)
            wanting = wanting[np.union1d(best, others)]
        self.free = np.concatenate([self.free, wanting])
        return True

    def clear(self, found: Found, tol: float) -> Found:
        """The same weights without the tiny ones that the interior-point method leaves, if the proof allows it."""
        moved = self._cleared(0.3)
        if moved is None:
            return found
        u = found.u.copy()
        u[self.free] = moved
        information = self.base + self.problem.information(self.free, moved)
        certificate = self.problem.criterion.certificate(information, found.certificate.dual)
        d = self.problem.sensitivities(certificate.factor)
        bound = min(self.problem.bound(certificate, d), certificate.value)
        cleared = Found(u, certificate, d, bound, found.passes + 1)
        return cleared if cleared.gap <= tol else found

    def _first_weights(self) -> tuple[Floats, Ints]:
        """The best candidates by their sensitivities; without caps the best few and some at random."""
        upper = np.minimum(self.problem.upper, 1.0)
        order = np.argsort(-self.d, kind="stable")
        edge = int(np.searchsorted(np.cumsum(upper[order]), 1.0 - 1e-12))
        few = order[max(0, edge - self.batch) : edge + self.batch]
        usable = np.flatnonzero(upper > 0.0)
        few = few[upper[few] > 0.0]
        more = self.rng.choice(usable, min(self.batch, len(usable)), replace=False)
        u = np.zeros(len(order))
        u[order[:edge]] = upper[order[:edge]]
        u[order[edge]] = 1.0 - u.sum()
        return u, np.union1d(few, more)

    def _fixed_information(self) -> Floats:
        """Information of the prior and of the candidates at their caps."""
        fixed = self.u > 0.0
        fixed[self.free] = False
        index = np.flatnonzero(fixed)
        return self.problem.prior + self.problem.information(index, self.u[index])

    def _cover(self) -> None:
        """Free more candidates until the free ones and the base see the whole row space."""
        for _ in range(len(self.base)):
            seen = self.base + self.problem.information(self.free, np.full(len(self.free), 1.0 / len(self.free)))
            values, vectors = np.linalg.eigh(seen)
            blind = vectors[:, values < 1e-6 * values[-1]]
            if not blind.shape[1]:
                return
            d = self.problem.sensitivities(blind)
            d[self.free] = 0.0
            best = np.argsort(-d, kind="stable")[: blind.shape[1]]
            self.free = np.union1d(self.free, best[d[best] > 0.0])

    def _solve_free(self) -> Certificate:
        """Solve the restricted problem to the gap ``aim`` and put its weights into ``u``."""
        upper, start = self.problem.upper[self.free], self.u[self.free]
        total = float(start.sum())
        problem = Restricted(self.problem.criterion, self.problem.take(self.free), self.base, upper, total)
        share, mu = 1.0, None
        if self.centre is not None and self.problem.criterion.smooth:
            share = min(0.1, 0.3 * np.sqrt(self.gap))
            mu = self.centre.mu * max(1.0, 0.3 * self.gap / max(self.centre.gap, 1e-12))
        start = (1.0 - share) * start + share * inner_point(upper, total)
        self.centre = solve(problem, start, mu, lambda value, bound: 1.0 - bound / value <= self.aim)
        self.u[self.free] = self.centre.weights
        return self.centre.certificate

    def _shrink(self) -> None:
        """Put free weights that lean on a bound onto it, and take them out of the restricted problem."""
        if not self.problem.criterion.smooth and len(self.free) < 5 * self.batch:
            return  # here weights may come back from zero late, and few are worth leaving out
        moved = self._cleared(0.1)
        if moved is not None:
            inside = (moved > 0.0) & (moved < self.problem.upper[self.free])
            self.u[self.free] = moved
            self.free = self.free[inside]

    def _cleared(self, share: float) -> Floats | None:
        """The free weights with those that lean on a bound put onto it; None if that leaves no regular M."""
        centre, upper = self.centre, self.problem.upper[self.free]
        assert centre is not None
        if not centre.d.any():  # the free ones show nothing that counts
            return None
        w = centre.weights
        small = share * np.sqrt(centre.mu / centre.d.max())  # on the path w s = mu, and s and d are of one size
        low, high = w < small, upper - w < small
        middle = ~(low | high)
        rest = float(w.sum() - upper[high].sum())
        if middle.sum() < 2 or rest <= 0.0:
            return None
        moved = np.where(high, upper, np.where(low, 0.0, w * (rest / w[middle].sum())))
        values = np.linalg.eigvalsh(self.base + self.problem.information(self.free, moved))
        regular = values[0] > 1e-9 * values[-1]
        return moved if regular and np.all(moved[middle] < upper[middle]) else None
