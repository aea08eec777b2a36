"""The best plan that really fits into a budget: what travel and further crane operations take is saved elsewhere."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

from doe.choice import Choice, choose
from doe.pool import Pool
from doe.purse import Purse, prices, purse_of
from doe.schedule import Schedule
from identify.errors import Infeasible

__all__ = ["Bought", "within_budget"]

_ROUNDS = 20  # two or three are usual
_ROUNDING = 1e-9

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Bought:
    """A plan that fits into a budget.

    Attributes:
        choice: The experiments.
        schedule: Their order; None without any.
        purse: What might have been spent.
        searched: The budget for experiments with which they were found; the rest goes into travel and crane.
        spent: Their costs together.
    """

    choice: Choice
    schedule: Schedule | None
    purse: Purse
    searched: float
    spent: float


def within_budget(pool: Pool, seed: int, scheduled: Callable[[Choice], Schedule | None]) -> Bought:
    """Search with the whole budget, then with less and less until the ordered plan fits.

    Args:
        pool: The candidates.
        seed: Seed of the search.
        scheduled: Puts a choice in order.

    Raises:
        Infeasible: Nothing fits.
        NotIdentifiable: What can be paid does not show what the criterion needs.
    """
    watching = pool.observer
    purse = purse_of(watching.study, pool.candidates.visit_loads, own_visits=watching.own_visits)
    spend, cheapest = purse.budget, float(purse.costs.min())
    for _ in range(_ROUNDS):
        choice = choose(pool, None, seed, purse=replace(purse, budget=spend))
        ordered = scheduled(choice)
        spent = float(prices(watching.study, choice.visit_loads, own_visits=watching.own_visits).sum())
        over = 0.0 if purse.key == "cost_budget" else ((ordered and ordered.time) or 0.0) - purse.asked
        if over <= _ROUNDING * purse.asked:
            return Bought(choice, ordered, purse, spend, spent)
        log.info("%d experiments take %.0f s too long; searching fewer", len(choice.q), over)
        spend = spent - over
        if spend < cheapest:
            break
    raise Infeasible(
        f"{watching.path}: [plan] {purse.key} = {purse.asked:g} is too small: with travel and crane operations no plan "
        "fits; allow more time or faster moves"
    )
