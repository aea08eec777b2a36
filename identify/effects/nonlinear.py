"""Joints that are no linear springs: gears that harden, wind up, have play, or stick.

``t_j`` is the torque of load and self-weight on joint j, ``t_j^w`` its load part, ``D_j`` the motion of a marker per
unit of the joint. Each effect adds to what the linear springs of other effects say:

    joint_hardening     D_j h t_j^3 / (1 + (t_j / t_s)^2)   joint_windup    D_j A tanh(t_j / t_0)
    backlash            D_j b sgn(t_j)                      stiction        -c_j D_j clip(t_j^w, -t_f, t_f)

Windup is the soft first part of a gear's torsion curve (catalogues of strain wave and cycloidal gears give two or
three stiffnesses with the torques where they change), backlash its limit for a knee of zero. Sticking joints hold back
the first t_f of every change of load, so that the unloaded reading is where the others start.

A torque below 1e-5 of the largest in its shot counts as zero: robot files round their axes to about this, and no sign
of a joint's play hangs on it. Sliding joints are served alike, in N and um.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene
from identify.effects.joint_turns import (
    JointTurn,
    axis_compliance,
    borrowed_compliance,
    joint_options,
    joint_turns,
)
from identify.effects.options import number
from identify.effects.places import joint_places
from identify.errors import InputError
from identify.robot import Robot
from identify.units import SI_OF

__all__ = ["backlash", "joint_hardening", "joint_windup", "stiction"]

_ANGLE, _TORQUE = ("urad", "um"), ("Nm", "N")  # of turning, of sliding joints
_HARDENING = ("urad/kNm^3", "um/kN^3")
_PLAUSIBLE_ANGLE = 600.0  # urad: two arcmin, twice the play in gear catalogues; knowing it worse says nothing
_KNEE_SHARE = 0.1  # of the rated torque
_KNEE_UNKNOWN = 100.0  # Nm or N
_STICTION_SHARE, _STICTION_UNKNOWN = 0.1, 1000.0  # of the rated torque; Nm or N
_SMALLEST_KNEE = 0.01  # of its starting value: below, ever smaller changes
_NO_TORQUE, _NO_SHARE = 1e-6, 1e-5  # Nm or N; of the largest in a shot


def joint_hardening(binding: Binding) -> Effect:
    """Gears that stiffen with torque: ``D_j h t_j^3 / (1 + (t_j / t_s)^2)``; h < 0 is stiffer at high torque.

    Below the torque t_s the joint hardens by the cube, far above it is linear again with its final stiffness.

    Parameters ``joint_hardening.j<i>`` (h), urad/kNm^3 (um/kN^3 of sliding joints). Typical: 5 to 20 % of the joint's
    linear deflection at its largest torque, which is 1 to 10 urad/kNm^3 for 0.3 urad/Nm at 3 kNm.

    Options, also in ``[model.joint_hardening.j<i>]``: ``saturation_Nm`` (``saturation_N`` for sliding joints), t_s;
    default: none, the cube alone.

    Args:
        binding: Robot, places ``j1 ... jn`` and options.

    Raises:
        InputError: Unknown option, or a saturation that is not above 0.
    """
    name = "joint_hardening"

    def part(joint: int) -> JointTurn:
        parameter = _parameter(binding.robot, joint, f"{name}.j{joint + 1}", _HARDENING)
        key = "saturation_N" if binding.robot.prismatic[joint] else "saturation_Nm"
        options = joint_options(name, ("saturation_Nm", "saturation_N"), binding.options, joint)
        final = number(name, options, key, math.inf, least=0.0)

        def turn(scene: Scene, values: Floats) -> tuple[Floats, Floats]:
            torque = scene.joint_torque[:, joint]
            return _linear(parameter.scale * torque**3 / (1.0 + (torque / final) ** 2), values)

        return JointTurn(joint, (parameter,), turn, _unmoved(binding.robot, joint), linear=True)

    return _joints(name, binding, part, ("saturation_Nm", "saturation_N"))


def joint_windup(binding: Binding) -> Effect:
    """Gears that are soft near zero torque: ``D_j A tanh(t_j / t_0)``.

    Parameters ``joint_windup.j<i>.amplitude`` (A, urad; um of sliding joints) and, with ``fit_knee``,
    ``joint_windup.j<i>.knee`` (t_0, Nm or N). Typical: 50 to 150 urad, a knee at a few to 10 % of the rated torque.
    The knee is positive: a fit that goes below 1 % of its starting value k reaches ever smaller positive knees,
    ``t_0 = m^2 / (2 m - knee)`` with m = k / 100, and never zero, which is `backlash`.

    Options, also in ``[model.joint_windup.j<i>]``: ``knee_Nm`` (``knee_N`` for sliding joints; default: a tenth of the
    rated torque, else of what the rated payload does on the stretched arm, else 100) and ``fit_knee = false``. At an
    amplitude of zero, the nominal one, nothing depends on the knee: plans that are to show it need a stated amplitude.

    Args:
        binding: Robot, places ``j1 ... jn`` and options.

    Raises:
        InputError: Unknown option, a knee that is not above 0, or a switch that is none.
    """
    name = "joint_windup"

    def part(joint: int) -> JointTurn:
        robot, stem = binding.robot, f"{name}.j{joint + 1}"
        knee, fitted = _knee(binding, joint)
        amplitude = _play(robot, joint, f"{stem}.amplitude", typical=100.0)
        by_knee = _parameter(robot, joint, f"{stem}.knee", _TORQUE, knee, limit=100.0 * knee, typical=knee)

        def turn(scene: Scene, values: Floats) -> tuple[Floats, Floats]:
            t_0, slope = _positive(values[1], _SMALLEST_KNEE * knee) if fitted else (knee, 0.0)
            ratio = _clean(scene.joint_torque)[:, joint] / t_0
            bent = amplitude.scale * np.tanh(ratio)
            flatter = amplitude.scale * values[0] * (1.0 - np.tanh(ratio) ** 2) * ratio * (-slope / t_0)
            return bent * values[0], np.column_stack([bent, flatter] if fitted else [bent])

        unmoved = _unmoved(robot, joint)

        def why_zero(parameter: int) -> str:
            if parameter:
                return (
                    f"at an amplitude of zero, or with all torques on joint {joint + 1} far above it, nothing depends "
                    f"on the knee; state {stem}.amplitude under [model.nominal]"
                )
            return unmoved(parameter)

        unknown = (amplitude, by_knee) if fitted else (amplitude,)
        return JointTurn(joint, unknown, turn, why_zero, linear=not fitted)

    return _joints(name, binding, part, ("knee_Nm", "knee_N", "fit_knee"))


def backlash(binding: Binding) -> Effect:
    """Play between gears: ``D_j b sgn(t_j)``, b half of the gap; no torque leaves the joint in the middle.

    Parameters ``backlash.j<i>``, urad (um of sliding joints). Catalogues of robot gears state gaps up to 1 arcmin,
    290 urad. Where the mass of a link is unknown, the sign is that of the load alone.

    Args:
        binding: Robot and places ``j1 ... jn``; no options.
    """
    name = "backlash"

    def part(joint: int) -> JointTurn:
        parameter = _play(binding.robot, joint, f"{name}.j{joint + 1}", typical=50.0)

        def turn(scene: Scene, values: Floats) -> tuple[Floats, Floats]:
            return _linear(parameter.scale * np.sign(_clean(scene.joint_torque)[:, joint]), values)

        return JointTurn(joint, (parameter,), turn, _unmoved(binding.robot, joint), linear=True)

    return _joints(name, binding, part)


def stiction(binding: Binding) -> Effect:
    """Friction that holds a joint back: ``-c_j D_j clip(t_j^w, -t_f, t_f)``; c_j borrowed as by `gravity_compensator`.

    Parameters ``stiction.j<i>``, Nm (N of sliding joints). Typical: 1 to 4 % of the rated torque. The derivative at
    zero is that for t_f > 0, and t_f < 0 continues oddly, so that a fit may pass through zero.

    Args:
        binding: Robot, places ``j1 ... jn`` (default: all joints that yield) and the effects that own the joints'
            compliance; no options.

    Raises:
        InputError: Nothing lets the joint yield.
    """
    name, robot = "stiction", binding.robot
    yielding = tuple(f"j{j + 1}" for j in range(robot.n) if any(axis_compliance(binding.others, robot, j)))

    def part(joint: int) -> JointTurn:
        shares, held = borrowed_compliance(name, binding, joint)
        weights, effort = np.array(list(shares.values())), float(robot.efforts[joint])
        plausible = _STICTION_SHARE * effort if math.isfinite(effort) else _STICTION_UNKNOWN
        parameter = _parameter(
            robot, joint, f"{name}.j{joint + 1}", _TORQUE, limit=plausible, plausible=plausible,
            typical=0.025 * effort,
        )  # fmt: skip

        def turn(scene: Scene, values: Floats) -> tuple[Floats, Floats]:
            torque = _clean(scene.load_on_joints)[:, joint]
            compliance, friction = held + float(weights @ values[1:]), values[0]
            kept = math.copysign(1.0, friction) * np.clip(torque, -abs(friction), abs(friction))
            own = -compliance * np.where(np.abs(torque) > abs(friction), np.sign(torque), 0.0)
            return -compliance * kept, np.hstack([own[:, None], -kept[:, None] * weights])

        def why_zero(parameter: int) -> str:
            return (
                f"no load in these data puts a torque on joint {joint + 1} that exceeds its friction, or the joint is "
                f"rigid; state {next(iter(shares), 'its compliance')} under [model.nominal]"
            )

        return JointTurn(joint, (parameter,), turn, why_zero, tuple(shares))

    return _joints(name, binding, part, default=yielding or ("j1",))


def _joints(
    name: str,
    binding: Binding,
    part: Callable[[int], JointTurn],
    allowed: tuple[str, ...] = (),
    default: tuple[str, ...] = (),
) -> Effect:
    """One part for each place of an effect; unknown options are refused."""
    joints = joint_places(name, binding.robot, binding.where or default)
    if not allowed and binding.options:
        raise InputError(f"[model.{name}] {next(iter(binding.options))}: unknown key; {name} has no options")
    return joint_turns(name, [part(joint) for joint in joints])


def _linear(slope: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Angle and slopes of one linear unknown."""
    return slope * values[0], slope[:, None]


