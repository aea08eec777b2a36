"""Forward kinematics, screws and Jacobian of serial robots in dual quaternions, all poses at once.

Joint i moves by the factor ``cos(q/2) + k sin(q/2)`` (turning) or ``1 + eps k q/2`` (sliding) about its own z axis.
With ``u = k`` or ``eps k`` both are ``c + s u``; so one step of the chain, placement p behind it, is
``c (x p) + s (x u p)``, two constant matrices. Poses are worked through in parts that stay in the cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats, frozen
from identify.dual_quaternions.algebra import components, joined, product, right_matrix
from identify.dual_quaternions.placements import from_matrix
from identify.errors import InputError
from identify.robot import Robot

__all__ = ["DualChain", "Postures", "dual_chain", "forward", "joint_frames", "pose_and_jacobian", "postures"]

_CHUNK = 1024  # poses at once


@dataclass(frozen=True, eq=False)
class DualChain:
    """A robot whose fixed placements are dual quaternions.

    Attributes:
        robot: The robot.
        placements: (n + 1, 8) as `Robot.placements`, m.
        directions: (n, 8) screw of each joint in its own frame, k or eps k.
        steps: (n, 16, 8) what joint i and the placement behind it make of a frame: the parts of c and of s.
    """

    robot: Robot
    placements: Floats
    directions: Floats
    steps: Floats


@dataclass(frozen=True, eq=False)
class Postures:
    """One robot in V poses.

    Attributes:
        robot: The robot.
        pose: (V, 8) flange in the base frame, m.
        screws: (V, n, 8) dual vectors of the joint axes in the base frame, ``a + eps o x a`` or ``eps a``.
    """

    robot: Robot
    pose: Floats
    screws: Floats

    @property
    def deviation(self) -> Floats:
        """(V, 8, n) change of ``q' q^-1`` per joint, ``dq/dtheta q^-1``: half the screws, 1 / rad or 1 / m."""
        half: Floats = 0.5 * self.screws.swapaxes(1, 2)
        return half

    @property
    def jacobian(self) -> Floats:
        """(V, 8, n) ``dq/dtheta`` (eq. 10, 11): ``screw * q / 2``."""
        return (0.5 * product(self.screws, self.pose[:, None])).swapaxes(1, 2)


def dual_chain(robot: Robot) -> DualChain:
    """Convert the fixed placements of a robot, once for all its poses."""
    placements = from_matrix(robot.placements)
    directions = np.zeros((robot.n, 8))
    directions[np.arange(robot.n), np.where(robot.prismatic, 7, 3)] = 1.0
    still, moved = right_matrix(placements[1:]), right_matrix(product(directions, placements[1:]))
    steps = np.concatenate([still, moved], axis=1)
    return DualChain(robot, frozen(placements), frozen(directions), frozen(steps))


def forward(chain: DualChain, q: ArrayLike) -> Floats:
    """Flange in the base frame (V, 8) for joint values ``q`` (V, n) or (n,), rad or m; eq. 8.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    values = _joint_values(chain.robot, q)
    poses = np.empty((len(values), 8))
    for part, _, pose in _walk(chain, values):
        poses[part] = pose
    return poses


def joint_frames(chain: DualChain, q: ArrayLike) -> Floats:
    """Joint frames (V, n, 8) in the base frame before the joint moves, for joint values ``q`` (V, n) or (n,), rad or m.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    values = _joint_values(chain.robot, q)
    frames = np.empty((len(values), chain.robot.n, 8))
    for part, frame, _ in _walk(chain, values):
        frames[part] = frame.swapaxes(0, 1)
    return frames


def postures(chain: DualChain, q: ArrayLike) -> Postures:
    """Flange and screws for joint values ``q`` (V, n) or (n,), rad or m.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    values = _joint_values(chain.robot, q)
    poses, screws = np.empty((len(values), 8)), np.empty((len(values), chain.robot.n, 8))
    for part, frame, pose in _walk(chain, values):
        poses[part], screws[part] = pose, _screws(chain, frame).swapaxes(0, 1)
    poses.setflags(write=False)
    screws.setflags(write=False)
    return Postures(chain.robot, poses, screws)


def pose_and_jacobian(chain: DualChain, q: ArrayLike) -> tuple[Floats, Floats]:
    """Flange (V, 8) and ``dq/dtheta`` (V, 8, n) for joint values ``q`` (V, n) or (n,), rad or m; eq. 8, 10 and 11.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    values = _joint_values(chain.robot, q)
    poses, jacobians = np.empty((len(values), 8)), np.empty((len(values), 8, chain.robot.n))
    for part, frame, pose in _walk(chain, values):
        poses[part] = pose
        jacobians[part] = product(_screws(chain, frame), 0.5 * pose).transpose(1, 2, 0)
    return poses, jacobians


def _joint_values(robot: Robot, q: ArrayLike) -> Floats:
    """(V, n) joint values."""
    values = np.atleast_2d(np.asarray(q, dtype=np.float64))
    if values.ndim != 2 or values.shape[1] != robot.n:
        raise InputError(f"joint values of shape {np.shape(q)}: (V, {robot.n}) expected for robot {robot.name}")
    return values


def _walk(chain: DualChain, q: Floats) -> Iterator[tuple[slice, Floats, Floats]]:
    """Of each part of the poses: where it stands, joint frames (n, C, 8) and flange (C, 8)."""
    slides = chain.robot.prismatic[:, None]
    for start in range(0, len(q), _CHUNK):
        part = slice(start, start + _CHUNK)
        half = 0.5 * q[part].T
        cosine, sine = np.where(slides, 1.0, np.cos(half)), np.where(slides, half, np.sin(half))
        frames = np.empty((8, *half.shape))
        state = np.repeat(chain.placements[0, :, None], half.shape[1], axis=1)
        for i, step in enumerate(chain.steps):
            frames[:, i] = state
            stepped = step @ state
            state = stepped[:8] * cosine[i] + stepped[8:] * sine[i]
        yield part, joined(frames), joined(state)


def _screws(chain: DualChain, frames: Floats) -> Floats:
    """Screws (n, C, 8) of joints in the base frame, ``x k x*`` or ``x eps k x*`` with the frames x (n, C, 8).

    The real part is ``r k r*``. The dual part, ``d k r* + r k d*``, is twice the vector of its first term.
    """
    parts = components(frames)
    axis, moment = _z_between(parts[:4], parts[:4]), 2.0 * _z_between(parts[4:], parts[:4])
    slides = chain.robot.prismatic[:, None]
    screws = np.zeros(parts.shape)
    screws[1:4], screws[5:] = np.where(slides, 0.0, axis), np.where(slides, axis, moment)
    return joined(screws)


def _z_between(a: Floats, b: Floats) -> Floats:
    """Vector part (3, ...) of ``a k b*`` for quaternions (4, ...)."""
    w, x, y, z = a
    bw, bx, by, bz = b
    return np.stack([
        w * by + x * bz + y * bw + z * bx,
        y * bz + z * by - w * bx - x * bw,
        w * bw + z * bz - x * bx - y * by,
    ])
