"""Compensation inside a control loop: one pose and one measured wrench at a time, in well under a millisecond.

For arms in which only joints yield: with the compliances C of the joints and the torques t of the measured wrench (and
of self-weight), the joints are commanded to ``q - C t``, which is exact there (`identify.compensation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats, frozen
from identify.compensation import joint_matrix
from identify.errors import InputError
from identify.kinematics import flange_poses, forward
from identify.robot import Robot
from identify.springs import joint_springs, load_torque, self_weight_torque
from identify.tool_response import Arm

__all__ = ["LoopCompensator", "LoopCorrection", "loop_compensator"]


class LoopCorrection(NamedTuple):
    """The correction of one sample.

    Attributes:
        change: (n,) to add to the joint values, rad or m.
        q: (n,) joint values to command.
        pose: (4, 4) pose to command: where the rigid nominal robot stands at ``q``, base frame, m.
    """

    change: Floats
    q: Floats
    pose: Floats


@dataclass(frozen=True, eq=False)
class LoopCompensator:
    """What was prepared for the loop.

    Attributes:
        robot: The robot.
        compliance: (n, n) rad/Nm, m/N for sliding joints.
        attach: (3,) point about which wrenches are measured, flange frame, m.
        self_weight: The weight of links and tool counts; it is then not to be part of the measured wrench.
    """

    robot: Robot
    compliance: Floats
    attach: Floats
    self_weight: bool

    def correction(self, q: ArrayLike, wrench: ArrayLike) -> LoopCorrection:
        """Correction of one sample.

        Args:
            q: (n,) wished joint values, rad or m.
            wrench: (6,) measured force (N) and moment (Nm) on the flange, in its axes.

        Raises:
            InputError: Wrong shapes, or a number that is not finite (a sensor that failed must not move the arm).
        """
        wished = _sample("joint values", q, self.robot.n)[None]
        given = _sample("wrench", wrench, 6)
        frames = forward(self.robot, wished)
        springs, turn = joint_springs(frames), frames.flange_rotation
        torque = load_torque(springs, frames.point(self.attach), turn @ given[:3], turn @ given[3:])
        if self.self_weight:
            torque = torque + self_weight_torque(springs, frames)
        change = -torque @ self.compliance.T
        return LoopCorrection(change[0], (wished + change)[0], flange_poses(self.robot, wished + change)[0])


def loop_compensator(arm: Arm, attach: ArrayLike = (0.0, 0.0, 0.0)) -> LoopCompensator:
    """Prepare the compensation of an arm for a control loop.

    Args:
        arm: The fitted arm (`identify.tool_response.arm_of`).
        attach: (3,) point about which the sensor measures, flange frame, m.

    Raises:
        InputError: The model holds effects that a loop cannot compensate by joint torques alone.
    """
    others = [effect.name for effect in arm.model.effects if effect.springs != "joints"]
    if others:
        raise InputError(
            f"the model holds {', '.join(others)}; a control loop compensates joint_compliance and "
            "joint_cross_compliance alone: identify a model of these, or compensate whole targets (compensate)"
        )
    point = _sample("attach point", attach, 3)
    return LoopCompensator(arm.model.robot, frozen(joint_matrix(arm)), frozen(point), arm.model.self_weight)


def _sample(what: str, values: ArrayLike, size: int) -> Floats:
    """One sample as a finite vector.

    Raises:
        InputError: It is none.
    """
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise InputError(f"{what} {np.array2string(vector, threshold=10)}: {size} finite numbers expected")
    return vector
