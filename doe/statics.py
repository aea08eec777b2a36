"""What the arm may carry: payload, payload diagram, rated wrist moments and joint torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.kinematics import Frames
from identify.springs import Springs, joint_springs, load_torque, self_weight_torque
from identify.study import Study

__all__ = ["Statics", "carried", "statics"]

_ROUNDING = 1e-9  # relative: a load at a limit is allowed


@dataclass(frozen=True, eq=False)
class Statics:
    """Static torques and what they are compared with.

    Attributes:
        study: The study.
        wrist: (n,) rated moment of tool and load about each joint, Nm; infinite where unknown.
        torque: (n,) allowed torque of links, tool and load, Nm or N; infinite where unknown.
    """

    study: Study
    wrist: Floats
    torque: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "wrist", frozen(self.wrist))
        object.__setattr__(self, "torque", frozen(self.torque))

    def exceeded(self, frames: Frames) -> np.ndarray:
        """(N, L) True where a static moment or torque is above its limit; (N, 1) where none is stated."""
        if np.isinf(self.wrist).all() and np.isinf(self.torque).all():
            return np.zeros((len(frames.origin), 1), dtype=bool)
        joints = joint_springs(frames)
        tool = self._weight(joints, frames, frames.robot.tool_centre, frames.robot.tool_mass)
        weight = self_weight_torque(joints, frames)
        over = []
        for load in _load_torques(self.study, joints, frames):
            moment = np.abs(tool + load) > self.wrist * (1 + _ROUNDING)
            over.append((moment | (np.abs(weight + load) > self.torque * (1 + _ROUNDING))).any(axis=1))
        return np.stack(over, axis=1)

    @staticmethod
    def _weight(joints: Springs, frames: Frames, centre: Floats, mass: float) -> Floats:
        """(N, n) torque of one mass on the flange."""
        force = np.broadcast_to(mass * frames.robot.gravity_base, frames.flange_origin.shape)
        return load_torque(joints, frames.point(centre), force, np.zeros_like(force))


def _load_torques(study: Study, joints: Springs, frames: Frames) -> list[Floats]:
    """Torque or force (N, n) of each load of the study on the joints, Nm or N."""
    robot = study.robot
    found = []
    for load in study.loads:
        stated = [_in_base(frames, vector, load.in_flange) for vector in (load.force, load.moment)]
        force = stated[0] + load.mass * robot.gravity_base
        found.append(load_torque(joints, frames.point(load.attach), force, stated[1]))
    return found


def _in_base(frames: Frames, vector: Floats, in_flange: bool) -> Floats:
    """(N, 3) a vector of the flange or of the world, base axes."""
    if in_flange:
        return np.asarray(frames.flange_rotation @ vector)
    return np.broadcast_to(frames.robot.world_R_base.T @ vector, frames.flange_origin.shape)


def statics(study: Study) -> Statics:
    """The static limits of a study."""
    robot, constraints = study.robot, study.constraints
    wrist, torque = np.full(robot.n, np.inf), np.full(robot.n, np.inf)
    if constraints.wrist_moment is not None:
        wrist[-3:] = constraints.wrist_moment
    if constraints.torque_share is not None:
        torque = np.where(np.isfinite(robot.efforts), constraints.torque_share * robot.efforts, np.inf)
    return Statics(study, wrist, torque)


def carried(study: Study) -> np.ndarray:
    """(L,) True where rated payload and payload diagram allow a load together with the tool.

    The distance of the diagram is that of the common centre of tool and hung mass (at its attach point) from the
    flange origin. An unknown payload allows everything.
    """
    robot, constraints = study.robot, study.constraints
    mass = np.array([load.mass for load in study.loads]) + robot.tool_mass
    payload = robot.payload * constraints.payload_share
    allowed = ~(mass > payload * (1 + _ROUNDING))
    if constraints.payload_diagram is None:
        return np.asarray(allowed)
    moment = np.array([load.mass * load.attach for load in study.loads]) + robot.tool_mass * robot.tool_centre
    distance = np.linalg.norm(moment, axis=1) / np.where(mass > 0.0, mass, 1.0)
    limit = constraints.payload_diagram.allowed(distance) * (1 + _ROUNDING)
    return np.asarray(allowed & ((mass <= limit) | (mass == 0.0)))
