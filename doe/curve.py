"""Expected accuracy against the number of experiments: designed, random and given poses, and what is impossible.

The bound is that of the mean square at the test poses on the same candidates: no plan of as many experiments has a
smaller rms. Designed plans are searched quickly and stay on the candidates; random ones are candidates drawn at random,
of which the median by rms is told.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from doe.accuracy import Accuracy
from doe.bounds import relaxed
from doe.guard import Guard, search
from doe.information import covariance_of, information_of
from doe.objective import Objective
from doe.pool import AnyPool
from doe.storage import stacked
from identify.arrays import Floats, Ints
from identify.errors import NotIdentifiable
from identify.study import PlanSettings

__all__ = ["CurvePoint", "Judge", "Reached", "accuracy_curve", "fewest_shown", "sizes"]

_POINTS = 8
_DRAWS = 25  # random plans of each size
_LONGEST = 60  # experiments of a plan that is searched for the curve

Judge = Callable[[Floats], Accuracy]  # covariance (p, p) -> accuracy at the test poses


@dataclass(frozen=True)
class Reached:
    """Accuracy of one plan at the test poses, mm.

    Attributes:
        rms: From the uncertainty of the parameters.
        rms_total: With the robot's own pose jitter.
        radius: Holds the total error at the worst test pose with the confidence of the study.
    """

    rms: float
    rms_total: float
    radius: float


@dataclass(frozen=True)
class CurvePoint:
    """What so many experiments reach; None where nothing is known or too little is seen.

    Attributes:
        poses: Number of experiments.
        bound: No plan of as many has a smaller rms, mm.
        plan: A designed plan on the candidates.
        random: The median of random plans.
        own: The first so many of the given visits.
    """

    poses: int
    bound: float | None
    plan: Reached | None
    random: Reached | None
    own: Reached | None


def sizes(last: int, *, first: int = 1, also: int = 1) -> list[int]:
    """About eight numbers from ``first`` to ``last``, at equal ratios, ``also`` among them."""
    spread = np.geomspace(max(first, 1), max(last, first, 1), _POINTS).round().astype(int)
    return sorted({*spread.tolist(), max(also, 1)})


def fewest_shown(pool: AnyPool) -> int:
    """Experiments with fewer rows than parameters need not be looked at."""
    return 1 if pool.prior is not None else math.ceil(pool.objective.size / pool.blocks.shape[1])


def accuracy_curve(
    aim: Objective,
    settings: PlanSettings,
    judge: Judge,
    counts: list[int],
    seed: int,
    *,
    pool: AnyPool | None,
    own: Floats | None = None,
    guard: Guard | None = None,
    prior: Floats | None = None,
) -> tuple[CurvePoint, ...]:
    """Accuracy for some numbers of experiments.

    Args:
        aim: The criterion on p parameters, with test poses.
        settings: What the plan is asked for: confidence, repeats.
        judge: ``(p, p) covariance -> accuracy``.
        counts: Numbers of experiments, ascending.
        seed: Of searches and random plans.
        pool: The candidates on the same parameters; None if there are none.
        own: (n, k, p) given visits in their order, which then count as candidates for the bound.
        guard: What is weighed into the designed plans.
        prior: (p, p) information that is there already where there are no candidates, which else know it.
    """
    given = np.zeros((0, 1, aim.size)) if own is None else own
    prior = prior if pool is None else pool.prior
    bounds = _bounds(aim, settings, counts, given[:0] if pool is None else pool.blocks, given, prior)
    designed = [_designed(pool, count, seed, guard or Guard()) for count in counts]
    random = _random(aim, pool, counts, settings, seed)
    start = np.zeros((aim.size, aim.size)) if prior is None else prior
    ordered = [start + information_of(given[:count]) if count <= len(given) else None for count in counts]

    def reached(information: Floats | None) -> Reached | None:
        if information is None or not np.isfinite(aim.value(information, "test_pose")):
            return None
        found = judge(covariance_of(information))
        return Reached(found.rms, found.rms_total, found.radius(settings.confidence))

    return tuple(
        CurvePoint(count, bound, reached(plan), reached(drawn), reached(first))
        for count, bound, plan, drawn, first in zip(counts, bounds, designed, random, ordered, strict=True)
    )


def _bounds(
    aim: Objective, settings: PlanSettings, counts: list[int], pool: Floats, own: Floats, prior: Floats | None
) -> list[float | None]:
    """Proven lower bound of the rms for each number of experiments, mm; None where nothing shows enough."""
    mean = replace(aim, criterion="test_pose")
    blocks = stacked(pool, own)

    def bound(count: int) -> float | None:
        try:
            best = relaxed(mean, count, blocks, repeats=settings.repeats, prior=prior).bound
        except NotIdentifiable:
            return None
        return math.sqrt(best / count)

    if not settings.repeats or prior is not None:
        return [bound(count) if settings.repeats or count <= len(blocks) else None for count in counts]
    one = bound(1)
    return [None if one is None else one / math.sqrt(count) for count in counts]


def _designed(pool: AnyPool | None, count: int, seed: int, guard: Guard) -> Floats | None:
    """Information (p, p) of a designed plan, or None where none is found or looked for."""
    if pool is None or count > _LONGEST or (not pool.observer.settings.repeats and count > len(pool.blocks)):
        return None
    try:
        return pool.information(pool.blocks[search(pool, count, seed, guard, effort="low")])
    except NotIdentifiable:  # too few
        return None


def _random(
    aim: Objective, pool: AnyPool | None, counts: list[int], settings: PlanSettings, seed: int
) -> list[Floats | None]:
    """Information (p, p) of the random plan of each size whose rms is the median."""
    if pool is None:
        return [None] * len(counts)
    drawn = _draws(len(pool.blocks), counts[-1], seed, repeats=settings.repeats)
    found: list[Floats | None] = []
    for count in counts:
        if count > drawn.shape[1]:
            found.append(None)
            continue
        informations = [pool.information(pool.blocks[pick[:count]]) for pick in drawn]
        order = np.argsort([aim.value(one, "test_pose") for one in informations], kind="stable")
        found.append(informations[order[_DRAWS // 2]])
    return found


def _draws(candidates: int, most: int, seed: int, *, repeats: bool) -> Ints:
    """(draws, n) candidates of random plans; shorter plans are the beginnings of longer ones."""
    rng = np.random.default_rng(seed)
    if repeats:
        return rng.integers(0, candidates, (_DRAWS, most))
    return np.stack([rng.permutation(candidates)[:most] for _ in range(_DRAWS)])
