"""Two arms whose tool points meet: how drill and board move against each other, and what the wrist sensors read.

The joints of both arms are counted once: the shared ones first, then those of the arm with the drill, then those of
the arm with the board. The shared joints feel the torques of both arms and move both tools.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats, frozen, skew
from identify.errors import InputError
from identify.kinematics import Frames, forward, jacobian
from identify.robot import Robot
from identify.units import MM

__all__ = ["Arm", "Facing", "across", "face"]

_SAME = 1e-9  # shared joints, bases and gravity of the two arms agree up to this (m, rad, m/s^2; compliances: relative)
_UNIT = 1e-6  # the feed direction has length 1 up to this
_MEET = 1.0 * MM  # tool points further apart than this do not meet


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm in the pose in which it works.

    Attributes:
        robot: The robot. What it carries as ``tool_mass`` at ``tool_centre`` hangs on its flange all the time.
        joints: (n,) joint values, rad, or m where a joint slides.
        compliance: (n,) true joint compliances, rad/Nm, or m/N where a joint slides; 0 is a rigid joint.
        tool: (3,) drill tip, or the place on the board where it meets the drill; flange frame, m.
    """

    robot: Robot
    joints: Floats
    compliance: Floats
    tool: Floats

    def __post_init__(self) -> None:
        """Check shapes and values, and make the arrays read-only.

        Raises:
            InputError: A wrong shape, a number that is not finite, or a negative compliance.
        """
        for key, size in (("joints", self.robot.n), ("compliance", self.robot.n), ("tool", 3)):
            array = frozen(getattr(self, key))
            if array.shape != (size,) or not np.isfinite(array).all():
                raise InputError(
                    f"{key} of {self.robot.name} = {array.tolist()}: {size} finite numbers in a row expected"
                )
            object.__setattr__(self, key, array)
        if (self.compliance < 0.0).any():
            raise InputError(f"compliance of {self.robot.name} = {self.compliance.tolist()}: none may be negative")


