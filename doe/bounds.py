"""How good a plan is at best: proven lower bounds for a number of experiments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.approximate import ApproximateDesign, approximate_design
from doe.objective import Objective
from identify.arrays import Floats
from identify.errors import NoConvergence

__all__ = ["Bound", "among", "bound_of", "joined", "relaxed"]

_SAME = 1e-9  # blocks that differ by less are those of one pose


@dataclass(frozen=True, eq=False)
class Bound:
    """A value with its proven lower bound, for one number of experiments.

    Attributes:
        value: Value of the criterion.
        bound: No plan of as many experiments on the same candidates is better than this.
    """

    value: float
    bound: float

    @property
    def efficiency(self) -> float:
        """Bound / value, at most 1."""
        return min(self.bound / self.value, 1.0) if np.isfinite(self.value) else 0.0


def bound_of(
    aim: Objective,
    count: int,
    pool: Floats,
    own: Floats,
    value: float,
    *,
    repeats: bool,
    prior: Floats | None = None,
    costs: tuple[Floats, Floats] | None = None,
    budget: float | None = None,
) -> Bound:
    """Proven lower bound for ``count`` experiments, or for all that a budget pays for.

    Args:
        aim: The criterion.
        count: Number of experiments; with none the value is the bound.
        pool: (N, k, p) blocks of the candidates.
        own: (n, k', p) blocks of the plan itself, which count as candidates too.
        value: What the plan reaches.
        repeats: One candidate may be measured several times.
        prior: (p, p) information that is there already, in full.
        costs: (N,) and (n,) costs of both, together with ``budget``.
        budget: Largest sum of costs, in place of the number of experiments.
    """
    if not count:
        return Bound(value, value)
    new = ~among(pool, own, repeats=repeats)
    blocks, prices, amount = joined(pool, own[new]), None, float(count)
    if costs is not None and budget is not None:
        prices, amount = np.concatenate([costs[0], costs[1][new]]), budget
    design = relaxed(aim, amount, blocks, repeats=repeats, prior=prior, costs=prices)
    return Bound(value, min(design.bound / amount, value))


def relaxed(
    aim: Objective, amount: float, blocks: Floats, *, repeats: bool, prior: Floats | None, costs: Floats | None = None
) -> ApproximateDesign:
    """The best weights of (N, k, p) candidates.

    Args:
        aim: The criterion.
        amount: Number of experiments, or the budget where there are costs.
        blocks: (N, k, p) of the candidates.
        repeats: One candidate may be measured several times.
        prior: (p, p) information that is there already, in full.
        costs: (N,) of the candidates.
    """
    cap = None if repeats else 1.0 / amount
    if cap is not None and costs is not None:  # a budget that pays for everything
        cap = max(cap, (1.0 + 1e-6) / float(costs.sum()))
    try:
        return approximate_design(
            blocks,
            aim.target(),
            criterion=aim.criterion,
            max_weight=cap,
            costs=costs,
            prior=None if prior is None else prior / amount,
        )
    except NoConvergence as error:  # its bound is proven all the same, only not the tightest
        if not isinstance(error.best, ApproximateDesign):
            raise
        return error.best


def among(pool: Floats, own: Floats, *, repeats: bool) -> np.ndarray:
    """(n,) True for blocks of ``own`` that are candidates already; without repeats a candidate stands for one only.

    Blocks are the same if their information is: the order of the readings of a visit turns the rows alone.
    """
    known = np.zeros(len(own), dtype=bool)
    if not len(pool):
        return known
    size, sizes = (np.einsum("nki,nki->n", blocks, blocks) for blocks in (own, pool))
    free = np.ones(len(pool), dtype=bool)
    for index, block in enumerate(own):
        near = np.flatnonzero(free & (np.abs(sizes - size[index]) <= _SAME * size[index]))
        off = np.abs(pool[near].swapaxes(1, 2) @ pool[near] - block.T @ block).max(axis=(1, 2), initial=0.0)
        same = near[off <= _SAME * size[index]]
        known[index] = len(same) > 0
        free[same[:1]] = repeats
    return known


def joined(first: Floats, second: Floats) -> Floats:
    """Blocks of both, the shorter ones filled up with rows of zeros."""
    if not len(first) or not len(second):
        return second if len(second) else first
    rows = max(first.shape[1], second.shape[1])
    blocks = np.zeros((len(first) + len(second), rows, first.shape[2]))
    blocks[: len(first), : first.shape[1]] = first
    blocks[len(first) :, : second.shape[1]] = second
    return blocks
