"""Commands that make a loaded arm stand where the program means.

*Joint form*: joint values ``q - C t``, C the compliances of the joints and t the torques of load and self-weight at the
wished pose. Where only joints yield, the arm then turns by ``C t`` and stands exactly there. What other effects do is
taken back by the smallest joint motion that does it, and with more passes by Newton steps on the full model.

*Mirror form*: the pose ``T_cmd T_act^-1 T`` instead of T, with T_act where the arm goes when T_cmd is commanded; for
programs with linear motions, whose controllers find the joint values themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from identify.alignment import inverse
from identify.arrays import Floats
from identify.elastic_chain import chain_index
from identify.error_radius import radii
from identify.errors import Infeasible, InputError, NoConvergence
from identify.inverse_kinematics import joints_near, least_motion
from identify.kinematics import flange_poses
from identify.loaded_scene import spring_matrix
from identify.rotations import pose_errors
from identify.tool_response import Arm, Targets, point_covariances, tool_poses, tool_response
from identify.units import DEG, MM

__all__ = ["Compensation", "Form", "compensate", "joint_matrix", "joint_shift"]

Form = Literal["joint", "mirror"]

_SETTLED = 1e-9  # rad or m: poses this near are reached, and steps this small change nothing
_STEP = 0.05  # rad or m: joints that need more than this to take back a deflection are at a singular pose
_FAR = 0.2  # rad or m from the target: no arm yields that much
_LIMIT_SLACK = 1e-9  # rad or m
_CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False)
class Compensation:
    """Commands for T targets, and what the model says will remain.

    Attributes:
        arm: The arm.
        targets: What was wished.
        form: ``joint`` or ``mirror``.
        passes: Corrections that were made.
        q: (T, n) joint values to command, rad or m.
        command: (T, 4, 4) pose to command: where the rigid nominal robot stands at ``q``, base frame, m.
        before: (T, 3) error of the attach point without compensation, base frame, m.
        residual: (T, 3) error of the attach point that remains by the model, base frame, m.
        residual_turn: (T,) angle by which the flange remains turned, rad.
    """

    arm: Arm
    targets: Targets
    form: Form
    passes: int
    q: Floats
    command: Floats
    before: Floats
    residual: Floats
    residual_turn: Floats

    @cached_property
    def _uncertainty(self) -> tuple[Floats, Floats]:
        return point_covariances(self.arm, self.targets.at(self.q))

    @property
    def covariance(self) -> Floats:
        """(T, 3, 3) of the error of the attach point from that of the identified parameters, base frame, m^2."""
        return self._uncertainty[0]

    @property
    def answer(self) -> Floats:
        """(p,) largest motion of any attach point per unit of each parameter, m."""
        return self._uncertainty[1]

    @cached_property
    def radius95(self) -> Floats:
        """(T,) radius that holds 95 % of the remaining errors of the attach point, from `covariance`, m."""
        return radii(self.covariance, _CONFIDENCE)


def compensate(arm: Arm, targets: Targets, form: Form = "joint", passes: int = 10) -> Compensation:
    """Commands that take targets of a loaded arm where they are meant.

    Args:
        arm: The fitted arm (`identify.tool_response.arm_of`).
        targets: Wished poses, given by joint values of the rigid nominal robot, and wrenches.
        form: ``joint`` targets or ``mirror`` poses.
        passes: Most corrections; it ends earlier where another one would change nothing. 1 is the one-shot form.

    Raises:
        InputError: Fewer than one pass, an unknown form, or another number of joints than the robot has.
        Infeasible: A corrected target is outside the joint limits or cannot be reached.
        NoConvergence: The loaded arm finds no equilibrium.
    """
    if passes < 1:
        raise InputError(f"passes = {passes}: at least 1 expected")
    if form not in get_args(Form):
        raise InputError(f"form = {form!r}: allowed are {', '.join(get_args(Form))}")
    robot = arm.model.robot
    wished = flange_poses(robot, targets.q)
    q, done = (_joint_form if form == "joint" else _mirror_form)(arm, targets, wished, passes)
    _check_distance(arm, targets, q, form)
    _check_limits(arm, targets, q)
    real, rigid = tool_poses(arm, targets.at(q)), tool_poses(arm, targets)
    return Compensation(
        arm=arm,
        targets=targets,
        form=form,
        passes=done,
        q=q,
        command=flange_poses(robot, q),
        before=_points(rigid, targets) - _points(wished, targets),
        residual=_points(real, targets) - _points(wished, targets),
        residual_turn=np.linalg.norm(pose_errors(real, wished)[:, 3:], axis=1),
    )


def _points(poses: Floats, targets: Targets) -> Floats:
    """(T, 3) attach points of flanges at poses, m."""
    points: Floats = poses[:, :3, 3] + (poses[:, :3, :3] @ targets.attach[..., None])[..., 0]
    return points


def _repeat(
    arm: Arm, targets: Targets, wished: Floats, q: Floats, step: Callable[[Floats, Floats], Floats], passes: int
) -> tuple[Floats, int]:
    """Change joint values by ``(q, actual poses) -> change`` until the poses are reached; the number of changes."""
    for done in range(passes):
        actual = tool_poses(arm, targets.at(q))
        if np.abs(pose_errors(actual, wished)).max(initial=0.0) < _SETTLED:
            return q, done
        change = step(q, actual)
        q = q + change
        if np.abs(change).max(initial=0.0) < _SETTLED:
            return q, done + 1
    return q, passes


# ---- joint form


def _joint_form(arm: Arm, targets: Targets, wished: Floats, passes: int) -> tuple[Floats, int]:
    """Joint values (T, n) to command, and the passes made."""
    robot = arm.model.robot

    def step(q: Floats, actual: Floats) -> Floats:
        return -least_motion(robot, q, pose_errors(actual, wished), largest=_STEP)

    q, more = _repeat(arm, targets, wished, targets.q + joint_shift(arm, targets), step, passes - 1)
    return q, 1 + more


def joint_shift(arm: Arm, targets: Targets) -> Floats:
    """One-shot correction (T, n) of joint values, rad or m: ``-C t``, and the smallest one for what else moves.

    Exact where only joint springs yield, whatever the equilibrium; else of first order.
    """
    return np.concatenate([_shift(arm, part) for part in targets.parts()])


def _shift(arm: Arm, targets: Targets) -> Floats:
    """`joint_shift` of some thousand targets."""
    linear = replace(arm, model=replace(arm.model, loaded=False))
    response = tool_response(linear, targets, derivative=False)
    scene = response.scene
    yielded = scene.torque("joints") @ joint_matrix(arm).T
    if all(effect.springs == "joints" for effect in arm.model.effects):
        return -yielded
    robot = arm.model.robot
    rigid = flange_poses(robot, targets.q + yielded)
    return -yielded - least_motion(robot, targets.q, pose_errors(response.pose, rigid), largest=_STEP)


def joint_matrix(arm: Arm) -> Floats:
    """(n, n) compliances of the joints and between them, rad/Nm (m/N, mixed): effects that count joint springs."""
    model = arm.model
    pairs = zip(model.effects, model.effect_inputs, strict=True)
    springs = [(effect, arm.values[inputs]) for effect, inputs in pairs if effect.springs == "joints"]
    given, active = spring_matrix(springs, model.robot.n)
    place = np.searchsorted(chain_index(model.robot.n, "joints"), active)
    matrix = np.zeros((model.robot.n, model.robot.n))
    matrix[np.ix_(place, place)] = given
    return matrix


# ---- mirror form


def _mirror_form(arm: Arm, targets: Targets, wished: Floats, passes: int) -> tuple[Floats, int]:
    """Joint values (T, n) at which the commanded poses are reached, and the passes made."""
    robot = arm.model.robot

    def step(q: Floats, actual: Floats) -> Floats:
        mirrored = flange_poses(robot, q) @ inverse(actual) @ wished
        try:
            return joints_near(robot, mirrored, q) - q
        except NoConvergence as error:
            raise Infeasible(_unreached(targets, error)) from None

    return _repeat(arm, targets, wished, targets.q, step, passes)


def _unreached(targets: Targets, error: NoConvergence) -> str:
    """Which mirrored pose has no joint values near its target."""
    missed = np.flatnonzero(np.asarray(error.best))
    name, q = targets.names[missed[0]], targets.q[missed[0]]
    more = f" (and {len(missed) - 1} more)" if len(missed) > 1 else ""
    at = ", ".join(f"{value:.4g}" for value in q / DEG)
    return (
        f"target {name}{more}: its mirrored pose is not reached near joint values {at} deg: out of reach, at a "
        'singular pose, or with fewer joints than a pose needs; move the target, or use form "joint"'
    )


# ---- limits


def _check_limits(arm: Arm, targets: Targets, q: Floats) -> None:
    """Stop where a command is outside the joint limits.

    Raises:
        Infeasible: The message names target, joint, value and limits.
    """
    robot = arm.model.robot
    inside = (q >= robot.lower - _LIMIT_SLACK) & (q <= robot.upper + _LIMIT_SLACK) & np.isfinite(q)
    if inside.all():
        return
    (row, joint), more = _first(~inside)
    unit, word = (MM, "mm") if robot.prismatic[joint] else (DEG, "deg")
    value, lower, upper = (x / unit for x in (q[row, joint], robot.lower[joint], robot.upper[joint]))
    raise Infeasible(
        f"target {targets.names[row]}{more}: joint {joint + 1} would be commanded to {value:.6g} {word}, allowed are "
        f"{lower:.6g} to {upper:.6g} {word}; the target cannot be reached under this wrench"
    )


def _check_distance(arm: Arm, targets: Targets, q: Floats, form: Form) -> None:
    """Stop where a command is far from its target.

    Raises:
        Infeasible: The message names target, joint and distance.
    """
    change = q - targets.q
    near = np.abs(change) <= _FAR
    if near.all():
        return
    (row, joint), more = _first(~near)
    unit, word = (MM, "mm") if arm.model.robot.prismatic[joint] else (DEG, "deg")
    moved = change[row, joint] / unit
    other = ', or use form "joint", which leaves out what a singular pose has lost' if form == "mirror" else ""
    raise Infeasible(
        f"target {targets.names[row]}{more}: joint {joint + 1} would be moved by {moved:.6g} {word} to take back a "
        f"deflection, allowed are {_FAR / unit:.4g} {word}: the pose is nearly singular, or wrench or compliances are "
        f"far too large; move the target{other}"
    )


def _first(wrong: np.ndarray) -> tuple[tuple[int, int], str]:
    """Row and column of the first True of (T, n), and how many more rows have one."""
    row, column = np.argwhere(wrong)[0]
    count = int(wrong.any(axis=1).sum())
    return (int(row), int(column)), f" (and {count - 1} more)" if count > 1 else ""
