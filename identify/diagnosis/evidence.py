"""What the residual of a fit says about blocks of columns that are not in its model.

With X the whitened columns of the model, r the whitened residual and B the whitened columns of a hypothesis, only
the part of B that the model cannot imitate counts, ``Z = B - X X^+ B``. The score of a hypothesis is

    S = r' Z (Z'Z)^+ Z' r  ~  chi2 with rank(Z) degrees of freedom, if nothing is missing,

and all that is needed for any union of hypotheses are the products Z'Z and Z'r (Rao 1948; Cox and Hinkley 1974, 9.3).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from identify.arrays import Floats, Ints
from identify.fit import Fit
from identify.tails import chi2_sf

__all__ = ["Block", "Evidence", "Score", "Visits", "evidence", "visits_of"]

_INSIDE = 1e-6  # a column that the model imitates to this share is inside it
_FLAT = 1e-9  # squared relative singular value below which a direction does not count
_INVISIBLE = 0.3  # sigma: a column whose largest plausible size moves the readings by less cannot be judged
_CHUNK = 4096


class Block(Protocol):
    """Columns that may be missing: anything with a derivative (R, 3, b) and largest plausible sizes (b,)."""

    @property
    def columns(self) -> Floats:
        """(R, 3, b) m per unit."""

    @property
    def plausible(self) -> Floats:
        """(b,) largest plausible absolute sizes, in units; inf where nothing is known."""


@dataclass(frozen=True)
class Score:
    """The score of one or several blocks.

    Attributes:
        value: Chi-square that they take off.
        dof: Directions that they add.
    """

    value: float
    dof: int

    @property
    def p_value(self) -> float:
        """Probability of a score this large if nothing is missing and the covariance is right."""
        return float(chi2_sf(self.value, self.dof)) if self.dof else 1.0


@dataclass(frozen=True, eq=False)
class Visits:
    """Whitened rows by visit, in groups of visits with equally many.

    Attributes:
        index: For each group the (G, k) rows of its G visits.
        names: For each group the (G,) numbers of its visits.
    """

    index: tuple[Ints, ...]
    names: tuple[Ints, ...]

    @property
    def count(self) -> int:
        """Number of visits."""
        return sum(map(len, self.names))

    def sums(self, rows: Floats) -> Floats:
        """(K, c) whitened rows summed over each visit, (V, c) in the order of the groups."""
        return np.concatenate([rows[index].sum(axis=1) for index in self.index])


def visits_of(found: Fit) -> Visits:
    """The whitened rows of a fit by visit."""
    visit = found.whitening.visits(found.data.experiment)
    order = np.argsort(visit, kind="stable")
    starts = np.flatnonzero(np.diff(visit[order], prepend=-1))
    sizes = np.diff(starts, append=len(order))
    groups = [starts[sizes == size][:, None] + np.arange(size) for size in np.unique(sizes)]
    index = tuple(order[group] for group in groups)
    return Visits(index, tuple(visit[rows[:, 0]] for rows in index))


@dataclass(frozen=True, eq=False)
class Evidence:
    """Blocks beside a fit.

    Attributes:
        found: The fit.
        where: Columns of each block.
        visits: The whitened rows by visit.
        basis: (K, r) orthonormal basis of the model's columns.
        residual: (K,) whitened residual, orthogonal to the basis.
        rest: (K, m) whitened columns of all blocks, projected off the model, of unit length (or zero).
        scale: (m,) length of each projected column, sigma per unit; 0 where the model imitates it.
        gram: (m, m) ``rest' rest``.
        product: (m,) ``rest' residual``.
    """

    found: Fit
    where: tuple[slice, ...]
    visits: Visits
    basis: Floats
    residual: Floats
    rest: Floats
    scale: Floats
    gram: Floats
    product: Floats

    def columns_of(self, blocks: Sequence[int]) -> Ints:
        """Columns of some blocks that count."""
        index = np.concatenate([np.arange(self.where[b].start, self.where[b].stop) for b in blocks])
        seen: Ints = index[self.scale[index] > 0]
        return seen

    def score(self, *blocks: int) -> Score:
        """Score of a union of blocks."""
        index = self.columns_of(blocks)
        values, vectors = self._directions(index)
        return Score(float((((vectors.T @ self.product[index]) ** 2) / values).sum()), len(values))

    def beyond(self, block: int, other: int) -> Score:
        """What a block adds once the other is in the model."""
        both, alone = self.score(block, other), self.score(other)
        return Score(max(both.value - alone.value, 0.0), both.dof - alone.dof)

    def sizes(self, block: int) -> tuple[Floats, Floats]:
        """Least-squares sizes (b,) of a block's parameters and their standard deviations, in units.

        Parameters that cannot be told (alone or from each other) get the smallest sizes that explain the residual.
        """
        where = self.where[block]
        index = self.columns_of([block])
        values, vectors = self._directions(index)
        size, spread = np.zeros(where.stop - where.start), np.full(where.stop - where.start, np.inf)
        inverse = (vectors / values) @ vectors.T
        size[index - where.start] = inverse @ self.product[index] / self.scale[index]
        spread[index - where.start] = np.sqrt(np.diag(inverse)) / self.scale[index]
        return size, spread

    def directions(self, *blocks: int) -> Floats:
        """Orthonormal basis (K, d) of what a union of blocks adds to the model."""
        index = self.columns_of(blocks)
        values, vectors = self._directions(index)
        basis: Floats = self.rest[:, index] @ (vectors / np.sqrt(values))
        return basis

    def _directions(self, index: Ints) -> tuple[Floats, Floats]:
        """Eigenvalues and eigenvectors of the products of some columns, flat ones left out."""
        values, vectors = np.linalg.eigh(self.gram[np.ix_(index, index)])
        seen = values > _FLAT * values.max(initial=0.0)
        return values[seen], vectors[:, seen]

    @cached_property
    def chi2(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(self.residual @ self.residual)

    @property
    def dof(self) -> int:
        """Whitened rows minus rank of the model."""
        return len(self.residual) - int(self.basis.shape[1])

    def left_out(self, *blocks: int) -> float:
        """Sum of squares of the leave-one-visit-out errors with some blocks added to the model.

        In closed form: with Q_i the rows of visit i of the orthonormal model basis, the error of a visit that took no
        part in the fit is ``(I - Q_i Q_i')^-1 r_i``.
        """
        added = self.directions(*blocks) if blocks else np.zeros((len(self.residual), 0))
        residual = self.residual - added @ (added.T @ self.residual)
        total = 0.0
        for index, left in zip(self.visits.index, self.left, strict=True):
            part = added[index]
            inside = left - part @ part.swapaxes(1, 2)
            error = np.linalg.solve(inside + _FLAT * np.eye(index.shape[1]), residual[index][..., None])
            total += float((error**2).sum())
        return total

    @cached_property
    def left(self) -> tuple[Floats, ...]:
        """``I - Q_i Q_i'`` of every visit, by groups."""
        parts = [self.basis[index] for index in self.visits.index]
        return tuple(np.eye(part.shape[1]) - part @ part.swapaxes(1, 2) for part in parts)

    def outside(self) -> Floats:
        """Chi-square per row of each visit judged by all others, by number: ``r_i'(I - H_i)^-1 r_i / k``."""
        found = np.zeros(len(self.found.data.experiment.visits))
        for index, names, left in zip(self.visits.index, self.visits.names, self.left, strict=True):
            part = self.residual[index][..., None]
            error = np.linalg.solve(left + _FLAT * np.eye(index.shape[1]), part)
            found[names] = (part * error).sum(axis=(1, 2)) / index.shape[1]
        return found


def evidence(found: Fit, blocks: Sequence[Block]) -> Evidence:
    """Whiten blocks, project them off the model of a fit, and take the products that all scores need.

    Args:
        found: The fit.
        blocks: Blocks on the rows of the fit.
    """
    columns = found.columns[:, found.identifiability.kept]
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0] if columns.shape[1] else columns
    residual = found.whitened - basis @ (basis.T @ found.whitened)
    ends = np.cumsum([0, *(block.columns.shape[2] for block in blocks)])
    where = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
    rest = np.empty((len(residual), int(ends[-1])))
    plausible = np.concatenate([block.plausible for block in blocks]) if blocks else np.zeros(0)
    for block, place in zip(blocks, where, strict=True):
        rest[:, place] = found.whitening.apply(block.columns)
    whole = np.linalg.norm(rest, axis=0)
    for _ in range(2):  # twice is enough (Kahan, Parlett)
        rest -= basis @ (basis.T @ rest)
    scale = np.linalg.norm(rest, axis=0)
    scale[(scale <= _INSIDE * whole) | (scale < _INVISIBLE / plausible)] = 0.0
    rest /= np.where(scale > 0, scale, np.inf)
    return Evidence(found, where, visits_of(found), basis, residual, rest, scale, rest.T @ rest, rest.T @ residual)
