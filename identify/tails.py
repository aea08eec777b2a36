"""Tails and quantiles of the usual distributions, from `scipy.special`: loading `scipy.stats` takes most of a second.

All are what the methods of the same name of `scipy.stats` return (a test holds them together).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from identify.arrays import Floats

__all__ = ["chi2_sf", "f_sf", "gamma_sf", "norm_ppf", "spearman", "student_ppf", "student_sf"]


def chi2_sf(value: Any, dof: Any) -> Any:
    """P(chi2 > value) with ``dof`` degrees of freedom; arrays broadcast."""
    from scipy.special import chdtrc

    return chdtrc(dof, value)


def gamma_sf(value: float, shape: float, scale: float) -> float:
    """P(x > value) of a gamma distribution."""
    from scipy.special import gammaincc

    return float(gammaincc(shape, value / scale))


def f_sf(value: float, above: float, below: float) -> float:
    """P(F > value) with these degrees of freedom above and below the bar."""
    from scipy.special import fdtrc

    return float(fdtrc(above, below, value))


def norm_ppf(share: float) -> float:
    """Quantile of the normal distribution."""
    from scipy.special import ndtri

    return float(ndtri(share))


def student_ppf(share: float, dof: float) -> float:
    """Quantile of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(dof, share))


def student_sf(value: Any, dof: float) -> Any:
    """P(t > value) of Student's t."""
    from scipy.special import stdtr

    return stdtr(dof, -np.asarray(value))


def spearman(one: Floats, other: Floats) -> tuple[float, float]:
    """Spearman's rank correlation of two series (n,) and its two-sided probability (Student's t), n > 2."""
    ranks = [_ranks(series) for series in (one, other)]
    centred = [series - series.mean() for series in ranks]
    lengths = [float(np.linalg.norm(series)) for series in centred]
    correlation = float(np.clip(centred[0] @ centred[1] / (lengths[0] * lengths[1]), -1.0, 1.0))
    dof = len(one) - 2
    t = abs(correlation) * np.sqrt(dof / max((1.0 - correlation) * (1.0 + correlation), 1e-300))
    return correlation, float(2.0 * student_sf(t, dof))


def _ranks(series: Floats) -> Floats:
    """Ranks, equal values share theirs."""
    _, inverse, count = np.unique(series, return_inverse=True, return_counts=True)
    middle = np.cumsum(count) - (count - 1) / 2
    ranks: Floats = middle[inverse]
    return ranks
