"""Exact designs: equal to brute force, never below the bound, limits kept, errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from plain_design import brute_force, information, plans, value_of
from reference_cases import reference_case

from doe import approximate_design, exact_design, local_search
from doe.boxes import Box, relax
from doe.branch import branch_and_bound
from doe.local_search import Limits, make_pool
from doe.problem import make_problem
from identify.errors import Infeasible, InputError, NotIdentifiable

CRITERIA = ("test_pose", "A", "D", "E", "G")


def condition(matrix):
    """Condition number on unit columns, of what the matrix shows."""
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    values = np.linalg.eigvalsh(matrix / scale / scale[:, None])
    return values[-1] / values[values > 1e-13 * values[-1]][0]


@settings(max_examples=80, deadline=None)
@example(seed=1043, criterion="E", shape=(7, 1, 4), n=4, repeats=True, with_prior=False, money="none")
@given(
    seed=st.integers(0, 10**6),
    criterion=st.sampled_from(CRITERIA),
    shape=st.tuples(st.integers(2, 7), st.integers(1, 3), st.integers(1, 4)),
    n=st.integers(1, 4),
    repeats=st.booleans(),
    with_prior=st.booleans(),
    money=st.sampled_from(["none", "budget", "both"]),
)
def test_tiny_instances_equal_brute_force(seed, criterion, shape, n, repeats, with_prior, money):
    rng = np.random.default_rng(seed)
    count, k, p = shape
    n = n if repeats else min(n, count)
    blocks = rng.normal(size=shape) * 10.0 ** rng.uniform(-2, 2, p)
    blocks[-1] = blocks[0]
    target = rng.normal(size=(2, 2, count * k)) @ blocks.reshape(-1, p)
    target = target if criterion == "G" else target[0]
    factor = rng.normal(size=(1, p)) * abs(blocks).mean(axis=(0, 1))
    prior = factor.T @ factor if with_prior else None
    costs = None if money == "none" else rng.uniform(0.5, 2.0, count)
    budget = None if money == "none" else float(rng.uniform(1.0, 4.0))
    n = None if money == "budget" else n
    every = list(plans(count, n, repeats, costs, budget))
    best = brute_force(criterion, blocks, target, prior, every)
    limits = {"criterion": criterion, "repeats": repeats, "costs": costs, "budget": budget, "prior": prior}
    if not np.isfinite(best):
        with pytest.raises((Infeasible, NotIdentifiable)):
            exact_design(blocks, target, n, **limits)
        return
    design = exact_design(blocks, target, n, **limits)
    matrix = information(blocks, design.counts, prior)
    rel = max(1e-6, 1e-14 * condition(matrix))  # rounding of M itself, in the plain inverse as in ours
    assert design.value == pytest.approx(best, rel=rel)
    assert design.bound <= best * (1 + rel)
    assert value_of(criterion, matrix, target) == pytest.approx(design.value, rel=rel)


@pytest.mark.parametrize("seed", range(3))
def test_branch_and_bound_proves_the_optimum(seed):
    rng = np.random.default_rng(seed)
    blocks, target = rng.normal(size=(16, 2, 4)), rng.normal(size=(2, 4))
    design = exact_design(blocks, target, 4, effort="high", seed=seed)
    best = brute_force("test_pose", blocks, target, None, plans(16, 4, True))
    assert design.value == pytest.approx(best, rel=1e-9)
    assert design.bound_source == "branch_and_bound"
    assert 1 - 2e-6 <= design.efficiency <= 1.0


@pytest.mark.parametrize("repeats", [True, False])
def test_branch_and_bound_needs_no_good_plan_to_start_from(repeats):
    rng = np.random.default_rng(1)
    blocks, target = rng.normal(size=(9, 2, 3)), rng.normal(size=(2, 3))
    problem = make_problem(blocks, target, "test_pose", None, None, None)
    pool = make_pool(problem, 1e-9 * np.eye(3), np.arange(9), Limits(3, np.inf, np.ones(9), repeats))
    worst = max(plans(9, 3, repeats), key=lambda plan: pool.plan(plan).value)
    plan, bound = branch_and_bound(pool, np.full(9, 1 / 3), pool.plan(worst), 0.0, 10_000)
    best = brute_force("test_pose", blocks, target, None, plans(9, 3, repeats))
    assert plan.value == pytest.approx(best, rel=1e-6)
    assert best * (1 - 2e-6) <= bound <= best


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("seed", range(1))
def test_a_tightened_box_keeps_every_better_plan(seed, criterion):
    rng = np.random.default_rng(seed)
    blocks, target = rng.normal(size=(9, 2, 3)), rng.normal(size=(2, 2, 3))
    target = target if criterion == "G" else target[0]
    problem = make_problem(blocks, target, criterion, None, None, None)
    pool = make_pool(problem, 1e-9 * np.eye(3), np.arange(9), Limits(4, np.inf, np.ones(9), True))
    grams = np.einsum("kmi,kmj->mij", pool.rows, pool.rows)
    whole = Box(np.zeros(9, np.int64), np.full(9, 4))
    relaxed = relax(pool, grams, np.full(9, 0.25), whole, lambda value, bound: bound > 0.999 * value)
    values = np.array([pool.plan(plan).value for plan in plans(9, 4, True)])
    counts = np.array([np.bincount(plan, minlength=9) for plan in plans(9, 4, True)])
    assert relaxed.bound <= values.min()
    for better in (1, 5, 25):
        goal = np.sort(values)[better]
        box = relaxed.tightened(goal)
        inside = np.all((counts >= box.low) & (counts <= box.high), axis=1)
        assert inside[values < goal].all()
        assert not inside.all()


def test_a_budget_that_pays_for_the_number_only_just_keeps_the_number():
    """The fractional optimum takes two dear experiments whole, which would leave too little for the third."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        blocks, target = rng.normal(size=(9, 2, 1)), np.ones((1, 1))
        costs = rng.choice([1.0, 2.0, 3.0], 9)
        budget = 1.2 * np.sort(costs)[:3].sum()
        design = exact_design(blocks, target, 3, repeats=False, costs=costs, budget=budget)
        paid = [plan for plan in plans(9, 3, False) if costs[list(plan)].sum() <= budget * (1 + 1e-12)]
        assert design.counts.sum() == 3
        assert design.value == pytest.approx(brute_force("test_pose", blocks, target, None, paid), rel=2e-6)
        assert design.efficiency > 1 - 1e-5


