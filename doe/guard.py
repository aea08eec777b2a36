"""The search on the grid, guarded against plans that see little but the test poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from doe.exact import ExactDesign, exact_design
from doe.information import standard_deviations
from doe.losses import after_losses
from doe.objective import Objective
from doe.pool import AnyPool
from doe.purse import Purse
from doe.robust import exchanged, worst_case
from identify.arrays import Floats, Ints
from identify.errors import Infeasible, InputError, NotIdentifiable
from identify.units import counted

__all__ = ["Guard", "blind_spot", "guarded_search", "search"]

_GUARD_ROUNDS = 12
_NUMBERS = 4  # numbers of experiments that a budget is tried with, beside what the search finds itself
_THOROUGH = 2  # of them are searched in full
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


def search(
    pool: AnyPool,
    count: int | None,
    seed: int,
    guard: Guard,
    *,
    effort: str = "normal",
    purse: Purse | None = None,
    prove: bool = True,
) -> Ints:
    """Indices of the chosen candidates (n,) for the criterion of the study, repeats included.

    Args:
        pool: What to choose from.
        count: Number of experiments, with 0 nothing is chosen; None: what the purse pays for.
        seed: Of the random moves.
        guard: What is weighed in.
        effort: As in `doe.exact.exact_design`.
        purse: What may be spent.
        prove: Also search by branch and bound.

    Raises:
        InputError: A purse in a plan that must be robust, whose exchanges do not look at costs.
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    aim, losses = pool.objective, pool.observer.settings.losses
    chosen = _found(pool, guard.target(aim), count, seed, aim.criterion, effort, purse, prove=prove)
    if not losses and not pool.draws:
        return chosen
    if purse is not None:
        raise InputError(
            f"{pool.observer.path}: [plan] {purse.key} is not for plans with robust_to_losses or draws; give poses or "
            "tolerance_mm"
        )
    chosen = exchanged(pool, guard.target, chosen, losses, effort, seed)
    left = after_losses(pool.blocks[chosen], losses, pool.prior)
    if not np.isfinite(worst_case([aim], [left])[0]):
        raise NotIdentifiable(
            f"{pool.observer.path}: [plan] {_few(count, None)} for robust_to_losses = {losses}: after the worst "
            f"loss the rest does not show what criterion {aim.criterion} needs; plan more poses"
        )
    return chosen


def _found(
    pool: AnyPool,
    target: Floats,
    count: int | None,
    seed: int,
    criterion: str,
    effort: str = "normal",
    purse: Purse | None = None,
    *,
    prove: bool = True,
) -> Ints:
    """The best design on the candidates: ``count`` of them, or what the purse pays for.

    Raises:
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    asked = pool.observer

    def design(number: int | None, effort: str = effort) -> ExactDesign:
        return exact_design(
            pool.blocks,
            target,
            number,
            criterion=criterion,
            repeats=asked.settings.repeats,
            costs=None if purse is None else purse.costs,
            budget=None if purse is None else purse.budget,
            prior=pool.prior,
            effort=effort,
            seed=seed,
            restarts=asked.settings.restarts,
            prove=prove,
            executor=pool.executor,
        )

    try:
        found = design(count) if purse is None or count is not None else _best_buy(design, purse, len(pool.blocks))
    except NotIdentifiable as error:
        columns = [index for index in error.missing if isinstance(index, int)]
        names = tuple(pool.observer.names[pool.known.kept[index]] for index in columns)
        raise NotIdentifiable(
            f"{asked.path}: [plan] {_few(count, purse)}: no plan of them shows "
            f"{', '.join(names) or 'all parameters'}, which criterion {criterion} needs; plan more poses, more loads "
            "at each pose or more markers",
            names,
        ) from error
    return np.repeat(np.arange(len(found.counts)), found.counts)


def _best_buy(design: Callable[..., ExactDesign], purse: Purse, candidates: int) -> ExactDesign:
    """The best of what a purse pays for: any number of experiments, and some numbers between dear and cheap ones.

    Exchanging one experiment for one does not get from many cheap ones to fewer dear ones. Which number is good shows
    in a quick search; only the most promising ones are searched in full.

    Raises:
        NotIdentifiable: No number shows what the criterion needs.
    """
    least, most = (min(int(purse.budget / cost), candidates) for cost in (purse.costs.max(), purse.costs.min()))
    spread = np.linspace(least, most, _NUMBERS if most > least else 0)
    numbers = sorted({int(n) for n in spread if n >= 1})
    if not numbers:
        return design(None)
    found: list[tuple[ExactDesign, int | None]] = []
    missed: NotIdentifiable | None = None
    for number in (None, *numbers):
        try:
            found.append((design(number, "low"), number))
        except NotIdentifiable as error:
            missed = missed or error
    if missed is not None and not found:
        raise missed
    found.sort(key=lambda each: each[0].value)
    thorough = [design(number) for _, number in found[:_THOROUGH]]
    return min([*thorough, found[0][0]], key=lambda each: each.value)


def guarded_search(
    pool: AnyPool,
    count: int | None,
    seed: int,
    best: Floats | None = None,
    *,
    purse: Purse | None = None,
    prove: bool = True,
) -> tuple[Ints, Guard, tuple[str, ...]]:
    """Search; where the plan sees little but the test poses, weigh the parameters' own variances in.

    Args:
        pool: The candidates.
        count: Number of experiments.
        seed: Of the search.
        best: (p,) standard deviations that count as the best; None to search for them.
        purse: What may be spent.
        prove: Also search by branch and bound.

    Returns:
        Chosen candidates, the guard they were found with, and notes.

    Raises:
        Infeasible: ``max_std_percent`` cannot be met.
    """
    aim, asked = pool.objective, pool.observer
    chosen = search(pool, count, seed, Guard(), purse=purse, prove=prove)
    if aim.criterion not in {"test_pose", "G"} or count == 0:
        return chosen, Guard(), ()
    if best is None:
        thorough = _found(pool, np.eye(aim.size), count, seed, "A", purse=purse, prove=False)
        best = standard_deviations(pool.information(pool.blocks[thorough]))
    percent = asked.settings.max_std_percent
    name, ratio = _worst(pool, pool.blocks[chosen], best)
    if ratio <= percent / 100.0:
        return chosen, Guard(best), ()
    unguarded = aim.value(pool.information(pool.blocks[chosen]))
    share = 1e-4 * max(unguarded if np.isfinite(unguarded) else 1.0, 1e-300) / aim.size
    for _ in range(_GUARD_ROUNDS):
        guard = Guard(best, share)
        chosen = search(pool, count, seed, guard, effort="low", purse=purse)
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
        f"{asked.path}: [plan] max_std_percent = {percent:g} cannot be met with {_amount(count, purse)}: the best "
        f"plan for the test poses tells {name} {_times(ratio)}; allow more"
    )


def _amount(count: int | None, purse: Purse | None) -> str:
    """How much may be measured, in words."""
    if purse is None:
        return counted(count or 0, "pose")
    return f"the poses that {purse.key} = {purse.asked:g} pays for"


def _few(count: int | None, purse: Purse | None) -> str:
    """That so much is too little, in words."""
    return f"{_amount(count, purse)} {'is' if count == 1 and purse is None else 'are'} too few"


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
