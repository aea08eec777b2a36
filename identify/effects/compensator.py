"""Gravity compensator: a spring beside a joint that carries part of the arm's weight and adds stiffness.

Three descriptions, chosen by the option ``mode``:

* ``levels``: the joint has another compliance at each of some joint values, ``D_j t_j 1[q_j at level]``. Nothing is
  assumed about the spring, but its static torque is not described: use it for changes under load.
* ``spring``: a coil spring of known geometry (`identify.gravity_spring`). The joint of compliance c then turns by

      (t - M(q)) c / (1 + c k(q))          in place of c t,

  with M the spring's torque and k its stiffness, both linear in ``K_c`` and ``K_c s_0``. What the effect adds is the
  difference of the two, so at ``K_c = 0`` it adds nothing. M loads the joint in every reading, the unloaded ones
  too, and shows in absolute readings only; k shows in changes under load. The compliance c belongs to other effects
  (`joint_compliance`, and the elements of `link_compliance` about this axis); the effect borrows it.
* ``harmonics``: a spring of unknown geometry, acting in the same way, with

      M(q) = sum_n (a_n sin n q + b_n cos n q)        k(q) = dM/dq = sum_n n (a_n cos n q - b_n sin n q)

  Three orders follow the coil spring of a heavy arm to 0.2 % of its largest torque over the range of joint 2, to 1.2 %
  over a whole turn. A constant part of M is left out: it turns the joint by the same angle everywhere, which is a
  zero offset (`geometry`).

Several springs act side by side: their M and k add up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene
from identify.effects.compensator_options import (
    SpringOptions,
    mode_of,
    options_of,
    read_levels,
    read_orders,
    read_springs,
)
from identify.effects.compliance import LIMIT
from identify.effects.joint_turns import JointTurn, Turn, borrowed_compliance, joint_turns
from identify.effects.places import joint_places
from identify.errors import InputError
from identify.gravity_spring import SpringGeometry, harmonic_basis, spring_basis, spring_slopes
from identify.units import DEG, MM, SI_OF, URAD

__all__ = ["gravity_compensator", "nearest_level"]

NAME = "gravity_compensator"
SPRING_LIMIT = {"N/mm": 1e4, "N": 1e7, "mm": 1e3}  # some ten times a heavy robot's spring
PLAUSIBLE_TORQUE, TYPICAL_TORQUE = 2e4, 1e3  # Nm: the largest arms hold some 20 kNm in joint 2

#: ``(torque (S,), q (S,), values) -> (angle (S,), slopes (S, p + b))``, Nm and rad, slopes per unit.
TorqueTurn: TypeAlias = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
#: ``(q (S,), values) -> (M and k (2, S), slopes (2, S, p))``, Nm and Nm/rad, slopes per unit.
Field: TypeAlias = Callable[[Floats, Floats], tuple[Floats, Floats]]


def gravity_compensator(binding: Binding) -> Effect:
    """Spring beside a turning joint (default: joint 2), by levels, as a spring or by harmonics, see the module.

    Parameters ``gravity_compensator.j<i>.<component>``: ``l1 ...`` (urad/Nm), the change of compliance at each level;
    or ``k_c`` (N/mm), ``k_c_s0`` (N, absent where ``s0_mm`` is given) and with ``fit_geometry`` also ``a_x``, ``a_y``
    and ``radius`` (mm); of several springs ``s1_k_c ...``; or ``s<n>`` and ``c<n>`` (Nm), the sine and cosine part
    of its torque of order n. Typical of a 270 kg arm: 100 N/mm at a radius of 180 mm, a torque of some kNm (mm in
    absolute readings) and a change of stiffness below some per cent.

    Options: see `identify.effects.compensator_options`.

    Args:
        binding: Robot, places, options and the effects that own the joints' compliance.

    Raises:
        InputError: A joint that does not exist or slides, wrong options, or a spring on a joint without compliance.
    """
    robot = binding.robot
    joints = joint_places(NAME, robot, binding.where or ("j2",))
    for joint in joints:
        if robot.prismatic[joint]:
            raise InputError(f"effect {NAME}@j{joint + 1}: joint {joint + 1} slides; the spring turns with a joint")
    return joint_turns(NAME, [_part(binding, joint) for joint in joints])


def _part(binding: Binding, joint: int) -> JointTurn:
    """The compensator of one joint, as its options say."""
    options = options_of(binding.options, joint)
    mode = mode_of(options)
    if mode == "levels":
        return _levels(joint, *read_levels(options))
    return _springs(binding, joint, read_springs(options)) if mode == "spring" else _harmonics(binding, joint, options)


def _at(joint: int, turn: TorqueTurn) -> Turn:
    """The turn of a joint, given by its torque and its value."""

    def in_scene(scene: Scene, values: Floats) -> tuple[Floats, Floats]:
        experiment = scene.experiment
        return turn(scene.joint_torque[:, joint], experiment.q[experiment.shot_pose, joint], values)

    return in_scene


# --- levels


def nearest_level(levels: Floats, q: Floats, tolerance: float = np.inf) -> np.ndarray:
    """Index of the level nearest to each joint value ``q`` (S,), rad.

    Raises:
        InputError: A joint value is further than ``tolerance`` (rad) from every level.
    """
    distance = np.abs(q[:, None] - levels)
    index = distance.argmin(axis=1)
    far = np.flatnonzero(distance.min(axis=1) > tolerance)
    if len(far):
        listed = ", ".join(f"{level:.6g}" for level in levels / DEG)
        raise InputError(
            f"[model.{NAME}] tolerance_deg = {tolerance / DEG:g}: a pose has {q[far[0]] / DEG:.6g} deg, levels_deg are "
            f"{listed}; add its level, or leave tolerance_deg out to take the nearest"
        )
    return np.asarray(index)


def _levels(joint: int, levels: Floats, tolerance: float) -> JointTurn:
    """One change of compliance per level; a pose belongs to the nearest level."""
    parameters = tuple(
        Parameter(f"{NAME}.j{joint + 1}.l{i + 1}", "urad/Nm", URAD, limit=LIMIT) for i in range(len(levels))
    )

    def turn(torque: Floats, q: Floats, values: Floats) -> tuple[Floats, Floats]:
        at = nearest_level(levels, q, tolerance)[:, None] == np.arange(len(levels))
        slopes = URAD * torque[:, None] * at
        return slopes @ values, slopes

    def why_zero(parameter: int) -> str:
        return (
            f"no pose of these data is nearest to the level {levels[parameter] / DEG:g} deg of joint {joint + 1}, "
            "or no load puts a torque on this joint there"
        )

    return JointTurn(joint, parameters, _at(joint, turn), why_zero, stops=levels, linear=True)


# --- springs


def _springs(binding: Binding, joint: int, springs: tuple[SpringOptions, ...]) -> JointTurn:
    """Springs of known or fitted geometry beside one joint."""
    several = len(springs) > 1
    sets = [_parameters(joint, spring, f"s{i + 1}_" if several else "") for i, spring in enumerate(springs)]
    ends = np.cumsum([0, *map(len, sets)])

    def field(q: Floats, values: Floats) -> tuple[Floats, Floats]:
        total, slopes = np.zeros((2, len(q))), np.zeros((2, len(q), ends[-1]))
        for i, spring in enumerate(springs):
            added, slopes[:, :, ends[i] : ends[i + 1]] = _field(spring, q, values[ends[i] : ends[i + 1]])
            total += added
        return total, slopes

    return _beside(binding, joint, tuple(p for group in sets for p in group), field, sets[0][0].name)


def _beside(
    binding: Binding, joint: int, parameters: tuple[Parameter, ...], field: Field, needed: str | None = None
) -> JointTurn:
    """What a torque M and its stiffness k do to a joint that yields.

    Args:
        binding: Robot and the effects that own the joint's compliance.
        joint: Number of the joint.
        parameters: The p unknowns of the field.
        field: M and k.
        needed: Name of the parameter without which the other columns are zero.
    """
    shares, held = borrowed_compliance(NAME, binding, joint)
    weights, own_count = np.array(list(shares.values())), len(parameters)

    def turn(torque: Floats, q: Floats, values: Floats) -> tuple[Floats, Floats]:
        compliance = held + float(weights @ values[own_count:])
        (moment, stiffness), slopes = field(q, values[:own_count])
        gain = 1.0 / (1.0 + compliance * stiffness)
        rest = torque - moment
        yielded = compliance * gain
        own = -yielded[:, None] * (slopes[0] + (yielded * rest)[:, None] * slopes[1])
        lent = (gain**2 * rest - torque)[:, None] * weights
        return yielded * rest - compliance * torque, np.hstack([own, lent])

    def why_zero(parameter: int) -> str:
        wanted = " and ".join([*list(shares)[:1], *([needed] if needed else [])])
        zero = "is rigid or its spring constant zero" if needed else "is rigid"
        return f"at the values it was computed for, joint {joint + 1} {zero}; state {wanted} under [model.nominal]"

    return JointTurn(joint, parameters, _at(joint, turn), why_zero, tuple(shares))


def _parameters(joint: int, spring: SpringOptions, prefix: str) -> tuple[Parameter, ...]:
    """Unknowns of one spring: its constant, constant times free length, geometry."""
    wanted = [("k_c", "N/mm", 0.0)]
    if spring.free_length is None:
        wanted.append(("k_c_s0", "N", 0.0))
    if spring.fitted:
        place = spring.geometry
        wanted += [("a_x", "mm", place.a_x / MM), ("a_y", "mm", place.a_y / MM), ("radius", "mm", place.radius / MM)]
    return tuple(
        Parameter(f"{NAME}.j{joint + 1}.{prefix}{name}", unit, SI_OF[unit], nominal, limit=SPRING_LIMIT[unit])
        for name, unit, nominal in wanted
    )


def _field(spring: SpringOptions, q: Floats, values: Floats) -> tuple[Floats, Floats]:
    """M and k of one spring, (2, S) in Nm and Nm/rad, and their slopes (2, S, p) per unit of its parameters."""
    newton = SI_OF["N/mm"]
    geometry = SpringGeometry(*(values[-3:] * MM)) if spring.fitted else spring.geometry
    if spring.free_length is None:
        force, by_force = np.array([newton * values[0], values[1]]), np.diag([newton, 1.0])
    else:
        by_force = newton * np.array([[1.0], [spring.free_length]])
        force = by_force[:, 0] * values[0]
    basis = spring_basis(geometry, q)
    slopes = basis @ by_force
    if spring.fitted:
        slopes = np.concatenate([slopes, MM * np.einsum("kvfg,f->kvg", spring_slopes(geometry, q), force)], axis=2)
    return basis @ force, slopes


# --- harmonics


def _harmonics(binding: Binding, joint: int, options: Mapping[str, Any]) -> JointTurn:
    """A spring whose torque is a sum of sines and cosines of the joint value."""
    orders = read_orders(options)
    parameters = tuple(
        Parameter(
            f"{NAME}.j{joint + 1}.{kind}{order}",
            "Nm",
            SI_OF["Nm"],
            limit=PLAUSIBLE_TORQUE,
            plausible=PLAUSIBLE_TORQUE,
            typical=TYPICAL_TORQUE,
        )
        for order in orders
        for kind in "sc"
    )

    def field(q: Floats, values: Floats) -> tuple[Floats, Floats]:
        basis = harmonic_basis(orders, q)
        return basis @ values, basis

    return _beside(binding, joint, parameters, field)