def test_the_reference_arm_is_proven_within_half_a_percent():
    design = exact_design(*reference_case(3000, 6), 20)
    assert design.efficiency > 0.995
    assert design.counts.sum() == 20


@pytest.mark.parametrize("criterion", ["test_pose", "D"])
@pytest.mark.parametrize("repeats", [True, False])
def test_no_single_exchange_with_any_candidate_improves_the_plan(criterion, repeats):
    rng = np.random.default_rng(2)
    blocks, target = rng.normal(size=(400, 2, 6)), rng.normal(size=(3, 6))
    design = exact_design(blocks, target, 7, criterion=criterion, repeats=repeats)
    for out in np.flatnonzero(design.counts):
        for other in range(400):
            counts = design.counts.copy()
            counts[out] -= 1
            counts[other] += 1
            if repeats or counts.max() == 1:
                assert value_of(criterion, information(blocks, counts), target) > design.value * (1 - 1e-8)


def test_every_experiment_once_when_nothing_else_is_allowed():
    rng = np.random.default_rng(3)
    blocks, target = rng.normal(size=(12, 1, 3)), rng.normal(size=(1, 3))
    design = exact_design(blocks, target, 12, repeats=False)
    np.testing.assert_array_equal(design.counts, 1)
    assert design.efficiency == pytest.approx(1.0)


def test_limits_are_kept():
    rng = np.random.default_rng(4)
    blocks, target, costs = rng.normal(size=(300, 2, 5)), rng.normal(size=(2, 5)), rng.uniform(1.0, 5.0, 300)
    free = exact_design(blocks, target, None, costs=costs, budget=30.0)
    both = exact_design(blocks, target, 9, costs=costs, budget=30.0)
    once = exact_design(blocks, target, 9, costs=costs, budget=30.0, repeats=False)
    for design in (free, both, once):
        assert costs @ design.counts <= 30.0 * (1 + 1e-9)
        assert 0.0 < design.bound <= design.value
    assert both.counts.sum() == once.counts.sum() == 9
    assert once.counts.max() == 1
    assert free.value <= both.value * (1 + 1e-9) <= once.value * (1 + 2e-9)