def _parameter(
    robot: Robot,
    joint: int,
    name: str,
    units: tuple[str, str],
    nominal: float = 0.0,
    *,
    limit: float = math.inf,
    plausible: float = math.inf,
    typical: float = math.nan,
) -> Parameter:
    """A parameter in the unit for turning or for sliding joints."""
    unit = units[int(robot.prismatic[joint])]
    return Parameter(name, unit, SI_OF[unit], nominal, limit=limit, plausible=plausible, typical=typical)


def _play(robot: Robot, joint: int, name: str, *, typical: float) -> Parameter:
    """Half of a lost motion."""
    return _parameter(robot, joint, name, _ANGLE, limit=_PLAUSIBLE_ANGLE, plausible=_PLAUSIBLE_ANGLE, typical=typical)


def _clean(torque: Floats) -> Floats:
    """Torques (S, n) with zero for what is only the rounding of a robot file; see the module."""
    size = np.abs(torque)
    cleaned: Floats = np.where(size > np.maximum(_NO_TORQUE, _NO_SHARE * size.max(axis=1, keepdims=True)), torque, 0.0)
    return cleaned


def _unmoved(robot: Robot, joint: int) -> Callable[[int], str]:
    """Why nothing shows what a joint does under torque."""
    action = "force along" if robot.prismatic[joint] else "torque on"

    def why_zero(parameter: int) -> str:
        return f"nothing in these data puts a {action} joint {joint + 1}, or no marker moves with it"

    return why_zero


