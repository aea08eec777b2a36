"""The deflected arm: joints and springs as one serial chain of elementary motions, in the order of the chain.

A link end yields along x, y, z and then about x, y, z of its frame, one after the other (Pashkevich's virtual springs
in series). With n joints there are ``7 n + 12`` *coordinates*: link 0 (6), joint 1, column (6), link 1 (6), joint 2,
link 2 (6), ... joint n, link n (6). What coordinate r moves comes after it, springs of higher number included.
"""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects import SpringSet
from identify.kinematics import Frames
from identify.robot import Robot
from identify.springs import Springs, link_turns

__all__ = ["chain_index", "deflect"]

_COLUMN = 7  # first coordinate of the column


def chain_index(joints: int, springs: SpringSet) -> Ints:
    """Coordinates of a named set of springs of an arm with ``joints`` joints; link 0 is the first half of the foot."""
    own = [6, *range(19, 12 + 7 * joints, 7)]
    links = [range(6), *(range(start, start + 6) for start in range(13, 7 + 7 * joints, 7))]
    sets = {"joints": own, "links": [k for six in links for k in six], "base": [*range(6), *range(7, 13)]}
    return np.array(sets[springs], dtype=np.int64)


def deflect(robot: Robot, q: Floats, theta: Floats, active: Ints) -> tuple[Frames, Springs]:
    """The arm with some coordinates deflected, the others rigid.

    Args:
        robot: The robot.
        q: (S, n) joint values, rad or m.
        theta: (S, a) deflections, rad or m.
        active: (a,) their coordinates, ascending.

    Returns:
        Its frames, and the axes of the active coordinates as springs (S, a), base frame.
    """
    walk = _Walk(theta, active)
    count, n = len(q), robot.n
    turns = link_turns(robot)
    rotations, origins, centres = np.empty((count, n, 3, 3)), np.empty((count, n, 3)), np.empty((count, n, 3))
    local = np.where(np.isfinite(robot.centres), robot.centres, 0.0)
    ends, starts = chain_index(n, "links")[::6], chain_index(n, "joints")
    for i, placement in enumerate(robot.placements):
        walk.go(placement)
        walk.six(int(ends[i]), turns[i])
        if i == n:
            break
        rotations[:, i], origins[:, i] = walk.rotation, walk.origin
        walk.joint(int(starts[i]), q[:, i], slides=bool(robot.prismatic[i]))
        if i == 0:
            walk.six(_COLUMN, turns[0])
        centres[:, i] = walk.origin + walk.rotation @ local[i]
    frames = Frames(robot, rotations, origins, centres, walk.rotation, walk.origin)
    return frames, Springs(walk.axis, walk.place, _slides(robot)[active], _first_link(n)[active])


class _Walk:
    """Goes along the chain of all shots at once and notes the axes that it passes."""

    def __init__(self, theta: Floats, active: Ints) -> None:
        """Start at the base."""
        count = len(theta)
        self.rotation: Floats = np.broadcast_to(np.eye(3), (count, 3, 3))
        self.origin: Floats = np.zeros((count, 3))
        self.axis, self.place = np.empty((count, len(active), 3)), np.empty((count, len(active), 3))
        self._theta = theta
        self._slot = {int(coordinate): slot for slot, coordinate in enumerate(active)}

    def go(self, placement: Floats) -> None:
        """Along a rigid link."""
        self.origin = self.origin + self.rotation @ placement[:3, 3]
        self.rotation = self.rotation @ placement[:3, :3]

    def joint(self, coordinate: int, value: Floats, *, slides: bool) -> None:
        """Through a joint and its spring, which both move along or about z."""
        value = value + self._pass(coordinate, self.rotation[..., 2])
        if slides:
            self.origin = self.origin + self.rotation[..., 2] * value[:, None]
        else:
            self.rotation = self.rotation @ _turned(value, 2)

    def six(self, start: int, turn: Floats) -> None:
        """Through the six springs of a link end whose frame is turned by ``turn`` (3, 3)."""
        present = [k for k in range(6) if start + k in self._slot]
        if not present:
            return
        frame = self.rotation @ turn
        for k in present:
            axis = frame[..., k % 3]
            value = self._pass(start + k, axis)
            if k < 3:
                self.origin = self.origin + axis * value[:, None]
            else:
                frame = frame @ _turned(value, k - 3)
        self.rotation = frame @ turn.T

    def _pass(self, coordinate: int, axis: Floats) -> Floats:
        """Note an axis; the deflection of its spring, zero for rigid ones."""
        slot = self._slot.get(coordinate)
        if slot is None:
            return np.zeros(len(axis))
        self.axis[:, slot], self.place[:, slot] = axis, self.origin
        deflection: Floats = self._theta[:, slot]
        return deflection


def _turned(angle: Floats, about: int) -> Floats:
    """(S, 3, 3) turns about local axis 0, 1 or 2."""
    matrix = np.zeros((len(angle), 3, 3))
    first, second = (about + 1) % 3, (about + 2) % 3
    matrix[:, about, about] = 1.0
    matrix[:, first, first] = matrix[:, second, second] = np.cos(angle)
    matrix[:, second, first] = np.sin(angle)
    matrix[:, first, second] = -matrix[:, second, first]
    return matrix


def _slides(robot: Robot) -> np.ndarray:
    """(7 n + 12,) True for coordinates along an axis."""
    slides = np.zeros(7 * robot.n + 12, dtype=bool)
    six = np.arange(6) < 3
    slides[chain_index(robot.n, "links")] = np.tile(six, robot.n + 1)
    slides[_COLUMN : _COLUMN + 6] = six
    slides[chain_index(robot.n, "joints")] = robot.prismatic
    return slides


def _first_link(n: int) -> Ints:
    """(7 n + 12,) the coordinates carry the links ``first_link ... n - 1`` and the tool."""
    first = np.zeros(7 * n + 12, dtype=np.int64)
    first[chain_index(n, "links")] = np.repeat(np.arange(n + 1), 6)
    first[chain_index(n, "joints")] = np.arange(n)
    return first
