"""The five criteria: values, derivatives, bounds, and what adding one candidate does."""

from __future__ import annotations

import numpy as np
import pytest
from plain_design import information, value_of

from doe.blocks import Blocks, sensitivities
from doe.criteria import NAMES, criterion_for
from doe.polytope import inner_point, largest_sum, marginal_value
from doe.row_space import row_space

P, COUNT = 4, 12


@pytest.fixture(params=NAMES)
def case(request):
    """Criterion, its blocks in row-space coordinates, weights, M there and in the parameters' own coordinates."""
    rng = np.random.default_rng(4)
    blocks = rng.normal(size=(COUNT, 2, P)) * [1.0, 10.0, 0.1, 3.0]
    target = rng.normal(size=(5, 3, P))
    target = target if request.param == "G" else target[0]
    space = row_space(Blocks(blocks), np.zeros((P, P)))
    weights = rng.uniform(0.5, 1.0, COUNT)
    return request.param, criterion_for(request.param, space, target), blocks, blocks @ space.basis, target, weights


def test_value_is_the_definition(case):
    name, criterion, blocks, turned, target, weights = case
    expected = value_of(name, information(blocks, weights), target)
    assert criterion.value(information(turned, weights)) == pytest.approx(expected, rel=1e-10)


def test_gradient_and_curvature_are_the_derivatives_of_the_objective(case):
    _, criterion, _, turned, _, weights = case
    mu = 1e-2 * criterion.unit(information(turned, weights))

    def gradient(w):
        return -sensitivities(turned, criterion.local(information(turned, w), mu, None).certificate.factor)

    local = criterion.local(information(turned, weights), mu, None)
    rows = local.curvature(turned)
    for i, step in enumerate(1e-6 * np.eye(COUNT)):
        up, down = (criterion.objective(information(turned, weights + s * step), mu) for s in (1, -1))
        assert gradient(weights)[i] == pytest.approx((up - down) / 2e-6, rel=1e-6)
        slope = (gradient(weights + step) - gradient(weights - step)) / 2e-6
        np.testing.assert_allclose(rows @ rows[i], slope, rtol=1e-5, atol=1e-6 * abs(slope).max())


def test_the_bound_holds_for_any_feasible_weights(case):
    _, criterion, _, turned, _, weights = case
    matrix = information(turned, weights / weights.sum())
    certificate = criterion.local(matrix, 1e-3 * criterion.unit(matrix), None).certificate
    bound = certificate.numerator / sensitivities(turned, certificate.factor).max()
    rng = np.random.default_rng(5)
    for other in rng.dirichlet(np.full(COUNT, 0.7), size=100):
        assert criterion.value(information(turned, other)) >= bound * (1 - 1e-12)


def test_adding_a_candidate_is_scored_as_its_own_value(case):
    _, criterion, _, turned, _, weights = case
    matrix = information(turned, weights)
    scores = criterion.after_adding(matrix, np.ascontiguousarray(turned.swapaxes(0, 1)))
    values = np.array([criterion.value(matrix + block.T @ block) for block in turned])
    assert scores.argmin() == values.argmin()
    scored = np.isfinite(scores)
    np.testing.assert_allclose(scores[scored], values[scored], rtol=1e-9)


@pytest.mark.parametrize("k", [1, 3, 9])
def test_additions_of_few_and_of_many_rows_are_scored(case, k):
    _, criterion, _, turned, _, weights = case
    matrix = information(turned, weights)
    rows = np.random.default_rng(k).normal(size=(k, 20, P))
    scores = criterion.after_adding(matrix, rows)
    values = np.array([criterion.value(matrix + block.T @ block) for block in rows.swapaxes(0, 1)])
    assert scores.argmin() == values.argmin()
    scored = np.isfinite(scores)
    np.testing.assert_allclose(scores[scored], values[scored], rtol=1e-9)


def test_no_candidate_below_the_prospect_threshold_reaches_the_goal(case):
    _, criterion, _, turned, _, weights = case
    matrix = information(turned, weights)
    values = np.array([criterion.value(matrix + block.T @ block) for block in turned])
    for goal in np.sort(values)[[0, 3, 8]]:
        factor, threshold = criterion.prospect(matrix, goal)
        left_out = sensitivities(turned, factor) < threshold * (1 - 1e-9)
        assert np.all(values[left_out] > goal)


def test_the_duals_are_what_the_contract_says(case):
    name, criterion, _, turned, _, weights = case
    matrix = information(turned, weights)
    certificate = criterion.local(matrix, 1e-4 * criterion.unit(matrix), None).certificate
    dual = criterion.published(certificate.dual)
    if name == "E":
        assert np.trace(dual) == pytest.approx(1.0)
        assert np.linalg.eigvalsh(dual)[0] > 0.0
    elif name == "G":
        assert dual.sum() == pytest.approx(1.0)
        assert dual.min() > 0.0
    else:
        assert dual is None


def test_linear_maximisation_fills_the_best_first():
    values, upper = np.array([1.0, 5.0, 3.0]), np.array([1.0, 0.25, 0.5])
    assert largest_sum(values, upper, 1.0) == pytest.approx(5 * 0.25 + 3 * 0.5 + 1 * 0.25)
    assert largest_sum(values, np.full(3, np.inf), 2.0) == pytest.approx(10.0)
    assert marginal_value(values, upper, 1.0) == 1.0
    assert marginal_value(values, upper, 0.5) == 3.0
    point = inner_point(upper, 1.0)
    assert point.sum() == pytest.approx(1.0)
    assert np.all((point > 0.0) & (point < upper))
