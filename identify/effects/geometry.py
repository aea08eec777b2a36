"""Errors of the robot's geometry: zero offsets, link lengths, twists of the axes.

Each joint frame is displaced in its own coordinates by

    T' = T  Q Tx Ty Tz Rx Ry Rz Q'      (Q turns x onto the common normal with the axis before)

with the parameters that are independent for a turning joint after a turning joint: ``offset`` (about
its own axis), ``a`` and ``alpha`` (along and about the common normal) and ``d`` (along its own axis), or
``beta`` (about the third axis) instead of ``d`` where the two axes are parallel. This is the modified
Denavit-Hartenberg set with Hayati's extra angle (Hayati 1983; Hayati and Mirmirani 1985), which is
complete and continuous at parallel axes. The first joint and joints next to a sliding one carry all
six (``x, y, d, rx, ry, offset``), and the flange too where the markers are taken as exact; what is
then redundant is found by rank and reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene
from identify.effects.places import joint_places
from identify.robot import Robot
from identify.springs import cross
from identify.units import SI_OF

__all__ = ["geometry"]

LIMIT = 1.0  # mrad and mm: twice a usual error; knowing it worse than this says nothing and bends the fit
PLAUSIBLE = 5.0  # mrad and mm: ten times a usual error
PARALLEL = 0.1  # axes closer than this angle (rad) take beta instead of d
_STEPS = ("tx", "ty", "tz", "rx", "ry", "rz")  # order of the elementary displacements
_FULL = {"tx": "x", "ty": "y", "tz": "d", "rx": "rx", "ry": "ry", "rz": "offset"}
_FLANGE = {"tx": "x", "ty": "y", "tz": "z", "rx": "rx", "ry": "ry", "rz": "rz"}
_CROSSING = {"tx": "a", "tz": "d", "rx": "alpha", "rz": "offset"}
_ALONGSIDE = {"tx": "a", "rx": "alpha", "ry": "beta", "rz": "offset"}


@dataclass(frozen=True, eq=False)
class _Slot:
    """The displacement of one frame: which of the six steps are parameters, and the turn ``Q`` (3, 3)."""

    frame: int
    names: dict[str, str]
    turn: Floats


def geometry(binding: Binding) -> Effect:
    """Geometric errors of the joint frames (and of the flange, where marker positions are exact).

    Parameters ``geometry.j<i>.<component>`` and ``geometry.flange.<component>``, mm and mrad. Typical:
    0.1 to 1 mrad and 0.1 to 1 mm; gravity deflection is evaluated on the displaced geometry.

    Args:
        binding: Robot and places ``j1 ... jn``.
    """
    robot = binding.robot
    slots = [_slot(robot, joint) for joint in joint_places("geometry", robot, binding.where)]
    if binding.flange and not binding.where:
        slots.append(_Slot(robot.n, _FLANGE, np.eye(3)))
    steps = [(slot, step) for slot in slots for step in _STEPS if step in slot.names]
    parameters = tuple(_parameter(robot, slot, step) for slot, step in steps)
    scale = np.array([parameter.scale for parameter in parameters])

    def grouped(values: Floats) -> list[dict[str, float]]:
        sizes = iter(values * scale)
        return [{step: next(sizes) for step in _STEPS if step in slot.names} for slot in slots]

    def adjust(base: Robot, values: Floats) -> Robot:
        placements = base.placements.copy()
        for slot, sizes in zip(slots, grouped(values), strict=True):
            placements[slot.frame] = placements[slot.frame] @ _displacement(slot.turn, sizes)
        return replace(base, placements=placements)

    def derivative(scene: Scene, values: Floats) -> Floats:
        columns = np.empty((len(scene.point), 3, len(steps)))
        column = 0
        pose = scene.row_pose
        fixed, turning = scene.on_base, np.flatnonzero(scene.turning)
        for slot, sizes in zip(slots, grouped(values), strict=True):
            rotation, origin = _frame(scene, slot.frame)
            arm = scene.point - origin[pose]
            for step, direction in _directions(slot, sizes).items():
                axis = (rotation @ direction)[pose]
                columns[:, :, column] = axis if step[0] == "t" else cross(axis, arm)
                columns[turning, :, column] = 0.0 if step[0] == "t" else axis[turning]
                column += 1
        columns[fixed] = 0.0
        columns *= scale
        return columns

    def displacement(scene: Scene, values: Floats) -> Floats:
        return np.zeros_like(scene.point)  # the scene is already built on the adjusted robot

    def why_zero(parameter: int) -> str:
        return "no reading in these data depends on it (changes between loads hide geometry)"

    return Effect("geometry", parameters, displacement, derivative, why_zero, yields=False, adjust=adjust)


def _slot(robot: Robot, joint: int) -> _Slot:
    """Parameters and common normal of one joint frame."""
    if joint == 0 or robot.prismatic[joint] or robot.prismatic[joint - 1]:
        return _Slot(joint, _FULL, np.eye(3))
    placement = robot.placements[joint]
    before, z = placement[2, :3], np.array([0.0, 0.0, 1.0])  # both axes in this joint's frame
    normal = np.cross(before, z)
    alongside = bool(np.linalg.norm(normal) < PARALLEL)
    if alongside:
        normal = placement[:3, :3].T @ placement[:3, 3]
        normal[2] = 0.0
    if np.linalg.norm(normal) < 1e-9:  # one line: any normal will do
        normal = np.array([1.0, 0.0, 0.0])
    x = normal / np.linalg.norm(normal)
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    return _Slot(joint, _ALONGSIDE if alongside else _CROSSING, turn)


def _parameter(robot: Robot, slot: _Slot, step: str) -> Parameter:
    """The parameter of one elementary displacement."""
    place = f"j{slot.frame + 1}" if slot.frame < robot.n else "flange"
    unit = "mm" if step[0] == "t" else "mrad"
    return Parameter(
        f"geometry.{place}.{slot.names[step]}", unit, SI_OF[unit], limit=LIMIT, plausible=PLAUSIBLE, typical=0.5
    )


def _elementary(step: str, size: float) -> Floats:
    """One translation along or rotation about x, y or z, (4, 4)."""
    matrix = np.eye(4)
    axis = "xyz".index(step[1])
    if step[0] == "t":
        matrix[axis, 3] = size
        return matrix
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(size), np.sin(size)
    matrix[[i, j, i, j], [i, j, j, i]] = c, c, -s, s
    return matrix


def _displacement(turn: Floats, sizes: dict[str, float]) -> Floats:
    """``Q Tx Ty Tz Rx Ry Rz Q'``, (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    for step, size in sizes.items():
        matrix = matrix @ _elementary(step, size)
    back = np.eye(4)
    back[:3, :3] = turn.T
    moved: Floats = matrix @ back
    return moved


def _directions(slot: _Slot, sizes: dict[str, float]) -> dict[str, Floats]:
    """Direction of each elementary step in the displaced frame: what follows it turns it back."""
    directions = {}
    after = np.eye(3)
    for step in reversed(list(sizes)):
        unit = np.eye(3)["xyz".index(step[1])]
        directions[step] = slot.turn @ after.T @ unit
        after = _elementary(step, sizes[step])[:3, :3] @ after
    return dict(reversed(directions.items()))


def _frame(scene: Scene, frame: int) -> tuple[Floats, Floats]:
    """Rotation (C, 3, 3) and origin (C, 3) of a joint frame or the flange."""
    frames = scene.frames
    if frame == frames.robot.n:
        return frames.flange_rotation, frames.flange_origin
    return frames.rotation[:, frame], frames.origin[:, frame]
