"""Information matrices: of blocks, and what they say about standard deviations."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats

__all__ = ["covariance_of", "information_of", "standard_deviations"]

_SINGULAR = 1e-15  # smallest over largest eigenvalue on unit columns


def information_of(blocks: Floats) -> Floats:
    """``sum A_i'A_i`` of blocks (n, k, p) -> (p, p)."""
    rows = blocks.reshape(-1, blocks.shape[2])
    product: Floats = rows.T @ rows
    return product


def covariance_of(information: Floats) -> Floats:
    """Inverse on unit columns; infinite where the matrix is singular."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return np.full_like(information, np.inf)
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    if values[0] <= _SINGULAR * values[-1]:
        return np.full_like(information, np.inf)
    root = vectors / np.sqrt(values) / scale[:, None]
    covariance: Floats = root @ root.T
    return covariance


def standard_deviations(information: Floats) -> Floats:
    """(p,) standard deviations; infinite where the information is singular."""
    deviation: Floats = np.sqrt(np.diag(covariance_of(information)))
    return deviation
