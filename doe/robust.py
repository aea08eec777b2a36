"""Plans that stay good when visits are lost or nominal values are wrong: exchange on the worst case, on average.

What counts of a plan S is

    max over lost L in S, |L| = r   of   mean over draws d of   value_d( M_d(S without L) )

An exchange takes one visit out and puts in the candidate with the smallest such value: for every lost set of the rest
all candidates are scored at once, the worst sets first, and a candidate is dropped as soon as it cannot win any more.
The search starts from the best plan for the nominal values without losses, and some times from a spoilt one.

After any losses a plan has n - r visits, so a bound of the mean for n - r visits (`doe.averaged`) is a bound of what
counts of any plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from doe.exact import kept_regular
from doe.local_search import BETTER, Limits, Pool, make_pool
from doe.losses import after_losses, lost_sets
from doe.objective import Objective
from doe.pool import AnyPool
from doe.problem import Problem, make_problem
from identify.arrays import Floats, Ints
from identify.threads import one_thread

__all__ = ["exchanged", "worst_case"]

_SCORED = 300  # candidates with the highest sensitivities at each of the informations looked at
_SETS = 4  # worst lost sets whose sensitivities count too
_RESTARTS = 60  # for one visit; longer plans get fewer
_ROUNDS = {"low": 2, "normal": 12, "high": 30}  # through all visits


def worst_case(aims: Sequence[Objective], informations: Sequence[Floats]) -> tuple[float, int]:
    """What counts of a plan, and which lost set is the worst.

    Args:
        aims: Criterion of each draw.
        informations: (L, p, p) of each draw after every loss, see `doe.losses.after_losses`.
    """
    values = np.mean([[aim.value(one) for one in each] for aim, each in zip(aims, informations, strict=True)], axis=0)
    if not len(values):
        return float("inf"), -1
    worst = int(np.argmax(values))
    return float(values[worst]), worst


def exchanged(
    pool: AnyPool, target: Callable[[Objective], Floats], chosen: Ints, losses: int, effort: str, seed: int
) -> Ints:
    """Candidates (n,) that are better by what counts than the ``chosen`` ones (n,), or these.

    Args:
        pool: The candidates, with draws.
        target: What is searched for, given the objective of a draw.
        chosen: The plan to start from.
        losses: Visits that may be lost.
        effort: low, normal or high.
        seed: Of the random moves.
    """
    if losses >= len(chosen):
        return chosen
    settings = pool.observer.settings
    with one_thread():
        draws = pool.draws or (pool,)
        problems = [_problem(draw, target(draw.objective), len(chosen)) for draw in draws]
        index = np.unique(np.concatenate([chosen, *(_promising(problem, chosen, losses) for problem in problems)]))
        limits = Limits(len(chosen), np.inf, np.ones(len(pool.blocks)), settings.repeats)
        search = _Search(tuple(make_pool(problem, problem.prior, index, limits) for problem in problems), losses)
        members = search.improved(np.searchsorted(index, chosen).tolist(), _ROUNDS[effort])
        if effort != "low":
            members = search.spoilt_and_improved(members, _RESTARTS // len(members), np.random.default_rng(seed))
    return np.sort(index[members])


def _problem(draw: AnyPool, target: Floats, count: int) -> Problem:
    """The design problem of one draw, kept regular."""
    problem = make_problem(draw.blocks, target, draw.objective.criterion, None, draw.prior, None)
    return kept_regular(problem, Limits(count, np.inf, np.ones(len(draw.blocks)), True))


def _promising(problem: Problem, chosen: Ints, losses: int) -> Ints:
    """Candidates with the highest sensitivities at the plan and after its worst losses."""
    blocks = problem.blocks.take(chosen, problem.space.basis)
    whole = after_losses(blocks, 0, problem.prior)
    left = after_losses(blocks, losses, problem.prior)
    values = [problem.criterion.value(one) for one in left]
    worst = left[np.argsort(values)[-_SETS:]]
    found = []
    for information in (*whole, *worst):
        factor, _ = problem.criterion.prospect(information, problem.criterion.value(information))
        found.append(np.argsort(-problem.sensitivities(factor), kind="stable")[:_SCORED])
    return np.concatenate(found)


@dataclass(frozen=True, eq=False)
class _Search:
    """Exchange on the worst case of the mean.

    Attributes:
        pools: The scored candidates of each draw.
        losses: Visits that may be lost.
    """

    pools: tuple[Pool, ...]
    losses: int

    def improved(self, members: list[int], rounds: int) -> list[int]:
        """A plan that no exchange of one visit improves, or that of the last round."""
        value = float(self._values(members, self.losses)[1].max())
        for _ in range(rounds):
            before = value
            for out in sorted(set(members)):
                rest = list(members)
                if out not in rest:
                    continue
                rest.remove(out)
                found, reached = self._best_addition(rest, value * BETTER)
                if found is not None:
                    members, value = [*rest, found], reached
            if value >= before:
                break
        return members

    def spoilt_and_improved(self, members: list[int], times: int, rng: np.random.Generator) -> list[int]:
        """The best plan after putting in two random visits and exchanging again, some times over."""
        best, least = members, float(self._values(members, self.losses)[1].max())
        for _ in range(times):
            kept = list(rng.permutation(best))[min(2, len(best)) :]
            open_ = np.arange(len(self.pools[0].index))
            if not self.pools[0].limits.repeats:
                open_ = np.setdiff1d(open_, kept)
            fresh = rng.choice(open_, len(best) - len(kept), replace=False)
            found = self.improved([*map(int, kept), *map(int, fresh)], _ROUNDS["normal"])
            value = float(self._values(found, self.losses)[1].max())
            if value < least * BETTER:
                best, least = found, value
        return best

    def _values(self, members: list[int], losses: int) -> tuple[list[Floats], Floats]:
        """Informations (L, p, p) of each draw after every distinct loss, and (L,) the mean of their values."""
        sets = np.sort(np.array(members)[lost_sets(len(members), losses)], axis=1)
        distinct = np.sort(np.unique(sets, axis=0, return_index=True)[1])
        informations = [
            after_losses(pool.rows[:, members].swapaxes(0, 1), losses, pool.base)[distinct] for pool in self.pools
        ]
        each = [
            [pool.criterion.value(one) for one in left] for pool, left in zip(self.pools, informations, strict=True)
        ]
        return informations, np.mean(each, axis=0)

    def _best_addition(self, rest: list[int], goal: float) -> tuple[int | None, float]:
        """The candidate that brings a plan below ``goal`` and furthest, and its value; None if none does."""
        least = float(self._values(rest, self.losses - 1)[1].max()) if self.losses else 0.0  # it is lost itself
        informations, values = self._values(rest, self.losses)
        open_ = np.arange(len(self.pools[0].index))
        if not self.pools[0].limits.repeats:
            open_ = np.setdiff1d(open_, rest)
        score = np.full(len(open_), least)
        for lost in np.argsort(-values):
            kept = score < goal
            open_, score = open_[kept], score[kept]
            if not len(open_):
                return None, goal
            added = [
                pool.criterion.after_adding(left[lost], pool.rows[:, open_])
                for pool, left in zip(self.pools, informations, strict=True)
            ]
            score = np.maximum(score, np.mean(added, axis=0))
        best = int(np.argmin(score))
        return (int(open_[best]), float(score[best])) if score[best] < goal else (None, goal)
