"""Batched forward kinematics: all joint frames of many poses at once, in the base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.errors import InputError
from identify.robot import Robot

__all__ = ["Frames", "flange_poses", "forward", "jacobian"]


@dataclass(frozen=True, eq=False)
class Frames:
    """Placements of one robot in V poses, base frame, m.

    Attributes:
        robot: The robot.
        rotation: (V, n, 3, 3) axes of the joint frames before the joint moves; column 2 is the joint axis.
        origin: (V, n, 3) their origins.
        centre: (V, n, 3) centres of mass of the moved links (zero where unknown).
        flange_rotation: (V, 3, 3).
        flange_origin: (V, 3).
    """

    robot: Robot
    rotation: Floats
    origin: Floats
    centre: Floats
    flange_rotation: Floats
    flange_origin: Floats

    @property
    def axis(self) -> Floats:
        """(V, n, 3) joint axes."""
        return self.rotation[..., 2]

    def taken(self, poses: Ints) -> Frames:
        """The frames of some of the poses, by their indices (W,)."""
        arrays = (self.rotation, self.origin, self.centre, self.flange_rotation, self.flange_origin)
        return Frames(self.robot, *(array[poses] for array in arrays))

    def point(self, local: Floats) -> Floats:
        """Points of the flange frame in the base frame: ``local`` (3,) or (V, 3) -> (V, 3), m."""
        if local.ndim == 1:
            return self.flange_origin + self.flange_rotation @ local
        turned: Floats = np.einsum("vij,vj->vi", self.flange_rotation, local)
        return self.flange_origin + turned


def _turn(rotation: Floats, angle: Floats) -> Floats:
    """Rotate (V, 3, 3) frames about their own z axis by ``angle`` (V,), rad."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = rotation[..., 0], rotation[..., 1]
    return np.stack([c * x + s * y, c * y - s * x, rotation[..., 2]], axis=-1)


def forward(robot: Robot, q: Floats) -> Frames:
    """Joint frames and flange for joint values ``q`` (V, n), rad or m, in the robot file's convention.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    q = np.atleast_2d(np.asarray(q, dtype=np.float64))
    if q.shape[1] != robot.n:
        raise InputError(f"{q.shape[1]} joint values per pose given, robot {robot.name} has {robot.n} joints")
    count = len(q)
    rotations = np.empty((count, robot.n, 3, 3))
    origins = np.empty((count, robot.n, 3))
    centres = np.empty((count, robot.n, 3))
    local_centres = np.where(np.isfinite(robot.centres), robot.centres, 0.0)
    rotation: Floats = np.broadcast_to(np.eye(3), (count, 3, 3))
    origin: Floats = np.zeros((count, 3))
    for i, placement in enumerate(robot.placements):
        origin = origin + (rotation.reshape(-1, 3) @ placement[:3, 3]).reshape(count, 3)
        rotation = np.matmul(rotation.reshape(-1, 3), placement[:3, :3]).reshape(count, 3, 3)
        if i == robot.n:
            break
        rotations[:, i], origins[:, i] = rotation, origin
        if robot.prismatic[i]:
            origin = origin + rotation[..., 2] * q[:, i, None]
        else:
            rotation = _turn(rotation, q[:, i])
        centres[:, i] = origin + (rotation.reshape(-1, 3) @ local_centres[i]).reshape(count, 3)
    return Frames(robot, rotations, origins, centres, rotation, origin)


def flange_poses(robot: Robot, q: Floats) -> Floats:
    """Flange placements base_T_flange (V, 4, 4) for joint values ``q`` (V, n)."""
    frames = forward(robot, q)
    poses = np.zeros((len(frames.origin), 4, 4))
    poses[:, :3, :3] = frames.flange_rotation
    poses[:, :3, 3] = frames.flange_origin
    poses[:, 3, 3] = 1.0
    return poses


def jacobian(frames: Frames, points: Floats) -> Floats:
    """Geometric Jacobian (V, 6, n) of points (V, 3) that move with the flange, base frame.

    Rows 0-2: velocity of the point, m per rad (or per m); rows 3-5: angular velocity. The load
    Jacobian and the marker Jacobian of the field are this function at the load and at the marker.
    """
    axis, slides = frames.axis, frames.robot.prismatic[:, None]
    linear = np.where(slides, axis, np.cross(axis, points[:, None] - frames.origin))
    angular = np.where(slides, 0.0, axis)
    return np.concatenate([linear, angular], axis=-1).swapaxes(1, 2)
