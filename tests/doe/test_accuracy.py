"""Expected errors at the test poses: radii against known distributions, jitter against jittered joints."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi, norm

from doe.accuracy import accuracy, jitter_covariance
from identify.error_radius import radius
from identify.kinematics import forward
from tests.doe.study_files import ARM, KR270, study


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.99])
def test_radius_of_round_and_of_flat_errors(confidence):
    assert radius(4.0 * np.eye(3), confidence) == pytest.approx(2.0 * chi(3).ppf(confidence), rel=3e-3)
    line = np.outer([1.0, 2.0, 2.0], [1.0, 2.0, 2.0])  # sigma 3 along one direction
    assert radius(line, confidence) == pytest.approx(3.0 * norm.ppf(0.5 + confidence / 2), rel=3e-3)
    plane = np.diag([1.0, 0.0, 1.0])
    assert radius(plane, confidence) == pytest.approx(np.sqrt(-2.0 * np.log(1.0 - confidence)), rel=3e-3)
    assert radius(np.zeros((3, 3)), confidence) == 0.0


def test_radius_of_crooked_errors_holds_the_stated_share_of_many_draws():
    rng = np.random.default_rng(0)
    for _ in range(5):
        root = rng.normal(size=(3, 3)) @ np.diag([1.0, 0.3, 0.05])
        draws = np.linalg.norm(rng.standard_normal((200_000, 3)) @ root.T, axis=1)
        share = (draws <= radius(root @ root.T, 0.95)).mean()
        assert share == pytest.approx(0.95, abs=2e-3)  # four sigmas of the count alone are 0.002


def test_radius_turns_and_grows_with_the_error():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    first = radius(root @ root.T, 0.95)
    assert radius(turn @ root @ root.T @ turn.T, 0.95) == pytest.approx(first, rel=3e-3)
    assert radius(9.0 * root @ root.T, 0.95) == pytest.approx(3.0 * first, rel=1e-12)
    assert radius(root @ root.T, 0.95) == first
    assert radius(root @ root.T, 0.9) < first


def test_mean_square_is_weighted_over_the_test_poses_and_jitter_adds_to_it(tmp_path):
    made = study(tmp_path, KR270)
    rng = np.random.default_rng(2)
    rows, spread = rng.normal(size=(2, 3, 5)), rng.normal(size=(5, 5))
    covariance = spread @ spread.T * 1e-4
    found = accuracy(made, rows, covariance)
    np.testing.assert_allclose(found.weights, [1 / 3, 2 / 3])
    each = [np.trace(part @ covariance @ part.T) for part in rows]
    shaking = [np.trace(part) for part in jitter_covariance(made)]
    assert found.rms == pytest.approx(np.sqrt((each[0] + 2 * each[1]) / 3), rel=1e-12)
    total = (each[0] + shaking[0] + 2 * (each[1] + shaking[1])) / 3
    assert found.rms_total == pytest.approx(np.sqrt(total), rel=1e-12)


def test_jitter_is_what_jittered_joints_do_to_the_point(tmp_path):
    """100,000 approaches with 12 urad a joint; sampling error of a covariance is below 1 %."""
    made = study(tmp_path, KR270)
    rng = np.random.default_rng(3)
    for pose, expected in zip(made.test_poses, jitter_covariance(made), strict=True):
        q = pose.q + made.noise.pose_jitter * rng.standard_normal((100_000, made.robot.n))
        points = forward(made.robot, q).point(pose.point) * 1e3
        np.testing.assert_allclose(np.cov(points.T), expected, atol=0.02 * np.trace(expected))


def test_jitter_of_the_reference_arm_in_closed_form(tmp_path):
    made = study(tmp_path, ARM, noise={"pose_jitter_urad": 1000.0})
    pose = replace(made.test_poses[0], q=np.zeros(3))
    (found,) = jitter_covariance(replace(made, test_poses=(pose,)))
    # stretched along x: joint 1 moves the tip by 1.8 m per rad sideways, joints 2 and 3 by 1.8 and 0.8 m upwards
    np.testing.assert_allclose(found, np.diag([0.0, 1.8**2, 1.8**2 + 0.8**2]), atol=1e-9)
