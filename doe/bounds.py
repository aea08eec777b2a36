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
) -> Bound:
    """Proven lower bound for ``count`` experiments.

    Args:
        aim: The criterion.
        count: Number of experiments; with none the value is the bound.
        pool: (N, k, p) blocks of the candidates.
        own: (n, k', p) blocks of the plan itself, which count as candidates too.
        value: What the plan reaches.
        repeats: One candidate may be measured several times.
        prior: (p, p) information that is there already, in full.
    """
    if not count:
        return Bound(value, value)
    blocks = joined(pool, own[~among(pool, own, repeats=repeats)])
    return Bound(value, min(relaxed(aim, count, blocks, repeats=repeats, prior=prior).bound / count, value))


def relaxed(aim: Objective, count: int, blocks: Floats, *, repeats: bool, prior: Floats | None) -> ApproximateDesign:
    """The best weights of (N, k, p) candidates for ``count`` experiments; arguments as in `bound_of`."""
    try:
        return approximate_design(
            blocks,
            aim.target(),
            criterion=aim.criterion,
            max_weight=None if repeats else 1.0 / count,
            prior=None if prior is None else prior / count,
        )
    except NoConvergence as error:  # its bound is proven all the same, only not the tightest
        if not isinstance(error.best, ApproximateDesign):
            raise
        return error.best


def among(pool: Floats, own: Floats, *, repeats: bool) -> np.ndarray:
    """(n,) True for blocks of ``own`` that are candidates already; without repeats a candidate stands for one only."""
    known = np.zeros(len(own), dtype=bool)
    if not len(pool) or own.shape[1:] != pool.shape[1:]:
        return known
    size, sizes = (np.einsum("nki,nki->n", blocks, blocks) for blocks in (own, pool))
    free = np.ones(len(pool), dtype=bool)
    for index, block in enumerate(own):
        near = np.flatnonzero(free & (np.abs(sizes - size[index]) <= _SAME * size[index]))
        same = near[np.abs(pool[near] - block).max(axis=(1, 2), initial=0.0) <= _SAME * size[index] ** 0.5]
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
