"""The compensation in the control loop: wrist sensors, estimated compliances, joint corrections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats, frozen
from identify.drilling.facing import Facing
from identify.errors import InputError

__all__ = ["Compensation", "Sensors", "compensation", "sensor_noise"]


@dataclass(frozen=True)
class Sensors:
    """The wrist sensors of both arms, zeroed with the tools hung on.

    Attributes:
        force_std: 1 sigma of a component of one sample, N.
        moment_std: 1 sigma of a component of one sample, Nm.
        filter_time: Time constant of the low pass (first order) before the compensation, s; 0: none. Assumed. It
            must be longer than drag times the compliance along the feed that is corrected in excess, or the loop is
            unstable.
    """

    force_std: float = 0.0
    moment_std: float = 0.0
    filter_time: float = 0.01

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InputError: A negative number, or one that is not finite.
        """
        for key in ("force_std", "moment_std", "filter_time"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"sensors: {key} = {value:g}: a finite number, 0 or more")


@dataclass(frozen=True, eq=False)
class Compensation:
    """What the loop does with the readings.

    Attributes:
        compliance: (m,) estimated joint compliances, rad/Nm or m/N; 0 where there is no estimate.
        per_reading: (6, 12) motion of drill against board that is commanded per reading.
        weight: (6,) motion commanded against the known tool weights.
    """

    compliance: Floats
    per_reading: Floats
    weight: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("compliance", "per_reading", "weight"):
            object.__setattr__(self, key, frozen(getattr(self, key)))


def compensation(facing: Facing, estimates: tuple[ArrayLike, ArrayLike] | None) -> Compensation:
    """Joint corrections ``-c tau`` of all joints, from estimated compliances.

    Args:
        facing: Both arms.
        estimates: (n,) compliances of the arm with the drill and of the arm with the board, rad/Nm or m/N; nan where a
            joint was not identified: it is not corrected. Of a shared joint the mean counts. None: no compensation.

    Raises:
        InputError: Another number of joints, an infinite or a negative estimate.
    """
    unknown = (np.full(facing.drill.robot.n, np.nan), np.full(facing.board.robot.n, np.nan))
    values = facing.joined(*(unknown if estimates is None else estimates))
    if np.isinf(values).any() or (values < 0.0).any():
        raise InputError(f"estimated compliances {values.tolist()}: 0 or more, or nan where not identified")
    known = np.where(np.isnan(values), 0.0, values)
    moves = facing.jacobian * -known
    return Compensation(known, moves @ facing.torque, moves @ facing.weight)


def sensor_noise(sensors: Sensors, count: int, rng: np.random.Generator | None) -> Floats:
    """Noise (count, 12) of both sensors, N and Nm.

    Raises:
        InputError: The sensors are noisy and there is no generator.
    """
    std = np.tile(np.repeat([sensors.force_std, sensors.moment_std], 3), 2)
    if not std.any():
        return np.zeros((count, 12))
    if rng is None:
        raise InputError("noisy sensors need a random generator: pass rng, or set force_std and moment_std to 0")
    noise: Floats = std * rng.standard_normal((count, 12))
    return noise
