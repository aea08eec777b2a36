"""Approximate designs: proof, agreement with a general solver, invariance, errors."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_design import bound_of, information, value_of
from reference_cases import reference_case
from threadpoolctl import threadpool_info

from doe import approximate_design, column_generation
from doe.blocks import Blocks
from identify.errors import InputError, NoConvergence, NotIdentifiable

CRITERIA = ("test_pose", "A", "D", "E", "G")


def problem(seed, count=40, k=2, p=4, criterion="test_pose"):
    rng = np.random.default_rng(seed)
    blocks = rng.normal(size=(count, k, p)) * rng.uniform(0.3, 3.0, p)
    target = rng.normal(size=(3, 2, p))
    return blocks, target if criterion == "G" else target[0]


def options(seed, count=40, p=4):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(2, p))
    return {
        "plain": {},
        "cap": {"max_weight": 0.08},
        "costs": {"costs": rng.uniform(0.3, 3.0, count)},
        "prior": {"prior": 0.3 * factor.T @ factor},
        "all": {"max_weight": 0.1, "costs": rng.uniform(0.5, 2.0, count), "prior": 0.1 * factor.T @ factor},
    }


def cvxpy_value(criterion, blocks, target, max_weight=None, costs=None, prior=None):
    """The same problem as a semidefinite programme."""
    count, _, p = blocks.shape
    w = cp.Variable(count, nonneg=True)
    grams = np.einsum("nki,nkj->nij", blocks, blocks).reshape(count, p * p)
    matrix = cp.reshape(grams.T @ w, (p, p), order="C") + (np.zeros((p, p)) if prior is None else prior)
    matrix = 0.5 * (matrix + matrix.T)
    limits = [(np.ones(count) if costs is None else costs) @ w == 1]
    if max_weight is not None:
        limits.append(w <= max_weight)
    if criterion == "D":
        goal, read = cp.Maximize(cp.log_det(matrix)), lambda best: np.exp(-best / p)
    elif criterion == "E":
        goal, read = cp.Maximize(cp.lambda_min(matrix)), lambda best: 1.0 / best
    else:
        targets = {"test_pose": [target], "A": [np.eye(p)], "G": target}[criterion]
        goal = cp.Minimize(cp.maximum(*(cp.matrix_frac(t.T, matrix) for t in targets), -1.0))
        read = float
    return read(cp.Problem(goal, limits).solve(solver=cp.CLARABEL, tol_gap_rel=1e-9, tol_gap_abs=1e-9, tol_feas=1e-9))


@pytest.mark.parametrize("case", ["plain", "cap", "costs", "prior", "all"])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_agrees_with_a_semidefinite_programme(criterion, case):
    blocks, target = problem(3, criterion=criterion)
    limits = options(3)[case]
    design = approximate_design(blocks, target, criterion=criterion, **limits)
    assert design.value == pytest.approx(cvxpy_value(criterion, blocks, target, **limits), rel=1e-5)
    assert design.gap <= 1e-6


@pytest.mark.parametrize("case", ["plain", "cap", "costs", "prior", "all"])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_anyone_can_check_weights_value_and_bound(criterion, case):
    blocks, target = problem(5, count=200, criterion=criterion)
    limits = options(5, count=200)[case]
    limits.pop("max_weight", None) if case == "plain" else None
    design = approximate_design(blocks, target, criterion=criterion, **limits)
    costs = limits.get("costs", np.ones(200))
    assert design.weights.min() >= 0.0
    assert costs @ design.weights == pytest.approx(1.0, abs=1e-12)
    assert design.weights.max() <= limits.get("max_weight", 1.0 / costs.min()) * (1 + 1e-12)
    value = value_of(criterion, information(blocks, design.weights, limits.get("prior")), target)
    assert design.value == pytest.approx(value, rel=1e-9)
    bound = bound_of(criterion, blocks, target, design.weights, design.dual, **limits)
    assert value * (1 - 2e-6) <= bound <= value * (1 + 1e-9)
    assert design.bound <= design.value
    if criterion == "E":
        assert np.linalg.eigvalsh(design.dual)[0] >= -1e-12
        assert np.trace(design.dual) == pytest.approx(1.0)
    elif criterion == "G":
        assert design.dual.min() >= 0.0
        assert design.dual.sum() == pytest.approx(1.0)
    else:
        assert design.dual is None


@pytest.mark.parametrize("case", ["plain", "cap", "costs", "prior", "all"])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_very_many_candidates_are_searched_in_parts(criterion, case, monkeypatch):
    """The way taken above some million numbers, here with few: same optimum, and proven on all candidates."""
    count = 3000
    blocks, target = problem(7, count=count, criterion=criterion)
    limits = options(7, count=count)[case]
    plain = approximate_design(blocks, target, criterion=criterion, **limits)
    monkeypatch.setattr(column_generation, "MANY", 1)
    monkeypatch.setattr(Blocks, "sensitivities", counted := Counted(Blocks.sensitivities, count))
    design = approximate_design(blocks, target, criterion=criterion, **limits)
    assert design.value == pytest.approx(plain.value, rel=2e-6)
    bound = bound_of(criterion, blocks, target, design.weights, design.dual, **limits)
    assert design.value * (1 - 2e-6) <= bound <= plain.value * (1 + 1e-9)
    assert design.iterations == counted.whole < 8


class Counted:
    """Stands for `Blocks.sensitivities` and counts the passes over all candidates."""

    def __init__(self, original, count):
        self.original, self.count, self.whole = original, count, 0

    def __get__(self, blocks, kind):
        self.whole += len(blocks) == self.count
        return self.original.__get__(blocks)


def test_a_part_that_misses_a_direction_does_not_stand_for_all(monkeypatch):
    """One candidate alone sees the last parameter, and it is not among those that are looked at first."""
    blocks, target = problem(8, count=1000)
    blocks[:, :, 3] = 0.0
    blocks[17, 0, 3] = 1.0
    plain = approximate_design(blocks, target)
    monkeypatch.setattr(column_generation, "MANY", 1)
    assert approximate_design(blocks, target).value == pytest.approx(plain.value, rel=2e-6)


@pytest.mark.parametrize(("p", "count"), [(6, 3000), (26, 1500)])
def test_equivalence_theorem_holds_on_the_reference_arm(p, count):
    blocks, target = reference_case(count, p)
    design = approximate_design(blocks, target)
    solved = np.linalg.solve(information(blocks, design.weights), target.T)
    d = ((blocks @ solved) ** 2).sum(axis=(1, 2))
    assert d.max() == pytest.approx(design.value, rel=2e-6)
    np.testing.assert_allclose(d[design.weights > 1e-3], design.value, rtol=1e-2)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    criterion=st.sampled_from(CRITERIA),
    p=st.integers(1, 6),
    k=st.integers(1, 8),
    count=st.integers(1, 60),
    decades=st.floats(0.0, 4.0),
)
def test_the_bound_is_proven_for_any_blocks(seed, criterion, p, k, count, decades):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-decades, decades, p)
    blocks = rng.normal(size=(count, k, p)) * scale
    blocks = np.concatenate([blocks, blocks[:1]])
    target = rng.normal(size=(2, 3, p)) * scale
    target = target if criterion == "G" else target[0]
    if k * count < p:
        with pytest.raises(NotIdentifiable):
            approximate_design(blocks, target, criterion=criterion)
        return
    tol = 1e-5 if criterion == "E" else 1e-6  # widely different units make E a nearly singular problem
    design = approximate_design(blocks, target, criterion=criterion, tol=tol)
    assert bound_of(criterion, blocks, target, design.weights, design.dual) >= design.value * (1 - 2.1 * tol)


@pytest.mark.parametrize("criterion", ["test_pose", "D", "G"])
def test_parameter_scaling_and_row_order_change_nothing(criterion):
    blocks, target = problem(7, criterion=criterion)
    order = np.random.default_rng(0).permutation(len(blocks))
    scale = np.array([1e-6, 1.0, 1e3, 50.0])
    plain = approximate_design(blocks, target, criterion=criterion)
    scaled = approximate_design(blocks * scale, target * scale, criterion=criterion)
    turned = approximate_design(blocks[order], target, criterion=criterion)
    unit = np.prod(scale) ** (-2 / 4) if criterion == "D" else 1.0
    assert scaled.value == pytest.approx(plain.value * unit, rel=3e-6)
    assert turned.value == pytest.approx(plain.value, rel=3e-6)


def test_same_input_gives_the_same_bytes():
    blocks, target = reference_case(500, 26)
    first, second = approximate_design(blocks, target), approximate_design(blocks, target)
    assert first.weights.tobytes() == second.weights.tobytes()


def test_duplicating_candidates_changes_nothing():
    blocks, target = problem(8)
    once = approximate_design(blocks, target)
    twice = approximate_design(np.concatenate([blocks, blocks]), target)
    assert twice.value == pytest.approx(once.value, rel=3e-6)


def test_a_single_parameter_has_the_closed_form():
    slopes = np.array([0.2, 3.0, -1.5])
    design = approximate_design(slopes[:, None, None], [[2.0]])
    assert design.value == pytest.approx(4.0 / 9.0)
    np.testing.assert_allclose(design.weights, [0.0, 1.0, 0.0], atol=1e-6)


def test_a_test_pose_among_the_candidates_is_a_singular_but_solved_problem():
    # the plan that measures only there has value rank(A_0), and M is singular
    blocks, _ = problem(9, count=30, k=2, p=5)
    quiet = np.concatenate([blocks * 1e-2, blocks[:1]])
    design = approximate_design(quiet, quiet[-1])
    assert design.value == pytest.approx(2.0, rel=1e-5)
    assert design.weights[-1] > 0.99


def test_a_target_inside_a_deficient_row_space_is_valid():
    blocks, target = problem(10)
    seen = blocks.copy()
    seen[..., 1] = 0.0
    seen[..., 3] = 2.0 * seen[..., 0]
    target = target.copy()
    target[:, 1], target[:, 3] = 0.0, 2.0 * target[:, 0]
    reduced = approximate_design(seen[..., [0, 2]] * [np.sqrt(5.0), 1.0], target[:, [0, 2]] * [np.sqrt(5.0), 1.0])
    design = approximate_design(seen, target)
    assert design.value == pytest.approx(reduced.value, rel=3e-6)
    with pytest.raises(NotIdentifiable, match=r"1") as caught:
        approximate_design(seen, target + np.eye(4)[1])
    assert caught.value.missing == (1,)
    with pytest.raises(NotIdentifiable) as caught:
        approximate_design(seen, None, criterion="D")
    assert caught.value.missing == (0, 1, 3)


def test_a_cap_that_leaves_no_choice_gives_equal_weights():
    blocks, target = problem(11)
    design = approximate_design(blocks, target, max_weight=1.0 / 40.0)
    np.testing.assert_allclose(design.weights, 1.0 / 40.0)
    assert design.gap == 0.0


def test_many_candidates_at_their_cap():
    blocks, target = problem(12, count=2000)
    design = approximate_design(blocks, target, max_weight=1.0 / 1500.0)
    assert np.sum(design.weights > 0.999 / 1500.0) > 1400
    assert bound_of("test_pose", blocks, target, design.weights, max_weight=1.0 / 1500.0) >= design.value * (1 - 2e-6)


def test_more_information_never_raises_the_value():
    blocks, target = problem(13)
    values = [approximate_design(blocks, target, prior=size * np.eye(4)).value for size in (0.0, 0.1, 1.0, 10.0)]
    assert values == sorted(values, reverse=True)


def test_result_is_read_only_and_counts_its_passes():
    design = approximate_design(*problem(14))
    assert design.iterations >= 1
    with pytest.raises(ValueError, match="read-only"):
        design.weights[0] = 1.0


def test_the_thread_setting_comes_back():
    before = [library["num_threads"] for library in threadpool_info()]
    approximate_design(*problem(15))
    assert [library["num_threads"] for library in threadpool_info()] == before


def test_an_unreachable_tolerance_keeps_the_best_result():
    blocks, target = problem(16, criterion="E")
    with pytest.raises(NoConvergence, match="gap") as caught:
        approximate_design(blocks, target, criterion="E", tol=1e-16)
    assert 0.0 <= caught.value.best.gap < 1e-5


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"max_weight": 0.01}, "caps"),
        ({"max_weight": 0.0}, "max_weight"),
        ({"max_weight": np.nan}, "max_weight"),
        ({"costs": np.ones(3)}, "costs"),
        ({"costs": np.zeros(40)}, r"costs\[0\]"),
        ({"prior": np.eye(3)}, "prior"),
        ({"prior": -np.eye(4)}, "negative"),
        ({"prior": np.triu(np.ones((4, 4)))}, "symmetric"),
        ({"prior": np.full((4, 4), np.nan)}, "prior"),
        ({"criterion": "K"}, "allowed: test_pose, A, D, E, G"),
        ({"criterion": "G"}, "target"),
        ({"tol": 0.0}, "tol"),
        ({"target": None}, "target"),
        ({"target": np.zeros((2, 4))}, "zeros"),
        ({"target": np.full((2, 4), np.inf)}, "NaN"),
        ({"target": np.ones((2, 5))}, "shape"),
        ({"blocks": np.ones((3, 4))}, "shape"),
        ({"blocks": np.ones((0, 2, 4))}, "shape"),
        ({"blocks": np.ones((3, 2, 4), dtype=complex)}, "dtype"),
    ],
)
def test_bad_input_is_named(change, text):
    blocks, target = problem(17)
    given_ = {"blocks": blocks, "target": target} | change
    with pytest.raises(InputError, match=text):
        approximate_design(given_.pop("blocks"), given_.pop("target"), **given_)
