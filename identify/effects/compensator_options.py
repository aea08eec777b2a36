"""Options of `gravity_compensator`: the table ``[model.gravity_compensator]`` of a study.

    mode = "levels"            # "spring" or "harmonics"; needed only where the other keys do not tell
    levels_deg = [-100, -50, -5]   # two or more; a pose belongs to the nearest one
    tolerance_deg = 2.0        # optional: a pose further than this from every level is an error

    a_x_mm = 686.0             # spring: from the fixed anchor to the axis, see identify.gravity_spring
    a_y_mm = 121.0
    radius_mm = 185.0          # distance of the moving anchor from the axis
    s0_mm = 458.0              # optional: free length; without it K_c s_0 is a second unknown
    fit_geometry = false       # a_x_mm, a_y_mm and radius_mm are starting values then
    springs = [{...}, {...}]   # several springs, in place of the five keys above

    orders = [1, 2, 3]         # harmonics: waves per turn of the joint; this is the default

The same keys in ``[model.gravity_compensator.j2]`` hold for that joint alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from identify.arrays import Floats
from identify.effects.joint_turns import joint_options
from identify.effects.options import is_number
from identify.errors import InputError
from identify.gravity_spring import SpringGeometry
from identify.units import DEG, MM

__all__ = ["SpringOptions", "mode_of", "options_of", "read_levels", "read_orders", "read_springs"]

_HEADING = "[model.gravity_compensator]"
_LEVEL_KEYS = ("levels_deg", "tolerance_deg")
_SPRING_KEYS = ("a_x_mm", "a_y_mm", "radius_mm", "s0_mm", "fit_geometry")
_MOST_WAVES = 12  # a spring's torque is smooth
_KEYS_OF = {"levels": _LEVEL_KEYS, "spring": (*_SPRING_KEYS, "springs"), "harmonics": ("orders",)}
_KEYS = ("mode", *(key for keys in _KEYS_OF.values() for key in keys))


@dataclass(frozen=True)
class SpringOptions:
    """One spring.

    Attributes:
        geometry: Its anchors.
        free_length: ``s_0``, m; None if it is unknown.
        fitted: The geometry is fitted, from here.
    """

    geometry: SpringGeometry
    free_length: float | None
    fitted: bool


def options_of(options: Mapping[str, Any], joint: int) -> dict[str, Any]:
    """The options of one joint: the common ones, overlaid with its own.

    Raises:
        InputError: A key that does not exist.
    """
    return joint_options("gravity_compensator", _KEYS, options, joint)


def mode_of(options: Mapping[str, Any]) -> str:
    """``levels``, ``spring`` or ``harmonics``, as stated or as the other keys tell.

    Raises:
        InputError: None follows, or the keys of another one are there.
    """
    told = [mode for mode, keys in _KEYS_OF.items() if any(key in options for key in keys)]
    mode = options.get("mode", told[0] if len(told) == 1 else None)
    if mode not in _KEYS_OF:
        given = "is missing" if mode is None else f"= {mode!r} is unknown"
        raise InputError(
            f'{_HEADING} mode {given}: "levels" (with levels_deg), "spring" (with a_x_mm, a_y_mm, radius_mm) or '
            '"harmonics" (with orders) expected'
        )
    stray = [key for other, keys in _KEYS_OF.items() if other != mode for key in keys if key in options]
    if stray:
        raise InputError(f'{_HEADING} {stray[0]}: has no meaning with mode = "{mode}"; leave it out')
    return str(mode)


def read_orders(options: Mapping[str, Any]) -> tuple[int, ...]:
    """Orders of the harmonics, waves per turn of the joint, ascending.

    Raises:
        InputError: No list of different whole numbers from 1 to 12.
    """
    given = options.get("orders", [1, 2, 3])
    whole = isinstance(given, list | tuple) and all(
        isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MOST_WAVES for value in given
    )
    if not whole or not given or len(set(given)) < len(given):
        raise InputError(
            f"{_HEADING} orders = {given!r}: a list of different whole numbers from 1 to {_MOST_WAVES} expected, for "
            "example [1, 2, 3]; order 0 would be a zero offset of the joint, which geometry holds"
        )
    return tuple(sorted(given))


def read_levels(options: Mapping[str, Any]) -> tuple[Floats, float]:
    """Levels and tolerance, rad.

    Raises:
        InputError: No list of two or more different numbers, or a tolerance that is not positive.
    """
    given = options.get("levels_deg")
    listed = isinstance(given, list | tuple) and all(is_number(value) for value in given)
    if not listed or len(set(given or ())) < max(2, len(given or ())):
        raise InputError(
            f"{_HEADING} levels_deg = {given!r}: two or more different values of the joint expected, for example "
            "[-100, -50, -5]; one level is joint_compliance itself"
        )
    tolerance = options.get("tolerance_deg", np.inf)
    if not is_number(tolerance) or tolerance <= 0:
        raise InputError(f"{_HEADING} tolerance_deg = {tolerance!r}: a number above 0 expected")
    return np.array(given, dtype=np.float64) * DEG, float(tolerance) * DEG


def read_springs(options: Mapping[str, Any]) -> tuple[SpringOptions, ...]:
    """The springs of one joint.

    Raises:
        InputError: Geometry that is missing or impossible.
    """
    if "springs" not in options:
        return (_spring(options, _HEADING),)
    stray = [key for key in _SPRING_KEYS if key in options]
    if stray:
        raise InputError(f"{_HEADING} {stray[0]}: give it in each entry of springs, or one spring without springs")
    given = options["springs"]
    if not isinstance(given, list | tuple) or not given or not all(isinstance(entry, Mapping) for entry in given):
        raise InputError(f"{_HEADING} springs = {given!r}: a list of tables with a_x_mm, a_y_mm, radius_mm expected")
    return tuple(_spring(entry, f"{_HEADING} springs, entry {i + 1},") for i, entry in enumerate(given))


def _spring(table: Mapping[str, Any], heading: str) -> SpringOptions:
    """One spring from its keys."""
    for key in table:
        if key not in _SPRING_KEYS and key != "mode":
            raise InputError(f"{heading} {key}: unknown key; allowed: {', '.join(_SPRING_KEYS)}")
    a_x, a_y, radius = (_length(table, key, heading) for key in _SPRING_KEYS[:3])
    free_length = _length(table, "s0_mm", heading) if "s0_mm" in table else None
    fitted = table.get("fit_geometry", False)
    if not isinstance(fitted, bool):
        raise InputError(f"{heading} fit_geometry = {fitted!r}: true or false expected")
    for key, value in (("radius_mm", radius), ("s0_mm", free_length)):
        if value is not None and value <= 0:
            raise InputError(f"{heading} {key} = {value / MM:g}: must be above 0")
    if np.isclose(np.hypot(a_x, a_y), radius, rtol=1e-6) or np.hypot(a_x, a_y) == 0.0:
        raise InputError(
            f"{heading} a_x_mm, a_y_mm = {a_x / MM:g}, {a_y / MM:g}: the fixed anchor is on the axis or on the circle "
            f"of the moving one (radius_mm = {radius / MM:g}), so the spring would have no length or no lever"
        )
    return SpringOptions(SpringGeometry(a_x, a_y, radius), free_length, fitted)


def _length(table: Mapping[str, Any], key: str, heading: str) -> float:
    """A length in mm, as m."""
    if key not in table:
        raise InputError(f"{heading} {key} is missing; a spring needs a_x_mm, a_y_mm and radius_mm")
    value = table[key]
    if not is_number(value):
        raise InputError(f"{heading} {key} = {value!r}: a number (mm) expected")
    return float(value) * MM
