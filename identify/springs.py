"""The elastic core: every deflection is a sum over elementary springs.

``displacement(marker) = sum_s D_s(marker) c_s t_s(load)`` with

* ``D_s = a_s x (p - o_s)`` for a rotational spring, ``D_s = a_s`` for a translational one: how the
  marker moves per unit of spring deflection (the marker Jacobian);
* ``t_s = a_s . ((p_L - o_s) x F + M)`` or ``a_s . F``: what the load puts on the spring (the load
  Jacobian, at the point where the load acts);
* ``c_s`` its compliance.

Source: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", eq. (3)-(5),
with the marker and the load at two different points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.kinematics import Frames, forward
from identify.robot import Robot

__all__ = [
    "Springs",
    "base_springs",
    "carried",
    "carry",
    "cross",
    "joint_springs",
    "link_springs",
    "link_turns",
    "load_torque",
    "motion",
    "screws",
    "self_weight_torque",
]


@dataclass(frozen=True, eq=False)
class Springs:
    """Elementary springs of one robot in V poses, base frame.

    Attributes:
        axis: (V, s, 3) unit directions.
        origin: (V, s, 3) points on the axes, m.
        slides: (s,) True for translational springs.
        first_link: (s,) the springs carry the links ``first_link ... n - 1`` and the tool.
    """

    axis: Floats
    origin: Floats
    slides: np.ndarray
    first_link: Ints


def joint_springs(frames: Frames) -> Springs:
    """The springs of the joints themselves, one a joint."""
    return Springs(frames.axis, frames.origin, frames.robot.prismatic, np.arange(frames.robot.n))


def link_springs(frames: Frames) -> Springs:
    """Six springs at the distal end of every link, base included: x, y, z sliding, then x, y, z turning.

    Link i (0 is the base, n carries the flange) ends where joint i + 1 begins, or at the flange. Its frame moves
    with it and is, at zero joint values, turned from the base by ``robot.link_rotations[i]``.
    """
    rotation = np.concatenate([frames.rotation, frames.flange_rotation[:, None]], axis=1) @ link_turns(frames.robot)
    origin = np.concatenate([frames.origin, frames.flange_origin[:, None]], axis=1)
    return _six_each(rotation, origin, np.arange(frames.robot.n + 1))


def base_springs(frames: Frames) -> Springs:
    """Twelve springs at the foot of the arm: the six of link 0, then the same six turning (or sliding) with joint 1.

    The second half stands for the bearing under the column: it carries what the first half carries, but its axes
    are fixed in the column.
    """
    robot = frames.robot
    after = np.concatenate([frames.rotation, frames.flange_rotation[:, None]], axis=1)[:, 1]
    column = after @ robot.placements[1, :3, :3].T
    end = frames.origin[:, 1] if robot.n > 1 else frames.flange_origin
    origin = np.stack([frames.origin[:, 0], end - column @ robot.placements[1, :3, 3]], axis=1)
    rotation = np.stack([frames.rotation[:, 0], column], axis=1) @ link_turns(robot)[0]
    return _six_each(rotation, origin, np.zeros(2, dtype=np.int64))


def _six_each(rotation: Floats, origin: Floats, first_link: Ints) -> Springs:
    """x, y, z sliding, then x, y, z turning, in each of b frames (V, b, 3, 3) at (V, b, 3)."""
    axis = np.tile(rotation.swapaxes(2, 3), (1, 1, 2, 1)).reshape(len(origin), -1, 3)
    slides = np.tile(np.repeat([True, False], 3), len(first_link))
    return Springs(axis, np.repeat(origin, 6, axis=1), slides, np.repeat(first_link, 6))


def link_turns(robot: Robot) -> Floats:
    """(n + 1, 3, 3) link frames seen from the joint frame (or flange) at which each link ends."""
    start = forward(robot, np.zeros((1, robot.n)))
    ends = np.concatenate([start.rotation[0], start.flange_rotation])
    turns: Floats = ends.swapaxes(1, 2) @ robot.link_rotations
    return turns


def screws(springs: Springs) -> Floats:
    """Motion of the flange per unit of each spring: of its point at the base origin, then its turn, (V, 6, s)."""
    slides = springs.slides[:, None]
    linear = np.where(slides, springs.axis, cross(springs.origin, springs.axis))
    turning = np.where(slides, 0.0, springs.axis)
    return np.concatenate([linear.swapaxes(1, 2), turning.swapaxes(1, 2)], axis=1)


def carry(screws: Floats, points: Floats) -> Floats:
    """Motion of points (V, M, 3) by screws (V, 6, s), ``v + w x p`` -> (V, M, 3, s)."""
    v, w, p = screws[:, None, :3], screws[:, None, 3:], points[..., None]
    moved = np.empty((*points.shape, screws.shape[2]))
    for x, (y, z) in enumerate(((1, 2), (2, 0), (0, 1))):
        moved[:, :, x] = v[:, :, x] + w[:, :, y] * p[:, :, z] - w[:, :, z] * p[:, :, y]
    return moved


def motion(springs: Springs, points: Floats) -> Floats:
    """``D``: motion of points (V, M, 3) per unit of each spring -> (V, M, s, 3), m per rad or m per m."""
    return np.swapaxes(carry(screws(springs), points), 2, 3)


def load_torque(springs: Springs, point: Floats, force: Floats, moment: Floats) -> Floats:
    """``t``: torque (Nm) or force (N) of a wrench on each spring.

    Args:
        springs: Springs of the shots (S poses).
        point: (S, 3) where the wrench acts, base frame, m.
        force: (S, 3) base frame, N.
        moment: (S, 3) base frame, Nm, about ``point``.

    Returns:
        (S, s).
    """
    arm = point[:, None] - springs.origin
    total = cross(arm, force[:, None]) + moment[:, None]
    turning: Floats = np.einsum("vsi,vsi->vs", springs.axis, total)
    if not springs.slides.any():
        return turning
    sliding: Floats = np.einsum("vsi,vi->vs", springs.axis, force)
    return np.where(springs.slides, sliding, turning)


def self_weight_torque(springs: Springs, frames: Frames) -> Floats:
    """Torque or force of the link weights and the tool on each spring, (V, s).

    Zero contribution where a mass is unknown; whether that is acceptable is the caller's decision
    (`identify` then analyses differences only).
    """
    weight, arm = carried(springs, frames)
    if not weight.any():
        return np.zeros(springs.axis.shape[:2])
    g = frames.robot.gravity_base
    turning = np.einsum("vsi,vsi->vs", springs.axis, cross(arm, g))
    return np.where(springs.slides, weight * (springs.axis @ g), turning)


def carried(springs: Springs, frames: Frames) -> tuple[Floats, Floats]:
    """Mass that each spring carries (s,), kg, and its first moment about the spring's origin (V, s, 3), kg m.

    Links of unknown mass count nothing.
    """
    robot = frames.robot
    masses = np.append(np.where(np.isfinite(robot.masses), robot.masses, 0.0), robot.tool_mass)
    if not masses.any():
        return np.zeros(springs.axis.shape[1]), np.zeros_like(springs.axis)
    centres = np.concatenate([frames.centre, frames.point(robot.tool_centre)[:, None]], axis=1)
    above = np.cumsum(masses[::-1])[::-1]
    moments = np.cumsum((masses[:, None] * centres)[:, ::-1], axis=1)[:, ::-1]
    weight = above[springs.first_link]
    return weight, moments[:, springs.first_link] - weight[:, None] * springs.origin


def cross(a: Floats, b: Floats) -> Floats:
    """Cross product over the last axis, several times faster than numpy's general one."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
