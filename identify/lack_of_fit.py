"""Does the model fit the readings: chi-square of the rows that fit at all, loads as uncertain as stated.

Leaving rows out is the same as giving each a displacement of its own, so the whitened residual is
projected off their columns. Loads stated with a standard deviation add ``Z Z'`` to the unit covariance
of the whitened residual r, with Z the whitened change of the readings by one sigma of each load:

    chi2 = r' (M + M Z Z' M)^+ r = r'r - r'MZ (I + Z'MZ)^-1 Z'M r        (M projects off the fitted columns)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.fit import Fit
from identify.uncertainty import load_changes_by_sigma, off_columns

__all__ = ["LackOfFit", "lack_of_fit"]

_SMALL = 1e-9


@dataclass(frozen=True)
class LackOfFit:
    """How well model and stated noise explain the rows.

    Attributes:
        chi2: Weighted sum of squares.
        dof: Degrees of freedom.
        p_value: Probability of a chi2 this large if both are right.
    """

    chi2: float
    dof: int
    p_value: float


def lack_of_fit(found: Fit, left_out: Ints) -> LackOfFit:
    """Chi-square of a fit.

    Args:
        found: The fit.
        left_out: Rows that do not fit and do not count.
    """
    from scipy.special import chdtrc  # scipy.stats takes half a second to import

    loads = off_columns(found, load_changes_by_sigma(found))
    both = np.column_stack([found.whitened, loads])
    lost = _project_off(found, left_out, both)
    rest, loads = both[:, 0], both[:, 1:]
    gained = loads.T @ rest
    total = float(rest @ rest - gained @ np.linalg.solve(np.eye(len(gained)) + loads.T @ loads, gained))
    dof = max(found.dof - lost, 1)
    return LackOfFit(total, dof, float(chdtrc(dof, total)))


def _project_off(found: Fit, left_out: Ints, whitened: Floats) -> int:
    """Take the displacements of some rows out of whitened columns (K, c), in place; the number of equations lost."""
    bad = np.zeros(len(found.residual), dtype=bool)
    bad[left_out] = True
    lost, start = 0, 0
    for index, operator in found.whitening.groups:
        size = operator.shape[1]
        for visit in np.flatnonzero(bad[index].any(axis=1)):
            columns = operator[visit][:, np.repeat(bad[index[visit]], 3)]
            columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            left, values, _ = np.linalg.svd(columns, full_matrices=False)
            basis = left[:, values > _SMALL]
            rows = slice(start + visit * size, start + (visit + 1) * size)
            whitened[rows] -= basis @ (basis.T @ whitened[rows])
            lost += basis.shape[1]
        start += len(index) * size
    return lost
