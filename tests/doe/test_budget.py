"""Budgets of time and cost: the bound holds for every plan that fits, and the ordered plan fits."""

from dataclasses import replace
from itertools import combinations_with_replacement, permutations, product

import numpy as np
import pytest

from doe import exact_design
from doe.bounds import bound_of
from doe.exact import ExactDesign
from doe.guard import _best_buy
from doe.information import information_of
from doe.order import Visits, measured
from doe.plan import plan
from doe.purse import Purse, prices, purse_of
from doe.schedule import pace_of
from doe.travel import travel_between
from identify.errors import Infeasible
from identify.study import Times
from tests.doe.study_files import ARM, KR270, study

TIMES = {"pose_s": 50.0, "reading_s": 20.0, "load_change_s": 200.0, "speed_deg_s": 30.0, "start_s": 100.0}
LOADS = [
    {"id": "L0"},
    {"id": "L1", "wrench": [0, 0, -1, 0, 0, 0], "cost": 2.0},
    {"id": "L2", "wrench": [1, 0, 0, 0, 0, 0], "cost": 5.0},
]


def arm(folder, **asked):
    """The three-joint arm with two loads and a budget."""
    settings = {"poses": None, "candidates": 12, "refine": False, "reference_rows": True, **asked}
    return study(folder, ARM, loads=LOADS, plan=settings, times=TIMES)


def least_time(made, q, loads, limit):
    """The shortest time in which visits can be made, by trying all orders; stops at the first that keeps the limit."""
    travel = travel_between(q, made.robot.prismatic, speed=made.times.speed, speed_slide=made.times.speed_slide)
    unloaded = [load.unloaded for load in made.loads]
    visits = Visits(loads, unloaded, travel, pace_of(made.times), np.zeros((*loads.shape, 1)))
    best = np.inf
    for order in permutations(range(len(q))):
        for turns in product([(0, 1), (1, 0)], repeat=len(q)):
            best = min(best, measured(visits, np.array(order), np.array(turns)).times.max())
            if best <= limit:
                return best
    return best


def test_no_plan_that_fits_into_the_time_is_better_than_the_bound(tmp_path):
    made_study = arm(tmp_path, time_budget_s=1150.0)
    made = plan(made_study)
    drawn, blocks = made.pool.candidates, made.pool.blocks
    aim = made.pool.objective
    best = np.inf
    for count in (1, 2, 3):
        for chosen in combinations_with_replacement(range(len(drawn)), count):
            value = aim.value(information_of(blocks[list(chosen)]))
            if value >= best:
                continue
            q, loads = drawn.visit_q[list(chosen)], drawn.visit_loads[list(chosen)]
            if least_time(made_study, q, loads, 1150.0) <= 1150.0:
                best = value
    assert np.isfinite(best)
    assert made.final.bound <= best * (1 + 1e-9)
    assert best <= made.final.value * (1 + 1e-9)
    assert made.schedule.time <= 1150.0


def test_prices_are_never_above_the_true_time(tmp_path):
    made_study = arm(tmp_path, time_budget_s=3000.0)
    made = plan(made_study)
    assert prices(made_study, made.visit_loads, own_visits=False).sum() <= made.schedule.time - 100.0
    np.testing.assert_allclose(prices(made_study, np.array([[0, 1], [0, 2]]), own_visits=False), 50 + 20 + 200)
    np.testing.assert_allclose(prices(made_study, np.array([[0, 1], [0, 2]]), own_visits=True), 2 * 50)


def test_a_budget_of_cost_is_kept_and_its_bound_holds(tmp_path):
    made = plan(arm(tmp_path, cost_budget=20.0, pose_cost=1.0, candidates=8, max_std_percent=1e9))
    costs = prices(made.pool.observer.study, made.pool.candidates.visit_loads, own_visits=False)
    assert set(costs) == {3.0, 6.0}
    assert made.bought.spent == prices(made.pool.observer.study, made.visit_loads, own_visits=False).sum() <= 20.0
    blocks, aim = made.pool.blocks, made.pool.objective
    best = np.inf
    for count in range(1, 7):
        for chosen in combinations_with_replacement(range(len(costs)), count):
            if costs[list(chosen)].sum() <= 20.0:
                best = min(best, aim.value(information_of(blocks[list(chosen)])))
    assert made.final.bound <= best * (1 + 1e-9)
    assert made.final.value <= best * (1 + 1e-9)


