"""What every effect is made of: named parameters, a displacement and its derivative.

An effect is one physical cause. It is bound to a robot once (`bind`), which fixes its parameters, and
then maps a *scene* (an experiment with all its fields computed) to marker displacements. Simulation,
design, identification and compensation all use the same two functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.experiment import Experiment
from identify.kinematics import Frames
from identify.loads import LoadCase
from identify.robot import Robot
from identify.springs import joint_springs, load_torque, motion, self_weight_torque

__all__ = ["Effect", "Parameter", "Scene", "build_scene"]


@dataclass(frozen=True)
class Parameter:
    """One unknown.

    Attributes:
        name: ``<effect>.<where>[.<component>]``.
        unit: Unit of its value in files and results.
        scale: SI value of one unit.
        nominal: Starting value, in ``unit``.
        nuisance: True for frame and markers, which are fitted but not asked for.
        limit: A fit that knows it no better than this (1 sigma, in ``unit``) holds it at its nominal value.
    """

    name: str
    unit: str
    scale: float
    nominal: float = 0.0
    nuisance: bool = False
    limit: float = float("inf")


@dataclass(frozen=True, eq=False)
class Scene:
    """An experiment with its fields, base frame, SI.

    Attributes:
        experiment: The conditions.
        frames: Joint frames of the C poses of the experiment.
        point: (R, 3) undeflected marker of each row, m.
        motion: (R, n, 3) motion of that marker per unit of each joint; zero for targets on the base.
        torque: (S, n) torque or force that load and self-weight put on each joint.
    """

    experiment: Experiment
    frames: Frames
    point: Floats
    motion: Floats
    torque: Floats

    @property
    def row_pose(self) -> np.ndarray:
        """(R,) pose of each row."""
        return np.asarray(self.experiment.shot_pose[self.experiment.row_shot])


Displacement = Callable[[Scene, Floats], Floats]


@dataclass(frozen=True, eq=False)
class Effect:
    """One cause, bound to a robot.

    Attributes:
        name: Its name in study files.
        parameters: Its p unknowns.
        displacement: ``(scene, values) -> (R, 3)`` m, base frame; values in the parameters' units.
        derivative: ``(scene, values) -> (R, 3, p)`` m per unit.
        yields: True if it answers to loads (only then do differences between loads show it).
        adjust: ``(robot, values) -> robot`` for effects that change the robot itself.
        why_zero: Index of a parameter -> why no row may depend on it.
    """

    name: str
    parameters: tuple[Parameter, ...]
    displacement: Displacement
    derivative: Displacement
    why_zero: Callable[[int], str]
    yields: bool = True
    adjust: Callable[[Robot, Floats], Robot] | None = None


def build_scene(experiment: Experiment, frames: Frames, positions: Floats, *, self_weight: bool) -> Scene:
    """Compute all fields of an experiment in one pass.

    Args:
        experiment: The conditions.
        frames: Joint frames of ``experiment.q``.
        positions: (M, 3) markers in their own frames, m.
        self_weight: Count the weight of links and tool.
    """
    markers = experiment.markers
    points = np.stack([frames.point(local) for local in positions], axis=1)
    points[:, markers.on_base] = positions[markers.on_base]
    springs = joint_springs(frames)
    moves = motion(springs, points)
    moves[:, markers.on_base] = 0.0
    row_pose = experiment.shot_pose[experiment.row_shot]
    torque = _load_torque(experiment, frames)
    if self_weight:
        torque += self_weight_torque(springs, frames)[experiment.shot_pose]
    return Scene(
        experiment, frames, points[row_pose, experiment.row_marker], moves[row_pose, experiment.row_marker], torque
    )


def _load_torque(experiment: Experiment, frames: Frames) -> Floats:
    """Torque of what hangs on the flange or of the measured wrench, (S, n)."""
    torque = np.zeros((len(experiment.shot_load), frames.robot.n))
    for index, load in enumerate(experiment.loads):
        shots = np.flatnonzero((experiment.shot_load == index) & ~experiment.shot_unloaded)
        if len(shots):
            measured = None if experiment.wrench is None else experiment.wrench[shots]
            torque[shots] = _torque_of(load, measured, _at(frames, experiment.shot_pose[shots]))
    return torque


def _torque_of(load: LoadCase, measured: Floats | None, frames: Frames) -> Floats:
    """Torque of one load case (or of measured wrenches (S, 6) in the flange frame) in S poses."""
    robot = frames.robot
    if measured is not None:
        force, moment = measured[:, :3], measured[:, 3:]
        force, moment = (np.einsum("sij,sj->si", frames.flange_rotation, v) for v in (force, moment))
    else:
        turn = frames.flange_rotation if load.in_flange else robot.world_R_base.T[None]
        force = turn @ load.force + load.mass * robot.gravity_base
        moment = turn @ load.moment
    shape = frames.flange_origin.shape
    return load_torque(
        joint_springs(frames), frames.point(load.attach), np.broadcast_to(force, shape), np.broadcast_to(moment, shape)
    )


def _at(frames: Frames, index: np.ndarray) -> Frames:
    """The frames of some poses."""
    if np.array_equal(index, np.arange(len(frames.origin))):
        return frames
    return Frames(
        frames.robot,
        frames.rotation[index],
        frames.origin[index],
        frames.centre[index],
        frames.flange_rotation[index],
        frames.flange_origin[index],
    )
