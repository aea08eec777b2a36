"""What the arm may carry: payload, payload diagram, rated wrist moments and joint torques."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from doe.hung_frames import attach_points, masses
from identify.arrays import Floats, frozen
from identify.kinematics import Frames
from identify.springs import Springs, joint_springs, load_torque, self_weight_torque
from identify.study import Study

__all__ = ["Statics", "allowed_mass", "carried", "overload", "statics"]

_ROUNDING = 1e-9  # relative: a load at a limit is allowed
_PARTS = 16  # of a range of masses, where its lower end is too heavy
_TURNS = 80  # to the limit at most; one or two are usual
_INSIDE = 1e-10  # relative: how far below the limit the largest mass stays


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
        return self.excess(frames) > 0.0

    def excess(self, frames: Frames) -> Floats:
        """(N, L) by which share of its limit the worst static moment or torque is too large; not above 0 if none is.

        Limits below 1 Nm or 1 N count as 1.
        """
        joints = joint_springs(frames)
        tool = self._weight(joints, frames, frames.robot.tool_centre, frames.robot.tool_mass)
        weight = self_weight_torque(joints, frames)
        over = []
        for load in _load_torques(self.study, joints, frames):
            both = [_share(np.abs(tool + load), self.wrist), _share(np.abs(weight + load), self.torque)]
            over.append(np.maximum(*both).max(axis=1))
        return np.stack(over, axis=1)

    def overload(self, frames: Frames) -> Floats:
        """(N, L) by which share of what is allowed a load is too heavy; not above 0 where it is not."""
        loads, count = self.study.loads, len(frames.origin)
        mass = masses(frames, np.array([load.mass for load in loads]))
        attach = attach_points(frames, np.array([load.attach for load in loads]))
        return np.broadcast_to(overload(self.study, mass, attach), (count, len(loads)))

    @staticmethod
    def _weight(joints: Springs, frames: Frames, centre: Floats, mass: float) -> Floats:
        """(N, n) torque of one mass on the flange."""
        force = np.broadcast_to(mass * frames.robot.gravity_base, frames.flange_origin.shape)
        return load_torque(joints, frames.point(centre), force, np.zeros_like(force))


def _share(value: Floats, limit: Floats) -> Floats:
    """Share of their limits by which values of any shape exceed them; minus infinity where there is no limit."""
    known = np.isfinite(limit)
    highest = np.where(known, limit, 0.0)
    excess = (value - highest * (1.0 + _ROUNDING)) / np.maximum(highest, 1.0)
    return np.where(known, excess, -np.inf)


def _load_torques(study: Study, joints: Springs, frames: Frames) -> list[Floats]:
    """Torque or force (N, n) of each load of the study on the joints, Nm or N."""
    robot, found = study.robot, []
    attach = attach_points(frames, np.array([load.attach for load in study.loads]))
    mass = masses(frames, np.array([load.mass for load in study.loads]))
    for i, load in enumerate(study.loads):
        stated = [_in_base(frames, vector, load.in_flange) for vector in (load.force, load.moment)]
        point = frames.point(attach[0, i] if len(attach) == 1 else attach[:, i])
        found.append(load_torque(joints, point, stated[0] + mass[:, i, None] * robot.gravity_base, stated[1]))
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
    """(L,) True where rated payload and payload diagram allow a load of the study together with the tool."""
    loads = study.loads
    return overload(study, np.array([load.mass for load in loads]), np.array([load.attach for load in loads])) <= 0.0


def overload(study: Study, mass: Floats, attach: Floats) -> Floats:
    """By which share of what payload and payload diagram allow hung masses are too heavy together with the tool.

    The distance of the diagram is that of the common centre of tool and hung mass (at its attach point) from the
    flange origin. An unknown payload allows everything; an allowed mass below 1 kg counts as 1 kg.

    Args:
        study: The study.
        mass: (...) kg.
        attach: (..., 3) where they hang, flange frame, m.

    Returns:
        (...) not above 0 where allowed.
    """
    robot, diagram = study.robot, study.constraints.payload_diagram
    total = mass + robot.tool_mass
    limit = np.broadcast_to(robot.payload * study.constraints.payload_share, total.shape)
    if diagram is not None:
        moment = mass[..., None] * attach + robot.tool_mass * robot.tool_centre
        distance = np.linalg.norm(moment, axis=-1) / np.where(total > 0.0, total, 1.0)
        limit = np.fmin(limit, diagram.allowed(distance))  # an unknown payload is nan
    return _share(total, limit)


def allowed_mass(study: Study, attach: Floats, lower: Floats, upper: Floats) -> Floats:
    """The largest mass of a range that payload and payload diagram allow.

    Args:
        study: The study.
        attach: (m, 3) where it hangs, flange frame, m.
        lower: (m,) least masses, kg.
        upper: (m,) largest masses, kg.

    Returns:
        (m,) kg, allowed unless no mass of the range is; then the least one.
    """
    found = np.array(upper)
    rest = np.flatnonzero(overload(study, upper, attach) > 0.0)
    low, high, place = lower[rest], upper[rest], attach[rest]
    heavy = overload(study, low, place) > 0.0
    if heavy.any():  # with a tool further out, light loads may be too far out and heavier ones not
        low[heavy], high[heavy] = _bracket(study, place[heavy], low[heavy], high[heavy])
    found[rest] = _limit(lambda mass: overload(study, mass, place) + _INSIDE, low, high)
    return found


def _bracket(study: Study, attach: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """The heaviest mass (m,) of some that is allowed, and the next one; the least mass twice where none is."""
    share = np.linspace(0.0, 1.0, _PARTS + 1)
    tried = lower[:, None] + (upper - lower)[:, None] * share
    good = overload(study, tried, np.repeat(attach[:, None], len(share), axis=1)) <= 0.0
    last = (good * np.arange(len(share))).max(axis=1)
    row = np.arange(len(tried))
    return tried[row, last], np.where(good.any(axis=1), tried[row, np.minimum(last + 1, _PARTS)], lower)


def _limit(excess: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    """Where functions rise through zero between ``low`` (m,) and ``high`` (m,); ``low`` where they do not.

    Secants and halvings in turn: functions are nearly linear, but may jump where the diagram ends.
    """
    left, right = excess(low), excess(high)
    crossed = (left < 0.0) & (right > 0.0)
    at, value = low, left
    for step in range(_TURNS):
        share = np.where(crossed, -left / np.where(crossed, right - left, 1.0), 0.0) if step % 2 == 0 else 0.5
        at = low + share * (high - low)
        value = excess(at)
        if (np.abs(value[crossed]) < 0.1 * _INSIDE).all():
            break
        below = value < 0.0
        low, left = np.where(below, at, low), np.where(below, value, left)
        high, right = np.where(below, high, at), np.where(below, right, value)
    return np.where(crossed & (value < _INSIDE), np.maximum(at, low), low)
