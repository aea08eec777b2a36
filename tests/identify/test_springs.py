"""The spring fields against finite differences, virtual work and the closed forms of one and three joints."""

import math
from dataclasses import replace

import numpy as np
import pytest

from identify.kinematics import flange_poses, forward, jacobian
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.springs import joint_springs, load_torque, motion, self_weight_torque
from identify.transforms import axis_frame, roll_pitch_yaw, translation

RNG = np.random.default_rng(7)
LOCAL = np.array([[0.3, 0.12, -0.08], [0.02, 0.09, 0.22]])
HOOK = np.array([0.32, 0.06, -0.07])


def mixed_robot():
    """Five joints about crooked axes, two of them sliding, with masses, a tool and a tilted base."""
    n = 5
    placements = [translation(RNG.normal(0, 0.4, 3)) @ axis_frame(RNG.normal(size=3)) for _ in range(n + 1)]
    return Robot(
        name="mixed",
        joints=tuple("abcde"),
        prismatic=np.array([False, True, False, True, False]),
        placements=np.array(placements),
        lower=np.full(n, -1.0),
        upper=np.full(n, 1.0),
        masses=RNG.uniform(1, 50, n),
        centres=RNG.normal(0, 0.3, (n, 3)),
        efforts=np.full(n, np.nan),
        world_R_base=roll_pitch_yaw([0.3, -0.4, 2.0]),
        tool_mass=12.0,
        tool_centre=np.array([0.1, 0.2, -0.1]),
    )


@pytest.fixture(params=["mixed", "ur10", "kr270_r2700"])
def robot(request):
    return mixed_robot() if request.param == "mixed" else load_robot(request.param, mount=(0.2, -0.3, 0.5))


def slope(function, q, step=1e-6):
    """Central differences of ``function(q)`` (V, ...) by each joint -> (n, V, ...)."""
    return np.array([(function(q + step * e) - function(q - step * e)) / (2 * step) for e in np.eye(q.shape[1])])


def test_motion_is_how_the_marker_moves_with_each_joint(robot):
    q = RNG.uniform(-1, 1, (6, robot.n))
    frames = forward(robot, q)
    points = np.stack([frames.point(local) for local in LOCAL], axis=1)
    fields = motion(joint_springs(frames), points)
    for m, local in enumerate(LOCAL):
        expected = slope(lambda values, local=local: forward(robot, values).point(local), q)
        np.testing.assert_allclose(fields[:, m], expected.swapaxes(0, 1), atol=1e-8)


def test_motion_and_load_torque_are_the_two_jacobians(robot):
    q = RNG.uniform(-1, 1, (6, robot.n))
    frames = forward(robot, q)
    springs = joint_springs(frames)
    force, moment = RNG.normal(size=(2, 6, 3))
    marker, hook = frames.point(LOCAL[0]), frames.point(HOOK)
    np.testing.assert_allclose(
        motion(springs, marker[:, None])[:, 0].swapaxes(1, 2), jacobian(frames, marker)[:, :3], atol=1e-14
    )
    wrench = np.concatenate([force, moment], axis=1)
    expected = np.einsum("vij,vi->vj", jacobian(frames, hook), wrench)
    np.testing.assert_allclose(load_torque(springs, hook, force, moment), expected, atol=1e-13)


def test_load_torque_does_the_virtual_work_of_a_dead_force(robot):
    q = RNG.uniform(-1, 1, (6, robot.n))
    force = RNG.normal(0, 500, (6, 3))
    frames = forward(robot, q)
    torque = load_torque(joint_springs(frames), frames.point(HOOK), force, np.zeros((6, 3)))
    work = slope(lambda values: np.einsum("vi,vi->v", forward(robot, values).point(HOOK), force), q)
    np.testing.assert_allclose(torque, work.T, atol=1e-5)


def test_load_torque_does_the_virtual_work_of_a_moment(robot):
    q = RNG.uniform(-1, 1, (6, robot.n))
    moment = RNG.normal(0, 100, (6, 3))
    frames = forward(robot, q)
    torque = load_torque(joint_springs(frames), frames.point(HOOK), np.zeros((6, 3)), moment)
    for i, change in enumerate(slope(lambda values: forward(robot, values).flange_rotation, q)):
        spin = change @ frames.flange_rotation.swapaxes(1, 2)
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        np.testing.assert_allclose(torque[:, i], np.einsum("vi,vi->v", omega, moment), atol=1e-6)


