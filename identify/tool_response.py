"""Where the flange of a fitted arm really stands under a wrench, and how that depends on the parameters.

A 6-D target at the origin of the flange goes through the same response as readings do, so that every effect of the
model counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, frozen, skew
from identify.effects import Effect, Scene
from identify.errors import InputError
from identify.experiment import Experiment, full_experiment
from identify.loads import LoadCase, Markers
from identify.model import Model, without_nuisance
from identify.response import respond
from identify.six_d import with_turns

__all__ = [
    "Arm",
    "Targets",
    "ToolResponse",
    "arm_of",
    "point_covariances",
    "target_experiment",
    "tool_poses",
    "tool_response",
]

_CHUNK = 4096  # targets at once
_FLANGE = Markers(("flange",), np.zeros((1, 3)), np.zeros(1, dtype=bool))


@dataclass(frozen=True, eq=False)
class Targets:
    """T poses that are wanted under a wrench.

    Attributes:
        names: (T,) their names.
        q: (T, n) joint values at which the rigid nominal robot stands there, rad or m.
        wrench: (T, 6) what acts on the flange at the attach point, N and Nm.
        in_flange: (T,) True for wrenches in the axes of the deflected flange, which turn with it; else world axes.
        attach: (T, 3) where the wrench acts, flange frame, m. The position that counts is that of this point.
    """

    names: tuple[str, ...]
    q: Floats
    wrench: Floats
    in_flange: np.ndarray
    attach: Floats

    def __post_init__(self) -> None:
        """Check shapes and make the arrays read-only."""
        count = len(self.names)
        if not count:
            raise InputError("targets: there are none; at least one expected")
        shapes = {"q": (count, np.shape(self.q)[-1]), "wrench": (count, 6), "in_flange": (count,), "attach": (count, 3)}
        for key, shape in shapes.items():
            array = frozen(getattr(self, key), bool if key == "in_flange" else np.float64)
            if array.shape != shape:
                raise InputError(f"targets: {key} has shape {array.shape}, expected {shape}")
            if not np.isfinite(array).all():
                raise InputError(f"targets: {key} of target {self.names[_first_bad(array)]} is not finite")
            object.__setattr__(self, key, array)

    def at(self, q: Floats) -> Targets:
        """The same wrenches at other joint values (T, n)."""
        return replace(self, q=q)

    def under(self, wrench: Floats) -> Targets:
        """The same poses under other wrenches (T, 6)."""
        return replace(self, wrench=wrench)

    def part(self, rows: slice) -> Targets:
        """Some of the targets."""
        return Targets(self.names[rows], self.q[rows], self.wrench[rows], self.in_flange[rows], self.attach[rows])

    def parts(self) -> Iterator[Targets]:
        """All targets, some thousand at a time."""
        for start in range(0, len(self.names), _CHUNK):
            yield self.part(slice(start, start + _CHUNK))


@dataclass(frozen=True, eq=False)
class Arm:
    """What a fitted model says about the arm itself: no frame, no markers, no instrument, no errors of measured loads.

    Attributes:
        model: The model of the arm.
        values: (p,) its parameters in their units.
        covariance: (p, p) of them; rows of zeros for parameters that were not identified and are held.
    """

    model: Model
    values: Floats
    covariance: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("values", "covariance"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    @property
    def held(self) -> np.ndarray:
        """(p,) True for parameters that were not identified."""
        return np.asarray(np.diagonal(self.covariance) == 0.0)


@dataclass(frozen=True, eq=False)
class ToolResponse:
    """Real flange poses.

    Attributes:
        scene: The fields they were computed from.
        pose: (T, 4, 4) base_T_flange, m.
        derivative: (T, 6, p) position (m) and turn (rad), base frame, per unit of the parameters; (T, 6, 0) if not
            asked for.
    """

    scene: Scene
    pose: Floats
    derivative: Floats


def arm_of(model: Model, values: Floats, covariance: Floats | None = None) -> Arm:
    """The arm of a fitted model.

    A wrench at a target is what it is, no matter how wrong the loads were that hung for measuring: effects that
    change what acts (`Effect.reload`) are left out like those of instrument and reflectors.

    Args:
        model: The fitted model.
        values: (p,) its parameters.
        covariance: (p, p) of them; none by default.
    """
    effects: list[Effect] = []
    columns: list[int] = []
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        if not effect.of_reading and effect.reload is None:
            effects.append(effect)
            columns += range(where.start, where.stop)
    covariance = np.zeros((len(values), len(values))) if covariance is None else covariance
    bare = replace(
        without_nuisance(model), effects=tuple(effects), parameters=tuple(model.parameters[i] for i in columns)
    )
    return Arm(bare, values[columns], covariance[np.ix_(columns, columns)])


def tool_response(arm: Arm, targets: Targets, *, derivative: bool = True) -> ToolResponse:
    """Real poses of the flange at targets, all at once.

    Args:
        arm: The arm.
        targets: Joint values and wrenches.
        derivative: Also compute the derivative.

    Raises:
        InputError: Another number of joints than the robot has.
        NoConvergence: The loaded arm finds no equilibrium.
    """
    count = len(targets.names)
    response = respond(arm.model, target_experiment(targets), arm.values, derivative=derivative)
    pose = np.zeros((count, 4, 4))
    pose[:, :3, :3] = response.turned
    pose[:, :3, 3] = response.position[::2]  # the rows of each target: its position, its turn
    pose[:, 3, 3] = 1.0
    return ToolResponse(response.scene, pose, response.derivative.reshape(count, 6, -1))


def target_experiment(targets: Targets) -> Experiment:
    """The conditions of targets: one shot each, which reads position and turn of the flange."""
    points, index = np.unique(targets.attach, axis=0, return_inverse=True)
    loads = tuple(LoadCase("target", attach=point) for point in points)
    experiment = full_experiment(targets.q, index.reshape(-1, 1), loads, _FLANGE, targets.names)
    return with_turns(replace(experiment, wrench=targets.wrench, wrench_in_world=~targets.in_flange))


def tool_poses(arm: Arm, targets: Targets) -> Floats:
    """(T, 4, 4) real poses of the flange of any number of targets, base frame, m; errors as in `tool_response`."""
    return np.concatenate([tool_response(arm, part, derivative=False).pose for part in targets.parts()])


def point_covariances(arm: Arm, targets: Targets) -> tuple[Floats, Floats]:
    """How uncertain the attach points are, and how they answer to the parameters.

    Args:
        arm: The arm.
        targets: The targets, at the joint values that are commanded.

    Returns:
        (T, 3, 3) covariance of the points from that of the parameters, base frame, m^2, and the (p,) largest motion of
        any of them per unit of each parameter, m.
    """
    spread, largest = [], np.zeros(len(arm.values))
    for part in targets.parts():
        response = tool_response(arm, part)
        lever = (response.pose[:, :3, :3] @ part.attach[:, :, None])[..., 0]
        rows = response.derivative[:, :3] - skew(lever) @ response.derivative[:, 3:]
        spread.append(rows @ arm.covariance @ rows.swapaxes(1, 2))
        largest = np.maximum(largest, np.linalg.norm(rows, axis=1).max(axis=0, initial=0.0))
    return np.concatenate(spread), largest


def _first_bad(array: np.ndarray) -> int:
    """First row that holds a number that is not finite."""
    return int(np.flatnonzero(~np.isfinite(array).reshape(len(array), -1).all(axis=1))[0])
