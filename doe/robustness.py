"""What a plan is worth after losses and on average over uncertain nominal values, with a proven bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.averaged import averaged_bound
from doe.bounds import Bound, among, relaxed
from doe.losses import after_losses, lost_sets
from doe.pool import Pool
from doe.problem import Problem, make_problem
from doe.robust import worst_case
from doe.storage import Stacked, stacked
from identify.arrays import Floats, Ints

__all__ = ["Robustness", "robustness", "value_that_counts"]


@dataclass(frozen=True, eq=False)
class Robustness:
    """How good a plan stays.

    Attributes:
        losses: Visits that may be lost.
        draws: Draws of nominal values; 0: at the nominal ones.
        reached: Value after the worst loss, on average over the draws, and its proven bound.
        lost: The visits of the worst loss.
        left: (L, p, p) information at the nominal values after every loss.
    """

    losses: int
    draws: int
    reached: Bound
    lost: tuple[int, ...]
    left: Floats


def value_that_counts(pool: Pool, q: Floats, visit_loads: Ints, own: Floats) -> float:
    """Value of a plan after its worst loss, on average over the draws.

    Args:
        pool: What it was chosen from.
        q: (n, joints) joint values, rad or m.
        visit_loads: (n, L) loads.
        own: (n, k, p) its blocks at the nominal values.
    """
    return _worst(pool, _blocks(pool, q, visit_loads, own))[0]


def robustness(pool: Pool, q: Floats, visit_loads: Ints, own: Floats) -> Robustness | None:
    """The same with what proves it; None for plans that need not be robust. Arguments as in `value_that_counts`."""
    losses, count = pool.observer.settings.losses, len(own)
    if not (losses or pool.draws) or count <= losses:
        return None
    blocks = _blocks(pool, q, visit_loads, own)
    value, place = _worst(pool, blocks)
    proven = _proven(pool, count - losses, blocks)
    lost = tuple(lost_sets(count, losses)[place].tolist())
    left = after_losses(own, losses, pool.prior)
    return Robustness(losses, len(pool.draws), Bound(value, min(proven, value)), lost, left)


def _proven(pool: Pool, count: int, blocks: list[Floats]) -> float:
    """No plan of ``count`` visits has a smaller mean over the draws; ``blocks`` (n, k, p) of the plan at each draw."""
    repeats, draws = pool.observer.settings.repeats, _draws(pool)
    extra = ~among(draws[0].blocks, blocks[0], repeats=repeats)
    every = [stacked(draw.blocks, mine[extra]) for draw, mine in zip(draws, blocks, strict=True)]
    found = [
        relaxed(draw.objective, count, own, repeats=repeats, prior=draw.prior)
        for draw, own in zip(draws, every, strict=True)
    ]
    bound = float(np.mean([each.bound for each in found]))  # of the means of the smallest values
    if len(draws) > 1:
        problems = [_problem(draw, own, count, repeats=repeats) for draw, own in zip(draws, every, strict=True)]
        bound = max(bound, averaged_bound(problems, np.mean([each.weights for each in found], axis=0)))
    return bound / count


def _problem(draw: Pool, blocks: Floats | Stacked, count: int, *, repeats: bool) -> Problem:
    """The relaxed problem of one draw on the scale of one visit."""
    prior = None if draw.prior is None else draw.prior / count
    aim = draw.objective
    return make_problem(blocks, aim.target(), aim.criterion, None, prior, None if repeats else 1.0 / count)


def _draws(pool: Pool) -> tuple[Pool, ...]:
    """The draws, or the nominal values alone."""
    return pool.draws or (pool,)


def _blocks(pool: Pool, q: Floats, visit_loads: Ints, own: Floats) -> list[Floats]:
    """(n, k, p) blocks of a plan at each draw."""
    kept = pool.known.kept
    return [draw.observer.blocks(q, visit_loads)[:, :, kept] for draw in pool.draws] or [own]


def _worst(pool: Pool, blocks: list[Floats]) -> tuple[float, int]:
    """What counts of a plan, and the place of the worst loss."""
    losses, draws = pool.observer.settings.losses, _draws(pool)
    left = [after_losses(mine, losses, draw.prior) for draw, mine in zip(draws, blocks, strict=True)]
    return worst_case([draw.objective for draw in draws], left)
