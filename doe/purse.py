"""What experiments cost: a lower bound of the time that each takes, or what the study says that it costs.

The time of an experiment counts settling, readings and the crane operations within its visit, which no order of the
visits can save; travel and operations between visits come on top. A bound that is proven with these times therefore
holds for every plan that fits into the time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.lifts import hung_states, orders_of
from doe.schedule import pace_of
from identify.arrays import Floats, Ints, frozen
from identify.errors import Infeasible
from identify.study import Study

__all__ = ["Purse", "prices", "purse_of"]


@dataclass(frozen=True, eq=False)
class Purse:
    """What may be spent on experiments.

    Attributes:
        key: Key of the study.
        asked: What the study allows, s or units of cost.
        budget: What may be spent on experiments.
        costs: (N,) of the candidates.
    """

    key: str
    asked: float
    budget: float
    costs: Floats

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "costs", frozen(self.costs))


def purse_of(study: Study, visit_loads: Ints, *, own_visits: bool) -> Purse:
    """What the plan of a study may spend on candidates.

    Args:
        study: The study; its plan has a budget.
        visit_loads: (N, L) loads of the candidates.
        own_visits: The unloaded state is read in visits of its own.

    Raises:
        Infeasible: Not even the cheapest candidate can be paid.
    """
    costs = prices(study, visit_loads, own_visits=own_visits)
    if study.plan.time_budget is None:
        key, asked, ahead = "cost_budget", float(study.plan.cost_budget or 0.0), 0.0
    else:
        pace = pace_of(study.times)
        hung = ~np.array([load.unloaded for load in study.loads])[visit_loads]
        once = pace.load_change if own_visits and hung.any(axis=1).all() else 0.0  # every plan hangs something
        key, asked, ahead = "time_budget_s", study.plan.time_budget, pace.start + once
    if asked - ahead < costs.min():
        raise Infeasible(
            f"{study.path}: [plan] {key} = {asked:g} is too small: one experiment takes at least "
            f"{costs.min() + ahead:g}"
        )
    return Purse(key, asked, asked - ahead, costs)


def prices(study: Study, visit_loads: Ints, *, own_visits: bool) -> Floats:
    """(n,) least time, s, or cost of experiments with loads (n, L)."""
    kinds, kind = np.unique(visit_loads, axis=0, return_inverse=True)
    unloaded = np.array([load.unloaded for load in study.loads])
    visits = kinds.shape[1] if own_visits else 1
    if study.plan.time_budget is None:
        each = np.array(study.load_costs)[kinds].sum(axis=1) + visits * study.plan.pose_cost
        return np.asarray(each[kind.ravel()], dtype=np.float64)
    pace = pace_of(study.times)
    within = [0 if own_visits else orders_of(states).lifts.min() for states in hung_states(kinds, unloaded)]
    further = kinds.shape[1] - visits
    each = visits * pace.pose + further * pace.reading + pace.load_change * np.array(within)
    return np.asarray(each[kind.ravel()], dtype=np.float64)
