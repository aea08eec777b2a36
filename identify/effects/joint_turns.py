"""Effects of single joints that are no sum over pairs of springs: the joint turns (slides) by an angle of its own.

``displacement = sum_j D_j angle_j``; what differs between the effects is how the angle depends on torque and pose.
Such effects are of first order: torque and motion are those of the undeflected arm, also in equilibrium ``loaded``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene, Term
from identify.errors import InputError
from identify.robot import Robot
from identify.springs import link_turns
from identify.units import SI_OF

__all__ = ["JointTurn", "Turn", "axis_compliance", "borrowed_compliance", "joint_options", "joint_turns"]

#: ``(scene, values) -> (angle (S,), slopes (S, p + b))``, rad or m, slopes per unit.
Turn: TypeAlias = Callable[[Scene, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, eq=False)
class JointTurn:
    """How far an effect turns one joint.

    Attributes:
        joint: Number of the joint, from 0.
        parameters: Its p unknowns.
        turn: The angle and its slopes in every shot; values in units, own then borrowed.
        why_zero: Reason for a column of zeros.
        borrowed: Its b parameters of other effects.
        stops: Joint values (rad) at which alone it is defined, or None.
        linear: The angle is linear in the values.
    """

    joint: int
    parameters: tuple[Parameter, ...]
    turn: Turn
    why_zero: Callable[[int], str]
    borrowed: tuple[str, ...] = ()
    stops: Floats | None = None
    linear: bool = False


def joint_turns(name: str, parts: Sequence[JointTurn]) -> Effect:
    """The effect that turns some joints, one part a joint."""
    own = np.cumsum([0, *(len(part.parameters) for part in parts)])
    lent = own[-1] + np.cumsum([0, *(len(part.borrowed) for part in parts)])
    inputs = [np.r_[own[i] : own[i + 1], lent[i] : lent[i + 1]] for i in range(len(parts))]

    def twist(scene: Scene, values: Floats) -> Floats:
        twists = np.zeros((len(scene.experiment.shot_load), 6))
        for part, index in zip(parts, inputs, strict=True):
            angle, _ = part.turn(scene, values[index])
            twists += scene.turned(part.joint, angle)
        return twists

    def displacement(scene: Scene, values: Floats) -> Floats:
        return scene.carried(twist(scene, values))

    def derivative(scene: Scene, values: Floats) -> Floats:
        columns = np.zeros((len(scene.point), 3, lent[-1]))
        for part, index in zip(parts, inputs, strict=True):
            _, slopes = part.turn(scene, values[index])
            motion = scene.joints.motion[:, part.joint, :, None]
            columns[:, :, index] = motion * slopes[scene.experiment.row_shot, None]
        return columns

    def why_zero(parameter: int) -> str:
        number = int(np.searchsorted(own, parameter, side="right")) - 1
        return parts[number].why_zero(int(parameter - own[number]))

    return Effect(
        name,
        tuple(parameter for part in parts for parameter in part.parameters),
        displacement,
        derivative,
        why_zero,
        borrowed=tuple(name for part in parts for name in part.borrowed),
        linear=all(part.linear for part in parts),
        stops={part.joint: part.stops for part in parts if part.stops is not None},
        twist=twist,
    )


def joint_options(effect: str, allowed: tuple[str, ...], options: Mapping[str, Any], joint: int) -> dict[str, Any]:
    """The options of one joint: the common ones, overlaid with its own in ``[model.<effect>.j<i>]``.

    Args:
        effect: Name of the effect.
        allowed: Keys that exist.
        options: The table ``[model.<effect>]``.
        joint: Number of the joint, from 0.

    Raises:
        InputError: A key that does not exist.
    """
    tables = {key for key, value in options.items() if isinstance(value, Mapping) and re.fullmatch(r"j[1-9]\d*", key)}
    common = {key: value for key, value in options.items() if key not in tables}
    place = f"j{joint + 1}"
    found = {**common, **(options[place] if place in tables else {})}
    for key in found:
        if key not in allowed:
            raise InputError(f"[model.{effect}] {key}: unknown key; allowed: {', '.join(allowed)}")
    return found


def borrowed_compliance(effect: str, binding: Binding, joint: int) -> tuple[dict[str, float], float]:
    """The compliance of a joint for an effect that needs it; see `axis_compliance`.

    Raises:
        InputError: No other effect lets this joint yield.
    """
    shares, held = axis_compliance(binding.others, binding.robot, joint)
    if not shares and held == 0.0:
        place = f"j{joint + 1}"
        raise InputError(
            f"effect {effect}@{place}: nothing in this model lets joint {joint + 1} yield, so {effect} has nothing to "
            f"act on; add joint_compliance@{place}"
        )
    return shares, held


def axis_compliance(effects: tuple[Effect, ...], robot: Robot, joint: int) -> tuple[dict[str, float], float]:
    """What other effects add to the compliance about (along) the axis of a joint.

    Args:
        effects: The other effects.
        robot: The robot.
        joint: Number of the joint, from 0.

    Returns:
        Name of each parameter that takes part -> rad/Nm (m/N) per unit: the joint's own compliance, and the
        elements of the link that ends at this joint, projected on the axis; and the sum of what is held, in SI.
    """
    own = np.eye(robot.n)[joint]
    link = np.zeros(6 * (robot.n + 1))
    start = 6 * joint + (0 if robot.prismatic[joint] else 3)
    link[start : start + 3] = link_turns(robot)[joint, 2]
    along = {"joints": own, "links": link, "base": np.zeros(12), None: own}

    def share(effect: Effect, term: Term) -> float:
        twice = 2.0 if term.mutual and term.first != term.second else 1.0
        size = twice * along[effect.springs][term.first] * along[effect.springs][term.second]
        return float(size) * SI_OF[term.unit] if abs(size) > 1e-12 else 0.0

    shares = {term.name: share(effect, term) for effect in effects for term in effect.terms}
    held = sum(value * share(effect, term) for effect in effects for term, value in effect.held)
    return {name: size for name, size in shares.items() if size}, held
