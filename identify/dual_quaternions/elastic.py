"""Torques, deflections and stiffness of serial robots in dual quaternions.

A wrench is a dual vector like a screw: force in the real part, moment about the base origin in the dual part,
``f + eps m``. It is carried from frame to frame as screws are. Its work on a twist ``a + eps v`` is
``m . a + f . v``, the circle product of the twist with the swapped wrench. The deviation of a pose is ``q' q^-1 - 1``,
half the twist; so the F of eq. 14 to 23, which meets deviations, is twice the swapped wrench, and ``T F' J`` (eq. 18)
the torque of each joint.

Source: eq. 12-32 of the paper; for the complementary stiffness Chen and Kao, Int. J. Robot. Res. 19(9), 835-847, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats, frozen, skew
from identify.dual_quaternions.algebra import bracket, circle, swap
from identify.dual_quaternions.chain import Postures
from identify.dual_quaternions.placements import rotation, transform
from identify.dual_quaternions.screws import dual_vector, twist
from identify.errors import Infeasible, InputError

__all__ = [
    "FRAMES",
    "AppliedWrench",
    "apply_wrench",
    "cartesian_compliance",
    "cartesian_stiffness",
    "complementary_stiffness",
    "deviation",
    "deviation_columns",
    "joint_torques",
    "twist_jacobian",
]

#: Frames in which a wrench may be given.
FRAMES = ("base", "world", "flange")
_RIGID = 1e-9  # share of the largest singular value of a compliance with unit diagonal below which it has no inverse


@dataclass(frozen=True, eq=False)
class AppliedWrench:
    """What acts on the flange in V poses.

    Attributes:
        dual: (V, 8) force, N, and moment about the base origin, Nm: ``f + eps m``, base frame.
        point: (V, 3) where the force acts, base frame, m. It moves with the flange.
        turns: True if force and moment turn with the flange, False if they keep their directions.
    """

    dual: Floats
    point: Floats
    turns: bool


def apply_wrench(
    postures: Postures, wrench: ArrayLike, attach: ArrayLike = (0.0, 0.0, 0.0), *, frame: str = "base"
) -> AppliedWrench:
    """Let wrenches act on the flange.

    Args:
        postures: The robot in V poses.
        wrench: (6,) or (V, 6) force, N, then moment about the attach point, Nm.
        attach: (3,) or (V, 3) point where it acts, flange frame, m.
        frame: Frame of the wrench: "base", "world" or "flange". In "flange" it turns with the flange.

    Raises:
        InputError: Another frame; no wrench; a wrong shape; a number that is not finite; a pose that is not unit.
    """
    if frame not in FRAMES:
        raise InputError(f"frame = {frame!r}: a wrench can be given in {', '.join(FRAMES)}")
    count = len(postures.pose)
    values, local = _rows(wrench, count, 6, "wrench"), _rows(attach, count, 3, "attach point")
    turn = {"base": np.eye(3), "world": postures.robot.world_R_base.T, "flange": rotation(postures.pose)}[frame]
    force, moment = ((turn @ part[..., None])[..., 0] for part in (values[:, :3], values[:, 3:]))
    point = transform(postures.pose, local)
    about_origin = moment + (skew(point) @ force[..., None])[..., 0]
    dual = dual_vector(np.concatenate([about_origin, force], axis=1))
    return AppliedWrench(frozen(dual), frozen(point), frame == "flange")


def _rows(values: ArrayLike, count: int, size: int, what: str) -> Floats:
    """(V, size) of one row or of one for every pose."""
    array = np.asarray(values, dtype=np.float64)
    if not array.size:
        raise InputError(f"no {what}: an array of shape {array.shape} holds none; give one, or one for each pose")
    if array.shape not in ((size,), (count, size)):
        raise InputError(f"{what} of shape {array.shape}: ({size},) or ({count}, {size}) expected")
    if not np.isfinite(array).all():
        raise InputError(f"{what} {array[~np.isfinite(array)][0]}: finite numbers expected")
    return np.broadcast_to(array, (count, size))


def joint_torques(postures: Postures, applied: AppliedWrench) -> Floats:
    """``T F' J`` (V, n): what the wrench puts on each joint, Nm, or N where it slides; eq. 16 to 18.

    Raises:
        InputError: The wrench was applied to another number of poses.
    """
    return circle(_same(postures, applied)[:, None], postures.screws)


def deviation_columns(postures: Postures, applied: AppliedWrench) -> Floats:
    """Deviation ``q' q^-1 - 1`` per joint compliance (V, 8, n): the rows A of eq. 31 and 32, first order.

    The compliances are in rad/Nm, or m/N where a joint slides.

    Raises:
        InputError: The wrench was applied to another number of poses.
    """
    columns: Floats = postures.deviation * joint_torques(postures, applied)[:, None]
    return columns


def deviation(postures: Postures, compliance: ArrayLike, applied: AppliedWrench) -> Floats:
    """``D = J K^-1 J' F T'`` (V, 8): deviation ``q' q^-1 - 1`` under the wrench, first order; eq. 23.

    Args:
        postures: The robot in V poses.
        compliance: (n,) rad/Nm, or m/N where a joint slides.
        applied: What acts.

    Raises:
        InputError: Another number of compliances, or a negative one.
    """
    moved: Floats = deviation_columns(postures, applied) @ _compliances(postures, compliance)
    return moved


def complementary_stiffness(postures: Postures, applied: AppliedWrench) -> Floats:
    """``K_c[i, j] = d tau_i / d theta_j`` (V, n, n) of the wrench that stays as it is; eq. 26 to 29.

    Joint j carries the screws of the joints after it, ``d s_i = s_j x s_i``, and the point where the wrench acts; the
    wrench itself keeps its direction, or turns with the flange. Nm/rad, N/rad, Nm/m or N/m.

    Raises:
        InputError: The wrench was applied to another number of poses.
    """
    _same(postures, applied)
    screws, dual = postures.screws, applied.dual[:, None]
    if applied.turns:
        changed = bracket(screws, dual)
    else:
        # the moment about the base origin grows as the point moves: (v + a x p) x f
        values = twist(screws)
        moves = values[..., :3] + values[..., 3:] @ skew(applied.point)
        moment = moves @ skew(applied.dual[:, 1:4])
        changed = dual_vector(np.concatenate([moment, np.zeros_like(moment)], axis=-1))
    # <W, s_j x s_i> = <s_i x W, s_j>: the triple product may be turned round
    carried = swap(bracket(screws, dual)) @ screws.swapaxes(1, 2)
    after = np.tri(postures.robot.n, k=-1, dtype=bool)
    slope: Floats = swap(screws) @ changed.swapaxes(1, 2) + np.where(after, carried, 0.0)
    return slope


def twist_jacobian(postures: Postures, points: ArrayLike) -> Floats:
    """Ordinary Jacobian (V, 6, n) of points (3,) or (V, 3) that ride on the flange, flange frame, m.

    Rows: velocity of the point, then turn; base frame.

    Raises:
        InputError: A wrong shape.
    """
    point = transform(postures.pose, _rows(points, len(postures.pose), 3, "point"))
    values = twist(postures.screws).swapaxes(1, 2)
    linear = values[:, :3] - skew(point) @ values[:, 3:]
    return np.concatenate([linear, values[:, 3:]], axis=1)


def cartesian_compliance(
    postures: Postures, compliance: ArrayLike, applied: AppliedWrench | None = None, point: ArrayLike = (0.0, 0.0, 0.0)
) -> Floats:
    """Twist of a point per wrench added there (V, 6, 6): ``J (K - K_c)^-1 J'``, eq. 29 without an inverse of J.

    Args:
        postures: The robot in V poses.
        compliance: (n,) rad/Nm, or m/N where a joint slides; 0 is a rigid joint.
        applied: What acts already; None: nothing, ``K_c = 0``.
        point: (3,) or (V, 3) flange frame, m.

    Returns:
        Rows: displacement, m, then turn, rad; columns: force, N, then moment, Nm; base frame. Symmetric where nothing
        acts already, or a force alone that keeps its direction.

    Raises:
        InputError: Another number of compliances, a negative one, or a wrong shape.
    """
    flexible: Floats = np.diag(_compliances(postures, compliance))
    moves = twist_jacobian(postures, point)
    if applied is not None:
        slope = complementary_stiffness(postures, applied)
        flexible = np.asarray(np.linalg.solve(np.eye(len(flexible)) - flexible @ slope, flexible))
    found: Floats = moves @ flexible @ moves.swapaxes(1, 2)
    return found


def cartesian_stiffness(
    postures: Postures, compliance: ArrayLike, applied: AppliedWrench | None = None, point: ArrayLike = (0.0, 0.0, 0.0)
) -> Floats:
    """Wrench per twist of a point (V, 6, 6), the inverse of `cartesian_compliance`.

    Args:
        postures: The robot in V poses.
        compliance: (n,) rad/Nm, or m/N where a joint slides.
        applied: What acts already; None: nothing.
        point: (3,) or (V, 3) flange frame, m.

    Raises:
        InputError: Another number of compliances, a negative one, or a wrong shape.
        Infeasible: In some pose the arm does not yield in every direction: fewer than six elastic joints, or singular.
    """
    yields = cartesian_compliance(postures, compliance, applied, point)
    size = np.sqrt(np.abs(np.einsum("vii->vi", yields)))
    scaled = yields / np.where(size > 0.0, size, 1.0)[:, :, None] / np.where(size > 0.0, size, 1.0)[:, None]
    spread = np.linalg.svd(scaled, compute_uv=False)
    stiff = ~(spread[:, -1] > _RIGID * spread[:, 0])
    if stiff.any():
        raise Infeasible(
            f"pose {int(np.argmax(stiff))} of {len(stiff)}: the arm does not yield in every direction (fewer than six "
            "elastic joints, or a singular pose), so it has no Cartesian stiffness; use the compliance"
        )
    return np.asarray(np.linalg.inv(yields))


def _same(postures: Postures, applied: AppliedWrench) -> Floats:
    """(V, 8) the swapped wrench, if it was applied to as many poses."""
    if applied.dual.shape != postures.pose.shape:
        raise InputError(
            f"{len(applied.dual)} wrenches for {len(postures.pose)} poses: apply the wrench to these poses"
        )
    return swap(applied.dual)


def _compliances(postures: Postures, compliance: ArrayLike) -> Floats:
    """(n,) compliances, none of them negative."""
    values = np.asarray(compliance, dtype=np.float64)
    if values.shape != (postures.robot.n,) or not (values >= 0.0).all() or not np.isfinite(values).all():
        raise InputError(
            f"compliances {values.tolist()}: {postures.robot.n} finite numbers, none negative, expected "
            "(rad/Nm, or m/N for a sliding joint)"
        )
    return values
