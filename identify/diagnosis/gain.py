"""What naming the causes gains, on visits that took no part in choosing or fitting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.diagnosis.search import Search, fitted, search
from identify.experiment import Measurements
from identify.fit import Fit
from identify.identification import misfit_of
from identify.noise import instrument_covariance
from identify.response import respond
from identify.selection import rows_of_visits, take_rows
from identify.study import Noise, Study

__all__ = ["Gain", "gain"]

_FOLDS = 5
_MANY = 2000  # visits above which one split of 60 to 40 is enough
_JUDGED = 0.4
_BOOTSTRAPS = 1000


@dataclass(frozen=True, eq=False)
class Gain:
    """Errors of markers on held-out visits (of their change under load, for ``differences``), m.

    Attributes:
        before: Rms of the 3-D error with the model as it was.
        after: The same with the model extended.
        noise: Rms that the noise alone would leave.
        visits: Number of visits that were held out.
        interval: 95 % interval of the ratio after / before, by resampling visits.
    """

    before: float
    after: float
    noise: float
    visits: int
    interval: tuple[float, float]

    @property
    def significant(self) -> bool:
        """True if the interval of the ratio lies below 1."""
        return self.interval[1] < 1.0


def gain(study: Study, done: Search, *, differences: bool, rng: np.random.Generator, without: frozenset[str]) -> Gain:
    """Repeat choosing and fitting without each fold of visits and judge it there.

    Args:
        study: The study as it was.
        done: The search on all visits.
        differences: Only changes within a visit inform.
        rng: Random numbers: folds, flips, resampling.
        without: Effects that are not tried.
    """
    data = done.last.data
    visits = np.unique(data.experiment.row_visit)
    reference = "differences" if differences else "absolute"
    squares: list[tuple[Floats, Floats, Ints]] = []
    for judged in _folds(visits, rng):
        marked = np.zeros(len(data.experiment.visits), dtype=bool)
        marked[judged] = True
        part = take_rows(data, rows_of_visits(data.experiment, ~marked))
        begin = fitted(study, part, differences=differences, begin=done.first)
        trained = search(
            study, part, gate=done.gate, differences=differences, rng=rng, without=without, begin=begin, rivals=False
        )
        rows = rows_of_visits(data.experiment, marked)
        before, after = (misfit_of(data, _residual(model, data), reference, rows) for model in (begin, trained.last))
        squares.append((
            (before.error**2).sum(axis=1),
            (after.error**2).sum(axis=1),
            data.experiment.row_visit[before.rows],
        ))
    errors = [np.concatenate(parts) for parts in zip(*squares, strict=True)]
    return _judged(errors[0], errors[1], errors[2], _noise_rms(done.last, study.noise, reference), rng)


def _folds(visits: Ints, rng: np.random.Generator) -> list[Ints]:
    """Visits to judge, fold by fold."""
    shuffled = rng.permutation(visits)
    if len(visits) > _MANY:
        return [shuffled[: round(_JUDGED * len(visits))]]
    return [shuffled[fold::_FOLDS] for fold in range(_FOLDS)]


def _residual(found: Fit, data: Measurements) -> Floats:
    """(R, 3) residual of all rows under a fit to some of them, base frame, m."""
    placement = found.state.base_T_measurement
    predicted = respond(found.model, data.experiment, found.state.values, derivative=False).position
    residual: Floats = data.positions @ placement[:3, :3].T + placement[:3, 3] - predicted
    return residual


def _noise_rms(found: Fit, noise: Noise, reference: str) -> float:
    """Rms of a marker's error that the stated noise alone leaves, m."""
    scene = found.response.scene
    own = instrument_covariance(noise, scene.point, found.state.base_T_measurement[:3, 3])
    jitter = noise.reading_jitter**2 + (noise.pose_jitter**2 if reference == "absolute" else 0.0)
    swept = (scene.joints.motion**2).sum(axis=(1, 2))
    variance = np.trace(own, axis1=1, axis2=2) + jitter * swept
    return float(np.sqrt(variance.mean() * (1.0 if reference == "absolute" else 2.0)))


def _judged(before: Floats, after: Floats, visit: Ints, noise: float, rng: np.random.Generator) -> Gain:
    """Rms before and after, with the ratio's interval from resampled visits."""
    names, index = np.unique(visit, return_inverse=True)
    sums = np.stack([np.bincount(index, part) for part in (before, after)])
    weights = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=_BOOTSTRAPS)
    ratio = np.sqrt((weights @ sums[1]) / np.maximum(weights @ sums[0], 1e-300))
    low, high = np.quantile(ratio, [0.025, 0.975])
    return Gain(
        float(np.sqrt(before.mean())), float(np.sqrt(after.mean())), noise, len(names), (float(low), float(high))
    )
