"""The radius of a sphere that holds a position error with a stated confidence."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from identify.arrays import Floats

__all__ = ["radii", "radius"]

_DRAWS = 2**14
_CHUNK = 32  # covariances at once: their draws stay within some MB


def radius(covariance: Floats, confidence: float) -> float:
    """Radius that holds a zero-mean Gaussian 3-D error with this confidence, unit of the covariance's root.

    By 16,384 quasi-random draws: good to about 0.1 %, the same at every call.
    """
    return float(radii(covariance[None], confidence)[0])


def radii(covariances: Floats, confidence: float) -> Floats:
    """The same of many covariances (T, 3, 3) -> (T,)."""
    squares = _standard_draws() ** 2
    place = confidence * (len(squares) - 1)
    below = int(place)
    nearest = [below, min(below + 1, len(squares) - 1)]
    found = np.empty(len(covariances))
    for start in range(0, len(covariances), _CHUNK):
        variances = np.maximum(np.linalg.eigvalsh(covariances[start : start + _CHUNK]), 0.0)
        distance = variances @ squares.T  # squared, in the principal axes
        distance.partition(nearest, axis=1)
        low, high = np.sqrt(distance[:, nearest]).T
        found[start : start + _CHUNK] = low + (place - below) * (high - low)
    return found


@lru_cache(maxsize=1)
def _standard_draws() -> Floats:
    """(16384, 3) standard normal points of a scrambled Sobol sequence."""
    from scipy.stats.qmc import MultivariateNormalQMC

    draws: Floats = MultivariateNormalQMC(np.zeros(3), rng=np.random.default_rng(0)).random(_DRAWS)
    return draws
