"""Gravity compensator: a spring beside a joint that carries part of the arm's weight and adds stiffness.

Two descriptions, chosen by the option ``mode``:

* ``levels``: the joint has another compliance at each of some joint values, ``D_j t_j 1[q_j at level]``. Nothing is
  assumed about the spring, but its static torque is not described: use it for changes under load.
* ``spring``: a coil spring of known geometry (`identify.gravity_spring`). The joint of compliance c then turns by

      (t - M(q)) c / (1 + c k(q))          in place of c t,

  with M the spring's torque and k its stiffness, both linear in ``K_c`` and ``K_c s_0``. What the effect adds is the
  difference of the two, so at ``K_c = 0`` it adds nothing. M loads the joint in every reading, the unloaded ones
  too, and shows in absolute readings only; k shows in changes under load. The compliance c belongs to other effects
  (`joint_compliance`, and the elements of `link_compliance` about this axis); the effect borrows it.

Several springs act side by side: their M and k add up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene, Term
from identify.effects.compensator_options import SpringOptions, mode_of, options_of, read_levels, read_springs
from identify.effects.compliance import LIMIT
from identify.effects.places import joint_places
from identify.errors import InputError
from identify.gravity_spring import SpringGeometry, spring_basis, spring_slopes
from identify.robot import Robot
from identify.springs import link_turns
from identify.units import DEG, MM, SI_OF, URAD

__all__ = ["axis_compliance", "gravity_compensator", "nearest_level"]

NAME = "gravity_compensator"
SPRING_LIMIT = {"N/mm": 1e4, "N": 1e7, "mm": 1e3}  # some ten times a heavy robot's spring

#: ``(torque (S,), q (S,), values) -> (angle (S,), slopes (S, p + b))``, Nm and rad, slopes per unit.
Turn: TypeAlias = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, eq=False)
class _Part:
    """The compensator of one joint: how far it turns the joint more than the other effects say.

    Attributes:
        joint: Number of the joint, from 0.
        parameters: Its p unknowns.
        borrowed: Its b parameters of other effects.
        turn: The angle and its slopes; values in units, own then borrowed.
        why_zero: Reason for a column of zeros.
    """

    joint: int
    parameters: tuple[Parameter, ...]
    borrowed: tuple[str, ...]
    turn: Turn
    why_zero: Callable[[int], str]
    levels: Floats | None = None


def gravity_compensator(binding: Binding) -> Effect:
    """Spring beside a turning joint (default: joint 2), by levels or as a spring, see the module.

    Parameters ``gravity_compensator.j<i>.<component>``: ``l1 ...`` (urad/Nm), the change of compliance at each level;
    or ``k_c`` (N/mm), ``k_c_s0`` (N, absent where ``s0_mm`` is given) and with ``fit_geometry`` also ``a_x``, ``a_y``
    and ``radius`` (mm); of several springs ``s1_k_c ...``. Typical of a 270 kg arm: 100 N/mm at a radius of 180 mm,
    a torque of some kNm (mm in absolute readings) and a change of stiffness below some per cent.

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
    parts = tuple(_part(binding, joint) for joint in joints)
    own = np.cumsum([0, *(len(part.parameters) for part in parts)])
    lent = own[-1] + np.cumsum([0, *(len(part.borrowed) for part in parts)])
    inputs = [np.r_[own[i] : own[i + 1], lent[i] : lent[i + 1]] for i in range(len(parts))]

    def displacement(scene: Scene, values: Floats) -> Floats:
        moved = np.zeros_like(scene.point)
        for part, index in zip(parts, inputs, strict=True):
            angle, _ = _turn(part, scene, values[index])
            moved += scene.turned(part.joint, angle)
        return moved

    def derivative(scene: Scene, values: Floats) -> Floats:
        columns = np.zeros((len(scene.point), 3, lent[-1]))
        for part, index in zip(parts, inputs, strict=True):
            _, slopes = _turn(part, scene, values[index])
            motion = scene.joints.motion[:, part.joint, :, None]
            columns[:, :, index] = motion * slopes[scene.experiment.row_shot, None]
        return columns

    def why_zero(parameter: int) -> str:
        number = int(np.searchsorted(own, parameter, side="right")) - 1
        return parts[number].why_zero(int(parameter - own[number]))

    return Effect(
        NAME,
        tuple(parameter for part in parts for parameter in part.parameters),
        displacement,
        derivative,
        why_zero,
        borrowed=tuple(name for part in parts for name in part.borrowed),
        linear=all(part.levels is not None for part in parts),
        stops={part.joint: part.levels for part in parts if part.levels is not None},
    )


