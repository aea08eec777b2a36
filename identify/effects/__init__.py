"""Physical causes, one registry: a new cause is one new file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from identify.effects.base import Binding, Effect, Fields, Parameter, Scene, SpringSet, build_scene
from identify.effects.compensator import gravity_compensator
from identify.effects.compliance import joint_compliance, link_compliance
from identify.effects.geometry import geometry
from identify.effects.instrument import marker_seating, tracker_drift, tracker_scale, tracker_step
from identify.effects.joint_errors import approach_hysteresis, transmission_error, wrist_coupling
from identify.effects.link_mass import link_mass
from identify.effects.loading import force_sensor_bias, load_com, load_direction, load_level, load_scale
from identify.effects.nonlinear import backlash, joint_hardening, joint_windup, stiction
from identify.effects.special_compliance import base_compliance, joint_cross_compliance, tool_compliance
from identify.effects.thermal import thermal_growth
from identify.errors import InputError
from identify.loads import LoadCase, Markers
from identify.robot import Robot

__all__ = ["REGISTRY", "Binding", "Effect", "Fields", "Parameter", "Scene", "SpringSet", "bind_effects", "build_scene"]

#: Name of an effect -> how it is bound to a robot.
REGISTRY: dict[str, Callable[[Binding], Effect]] = {
    "backlash": backlash,
    "approach_hysteresis": approach_hysteresis,
    "base_compliance": base_compliance,
    "force_sensor_bias": force_sensor_bias,
    "geometry": geometry,
    "gravity_compensator": gravity_compensator,
    "joint_compliance": joint_compliance,
    "joint_cross_compliance": joint_cross_compliance,
    "joint_hardening": joint_hardening,
    "joint_windup": joint_windup,
    "link_compliance": link_compliance,
    "link_mass": link_mass,
    "load_com": load_com,
    "load_direction": load_direction,
    "load_level": load_level,
    "load_scale": load_scale,
    "stiction": stiction,
    "marker_seating": marker_seating,
    "thermal_growth": thermal_growth,
    "tool_compliance": tool_compliance,
    "tracker_drift": tracker_drift,
    "tracker_scale": tracker_scale,
    "tracker_step": tracker_step,
    "transmission_error": transmission_error,
    "wrist_coupling": wrist_coupling,
}
#: Effects that borrow parameters of others, and therefore are bound after them.
BORROWERS = ("gravity_compensator", "stiction")


def bind_effects(
    names: tuple[str, ...],
    robot: Robot,
    *,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    flange: bool = False,
    loads: tuple[LoadCase, ...] = (),
    markers: Markers | None = None,
    others: tuple[Effect, ...] = (),
) -> tuple[Effect, ...]:
    """Bind a study's list of effects to a robot; entries ``name`` or ``name@where``.

    Args:
        names: The list, any order; places of one effect are joined.
        robot: The robot.
        options: Options by effect name.
        flange: The flange has geometric errors of its own (marker positions are exact).
        loads: The load cases of the study.
        markers: Its markers.
        others: Effects that are bound already and that these may lean on.

    Raises:
        InputError: An effect that does not exist, a place it cannot have, or a wrong option.
    """
    places: dict[str, list[str]] = {}
    for entry in names:
        name, _, where = entry.partition("@")
        if name not in REGISTRY:
            raise InputError(f"effect {entry!r} is not available; allowed are {', '.join(sorted(REGISTRY))}")
        places.setdefault(name, []).append(where)
    given = options or {}
    bound: dict[str, Effect] = {}
    for name in sorted(places, key=lambda name: name in BORROWERS):
        chosen = () if "" in places[name] else tuple(places[name])
        beside = (*others, *bound.values())
        bound[name] = REGISTRY[name](
            Binding(robot, chosen, given.get(name, {}), flange, beside, loads=loads, markers=markers)
        )
    return tuple(bound[name] for name in places)
