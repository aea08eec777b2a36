"""Pose errors as dual quaternions, the joint corrections they ask for, and corrected commands; eq. 36 to 45."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats
from identify.dual_quaternions.algebra import canonical, conjugate, normalise, product, unit
from identify.dual_quaternions.screws import log
from identify.errors import InputError

__all__ = ["corrected", "joint_correction", "pose_error"]

_SINGULAR = 1e-9  # share of the largest singular value below which a direction counts as lost


def pose_error(wanted: ArrayLike, reached: ArrayLike) -> Floats:
    """``p q^-1`` (..., 8): the motion, seen in the base frame, that carries what is reached to what is wanted; eq. 36.

    Of the two signs the one with the shorter way is given: the same for ``q`` and ``-q``.

    Args:
        wanted: (..., 8) nominal poses p.
        reached: (..., 8) poses q with the estimated deflection.

    Raises:
        InputError: One is not unit.
    """
    return canonical(product(unit(wanted, "wanted pose"), conjugate(unit(reached, "reached pose"))))


def joint_correction(columns: ArrayLike, error: ArrayLike) -> Floats:
    """Joint values (V, n), rad or m, to add: ``J dtheta = dQ``, eq. 37, by least squares.

    A redundant arm gets the solution of least norm; an arm that cannot follow gets the one that comes nearest in rad of
    turn and m of displacement of the point at the base origin. Directions lost in a singular pose are left out.

    Args:
        columns: (V, 8, n) deviation per joint, `Postures.deviation`: the J of eq. 11 times ``q^-1``, as the error is no
            difference of poses but a motion.
        error: (V, 8) unit, of `pose_error`. Its logarithm is taken for dQ, which it is to first order.

    Raises:
        InputError: A wrong shape, or an error that is not unit.
    """
    jacobian, goal = np.asarray(columns, dtype=np.float64), log(unit(error, "pose error"))
    if jacobian.ndim != 3 or goal.ndim != 2 or jacobian.shape[:2] != (len(goal), 8):
        raise InputError(
            f"columns of shape {jacobian.shape} and errors of shape {goal.shape}: (V, 8, n), (V, 8) expected"
        )
    found: Floats = (np.linalg.pinv(jacobian, rcond=_SINGULAR) @ goal[:, :, None])[:, :, 0]
    return found


def corrected(command: ArrayLike, error: ArrayLike) -> Floats:
    """The command that makes up for an error: ``dQ * Q`` (..., 8), eq. 44 and 45.

    Eq. 45 prints a sum, which is no unit dual quaternion; the motion dQ is carried out after the commanded one instead.

    Args:
        command: (..., 8) poses Q as commanded.
        error: (..., 8) unit, of `pose_error`.

    Raises:
        InputError: One is not unit.
    """
    return normalise(product(unit(error, "pose error"), unit(command, "commanded pose")))