@dataclass(frozen=True, eq=False)
class Facing:
    """Two arms at work on one another; m joints in all, base frame.

    Attributes:
        drill: The arm with the drill.
        board: The arm with the board.
        shared: Number of first joints that are the same in both arms.
        feed: (3,) unit vector along which the drill moves into the board.
        point: (3,) where they meet, m.
        jacobian: (6, m) motion of the drill tip against the board, m, and its turn, rad, per joint.
        compliance: (m,) true joint compliances, rad/Nm or m/N.
        weight: (m,) torque, Nm, or force, N, of the hung tools on each joint.
        reading: (12, 6) what the sensors of drill and board read per wrench on the drill tip: force, N, and moment, Nm,
            about the flange origin, each in its flange frame.
        torque: (m, 12) torque of each joint per reading.
    """

    drill: Arm
    board: Arm
    shared: int
    feed: Floats
    point: Floats
    jacobian: Floats
    compliance: Floats
    weight: Floats
    reading: Floats
    torque: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("feed", "point", "jacobian", "compliance", "weight", "reading", "torque"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    def motion_per_wrench(self, compliance: ArrayLike) -> Floats:
        """Motion of drill against board per wrench on the drill tip (6, 6) for joint compliances (m,)."""
        found: Floats = self.jacobian * np.asarray(compliance, dtype=np.float64) @ self.jacobian.T
        return found

    def joined(self, drill: ArrayLike, board: ArrayLike) -> Floats:
        """One number a joint (m,) from one a joint of each arm (n,); nan is unknown.

        Two numbers of a shared joint are averaged; one that is known stands alone.

        Raises:
            InputError: Another number of joints.
        """
        own = [_numbers(values, arm) for values, arm in ((drill, self.drill), (board, self.board))]
        both = np.stack([values[: self.shared] for values in own])
        known = np.isfinite(both)
        total = np.where(known, both, 0.0).sum(axis=0)
        mean = np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
        return np.concatenate([mean, *(values[self.shared :] for values in own)])


def _numbers(values: ArrayLike, arm: Arm) -> Floats:
    """(n,) one number a joint of the arm."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (arm.robot.n,):
        raise InputError(
            f"array of shape {array.shape} for {arm.robot.name}: one number for each of {arm.robot.n} joints"
        )
    return array


def face(drill: Arm, board: Arm, feed: ArrayLike, *, shared: int = 1) -> Facing:
    """Put the arm with the drill in front of the arm with the board.

    Everything is taken at the drill tip, where drill and board touch: their wrenches on each other are equal and
    opposite there, and the shared joints feel nothing of them.

    Args:
        drill: Arm with the drill, its tip where drilling starts.
        board: Arm with the board.
        feed: (3,) unit vector, base frame, along which the drill moves into the board.
        shared: Number of first joints that are the same in both arms.

    Raises:
        InputError: A feed direction that is no unit vector; shared joints, their compliances, or gravity that
            differ between the arms; tool points more than 1 mm apart.
    """
    direction = np.asarray(feed, dtype=np.float64)
    if direction.shape != (3,) or not abs(np.linalg.norm(direction) - 1.0) <= _UNIT:
        raise InputError(f"feed direction {direction.tolist()}: a unit vector of 3 numbers, base frame, expected")
    _check_shared(drill, board, shared)
    frames = [forward(arm.robot, arm.joints) for arm in (drill, board)]
    point, other = (found.point(arm.tool) for found, arm in zip(frames, (drill, board), strict=True))
    apart = float(np.linalg.norm(other - point))
    if apart > _MEET:
        raise InputError(
            f"the tool points are {apart / MM:.3g} mm apart: at most {_MEET / MM:g} mm; "
            "change joint values or tool points"
        )
    sides = [_side(found, point) for found in frames]
    weights = [_tool_weight(found) for found in frames]
    return Facing(
        drill, board, shared, direction, point[0],
        jacobian=_joined_columns(sides[0][0], -sides[1][0], shared),
        compliance=np.concatenate([drill.compliance, board.compliance[shared:]]),
        weight=_joined_columns(weights[0], weights[1], shared)[0],
        reading=np.concatenate([sides[0][1], -sides[1][1]]),
        torque=np.concatenate(
            [_joined_columns(sides[0][2], np.zeros_like(sides[1][2]), shared),
             _joined_columns(np.zeros_like(sides[0][2]), sides[1][2], shared)]
        ).T,
    )  # fmt: skip


def _check_shared(drill: Arm, board: Arm, shared: int) -> None:
    """Both arms stand on the same first joints, in the same state, under the same gravity."""
    most = min(drill.robot.n, board.robot.n) - 1
    if not 0 <= shared <= most:
        raise InputError(f"shared = {shared}: 0 to {most}; each arm needs a joint of its own")
    if not np.allclose(drill.robot.gravity_base, board.robot.gravity_base, rtol=0.0, atol=_SAME):
        raise InputError("gravity in the base frame differs between the two robots; they stand on one base")
    for key in ("prismatic", "placements"):
        first, second = (getattr(arm.robot, key)[:shared] for arm in (drill, board))
        if not np.allclose(first, second, rtol=0.0, atol=_SAME):
            raise InputError(
                f"{key} of the {shared} shared joints differ between the two robots: they are one and the same"
            )
    for key, absolute, relative in (("joints", _SAME, 0.0), ("compliance", 0.0, _SAME)):
        first, second = (getattr(arm, key)[:shared] for arm in (drill, board))
        if not np.allclose(first, second, rtol=relative, atol=absolute):
            raise InputError(
                f"{key} of shared joints: {first.tolist()} with the drill, {second.tolist()} with the board; "
                "a shared joint has one value, state it for both arms"
            )


def _side(frames: Frames, point: Floats) -> tuple[Floats, Floats, Floats]:
    """Of one arm: Jacobian (6, n) at the point, reading (6, 6) per wrench there, reading to torques (6, n)."""
    turn, arm = frames.flange_rotation[0].T, point[0] - frames.flange_origin[0]
    reading = np.block([[turn, np.zeros((3, 3))], [turn @ skew(arm), turn]])
    at_flange = jacobian(frames, frames.flange_origin)[0]
    return jacobian(frames, point)[0], reading, np.concatenate([turn @ at_flange[:3], turn @ at_flange[3:]])


def _tool_weight(frames: Frames) -> Floats:
    """Torque of the hung tool on each joint (1, n), Nm, or N where it slides."""
    robot = frames.robot
    reach = jacobian(frames, frames.point(robot.tool_centre))[0, :3]
    torque: Floats = robot.tool_mass * robot.gravity_base @ reach
    return torque[None]


def _joined_columns(drill: Floats, board: Floats, shared: int) -> Floats:
    """Columns per joint of both arms (k, n) -> (k, m): those of shared joints added."""
    both = drill[:, :shared] + board[:, :shared]
    return np.concatenate([both, drill[:, shared:], board[:, shared:]], axis=1)


def across(direction: Floats) -> Floats:
    """Projector (3, 3) on the plane across a unit vector (3,)."""
    projector: Floats = np.eye(3) - np.outer(direction, direction)
    return projector
