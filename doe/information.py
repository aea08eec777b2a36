"""Information matrices: of blocks, and what they say about standard deviations."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats

__all__ = ["covariance_of", "information_of", "inverse_root_of", "standard_deviations"]

_SINGULAR = 1e-15  # smallest over largest eigenvalue on unit columns


def information_of(blocks: Floats, prior: Floats | None = None) -> Floats:
    """``sum A_i'A_i + prior`` of blocks (n, k, p) -> (p, p)."""
    rows = blocks.reshape(-1, blocks.shape[2])
    product: Floats = rows.T @ rows
    return product if prior is None else product + prior


def inverse_root_of(information: Floats) -> Floats | None:
    """Root with ``M^-1 = root root'``, (p, p), by eigenvalues on unit columns; None where the matrix is singular."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return None
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    if values[0] <= _SINGULAR * values[-1]:
        return None
    root: Floats = vectors / np.sqrt(values) / scale[:, None]
    return root


def covariance_of(information: Floats) -> Floats:
    """Inverse on unit columns; infinite where the matrix is singular."""
    root = inverse_root_of(information)
    return np.full_like(information, np.inf) if root is None else root @ root.T


def standard_deviations(information: Floats) -> Floats:
    """(p,) standard deviations; infinite where the information is singular."""
    deviation: Floats = np.sqrt(np.diag(covariance_of(information)))
    return deviation
