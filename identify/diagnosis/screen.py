"""What is wrong before any cause is named: the residual of the model as it was, laid out by everything recorded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects import Scene
from identify.experiment import Experiment
from identify.fit import Fit
from identify.identification import Misfit, misfit_of
from identify.tails import spearman
from identify.units import DEG, MM

__all__ = ["Dependence", "Screen", "recorded", "screen"]

_WORST = 8  # poses


@dataclass(frozen=True)
class Dependence:
    """How one axis of the residual goes with one recorded or computed quantity, over the visits.

    Attributes:
        column: Name of the quantity; ``t3_Nm`` is the torque on joint 3, ``range_m`` the distance to the instrument.
        axis: x, y or z of the base frame, or ``norm``.
        correlation: Spearman's rank correlation.
        p_value: Probability of one that large without a dependence.
    """

    column: str
    axis: str
    correlation: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Screen:
    """The residual of a fit by axis, marker, load and visit.

    Attributes:
        misfit: Errors of markers (or of their change under load) and their rows, base frame, m.
        axis: (3,) rms, m.
        marker: Rms by marker, m.
        load: Rms by load, m.
        worst: Visits with the largest rms, worst first, m.
        dependences: Every axis against every quantity, strongest first.
    """

    misfit: Misfit
    axis: Floats
    marker: dict[str, float]
    load: dict[str, float]
    worst: dict[str, float]
    dependences: tuple[Dependence, ...]


def screen(found: Fit, reference: str) -> Screen:
    """Lay out the residual of a fit.

    Args:
        found: The fit of the model as it was.
        reference: absolute or differences.
    """
    experiment = found.data.experiment
    misfit = misfit_of(found.data, found.residual, reference, np.arange(len(found.residual)))
    marker, visit = experiment.row_marker[misfit.rows], experiment.row_visit[misfit.rows]
    load = experiment.shot_load[experiment.row_shot[misfit.rows]]
    by_visit = _rms_by(misfit.error, visit, experiment.visits)
    worst = dict(sorted(by_visit.items(), key=lambda item: -item[1])[:_WORST])
    return Screen(
        misfit,
        np.sqrt((misfit.error**2).mean(axis=0)) if len(misfit.error) else np.zeros(3),
        _rms_by(misfit.error, marker, experiment.markers.names),
        _rms_by(misfit.error, load, tuple(case.name for case in experiment.loads)),
        worst,
        _dependences(found, misfit),
    )


def _rms_by(error: Floats, group: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    """Rms of the 3-D error of each group that has rows."""
    square = (error**2).sum(axis=1)
    count = np.bincount(group, minlength=len(names))
    total = np.bincount(group, square, len(names))
    return {names[i]: float(np.sqrt(total[i] / count[i])) for i in np.flatnonzero(count)}


def _dependences(found: Fit, misfit: Misfit) -> tuple[Dependence, ...]:
    """Rank correlations of shots' mean errors with everything, strongest first."""
    shot = found.data.experiment.row_shot[misfit.rows]
    present, index = np.unique(shot, return_inverse=True)
    count = np.bincount(index)
    if len(present) < 4:
        return ()
    mean = np.stack([np.bincount(index, misfit.error[:, axis]) / count for axis in range(3)], axis=1)
    axes = {**dict(zip("xyz", mean.T, strict=True)), "norm": np.linalg.norm(mean, axis=1)}
    made = []
    first = _first_rows(found.data.experiment.row_shot, present)
    everything = recorded(found.data.experiment, found.response.scene, found.state.base_T_measurement[:3, 3])
    for column, values in ((name, rows[first]) for name, rows in everything):
        if np.ptp(values) > 0:
            for axis, error in axes.items():
                made.append(Dependence(column, axis, *spearman(values, error)))
    return tuple(sorted(made, key=lambda item: -abs(item.correlation)))


def _first_rows(row_shot: Ints, shots: Ints) -> Ints:
    """The first row of each of some shots."""
    first = np.zeros(int(row_shot.max()) + 1, dtype=np.int64)
    first[row_shot[::-1]] = np.arange(len(row_shot))[::-1]
    rows: Ints = first[shots]
    return rows


def recorded(experiment: Experiment, scene: Scene, station: Floats) -> Iterator[tuple[str, Floats]]:
    """Names and values (R,) of everything that rows can be laid out by, in the units of the names.

    Args:
        experiment: The conditions.
        scene: Their fields.
        station: (3,) the instrument in the base frame, m.
    """
    robot = scene.frames.robot
    q = experiment.q[experiment.shot_pose[experiment.row_shot]] / np.where(robot.prismatic, MM, DEG)
    torque = scene.joints.torque[experiment.row_shot]
    for joint in range(robot.n):
        yield f"q{joint + 1}_{'mm' if robot.prismatic[joint] else 'deg'}", q[:, joint]
    for joint in range(robot.n):
        yield f"t{joint + 1}_{'N' if robot.prismatic[joint] else 'Nm'}", torque[:, joint]
    if experiment.approach is not None:
        for joint in range(robot.n):
            yield f"approach{joint + 1}", experiment.approach[experiment.row_visit, joint]
    for name, values in (("time_s", experiment.time), ("temperature_C", experiment.temperature)):
        if values is not None:
            yield name, values
    yield "range_m", np.linalg.norm(scene.point - station, axis=1)
