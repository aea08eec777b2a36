"""Products, conjugates, matrices and the unit constraint of dual quaternions.

Arrays (..., 8) broadcast against each other. Results lie in memory component by component, which keeps long
batches fast; their shape is (..., 8) all the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats
from identify.errors import InputError

__all__ = [
    "IDENTITY",
    "UNIT_TOLERANCE",
    "bracket",
    "canonical",
    "circle",
    "components",
    "conjugate",
    "dual_conjugate",
    "dual_quaternion_conjugate",
    "inverse",
    "joined",
    "left_matrix",
    "normalise",
    "product",
    "right_matrix",
    "swap",
    "unit",
]

#: The placement that moves nothing, (8,).
IDENTITY: Floats = np.eye(8)[0]
IDENTITY.setflags(write=False)
#: How far ``|r|`` may be from 1, and ``r . d`` from 0 m, in a unit dual quaternion.
UNIT_TOLERANCE = 1e-9

_CONJUGATE = np.array([1.0, -1, -1, -1, 1, -1, -1, -1])
_DUAL = np.repeat([1.0, -1.0], 4)


def components(values: ArrayLike, size: int = 8, what: str = "dual quaternion") -> Floats:
    """View of (..., size) as (size, ...), checked.

    Raises:
        InputError: The last axis has another length.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != size:
        raise InputError(f"{what} of shape {array.shape}: the last axis must have {size} numbers")
    return array.transpose(-1, *range(array.ndim - 1))


def joined(parts: ArrayLike) -> Floats:
    """(..., size) from components (size, ...), as a view."""
    array = np.asarray(parts, dtype=np.float64)
    return array.transpose(*range(1, array.ndim), 0)


def _common(p: Floats, q: Floats) -> tuple[int, ...]:
    """Shape of what comes out for components (8, ...) and (8, ...)."""
    try:
        return np.broadcast_shapes(p.shape[1:], q.shape[1:])
    except ValueError as error:
        raise InputError(
            f"dual quaternions of shapes {joined(p).shape} and {joined(q).shape} do not broadcast against each other"
        ) from error


def _quaternion_product(a: Floats, b: Floats, out: Floats) -> None:
    """Add the product of quaternions (4, ...), eq. 7, to ``out``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    out[0] += aw * bw - ax * bx - ay * by - az * bz
    out[1] += aw * bx + ax * bw + ay * bz - az * by
    out[2] += aw * by - ax * bz + ay * bw + az * bx
    out[3] += aw * bz + ax * by - ay * bx + az * bw


def product(a: ArrayLike, b: ArrayLike) -> Floats:
    """``a * b``, eq. 6: of two placements, first ``b`` then ``a``; (..., 8).

    Raises:
        InputError: The shapes do not broadcast.
    """
    p, q = components(a), components(b)
    result = np.zeros((8, *_common(p, q)))
    _quaternion_product(p[:4], q[:4], result[:4])
    _quaternion_product(p[:4], q[4:], result[4:])
    _quaternion_product(p[4:], q[:4], result[4:])
    return joined(result)


def _signed(q: ArrayLike, signs: Floats) -> Floats:
    """``q`` with the signs (8,)."""
    signed: Floats = joined(components(q)) * signs
    return signed


def conjugate(q: ArrayLike) -> Floats:
    """Quaternion conjugate ``r* + eps d*``: the inverse of a unit one; stands behind lines, ``q s q*``."""
    return _signed(q, _CONJUGATE)


def dual_conjugate(q: ArrayLike) -> Floats:
    """Dual conjugate ``r - eps d``."""
    return _signed(q, _DUAL)


def dual_quaternion_conjugate(q: ArrayLike) -> Floats:
    """Both conjugates, ``r* - eps d*`` (eq. 5): what stands behind points, ``q (1 + eps x) q'``."""
    return _signed(q, _CONJUGATE * _DUAL)


def swap(q: ArrayLike) -> Floats:
    """``d + eps r``: real and dual part change places, (..., 8)."""
    parts = components(q)
    return joined(np.concatenate([parts[4:], parts[:4]]))


def circle(a: ArrayLike, b: ArrayLike) -> Floats:
    """Circle product ``a_r . b_r + a_d . b_d``, a real number (...).

    As Filipe, Valverde, Tsiotras use it (IEEE Trans. Aerosp. Electron. Syst. 52, 411-422, 2016; reference 29 of the
    paper). The paper keeps the two dot products apart, as scalars of a real and a dual part, and adds them with
    ``T = [1 0 0 0 1 0 0 0]`` (eq. 13-16): the same number.

    Raises:
        InputError: The shapes do not broadcast.
    """
    p, q = components(a), components(b)
    _common(p, q)
    total: Floats = (joined(p) * joined(q)).sum(axis=-1)
    return total


