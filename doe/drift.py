"""What a drifting instrument does to the result of a plan, reading by reading.

An estimate is linear in its readings, so a drift that moves every reading by its time times a rigid displacement
(`tracker_drift`) biases it by

    b = M^-1 sum_v A_v' N_v D t

with A_v the whitened rows of visit v, N_v its whitening operator, D the displacement of its readings by each of the six
freedoms and t their times. The part of one reading is its share of the columns of D.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from doe.objective import Objective
from doe.observations import Observer, stacked_visits
from identify.arrays import Floats, Ints, frozen
from identify.effects import Scene
from identify.effects.base import Binding
from identify.effects.instrument import tracker_drift
from identify.experiment import full_experiment
from identify.units import HOUR

__all__ = ["Leftover", "Yardstick", "drift_of_readings", "leftover", "typical_drift", "yardstick"]


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What a bias of the parameters is measured by.

    Attributes:
        rows: (r, p) of the parameters; the norm of ``rows @ bias`` counts.
        own: This norm for the plan's own random error (root of its mean square).
        unit: ``mm``, at the test poses; or ``std``, root mean square over the parameters.
    """

    rows: Floats
    own: float
    unit: str

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "rows", frozen(self.rows))


@dataclass(frozen=True)
class Leftover:
    """What is left of a drift, in the unit of the yardstick, in the worst direction.

    Attributes:
        shift: For each mm/h that the instrument shifts.
        turn: For each mrad/h that it turns about the base origin.
    """

    shift: float
    turn: float


def yardstick(aim: Objective, covariance: Floats) -> Yardstick:
    """Error at the test poses where there are some, else the parameters in units of their standard deviations.

    Args:
        aim: The criterion.
        covariance: (p, p) of the parameters.
    """
    if aim.rows is None:
        scale = np.sqrt(np.diag(covariance) * aim.size)
        return Yardstick(np.diag(1.0 / scale), 1.0, "std")
    rows = aim.target("test_pose")
    triangle: Floats = np.asarray(np.linalg.qr(rows, mode="r"))
    return Yardstick(triangle, float(np.sqrt(np.einsum("rp,pq,rq->", rows, covariance, rows))), "mm")


def drift_of_readings(observer: Observer, q: Floats, visit_loads: Ints, kept: Ints, gain: Floats) -> Floats:
    """Effect of each reading on the result per hour that it is late.

    Args:
        observer: How the poses of this arm are read.
        q: (V, n) joint values of the visits, rad or m.
        visit_loads: (V, S) loads of their readings.
        kept: (p_a,) kept columns of the observer's model.
        gain: (r, p_a) result for each unit of ``A' N d``: rows of the yardstick times the covariance.

    Returns:
        (V, S, r, 6) for each mm/h along x, y, z and each mrad/h about them.
    """
    study, (count, readings) = observer.study, visit_loads.shape
    experiment = full_experiment(q, visit_loads, study.loads, study.markers)

    def columns(scene: Scene) -> Floats:
        rigid = _per_hour(scene, observer)
        own = (scene.experiment.row_shot % readings)[:, None] == np.arange(readings)
        return np.asarray((rigid[:, :, None, :] * own[:, None, :, None]).reshape(*rigid.shape[:2], -1))

    blocks = stacked_visits(observer, experiment, columns)
    size = len(observer.parameters)
    moved = gain @ (blocks[:, :, kept].swapaxes(1, 2) @ blocks[:, :, size:])
    return np.asarray(moved.reshape(count, len(gain), readings, 6).swapaxes(1, 2))


def leftover(total: Floats) -> Leftover:
    """The worst directions of a drift whose effect is (r, 6) per mm/h and mrad/h."""
    return Leftover(float(np.linalg.norm(total[:, :3], 2)), float(np.linalg.norm(total[:, 3:], 2)))


def typical_drift(observer: Observer) -> Floats:
    """(6,) typical size of each freedom of the drift, mm/h and mrad/h."""
    effect = tracker_drift(Binding(observer.study.robot))
    return np.array([parameter.typical for parameter in effect.parameters], dtype=np.float64)


def _per_hour(scene: Scene, observer: Observer) -> Floats:
    """(R, 3, 6) displacement of readings that are an hour late, m or rad, per mm/h and mrad/h."""
    late = replace(scene.experiment, time=np.full(len(scene.point), HOUR), start=0.0)
    effect = tracker_drift(Binding(observer.study.robot))
    return effect.derivative(replace(scene, experiment=late), np.zeros(6))
