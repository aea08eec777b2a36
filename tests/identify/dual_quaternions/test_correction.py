"""Pose errors, joint corrections and corrected commands."""

import re

import numpy as np
import pytest
from reference_robots import ARMS, poses_of

from identify.dual_quaternions import algebra as dq
from identify.dual_quaternions.chain import dual_chain, forward, postures
from identify.dual_quaternions.correction import corrected, joint_correction, pose_error
from identify.dual_quaternions.placements import to_matrix
from identify.dual_quaternions.screws import dual_vector, exp, log
from identify.errors import InputError
from identify.robot_files import load_robot


@pytest.fixture(params=ARMS)
def robot(request):
    return ARMS[request.param]()


def small(count, size=1e-4, seed=3):
    return exp(0.5 * dual_vector(np.random.default_rng(seed).normal(0, size, (count, 6))))


def test_the_error_carries_what_is_reached_to_what_is_wanted_whatever_the_signs(robot):
    wanted = forward(dual_chain(robot), poses_of(robot))
    reached = dq.product(dq.conjugate(small(len(wanted))), wanted)
    error = pose_error(wanted, reached)
    np.testing.assert_allclose(error, small(len(wanted)), atol=1e-13)
    np.testing.assert_allclose(to_matrix(dq.product(error, reached)), to_matrix(wanted), atol=1e-12)
    for a, b in ((-wanted, reached), (wanted, -reached), (-wanted, -reached)):
        np.testing.assert_array_equal(pose_error(a, b), error)


def test_the_joint_correction_takes_an_error_of_the_joints_away(robot):
    """In one step what is left is of second order; a second step takes that too."""
    chain, q = dual_chain(robot), poses_of(robot)
    wrong = q + np.random.default_rng(4).normal(0, 1e-4, q.shape)
    wanted, at = forward(chain, q), wrong
    left = []
    for _ in range(3):
        found = postures(chain, at)
        error = pose_error(wanted, found.pose)
        left.append(np.abs(log(error)).max())
        at = at + joint_correction(found.deviation, error)
    assert left[1] < 1e-3 * left[0]
    assert left[2] < 1e-6 * left[0]


def test_an_arm_with_six_joints_or_less_goes_back_to_the_joints_it_came_from():
    robot = load_robot("ur10")
    chain, q = dual_chain(robot), poses_of(robot)
    away = np.random.default_rng(5).normal(0, 1e-6, q.shape)
    found = postures(chain, q + away)
    correction = joint_correction(found.deviation, pose_error(forward(chain, q), found.pose))
    np.testing.assert_allclose(correction, -away, atol=1e-9)


def test_a_redundant_arm_gets_the_correction_of_least_norm():
    robot = load_robot("sda5f_r1")
    found = postures(dual_chain(robot), poses_of(robot))
    error = small(len(found.pose))
    least = joint_correction(found.deviation, error)
    np.testing.assert_allclose((found.deviation @ least[..., None])[..., 0], log(error), atol=1e-14)
    null = np.linalg.svd(found.deviation)[2][:, 6:]
    np.testing.assert_allclose(null @ least[..., None], 0.0, atol=1e-13)


def test_corrections_do_not_depend_on_the_sign_of_the_poses():
    robot = load_robot("sda5f_r1")
    found = postures(dual_chain(robot), poses_of(robot))
    wanted = dq.product(small(len(found.pose)), found.pose)
    one = joint_correction(found.deviation, pose_error(wanted, found.pose))
    for error in (pose_error(-wanted, found.pose), pose_error(wanted, -found.pose), -pose_error(wanted, found.pose)):
        np.testing.assert_array_equal(joint_correction(found.deviation, error), one)


def test_a_corrected_command_ends_where_it_was_wanted_if_the_error_stays(robot):
    """Of an arm that misses by the same motion everywhere; the printed sum is no placement at all."""
    wanted = forward(dual_chain(robot), poses_of(robot))
    miss = small(len(wanted), 1e-2)
    error = pose_error(wanted, dq.product(miss, wanted))
    command = corrected(wanted, error)
    np.testing.assert_allclose(to_matrix(dq.product(miss, command)), to_matrix(wanted), atol=1e-12)
    np.testing.assert_allclose(to_matrix(corrected(-wanted, error)), to_matrix(command), atol=1e-12)
    np.testing.assert_allclose(dq.left_matrix(error) @ wanted[..., None], command[..., None], atol=1e-12)
    with pytest.raises(InputError, match="is not unit"):
        dq.unit(wanted + error)


def test_bad_input_is_named():
    found = postures(dual_chain(load_robot("ur10")), np.zeros((3, 6)))
    with pytest.raises(InputError, match=r"wanted pose \[0\] .* is not unit"):
        pose_error(1.1 * found.pose, found.pose)
    with pytest.raises(InputError, match=r"reached pose .* is not unit"):
        pose_error(found.pose, 1.1 * found.pose)
    with pytest.raises(InputError, match=r"commanded pose .* is not unit"):
        corrected(1.1 * found.pose, small(3))
    with pytest.raises(InputError, match=re.escape("columns of shape (3, 8, 6) and errors of shape (2, 8)")):
        joint_correction(found.deviation, small(2))
