"""Dual quaternions from and to homogeneous matrices, rotations and translations; points carried by them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats
from identify.dual_quaternions.algebra import UNIT_TOLERANCE, components, joined, product, unit
from identify.errors import InputError

__all__ = ["from_matrix", "from_rotation", "placed", "rotation", "to_matrix", "transform", "translation"]


def placed(quaternion: ArrayLike, shift: ArrayLike) -> Floats:
    """``r + eps p r / 2`` (..., 8) from unit quaternions (..., 4) w, x, y, z and translations (..., 3), m.

    Raises:
        InputError: A quaternion is not unit, or a shape is wrong.
    """
    r, p = components(quaternion, 4, "quaternion"), components(shift, 3, "translation")
    turn, move = np.zeros((8, *r.shape[1:])), np.zeros((8, *p.shape[1:]))
    turn[:4] = r
    move[0], move[5:] = 1.0, 0.5 * p
    return product(joined(move), unit(joined(turn), "quaternion"))


def from_rotation(matrices: ArrayLike) -> Floats:
    """Unit quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Of the four ways to read a quaternion off a matrix the one with the largest divisor is taken (Shepperd 1978), so
    that no digits are lost at any angle.

    Raises:
        InputError: A matrix is no rotation.
    """
    m = np.asarray(matrices, dtype=np.float64)
    if m.ndim < 2 or m.shape[-2:] != (3, 3):
        raise InputError(f"rotation matrices of shape {m.shape}: (..., 3, 3) expected")
    off = np.abs(m @ m.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2))
    right_handed = (np.cross(m[..., 0, :], m[..., 1, :]) * m[..., 2, :]).sum(axis=-1) > 0.0
    wrong = ~((off <= UNIT_TOLERANCE) & right_handed)
    if wrong.any():
        where = np.argwhere(wrong)[0]
        raise InputError(
            f"matrix {where.tolist()} = {m[tuple(where)].tolist()} is no rotation: R R' differs from 1 by "
            f"{off[tuple(where)]:.3g} ({UNIT_TOLERANCE:g} allowed) or its determinant is not 1"
        )
    outer = np.empty((*m.shape[:-2], 4, 4))
    diagonal = np.einsum("...ii->...i", m)
    trace = diagonal.sum(axis=-1)
    outer[..., 0, 0] = 1.0 + trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        outer[..., 0, i + 1] = outer[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        outer[..., j + 1, k + 1] = outer[..., k + 1, j + 1] = m[..., j, k] + m[..., k, j]
        outer[..., i + 1, i + 1] = 1.0 + 2.0 * diagonal[..., i] - trace
    best = np.argmax(np.einsum("...ii->...i", outer), axis=-1)
    row = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    found: Floats = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.where(found[..., :1] < 0.0, -found, found)


def from_matrix(matrices: ArrayLike) -> Floats:
    """Unit dual quaternions (..., 8) of homogeneous matrices (..., 4, 4), translations in m.

    Raises:
        InputError: A matrix is no placement.
    """
    m = np.asarray(matrices, dtype=np.float64)
    if m.ndim < 2 or m.shape[-2:] != (4, 4):
        raise InputError(f"homogeneous matrices of shape {m.shape}: (..., 4, 4) expected")
    if not (np.abs(m[..., 3, :] - [0.0, 0.0, 0.0, 1.0]) <= UNIT_TOLERANCE).all():
        raise InputError(f"the last row of a homogeneous matrix must be 0, 0, 0, 1 within {UNIT_TOLERANCE:g}")
    return placed(from_rotation(m[..., :3, :3]), m[..., :3, 3])


def rotation(q: ArrayLike) -> Floats:
    """Rotation matrices (..., 3, 3) of unit dual quaternions (..., 8).

    Raises:
        InputError: One is not unit.
    """
    return _rotation(components(unit(q)))


def _rotation(parts: Floats) -> Floats:
    """(..., 3, 3) of components (8, ...)."""
    w, x, y, z = parts[:4]
    ww, xx, yy, zz = parts[:4] ** 2
    matrices = np.empty((*parts.shape[1:], 3, 3))
    matrices[..., 0, 0] = ww + xx - yy - zz
    matrices[..., 1, 1] = ww - xx + yy - zz
    matrices[..., 2, 2] = ww - xx - yy + zz
    matrices[..., 0, 1], matrices[..., 1, 0] = 2.0 * (x * y - w * z), 2.0 * (x * y + w * z)
    matrices[..., 2, 0], matrices[..., 0, 2] = 2.0 * (x * z - w * y), 2.0 * (x * z + w * y)
    matrices[..., 1, 2], matrices[..., 2, 1] = 2.0 * (y * z - w * x), 2.0 * (y * z + w * x)
    return matrices


def translation(q: ArrayLike) -> Floats:
    """Translations (..., 3), m, of unit dual quaternions (..., 8): ``2 d r*``.

    Raises:
        InputError: One is not unit.
    """
    return _translation(components(unit(q)))


def _translation(parts: Floats) -> Floats:
    """(..., 3) of components (8, ...): the vector part of ``2 d r*``."""
    w, x, y, z, a, b, c, d = parts
    shift = [
        w * b - a * x + y * d - z * c,
        w * c - a * y + z * b - x * d,
        w * d - a * z + x * c - y * b,
    ]
    return joined(2.0 * np.array(shift))


def to_matrix(q: ArrayLike) -> Floats:
    """Homogeneous matrices (..., 4, 4) of unit dual quaternions (..., 8), translations in m.

    Raises:
        InputError: One is not unit.
    """
    parts = components(unit(q))
    matrices = np.zeros((*parts.shape[1:], 4, 4))
    matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = _rotation(parts), _translation(parts), 1.0
    return matrices


def transform(q: ArrayLike, points: ArrayLike) -> Floats:
    """Points (..., 3), m, carried by unit dual quaternions (..., 8): ``q (1 + eps x) q'``, ' for both conjugates.

    Several points of one placement take one more axis: ``transform(q[:, None], points)``.

    Raises:
        InputError: One is not unit, or a shape is wrong.
    """
    parts, x = components(unit(q)), joined(components(points, 3, "points"))
    moved: Floats = (_rotation(parts) @ x[..., None])[..., 0] + _translation(parts)
    return moved
