"""How far single parameters can move among the positive definite matrices of `identify.cone_problems`.

Every bound is proven by duality, so that a solver that stops early makes an interval wider, never too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from identify.arrays import Floats
from identify.cone_problems import Affine, elements, solutions
from identify.errors import NoConvergence
from identify.positive_cone import Cone

__all__ = ["extremes"]

_DETERMINED = 1e-9
_CLOSE = 1e-5  # a proven bound so near the solver's own, relative to it and to the prior, is as good as exact
_LOSS = 1e-2  # and the best of all attempts may be that far off: an interval wider by so much still tells something


def extremes(
    cone: Cone, space: Affine, margin: float, bounds: tuple[Floats, Floats], wanted: Sequence[int]
) -> tuple[Floats, Floats]:
    """Smallest and largest possible values (w,) of some parameters; no possible value lies outside.

    Parameters that the equations determine are taken to be possible.

    Args:
        cone: The cone.
        space: Where y may be.
        margin: Smallest eigenvalue.
        bounds: (P,) and (P,) box around y; infinite beside the diagonals of the matrices, finite elsewhere.
        wanted: Indices of the parameters.

    Raises:
        NoConvergence: The solver gave up.
    """
    found = np.empty((2, len(wanted)))
    if not wanted:
        return found[0], found[1]
    problem = _problem(cone, space, margin, bounds)
    for place, index in enumerate(wanted):
        size = float(np.linalg.norm(space.basis[index]))
        for side, sign in enumerate((1.0, -1.0)):
            found[side, place] = space.point[index]
            if size > _DETERMINED:
                least = _least(problem, sign * space.basis[index] / size)
                if least is None:
                    raise NoConvergence(f"the solver found no bound of {cone.names[index]}")
                found[side, place] += sign * least * size
    return found[0], found[1]


@dataclass(frozen=True, eq=False)
class _Linear:
    """A linear function of z over the possible matrices, and the affine functions of z that have to be positive.

    Attributes:
        problem: For the solver; minimises ``direction @ z``.
        direction: Its parameter.
        limits: The constraints of ``problem``.
        rows: Of each constraint, (m, d).
        offsets: Of each constraint, (m,): ``rows z + offset`` is positive, element by element or as a matrix.
        error: (P, d) E, such that ``|r'z|`` is at most the sum of ``|E r|`` for any r.
    """

    problem: Any
    direction: Any
    limits: list[Any]
    rows: list[Floats]
    offsets: list[Floats]
    error: Floats


def _problem(cone: Cone, space: Affine, margin: float, bounds: tuple[Floats, Floats]) -> _Linear:
    """The problem for any direction.

    Rows of what is determined are left out: rounding is all they hold, and a solver would scale it up.
    """
    import cvxpy as cp

    free = np.linalg.norm(space.basis, axis=1) > _DETERMINED
    single = [block.columns[0, 0] for block in cone.blocks if len(block.columns) == 1]
    sides = (
        (single, 1.0, space.point - margin),
        (np.flatnonzero(np.isfinite(bounds[1])), -1.0, bounds[1] - space.point),
        (np.flatnonzero(np.isfinite(bounds[0])), 1.0, space.point - bounds[0]),
    )
    kept = [(np.array([i for i in index if free[i]], dtype=np.int64), sign, room) for index, sign, room in sides]
    rows = [np.concatenate([sign * space.basis[index] for index, sign, _ in kept])]
    offsets = [np.concatenate([room[index] for index, _, room in kept])]
    for block in cone.blocks:
        if len(block.columns) > 1 and free[block.columns[block.columns >= 0]].any():
            row, offset = elements(block, space)
            rows.append(row)
            offsets.append(offset - margin * np.eye(len(block.columns)).ravel())
    z, direction = cp.Variable(space.basis.shape[1]), cp.Parameter(space.basis.shape[1])
    limits = [rows[0] @ z + offsets[0] >= 0]
    for row, offset in zip(rows[1:], offsets[1:], strict=True):
        size = int(np.sqrt(len(offset)))
        limits.append(cp.reshape(row @ z + offset, (size, size), order="C") >> 0)
    problem = cp.Problem(cp.Minimize(direction @ z), limits)
    return _Linear(problem, direction, limits, rows, offsets, _error(cone, space, bounds))


def _error(cone: Cone, space: Affine, bounds: tuple[Floats, Floats]) -> Floats:
    """What a linear function ``r'z`` can be at most, for the bounded y that z stand for.

    ``r = basis'v`` has many solutions v, and ``|r'z| <= sum_i |v_i| |y_i - point_i|`` with each; the least squares of
    these products make the sum small. Elements beside a diagonal are bounded by the two on it.
    """
    largest = np.maximum(np.abs(bounds[0]), np.abs(bounds[1]))
    for block in cone.blocks:
        peak = np.sqrt(np.maximum(bounds[1][np.diag(block.columns)], 0.0))
        used = block.columns >= 0
        index = block.columns[used]
        largest[index] = np.minimum(largest[index], np.outer(peak, peak)[used])
    room = largest + np.abs(space.point)
    error: Floats = np.linalg.pinv((space.basis / room[:, None]).T)
    return error


def _least(linear: _Linear, direction: Floats) -> float | None:
    """Proven lower bound of ``direction @ z``, None if no attempt comes close to the solver's own value."""
    linear.direction.value = direction
    best, worth = None, _LOSS
    for _ in solutions(linear.problem):
        value = linear.problem.value
        if value is None or not np.isfinite(value) or any(limit.dual_value is None for limit in linear.limits):
            continue
        proven = _proven(linear, direction)
        loss = (value - proven) / (1.0 + abs(value))
        if loss <= worth:
            best, worth = proven, loss
        if loss <= _CLOSE:
            break
    return best


def _proven(linear: _Linear, direction: Floats) -> float:
    """Weak duality: with any positive multipliers Y, ``c'z >= -<Y, offset> - |(c - rows'Y)'z|``."""
    rest, bound = direction.copy(), 0.0
    for limit, rows, offset in zip(linear.limits, linear.rows, linear.offsets, strict=True):
        multipliers = _positive(np.asarray(limit.dual_value, dtype=np.float64)).ravel()
        rest -= rows.T @ multipliers
        bound -= float(offset @ multipliers)
    return bound - float(np.abs(linear.error @ rest).sum())


def _positive(multipliers: Floats) -> Floats:
    """The nearest nonnegative (m,) or positive semidefinite (k, k) multipliers."""
    if multipliers.ndim == 1:
        return np.maximum(multipliers, 0.0)
    values, vectors = np.linalg.eigh(0.5 * (multipliers + multipliers.T))
    nearest: Floats = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return nearest