def bracket(a: ArrayLike, b: ArrayLike) -> Floats:
    """``(a b - b a) / 2``: of dual vectors the cross product of screws, how ``b`` changes when carried along ``a``."""
    commutator: Floats = 0.5 * (product(a, b) - product(b, a))
    return commutator


#: ``e_i e_j = sum_k _TABLE[i, j, k] e_k``.
_TABLE = product(np.eye(8)[:, None], np.eye(8)[None])


def left_matrix(p: ArrayLike) -> Floats:
    """``[p+]`` (..., 8, 8) with ``p * q = [p+] q``, eq. 39, 40, 42; its lower left block is that of the dual part."""
    matrix: Floats = np.tensordot(joined(components(p)), _TABLE, 1).swapaxes(-1, -2)
    return matrix


def right_matrix(q: ArrayLike) -> Floats:
    """``[q-]`` (..., 8, 8) with ``p * q = [q-] p``, eq. 39, 41, 43; its lower left block is that of the dual part."""
    matrix: Floats = np.tensordot(joined(components(q)), _TABLE.swapaxes(0, 1), 1).swapaxes(-1, -2)
    return matrix


def unit(q: ArrayLike, what: str = "dual quaternion") -> Floats:
    """``q`` (..., 8) as an array, if every entry is a unit dual quaternion within `UNIT_TOLERANCE`.

    Raises:
        InputError: One is not: ``|r|`` is not 1, ``r . d`` is not 0, or a number is not finite.
    """
    parts = components(q)
    length, slant = np.sqrt((parts[:4] ** 2).sum(axis=0)), (parts[:4] * parts[4:]).sum(axis=0)
    wrong = ~((np.abs(length - 1.0) <= UNIT_TOLERANCE) & (np.abs(slant) <= UNIT_TOLERANCE))
    wrong |= ~np.isfinite(parts).all(axis=0)
    if wrong.any():
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        place = f"{what} {list(where)}" if where else what
        raise InputError(
            f"{place} = {joined(parts)[where].tolist()} is not unit: |r| = {length[where]:.10g}, "
            f"r.d = {slant[where]:.3g} m; 1 and 0 within {UNIT_TOLERANCE:g} expected; "
            "normalise it, or check the order w, x, y, z"
        )
    return joined(parts)


def _squared(q: ArrayLike, why: str) -> tuple[Floats, Floats, Floats]:
    """Components, ``|r|^2`` and ``r . d``; the real part must not be zero."""
    parts = components(q)
    squared, slant = (parts[:4] ** 2).sum(axis=0), (parts[:4] * parts[4:]).sum(axis=0)
    if not (squared > 0.0).all():
        where = np.argwhere(~(squared > 0.0))[0].tolist()
        raise InputError(f"dual quaternion {where}: a real part of length 0 (or not finite) {why}")
    return parts, squared, slant


def normalise(q: ArrayLike) -> Floats:
    """The unit dual quaternion of ``q`` (..., 8): ``q`` divided by its dual norm ``|r| + eps r . d / |r|``.

    A common factor of both parts changes no placement, and the part of ``d`` along ``r`` belongs to none: d / |r| is
    moved to the nearest one that is at right angles to r.

    Raises:
        InputError: The real part is zero.
    """
    parts, squared, slant = _squared(q, "cannot be normalised")
    length = np.sqrt(squared)
    return joined(np.concatenate([parts[:4] / length, (parts[4:] - parts[:4] * (slant / squared)) / length]))


def inverse(q: ArrayLike) -> Floats:
    """``q^-1`` (..., 8) of any dual quaternion with a real part; the conjugate divided by the squared dual norm.

    Raises:
        InputError: The real part is zero.
    """
    _, squared, slant = _squared(q, "has no inverse")
    opposite = components(conjugate(q))
    dual = opposite[4:] - opposite[:4] * (2.0 * slant / squared)
    return joined(np.concatenate([opposite[:4], dual]) / squared)


def canonical(q: ArrayLike) -> Floats:
    """That of ``q`` and ``-q`` (..., 8) whose first real component other than zero is positive: the short way round."""
    parts = components(q)
    sign = np.zeros(parts.shape[1:])
    for part in parts[:4]:
        sign = np.where(sign == 0.0, np.sign(part), sign)
    return joined(parts * np.where(sign == 0.0, 1.0, sign))
