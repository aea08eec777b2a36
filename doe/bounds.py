"""How good a plan is at best: proven lower bounds for a number of experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from doe.approximate import ApproximateDesign, approximate_design
from doe.closing import RELAXED
from doe.exact import proven_bound
from doe.information import information_of
from doe.objective import Objective
from doe.storage import Stacked, stacked
from identify.arrays import Floats, Ints
from identify.errors import InputError, NoConvergence, NotIdentifiable
from identify.study import Criterion

__all__ = ["NODES", "Bound", "Efficiencies", "among", "bound_of", "efficiencies", "relaxed"]

NODES = 600  # of branch and bound for the proof of a plan: some seconds where a proof is in reach at all
_SAME = 1e-9  # blocks that differ by less are those of one pose
_SAMPLE = 2000  # candidates that the efficiencies by all criteria are told on
_ROUGH = 1e-4  # proven gap of these


@dataclass(frozen=True, eq=False)
class Bound:
    """A value with its proven lower bound, for one number of experiments.

    Attributes:
        value: Value of the criterion.
        bound: No plan of as many experiments on the same candidates is better than this.
        source: Where the bound comes from: relaxation or branch_and_bound.
        estimate: What any plan of as many experiments at any poses reaches at best; not proven. None where it was
            not looked for.
    """

    value: float
    bound: float
    source: str = RELAXED
    estimate: float | None = None

    @property
    def efficiency(self) -> float:
        """Bound / value, at most 1."""
        return min(self.bound / self.value, 1.0) if np.isfinite(self.value) else 0.0

    @property
    def continuous(self) -> float | None:
        """Estimated efficiency over all poses, at most 1, or None."""
        if self.estimate is None:
            return None
        return min(self.estimate / self.value, 1.0) if np.isfinite(self.value) else 0.0


def bound_of(
    aim: Objective,
    count: int,
    pool: Floats,
    own: Floats,
    value: float,
    *,
    repeats: bool,
    prior: Floats | None = None,
    nodes: int = 0,
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
        nodes: Most nodes of branch and bound, where ``own`` is a whole plan and nothing was there before.
    """
    if not count:
        return Bound(value, value)
    new, members = _placed(pool, own, repeats=repeats)
    blocks, prices, amount = stacked(pool, own[new]), None, float(count)
    if costs is not None and budget is not None:
        prices, amount = np.concatenate([costs[0], costs[1][new]]), budget
    if not nodes or prices is not None or prior is not None or len(members) != count:
        design = relaxed(aim, amount, blocks, repeats=repeats, prior=prior, costs=prices)
        return Bound(value, min(design.bound / amount, value))
    bound, source = proven_bound(blocks, aim.target(), members, criterion=aim.criterion, repeats=repeats, nodes=nodes)
    return Bound(value, min(bound, value), source)


def relaxed(
    aim: Objective,
    amount: float,
    blocks: Floats | Stacked,
    *,
    repeats: bool,
    prior: Floats | None,
    costs: Floats | None = None,
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
    """(n,) True for blocks of ``own`` that are candidates already; without repeats a candidate stands for one only."""
    return np.asarray(_placed(pool, own, repeats=repeats)[1] < len(pool))


def _placed(pool: Floats, own: Floats, *, repeats: bool) -> tuple[Ints, Ints]:
    """Which blocks of ``own`` are no candidates yet, and where all of them stand among candidates and these.

    Blocks are the same if their information is: the order of the readings of a visit turns the rows alone. Without
    repeats a candidate stands for one only.
    """
    size, sizes = (np.einsum("nki,nki->n", blocks, blocks) for blocks in (own, pool))
    free = np.ones(len(pool), dtype=bool)
    new: list[int] = []
    members = np.zeros(len(own), dtype=np.int64)
    for index, block in enumerate(own):
        near = np.flatnonzero(free & (np.abs(sizes - size[index]) <= _SAME * size[index]))
        off = np.abs(pool[near].swapaxes(1, 2) @ pool[near] - block.T @ block).max(axis=(1, 2), initial=0.0)
        same = near[off <= _SAME * size[index]]
        twins = [place for place, other in enumerate(new) if repeats and np.array_equal(own[other], block)]
        free[same[:1]] = repeats
        if len(same):
            members[index] = same[0]
        elif twins:
            members[index] = len(pool) + twins[0]
        else:
            members[index] = len(pool) + len(new)
            new.append(index)
    return np.array(new, dtype=np.int64), members


@dataclass(frozen=True, eq=False)
class Efficiencies:
    """How good one plan is by every criterion.

    Attributes:
        by_criterion: Relaxed optimum over the plan's value for test_pose, A, D, E and G; None where the criterion is
            not defined.
        candidates: Number of candidates that the optima are taken over, beside the plan's own poses.
    """

    by_criterion: Mapping[Criterion, float | None]
    candidates: int


def efficiencies(aim: Objective, pool: Floats, own: Floats, *, repeats: bool) -> Efficiencies:
    """Efficiency of a plan by every criterion, against the relaxed optimum of that criterion.

    Args:
        aim: The test poses and the number of parameters.
        pool: (N, k, p) blocks of the candidates; an even sample of 2000 where there are more.
        own: (n, k', p) blocks of the plan, candidates too.
        repeats: One candidate may be measured several times.
    """
    sample = pool[np.linspace(0, len(pool) - 1, min(_SAMPLE, len(pool))).astype(np.int64)]
    new, _ = _placed(sample, own, repeats=repeats)
    blocks, cap = stacked(sample, own[new]), None if repeats else 1.0 / len(own)
    information = information_of(own)
    names: tuple[Criterion, ...] = ("test_pose", "A", "D", "E", "G")
    found: dict[Criterion, float | None] = {}
    for name in names:
        defined = name in {"A", "D", "E"} or aim.rows is not None
        least = _optimum(aim, name, blocks, cap) if defined else None
        found[name] = None if least is None else min(least / len(own) / aim.value(information, name), 1.0)
    return Efficiencies(found, len(sample))


def _optimum(aim: Objective, name: Criterion, blocks: Floats | Stacked, cap: float | None) -> float | None:
    """Proven lower bound of a criterion for one experiment; None where the blocks do not define it."""
    try:
        return approximate_design(blocks, aim.target(name), criterion=name, max_weight=cap, tol=_ROUGH).bound
    except (NotIdentifiable, InputError):
        return None
    except NoConvergence as error:  # its bound is proven all the same, only not the tightest
        return error.best.bound if isinstance(error.best, ApproximateDesign) else None
