"""Effects that displace markers directly: sums of known fields, each times one parameter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects.base import Effect, Parameter, Scene
from identify.units import SI_OF

__all__ = ["HIDDEN", "direct_effect", "turning_effect", "unknown_of"]

#: Reason for a column of zeros that every effect of absolute readings has.
HIDDEN = "or only changes between loads are used"

_LIMIT = 10.0  # knowing a parameter worse than ten times its plausible size says nothing and bends the fit


def unknown_of(name: str, unit: str, *, plausible: float, typical: float) -> Parameter:
    """A parameter with its sizes, in its unit."""
    return Parameter(name, unit, SI_OF[unit], limit=_LIMIT * plausible, plausible=plausible, typical=typical)


def direct_effect(
    name: str,
    parameters: tuple[Parameter, ...],
    fields: Callable[[Scene], Floats],
    why_zero: Callable[[int], str],
    *,
    yields: bool = False,
    of_reading: bool = False,
) -> Effect:
    """An effect that is linear in its parameters.

    Args:
        name: Name of the effect.
        parameters: Its p unknowns.
        fields: ``scene -> (R, 3, p)`` displacement by each parameter of one, everything in SI, base frame.
        why_zero: Reason for a column of zeros.
        yields: See `Effect`.
        of_reading: See `Effect`.
    """
    scale = np.array([parameter.scale for parameter in parameters])

    def derivative(scene: Scene, values: Floats) -> Floats:
        return np.asarray(fields(scene) * scale)

    def displacement(scene: Scene, values: Floats) -> Floats:
        moved: Floats = fields(scene) @ (scale * values)
        return moved

    return Effect(
        name, parameters, displacement, derivative, why_zero, yields=yields, linear=True, of_reading=of_reading
    )


def turning_effect(
    name: str,
    parameters: tuple[Parameter, ...],
    joint: Ints,
    shares: Callable[[Scene], Floats],
    why_zero: Callable[[int], str],
) -> Effect:
    """Errors of joint values, ``sum_p D_j(p) b_p``, to first order.

    Args:
        name: Name of the effect.
        parameters: Its p unknowns.
        joint: (p,) joint that each parameter moves, from 0.
        shares: ``scene -> (R, p)`` what each parameter of one adds to its joint's value, SI.
        why_zero: Reason for a column of zeros.
    """
    scale = np.array([parameter.scale for parameter in parameters])

    def derivative(scene: Scene, values: Floats) -> Floats:
        size = shares(scene) * scale
        return np.asarray((scene.joints.motion[:, joint] * size[:, :, None]).swapaxes(1, 2))

    def displacement(scene: Scene, values: Floats) -> Floats:
        motion = scene.joints.motion
        error = (shares(scene) * (scale * values)) @ (joint[:, None] == np.arange(motion.shape[1]))
        moved: Floats = np.einsum("rji,rj->ri", motion, error)
        return moved

    return Effect(name, parameters, displacement, derivative, why_zero, yields=False, linear=True)