def _positive(value: float, smallest: float) -> tuple[float, float]:
    """A positive number and its slope: the value itself above ``smallest``, smoothly towards zero below."""
    if value >= smallest:
        return value, 1.0
    reached = smallest**2 / (2.0 * smallest - value)
    return reached, (reached / smallest) ** 2


def _knee(binding: Binding, joint: int) -> tuple[float, bool]:
    """Knee of a joint, Nm or N, and whether it is fitted.

    Raises:
        InputError: Wrong options.
    """
    keys = ("knee_Nm", "knee_N")
    options = joint_options("joint_windup", (*keys, "fit_knee"), binding.options, joint)
    fitted = options.get("fit_knee", False)
    if not isinstance(fitted, bool):
        raise InputError(f"[model.joint_windup] fit_knee = {fitted!r}: true or false expected")
    key = keys[int(binding.robot.prismatic[joint])]
    if key not in options:
        return _usual_knee(binding.robot, joint), fitted
    return _above_zero(options, key), fitted


def _above_zero(options: Mapping[str, Any], key: str) -> float:
    value = options[key]
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number or value <= 0:
        raise InputError(f"[model.joint_windup] {key} = {value!r}: a number above 0 expected")
    return float(value)


def _usual_knee(robot: Robot, joint: int) -> float:
    """A tenth of the rated torque, else of what the rated payload does at the end of the stretched arm, else 100."""
    rated = float(robot.efforts[joint])
    if not math.isfinite(rated):
        lever = 1.0 if robot.prismatic[joint] else np.linalg.norm(robot.placements[joint + 1 :, :3, 3], axis=1).sum()
        rated = robot.payload * robot.gravity * float(lever)
    return _KNEE_SHARE * rated if math.isfinite(rated) and rated > 0.0 else _KNEE_UNKNOWN
