"""Joints that are not where their encoders say: gear errors, geared wrists, play of the drive train.

All displace the markers by ``D_j e_j``, the motion of the marker per unit of joint j times the error of the joint.
They act alike in loaded and unloaded readings of one visit, so changes between loads do not show them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Scene
from identify.effects.direct import HIDDEN, turning_effect, unknown_of
from identify.effects.options import check_keys, is_number
from identify.effects.places import joint_pair, joint_places, turning_places
from identify.errors import InputError
from identify.robot import Robot
from identify.units import DEG

__all__ = ["approach_hysteresis", "transmission_error", "usual_pairs", "wrist_coupling"]

_ORDERS = (1.0, 2.0)
_WAVES = ("sin", "cos")
_UNLIMITED = 2 * np.pi  # a joint without known limits turns this far to both sides
_SPACING = (0.05, 180.0)  # deg
_SHOWN = 8  # knots in a message
_WRIST = 6  # arms of so many joints have a wrist of the last three


@dataclass(frozen=True, eq=False)
class _Curve:
    """The error of one joint over its value, as a sum of known functions.

    Attributes:
        joint: Its number, from 0.
        components: (k,) names of the functions.
        zeros: (k,) where each of them is zero, in words.
        shares: ``q (C,) -> (C, k)`` the functions, rad to 1.
        error: ``q (C,), sizes (k,) -> (C,)`` their sum, which needs no table of all of them.
    """

    joint: int
    components: tuple[str, ...]
    zeros: tuple[str, ...]
    shares: Callable[[Floats], Floats]
    error: Callable[[Floats, Floats], Floats]


_GEARS, _SMALL_GEARS = 350.0, 1000.0  # urad, largest plausible transmission error of heavy and of small arms
_SMALL_ARM = 20.0  # kg of rated payload


def transmission_error(binding: Binding) -> Effect:
    """Error of the gears over a turn of the joint: ``D_j e_j(q_j)``.

    Harmonics, ``e = sum_m s_m sin(m q) + c_m cos(m q)`` with m cycles a turn of the joint: parameters
    ``transmission_error.j<i>.s<m>, .c<m>``, urad. Or a free curve, linear between knots and constant beyond, at equal
    distances from the lower limit of the joint on (-360 to 360 deg where a limit is unknown) or at stated values:
    parameters ``transmission_error.j<i>.k<index>``, urad, the error at each knot, counted from 0. Its mean would be an
    offset of the joint, which belongs to `geometry` (and to frame and markers for the outer joints); so the middle
    one of the knots is held at zero and has no parameter. Typical: 50 to 300 urad of one and two cycles a turn
    (eccentricity); plausible up to 350 urad, of arms that carry no more than 20 kg (strain wave gears) up to 1000 urad.

    Options: ``orders = [1, 2]`` (default; any positive numbers, 101 for a gear of that ratio), ``knots_deg = 2.0``
    (distance of the knots) or ``knots_deg = [-90, -60, 0]`` (the knots, ascending); both together add up. A table
    ``[model.transmission_error.j3]`` replaces both for a joint.

    Args:
        binding: Robot, places ``j1 ... jn`` (joints that turn; all of them by default) and options.

    Raises:
        InputError: A place that is no turning joint, or wrong options.
    """
    name, robot = "transmission_error", binding.robot
    joints = turning_places(name, robot, binding.where)
    curves = [_curve(robot, joint, _options_of(robot, joint, binding.options)) for joint in joints]
    plausible = _SMALL_GEARS if robot.payload <= _SMALL_ARM else _GEARS
    parameters = tuple(
        unknown_of(f"{name}.j{curve.joint + 1}.{c}", "urad", plausible=plausible, typical=100.0)
        for curve in curves
        for c in curve.components
    )
    joint = np.repeat(joints, [len(curve.components) for curve in curves])

    def shares(scene: Scene) -> Floats:
        q = scene.experiment.q
        by_pose = np.hstack([curve.shares(q[:, curve.joint]) for curve in curves])
        return np.asarray(by_pose[scene.row_pose])

    zeros = [zero for curve in curves for zero in curve.zeros]
    scale = np.array([parameter.scale for parameter in parameters])
    ends = np.cumsum([len(curve.components) for curve in curves])[:-1]

    def displacement(scene: Scene, values: Floats) -> Floats:
        q, motion, sizes = scene.experiment.q, scene.joints.motion, np.split(scale * values, ends)
        moved = np.zeros_like(scene.point)
        for curve, own in zip(curves, sizes, strict=True):
            moved += motion[:, curve.joint] * curve.error(q[:, curve.joint], own)[scene.row_pose, None]
        return moved

    def why_zero(parameter: int) -> str:
        return f"{zeros[parameter]}, no marker moves with this joint, {HIDDEN}"

    return replace(turning_effect(name, parameters, joint, shares, why_zero), displacement=displacement)


def wrist_coupling(binding: Binding) -> Effect:
    """Wrist axes that are geared together: turning joint a also turns joint b by a share, ``D_b q_a k``.

    Parameters ``wrist_coupling.j<a>-j<b>``, mrad/rad. Typical: 0.1 to 1 mrad/rad, where the controller's compensation
    of the coupling is not exact.

    Args:
        binding: Robot and places ``j<a>-j<b>`` with a < b. By default the three pairs of the last three joints of an
            arm with six or more, else neighbouring pairs.

    Raises:
        InputError: A place that is no pair of turning joints, or options.
    """
    name, robot = "wrist_coupling", binding.robot
    check_keys(name, binding.options)
    pairs = _pairs(name, robot, binding.where)
    parameters = tuple(
        unknown_of(f"{name}.j{a + 1}-j{b + 1}", "mrad/rad", plausible=3.0, typical=0.5) for a, b in pairs
    )
    turned, joint = np.array(pairs).T

    def shares(scene: Scene) -> Floats:
        return np.asarray(scene.experiment.q[:, turned][scene.row_pose])

    def why_zero(parameter: int) -> str:
        a, b = pairs[parameter]
        return f"joint {a + 1} is at zero in every pose of these data, no marker moves with joint {b + 1}, {HIDDEN}"

    return turning_effect(name, parameters, joint, shares, why_zero)


def approach_hysteresis(binding: Binding) -> Effect:
    """A joint stops short on the side it comes from: ``D_j h_j d_j``, d = -1, 0 or 1 the sign of its last motion.

    Parameters ``approach_hysteresis.j<i>``, urad (um if sliding): half the distance between both approaches. The signs
    stand in the columns ``approach1 ...`` of the readings; without them nothing is displaced. Typical: 20 to 100 urad.

    Args:
        binding: Robot and places ``j1 ... jn``; all by default.

    Raises:
        InputError: A place that is no joint, or options.
    """
    name, robot = "approach_hysteresis", binding.robot
    check_keys(name, binding.options)
    joint = np.array(joint_places(name, robot, binding.where))
    units = ["um" if robot.prismatic[j] else "urad" for j in joint]
    parameters = tuple(
        unknown_of(f"{name}.j{j + 1}", unit, plausible=350.0, typical=50.0)
        for j, unit in zip(joint, units, strict=True)
    )

    def shares(scene: Scene) -> Floats:
        experiment = scene.experiment
        if experiment.approach is None:
            return np.zeros((len(scene.point), len(joint)))
        return np.asarray(experiment.approach[:, joint][experiment.row_visit])

    def why_zero(parameter: int) -> str:
        j = joint[parameter] + 1
        return (
            f"the data have no columns approach1 ... approach{robot.n}, column approach{j} holds zeros, "
            f"no marker moves with joint {j}, {HIDDEN}"
        )

    return turning_effect(name, parameters, joint, shares, why_zero)


def _options_of(robot: Robot, joint: int, options: Mapping[str, Any]) -> Mapping[str, Any]:
    """The options of one joint: its own table, else the common ones."""
    keys, own = ("orders", "knots_deg"), tuple(f"j{j + 1}" for j in range(robot.n))
    check_keys("transmission_error", options, *keys, *own)
    for place in own:
        table = options.get(place, {})
        if not isinstance(table, Mapping):
            raise InputError(
                f"[model.transmission_error] {place} = {table!r}: a table with orders or knots_deg expected"
            )
        check_keys(f"transmission_error.{place}", table, *keys)
    found: Mapping[str, Any] = options.get(f"j{joint + 1}", options)
    return found


def _curve(robot: Robot, joint: int, options: Mapping[str, Any]) -> _Curve:
    """Harmonics, free curve, or their sum."""
    orders = _orders(options) if "orders" in options or "knots_deg" not in options else ()
    waves = [f"{wave[0]}{order:.12g}" for order in orders for wave in _WAVES]
    knots = _knots(robot, joint, options["knots_deg"]) if "knots_deg" in options else np.zeros(1)
    free = np.delete(np.arange(len(knots)), (len(knots) - 1) // 2)

    def harmonics(q: Floats) -> Floats:
        phase = np.outer(q, orders)
        return np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(q), -1)

    def shares(q: Floats) -> Floats:
        return np.hstack([harmonics(q), _hats(knots, q)[:, free]]) if len(free) else harmonics(q)

    def error(q: Floats, sizes: Floats) -> Floats:
        at_knots = np.zeros(len(knots))
        at_knots[free] = sizes[len(waves) :]
        summed: Floats = harmonics(q) @ sizes[: len(waves)] + np.interp(q, knots, at_knots)
        return summed

    names = (*waves, *(f"k{index}" for index in free))
    at_zero = [
        f"{wave}({order:.12g} q{joint + 1}) is zero in every pose of these data" for order in orders for wave in _WAVES
    ]
    nowhere = (f"no pose of these data has joint {joint + 1} near {knot:.4g} deg" for knot in knots[free] / DEG)
    return _Curve(joint, names, (*at_zero, *nowhere), shares, error)


def _orders(options: Mapping[str, Any]) -> tuple[float, ...]:
    """The option ``orders``.

    Raises:
        InputError: It is no list of different positive numbers.
    """
    given = options.get("orders", _ORDERS)
    listed = isinstance(given, list | tuple) and bool(given) and all(is_number(m) and 0 < m < np.inf for m in given)
    if not listed or len({f"{float(m):.12g}" for m in given}) < len(given):
        raise InputError(
            f"[model.transmission_error] orders = {given!r}: a list of different positive numbers (cycles a turn of "
            "the joint) expected, for example [1, 2]"
        )
    return tuple(float(m) for m in given)


def _knots(robot: Robot, joint: int, given: object) -> Floats:
    """Knots of a joint, ascending, rad: the stated ones, or equal distances over its range.

    Raises:
        InputError: No ascending numbers, no number, or a distance out of all proportion.
    """
    least, most = _SPACING
    if isinstance(given, list | tuple):
        return _stated_knots(given)
    if not is_number(given) or not least <= float(given) <= most:  # type: ignore[arg-type]
        raise InputError(
            f"[model.transmission_error] knots_deg = {given!r}: a distance of {least:g} to {most:g} deg, or a list of "
            "ascending joint values, expected"
        )
    step = float(given) * DEG  # type: ignore[arg-type]
    limits = robot.lower[joint], robot.upper[joint]
    lower, upper = limits if np.isfinite(limits).all() else (-_UNLIMITED, _UNLIMITED)
    count = max(int(np.ceil((upper - lower) / step - 1e-9)), 1)
    return np.asarray(lower + step * np.arange(count + 1), dtype=np.float64)


def _stated_knots(given: list[Any] | tuple[Any, ...]) -> Floats:
    """Knots at stated joint values, rad.

    Raises:
        InputError: Fewer than two, or not ascending by the smallest distance that knots may have.
    """
    numbers = all(is_number(value) and np.isfinite(float(value)) for value in given)
    knots = np.array([float(value) for value in given] if numbers else [], dtype=np.float64)
    if len(knots) < 2 or np.diff(knots).min() < _SPACING[0] - 1e-9:
        raise InputError(
            f"[model.transmission_error] knots_deg = {_shortened(given)}: two or more joint values expected, ascending "
            f"by at least {_SPACING[0]:g} deg, for example [-90, -60, 0]"
        )
    return knots * DEG


def _shortened(given: list[Any] | tuple[Any, ...]) -> str:
    """A list as text, long ones without their middle."""
    return repr(list(given)) if len(given) <= _SHOWN else f"[{given[0]!r}, {given[1]!r}, ..., {given[-1]!r}]"


def _hats(knots: Floats, q: Floats) -> Floats:
    """(C, k) functions that are 1 at one knot, 0 at the others and linear between; their sum is 1 everywhere."""
    left = np.clip(np.searchsorted(knots, q, side="right") - 1, 0, len(knots) - 2)
    share = np.clip((q - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)
    hats, row = np.zeros((len(q), len(knots))), np.arange(len(q))
    hats[row, left], hats[row, left + 1] = 1.0 - share, share
    return hats


def usual_pairs(robot: Robot) -> list[tuple[int, int]]:
    """Pairs of turning joints that may be geared together: of the last three of a long arm, else neighbours."""
    joints = range(robot.n)
    usual = combinations(joints[-3:], 2) if robot.n >= _WRIST else pairwise(joints)
    return [pair for pair in usual if not robot.prismatic[list(pair)].any()]


def _pairs(name: str, robot: Robot, where: tuple[str, ...]) -> list[tuple[int, int]]:
    """Pairs of turning joints of the given places, or the default ones."""
    if where:
        pairs = [joint_pair(name, robot, place) for place in dict.fromkeys(where)]
        for pair in pairs:
            turning_places(name, robot, tuple(f"j{joint + 1}" for joint in pair))
        return pairs
    pairs = usual_pairs(robot)
    if not pairs:
        raise InputError(f"effect {name}: robot {robot.name} has no such pair of turning joints; leave the effect out")
    return pairs
