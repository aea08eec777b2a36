"""A proven bound for the mean of a criterion over several problems with the same candidates.

For every problem and any information `doe.criteria` gives ``value(w') >= N/s(w')`` with ``s(w') = sum_i w'_i d_i + p``.
With ``a = N/s(w)`` at some weights w, the function 1/s lies above its tangents, so for all feasible w' and any c

    mean value(w') >= mean a (2 c - c^2 s(w')/s(w)) = 2 c mean(a) - c^2 (sum_i w'_i D_i + P),
    D_i = mean(a d_i/s(w)),   P = mean(a p/s(w))

and with the best c the bound is ``mean(a)^2 / (max over feasible w' of sum_i w'_i D_i + P)``. It holds at any w; the
multiplicative steps ``w_i <- w_i sqrt(D_i)`` (Silvey, Titterington and Torsney 1978) make it tight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from doe.polytope import largest_sum
from doe.problem import Problem
from identify.arrays import Floats
from identify.threads import one_thread

__all__ = ["averaged_bound"]

_ROUNDS = 4  # passes over all candidates
_STEPS = 60  # on the candidates in use, in each round
_ADDED = 100  # candidates that a pass takes in
_SHARE = 0.02  # of the weight that these get
_SURE, _FASTER, _LONGEST = 0.5, 1.5, 10.0  # powers of a step
_LEAST = 1e-10  # weight of a candidate in use
_SOFT = 0.01  # of the value: how sharply the mixture of criterion G follows the worst test pose


def averaged_bound(problems: Sequence[Problem], weights: Floats) -> float:
    """Proven lower bound of the mean of the values of some problems.

    Args:
        problems: The problems, with the same N candidates and caps and without costs.
        weights: (N,) to start from, such as the mean of the best ones of each problem.
    """
    with one_thread():
        used, best = np.flatnonzero(weights > 1e-6 * weights.max()), 0.0
        own = weights[used] / weights[used].sum()
        for _ in range(_ROUNDS):
            own = _stepped(problems, [problem.take(used) for problem in problems], own)
            informations = [problem.information(used, own) + problem.prior for problem in problems]
            mean, factors = _tangents(problems, informations)
            gains = np.sum([p.sensitivities(factor) for p, factor in zip(problems, factors, strict=True)], axis=0)
            fixed = sum(float(np.sum((p.prior @ factor) * factor)) for p, factor in zip(problems, factors, strict=True))
            best = max(best, mean**2 / (largest_sum(gains, problems[0].upper, 1.0) + fixed))
            fresh = np.setdiff1d(np.argsort(-gains, kind="stable")[:_ADDED], used)
            if not len(fresh):
                break
            used = np.concatenate([used, fresh])
            own = np.concatenate([(1.0 - _SHARE) * own, np.full(len(fresh), _SHARE / len(fresh))])
    return best


def _stepped(problems: Sequence[Problem], blocks: Sequence[Floats], own: Floats) -> Floats:
    """Better weights (m,) of the candidates in use after some multiplicative steps; ``blocks`` (m, k, p) of each.

    The power grows while the mean falls and is taken back where it does not; the square root always lowers a mean.
    """
    power, best, least, tried = 0.5, own, np.inf, own
    gains = np.ones(len(own))
    for _ in range(_STEPS):
        roots = [(part * np.sqrt(tried)[:, None, None]).reshape(-1, part.shape[2]) for part in blocks]
        informations = [rows.T @ rows + p.prior for rows, p in zip(roots, problems, strict=True)]
        mean, factors = _tangents(problems, informations)
        if mean < least or power == _SURE:
            best, least, power = tried, mean, min(power * _FASTER, _LONGEST)
            turned = [part @ factor for part, factor in zip(blocks, factors, strict=True)]
            gains = np.sum([np.einsum("nkq,nkq->n", rows, rows) for rows in turned], axis=0)
        else:
            power = _SURE
        tried = best * (gains / gains.max()) ** power
        tried = np.maximum(tried / tried.sum(), _LEAST)  # so that every information keeps its rank
        tried /= tried.sum()
    return best


def _tangents(problems: Sequence[Problem], informations: Sequence[Floats]) -> tuple[float, list[Floats]]:
    """``mean(a)``, and for each problem the factor F (p, q) whose ``|A_i F|^2`` add up to D_i."""
    heights, factors = [], []
    for problem, information in zip(problems, informations, strict=True):
        criterion = problem.criterion
        found = criterion.local(information, _SOFT * criterion.unit(information), None).certificate
        reached = float(np.sum((information @ found.factor) * found.factor))
        height = found.numerator / reached
        heights.append(height)
        factors.append(found.factor * np.sqrt(height / reached / len(problems)))
    return float(np.mean(heights)), factors
