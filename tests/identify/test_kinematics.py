"""Batched kinematics and Jacobians against Pinocchio, on shipped and on random robots."""

import math
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identify.errors import InputError
from identify.kinematics import flange_poses, forward, jacobian
from identify.robot import Robot
from identify.robot_files import load_robot, shipped_robots
from identify.springs import joint_springs, self_weight_torque
from identify.transforms import roll_pitch_yaw

MARKER, HOOK = np.array([0.3, 0.12, -0.08]), np.array([0.32, 0.06, -0.07])


def model_of(robot):
    """A Pinocchio model with the robot's own frames: joints about z, links and tool with their masses, mounted base."""
    model = pin.Model()
    parent, carried = 0, pin.SE3(robot.world_R_base, np.zeros(3))
    for i, name in enumerate(robot.joints):
        joint = pin.JointModelPZ() if robot.prismatic[i] else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, carried * pin.SE3(robot.placements[i]), name)
        carried = pin.SE3.Identity()
        if np.isfinite(robot.masses[i]):
            inertia = pin.Inertia(robot.masses[i], robot.centres[i], np.eye(3))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    flange = pin.SE3(robot.placements[-1])
    model.addFrame(pin.Frame("flange", parent, flange, pin.OP_FRAME))
    if robot.tool_mass:
        model.appendBodyToJoint(parent, pin.Inertia(robot.tool_mass, robot.tool_centre, np.eye(3)), flange)
    model.gravity.linear = np.array([0.0, 0.0, -robot.gravity])
    return model


