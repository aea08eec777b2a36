"""Beyond first order: where the loaded arm really settles, and what the linear model misses of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identify.arrays import Floats, frozen
from identify.errors import NoConvergence
from identify.experiment import Experiment
from identify.loaded_scene import TOLERANCE, LoadedScene
from identify.model import Model
from identify.response import deflected, displaced_points, frame_displacement, respond
from identify.units import MM

__all__ = ["Equilibrium", "LinearError", "equilibrium", "linear_error", "linear_misses"]

_SAMPLE = 300  # poses that a statement about the linear model looks at


class Equilibrium(NamedTuple):
    """The arm at rest under its loads.

    Attributes:
        positions: (R, 3) readings in the base frame, m.
        iterations: Newton steps of the slowest shot.
    """

    positions: Floats
    iterations: int


@dataclass(frozen=True)
class LinearError:
    """What the linear model misses.

    Attributes:
        rms: Root mean square over the rows of the distance between both models' markers, m.
        maximum: The largest, m.
        percent: ``rms`` against the root mean square of the deflection, per cent.
    """

    rms: float
    maximum: float
    percent: float


def equilibrium(model: Model, experiment: Experiment, values: Floats, tolerance: float = TOLERANCE) -> Equilibrium:
    """Readings of the arm at its loaded equilibrium, whatever the model's option says.

    Effects that are no pairs of springs are added at first order (`identify.loaded_scene`).

    Args:
        model: The model.
        experiment: The conditions.
        values: (p,) parameters in their units.
        tolerance: Largest difference of a spring's deflection to what its torque demands, rad or m.

    Raises:
        NoConvergence: The arm finds no equilibrium.
    """
    scene, deflection = deflected(replace(model, loaded=True), experiment, values, tolerance)
    assert isinstance(scene, LoadedScene)
    turn, shift = frame_displacement(model, values)
    return Equilibrium(frozen(displaced_points(scene, deflection) @ turn.T + shift), scene.iterations)


def linear_error(model: Model, experiment: Experiment, values: Floats) -> LinearError:
    """What the linear model misses of the loaded equilibrium, over all rows that read positions.

    Args:
        model: The model.
        experiment: The conditions.
        values: (p,) parameters in their units.

    Raises:
        NoConvergence: The arm finds no equilibrium.
    """
    linear = respond(replace(model, loaded=False), experiment, values, derivative=False)
    places = ~experiment.turning
    missed = np.linalg.norm((linear.position - equilibrium(model, experiment, values).positions)[places], axis=1)
    size = float(np.sqrt((linear.deflection[places] ** 2).sum(axis=1).mean())) if len(missed) else 0.0
    rms = float(np.sqrt((missed**2).mean())) if len(missed) else 0.0
    return LinearError(rms, float(missed.max(initial=0.0)), 100.0 * rms / size if size else 0.0)


def linear_misses(model: Model, experiment: Experiment, values: Floats) -> dict[str, float] | None:
    """`linear_error` as it stands in results; None where no spring yields, or where the arm finds no equilibrium.

    At most 300 poses are looked at, evenly spread over the experiment.
    """
    pairs = zip(model.effects, model.effect_slices, strict=True)
    if not any(values[where].any() or effect.held for effect, where in pairs if effect.springs):
        return None
    try:
        found = linear_error(model, _some(experiment), values)
    except NoConvergence:
        return None
    return {"rms_mm": found.rms / MM, "max_mm": found.maximum / MM, "percent": found.percent}


def _some(experiment: Experiment) -> Experiment:
    """The experiment with the shots of at most `_SAMPLE` poses."""
    count = len(experiment.q)
    if count <= _SAMPLE:
        return experiment
    poses = np.unique(np.linspace(0, count - 1, _SAMPLE).astype(np.int64))
    return experiment.of_rows(np.flatnonzero(np.isin(experiment.shot_pose[experiment.row_shot], poses)))
