"""Growth of the arm when it warms up."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene
from identify.effects.direct import HIDDEN, direct_effect, unknown_of
from identify.effects.options import check_keys, number
from identify.effects.places import named_places
from identify.errors import InputError
from identify.units import HOUR

__all__ = ["thermal_growth"]

REFERENCE = 20.0  # degC, the reference temperature of lengths (ISO 1)
_DRIVERS = ("auto", "temperature", "time")
_USUAL = ("all", "j2", "j3")
_BY_TIME = 25.0  # K: sizes at full warm-up are those of so many kelvin


def thermal_growth(binding: Binding) -> Effect:
    """Links that grow and joint offsets that move with the warmth T of each reading.

    Places: ``link<k>`` grows along the line from joint k to joint k + 1 (or the flange; link0 is the column under
    joint 1), ``u_k T`` with u_k that vector; ``all`` grows all of them alike, ``(flange - base origin) T``; ``j<i>``
    turns (or slides) the joint, ``D_i T``. Markers on the base stay. Parameters ``thermal_growth.<place>``: ppm/K for
    lengths, urad/K (um/K if sliding) for joints. Typical: 11.7 ppm/K of steel or 23 of aluminium, 0.1 to 0.5 mm in one
    to three hours.

    T is the column ``temperature_C`` above 20 degC; without it a warm-up ``1 - exp(-t / tau)``, t the time since the
    first reading; without both nothing grows. For a warm-up the values are those at full warm-up, ppm and urad.

    `predict` takes what the fit took: a plan without temperatures is at 20 degC if the fit had them.

    Options: ``tau_h = 1.0``; ``driver = "auto"`` (default), ``"temperature"`` or ``"time"``: which of the two is looked
    at. With ``"time"`` the units are named ppm, urad and um.

    Args:
        binding: Robot, places (default: ``all``, ``j2``, ``j3``) and options.

    Raises:
        InputError: A place that does not exist, or wrong options.
    """
    name, robot, options = "thermal_growth", binding.robot, binding.options
    check_keys(name, options, "driver", "tau_h")
    driver = options.get("driver", "auto")
    if driver not in _DRIVERS:
        raise InputError(f"[model.{name}] driver = {driver!r}: allowed: {', '.join(_DRIVERS)}")
    tau = HOUR * number(name, options, "tau_h", 1.0, least=0.0)
    joints, links = [f"j{j + 1}" for j in range(robot.n)], [f"link{k}" for k in range(robot.n + 1)]
    allowed = ("all", *links, *joints)
    places = named_places(name, allowed, binding.where or tuple(place for place in _USUAL if place in allowed))
    lengths = [("all", *links).index(place) for place in places if place not in joints]
    turned = [joints.index(place) for place in places if place in joints]
    kinds = ["ppm"] * len(lengths) + ["um" if robot.prismatic[j] else "urad" for j in turned]
    parameters = tuple(_parameter(f"{name}.{place}", kind, driver) for place, kind in zip(places, kinds, strict=True))

    def fields(scene: Scene) -> Floats:
        grown = _stretches(scene)[:, lengths][scene.row_pose]
        grown[scene.on_base | scene.turning] = 0.0
        moves = np.concatenate([grown, scene.joints.motion[:, turned]], axis=1)
        return np.asarray((moves * _warmth(scene, driver, tau)[:, None, None]).swapaxes(1, 2))

    def why_zero(parameter: int) -> str:
        columns = {"auto": "neither column temperature_C nor time_s", "temperature": "no column temperature_C"}
        what, place = columns.get(driver, "no column time_s"), places[parameter]
        return f"the data have {what}, no marker moves with {place}, {HIDDEN}"

    return direct_effect(name, parameters, fields, why_zero)


def _parameter(name: str, kind: str, driver: str) -> Parameter:
    """Growth per kelvin, or at full warm-up."""
    times, unit = (_BY_TIME, kind) if driver == "time" else (1.0, f"{kind}/K")
    plausible, typical = (40.0, 12.0) if kind == "ppm" else (50.0, 5.0)
    return unknown_of(name, unit, plausible=plausible * times, typical=typical * times)


def _stretches(scene: Scene) -> Floats:
    """(C, n + 2, 3) from the base origin to the flange, then from the begin to the end of each link, m."""
    frames = scene.frames
    base = np.zeros_like(frames.flange_origin)[:, None]
    stations = np.concatenate([base, frames.origin, frames.flange_origin[:, None]], axis=1)
    return np.concatenate([frames.flange_origin[:, None], np.diff(stations, axis=1)], axis=1)


def _warmth(scene: Scene, driver: str, tau: float) -> Floats:
    """(R,) K above the reference, or share of the full warm-up."""
    temperature, elapsed = scene.experiment.temperature, scene.experiment.elapsed
    if driver != "time" and temperature is not None:
        return np.asarray(temperature - REFERENCE)
    if driver != "temperature" and elapsed is not None:
        return np.asarray(-np.expm1(-elapsed / tau))
    return np.zeros(len(scene.point))
