"""How far each row is from what the others say: the distances on which the influence of a row depends."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.experiment import Experiment
from identify.noise import Whitening

__all__ = ["one_of_two", "robust_scale", "row_distances"]

_MEDIAN_CHI2_3 = 2.365974


def row_distances(operators: Whitening, whitened: Floats, own: Floats, weights: Floats) -> Floats:
    """Distance of each row from what the others of its visit and the model say, in stated sigmas, (R,).

    With P = N'N and u = P e, the mean shift of row i is ``P_ii^-1 u_i`` with covariance ``P_ii^-1``; the
    inflation that the row's weight put into it is taken out again.

    Args:
        operators: The whitening N of R rows.
        whitened: (K,) whitened residual, N e.
        own: (R, 3, 3) covariance of the instrument, m^2.
        weights: (R,) weights of the rows.
    """
    z, start = np.zeros(len(own)), 0
    for (index, operator), precision in zip(operators.groups, operators.precisions, strict=True):
        count, size = index.shape
        known = whitened[start : start + count * operator.shape[1]].reshape(count, 1, -1)
        start += known.size
        score = (known @ operator).reshape(count, size, 3)
        z[index] = _shift_distance(precision, score, own[index], weights[index])
    return z


def _shift_distance(precision: Floats, score: Floats, own: Floats, weights: Floats) -> Floats:
    """Mahalanobis length of the mean shifts, (G, m); zero where a row has nothing to be compared with."""
    alone = np.einsum("gmij,gmij->gm", precision, precision) * np.einsum("gmij,gmij->gm", own, own) < 1e-24
    precision = np.where(alone[:, :, None, None], np.eye(3), precision)
    square, less = _square(precision, score), weights < 1.0
    if less.any():
        shift = np.linalg.solve(precision[less], score[less][..., None])[..., 0]
        spread = np.linalg.inv(precision[less]) + own[less] * (1.0 - 1.0 / weights[less])[:, None, None]
        square[less] = np.einsum("ni,ni->n", shift, np.linalg.solve(spread, shift[..., None])[..., 0])
    return np.where(alone, 0.0, np.sqrt(np.maximum(square, 0.0)))


def _square(precision: Floats, score: Floats) -> Floats:
    """``u' P^-1 u`` of 3x3 matrices by ``L D L'`` written out: LAPACK takes five times as long for so small ones."""
    p, u = np.moveaxis(precision, (-2, -1), (0, 1)), np.moveaxis(score, -1, 0)
    left, right = p[1, 0] / p[0, 0], p[2, 0] / p[0, 0]
    second, mixed = p[1, 1] - left * p[1, 0], p[2, 1] - right * p[1, 0]
    third = p[2, 2] - right * p[2, 0] - mixed**2 / second
    v = u[1] - left * u[0]
    w = u[2] - right * u[0] - mixed / second * v
    square: Floats = u[0] ** 2 / p[0, 0] + v**2 / second + w**2 / third
    return square


def one_of_two(experiment: Experiment, residual: Floats, z: Floats, limit: float) -> Floats:
    """Where two rows contradict each other and nothing else compares them, only one of them is accused.

    Changes cannot tell which of the two is wrong; the one near where the model and the visit's other
    markers put it is believed, if it is at least twice as near as the other.
    """
    if not (z > limit).any():
        return z
    z = z.copy()
    key = experiment.row_visit * 2 * len(experiment.markers.names) + experiment.row_channel
    group = np.unique(key, return_inverse=True)[1]
    contradict = (np.bincount(group) == 2) & (np.bincount(group, z > limit) == 2)
    rows = np.flatnonzero(contradict[group])
    for one, other in rows[np.argsort(group[rows], kind="stable")].reshape(-1, 2):
        beside = (experiment.row_visit == experiment.row_visit[one]) & (group != group[one])
        expected = np.median(residual[beside], axis=0) if beside.any() else np.zeros(3)
        distance = np.linalg.norm(residual[[one, other]] - expected, axis=1)
        if distance.min() < 0.5 * distance.max():
            z[[one, other][int(distance.argmin())]] = 0.0
    return z


def robust_scale(z: Floats, rows: int, rank: int) -> float:
    """Scale of the row distances from their median, corrected for the parameters fitted."""
    compared = z[z > 0]
    if not len(compared) or rows <= rank:
        return 1.0
    spread = np.median(compared**2) / _MEDIAN_CHI2_3 * rows / (rows - rank)
    return float(np.sqrt(max(spread, 1e-6)))
