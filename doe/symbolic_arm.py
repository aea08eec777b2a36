"""One robot in one pose in CasADi: the chain of `identify.kinematics` and the springs of `identify.springs`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from identify.arrays import Floats, Ints
from identify.effects.base import SpringSet
from identify.loads import LoadCase
from identify.robot import Robot

__all__ = [
    "SX",
    "Chain",
    "Spring",
    "chain",
    "heights_function",
    "load_table",
    "load_torque",
    "motion_of",
    "springs_of",
    "turning_of",
    "vector",
    "weight_torque",
]

SX = Any  # CasADi is not typed


@dataclass(frozen=True, eq=False)
class Chain:
    """Placements of one robot in one pose, base frame, m.

    Attributes:
        robot: The robot.
        rotation: n (3, 3) joint frames before the joint moves; column 2 is the joint axis.
        origin: n (3, 1) their origins.
        centre: n (3, 1) centres of mass of the moved links (frame origin where unknown).
        flange_rotation: (3, 3).
        flange_origin: (3, 1).
        placements: n + 1 (4, 4) that it was made of.
    """

    robot: Robot
    rotation: tuple[SX, ...]
    origin: tuple[SX, ...]
    centre: tuple[SX, ...]
    flange_rotation: SX
    flange_origin: SX
    placements: list[SX]

    def point(self, local: Any) -> SX:
        """A point (3,) of the flange frame in the base frame, (3, 1)."""
        return self.flange_origin + self.flange_rotation @ local


def chain(robot: Robot, q: SX, placements: list[SX] | None = None) -> Chain:
    """Forward kinematics of ``robot`` for symbolic joint values ``q`` (n, 1).

    Args:
        robot: The robot.
        q: Its joint values, rad or m.
        placements: n + 1 placements (4, 4) in place of the robot's.
    """
    centres = np.where(np.isfinite(robot.centres), robot.centres, 0.0)
    rotation, origin = ca.SX.eye(3), ca.SX.zeros(3)
    rotations, origins, moved = [], [], []
    placements = placements or [ca.SX(placement) for placement in robot.placements]
    for i, placement in enumerate(placements):
        origin = origin + rotation @ placement[:3, 3]
        rotation = rotation @ placement[:3, :3]
        if i == robot.n:
            break
        rotations.append(rotation)
        origins.append(origin)
        if robot.prismatic[i]:
            origin = origin + rotation[:, 2] * q[i]
        else:
            c, s, x, y = ca.cos(q[i]), ca.sin(q[i]), rotation[:, 0], rotation[:, 1]
            rotation = ca.horzcat(c * x + s * y, c * y - s * x, rotation[:, 2])
        moved.append(origin + rotation @ ca.SX(centres[i]))
    return Chain(robot, tuple(rotations), tuple(origins), tuple(moved), rotation, origin, placements)


def load_table(robot: Robot, loads: tuple[LoadCase, ...]) -> Floats:
    """Numbers of each load that the symbolic torque needs, (loads, 15).

    Returns:
        Attach point (flange frame, m), then force (N) and moment (Nm) fixed in the base frame, then
        force and moment that turn with the flange.
    """
    rows = np.zeros((len(loads), 15))
    for row, load in zip(rows, loads, strict=True):
        turn = np.eye(3) if load.in_flange else robot.world_R_base.T
        start = 9 if load.in_flange else 3
        row[:3] = load.attach
        row[start : start + 3] = turn @ load.force
        row[start + 3 : start + 6] = turn @ load.moment
        row[3:6] += load.mass * robot.gravity_base
    return rows


@dataclass(frozen=True, eq=False)
class Spring:
    """One elementary spring; see `identify.springs.Springs`."""

    axis: SX
    origin: SX
    slides: bool
    first_link: int


def springs_of(arm: Chain, kind: SpringSet) -> list[Spring]:
    """The springs of a set, in the order of `identify.springs`."""
    robot = arm.robot
    if kind == "joints":
        parts = zip(arm.rotation, arm.origin, robot.prismatic, range(robot.n), strict=True)
        return [Spring(rotation[:, 2], origin, bool(slides), i) for rotation, origin, slides, i in parts]
    rotations, origins = [*arm.rotation, arm.flange_rotation], [*arm.origin, arm.flange_origin]
    turns = _link_turns(arm)
    if kind == "links":
        parts = zip(rotations, turns, origins, range(robot.n + 1), strict=True)
        return [spring for rotation, turn, *rest in parts for spring in _six(rotation @ turn, *rest)]
    column = rotations[1] @ arm.placements[1][:3, :3].T
    foot = origins[1] - column @ arm.placements[1][:3, 3]
    return [*_six(rotations[0] @ turns[0], origins[0], 0), *_six(column @ turns[0], foot, 0)]


def _link_turns(arm: Chain) -> list[SX]:
    """The (3, 3) link frames seen from where each of the n + 1 links ends; see `identify.springs.link_turns`."""
    start = chain(arm.robot, ca.SX(arm.robot.n, 1), arm.placements)
    ends = [*start.rotation, start.flange_rotation]
    turns = [end.T @ ca.SX(turn) for end, turn in zip(ends, arm.robot.link_rotations, strict=True)]
    return [_matrix(np.array(ca.DM(turn))) if turn.is_constant() else turn for turn in turns]


def _six(rotation: SX, origin: SX, first_link: int) -> list[Spring]:
    """x, y, z sliding, then x, y, z turning."""
    axes = ca.horzsplit(rotation)
    return [Spring(axis, origin, slides, first_link) for slides in (True, False) for axis in axes]


def motion_of(springs: list[Spring], point: SX) -> SX:
    """``D``: motion of a point per unit of each spring, (3, s)."""
    columns = [s.axis if s.slides else ca.cross(s.axis, point - s.origin) for s in springs]
    return ca.horzcat(*columns)


def turning_of(springs: list[Spring]) -> SX:
    """Turn of the flange per unit of each spring, (3, s)."""
    return ca.horzcat(*(ca.SX(3, 1) if s.slides else s.axis for s in springs))


def load_torque(arm: Chain, springs: list[Spring], load: SX) -> SX:
    """``t``: torque or force of one row of `load_table` on each spring, (s, 1)."""
    turn = arm.flange_rotation
    force, moment = load[3:6] + turn @ load[9:12], load[6:9] + turn @ load[12:15]
    return motion_of(springs, arm.point(load[:3])).T @ force + turning_of(springs).T @ moment


def weight_torque(arm: Chain, springs: list[Spring]) -> SX:
    """Torque or force of the weight of links and tool on each spring, (s, 1)."""
    robot = arm.robot
    masses = np.where(np.isfinite(robot.masses), robot.masses, 0.0)
    carried, moment = [robot.tool_mass], [robot.tool_mass * arm.point(ca.SX(robot.tool_centre))]
    for mass, centre in zip(masses[::-1], arm.centre[::-1], strict=True):
        carried.insert(0, carried[0] + mass)
        moment.insert(0, moment[0] + mass * centre)
    gravity = ca.SX(robot.gravity_base)
    torques = []
    for s in springs:
        weight = carried[s.first_link]
        lever = moment[s.first_link] - weight * s.origin
        torques.append(ca.dot(s.axis, weight * gravity if s.slides else ca.cross(lever, gravity)))
    return ca.vertcat(*torques)


def heights_function(robot: Robot, joints: Ints, points: int) -> Any:
    """World heights of joint origins and of points of the flange, from the base origin, m.

    Args:
        robot: The robot.
        joints: (J,) joints whose origin counts.
        points: Number P of points of the flange.

    Returns:
        ``(q (n, 1), local (3, P)) -> (J + P, 1)``, with ``local`` in the flange frame, m; the same as
        `doe.feasible.FloorPoints.heights`.
    """
    q, local = ca.SX.sym("q", robot.n), ca.SX.sym("local", 3, points)
    arm = chain(robot, q)
    moving = [*(arm.origin[joint] for joint in joints), *(arm.point(point) for point in ca.horzsplit(local))]
    up = vector(robot.world_R_base[2])
    heights = ca.vertcat(*(ca.dot(up, point) for point in moving))
    return ca.Function("heights", [q, local], [ca.densify(heights)], {"cse": True})


def vector(values: Floats) -> SX:
    """A constant column; zeros become structural."""
    return ca.sparsify(ca.SX(values))


def _matrix(values: Floats) -> SX:
    """A constant matrix; zeros and rounding noise become structural."""
    return ca.sparsify(ca.SX(np.where(np.abs(values) < 1e-15, 0.0, values)))
