"""The order of visits: operations first, then drift and travel."""

from itertools import permutations, product

import numpy as np
import pytest

from doe.lifts import hung_states, lifts_of
from doe.order import Pace, Visits, as_found, measured
from doe.order_moves import moved, moves_of
from doe.order_search import best_order
from doe.order_tables import Tables
from doe.routing import short_route
from doe.travel import travel_between
from identify.errors import Infeasible, InputError

TURNING = np.zeros(3, dtype=bool)


def visits(seed=0, count=8, weights=1, drift=0.0, pace=None, **more):
    """Random visits with an unloaded reading and one of some weights."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (count, 3))
    loads = np.column_stack([np.zeros(count, dtype=int), rng.integers(1, weights + 1, count)])
    effect = drift * (rng.normal(size=(count, 1, 4)) - 1.0) * np.array([-1.0, 1.0])[:, None]
    unloaded = np.arange(weights + 1) == 0
    travel = travel_between(q, TURNING, speed=0.5, **more)
    return Visits(loads, unloaded, travel, pace or Pace(60.0, 10.0, 300.0), effect, own=0.01)


def order(made, seed=0):
    return best_order(made, np.random.default_rng(seed))[0]


def states_of(made, found):
    loads = np.take_along_axis(made.loads[found.visit], found.reading, axis=1)
    return hung_states(loads, made.unloaded)


@pytest.mark.parametrize("weights", [1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_the_order_takes_the_fewest_operations_and_every_visit_once(weights, seed):
    made = visits(seed, count=5, weights=weights, drift=0.1)
    found, fewest = best_order(made, np.random.default_rng(seed))
    assert sorted(found.visit) == list(range(5))
    assert (np.sort(found.reading, axis=1) == [0, 1]).all()
    assert found.lifts == lifts_of(states_of(made, found)) == fewest.lifts
    every = [
        lifts_of(hung_states(made.loads[list(p)], made.unloaded)[np.arange(5)[:, None], list(r)])
        for p in permutations(range(5))
        for r in product([(0, 1), (1, 0)], repeat=5)
    ]
    assert found.lifts == min(every)


def test_drift_is_much_smaller_than_with_the_unloaded_state_first():
    for seed in range(5):
        made = visits(seed, count=12, weights=2, drift=0.02)
        ordered, naive = (float(np.linalg.norm(o.drift)) for o in (order(made), as_found(made)))
        assert ordered < 0.2 * naive
        assert order(made).lifts < as_found(made).lifts


def test_a_pose_that_is_visited_twice_lets_drift_cancel_completely():
    made = visits(3, count=2)
    same = np.broadcast_to(np.array([[[-1.0], [1.0]]]), (2, 2, 1))
    made = Visits(made.loads, made.unloaded, made.travel, made.pace, same, own=0.01)
    assert np.abs(order(made).drift).max() < 1e-12
    assert np.abs(as_found(made).drift).max() > 0.1


@pytest.mark.parametrize("seed", range(4))
def test_without_drift_travel_is_not_longer_than_to_the_nearest_neighbour_each_time(seed):
    made = visits(seed, count=15, weights=1, home=np.zeros(3))
    left, here, way = set(range(15)), 15, 0.0
    while left:
        nearest = min(left, key=lambda v: made.travel.length[0, here, v])
        way += made.travel.length[0, here, nearest]
        here = nearest
        left.remove(nearest)
    found = order(made)
    before = np.append(15, found.visit[:-1])
    assert made.travel.length[0, before, found.visit].sum() <= way * (1 + 1e-12)


def before_each(route, home):
    """What comes before each visit of a route from home."""
    return np.append(home, route[:-1])


def test_without_drift_a_short_plan_has_the_shortest_route_of_all():
    for seed in range(4):
        made = visits(seed, count=6, weights=1, home=np.zeros(3))
        best = min(made.travel.length[0, before_each(p, 6), list(p)].sum() for p in permutations(range(6)))
        found = order(made)
        assert made.travel.length[0, before_each(found.visit, 6), found.visit].sum() == pytest.approx(best, rel=1e-12)


def test_the_tables_judge_an_order_as_its_readings_do():
    made = visits(1, count=7, weights=2, drift=0.3)
    tables = Tables(made)
    rng = np.random.default_rng(0)
    for _ in range(20):
        visit, option = rng.permutation(7), rng.integers(2, size=7)
        found = tables.order(visit, option)
        assert tables.lifts(visit[None], option[None])[0] == found.lifts == lifts_of(states_of(made, found))
        seconds, _ = tables.ways(visit[None], option[None])
        drift = tables.drifts(visit[None], option[None], seconds)[0]
        assert drift == pytest.approx(np.linalg.norm(found.drift), rel=1e-9)


def test_times_are_those_of_a_stop_watch():
    q = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.5]])
    travel = travel_between(q, TURNING, speed=0.1)
    made = Visits([[0, 1], [0, 1]], [True, False], travel, Pace(60.0, 10.0, 300.0, 500.0), np.zeros((2, 2, 1)))
    found = measured(made, np.array([1, 0]), np.array([[0, 1], [1, 0]]))
    first = 500.0 + 60.0
    np.testing.assert_allclose(found.times[0], [first, first + 310.0])
    np.testing.assert_allclose(found.times[1], found.times[0, 1] + 10.0 + 60.0 + np.array([0.0, 310.0]))
    assert found.lifts == 2


def test_the_same_random_numbers_give_the_same_order():
    made = visits(2, count=10, weights=2, drift=0.05)
    first, second = order(made, 5), order(made, 5)
    assert (first.visit == second.visit).all()
    assert (first.reading == second.reading).all()


def test_unloaded_visits_of_their_own_stand_around_the_weights():
    """U A U: two operations for a weight, and a drift that grows with time cancels."""
    count = 8
    q = np.repeat(np.random.default_rng(0).uniform(-1, 1, (count, 3)), 2, axis=0)
    loads, signs = np.tile([[0], [1]], (count, 1)), np.tile([-1.0, 1.0], count)
    made = Visits(
        loads, [True, False], travel_between(q, TURNING), Pace(), signs[:, None, None] * 0.1, own=0.01, taken_off=True
    )
    found = order(made)
    assert found.lifts == 2
    assert np.abs(found.drift).max() < 1e-9
    assert as_found(made).lifts == 15


# --- travel


def test_a_move_takes_as_long_as_its_slowest_joint_and_sliding_joints_have_their_own_speed():
    q = np.array([[0.0, 0.0], [0.5, 0.2]])
    travel = travel_between(q, np.array([False, True]), speed=0.5, speed_slide=0.1)
    assert travel.seconds[0, 0, 1] == pytest.approx(2.0)
    assert travel.degrees[0, 0, 1] == pytest.approx(np.rad2deg(0.5))
    assert travel.along(np.array([0, 1]), np.array([-1, -1])) == pytest.approx((2.0, np.rad2deg(0.5), 0))


def wall(first, second, _):
    """A wall at zero of the first joint."""
    return first[:, 0] * second[:, 0] >= 0.0


def test_a_blocked_move_goes_over_home_and_is_avoided_where_it_can_be():
    q = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.1, 0.0], [1.0, 0.1, 0.0]])
    home = np.array([0.0, -1.0, 0.0])
    travel = travel_between(q, TURNING, speed=1.0, home=home, free=wall)
    assert travel.detour[0, 0, 1]
    assert not travel.detour[0, 0, 2]
    assert travel.seconds[0, 0, 1] == pytest.approx(travel.seconds[0, 0, 4] + travel.seconds[0, 4, 1])
    made = Visits([[0, 1]] * 4, [True, False], travel, Pace(), np.zeros((4, 2, 1)))
    assert travel.along(order(made).visit, np.full(4, -1))[2] == 1


def test_a_route_that_cannot_be_driven_is_refused_by_name():
    q = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    travel = travel_between(q, TURNING, free=wall)
    made = Visits([[0, 1]] * 2, [True, False], travel, Pace(), np.zeros((2, 2, 1)))
    found = order(made)
    with pytest.raises(Infeasible, match=r"study: .* P001 to P002.*home_deg"):
        travel.check(found.visit, found.carried, ("P001", "P002"), "study")


def test_home_has_one_value_a_joint():
    with pytest.raises(InputError, match="one value a joint"):
        travel_between(np.zeros((2, 3)), TURNING, home=np.zeros(2))


def test_the_solver_visits_one_place_of_each_group():
    """It must also do so in a process with cvxpy, whose HiGHS library is not that of the solver."""
    import cvxpy

    assert cvxpy.installed_solvers()
    costs = np.array([[0, 9, 1, 9, 0], [9, 0, 9, 1, 0], [1, 9, 0, 9, 0], [9, 1, 9, 0, 0], [5, 1, 5, 5, 0.0]])
    assert short_route(costs, np.array([0, 0, 1, 1])).tolist() == [1, 3]


@pytest.mark.parametrize("count", [2, 3, 6])
def test_every_move_keeps_all_visits(count):
    places = moved(moves_of(count), count)
    assert (np.sort(places, axis=1) == np.arange(count)).all()