def potential(robot, values):
    """Work of gravity on links and tool, J: minus the potential energy."""
    frames = forward(robot, values)
    masses = np.where(np.isfinite(robot.masses), robot.masses, 0.0)
    moment = np.einsum("i,vij->vj", masses, frames.centre) + robot.tool_mass * frames.point(robot.tool_centre)
    world = moment @ robot.world_R_base.T
    return -robot.gravity * world[:, 2]


def test_self_weight_is_the_slope_of_the_potential(robot):
    q = RNG.uniform(-1, 1, (6, robot.n))
    frames = forward(robot, q)
    torque = self_weight_torque(joint_springs(frames), frames)
    expected = slope(lambda values: potential(robot, values), q)
    np.testing.assert_allclose(torque, expected.T, atol=1e-5)


def test_unknown_masses_weigh_nothing_and_the_tool_still_does():
    robot = load_robot("kr270_r2700")
    frames = forward(robot, np.radians([[0, -90, 90, 0, 0, 0]]))
    assert not self_weight_torque(joint_springs(frames), frames).any()
    loaded = replace(robot, tool_mass=100.0)
    frames = forward(loaded, np.radians([[0, -90, 90, 0, 0, 0]]))
    torque = self_weight_torque(joint_springs(frames), frames)[0]
    weight = 100 * robot.gravity
    # A2 and A3 turn about +y, which lowers the arm for a positive angle, so the weight turns them forwards.
    np.testing.assert_allclose(
        torque, [0, weight * (1.2 + 0.24), weight * (1.2 + 0.24), 0, weight * 0.24, 0], atol=1e-9
    )


def test_a_weight_on_a_wall_mounted_robot_acts_along_world_z():
    robot = replace(load_robot("single_joint", mount=(0, math.pi / 2, 0)), tool_mass=10.0)
    # The base z axis points along world x, so the arm, at zero along base x, hangs down along world -z.
    flange = robot.world_R_base @ flange_poses(robot, np.zeros((1, 1)))[0, :3, 3]
    np.testing.assert_allclose(flange, [0, 0, -1], atol=1e-15)
    for angle, expected in ((0.0, 0.0), (math.pi / 2, -10 * robot.gravity), (-math.pi / 2, 10 * robot.gravity)):
        frames = forward(robot, np.array([[angle]]))
        np.testing.assert_allclose(self_weight_torque(joint_springs(frames), frames), [[expected]], atol=1e-12)


def test_single_joint_has_its_closed_form():
    """A = F L cos q (-L sin q, L cos q) for a force F upwards in the plane x-z."""
    robot, force = load_robot("single_joint"), 250.0
    q = RNG.uniform(-math.pi, math.pi, (20, 1))
    frames = forward(robot, q)
    springs, tip = joint_springs(frames), frames.flange_origin
    torque = load_torque(springs, tip, np.tile([0, 0, force], (20, 1)), np.zeros((20, 3)))
    column = motion(springs, tip[:, None])[:, 0, 0] * torque
    s, c = np.sin(q[:, 0]), np.cos(q[:, 0])
    expected = force * np.column_stack([-s * c, np.zeros(20), c * c])
    np.testing.assert_allclose(column, expected, atol=1e-12)


def test_three_joint_arm_reproduces_the_published_single_pose_plan():
    """One pose, vertical unit load, compliances 2 and 3 unknown: the published plans and their accuracy."""
    robot = load_robot("arm_3dof")

    def block(q2, q3, load):
        frames = forward(robot, np.radians([[0.0, q2, q3]]))
        springs, tip = joint_springs(frames), frames.flange_origin
        torque = load_torque(springs, tip, np.array([load], dtype=float), np.zeros((1, 3)))
        return (motion(springs, tip[:, None])[0, 0] * torque[0, :, None]).T

    down = (0, 0, -1)
    assert np.abs(block(12, 34, down)[:, 0]).max() < 1e-15
    plans = {
        ((130.8, 70.5),): (down, 1.23596),
        ((0, 0), (143.1, 216.9)): (down, 0.74949),
        ((338.8, 40.7), (158.8, 40.7), (143.1, 216.9)): (down, 0.63813),
        ((82.4, 112.8),): ((1, 0, 0), 0.92978),
        ((258.3, 262.1), (216.9, 143.1)): ((1, 0, 0), 0.62055),
    }
    for poses, (test_load, expected) in plans.items():
        information = sum(a.T @ a for a in (block(*pose, down)[:, 1:] for pose in poses))
        target = block(45, -90, test_load)[:, 1:]
        rho = math.sqrt(np.trace(target @ np.linalg.inv(information) @ target.T))
        assert rho == pytest.approx(expected, abs=1e-5)