@pytest.mark.parametrize("criterion", ["A", "D", "test_pose"])
def test_a_prior_of_low_rank_that_outweighs_all_candidates(criterion):
    """In the coordinates of the blocks rounding must not give the prior negative directions."""
    rng = np.random.default_rng(1)
    blocks, rows = rng.normal(size=(20, 5, 26)), rng.normal(size=(2, 26))
    prior = 1e9 * rows.T @ rows
    design = approximate_design(blocks, rows, criterion=criterion, prior=prior)
    assert design.gap <= 1e-6
    plan = exact_design(blocks, rows, 20, criterion=criterion, repeats=False, prior=prior, effort="low")
    assert plan.value == pytest.approx(plan.bound, rel=1e-6)  # there is no choice


def test_candidates_that_show_nothing_of_what_counts_gain_nothing():
    blocks = np.zeros((8, 2, 3))
    blocks[4:, :, :2] = np.random.default_rng(2).normal(size=(4, 2, 2))
    target, prior = np.array([[0.0, 0.0, 1.0]]), np.diag([0.0, 0.0, 4.0])
    assert approximate_design(blocks, target, prior=prior).value == pytest.approx(0.25)
    plan = exact_design(blocks, target, None, costs=np.ones(8), budget=3.0, prior=prior)
    assert plan.value == pytest.approx(0.25)
    assert plan.efficiency == pytest.approx(1.0)


def test_the_prior_counts_in_full():
    rng = np.random.default_rng(5)
    blocks, target = rng.normal(size=(50, 2, 3)), rng.normal(size=(2, 3))
    first = exact_design(blocks, target, 3)
    done = information(blocks, first.counts)
    more = exact_design(blocks, target, 2, prior=done)
    both = value_of("test_pose", done + information(blocks, more.counts), target)
    assert more.value == pytest.approx(both, rel=1e-9)
    assert more.value < first.value


def test_same_seed_same_plan_and_more_effort_is_never_worse():
    blocks, target = reference_case(600, 26)
    low, normal = (exact_design(blocks, target, 15, effort=effort, seed=3) for effort in ("low", "normal"))
    again = exact_design(blocks, target, 15, seed=3)
    assert normal.counts.tobytes() == again.counts.tobytes()
    assert normal.value <= low.value


def test_a_target_that_one_experiment_can_show_needs_only_one():
    # fewer rows than parameters: M is singular, the target is seen all the same
    rng = np.random.default_rng(6)
    blocks = rng.normal(size=(20, 2, 5))
    design = exact_design(blocks, blocks[7], 1)
    assert design.counts[7] == 1
    assert design.value == pytest.approx(2.0)
    assert design.bound <= 2.0 * (1 + 1e-9)


def test_single_precision_blocks():
    blocks, target = reference_case(500, 6)
    double, single = exact_design(blocks, target, 8), exact_design(blocks.astype(np.float32), target, 8)
    assert single.value == pytest.approx(double.value, rel=1e-4)


