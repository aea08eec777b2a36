"""Joint values of a rigid robot for poses of its flange, near known ones."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.errors import NoConvergence
from identify.kinematics import flange_poses, forward, jacobian
from identify.robot import Robot
from identify.rotations import pose_errors

__all__ = ["TOLERANCE", "joints_near", "least_motion"]

TOLERANCE = 1e-10  # m and rad
_MAX_STEPS = 20
_LEVER = 0.01  # m: a turn counts as the motion of a point at this distance, so that position comes first
_SINGULAR = 1e-6  # of the largest singular value; what is below is no direction the arm can be moved in
_WILD = 0.5  # rad or m: Newton's step beyond this leaves the neighbourhood


def least_motion(robot: Robot, q: Floats, twist: Floats, *, largest: float = np.inf) -> Floats:
    """The smallest change of joint values (T, n) that moves the flange by small twists.

    The least-squares one if the arm cannot do it, with 1 rad for 10 mm. Left out are directions that a singular pose
    has lost, and those in which the joints would have to move by more than ``largest`` because it is nearly lost.

    Args:
        robot: The robot.
        q: (T, n) joint values, rad or m.
        twist: (T, 6) motion of the flange origin and turn, base frame, m and rad.
        largest: Largest motion along one singular direction of the Jacobian, rad or m.
    """
    frames = forward(robot, q)
    scale = np.repeat([1.0, _LEVER], 3)
    rows = scale[:, None] * jacobian(frames, frames.flange_origin)
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    along = ((scale * twist)[:, None] @ left)[:, 0]
    lost = (size <= _SINGULAR * size[:, :1]) | (np.abs(along) > largest * size)
    share = np.where(lost, 0.0, along / np.where(lost, 1.0, size))
    change: Floats = (share[:, None] @ right)[:, 0]
    return change


def joints_near(robot: Robot, poses: Floats, q: Floats) -> Floats:
    """Joint values (T, n) that put the flange of the rigid robot at poses (T, 4, 4), by Newton's method.

    Args:
        robot: The robot.
        poses: base_T_flange, m.
        q: (T, n) where to start, rad or m; of several solutions the one that is reached from there.

    Raises:
        NoConvergence: Some pose is not reached to within `TOLERANCE`; ``best`` holds the (T,) bool of those.
    """
    for _ in range(_MAX_STEPS):
        miss = pose_errors(flange_poses(robot, q), poses)
        if np.abs(miss).max(initial=0.0) < TOLERANCE:
            return q
        q = q - np.clip(least_motion(robot, q, miss), -_WILD, _WILD)
    missed = ~(np.abs(pose_errors(flange_poses(robot, q), poses)).max(axis=1) < TOLERANCE)
    if missed.any():
        raise NoConvergence(
            f"{missed.sum()} of {len(q)} poses are not reached near the given joint values of {robot.name}: they are "
            "out of reach or at a singular pose",
            missed,
        )
    return q
