"""Effects without springs of their own: what they change moves markers through the springs of others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Effect, Parameter, Scene
from identify.experiment import Experiment
from identify.robot import Robot

__all__ = ["NOTHING_YIELDS", "through_effect"]

#: Why a column of such an effect may be zero whatever the loads are.
NOTHING_YIELDS = (
    "nothing in the model yields at the values it was computed for (add joint_compliance, or state compliances under "
    "[model.nominal])"
)


def through_effect(
    name: str,
    parameters: tuple[Parameter, ...],
    why_zero: Callable[[int], str],
    *,
    yields: bool = True,
    adjust: Callable[[Robot, Floats], Robot] | None = None,
    reload: Callable[[Experiment, Floats], Experiment] | None = None,
) -> Effect:
    """An effect that changes robot or loads and adds no displacement of its own; arguments as in `Effect`."""

    def displacement(scene: Scene, values: Floats) -> Floats:
        return np.zeros_like(scene.point)

    def derivative(scene: Scene, values: Floats) -> Floats:
        return np.zeros((*scene.point.shape, len(values)))

    return Effect(
        name, parameters, displacement, derivative, why_zero, yields=yields, adjust=adjust, reload=reload, through=True
    )