def test_without_repeats_a_budget_for_everything_buys_everything(tmp_path):
    made = plan(arm(tmp_path, cost_budget=1e4, pose_cost=1.0, repeats=False))
    assert len(made.q) == len(made.pool.candidates)
    assert made.final.bound <= made.final.value * (1 + 1e-12)


def test_the_bound_of_a_budget_is_that_of_the_exact_search(tmp_path):
    made = plan(arm(tmp_path, cost_budget=40.0, pose_cost=1.0))
    costs = made.bought.purse.costs
    aim, blocks = made.pool.objective, made.pool.blocks
    found = exact_design(blocks, aim.target(), len(made.q), costs=costs, budget=40.0, effort="low")
    bound = bound_of(
        aim, 1, blocks, blocks[:0], made.final.value, repeats=True, costs=(costs, np.zeros(0)), budget=40.0
    )
    assert bound.bound <= found.bound * (1 + 1e-4)
    assert bound.bound == made.final.bound


@pytest.mark.slow
def test_a_plan_that_does_not_fit_with_its_travel_is_made_smaller(tmp_path):
    """Slow joints: what the experiments leave of the time does not pay for the way between them."""
    slow = {**TIMES, "speed_deg_s": 1.0}
    made = plan(
        study(
            tmp_path,
            KR270,
            times=slow,
            plan={"poses": None, "time_budget_s": 6000.0, "candidates": 80, "refine": False},
        )
    )
    assert made.bought.searched < made.bought.purse.budget
    assert made.schedule.time <= 6000.0
    assert made.bought.spent <= made.bought.searched
    assert made.final.bound < made.final.value


def test_a_refined_plan_keeps_the_budget_too(tmp_path):
    made = plan(
        study(
            tmp_path,
            KR270,
            times=TIMES,
            plan={"poses": None, "time_budget_s": 3600.0, "candidates": 80, "refine": True},
        )
    )
    assert made.final.value < made.grid.value
    assert made.schedule.time <= 3600.0
    assert made.final.bound <= made.final.value


def test_what_cannot_be_paid_is_refused(tmp_path):
    made = arm(tmp_path, time_budget_s=1150.0)
    drawn = np.array([[0, 1], [0, 2]])
    with pytest.raises(Infeasible, match=r"time_budget_s = 300 is too small: one experiment takes at least 370"):
        purse_of(replace(made, plan=replace(made.plan, time_budget=300.0)), drawn, own_visits=False)
    crawl = replace(made, times=Times(50.0, 20.0, 200.0, 1e-5, 1.0, 100.0))
    with pytest.raises(Infeasible, match="with travel and crane operations no plan fits"):
        plan(crawl)
    own = purse_of(made, drawn, own_visits=True)
    assert own.budget == 1150.0 - 100.0 - 200.0


def test_only_the_most_promising_numbers_are_searched_in_full():
    asked = []

    def design(number, effort="normal"):
        asked.append((number, effort))
        worth = {None: 5.0, 2: 9.0, 4: 3.0, 7: 4.0, 10: 6.0}[number]
        return ExactDesign(
            np.zeros(1, dtype=np.int64), worth - (effort == "normal") * (number == 7) * 2.0, 1.0, 1.0, ""
        )

    best = _best_buy(design, Purse("cost_budget", 10.0, 10.0, np.array([1.0, 5.0])), 100)
    assert [number for number, effort in asked if effort == "low"] == [None, 2, 4, 7, 10]
    assert [number for number, effort in asked if effort == "normal"] == [4, 7]
    assert best.value == 2.0


def test_with_one_price_there_is_one_search_in_full():
    asked = []

    def design(number, effort="normal"):
        asked.append((number, effort))
        return ExactDesign(np.zeros(1, dtype=np.int64), 1.0, 1.0, 1.0, "")

    _best_buy(design, Purse("time_budget_s", 10.0, 10.0, np.array([2.0, 2.0])), 100)
    assert asked == [(None, "normal")]
