"""Logarithm, exponential, powers and interpolation of placements, and the twists they stand for.

A *dual vector* is a dual quaternion without scalars, ``a + eps m``. As a twist: a the turn, rad, and m the displacement
of the point at the base origin, m. As the screw of an axis through o: ``a + eps o x a`` (turning), ``eps a`` (sliding).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats
from identify.dual_quaternions.algebra import canonical, components, conjugate, joined, product, unit
from identify.errors import InputError

__all__ = ["DEVIATION_OF_TWIST", "TWIST_OF_DEVIATION", "dual_vector", "exp", "interpolate", "log", "power", "twist"]

_SMALL = 1e-4  # squared angle below which three terms of a series are exact to rounding

#: (8, 6): the deviation ``q - 1`` of a small twist, half of each entry, (linear, turning) -> dual quaternion.
DEVIATION_OF_TWIST: Floats = np.zeros((8, 6))
DEVIATION_OF_TWIST[[5, 6, 7, 1, 2, 3], np.arange(6)] = 0.5
DEVIATION_OF_TWIST.setflags(write=False)
#: (6, 8): its pseudo-inverse, the twist of a small deviation ``q - 1``.
TWIST_OF_DEVIATION: Floats = 4.0 * DEVIATION_OF_TWIST.T
TWIST_OF_DEVIATION.setflags(write=False)


def dual_vector(twist: ArrayLike) -> Floats:
    """Dual vector (..., 8) of a twist (..., 6): displacement of the point at the base origin, m, then the turn, rad."""
    parts = components(twist, 6, "twist")
    vector = np.zeros((8, *parts.shape[1:]))
    vector[1:4], vector[5:8] = parts[3:], parts[:3]
    return joined(vector)


def twist(vector: ArrayLike) -> Floats:
    """Twist (..., 6), linear then turning, of a dual vector (..., 8). Scalars are left out."""
    parts = components(vector)
    return joined(np.concatenate([parts[5:], parts[1:4]]))


def exp(vector: ArrayLike) -> Floats:
    """Unit dual quaternion (..., 8) of a dual vector (..., 8): ``exp(x / 2)`` is the finite motion of the twist ``x``.

    Raises:
        InputError: A scalar part is not zero.
    """
    parts = components(vector, what="dual vector")
    if parts[[0, 4]].any():
        raise InputError("a dual vector has no scalar parts (components 0 and 4 must be 0)")
    line, moment = parts[1:4], parts[5:]
    square, along = (line**2).sum(axis=0), (line * moment).sum(axis=0)
    half = np.sqrt(square)
    sine = np.sinc(half / np.pi)
    apart = np.where(square < _SMALL, 1.0, square)
    series = -1.0 / 3.0 + square * (1.0 / 30.0 - square / 840.0)
    slope = np.where(square < _SMALL, series, (np.cos(half) - sine) / apart)
    result = np.empty(parts.shape)
    result[0], result[1:4] = np.cos(half), line * sine
    result[4], result[5:] = -sine * along, moment * sine + line * (slope * along)
    return joined(result)


def log(q: ArrayLike) -> Floats:
    """Dual vector (..., 8), half the twist of the short way round, of unit dual quaternions; the same for q and -q.

    ``exp(log(q))`` is `canonical(q)`. Of the two ways of a half turn one is taken, always the same. With
    ``r = (w, v)``, ``s = |v|`` and the half angle h the real part is ``v g``, ``g = h / s``. The dual part is its
    derivative along d, ``d_v g + v ((w - g)/s^2 (v . d_v) - d_w)``: never divided by w, and where s is small the v in
    front makes up for the digits that ``w - g`` loses.

    Raises:
        InputError: One is not unit.
    """
    parts = components(canonical(unit(q)))
    w, v, dw, dv = parts[0], parts[1:4], parts[4], parts[5:]
    square = (v**2).sum(axis=0)
    sine = np.sqrt(square)
    near = square < _SMALL
    ratio = np.where(sine == 0.0, 1.0, np.arctan2(sine, w) / np.where(sine == 0.0, 1.0, sine))
    series = -2.0 / 3.0 - square * (0.2 + square * (3.0 / 28.0))
    slope = np.where(near, series, (w - ratio) / np.where(near, 1.0, square)) * (v * dv).sum(axis=0) - dw
    result = np.zeros(parts.shape)
    result[1:4], result[5:] = v * ratio, dv * ratio + v * slope
    return joined(result)


def power(q: ArrayLike, exponent: ArrayLike) -> Floats:
    """``q^t`` (..., 8): the share ``t`` (...) of the screw motion of ``q``, the short way round.

    Raises:
        InputError: One is not unit.
    """
    return exp(log(q) * np.asarray(exponent, dtype=np.float64)[..., None])


def interpolate(start: ArrayLike, end: ArrayLike, share: ArrayLike) -> Floats:
    """Screw linear interpolation ``a (a^-1 b)^t`` (..., 8) between placements, the short way; ``t`` (...) from 0 to 1.

    Source: Kavan, Collins, Zara, O'Sullivan, "Geometric skinning with approximate dual quaternion blending", 2008.

    Raises:
        InputError: One is not unit.
    """
    first = unit(start, "start")
    return product(first, power(product(conjugate(first), unit(end, "end")), share))