@pytest.mark.parametrize(
    ("n", "change", "text"),
    [
        (21, {"repeats": False}, "21 experiments without repeats"),
        (0, {}, "n is 0"),
        (2.5, {}, "n is 2.5"),
        (True, {}, "n is True"),
        (None, {}, "nothing limits"),
        (3, {"costs": np.ones(20)}, "budget"),
        (3, {"budget": 5.0}, "budget"),
        (3, {"costs": np.ones(20), "budget": -1.0}, "budget is"),
        (3, {"costs": -np.ones(20), "budget": 5.0}, "costs"),
        (3, {"effort": "extreme"}, "low, normal, high"),
        (3, {"criterion": "I"}, "allowed"),
        (3, {"prior": np.eye(2)}, "prior"),
    ],
)
def test_bad_input_is_named(n, change, text):
    rng = np.random.default_rng(7)
    with pytest.raises(InputError, match=text):
        exact_design(rng.normal(size=(20, 2, 3)), rng.normal(size=(1, 3)), n, **change)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_too_few_experiments_see_too_little(criterion):
    rng = np.random.default_rng(8)
    blocks, target = rng.normal(size=(20, 1, 4)), rng.normal(size=(2, 4))
    with pytest.raises(NotIdentifiable, match="3 experiments"):
        exact_design(blocks, target[None] if criterion == "G" else target, 1 + 2, criterion=criterion)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_too_few_rows_are_refused_before_any_search(criterion, monkeypatch):
    """The rows of the plan, with those of the prior, are fewer than what has to be seen: nothing to search for."""
    rng = np.random.default_rng(8)
    blocks, target = rng.normal(size=(40, 2, 9)) * 10.0 ** rng.uniform(-3, 3, 9), rng.normal(size=(9, 9))
    target = target[None] if criterion == "G" else target
    prior = np.diag([2.0, *np.zeros(8)])
    exact_design(blocks, target, 4, criterion=criterion, prior=prior, effort="low")
    monkeypatch.setattr("doe.exact.best_weights", lambda *_: pytest.fail("searched"))
    limits = [{"n": 4}, {"n": 3, "prior": prior}, {"n": None, "costs": np.ones(40), "budget": 4.5}]
    for limit in limits:
        with pytest.raises(NotIdentifiable, match="sees what criterion") as caught:
            exact_design(blocks, target, criterion=criterion, **limit)
        assert caught.value.missing


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "G"])
@pytest.mark.parametrize("noise", [0.0, 1e-10])
def test_a_search_among_plans_that_see_too_little_ends(criterion, noise, exchanges):
    """Enough rows, but every third says nothing new beyond rounding: singular but for a trace, whatever is chosen."""
    rng = np.random.default_rng(10)
    blocks = np.zeros((200, 3, 12))
    kind = np.arange(200) % 4  # each kind of candidate shows two of three parameters; two of a kind show them all
    for j in range(4):
        blocks[kind == j, :, 3 * j : 3 * j + 3] = rng.normal(size=(50, 3, 3))
    blocks[:, 2] = blocks[:, :2].sum(axis=1) + noise * rng.normal(size=(200, 12))
    target = rng.normal(size=(1, 12, 12) if criterion == "G" else (12, 12))
    with pytest.raises(NotIdentifiable, match="no plan of 6 experiments"):
        exact_design(blocks, target, 6, criterion=criterion)
    assert exchanges


def test_the_information_of_a_plan_does_not_depend_on_its_history():
    rng = np.random.default_rng(11)
    problem = make_problem(rng.normal(size=(30, 2, 8)), None, "A", None, None, None)
    pool = make_pool(problem, 1e-9 * np.eye(8), np.arange(30), Limits(3, np.inf, np.ones(30), True))
    found = local_search.exchange(pool, pool.plan([1, 1, 2]))  # six rows for eight parameters
    assert found.value == pool.plan(sorted(found.members)).value
    assert found.value == pool.plan(sorted(found.members, reverse=True)).value


def test_a_budget_that_buys_nothing_is_infeasible():
    rng = np.random.default_rng(9)
    blocks, target = rng.normal(size=(5, 3, 2)), rng.normal(size=(1, 2))
    with pytest.raises(Infeasible, match="too small"):
        exact_design(blocks, target, None, costs=np.full(5, 2.0), budget=1.0)
    with pytest.raises(Infeasible, match="at least 6"):
        exact_design(blocks, target, 3, costs=np.full(5, 2.0), budget=5.0)


def test_the_best_of_all_restarts_counts():
    blocks, target = reference_case(300, 6)
    found = []

    class Watched:
        def map(self, work, items):
            states = {str(rng.bit_generator.state) for rng in items}
            found.extend(work(rng).value for rng in items)
            assert len(states) == len(items) == len(found)
            return iter([work(rng) for rng in items])

    design = exact_design(blocks, target, 13, seed=1, restarts=3, executor=Watched())
    assert design.value <= min(found) * (1 + 1e-6)
    with pytest.raises(InputError, match="restarts is 0"):
        exact_design(blocks, target, 13, restarts=0)
