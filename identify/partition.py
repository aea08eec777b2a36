"""Which columns of an observation matrix can be identified: three groups, coupled groups, selection.

Source: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", section 3.2, eq. 14 to 21.
Two places of it are read as they must be meant: the block of V that spans the null space ends at V_n (n columns, not
m rows), and the inverse in eq. 21 is that of the transpose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.identifiability import independent_columns

__all__ = ["ROW_TOLERANCE", "Partition", "coupled_groups", "coupling", "partition", "select", "unit_columns"]

#: A parameter belongs to a subspace if its row of the other one is below this (the rows of V have length 1 at most).
ROW_TOLERANCE = 1e-7
_TOLERANCE = 1e-9
_ROUNDING = 64 * float(np.finfo(np.float64).eps)  # a column below this share of the largest is rounding noise


@dataclass(frozen=True, eq=False)
class Partition:
    """Columns of a matrix in three groups that do not overlap (rules 1 to 3).

    Attributes:
        identifiable: G1: indices of the columns that are determined.
        invisible: G2: indices of the columns that are zero.
        coupled: G3: indices of the columns that show, but only together with others.
        rank: Number of parameters that can be identified.
        singular_values: (min(m, n),) of the matrix with unit columns, relative to the largest.
        tolerance: Relative singular values at or below this count as zero.
    """

    identifiable: Ints
    invisible: Ints
    coupled: Ints
    rank: int
    singular_values: Floats
    tolerance: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("identifiable", "invisible", "coupled"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))
        object.__setattr__(self, "singular_values", frozen(self.singular_values))

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Rank and the sizes of G1, G2, G3."""
        return self.rank, len(self.identifiable), len(self.invisible), len(self.coupled)

    @property
    def gap(self) -> tuple[float, float]:
        """The last relative singular value that counts and the first that does not (0 if there is none)."""
        padded = np.append(self.singular_values, [0.0, 0.0])
        return float(padded[self.rank - 1]) if self.rank else 0.0, float(padded[self.rank])


def partition(matrix: Floats, tolerance: float = _TOLERANCE, row_tolerance: float = ROW_TOLERANCE) -> Partition:
    """Divide the columns of an observation matrix into G1, G2 and G3 by its singular vectors (M4a, eq. 15 to 20).

    Args:
        matrix: (m, n) rows of readings, one column a parameter, any scaling of the columns.
        tolerance: Singular values of the unit columns below this share of the largest count as zero.
        row_tolerance: A row of V below this is zero.
    """
    singular, right = _right_vectors(matrix)
    relative = singular / max(singular.max(initial=0.0), np.finfo(np.float64).tiny)
    rank = int((relative > tolerance).sum())
    seen, hidden = right[:, :rank], right[:, rank:]
    visible = np.abs(seen).max(axis=1, initial=0.0) >= row_tolerance
    free = np.abs(hidden).max(axis=1, initial=0.0) >= row_tolerance
    groups = [np.flatnonzero(group).astype(np.int64) for group in (visible & ~free, ~visible, visible & free)]
    return Partition(groups[0], groups[1], groups[2], rank, relative, tolerance)


def unit_columns(matrix: Floats) -> tuple[Floats, Floats]:
    """Columns of length 1 and their former lengths (n,); columns that are rounding noise become zero."""
    norms = np.linalg.norm(matrix, axis=0)
    norms = np.where(norms > _ROUNDING * norms.max(initial=0.0), norms, 0.0)
    return matrix * np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0), norms


def coupled_groups(matrix: Floats, tolerance: float = _TOLERANCE) -> tuple[Ints, ...]:
    """Split coupled columns into the smallest groups that are independent of each other (M5a, eq. 21).

    ``L = [V_1 ... V_r]*^-T [V_1 ... V_r]^T``, * being r rows that keep the rank, is brought into block-diagonal form:
    the blocks are the connected components of its pattern. They do not depend on which r rows are taken.

    Args:
        matrix: (m, n) columns of G3.
        tolerance: As in `partition`.

    Returns:
        Indices of the columns of each group, ascending; groups in the order of their first columns.
    """
    from scipy.linalg import qr

    singular, right = _right_vectors(matrix)
    rank = int((singular > tolerance * singular.max(initial=0.0)).sum())
    rows = right[:, :rank]
    chosen = qr(rows.T, mode="r", pivoting=True)[1][:rank]
    pattern = np.abs(np.linalg.solve(rows[chosen].T, rows.T)) >= ROW_TOLERANCE
    label = np.arange(matrix.shape[1])
    for row in pattern:
        joined = np.isin(label, label[row])
        label[joined] = label[row].min(initial=len(label))
    return tuple(np.flatnonzero(label == first) for first in np.unique(label))


def select(matrix: Floats, order: Sequence[int]) -> Ints:
    """Columns that keep the rank, taken greedily in an order of preference (M5b): ascending indices."""
    units, _ = unit_columns(matrix)
    preferred = np.asarray(order, dtype=np.int64)
    kept = independent_columns(_triangle(units[:, preferred])).kept
    return np.asarray(np.sort(preferred[kept]))


def coupling(matrix: Floats, kept: Ints) -> Floats:
    """``L`` (r, n) of eq. 21 with ``matrix = matrix[:, kept] L``: what every column adds to the kept ones."""
    units, norms = unit_columns(matrix)
    solution = np.asarray(np.linalg.lstsq(units[:, kept], units, rcond=None)[0], dtype=np.float64)
    solution[np.abs(solution) < ROW_TOLERANCE] = 0.0
    solution[:, kept] = np.eye(len(kept))
    scaled: Floats = solution * norms / norms[kept][:, None]
    return scaled


def _right_vectors(matrix: Floats) -> tuple[Floats, Floats]:
    """Singular values (min(m, n),) of the matrix with unit columns and V (n, n)."""
    units, _ = unit_columns(matrix)
    _, singular, transposed = np.linalg.svd(_triangle(units))
    return singular, transposed.T


def _triangle(matrix: Floats) -> Floats:
    """A matrix with the same columns' products and at most as many rows as columns."""
    return np.asarray(np.linalg.qr(matrix, mode="r")) if matrix.shape[0] > matrix.shape[1] else matrix