def _turn(part: _Part, scene: Scene, values: Floats) -> tuple[Floats, Floats]:
    """Angle and slopes of a part in every shot."""
    experiment, joint = scene.experiment, part.joint
    return part.turn(scene.joint_torque[:, joint], experiment.q[experiment.shot_pose, joint], values)


def _part(binding: Binding, joint: int) -> _Part:
    """The compensator of one joint, as its options say."""
    options = options_of(binding.options, joint)
    if mode_of(options) == "levels":
        return _levels(joint, *read_levels(options))
    return _springs(binding, joint, read_springs(options))


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


def _levels(joint: int, levels: Floats, tolerance: float) -> _Part:
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

    return _Part(joint, parameters, (), turn, why_zero, levels)


# --- springs


def _springs(binding: Binding, joint: int, springs: tuple[SpringOptions, ...]) -> _Part:
    """Springs of known or fitted geometry beside one joint."""
    shares, held = axis_compliance(binding.others, binding.robot, joint)
    if not shares and held == 0.0:
        raise InputError(
            f"effect {NAME}@j{joint + 1}: nothing in this model lets joint {joint + 1} yield, so a spring beside it "
            f"has nothing to act on; add joint_compliance@j{joint + 1}"
        )
    weights = np.array(list(shares.values()))
    several = len(springs) > 1
    sets = [_parameters(joint, spring, f"s{i + 1}_" if several else "") for i, spring in enumerate(springs)]
    ends = np.cumsum([0, *map(len, sets)])

    def turn(torque: Floats, q: Floats, values: Floats) -> tuple[Floats, Floats]:
        compliance = held + float(weights @ values[ends[-1] :])
        field, slopes = np.zeros((2, len(q))), np.zeros((2, len(q), ends[-1]))
        for i, spring in enumerate(springs):
            added, slopes[:, :, ends[i] : ends[i + 1]] = _field(spring, q, values[ends[i] : ends[i + 1]])
            field += added
        gain = 1.0 / (1.0 + compliance * field[1])
        rest = torque - field[0]
        yielded = compliance * gain
        own = -yielded[:, None] * (slopes[0] + (yielded * rest)[:, None] * slopes[1])
        lent = (gain**2 * rest - torque)[:, None] * weights
        return yielded * rest - compliance * torque, np.hstack([own, lent])

    def why_zero(parameter: int) -> str:
        wanted = " and ".join([*list(shares)[:1], sets[0][0].name])
        return (
            f"at the values it was computed for, joint {joint + 1} is rigid or its spring constant zero; state "
            f"{wanted} under [model.nominal]"
        )

    return _Part(joint, tuple(p for group in sets for p in group), tuple(shares), turn, why_zero)


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


def axis_compliance(effects: tuple[Effect, ...], robot: Robot, joint: int) -> tuple[dict[str, float], float]:
    """What other effects add to the compliance about the axis of a joint.

    Args:
        effects: The other effects.
        robot: The robot.
        joint: Number of the joint, from 0.

    Returns:
        Name of each parameter that takes part -> rad/Nm per unit: the joint's own compliance, and the turning
        elements of the link that ends at this joint, projected on the axis; and the sum of what is held, rad/Nm.
    """
    own = np.eye(robot.n)[joint]
    link = np.zeros(6 * (robot.n + 1))
    link[6 * joint + 3 : 6 * joint + 6] = link_turns(robot)[joint, 2]
    along = {"joints": own, "links": link, "base": np.zeros(12), None: own}

    def share(effect: Effect, term: Term) -> float:
        twice = 2.0 if term.mutual and term.first != term.second else 1.0
        size = twice * along[effect.springs][term.first] * along[effect.springs][term.second]
        return float(size) * SI_OF[term.unit] if abs(size) > 1e-12 else 0.0

    shares = {term.name: share(effect, term) for effect in effects for term in effect.terms}
    held = sum(value * share(effect, term) for effect in effects for term, value in effect.held)
    return {name: size for name, size in shares.items() if size}, held
