"""The search on the grid, guarded against plans that see little but the test poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from doe.exact import exact_design
from doe.information import standard_deviations
from doe.losses import after_losses
from doe.objective import Objective
from doe.pool import AnyPool
from doe.robust import exchanged, worst_case
from identify.arrays import Floats, Ints
from identify.errors import Infeasible, NotIdentifiable

__all__ = ["Guard", "blind_spot", "guarded_search", "search"]

_GUARD_ROUNDS = 12
_USUAL_PERCENT = 300.0  # the default of max_std_percent; beyond it a plan says what it does not see


@dataclass(frozen=True, eq=False)
class Guard:
    """What keeps a plan from seeing little but the test poses.

    Attributes:
        best: (p,) standard deviations under the best plan for the parameters; None for criteria that need no guard.
        share: Of the parameters' own variances that is weighed into the search.
    """

    best: Floats | None = None
    share: float = 0.0

    def target(self, aim: Objective) -> Floats:
        """What is searched for."""
        if self.best is None or not self.share:
            return aim.target()
        return aim.guarded(self.best, self.share)


def search(pool: AnyPool, count: int, seed: int, guard: Guard, *, effort: str = "normal") -> Ints:
    """Indices of the chosen candidates (n,) for the criterion of the study, repeats included.

    Args:
        pool: What to choose from.
        count: Number of experiments; with none nothing is chosen.
        seed: Of the random moves.
        guard: What is weighed in.
        effort: As in `doe.exact.exact_design`.

    Raises:
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    if not count:
        return np.zeros(0, dtype=np.int64)
    aim, losses = pool.objective, pool.observer.settings.losses
    chosen = _found(pool, guard.target(aim), count, seed, aim.criterion, effort)
    if not losses and not pool.draws:
        return chosen
    chosen = exchanged(pool, guard.target, chosen, losses, effort, seed)
    left = after_losses(pool.blocks[chosen], losses, pool.prior)
    if not np.isfinite(worst_case([aim], [left])[0]):
        raise NotIdentifiable(
            f"{pool.observer.path}: [plan] {count} poses are too few for robust_to_losses = {losses}: after the worst "
            f"loss the rest does not show what criterion {aim.criterion} needs; plan more poses"
        )
    return chosen


def _found(pool: AnyPool, target: Floats, count: int, seed: int, criterion: str, effort: str) -> Ints:
    """The best design on the candidates.

    Raises:
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    asked = pool.observer
    try:
        found = exact_design(
            pool.blocks,
            target,
            count,
            criterion=criterion,
            repeats=asked.settings.repeats,
            prior=pool.prior,
            effort=effort,
            seed=seed,
        )
    except NotIdentifiable as error:
        columns = [index for index in error.missing if isinstance(index, int)]
        names = tuple(pool.observer.names[pool.known.kept[index]] for index in columns)
        raise NotIdentifiable(
            f"{asked.path}: [plan] {count} poses are too few: no plan of them shows "
            f"{', '.join(names) or 'all parameters'}, which criterion {criterion} needs; plan more poses, more loads "
            "at each pose or more markers",
            names,
        ) from error
    return np.repeat(np.arange(len(found.counts)), found.counts)


def guarded_search(
    pool: AnyPool, count: int, seed: int, best: Floats | None = None
) -> tuple[Ints, Guard, tuple[str, ...]]:
    """Search; where the plan sees little but the test poses, weigh the parameters' own variances in.

    Args:
        pool: The candidates.
        count: Number of experiments.
        seed: Of the search.
        best: (p,) standard deviations that count as the best; None to search for them.

    Returns:
        Chosen candidates, the guard they were found with, and notes.

    Raises:
        Infeasible: ``max_std_percent`` cannot be met.
    """
    aim, asked = pool.objective, pool.observer
    chosen = search(pool, count, seed, Guard())
    if aim.criterion not in {"test_pose", "G"} or not count:
        return chosen, Guard(), ()
    if best is None:
        thorough = _found(pool, np.eye(aim.size), count, seed, "A", "normal")
        best = standard_deviations(pool.information(pool.blocks[thorough]))
    percent = asked.settings.max_std_percent
    name, ratio = _worst(pool, pool.blocks[chosen], best)
    if ratio <= percent / 100.0:
        return chosen, Guard(best), ()
    unguarded = aim.value(pool.information(pool.blocks[chosen]))
    share = 1e-4 * max(unguarded if np.isfinite(unguarded) else 1.0, 1e-300) / aim.size
    for _ in range(_GUARD_ROUNDS):
        guard = Guard(best, share)
        chosen = search(pool, count, seed, guard, effort="low")
        if _worst(pool, pool.blocks[chosen], best)[1] <= percent / 100.0:
            value = aim.value(pool.information(pool.blocks[chosen]))
            cost = f"costs {100 * (value / unguarded - 1):.2g} %" if np.isfinite(unguarded) else "keeps it identifiable"
            note = (
                f"the best plan for the test poses alone would tell {name} {_times(ratio)}; "
                f"max_std_percent = {percent:g} {cost}"
            )
            return chosen, guard, (note,)
        share *= 8.0
    raise Infeasible(
        f"{asked.path}: [plan] max_std_percent = {percent:g} cannot be met with {count} poses: the best plan for the "
        f"test poses tells {name} {_times(ratio)}; allow more"
    )


def blind_spot(pool: AnyPool, own: Floats, best: Floats) -> tuple[str, ...]:
    """A note if ``max_std_percent`` allows a plan that sees little but the test poses, and it is one."""
    name, ratio = _worst(pool, own, best)
    percent = pool.observer.settings.max_std_percent
    if ratio <= _USUAL_PERCENT / 100.0 * (1.0 + 1e-6):
        return ()
    return (
        f"this plan sees little but the test poses: it tells {name} {_times(ratio)}, which max_std_percent = "
        f"{percent:g} allows; it is of little use for other poses or loads",
    )


def _worst(pool: AnyPool, own: Floats, best: Floats) -> tuple[str, float]:
    """The parameter that a plan (n, k, p) tells worst relative to ``best`` (p,), and how much worse."""
    ratio = standard_deviations(pool.information(own)) / best
    worst = int(np.argmax(ratio))
    return pool.observer.names[pool.known.kept[worst]], float(ratio[worst])


def _times(ratio: float) -> str:
    """A ratio of standard deviations in words."""
    return f"{ratio:.3g} times worse than a plan for the parameters" if math.isfinite(ratio) else "not at all"
