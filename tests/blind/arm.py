"""A serial arm as a chain of 4x4 matrices, for many joint values at once."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True, eq=False)
class Arm:
    """Fixed dimensions: offset (7, 3) from each moved frame to the next joint (the last to the flange), axis (6, 3),
    mass (6,) and centre (6, 3) of the links in their moved frames, tool; shift (7, 6) displaces the joint frames."""

    offset: np.ndarray
    axis: np.ndarray
    mass: np.ndarray
    centre: np.ndarray
    tool_mass: float = 0.0
    tool_centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    shift: np.ndarray = field(default_factory=lambda: np.zeros((7, 6)))


class Frames(NamedTuple):
    """Base-frame quantities of N shots."""

    moved: np.ndarray  # (N, 6, 4, 4)
    flange: np.ndarray  # (N, 4, 4)
    origin: np.ndarray  # (N, 6, 3)
    axis: np.ndarray  # (N, 6, 3)
    spring_origin: np.ndarray  # (N, 8, 3): base, column, ends of links 1 ... 6
    spring_turn: np.ndarray  # (N, 8, 3, 3)


def cross(a, b):
    """Cross product over the last axis with broadcasting."""
    a, b = np.broadcast_arrays(a, b)
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def rotation(vector):
    """Rotation matrix of a rotation vector (..., 3)."""
    vector = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = np.zeros((*vector.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -vector[..., 2], vector[..., 1], -vector[..., 0]
    k = k - np.swapaxes(k, -1, -2)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.eye(3) + first * k + second * (k @ k)


def rigid(turn, shift):
    """(..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    turn, shift = np.asarray(turn), np.asarray(shift)
    shape = np.broadcast_shapes(turn.shape[:-2], shift.shape[:-1])
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = turn, shift, 1.0
    return matrix


def point_of(frames, local):
    """(N, k, 3) of local points (k, 3) or (N, k, 3) in frames (N, 4, 4)."""
    return (
        np.einsum("nab,...kb->nka" if local.ndim == 2 else "nab,nkb->nka", frames[:, :3, :3], local)
        + frames[:, None, :3, 3]
    )


def place_frames(arm: Arm, q: np.ndarray, stretch: np.ndarray) -> Frames:
    """All frames at joint values q (N, 6); stretch (N, 7) lengthens the links."""
    count = len(q)
    here = np.broadcast_to(np.eye(4), (count, 4, 4))
    moved, ends = [], []
    for joint in range(7):
        ends.append(here @ rigid(np.eye(3), arm.offset[joint] * stretch[:, joint, None]))
        here = ends[-1] @ rigid(rotation(arm.shift[joint, 3:]), arm.shift[joint, :3])
        if joint < 6:
            here = here @ rigid(rotation(q[:, joint, None] * arm.axis[joint]), np.zeros(3))
            moved.append(here)
    moved = np.stack(moved, axis=1)
    axis = np.einsum("njab,jb->nja", moved[:, :, :3, :3], arm.axis)
    ends = np.stack(ends, axis=1)
    spring_origin = np.concatenate([ends[:, :1, :3, 3], ends[:, :, :3, 3]], axis=1)
    spring_turn = np.concatenate([ends[:, :1, :3, :3], moved[:, :1, :3, :3], moved[:, :, :3, :3]], axis=1)
    return Frames(moved, here, moved[:, :, :3, 3], axis, spring_origin, spring_turn)


def bodies(arm: Arm, frames: Frames):
    """Masses (7,) of the links and the tool, and their centres (N, 7, 3)."""
    centres = np.einsum("njab,jb->nja", frames.moved[:, :, :3, :3], arm.centre) + frames.moved[:, :, :3, 3]
    tool = point_of(frames.flange, arm.tool_centre[None])
    return np.append(arm.mass, arm.tool_mass), np.concatenate([centres, tool], axis=1)