def flange_and_jacobian(model, robot, q, local):
    """Flange in the base frame, and the Jacobian of the point ``local`` (flange frame), base frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId("flange")
    base = pin.SE3(robot.world_R_base, np.zeros(3))
    pose = base.actInv(data.oMf[frame])
    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
    arm = data.oMf[frame].rotation @ local
    jacobian[:3] -= pin.skew(arm) @ jacobian[3:]
    turn = np.kron(np.eye(2), robot.world_R_base.T)
    return pose.homogeneous, turn @ jacobian


def random_robot(rng, *, masses=True):
    n = int(rng.integers(1, 10))
    placements = np.tile(np.eye(4), (n + 1, 1, 1))
    quaternions = rng.normal(size=(n + 1, 4))
    for placement, xyzw in zip(placements, quaternions / np.linalg.norm(quaternions, axis=1)[:, None], strict=True):
        placement[:3, :3] = pin.Quaternion(xyzw).toRotationMatrix()
        placement[:3, 3] = rng.normal(0, 0.5, 3)
    prismatic = rng.random(n) < 0.3
    return Robot(
        name="random",
        joints=tuple(f"q{i}" for i in range(n)),
        prismatic=prismatic,
        placements=placements,
        lower=np.full(n, -1.0),
        upper=np.full(n, 2.0),
        masses=rng.uniform(1, 100, n) if masses else np.full(n, np.nan),
        centres=rng.normal(0, 0.3, (n, 3)) if masses else np.full((n, 3), np.nan),
        efforts=np.full(n, np.nan),
    )


def mounted(robot, rng):
    angles = rng.uniform(-math.pi, math.pi, 3)
    return replace(
        robot, world_R_base=roll_pitch_yaw(angles), gravity=9.7, tool_mass=7.0, tool_centre=np.array([0.1, -0.2, 0.3])
    )


def assert_equal_to_pinocchio(robot, q):
    model = model_of(robot)
    frames, poses = forward(robot, q), flange_poses(robot, q)
    ours = {tuple(local): jacobian(frames, frames.point(local)) for local in (MARKER, HOOK)}
    scale = max(1.0, robot.reach)
    for i, row in enumerate(q):
        for local, values in ours.items():
            pose, expected = flange_and_jacobian(model, robot, row, np.array(local))
            np.testing.assert_allclose(poses[i], pose, atol=1e-10)
            np.testing.assert_allclose(values[i], expected, atol=1e-10 * scale)


@pytest.mark.parametrize("name", sorted(shipped_robots()))
def test_shipped_robots_move_as_pinocchio_says(name):
    robot, rng = load_robot(name), np.random.default_rng(50)
    assert_equal_to_pinocchio(robot, rng.uniform(-math.pi, math.pi, (50, robot.n)))
    assert_equal_to_pinocchio(mounted(robot, rng), rng.uniform(-math.pi, math.pi, (50, robot.n)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_random_robots_move_as_pinocchio_says(seed):
    rng = np.random.default_rng(seed)
    robot = mounted(random_robot(rng), rng)
    assert_equal_to_pinocchio(robot, rng.uniform(-3, 3, (10, robot.n)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_self_weight_is_the_generalised_gravity_of_pinocchio(seed):
    rng = np.random.default_rng(seed)
    robot = mounted(random_robot(rng), rng)
    q = rng.uniform(-3, 3, (10, robot.n))
    assert_weight_as_in_pinocchio(robot, q)


def test_self_weight_of_the_ur10_upright_and_mounted_is_that_of_pinocchio():
    rng, robot = np.random.default_rng(3), load_robot("ur10")
    q = rng.uniform(-3, 3, (50, 6))
    assert_weight_as_in_pinocchio(robot, q)
    for _ in range(3):
        assert_weight_as_in_pinocchio(mounted(robot, rng), q)


def assert_weight_as_in_pinocchio(robot, q):
    model = model_of(robot)
    data = model.createData()
    frames = forward(robot, q)
    ours = self_weight_torque(joint_springs(frames), frames)
    # Pinocchio's generalised gravity is what the motors must hold: the opposite of what the weight does.
    theirs = np.array([-pin.computeGeneralizedGravity(model, data, row) for row in q])
    np.testing.assert_allclose(ours, theirs, atol=1e-10 * max(1.0, np.abs(theirs).max()))


def test_jacobian_is_the_derivative_of_the_motion():
    rng = np.random.default_rng(4)
    robot = random_robot(rng)
    q, step = rng.uniform(-1, 1, (5, robot.n)), 1e-6
    frames = forward(robot, q)
    values = jacobian(frames, frames.point(MARKER))
    for i in range(robot.n):
        shifted = [forward(robot, q + sign * step * np.eye(robot.n)[i]) for sign in (1, -1)]
        slope = (shifted[0].point(MARKER) - shifted[1].point(MARKER)) / (2 * step)
        np.testing.assert_allclose(values[:, :3, i], slope, atol=1e-8)
        turn = np.einsum("vij,vkj->vik", shifted[0].flange_rotation, shifted[1].flange_rotation)
        spin = [pin.log3(matrix) / (2 * step) for matrix in turn]
        np.testing.assert_allclose(values[:, 3:, i], spin, atol=1e-8)


def test_a_pose_comes_out_the_same_alone_and_in_a_batch():
    robot, rng = load_robot("kr270_r2700"), np.random.default_rng(5)
    q = rng.uniform(-3, 3, (1000, 6))
    batch = flange_poses(robot, q)
    for i in (0, 17, 999):
        np.testing.assert_allclose(flange_poses(robot, q[i])[0], batch[i], atol=1e-14)
    np.testing.assert_array_equal(batch[:, 3], np.tile([0, 0, 0, 1], (1000, 1)))


def test_points_may_differ_from_pose_to_pose():
    robot, rng = load_robot("ur10"), np.random.default_rng(6)
    frames = forward(robot, rng.uniform(-3, 3, (4, 6)))
    locals_ = rng.normal(size=(4, 3))
    for i, local in enumerate(locals_):
        np.testing.assert_allclose(frames.point(locals_)[i], frames.point(local)[i], atol=1e-15)


def test_a_wrong_number_of_joint_values_is_named():
    with pytest.raises(
        InputError, match=re.escape("5 joint values per pose given, robot Universal Robots UR10 has 6 joints")
    ):
        forward(load_robot("ur10"), np.zeros((3, 5)))


def test_inputs_are_not_changed_and_robots_cannot_be():
    robot = load_robot("ur10")
    q = np.zeros((3, 6))
    q.setflags(write=False)
    forward(robot, q)
    with pytest.raises(ValueError, match="read-only"):
        robot.placements[0, 0, 0] = 2.0


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_reach_bounds_every_pose_within_the_limits(seed):
    rng = np.random.default_rng(seed)
    robot = random_robot(rng)
    q = rng.uniform(robot.lower, robot.upper, (50, robot.n))
    assert np.linalg.norm(flange_poses(robot, q)[:, :3, 3], axis=1).max() <= robot.reach
