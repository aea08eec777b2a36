"""Effects of elasticity: springs that yield under load and self-weight."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Effect, Parameter, Scene
from identify.effects.places import joint_places
from identify.robot import Robot
from identify.units import SI_OF

__all__ = ["joint_compliance"]

LIMIT = 1000.0  # urad/Nm or um/N: a hundred times the softest joint of an industrial arm


def joint_compliance(robot: Robot, where: tuple[str, ...]) -> Effect:
    """One linear spring about (along) the axis of each joint: gears, drives, bearings.

    Formula: ``displacement = sum_j c_j D_j t_j`` (Klimchik et al., eq. 3 with joint springs only).
    Parameters ``joint_compliance.j1 ...``, urad/Nm for turning and um/N for sliding joints. Typical:
    0.1 to 5 urad/Nm for arms of 200 kg payload, 10 to 50 for arms of 5 to 10 kg.

    Args:
        robot: The robot.
        where: Places ``j1 ... jn``; empty for all.
    """
    index = joint_places("joint_compliance", robot, where)
    units = ["um/N" if robot.prismatic[j] else "urad/Nm" for j in index]
    parameters = tuple(
        Parameter(f"joint_compliance.j{j + 1}", unit, SI_OF[unit], limit=LIMIT)
        for j, unit in zip(index, units, strict=True)
    )
    scale = np.array([parameter.scale for parameter in parameters])

    def derivative(scene: Scene, values: Floats) -> Floats:
        torque = scene.torque[:, index] * scale
        columns = scene.motion[:, index] * torque[scene.experiment.row_shot][:, :, None]
        return np.asarray(columns.swapaxes(1, 2))

    def displacement(scene: Scene, values: Floats) -> Floats:
        yielded: Floats = scene.torque[:, index] * (scale * values)
        moved: Floats = np.einsum("rji,rj->ri", scene.motion[:, index], yielded[scene.experiment.row_shot])
        return moved

    def why_zero(parameter: int) -> str:
        joint = index[parameter]
        if scene_is_vertical(robot, joint):
            return f"vertical loads put no torque on joint {joint + 1}, whose axis is vertical in every pose"
        action = "force along" if robot.prismatic[joint] else "torque on"
        return f"no load in these data puts a {action} joint {joint + 1}, or no marker moves with it"

    return Effect("joint_compliance", parameters, displacement, derivative, why_zero)


def scene_is_vertical(robot: Robot, joint: int) -> bool:
    """True if the joint's axis is vertical in every pose: the first turning joint of an upright arm."""
    if joint != 0 or robot.prismatic[0]:
        return False
    axis = robot.world_R_base @ robot.placements[0, :3, 2]
    return bool(np.hypot(axis[0], axis[1]) < 1e-9)
