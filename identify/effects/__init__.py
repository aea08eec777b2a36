"""Physical causes, one registry: a new cause is one new file and one line here."""

from __future__ import annotations

from collections.abc import Callable

from identify.effects.base import Effect, Parameter, Scene, build_scene
from identify.effects.compliance import joint_compliance, link_compliance
from identify.effects.geometry import geometry
from identify.errors import InputError
from identify.robot import Robot

__all__ = ["REGISTRY", "Effect", "Parameter", "Scene", "bind_effects", "build_scene"]

#: Name of an effect -> ``bind(robot, where, flange)``.
REGISTRY: dict[str, Callable[[Robot, tuple[str, ...], bool], Effect]] = {
    "joint_compliance": lambda robot, where, flange: joint_compliance(robot, where),
    "link_compliance": lambda robot, where, flange: link_compliance(robot, where),
    "geometry": lambda robot, where, flange: geometry(robot, where, flange=flange),
}


def bind_effects(names: tuple[str, ...], robot: Robot, *, flange: bool = False) -> tuple[Effect, ...]:
    """Bind a study's list of effects to a robot; entries ``name`` or ``name@where``.

    Args:
        names: The list, any order; places of one effect are joined.
        robot: The robot.
        flange: The flange has geometric errors of its own (marker positions are exact).

    Raises:
        InputError: An effect that does not exist, or a place it cannot have.
    """
    places: dict[str, list[str]] = {}
    for entry in names:
        name, _, where = entry.partition("@")
        if name not in REGISTRY:
            raise InputError(f"effect {entry!r} is not available; allowed are {', '.join(sorted(REGISTRY))}")
        places.setdefault(name, []).append(where)
    return tuple(REGISTRY[name](robot, () if "" in where else tuple(where), flange) for name, where in places.items())
