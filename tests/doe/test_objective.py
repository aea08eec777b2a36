"""Values of the criteria against the formulas as they are written."""

import numpy as np
import pytest

from doe.objective import Objective


def an_objective(criterion="test_pose", size=4, tests=3, seed=0):
    """Random rows of test poses with weights 1 : 2 : 3 ..."""
    rng = np.random.default_rng(seed)
    weights = np.arange(1.0, tests + 1)
    return Objective(criterion, rng.normal(size=(tests, 3, size)), weights / weights.sum(), size)


def an_information(size=4, seed=1):
    """A well-conditioned information matrix in columns of very different size."""
    rows = np.random.default_rng(seed).normal(size=(12, size)) * 10.0 ** np.arange(-3, size - 3)
    return rows.T @ rows


def test_values_are_the_formulas():
    aim, information = an_objective(), an_information()
    covariance = np.linalg.inv(information)
    each = np.array([np.trace(rows @ covariance @ rows.T) for rows in aim.rows])
    assert aim.value(information) == pytest.approx(aim.weights @ each, rel=1e-9)
    assert aim.value(information, "G") == pytest.approx(each.max(), rel=1e-9)
    assert aim.value(information, "A") == pytest.approx(np.trace(covariance), rel=1e-9)
    assert aim.value(information, "D") == pytest.approx(np.linalg.det(information) ** (-1 / 4), rel=1e-9)
    assert aim.value(information, "E") == pytest.approx(1 / np.linalg.eigvalsh(information)[0], rel=1e-9)


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "E", "G"])
def test_n_times_the_information_divides_every_value_by_n(criterion):
    aim, information = an_objective(criterion), an_information()
    assert aim.value(7 * information) == pytest.approx(aim.value(information) / 7, rel=1e-12)


def test_values_at_the_test_poses_do_not_depend_on_the_units_of_the_parameters():
    aim, information = an_objective(), an_information()
    scale = np.array([1e-6, 3.0, 1e4, 0.2])
    other = Objective("test_pose", aim.rows * scale, aim.weights, 4)
    rescaled = information * scale * scale[:, None]
    for criterion in ("test_pose", "G"):
        assert other.value(rescaled, criterion) == pytest.approx(aim.value(information, criterion), rel=1e-9)


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "E", "G"])
@pytest.mark.parametrize("spoil", ["zero", "copy"])
def test_a_singular_information_is_infinitely_bad(criterion, spoil):
    change = np.eye(4)
    change[3, 3] = 0.0
    if spoil == "copy":
        change[2, 3] = 2.0
    assert an_objective(criterion).value(change.T @ an_information() @ change) == np.inf


def test_the_target_holds_the_weights_and_its_trace_is_the_value():
    aim, information = an_objective(), an_information()
    target = aim.target()
    assert target.shape == (9, 4)
    assert np.trace(target @ np.linalg.inv(information) @ target.T) == pytest.approx(aim.value(information), rel=1e-9)
    assert aim.target("G") is aim.rows
    for criterion in ("A", "D", "E"):
        np.testing.assert_array_equal(an_objective(criterion).target(), np.eye(4))


@pytest.mark.parametrize("criterion", ["test_pose", "G"])
def test_the_guard_adds_a_share_of_each_variance_on_its_own_scale(criterion):
    aim, information = an_objective(criterion), an_information()
    scale, share = np.array([1e-3, 0.1, 1.0, 30.0]), 0.02
    covariance = np.linalg.inv(information)
    extra = share * np.sum(np.diag(covariance) / scale**2)
    target = aim.guarded(scale, share)
    parts = target if criterion == "G" else target[None]
    value = max(np.trace(rows @ covariance @ rows.T) for rows in parts)
    assert value == pytest.approx(aim.value(information) + extra, rel=1e-9)
