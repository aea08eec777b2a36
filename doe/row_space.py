"""What the candidates can see: rank, the row space, and coordinates in which the average information is I.

The rank is decided with unit columns at 1e-9, which the eigenvalues of one Gram matrix cannot do: they
carry rounding errors of 1e-16, singular values of 1e-8. Two Gram matrices can. The first splits the
directions into clearly seen ones and doubtful ones; the second is formed of the rows multiplied by the
doubtful directions alone, so its rounding errors are smaller by the square of what is left there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.blocks import Blocks
from identify.arrays import Floats
from identify.errors import NotIdentifiable

__all__ = ["RowSpace", "prior_rows", "row_space"]

CLEAR = 1e-4  # singular values above this fraction of the largest are certain from the first Gram matrix
FEW = 1000  # candidates that show the sizes of the columns
HUGE = 1e200  # a sum of squares above this may have lost numbers that overflowed, or hide some that vanished
NOISE = 64  # a column below this many rounding units of the largest one is zero


@dataclass(frozen=True, eq=False)
class RowSpace:
    """Coordinates of what can be identified.

    Attributes:
        basis: (p, rank); ``A_i @ basis`` are the blocks in coordinates where the average information is about I.
        seen: (p, rank) orthonormal directions of the row space, columns scaled to unit norm.
        norms: (p,) norms of the columns; zero where a column is only rounding noise.
        tolerance: Relative size below which a part of a target outside the row space is rounding.
    """

    basis: Floats
    seen: Floats
    norms: Floats
    tolerance: float

    @property
    def full(self) -> bool:
        """True if every parameter can be identified."""
        return bool(self.basis.shape[0] == self.basis.shape[1])

    def unseen(self) -> tuple[int, ...]:
        """Columns that take part in a direction nobody sees."""
        left = 1.0 - np.einsum("ij,ij->i", self.seen, self.seen)
        return tuple(int(j) for j in np.flatnonzero((left > 1e-6) | (self.norms == 0.0)))

    def reduce(self, target: Floats) -> Floats:
        """Target rows (..., p) in the new coordinates, (..., rank).

        Raises:
            NotIdentifiable: The target has a part outside the row space.
        """
        rows = target.reshape(-1, target.shape[-1])
        size = np.linalg.norm(rows, axis=0)
        outside = (self.norms == 0.0) & (size > NOISE * np.finfo(np.float64).eps * size.max(initial=0.0))
        unit = rows / np.where(self.norms > 0.0, self.norms, np.inf)
        rest = np.linalg.norm(unit - (unit @ self.seen) @ self.seen.T, axis=0)
        outside |= rest > self.tolerance * np.linalg.norm(unit)
        if outside.any():
            missing = tuple(int(j) for j in np.flatnonzero(outside))
            raise NotIdentifiable(
                f"the target needs directions that no candidate sees, in columns {list(missing)}; "
                "add candidates that see them or leave these parameters out of the target",
                missing,
            )
        product: Floats = target @ self.basis
        return product


def row_space(blocks: Blocks, prior: Floats) -> RowSpace:
    """Row space of the blocks and of the information ``prior`` (p, p), on the scale of one candidate.

    Raises:
        NotIdentifiable: All blocks are zero and there is no prior.
    """
    shift = prior_rows(prior) * np.sqrt(len(blocks))
    peak, first = _first_gram(blocks, shift)
    norms = np.sqrt(np.diag(first)) * peak
    norms = np.where(norms < NOISE * blocks.eps * norms.max(), 0.0, norms)
    kept = norms > 0.0
    shrink = (peak * _inverse(norms))[kept]  # scaling a column later costs no accuracy
    unit_gram = first[np.ix_(kept, kept)] * np.outer(shrink, shrink)
    return _split(blocks, shift, norms, unit_gram)


def _first_gram(blocks: Blocks, shift: Floats) -> tuple[Floats, Floats]:
    """Rough sizes (p,) of the columns, and the Gram matrix (p, p) of the rows with columns divided by them.

    The sizes only keep squares from overflowing and vanishing. Those of a few candidates will do, unless the result
    shows that they do not; then they are taken of all.

    Raises:
        InputError: The blocks hold NaN or infinity.
        NotIdentifiable: All blocks are zero and there is no prior.
    """
    here = np.abs(shift).max(axis=0, initial=0.0)
    some = np.asarray(blocks.array[:: max(1, len(blocks) // FEW)], dtype=np.float64)
    peak = np.maximum(np.abs(some).max(axis=(0, 1)), here)
    if np.isfinite(peak).all() and peak.all():
        gram = _gram(blocks, shift, 1.0 / peak)
        if np.all(np.diag(gram) < HUGE):
            return peak, gram
    peak = np.maximum(blocks.peak(), here)
    if not peak.any():
        everything = tuple(range(blocks.p))
        raise NotIdentifiable("all blocks are zero: no candidate sees any parameter", everything)
    return peak, _gram(blocks, shift, _inverse(peak))


def _split(blocks: Blocks, shift: Floats, norms: Floats, unit_gram: Floats) -> RowSpace:
    """Decide the rank of the rows with unit columns and build the coordinates."""
    limit = 1e-9 if blocks.eps < 1e-12 else max(1e-4, NOISE * blocks.eps)
    scale = np.diag(_inverse(norms))[:, norms > 0.0]
    square, directions = np.linalg.eigh(unit_gram)
    largest = np.sqrt(square[-1])
    clear = square > (max(CLEAR, limit) * largest) ** 2
    size, seen = np.sqrt(square[clear]), directions[:, clear]
    if not clear.all() and limit < CLEAR:
        doubtful = directions[:, ~clear]
        square, turn = np.linalg.eigh(_gram(blocks, shift, scale @ doubtful))
        kept = square > (limit * largest) ** 2
        seen = np.hstack([doubtful @ turn[:, kept], seen])
        size = np.concatenate([np.sqrt(square[kept]), size])
    unit = np.zeros((len(norms), len(size)))
    unit[norms > 0.0] = seen
    basis = scale @ (seen / size) * np.sqrt(len(blocks))
    tolerance = max(1e-8, 100.0 * blocks.eps * largest / size.min())
    return RowSpace(basis, unit, norms, tolerance)


def _gram(blocks: Blocks, shift: Floats, basis: Floats) -> Floats:
    """Gram matrix of all rows, those of the prior included, times ``basis`` (p, q) or with columns scaled by (p,)."""
    turned = shift * basis if basis.ndim == 1 else shift @ basis
    result: Floats = blocks.gram(basis) + turned.T @ turned
    return result


def prior_rows(prior: Floats) -> Floats:
    """Rows F (p, p) with ``F'F = prior`` for a positive semidefinite prior, accurate for any column scales."""
    scale = np.sqrt(np.diag(prior))
    unit = prior * np.outer(_inverse(scale), _inverse(scale))
    values, vectors = np.linalg.eigh(unit)
    rank_noise = len(prior) * np.finfo(np.float64).eps * values[-1:].max(initial=0.0)
    root = np.sqrt(np.where(values > rank_noise, values, 0.0))
    result: Floats = (vectors * root).T * scale
    return result


def _inverse(values: Floats) -> Floats:
    """1/values, and 0 where a value is zero."""
    return np.where(values > 0.0, 1.0 / np.where(values > 0.0, values, 1.0), 0.0)
