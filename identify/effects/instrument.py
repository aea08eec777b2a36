"""What is wrong with the readings and not with the arm: an instrument that moves or scales, reflectors that shift.

An instrument that moves displaces every reading as a rigid body, targets on the base and the floor too:
``v + w x p`` with v along and w about the axes of the base, p the target from the base origin; 6-D targets turn by w.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from identify.arrays import Floats, skew
from identify.effects.base import Binding, Effect, Scene
from identify.effects.direct import HIDDEN, direct_effect, unknown_of
from identify.effects.options import check_keys, number
from identify.effects.places import named_places
from identify.errors import InputError

__all__ = ["marker_seating", "tracker_drift", "tracker_scale", "tracker_step"]

_FREEDOMS = ("x", "y", "z", "rx", "ry", "rz")


def tracker_drift(binding: Binding) -> Effect:
    """An instrument that moves slowly: ``(v + w x p) t``, t the time since the first reading.

    Parameters ``tracker_drift.x, .y, .z``, mm/h, and ``.rx, .ry, .rz``, mrad/h: of the readings, about the base origin.
    Typical: tenths of a mm in the first two hours after switching on.

    Args:
        binding: Robot and places ``x ... rz``; all six by default.

    Raises:
        InputError: A place that does not exist, or options.
    """
    check_keys("tracker_drift", binding.options)

    def course(scene: Scene) -> Floats:
        elapsed = scene.experiment.elapsed
        return np.zeros(len(scene.point)) if elapsed is None else elapsed

    why = f"the data have no column time_s or all its values are the same, {HIDDEN}"
    return _moving("tracker_drift", binding, ("mm/h", "mrad/h"), ((0.5, 0.05), (0.3, 0.02)), course, why)


def tracker_step(binding: Binding) -> Effect:
    """An instrument that was knocked: ``v + w x p`` in all readings later than ``t*``.

    Parameters ``tracker_step.x, .y, .z``, mm, and ``.rx, .ry, .rz``, mrad: of the readings, about the base origin.
    Typical: 0.02 to 0.2 mm.

    Options: ``time_s``: t*, on the clock of the column ``time_s``; it has no default.

    Args:
        binding: Robot, places ``x ... rz`` (all six by default) and options.

    Raises:
        InputError: A place that does not exist, ``time_s`` missing, or other options.
    """
    check_keys("tracker_step", binding.options, "time_s")
    if "time_s" not in binding.options:
        raise InputError("[model.tracker_step] time_s is missing; say when it happened, for example time_s = 5400.0")
    moment = number("tracker_step", binding.options, "time_s", 0.0)

    def course(scene: Scene) -> Floats:
        time = scene.experiment.time
        return np.zeros(len(scene.point)) if time is None else np.asarray(time > moment, dtype=np.float64)

    why = f"the data have no column time_s, no reading is later than {moment:g} s, {HIDDEN}"
    return _moving("tracker_step", binding, ("mm", "mrad"), ((1.0, 0.1), (0.5, 0.03)), course, why)


def tracker_scale(binding: Binding) -> Effect:
    """An instrument whose unit of length is wrong: ``s p``, p the target from the base origin.

    What it adds from the base to the instrument is a displacement of the whole frame. Parameter
    ``tracker_scale.all``, ppm. Typical: 1 ppm for each kelvin that the air is taken wrong, 5 to 30 ppm in all.

    Args:
        binding: Robot and place ``all``.

    Raises:
        InputError: Another place, or options.
    """
    check_keys("tracker_scale", binding.options)
    named_places("tracker_scale", ("all",), binding.where)
    parameter = unknown_of("tracker_scale.all", "ppm", plausible=50.0, typical=10.0)

    def fields(scene: Scene) -> Floats:
        return np.where(scene.turning[:, None], 0.0, scene.point)[:, :, None]

    def why_zero(parameter: int) -> str:
        return f"every target stands at the base origin, {HIDDEN}"

    return direct_effect("tracker_scale", (parameter,), fields, why_zero, of_reading=True)


def marker_seating(binding: Binding) -> Effect:
    """A reflector that sits shifted in all loaded readings: ``R_f e_i`` where it is read and something is hung.

    Parameters ``marker_seating.<marker>.x, .y, .z``, mm, along the axes of the flange. Typical: 0.01 to 0.05 mm.

    Args:
        binding: Robot, markers, and places: names of markers on the flange; all of them by default.

    Raises:
        InputError: A place that is no marker on the flange, or options.
    """
    name, markers = "marker_seating", binding.markers
    check_keys(name, binding.options)
    if markers is None:
        raise InputError(f"effect {name}: no markers are known that it could sit on; bind it with those of a study")
    on_flange = tuple(n for n, fixed in zip(markers.names, markers.on_base, strict=True) if not fixed)
    places = named_places(name, on_flange, binding.where)
    parameters = tuple(
        unknown_of(f"{name}.{place}.{axis}", "mm", plausible=0.2, typical=0.03) for place in places for axis in "xyz"
    )

    def fields(scene: Scene) -> Floats:
        experiment = scene.experiment
        loaded = ~experiment.shot_unloaded[experiment.row_shot] & ~scene.turning
        marker = np.array(experiment.markers.names)[experiment.row_marker]
        shifted = loaded[:, None] & (marker[:, None] == np.array(places))
        axes = scene.frames.flange_rotation[scene.row_pose]
        return np.asarray((axes[:, :, None] * shifted[:, None, :, None]).reshape(len(marker), 3, -1))

    def why_zero(parameter: int) -> str:
        return f"no loaded reading of marker {places[parameter // 3]} is in these data"

    return direct_effect(name, parameters, fields, why_zero, yields=True, of_reading=True)


def _moving(
    name: str,
    binding: Binding,
    units: tuple[str, str],
    sizes: tuple[tuple[float, float], tuple[float, float]],
    course: Callable[[Scene], Floats],
    why: str,
) -> Effect:
    """Six rigid freedoms of the readings, each following the same course (R,) of time.

    ``units`` and ``sizes`` (plausible, typical) are of the shifts and of the turns.
    """
    freedoms = named_places(name, _FREEDOMS, binding.where)
    kinds = [int(freedom[0] == "r") for freedom in freedoms]
    parameters = tuple(
        unknown_of(f"{name}.{freedom}", units[k], plausible=sizes[k][0], typical=sizes[k][1])
        for freedom, k in zip(freedoms, kinds, strict=True)
    )
    columns = [_FREEDOMS.index(freedom) for freedom in freedoms]

    def fields(scene: Scene) -> Floats:
        shifts = np.broadcast_to(np.eye(3), (len(scene.point), 3, 3))
        rigid = np.concatenate([shifts, -skew(scene.point)], axis=2)
        rigid[scene.turning] = np.eye(3, 6, 3)
        return np.asarray(rigid[:, :, columns] * course(scene)[:, None, None])

    return direct_effect(name, parameters, fields, lambda _: why, of_reading=True)
