"""What is wrong before any cause is named: the residual of the model as it was, laid out by everything recorded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.fit import Fit
from identify.identification import Misfit, misfit_of

__all__ = ["Dependence", "Screen", "screen"]

_WORST = 8  # poses


@dataclass(frozen=True)
class Dependence:
    """How one axis of the residual goes with one recorded or computed quantity, over the visits.

    Attributes:
        column: Name of the quantity; ``t3_Nm`` is the torque on joint 3.
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
    from scipy.stats import spearmanr

    shot = found.data.experiment.row_shot[misfit.rows]
    present, index = np.unique(shot, return_inverse=True)
    count = np.bincount(index)
    if len(present) < 4:
        return ()
    mean = np.stack([np.bincount(index, misfit.error[:, axis]) / count for axis in range(3)], axis=1)
    axes = {**dict(zip("xyz", mean.T, strict=True)), "norm": np.linalg.norm(mean, axis=1)}
    made = []
    for column, values in _quantities(found, present):
        if np.ptp(values) > 0:
            for axis, error in axes.items():
                result = spearmanr(values, error)
                made.append(Dependence(column, axis, float(result.statistic), float(result.pvalue)))
    return tuple(sorted(made, key=lambda item: -abs(item.correlation)))


def _quantities(found: Fit, shots: np.ndarray) -> Iterator[tuple[str, Floats]]:
    """Names and values (S,) of everything that shots can be laid out by."""
    experiment, scene = found.data.experiment, found.response.scene
    q = experiment.q[experiment.shot_pose[shots]]
    torque = scene.joints.torque[shots]
    for joint in range(q.shape[1]):
        yield f"q{joint + 1}_deg", q[:, joint]
        yield f"t{joint + 1}_Nm", torque[:, joint]
        if experiment.approach is not None:
            yield f"approach{joint + 1}", experiment.approach[experiment.shot_visit[shots], joint]
    first = np.zeros(len(experiment.shot_visit), dtype=np.int64)
    first[experiment.row_shot[::-1]] = np.arange(len(experiment.row_shot))[::-1]
    for name, values in (("time_s", experiment.time), ("temperature_C", experiment.temperature)):
        if values is not None:
            yield name, values[first[shots]]
    station = found.state.base_T_measurement[:3, 3]
    yield "range_m", np.linalg.norm(scene.point[first[shots]] - station, axis=1)
