"""Crane operations: closed forms, and the fewest found by enumerating every order."""

from itertools import permutations, product

import numpy as np
import pytest

from doe.lifts import NOTHING, fewest_lifts, hung_states, lifts_of, orders_of

UNLOADED = np.array([True, False, False, False])


def fewest(loads):
    """The fewest operations of visits (V, S)."""
    states = hung_states(np.array(loads), UNLOADED)
    kinds, counts = np.unique(states, axis=0, return_counts=True)
    return fewest_lifts(tuple(orders_of(kind) for kind in kinds), counts), kinds


def enumerated(loads):
    """The fewest operations among all orders of the visits and of the readings in each."""
    states = [tuple(int(s) for s in row) for row in hung_states(np.array(loads), UNLOADED)]
    return min(
        lifts_of(np.array(reading))
        for order in set(permutations(states))
        for reading in product(*(set(permutations(visit)) for visit in order))
    )


def test_a_change_of_weights_is_two_operations_and_nothing_hangs_at_first():
    assert lifts_of(np.array([NOTHING, NOTHING])) == 0
    assert lifts_of(np.array([1])) == 1
    assert lifts_of(np.array([1, 1, 2, NOTHING, 2])) == 1 + 2 + 1 + 1


CASES = {
    "one weight": [[0, 1]] * 4,
    "two weights": [[0, 1], [0, 2], [0, 1], [0, 2]],
    "odd numbers": [[0, 1], [0, 2], [0, 3], [0, 1], [0, 1]],
    "single readings": [[0], [1], [2], [1], [0], [3]],
    "no unloaded ones": [[1, 2], [1, 3], [1, 2], [2, 3]],
    "two weights a visit": [[0, 1, 2], [0, 1, 2], [0, 1, 3]],
    "odd number of two weights": [[0, 1, 2]] * 3,
}


@pytest.mark.parametrize("name", CASES)
def test_the_fewest_operations_are_those_of_enumeration(name):
    found, _ = fewest(CASES[name])
    assert found.proven
    assert found.lifts == enumerated(CASES[name])


@pytest.mark.parametrize("seed", range(12))
def test_random_visits_too(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 4))
    loads = [rng.choice(4, size=size, replace=False) for _ in range(4)]
    assert fewest(loads)[0].lifts == enumerated(loads)


def test_the_steps_take_what_is_said_and_visit_everything():
    loads = [[0, 1], [0, 2], [0, 1], [0, 1], [0, 2], [0, 3]]
    found, kinds = fewest(loads)
    orders = [orders_of(kind) for kind in kinds]
    readings = [kinds[kind][orders[kind].places[order]] for kind, order in found.steps]
    assert lifts_of(np.array(readings)) == found.lifts
    assert sorted(tuple(np.sort(r)) for r in readings) == sorted(
        tuple(np.sort(s)) for s in hung_states(np.array(loads), UNLOADED)
    )


@pytest.mark.parametrize("counts", [(400, 301, 77), (3, 3, 3), (2, 4, 6), (1, 1, 1)])
def test_many_visits_are_put_aside_in_pairs_without_loss(counts):
    """One operation a visit, and one more for each weight but one that is visited an odd number of times."""
    loads = [[0, weight] for weight, count in enumerate(counts, start=1) for _ in range(count)]
    found, _ = fewest(loads)
    odd = sum(count % 2 for count in counts)
    assert found.proven
    assert found.lifts == len(loads) + max(odd - 1, 0)
    assert len(found.steps) == len(loads)


def test_a_pair_that_is_put_aside_goes_there_and_back(monkeypatch):
    monkeypatch.setattr("doe.lifts._STATES", 1)
    for loads in CASES.values():
        assert fewest(loads)[0].lifts == enumerated(loads)


def test_without_a_search_nothing_is_claimed(monkeypatch):
    monkeypatch.setattr("doe.lifts._MOST_STATES", 1)
    found, _ = fewest(CASES["odd numbers"])
    assert not found.proven
    assert found.lifts == enumerated(CASES["odd numbers"])


def test_orders_of_readings_are_the_cheapest_between_their_ends_and_can_be_turned_round():
    orders = orders_of(np.array([NOTHING, 1, 2]))
    for end in set(zip(orders.entry.tolist(), orders.exit.tolist(), strict=True)):
        same = [i for i in range(len(orders.lifts)) if (orders.entry[i], orders.exit[i]) == end]
        assert len({int(orders.lifts[i]) for i in same}) == 1
    assert (orders.places[orders.reverse] == orders.places[:, ::-1]).all()
    long = orders_of(np.arange(-1, 6))
    assert long.places.tolist() == [list(range(7)), list(range(7))[::-1]]
