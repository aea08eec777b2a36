"""The set of feasible weights: ``sum w = total, 0 <= w <= upper`` and linear maximisation over it."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats

__all__ = ["inner_point", "largest_sum", "marginal_value"]


def largest_sum(values: Floats, upper: Floats, total: float) -> float:
    """``max sum_i w_i values_i`` over the set: the fractional knapsack, best values first.

    Args:
        values: (N,) gains per unit of weight, >= 0.
        upper: (N,) caps, infinite where there is none.
        total: Weight to give away, at most ``sum(upper)``.
    """
    best = int(np.argmax(values))
    if upper[best] >= total:
        return float(values[best]) * total
    order = np.argsort(-values, kind="stable")
    filled = np.minimum(np.cumsum(np.minimum(upper[order], total)), total)
    return float(np.diff(filled, prepend=0.0) @ values[order])


def marginal_value(values: Floats, upper: Floats, total: float) -> float:
    """The value of the candidate that takes the last weight in `largest_sum`."""
    order = np.argsort(-values, kind="stable")
    filled = np.cumsum(np.minimum(upper[order], total))
    last = min(int(np.searchsorted(filled, total * (1.0 - 1e-12))), len(order) - 1)
    return float(values[order[last]])


def inner_point(upper: Floats, total: float) -> Floats:
    """Weights in proportion to the caps: strictly between 0 and ``upper`` if ``total < sum(upper)``."""
    share = np.minimum(upper, total)
    result: Floats = share * (total / share.sum())
    return result
