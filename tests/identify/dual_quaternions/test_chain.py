"""Kinematics in dual quaternions against matrices, Pinocchio, the paper's tables and finite differences."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from reference_robots import ARMS, poses_of

from identify.dual_quaternions import algebra as dq
from identify.dual_quaternions.chain import dual_chain, forward, joint_frames, pose_and_jacobian, postures
from identify.dual_quaternions.elastic import twist_jacobian
from identify.dual_quaternions.placements import to_matrix, translation
from identify.dual_quaternions.screws import twist
from identify.errors import InputError
from identify.kinematics import flange_poses, jacobian
from identify.kinematics import forward as matrix_forward
from identify.robot_files import load_robot
from identify.springs import joint_springs, screws

POINT = np.array([0.3, 0.12, -0.08])


@pytest.fixture(params=ARMS)
def robot(request):
    return ARMS[request.param]()


def pinocchio_of(robot):
    model, parent = pin.Model(), 0
    for i, name in enumerate(robot.joints):
        joint = pin.JointModelPZ() if robot.prismatic[i] else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(robot.placements[i]), name)
    model.addFrame(pin.Frame("flange", parent, pin.SE3(robot.placements[-1]), pin.OP_FRAME))
    return model


def test_flange_and_jacobian_are_those_of_pinocchio(robot):
    model, q = pinocchio_of(robot), poses_of(robot)
    data, found = model.createData(), postures(dual_chain(robot), q)
    ours, at_point = to_matrix(found.pose), twist_jacobian(found, POINT)
    frame = model.getFrameId("flange")
    for i, row in enumerate(q):
        pin.computeJointJacobians(model, data, row)
        pin.updateFramePlacements(model, data)
        np.testing.assert_allclose(ours[i], data.oMf[frame].homogeneous, atol=1e-10)
        expected = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        expected[:3] -= pin.skew(data.oMf[frame].rotation @ POINT) @ expected[3:]
        np.testing.assert_allclose(at_point[i], expected, atol=1e-10)


def test_frames_and_jacobian_are_those_of_matrices(robot):
    q = poses_of(robot)
    chain, frames = dual_chain(robot), matrix_forward(robot, q)
    np.testing.assert_allclose(to_matrix(forward(chain, q)), flange_poses(robot, q), atol=1e-12)
    ours = to_matrix(joint_frames(chain, q))
    np.testing.assert_allclose(ours[..., :3, :3], frames.rotation, atol=1e-12)
    np.testing.assert_allclose(ours[..., :3, 3], frames.origin, atol=1e-12)
    found = postures(chain, q)
    expected = jacobian(frames, frames.point(POINT))
    np.testing.assert_allclose(twist_jacobian(found, POINT), expected, atol=1e-10)
    np.testing.assert_allclose(twist(found.screws), screws(joint_springs(frames)).swapaxes(1, 2), atol=1e-12)


def test_the_jacobian_is_the_derivative_of_the_dual_quaternion(robot):
    q, step, chain = poses_of(robot), 1e-6, dual_chain(robot)
    pose, columns = pose_and_jacobian(chain, q)
    np.testing.assert_array_equal(pose, forward(chain, q))
    for i, nudge in enumerate(step * np.eye(robot.n)):
        slope = (forward(chain, q + nudge) - forward(chain, q - nudge)) / (2 * step)
        np.testing.assert_allclose(columns[:, :, i], slope, atol=1e-8)


def test_the_three_forms_of_the_jacobian_are_one(robot):
    q, chain = poses_of(robot), dual_chain(robot)
    pose, columns = pose_and_jacobian(chain, q)
    found = postures(chain, q)
    np.testing.assert_allclose(found.jacobian, columns, atol=1e-13)
    back = dq.product(columns.swapaxes(1, 2), dq.conjugate(pose)[:, None])
    np.testing.assert_allclose(found.deviation, back.swapaxes(1, 2), atol=1e-12)


def test_poses_stay_unit(robot):
    chain, q = dual_chain(robot), poses_of(robot, 3000)
    dq.unit(forward(chain, q))
    dq.unit(joint_frames(chain, q))


def test_end_points_of_both_arms_are_those_of_the_tables():
    points = [translation(forward(dual_chain(load_robot(name)), np.zeros(8)))[0] for name in ("sda5f_r1", "sda5f_r2")]
    np.testing.assert_allclose(points[0], [0.150, 0.573, 0.503], atol=1e-12)
    np.testing.assert_allclose(points[1], [0.150, -0.573, 0.503], atol=1e-12)


def test_the_right_arm_is_the_left_one_in_the_mirror():
    """Mirror plane xz: the waist turns the other way, the arm's joints do not, and the flange's z axis is reversed."""
    q = np.random.default_rng(2).uniform(-2, 2, (50, 8))
    left, right = (dual_chain(load_robot(name)) for name in ("sda5f_r1", "sda5f_r2"))
    one, two = to_matrix(forward(left, q)), to_matrix(forward(right, q * [-1, 1, 1, 1, 1, 1, 1, 1]))
    mirror, flip = np.diag([1.0, -1, 1, 1]), np.diag([1.0, 1, -1, 1])
    np.testing.assert_allclose(two, mirror @ one @ flip, atol=1e-12)


def test_a_pose_comes_out_the_same_alone_and_in_a_batch():
    robot = load_robot("sda5f_r1")
    chain, q = dual_chain(robot), poses_of(robot, 3000)
    batch = pose_and_jacobian(chain, q)
    for i in (0, 1023, 1024, 2999):
        alone = pose_and_jacobian(chain, q[i])
        np.testing.assert_allclose(alone[0][0], batch[0][i], atol=1e-14)
        np.testing.assert_allclose(alone[1][0], batch[1][i], atol=1e-14)


def test_negated_placements_change_no_motion(robot):
    q, chain = poses_of(robot), dual_chain(robot)
    signs = np.where(np.arange(robot.n + 1) % 2, -1.0, 1.0)[:, None]
    other = replace(chain, placements=chain.placements * signs, steps=chain.steps * signs[1:, :, None])
    one, two = postures(chain, q), postures(other, q)
    np.testing.assert_allclose(to_matrix(two.pose), to_matrix(one.pose), atol=1e-13)
    np.testing.assert_allclose(two.screws, one.screws, atol=1e-13)
    np.testing.assert_allclose(np.abs(two.pose), np.abs(one.pose), atol=1e-13)


def test_wrong_joint_values_are_named_and_right_ones_left_alone():
    chain = dual_chain(load_robot("ur10"))
    q = np.zeros((3, 6))
    q.setflags(write=False)
    for function in (forward, joint_frames, postures, pose_and_jacobian):
        function(chain, q)
        with pytest.raises(
            InputError, match=re.escape("shape (3, 5): (V, 6) expected for robot Universal Robots UR10")
        ):
            function(chain, np.zeros((3, 5)))
    assert forward(chain, np.zeros((0, 6))).shape == (0, 8)
    with pytest.raises(ValueError, match="read-only"):
        chain.placements[0, 0] = 2.0
