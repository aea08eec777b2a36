"""Loads that are not what the study says: where they act, how much, along which direction, how they were measured.

None of these moves a marker by itself. A torque error ``dt_j`` on spring j acts through its compliance,

    E(dt) = sum_j c_j D_j dt_j

with the motion ``D_j`` of the marker (`identify.springs`). For a load at ``p_L`` with force F and moment M, spring j
with axis ``a_j`` through ``o_j`` bears ``t_j = a_j . ((p_L - o_j) x F + M)``; the docstrings give ``dt_j`` of each
effect, ``R`` being the rotation of the flange and ``e_i`` a unit vector. Sizes are engineering experience.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.arrays import Floats, rotation_of
from identify.effects.base import Binding, Effect, Parameter
from identify.effects.options import check_keys
from identify.effects.places import named_places
from identify.effects.through import NOTHING_YIELDS, through_effect
from identify.errors import InputError
from identify.experiment import Experiment
from identify.loads import LoadCase
from identify.robot import Robot
from identify.units import MM, MRAD, SI_OF

__all__ = ["force_sensor_bias", "load_com", "load_direction", "load_level", "load_scale"]

_FREE = 10.0  # a parameter known no better than this many typical sizes is not worth fitting


def load_com(binding: Binding) -> Effect:
    """The loads act elsewhere than stated, all shifted alike: they hang on the same hook.

    ``dt_j = a_j . (R e_i x F)`` per metre. The point of a measured wrench is shifted too.

    Parameters ``load_com.x, .y, .z``, mm, flange frame. Typical: 10 to 30 mm.

    Args:
        binding: What it is bound to; no places, no options.

    Raises:
        InputError: A place or an option is given.
    """
    _plain("load_com", binding, ())
    parameters = tuple(_parameter(f"load_com.{axis}", "mm", 20.0, 100.0) for axis in "xyz")

    def reload(experiment: Experiment, values: Floats) -> Experiment:
        loads = tuple(replace(load, attach=load.attach + MM * values) for load in experiment.loads)
        return replace(experiment, loads=loads)

    def why_zero(parameter: int) -> str:
        return f"no loaded reading has a force across {'xyz'[parameter]} of the flange, or {NOTHING_YIELDS}"

    return through_effect("load_com", parameters, why_zero, reload=reload)


def load_level(binding: Binding) -> Effect:
    """Single loads are heavier than stated by a share of their mass, force and moment.

    ``dt_j = t_j`` of the load, in the readings under this load only. Measured wrenches of the load are scaled too.

    Parameters ``load_level.<load>``, % of what is stated. Typical: 1 to 5 %.

    Args:
        binding: What it is bound to; places are ids of loads of the study, by default those that are loaded (all,
            where the study states no load and wrenches are measured); no options.

    Raises:
        InputError: The study has no loads or not this one, or an option is given.
    """
    check_keys("load_level", binding.options)
    names = tuple(load.name for load in binding.loads)
    if not names:
        raise InputError("effect load_level: the study has no loads whose size could be wrong; add [[loads]]")
    loaded = tuple(load.name for load in binding.loads if not load.unloaded)
    places = named_places("load_level", names, binding.where or loaded)
    parameters = tuple(_parameter(f"load_level.{place}", "%", 3.0, 20.0) for place in places)

    def reload(experiment: Experiment, values: Floats) -> Experiment:
        share = dict(zip(places, values.tolist(), strict=True))
        return _scaled(experiment, np.array([share.get(load.name, 0.0) for load in experiment.loads]))

    def why_zero(parameter: int) -> str:
        return f"no reading in these data is loaded by {places[parameter]}, or {NOTHING_YIELDS}"

    return through_effect("load_level", parameters, why_zero, reload=reload)


def load_scale(binding: Binding) -> Effect:
    """All loads are heavier than stated by one share: mass, force, moment and measured wrenches.

    ``dt_j = t_j`` of the loads, not of self-weight and tool. In changes between loads this is exactly a common factor
    of all compliances; only absolute readings, which self-weight of known size bends as well, can tell the two apart.

    Parameter ``load_scale.all``, %. Typical: 1 to 3 %.

    Args:
        binding: What it is bound to; the only place is ``all``; no options.

    Raises:
        InputError: Another place or an option is given.
    """
    check_keys("load_scale", binding.options)
    named_places("load_scale", ("all",), binding.where)

    def reload(experiment: Experiment, values: Floats) -> Experiment:
        return _scaled(experiment, np.full(len(experiment.loads), values[0]))

    def why_zero(parameter: int) -> str:
        return f"no reading in these data is loaded, or {NOTHING_YIELDS}"

    return through_effect("load_scale", (_parameter("load_scale.all", "%", 2.0, 20.0),), why_zero, reload=reload)


def load_direction(binding: Binding) -> Effect:
    """Gravity is not along the assumed vertical: it is turned about the world's x and y axes.

    ``dt_j = a_j . ((p - o_j) x (e_i x W))`` per rad, summed over the weights W of hung masses, links and tool at their
    centres p. Stated forces and measured wrenches stay. Rotation vector ``(x, y, 0)``.

    Parameters ``load_direction.x, .y``, mrad, world frame. Typical: 3 to 20 mrad (0.2 to 1 degree).

    Args:
        binding: What it is bound to; no places, no options.

    Raises:
        InputError: A place or an option is given.
    """
    _plain("load_direction", binding, ())
    parameters = tuple(_parameter(f"load_direction.{axis}", "mrad", 10.0, 35.0) for axis in "xy")

    def adjust(robot: Robot, values: Floats) -> Robot:
        return replace(robot, down=rotation_of(MRAD * np.append(values, 0.0)) @ robot.down)

    def why_zero(parameter: int) -> str:
        return (
            "no weight of known size acts in these data (hung masses; links and tool where all masses are known), "
            f"or {NOTHING_YIELDS}"
        )

    return through_effect("load_direction", parameters, why_zero, adjust=adjust)


def force_sensor_bias(binding: Binding) -> Effect:
    """The force sensor adds a constant wrench in the flange frame: measured = true + bias, in loaded readings.

    ``dt_j = -a_j . ((p_L - o_j) x R e_i)`` per N and ``-a_j . R e_i`` per Nm. It exists where wrench columns stand;
    unloaded rows, whose wrench is zero, stay so.

    Parameters ``force_sensor_bias.fx, .fy, .fz`` (N), ``.mx, .my, .mz`` (Nm). Typical: 5 to 30 N, 1 to 5 Nm.

    Args:
        binding: What it is bound to; no places, no options.

    Raises:
        InputError: A place or an option is given.
    """
    _plain("force_sensor_bias", binding, ())
    forces = tuple(_parameter(f"force_sensor_bias.f{axis}", "N", 15.0, 100.0) for axis in "xyz")
    moments = tuple(_parameter(f"force_sensor_bias.m{axis}", "Nm", 3.0, 20.0) for axis in "xyz")

    def reload(experiment: Experiment, values: Floats) -> Experiment:
        if experiment.wrench is None:
            return experiment
        return replace(experiment, wrench=np.where(experiment.shot_unloaded[:, None], 0.0, experiment.wrench - values))

    def why_zero(parameter: int) -> str:
        return (
            "no loaded reading has a measured wrench (columns fx_N ... mz_Nm of the measurements), so no force sensor "
            f"has a part in these data, or {NOTHING_YIELDS}"
        )

    return through_effect("force_sensor_bias", (*forces, *moments), why_zero, reload=reload)


def _plain(name: str, binding: Binding, places: tuple[str, ...]) -> None:
    """Refuse places and options."""
    check_keys(name, binding.options)
    named_places(name, places, binding.where)


def _parameter(name: str, unit: str, typical: float, plausible: float) -> Parameter:
    return Parameter(name, unit, SI_OF[unit], limit=_FREE * typical, plausible=plausible, typical=typical)


def _scaled(experiment: Experiment, percent: Floats) -> Experiment:
    """The experiment with each load case (and what was measured under it) larger by (L,) per cent."""
    factor = 1.0 + SI_OF["%"] * percent
    loads = tuple(_times(load, size) for load, size in zip(experiment.loads, factor.tolist(), strict=True))
    wrench = None if experiment.wrench is None else experiment.wrench * factor[experiment.shot_load, None]
    return replace(experiment, loads=loads, wrench=wrench)


def _times(load: LoadCase, factor: float) -> LoadCase:
    return replace(load, mass=factor * load.mass, force=factor * load.force, moment=factor * load.moment)
