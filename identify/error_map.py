"""Maps of the errors of position and orientation over the workspace under a given load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from identify.arrays import Floats
from identify.errors import InputError
from identify.kinematics import flange_poses
from identify.robot import Robot
from identify.rotations import pose_errors
from identify.tool_response import Arm, Targets, tool_poses

__all__ = ["ErrorMap", "error_map", "hung_weight", "spread_poses"]


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Errors of the flange in N poses.

    Attributes:
        q: (N, n) joint values, rad or m.
        place: (N, 3) origin of the rigid flange, base frame, m.
        position: (N,) distance by which its origin is displaced, m.
        orientation: (N,) angle by which it is turned, rad.
    """

    q: Floats
    place: Floats
    position: Floats
    orientation: Floats


def error_map(
    arm: Arm,
    q: Floats,
    wrench: Floats,
    *,
    attach: Floats | None = None,
    in_flange: bool = False,
    against: Literal["rigid", "unloaded"] = "rigid",
) -> ErrorMap:
    """Errors of position and orientation of the flange in many poses under one load.

    Args:
        arm: The arm (`identify.tool_response.arm_of`).
        q: (N, n) joint values, rad or m.
        wrench: (6,) force (N) and moment (Nm) at the attach point.
        attach: (3,) where it acts, flange frame, m; the origin of the flange by default.
        in_flange: The wrench turns with the flange; else it is fixed in the world.
        against: ``rigid``: errors of the arm, self-weight included. ``unloaded``: what the load alone does.

    Raises:
        InputError: Wrong shapes, or numbers that are not finite.
        NoConvergence: The loaded arm finds no equilibrium.
    """
    count = len(q)
    targets = Targets(
        names=("pose",) * count,
        q=q,
        wrench=np.broadcast_to(np.asarray(wrench, dtype=np.float64), (count, 6)),
        in_flange=np.full(count, in_flange),
        attach=np.broadcast_to(np.zeros(3) if attach is None else attach, (count, 3)),
    )
    rigid = flange_poses(arm.model.robot, targets.q)
    reference = rigid if against == "rigid" else tool_poses(arm, targets.under(np.zeros((count, 6))))
    error = pose_errors(tool_poses(arm, targets), reference)
    return ErrorMap(
        targets.q, rigid[:, :3, 3], np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)
    )


def hung_weight(robot: Robot, mass: float) -> Floats:
    """Wrench (6,) of a mass (kg) that hangs freely, world frame, N and Nm."""
    weight: Floats = np.append(mass * robot.gravity * robot.down, np.zeros(3))
    return weight


def spread_poses(robot: Robot, count: int, rng: np.random.Generator) -> Floats:
    """Joint values (count, n) spread evenly over the joint limits (scrambled Sobol sequence), rad or m.

    Raises:
        InputError: A joint limit is unknown, or no pose is asked for.
    """
    from scipy.stats.qmc import Sobol

    if count < 1:
        raise InputError(f"{count} poses asked for; at least 1 expected")
    unknown = np.flatnonzero(~np.isfinite(robot.lower) | ~np.isfinite(robot.upper))
    if len(unknown):
        raise InputError(f"robot {robot.name}: the limits of joint {unknown[0] + 1} are unknown; state them")
    power = int(np.ceil(np.log2(count)))
    unit = Sobol(robot.n, rng=rng).random_base2(power)[:count]
    q: Floats = robot.lower + unit * (robot.upper - robot.lower)
    return q
