"""Poses of which each has load values of its own, for checking many loads without pairing each with every pose."""

from __future__ import annotations

from dataclasses import dataclass

from identify.arrays import Floats, Ints
from identify.kinematics import Frames, forward
from identify.robot import Robot

__all__ = ["Hung", "HungFrames", "attach_points", "masses", "placed"]


@dataclass(frozen=True, eq=False)
class Hung:
    """Values that take the place of those of a study's L loads, pose by pose.

    Attributes:
        mass: (V, L) kg.
        attach: (V, L, 3) flange frame, m.
    """

    mass: Floats
    attach: Floats

    def taken(self, poses: Ints | slice) -> Hung:
        """Those of some of the poses."""
        return Hung(self.mass[poses], self.attach[poses])


@dataclass(frozen=True, eq=False)
class HungFrames(Frames):
    """Placements of V poses, and what hangs there.

    Attributes:
        hung: The values of the loads.
    """

    hung: Hung

    def taken(self, poses: Ints) -> HungFrames:
        """Some of the poses, by their indices (W,)."""
        return _with(super().taken(poses), self.hung.taken(poses))


def placed(robot: Robot, q: Floats, hung: Hung | None) -> Frames:
    """Frames of joint values ``q`` (V, n), with loads of their own where ``hung`` gives them."""
    frames = forward(robot, q)
    return frames if hung is None else _with(frames, hung)


def attach_points(frames: Frames, stated: Floats) -> Floats:
    """Attach points, flange frame, m: those of each pose (V, L, 3), or the ``stated`` ones (L, 3) as (1, L, 3)."""
    return frames.hung.attach if isinstance(frames, HungFrames) else stated[None]


def masses(frames: Frames, stated: Floats) -> Floats:
    """Hung masses, kg: those of each pose (V, L), or the ``stated`` ones (L,) as (1, L)."""
    return frames.hung.mass if isinstance(frames, HungFrames) else stated[None]


def _with(frames: Frames, hung: Hung) -> HungFrames:
    """Frames with what hangs there."""
    arrays = (frames.rotation, frames.origin, frames.centre, frames.flange_rotation, frames.flange_origin)
    return HungFrames(frames.robot, *arrays, hung=hung)
